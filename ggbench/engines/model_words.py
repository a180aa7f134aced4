"""Weights of models as a text.

The text contains the description of each model, followed by its weight. An example is ``noise 3.1
times as assumed 62 %, outliers 30 %``: the first model has the weight 62 %, the second 30 %.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

_LEAST, _MOST = 0.05, 3
"""Weight from which a model is named, and the largest number of names."""
_SHARE = re.compile(r"(.+?) (\d+) %(?:, |$)")


def in_words(weights: Iterable[tuple[str, float]]) -> str:
    """Return a text with the models of largest weight.

    It contains at most three models, each with a weight of at least 5 %. Without such a model it is
    "".

    Parameters
    ----------
    weights : pairs of a model's description and its weight, from 0 to 1.
    """
    heaviest = sorted(weights, key=lambda item: -item[1])[:_MOST]
    return ", ".join(
        f"{words} {100.0 * weight:.0f} %" for words, weight in heaviest if weight >= _LEAST
    )


def weights_of(text: str) -> dict[str, float]:
    """Return the weight of each model from a text of :func:`in_words`, rounded to 0.01."""
    return {words: int(share) / 100.0 for words, share in _SHARE.findall(text)}
