"""Page of the comparison of frameworks and its figure, from the table of results."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from ggbench.errors import GGBenchError
from ggbench.figures.numbers import short
from ggbench.figures.style import Drawing, save, styled, subplots
from ggbench.report import page_templates

from .packages import FRAMEWORKS, OTHERS

FOLDER, TABLE = "frameworks", "frameworks.csv"
SAME, ENDED = 1e-6, 1e-4
"""Largest differences [prior σ] of equal results, for filters and for searches.

A search stops before the exact minimum, at a negligible step."""
SEARCHES = tuple(row.label for row in FRAMEWORKS if "mode=batch" in row.reference)
"""Estimators that search for the most probable trajectory."""
COLUMNS = (
    "package",
    "estimator",
    "difference [prior σ]",
    "contract",
    "ms/run",
    "first run [ms]",
    "memory [MB]",
    "adapter [lines]",
)
"""Columns on the page; the CSV table has all columns."""


def write(output: Path) -> Path:
    """Write ``frameworks.md`` and its figure from the table; return the path of the page.

    Raises
    ------
    GGBenchError
        If the table is missing.
    """
    measured = read(output / FOLDER)
    save(figure(measured), output / FOLDER / "answer.png")
    path = output / "frameworks.md"
    path.write_text(page(measured), encoding="utf-8")
    return path


def read(folder: Path) -> pd.DataFrame:
    """Return the table in a folder, one row per estimator.

    Raises
    ------
    GGBenchError
        If the table is missing.
    """
    try:
        return pd.read_csv(folder / TABLE)
    except OSError as error:
        raise GGBenchError(f"{error.filename} cannot be read; make frameworks writes it") from None


def page(measured: pd.DataFrame) -> str:
    """Return the text of the page; its table has the first estimator of each package."""
    difference, batch = measured["difference [prior σ]"], measured["estimator"].isin(SEARCHES)
    same = difference <= np.where(batch, ENDED, SAME)
    first = measured.drop_duplicates("package")
    cells = first.assign(
        **{
            "estimator": [f"`{label}`" for label in first["estimator"]],
            "difference [prior σ]": [f"{d:.0e}" for d in first["difference [prior σ]"]],
            "adapter [lines]": [str(lines) for lines in first["adapter [lines]"]],
            **{
                name: [short(value) for value in first[name]]
                for name in ("ms/run", "first run [ms]", "memory [MB]")
            },
        }
    )
    kalman = measured[measured["estimator"].str.endswith("-ekf")].sort_values("ms/run")
    return page_templates.markdown(
        "frameworks.md.j2",
        Path(__file__).parent,
        packages=len(first),
        same=int(same.sum()),
        rows=len(measured),
        limit=f"{SAME:.0e}",
        searches=f"{difference[batch].max():.0e}",
        apart=measured[~same].to_dict("records"),
        fastest=kalman.iloc[0],
        slowest=kalman.iloc[-1],
        failing=measured[~measured["contract"].str.startswith("9 of 9")].to_dict("records"),
        measured=cells[list(COLUMNS)],
        silent=sorted(measured.loc[measured["NaN measured"].str.contains("silent"), "estimator"]),
        others=OTHERS,
    )


@styled()
def figure(measured: pd.DataFrame) -> Drawing:
    """Return a figure of the times of the first and of later runs, by estimator."""
    rows = measured.sort_values("ms/run", ascending=False)
    drawing, axes = subplots(figsize=(7.2, 3.6))
    places = np.arange(len(rows))
    axes.plot(rows["ms/run"], places, "o", ms=7, label="later runs (median)")
    axes.plot(rows["first run [ms]"], places, "|", ms=11, mew=2, label="first run of a process")
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_yticks(places, rows["estimator"])
    axes.set_xlabel("processor time of a run of 200 epochs [ms]")
    axes.legend(loc="lower left")
    return drawing
