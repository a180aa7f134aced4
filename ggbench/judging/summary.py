"""How good estimators are: what the judgements of many runs say together.

A run is judged once, in the worker (:mod:`.judging.run_errors`); :func:`summarize` then turns the
table of many runs into one row per case, estimator and window, and :func:`paired_table` sets the
estimators beside each other, run by run.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from . import success
from .convergence import COLUMNS as CONVERGENCE_COLUMNS
from .convergence import figures
from .run_errors import COVERAGE as COVERAGE
from .run_errors import FIGURES as FIGURES
from .run_errors import JUDGED as JUDGED
from .run_errors import WINDOWS as WINDOWS
from .run_errors import Evaluation as Evaluation
from .run_errors import evaluate as evaluate
from .run_errors import has_diverged as has_diverged
from .run_errors import window_figures as window_figures
from .run_errors import window_mask as window_mask
from .statistics import coverage_band, nees_band, nis_band, paired_all, root_mean_intervals

if TYPE_CHECKING:
    import pandas as pd

SUMMARY_COLUMNS = (
    "scenario", "case", "estimator", "parameters", "causality", "runs", "failed", "diverged",
    "position_mrse_m", "position_mrse_lo", "position_mrse_hi",
    "velocity_mrse_mps", "velocity_mrse_lo", "velocity_mrse_hi",
    "window", "position_bound_m", "velocity_bound_mps", "position_efficiency",
    "paper_position_m", "paper_velocity_mps", "nees_mean", "nees_lo", "nees_hi", "seconds_per_run",
)  # fmt: skip
EXTRA_COLUMNS = (
    "label", "velocity_efficiency", "position_without_diverged_m", "position_median_m",
    "position_p95_m", "nis_mean", "coverage", "map_evaluations",
    "velocity_median_mps", "velocity_p95_mps", "nis_lo", "nis_hi", "coverage_lo", "coverage_hi",
    *CONVERGENCE_COLUMNS, *success.COLUMNS,
)  # fmt: skip
_QUANTITIES = {"position": "m2", "velocity": "m2ps2"}
"""Judged quantities, and the unit of their squared errors."""
_OF_A_WINDOW = {f"{window}_{name}": (window, name) for window in WINDOWS for name in FIGURES}
WINDOW_COLUMNS = tuple(_OF_A_WINDOW)
"""Columns of a table of runs that hold the figures of its windows."""
NUMBERS = (
    "seconds", "map_evaluations", "peak_memory_mb", "final_position_error_m", "final_ins_error_m",
    "lock_time_s",
)  # fmt: skip
"""Columns of a table of runs that hold numbers, NaN where a record has none."""
_TRUTHS = ("diverged", "cold")
_NEEDED = (
    "case", "estimator", "name", "parameters", "causality", "run", "status", "diverged", "seconds",
    "cold", "map_evaluations", "final_position_error_m", "final_ins_error_m", "lock_time_s",
    "false_lock", *WINDOW_COLUMNS,
)  # fmt: skip
PAIRED_COLUMNS = (
    "case", "window", "first", "second", "runs", "first_only", "second_only",
    *(
        f"{quantity}_{figure}"
        for quantity, unit in _QUANTITIES.items()
        for figure in (f"difference_{unit}", "lo", "hi", "relative", "win_rate", "verdict")
    ),
    *success.PAIRED_COLUMNS,
)  # fmt: skip


def runs_table(
    records: Sequence[Mapping[str, Any]],
    columns: Iterable[str] = (),
    common: Mapping[str, Any] | None = None,
) -> pd.DataFrame:
    """Return the table of the runs that records tell of, one row each, in their order.

    Parameters
    ----------
    records : stored records.
    columns : names of the first columns; those that a summary needs besides come after them.
    common : columns that do not come from the records: a value for all or one for each.

    Returns
    -------
    Numbers that a record does not have are NaN; whether a lock is false is not known where none was
    judged.
    """
    import pandas as pd  # not at the top: workers judge runs and make no tables

    found: dict[str, Any] = {}
    # A failed run has a time, perhaps, and no figures, whatever its record says.
    finished = [record if record["status"] == "ok" else {} for record in records]
    windows = [record["windows"] if record else {} for record in finished]
    for name in dict.fromkeys([*columns, *_NEEDED]):
        if common and name in common:
            found[name] = common[name]
        elif name in _OF_A_WINDOW:
            window, figure = _OF_A_WINDOW[name]
            values = [w[window][figure] if w else math.nan for w in windows]
            found[name] = np.array(values, dtype=float)
        elif name in NUMBERS:
            source = records if name == "seconds" else finished
            found[name] = np.array([record.get(name) for record in source], dtype=float)
        elif name in _TRUTHS:
            found[name] = np.array([record.get(name) is True for record in records], dtype=bool)
        else:
            found[name] = [record.get(name) for record in records]
    false = [record.get("false_lock") for record in finished]
    found["false_lock"] = pd.array(false, dtype="boolean")
    return pd.DataFrame(found, index=range(len(records)))


def summarize(
    runs: pd.DataFrame,
    bounds: success.Bounds,
    references: Mapping[str, tuple[float, float] | None],
    scenario: str,
    readings: Mapping[str, Mapping[str, tuple[int, float]]] | None = None,
) -> pd.DataFrame:
    """Return one row per case, estimator and window, with :data:`SUMMARY_COLUMNS` and more.

    Parameters
    ----------
    runs : table of runs (:func:`runs_table`), in any order.
    bounds : of the cases and estimators (:data:`.success.Bounds`).
    references : case to published position and velocity MRSE, or None.
    scenario : name of the scenario.
    readings : case to window to (epochs, channels): its epochs with a reading in one run, and the
        mean number of channels then. Where absent, the mean NIS has no band.

    Returns
    -------
    The documented columns first, then :data:`EXTRA_COLUMNS`. Rows in the order in which cases and
    estimators first occur in ``bounds``.
    """
    runs = runs.assign(succeeded=success.succeeded(runs, bounds))
    groups = {
        (str(case), str(label)): group
        for (case, label), group in runs.groupby(["case", "estimator"], sort=False)
    }
    order = dict.fromkeys([*bounds, *groups])
    judged = set(runs.loc[runs["false_lock"].notna(), "case"])
    cells = {cell: groups[cell] for cell in order if cell in groups}
    finished = {cell: group[group["status"] == "ok"] for cell, group in cells.items()}
    intervals = _intervals(finished)
    unaided = {
        (case, window): math.sqrt(float(good[f"{window}_position_ms"].mean()))
        for (case, _), good in finished.items()
        if len(good) and good["causality"].iloc[0] == "none"
        for window in WINDOWS
    }
    rows = []
    for (case, estimator), group in cells.items():
        good = finished[case, estimator]
        reference = references.get(case)
        first = group.iloc[0]
        sizes = (readings or {}).get(case, {})
        # An estimator all of whose runs failed has not locked either.
        locking = {}
        if case in judged:
            false = int(good["false_lock"].sum())
            locking = figures(good["lock_time_s"].to_numpy(), false, len(group))
        for window in WINDOWS:
            row: dict[str, Any] = {
                "scenario": scenario,
                "case": case,
                "estimator": first["name"],
                "parameters": first["parameters"],
                "label": estimator,
                "causality": first["causality"],
                "runs": len(group),
                "failed": len(group) - len(good),
                "diverged": int(good["diverged"].sum()),
                "window": window,
                "paper_position_m": reference[0] if reference else math.nan,
                "paper_velocity_mps": reference[1] if reference else math.nan,
            }
            bound = bounds.get((case, estimator), {}).get(window)
            row |= _window_row(good, window, bound, sizes.get(window, (0, 0))) | locking
            row |= intervals.get((case, estimator, window), {})
            row |= success.figures(
                group[f"{window}_position_ms"].to_numpy(dtype=float),
                group[f"{window}_nees"].to_numpy(dtype=float),
                group["succeeded"].to_numpy(dtype=bool),
                bound[0] if bound else math.nan,
                unaided.get((case, window), math.nan),
            )
            rows.append(row)
    import pandas as pd

    return pd.DataFrame(rows).reindex(columns=[*SUMMARY_COLUMNS, *EXTRA_COLUMNS])


def _intervals(
    finished: Mapping[tuple[str, str], pd.DataFrame],
) -> dict[tuple[str, str, str], dict[str, float]]:
    """Return the ends of the MRSE's intervals of every case, estimator and window.

    All at once: cells with equal numbers of runs share their bootstrap samples.
    """
    names = [(*cell, window) for cell, good in finished.items() if len(good) for window in WINDOWS]
    squares = [
        finished[case, label][f"{window}_{quantity}_ms"].to_numpy()
        for case, label, window in names
        for quantity in _QUANTITIES
    ]
    ends = iter(root_mean_intervals(squares))
    return {
        name: {
            f"{quantity}_mrse_{end}": value
            for quantity in _QUANTITIES
            for end, value in zip(("lo", "hi"), next(ends), strict=True)
        }
        for name in names
    }


def _window_row(
    good: pd.DataFrame,
    window: str,
    bound: tuple[float, float] | None,
    readings: tuple[int, float],
) -> dict[str, Any]:
    """Return the figures of one window over the runs that finished."""
    if good.empty:
        return {}

    def column(key: str) -> np.ndarray:
        return good[f"{window}_{key}"].to_numpy()

    position, velocity = column("position_ms"), column("velocity_ms")
    position_mrse, velocity_mrse = (math.sqrt(float(np.mean(p))) for p in (position, velocity))
    position_bound, velocity_bound = bound or (math.nan, math.nan)
    kept = position[~good["diverged"].to_numpy()]
    nees_lo, nees_hi = nees_band(len(good), JUDGED)
    coverage_lo, coverage_hi = coverage_band(len(good), COVERAGE)
    innovations = column("nis")
    present = innovations[~np.isnan(innovations)]  # a run may have no reading in the window
    nis = float(present.mean()) if len(present) else math.nan
    # Only a filter has innovations: without a mean there is no band.
    nis_lo, nis_hi = nis_band(0 if math.isnan(nis) else len(good), *readings)
    return {
        "position_mrse_m": position_mrse,
        "velocity_mrse_mps": velocity_mrse,
        "position_bound_m": position_bound,
        "velocity_bound_mps": velocity_bound,
        "position_efficiency": position_mrse / position_bound,
        "nees_mean": float(column("nees").mean()),
        "nees_lo": nees_lo,
        "nees_hi": nees_hi,
        "seconds_per_run": _median_seconds(good),
        "velocity_efficiency": velocity_mrse / velocity_bound,
        "position_without_diverged_m": math.sqrt(kept.mean()) if len(kept) else math.nan,
        "position_median_m": float(np.median(np.sqrt(position))),
        "position_p95_m": float(np.percentile(np.sqrt(position), 95)),
        "nis_mean": nis,
        "coverage": float(column("coverage").mean()),
        "map_evaluations": float(good["map_evaluations"].mean()),
        "velocity_median_mps": float(np.median(np.sqrt(velocity))),
        "velocity_p95_mps": float(np.percentile(np.sqrt(velocity), 95)),
        "nis_lo": nis_lo,
        "nis_hi": nis_hi,
        "coverage_lo": coverage_lo,
        "coverage_hi": coverage_hi,
    }


def _median_seconds(good: pd.DataFrame) -> float:
    """Return the median time of a run; the first of a process compiles, and counts if alone."""
    seconds, warm = good["seconds"].to_numpy(), ~good["cold"].to_numpy()
    return float(np.median(seconds[warm] if warm.any() else seconds))


def paired_table(runs: pd.DataFrame, bounds: success.Bounds) -> pd.DataFrame:
    """Return every two estimators of a case beside each other, on the runs that both were given.

    Parameters
    ----------
    runs : table of runs, one row per run and estimator; those of assumptions are left out.
    bounds : of the cases and estimators, by which success is judged.

    Returns
    -------
    One row per case, window and pair of estimators, all in order of first appearance, with
    :data:`PAIRED_COLUMNS`: ``runs`` both finished, ``first_only`` and ``second_only`` one of them;
    then for position and velocity the figures of :func:`.statistics.paired`, of the first
    against the second. Differences are over the runs that both finished; in the win rate a run that
    failed loses against one that finished, and one that both failed does not count. A verdict on
    squared errors is wrong in 5 % of the pairs that do not differ. Last come the figures of
    :func:`.success.compared`: who succeeds more often, and is nearer where both do.
    """
    cases = runs[runs["assumption"] == ""]
    cases = cases.assign(given=True, succeeded=success.succeeded(cases, bounds))
    rows: list[dict[str, Any]] = []
    pairs: list[tuple[np.ndarray, np.ndarray]] = []
    judged: list[tuple[np.ndarray, ...]] = []
    errors = [f"{window}_{quantity}_ms" for window in WINDOWS for quantity in _QUANTITIES]
    for case, group in cases.groupby("case", sort=False):
        labels = list(dict.fromkeys(group["estimator"]))
        wide = group.pivot(index=["seed", "run"], columns="estimator")
        given, good = (wide[name].eq(True) for name in ("given", "succeeded"))
        found = {name: wide[name].astype(float) for name in errors}
        finished = np.logical_and.reduce([np.isfinite(found[name]) for name in errors])
        places = {label: given.columns.get_loc(label) for label in labels}
        for first, second in itertools.combinations(labels, 2):
            one, two = places[first], places[second]
            # Runs that both were given; of these, that both finished.
            common = (given[first] & given[second]).to_numpy()
            both = common & finished[:, one] & finished[:, two]
            counts = {
                "case": case,
                "first": first,
                "second": second,
                "runs": int(both.sum()),
                "first_only": int((common & finished[:, one] & ~both).sum()),
                "second_only": int((common & finished[:, two] & ~both).sum()),
            }
            rows += [counts | {"window": window} for window in WINDOWS]
            pairs += [
                (found[name][first].to_numpy()[both], found[name][second].to_numpy()[both])
                for name in errors
            ]
            judged += [
                tuple(
                    table[label].to_numpy()[common]
                    for label in (first, second)
                    for table in (found[f"{window}_position_ms"], good)
                )
                for window in WINDOWS
            ]
    for row, said in zip(rows, success.compared(judged), strict=True):
        row |= said
    paired = iter(paired_all(pairs))
    for row, (quantity, unit) in itertools.product(rows, _QUANTITIES.items()):
        pair = next(paired)
        decided = row["runs"] + row["first_only"] + row["second_only"]
        wins = row["first_only"] + (pair.win_rate * pair.runs if pair.runs else 0.0)
        row |= {
            f"{quantity}_difference_{unit}": pair.difference,
            f"{quantity}_lo": pair.lo,
            f"{quantity}_hi": pair.hi,
            f"{quantity}_relative": pair.relative,
            f"{quantity}_win_rate": wins / decided if decided else math.nan,
            f"{quantity}_verdict": pair.verdict,
        }
    import pandas as pd

    return pd.DataFrame(rows, columns=PAIRED_COLUMNS)
