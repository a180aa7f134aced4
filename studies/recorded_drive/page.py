"""Page reports/recorded_drive.md, from reports/recorded_drive/outages.csv."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from ggbench.figures.style import Drawing, legend_below, save, styled, subplots
from ggbench.report import page_templates
from ggbench.report.columns import significant

from .outages import FILTER, SMOOTHER

FOLDER = "recorded_drive"
OUTAGES = "outages.csv"
_ANSWERED_S = 10.0
"""Length of the outages in the answer of the page [s]."""


def write(table: pd.DataFrame, output: Path) -> Path:
    """Write ``recorded_drive.md`` and its figure; return the path of the page."""
    save(drifts(table), output / FOLDER / "answer.png")
    path = output / f"{FOLDER}.md"
    path.write_text(page(table), encoding="utf-8")
    return path


def page(table: pd.DataFrame) -> str:
    """Return the text of the page."""
    rows = summary(table)
    numbers = rows[["drift_m", "sigma_m"]].map(lambda number: significant(number, 2))
    longest_s = rows.index[-1]
    return page_templates.markdown(
        "recorded_drive.md.j2",
        Path(__file__).parent,
        larger=bool((rows["drift_m"] > rows["sigma_m"]).any()),
        answered_s=f"{_ANSWERED_S:g}",
        answered=numbers.loc[_ANSWERED_S],
        longest_s=f"{longest_s:g}",
        longest=numbers.loc[longest_s],
        equal=equal_to_filter(table),
        drifts=_shown(rows),
    )


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return the RMS drift of filter and smoother, and the predicted drift, by outage length.

    The index is the outage length [s]. Columns are ``outages`` (number of outages), ``disjoint``
    (largest number of outages without overlap), ``drift_m``, ``sigma_m`` and ``smoother_m``.
    """
    rows = {}
    for length, part in table.groupby("length_s"):
        own = part[part["estimator"] == FILTER]
        smoothed = part.loc[part["estimator"] == SMOOTHER, "drift_m"]
        span = own["start_s"].max() + length - own["start_s"].min()
        rows[length] = {
            "outages": len(own),
            "disjoint": int(span // length),
            "drift_m": _rms(own["drift_m"]),
            "sigma_m": _rms(own["sigma_m"]),
            "smoother_m": _rms(smoothed),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("length_s")


def equal_to_filter(table: pd.DataFrame, tolerance: float = 0.01) -> list[str]:
    """Return the labels of the other filters with almost the drift of the filter.

    In every outage the drifts differ by at most ``tolerance``, relative to the filter's RMS drift.
    """
    errors = table.pivot(index=["length_s", "start_s"], columns="estimator", values="drift_m")
    others = [label for label in errors if label not in (FILTER, SMOOTHER)]
    own = errors[FILTER]
    return [n for n in others if (errors[n] - own).abs().max() <= tolerance * _rms(own)]


@styled()
def drifts(table: pd.DataFrame) -> Drawing:
    """Return a figure of the filter's drift in each outage against the outage length.

    It also shows the predicted standard deviation, and the RMS drifts of filter and smoother.
    """
    figure, axes = subplots(1, 1, figsize=(6.0, 3.4))
    own, rows = table[table["estimator"] == FILTER], summary(table)
    handles = {
        "EKF, one outage": axes.scatter(own["length_s"], own["drift_m"], s=9, alpha=0.4, lw=0),
        "EKF, RMS": axes.plot(rows.index, rows["drift_m"], "o-", color="C0")[0],
        "predicted σ": axes.plot(rows.index, rows["sigma_m"], "k--", lw=1.0)[0],
        "batch smoother, RMS": axes.plot(rows.index, rows["smoother_m"], "s-", color="C1")[0],
    }
    axes.set(xlabel="length of the outage [s]", ylabel="horizontal drift [m]", ylim=(0.0, None))
    legend_below(figure, handles)
    return figure


def _rms(values: pd.Series) -> float:
    return float(np.sqrt(np.mean(np.square(values.to_numpy(float)))))


def _shown(rows: pd.DataFrame) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "outage [s]": f"{length:g}",
            "outages (disjoint outages)": f"{int(row['outages'])} ({int(row['disjoint'])})",
            "EKF [m]": significant(row["drift_m"], 2),
            "predicted σ [m]": significant(row["sigma_m"], 2),
            "batch smoother [m]": significant(row["smoother_m"], 2),
        }
        for length, row in rows.iterrows()
    )
