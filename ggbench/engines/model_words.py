"""Weights of models in words: ``noise 3.1 times as assumed 62 %, outliers 30 %``."""

from __future__ import annotations

import re
from collections.abc import Iterable

_LEAST, _MOST = 0.05, 3
"""Weight from which a model is named, and the largest number of names."""
_SHARE = re.compile(r"(.+?) (\d+) %(?:, |$)")


def in_words(weights: Iterable[tuple[str, float]]) -> str:
    """Return the heaviest models and their weights, "" if none weighs enough to be named.

    Parameters
    ----------
    weights : words of each model, and its weight, from 0 to 1.
    """
    heaviest = sorted(weights, key=lambda item: -item[1])[:_MOST]
    return ", ".join(
        f"{words} {100.0 * weight:.0f} %" for words, weight in heaviest if weight >= _LEAST
    )


def weights_of(text: str) -> dict[str, float]:
    """Return the weights of the models of a text of :func:`in_words`, to a hundredth."""
    return {words: int(share) / 100.0 for words, share in _SHARE.findall(text)}
