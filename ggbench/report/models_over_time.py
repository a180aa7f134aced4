"""Weights of the models of a multiple-model estimator over time, as text."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

import pandas as pd

from ..engines.model_words import in_words, weights_of

_KEY = re.compile(r"at_(\d+)_s")


def over_time(infos: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """Return a table with a row for each time: ``time_s``, and ``models`` with the mean weights.

    ``models`` lists the models with the largest weights, averaged over the runs. A model that a run
    does not list has weight zero in this run.

    Parameters
    ----------
    infos : ``Estimate.info`` of the runs. The key ``at_<seconds>_s`` has the weights at this time.
        They are stored as the text that :func:`.in_words` returns.
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
        rows.append({"time_s": time_s, "models": in_words(means.items()) or "many, none above 5 %"})
    return pd.DataFrame(rows)
