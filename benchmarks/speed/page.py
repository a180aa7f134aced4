"""Page reports/speed.md, from the tables in reports/speed/."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ggbench.errors import GGBenchError
from ggbench.figures.numbers import short
from ggbench.figures.style import Drawing, legend_below, save, styled, subplots
from ggbench.report import page_templates

FOLDER = "speed"
TABLES = ("implementations", "rounds", "estimators", "streams", "machine")
LABELS = {"ekf": "ekf", "ukf": "ukf", "batch": "factor-graph[mode=batch]"}
"""Compiled engine of each family."""
TEXT = {"not_timed_because": object}
"""Types of text columns, also for columns without text."""
COMPILED = {1: "ggbench, one thread", 2: "ggbench, two threads"}
REFERENCE = "ggbench on frameworks"
TITLES = {"ekf": "EKF", "ukf": "UKF", "batch": "batch smoother"}
SHOWN = (
    "ekf",
    "ukf",
    "gaussian-sum",
    "factor-graph",
    "factor-graph[mode=fixed-lag]",
    "factor-graph[mode=batch]",
    "gauss-newton",
    "particle",
)
"""Estimators on the page; estimators.csv contains all estimators."""
DIFFERENCE = "largest_difference_prior_sd"


def write(output: Path) -> Path:
    """Write ``speed.md`` and its figure from the tables; return the path of the page."""
    tables = read(output / FOLDER)
    save(figure(tables["rounds"]), output / FOLDER / "answer.png")
    path = output / "speed.md"
    path.write_text(page(tables), encoding="utf-8")
    return path


def read(folder: Path) -> dict[str, pd.DataFrame]:
    """Return the tables of a folder by name.

    Raises
    ------
    GGBenchError
        If a table is missing.
    """
    try:
        return {name: pd.read_csv(folder / f"{name}.csv", dtype=TEXT) for name in TABLES}
    except OSError as error:
        raise GGBenchError(f"{error.filename} cannot be read; make bench writes it") from None


def page(tables: dict[str, pd.DataFrame]) -> str:
    """Return the text of the page.

    Raises
    ------
    GGBenchError
        If an implementation in the answer was not timed.
    """
    measured, estimators = tables["implementations"], tables["estimators"]
    return page_templates.markdown(
        "speed.md.j2",
        Path(__file__).parent,
        engines=_engines(tables["rounds"]),
        differences=_differences(measured),
        implementations=_by_family(tables["rounds"], measured),
        estimators=_of_estimators(estimators),
        flights=list(estimators["flight"].unique()),
        stream=_stream(tables["streams"]),
        refused=measured[measured["not_timed_because"].notna()].to_dict("records"),
        reference=REFERENCE,
        machine=dict(tables["machine"].to_numpy()),
    )


def _best(rounds: pd.DataFrame) -> pd.DataFrame:
    """Return the best processor time [ms] by implementation (rows) and family (columns)."""
    best = rounds.groupby(["implementation", "family"])["processor_ms_per_run"].min().unstack()
    return best.reindex(columns=list(LABELS)).drop(COMPILED[2], errors="ignore")


def _ratios(rounds: pd.DataFrame, column: str = "processor_ms_per_run") -> pd.DataFrame:
    """Return the time of each implementation relative to the engine, as the median over rounds."""
    times = rounds.pivot(index=["family", "round"], columns="implementation", values=column)
    return times.div(times[COMPILED[1]], axis=0).groupby("family").median().T


def _engines(rounds: pd.DataFrame) -> dict[str, dict[str, str]]:
    """Return time, ratio to the other package and speed-up by threads of each family's engine."""
    best, ratios, wall = _best(rounds), _ratios(rounds), _ratios(rounds, "wall_ms_per_run")
    found = {}
    for family, rival in {"ekf": "filterpy", "ukf": "filterpy", "batch": "gtsam"}.items():
        if {rival, *COMPILED.values()} - set(ratios[family].dropna().index):
            raise GGBenchError(f"no page: {rival} or {LABELS[family]} was not timed ({family})")
        values = {
            "ms": best.loc[COMPILED[1], family],
            "times": ratios.loc[rival, family],
            "two": 1.0 / wall.loc[COMPILED[2], family],
            "free": 2.0 / ratios.loc[COMPILED[2], family],
        }
        found[family] = {name: short(value) for name, value in values.items()}
    return found


def _differences(measured: pd.DataFrame) -> dict[str, str]:
    """Return the largest difference of the timed filters, and of the timed batch smoothers."""
    timed = measured[measured["not_timed_because"].isna()]
    batch = timed["family"] == "batch"
    return {
        name: f"{rows[DIFFERENCE].max():.0e}"
        for name, rows in (("filters", timed[~batch]), ("batch", timed[batch]))
    }


def _by_family(rounds: pd.DataFrame, measured: pd.DataFrame) -> pd.DataFrame:
    """Return ms/run of each implementation on one thread, and the ratio to the engine."""
    times, ratios = _best(rounds), _ratios(rounds)
    largest = measured.groupby("implementation")[DIFFERENCE].max()
    table = pd.DataFrame({"implementation": times.index}, index=times.index)
    for family, title in TITLES.items():
        cells = zip(times[family], ratios.loc[times.index, family], strict=True)
        table[f"{title} [ms/run] (× ggbench)"] = [
            "–" if np.isnan(time) else f"{short(time)} (×{short(ratio)})" for time, ratio in cells
        ]
    table["largest difference to reference [prior σ]"] = [
        "reference" if name == REFERENCE else f"{largest[name]:.0e}" for name in times.index
    ]
    order = times.min(axis=1).sort_values().index
    return table.loc[order]


def _of_estimators(estimators: pd.DataFrame) -> pd.DataFrame:
    """Return ms/run of the estimators on the page, and the time ratio of their references."""
    rows = []
    for label in SHOWN:
        row = {"estimator": f"`{label}`"}
        for flight in estimators["flight"].unique():
            own = estimators[
                (estimators["estimator"] == label) & (estimators["flight"] == flight)
            ].set_index("engine")
            row |= dict(zip(_heads(flight), _cells(own), strict=True))
        rows.append(row)
    return pd.DataFrame(rows)


def _heads(flight: str) -> list[str]:
    name = flight.partition(",")[0]
    return [f"{name} [ms/run]", f"{name}: time ratio", f"{name}: difference [prior σ]"]


def _cells(own: pd.DataFrame) -> list[str]:
    """Return time, ratio to the reference and difference of one estimator on one flight."""
    times = own["processor_ms_per_run"]
    if "only" in own.index:
        return ["–" if np.isnan(times["only"]) else short(times["only"]), "–", "–"]
    ratio = times["reference"] / times["compiled"]
    difference = own.loc["compiled", DIFFERENCE]
    return [short(times["compiled"]), f"×{short(ratio)}", f"{difference:.0e}"]


def _stream(streams: pd.DataFrame) -> dict[str, Any]:
    """Return time, speed-up by threads, largest number of runs and memory of the streams."""
    by = streams.groupby(["threads", "runs"])
    busy, wall = by["processor_ms_per_run"].sum(), by["stream_wall_ms_per_run"].first()
    common = wall[1].index[0]
    return {
        "one": short(busy[1, common]),
        "two": short(wall[1, common] / wall[2, common]),
        "most": wall[2].index.max(),
        "memory": f"{streams['peak_memory_mb'].max():.0f}",
    }


@styled()
def figure(rounds: pd.DataFrame) -> Drawing:
    """Return a figure of the times of all implementations on one thread, by family."""
    times = _best(rounds)
    times = times.loc[times.min(axis=1).sort_values(ascending=False).index]
    drawing, axes = subplots(figsize=(7.2, 3.0))
    places = np.arange(len(times))
    handles = {
        title: axes.plot(times[family], places, marker, ms=7)[0]
        for (family, title), marker in zip(TITLES.items(), "os^", strict=True)
    }
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_yticks(places, times.index)
    axes.set_xlabel("processor time of a run of 200 epochs [ms], one thread")
    legend_below(drawing, handles)
    return drawing
