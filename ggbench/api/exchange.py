"""Export of problems to files, and evaluation of estimates from files."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..block import ProblemBlock, joined
from ..campaign import flights, result_keys
from ..exchange import containers, estimate_files, problem_files
from ..exchange.containers import ExchangeError
from ..exchange.estimate_files import JUDGED, StoredRuns
from ..spec.case import CaseSpec
from ..spec.scenario import Scenario
from .problems import load
from .results import Results
from .running import run

_SAME = 1e-6
"""Allowed difference [σ] of a filter's estimates with and without later measurements."""
_BETTER = 0.2
"""Ratio of RMS errors below which another sign, frame or unit of the estimates is reported."""


def export(
    scenario: Scenario | str | Path,
    folder: Path | str,
    *,
    cases: Sequence[str] = (),
    runs: int = 20,
    seed: int | None = None,
    file_format: str = "mat",
    until_s: float | None = None,
) -> list[Path]:
    """Write the problems of a scenario's runs as files, and return their paths.

    One file is written per case, or per map if the runs of a case draw several maps. No file
    contains the truth.

    Parameters
    ----------
    scenario : a scenario, its name or the path of its file.
    folder : output folder of the files ``CASE.FORMAT``.
    cases : names of the cases; by default all.
    runs : number of runs, from run 0 on.
    seed : seed of the random numbers; by default the scenario's.
    file_format : ``mat`` (MATLAB 5), ``nc`` (netCDF-4) or ``txt`` (plain text).
    until_s : time [s] after which all epochs are omitted. Estimates from such a file show whether a
        filter uses later measurements (``cut`` of :func:`judge_estimates`).

    Raises
    ------
    GGBenchError
        If a name does not exist, a case cannot be flown, or a file cannot be written.
    """
    loaded = scenario if isinstance(scenario, Scenario) else load(scenario)
    if f".{file_format}" not in containers.SUFFIXES:
        formats = ", ".join(suffix[1:] for suffix in containers.SUFFIXES)
        raise ExchangeError(f"the format is '{file_format}' and must be one of {formats}")
    chosen = seed if seed is not None else loaded.campaign.seed
    written = []
    for case in (loaded.select(list(cases)) if cases else loaded).cases:
        for name, numbers, block in _blocks(case, chosen, runs):
            if until_s is not None:
                stop = int(np.searchsorted(block.times, until_s, side="right"))
                if not 0 < stop < block.epochs:
                    raise ExchangeError(
                        f"until is {until_s:g} s and must lie between the epochs of {case.name}, "
                        f"{block.times[0]:g} to {block.times[-1]:g} s"
                    )
                block = block.until(stop)
            path = Path(folder) / f"{name}.{file_format}"
            problem_files.write(path, block, _identity(loaded, case, chosen, numbers, block))
            written.append(path)
    return written


def _identity(
    loaded: Scenario, case: CaseSpec, seed: int, numbers: Sequence[int], block: ProblemBlock
) -> str:
    facts = {
        "scenario": loaded.argument or loaded.name,
        "case": case.name,
        "seed": seed,
        "runs": list(numbers),
        "key": result_keys.problem_key(case, seed),
        "states": block.dimension,
        "times": block.times.tolist(),
    }
    return problem_files.identity(facts, block)


def _blocks(
    case: CaseSpec, seed: int, runs: int
) -> Iterator[tuple[str, Sequence[int], ProblemBlock]]:
    """Yield the name, run indices and block of each file of a case."""
    maps = min(case.draw.maps, runs)
    for number in range(maps):
        own = range(number, runs, case.draw.maps)
        groups = list(flights.groups_of_runs(case, own))
        block = joined([flights.simulated(case, seed, group).block for group in groups])
        numbers = [run for group in groups for run in group]
        yield case.name if maps == 1 else f"{case.name}-map{number}", numbers, block


def judge_estimates(
    estimates: Path | str,
    *,
    scenario: Scenario | str | Path | None = None,
    cut: Path | str | None = None,
    output: Path | str | None = None,
    **options: Any,
) -> Results:
    """Judge a file or a folder of estimates; return the results as those of a campaign.

    The truth is simulated again from the scenario and the seed that the files state.

    Parameters
    ----------
    estimates : path of the file or folder.
    scenario : a scenario, its name or path; by default the scenario that the files state.
    cut : path of the same filter's estimates on problems exported with ``until_s``; they test
        whether the filter uses later measurements.
    output : folder of the results, as in :func:`.running.run`.
    options : further arguments of :func:`.running.run`.

    Raises
    ------
    GGBenchError
        If a file is invalid, its scenario has changed since the export, or ``cut`` shows that a
        filter uses later measurements.
    """
    stored = estimate_files.stored_runs(Path(estimates))
    first = stored[0].problem
    for one in stored:
        if (one.problem["scenario"], one.problem["seed"]) != (first["scenario"], first["seed"]):
            raise ExchangeError(
                f"{estimates} holds estimates of {stored[0]} and of {one}; all must have the same "
                "scenario and the same seed"
            )
    loaded = load(first["scenario"]) if scenario is None else scenario
    loaded = loaded if isinstance(loaded, Scenario) else load(loaded)
    names = list(dict.fromkeys(one.problem["case"] for one in stored))
    selected = loaded.select(names)
    for case in selected.cases:
        key = result_keys.problem_key(case, first["seed"])
        if any(one.problem["key"] != key for one in stored if one.problem["case"] == case.name):
            raise ExchangeError(
                f"case {case.name} of {loaded.name} differs from the problem of {estimates}: the "
                "case or the version of ggbench has changed; export the problem again"
            )
    if cut is not None:
        require_causal(stored, estimate_files.stored_runs(Path(cut)))
    counts = {name: _runs_of(stored, name) for name in names}
    shortest = min(counts.values())
    return run(
        loaded,
        [str(estimates)],
        shortest,
        seed=first["seed"],
        cases=names,
        output=output,
        **options,
    )


def _runs_of(stored: Sequence[StoredRuns], case: str) -> int:
    """Return the number of runs, consecutive from run 0, with estimates of a case."""
    numbers = {n for one in stored if one.problem["case"] == case for n in one.problem["runs"]}
    missing = next(n for n in range(len(numbers) + 1) if n not in numbers)
    if missing == 0:
        raise ExchangeError(f"the estimates of case {case} lack run 0")
    return missing


def require_causal(stored: Sequence[StoredRuns], cut: Sequence[StoredRuns]) -> None:
    """Raise ExchangeError if estimates change when later measurements are omitted.

    The error is also raised if ``stored`` has batch estimates, or no run is in both arguments.

    Parameters
    ----------
    stored : estimates of the same filter on the complete problems.
    cut : estimates of the same filter on the problems exported with ``until_s``.
    """
    if any(whole.causality == "batch" for whole in stored):
        raise ExchangeError(
            "'batch' estimates may use all measurements and are not tested with cut estimates: "
            "remove --cut (cut=...)"
        )
    compared = False
    for whole, part, number in _common_runs(stored, cut):
        last = part.times[-1] - (whole.lag or 0.0)
        common = np.flatnonzero(whole.times[: len(part.times)] <= last)
        if not len(common):
            continue
        compared = True
        own, row = (one.problem["runs"].index(number) for one in (whole, part))
        sigma = np.sqrt(np.diagonal(whole.cov[own][common], axis1=1, axis2=2))
        off = (np.abs(part.mean[row][common] - whole.mean[own][common]) / sigma).max(axis=1)
        if off.max() > _SAME:
            first = whole.times[int((off > _SAME).argmax())]
            raise ExchangeError(
                f"the estimates of {whole.problem['case']}, run {number}, are declared "
                f"'{whole.causality}' but use later measurements: without the measurements after "
                f"{part.times[-1]:g} s they differ by {off.max():.2g} standard deviations, first "
                f"at {first:g} s"
            )
    if not compared:
        raise ExchangeError(
            "the complete and the cut estimates have no common run with common epochs: export "
            "both problems by the same version with the same case and seed, and with --until "
            "later than the lag"
        )


def _common_runs(
    stored: Sequence[StoredRuns], cut: Sequence[StoredRuns]
) -> Iterator[tuple[StoredRuns, StoredRuns, int]]:
    """Yield the complete estimates, the cut estimates and the index of each common run."""
    for whole, part in itertools.product(stored, cut):
        if all(whole.problem[name] == part.problem[name] for name in ("key", "seed")):
            for number in part.problem["runs"]:
                if number in whole.problem["runs"]:
                    yield whole, part, number


def misreadings(estimates: Path | str, results: Results) -> list[str]:
    """Return remarks on estimates that fit the truth better with another sign, frame or unit.

    Parameters
    ----------
    estimates : path of the judged file or folder.
    results : results of :func:`judge_estimates` for these estimates.

    Returns
    -------
    A sentence for each file with a probable misreading. The numbers are also read with opposite
    sign, as north-east-down with either sign, and in kilometres. A misreading is probable if one of
    these readings reduces the RMS position error to less than a fifth.
    """
    sentences = []
    for one in estimate_files.stored_runs(Path(estimates)):
        case = results.scenario.case(one.problem["case"])
        numbers = one.problem["runs"][: flights.BLOCK_RUNS]
        for group in flights.groups_of_runs(case, numbers):
            with flights.simulated(case, one.problem["seed"], group).truth.looked_at() as truth:
                true = np.array(truth)[:, :, :JUDGED]
            rows = [one.problem["runs"].index(number) for number in group]
            mean = one.mean[rows][:, :, :JUDGED]
            ned = mean[:, :, [1, 0, 2, 4, 3, 5]] * np.array([1, 1, -1, 1, 1, -1])
            readings = {
                "with opposite sign (the error of the INS is INS − truth)": -mean,
                "as north, east, down": ned,
                "as north, east, down with opposite sign": -ned,
                "in km and km/s": 1e3 * mean,
            }
            errors = {name: _rms(true - other) for name, other in readings.items()}
            best = min(errors, key=lambda name: errors[name])
            if errors[best] < _BETTER * _rms(true - mean):
                sentences.append(
                    f"the RMS position error of {one.problem['case']} is "
                    f"{_rms(true - mean):.3g} m, but {errors[best]:.3g} m if the estimates are "
                    f"interpreted {best}: check sign, axes and units"
                )
            break
    return sentences


def _rms(errors: np.ndarray) -> float:
    """Return the RMS position error [m] in the second half of the epochs of errors (R, K, 6)."""
    half = errors[:, errors.shape[1] // 2 :, :3]
    return float(np.sqrt((half**2).sum(axis=2).mean()))
