"""Figure of a scorecard: errors of the scored estimator and of the EKF by case."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from matplotlib.ticker import LogLocator, NullFormatter

from .style import BOUND, Drawing, styled, subplots

_LONGEST = 60
_WIDTH, _ROW, _REST = 8.0, 0.32, 1.3


@styled()
def scorecard(rows: Sequence[Mapping[str, float | str]], label: str) -> Drawing:
    """Draw RMS errors and Cramér–Rao bounds with a row for each case, on a logarithmic axis.

    Parameters
    ----------
    rows : a mapping for each case. ``title`` is the title of the case. ``scored`` and ``ekf`` are
        the RMS errors of the scored estimator and of the EKF [m]. ``bound`` is the Cramér–Rao bound
        [m]. A missing number is NaN.
    label : label of the scored estimator.
    """
    figure, axis = subplots(figsize=(_WIDTH, _REST + _ROW * len(rows)))
    places = range(len(rows))
    legend = label if len(label) <= _LONGEST else f"{label[:_LONGEST]}…"
    for key, name, style in (
        ("bound", "Cramér–Rao bound", {"marker": "|", "color": BOUND, "ms": 12}),
        ("ekf", "EKF", {"marker": "o", "color": "tab:gray", "mfc": "w"}),
        ("scored", legend, {"marker": "o", "color": "tab:orange"}),
    ):
        values = [float(row[key]) for row in rows]
        usable = [v if math.isfinite(v) and v > 0.0 else math.nan for v in values]
        axis.plot(usable, places, ls="", label=name, **style)
    axis.set_xscale("log")
    axis.set_yticks(places, [str(row["title"])[:_LONGEST] for row in rows])
    axis.set_ylim(len(rows) - 0.5, -0.5)
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_xlabel("RMS position error, settled window [m]")
    handles, names = axis.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=3)
    return figure
