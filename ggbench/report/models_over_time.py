"""Weights of an estimator's models over time, in words."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

import pandas as pd

_KEY = re.compile(r"at_(\d+)_s")
_SHARE = re.compile(r"(.+?) (\d+) %(?:, |$)")
_LEAST, _MOST = 0.05, 3
"""Mean weight from which a model is named, and the largest number of names."""


def weights_of(text: str) -> dict[str, float]:
    """Return the weights of the models of a text such as ``as assumed 70 %, outliers 30 %``."""
    return {words: int(share) / 100.0 for words, share in _SHARE.findall(text)}


def over_time(infos: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """Return a row for each time: ``time_s``, and ``models``, the heaviest models of all runs.

    A model's weight is the mean over the runs, in which it weighs nothing where it is not named.

    Parameters
    ----------
    infos : ``Estimate.info`` of the runs, with texts of :func:`weights_of` at ``at_<seconds>_s``.
    """
    at: dict[int, list[dict[str, float]]] = {}
    for info in infos:
        for key, text in info.items():
            if (time := _KEY.fullmatch(key)) and isinstance(text, str):
                at.setdefault(int(time[1]), []).append(weights_of(text))
    rows = []
    for time_s, runs in sorted(at.items()):
        names = dict.fromkeys(name for run in runs for name in run)
        means = {name: sum(run.get(name, 0.0) for run in runs) / len(runs) for name in names}
        heaviest = sorted(means.items(), key=lambda item: -item[1])[:_MOST]
        named = [f"{name} {100.0 * mean:.0f} %" for name, mean in heaviest if mean >= _LEAST]
        rows.append({"time_s": time_s, "models": ", ".join(named) or "many, none above 5 %"})
    return pd.DataFrame(rows)
