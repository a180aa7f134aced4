"""Judging: numbers worked out by hand, and statistics that keep their promises."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from problems import LinearModel, changed, exact, kalman, linear_problem
from scipy.stats import chi2

from ggbench.judging import statistics
from ggbench.judging.bounds import bound_for, squared_bounds
from ggbench.judging.run_errors import (
    WINDOWS,
    Evaluation,
    evaluate,
    has_diverged,
    window_figures,
    window_mask,
)
from ggbench.judging.summary import (
    SUMMARY_COLUMNS,
    runs_table,
    summarize,
)
from ggbench.problem import Estimate, Problem, StateBlock
from ggbench.simulation.bound import posterior_bound
from ggbench.simulation.runs import Truth
from ggbench.spec.case import WindowsSpec

LIMITS = WindowsSpec(settled_from_s=3.0, last_s=2.0)


def judged(errors: np.ndarray, cov: np.ndarray | None) -> Evaluation:
    """The judgement of an estimate with given errors (K, 6)."""
    epochs, n = errors.shape
    zero = np.zeros((epochs, n, n))
    problem = Problem(
        np.arange(1.0, epochs + 1.0), np.zeros((epochs, 1)), np.eye(1), zero + np.eye(n), zero,
        np.zeros(n), np.eye(n), LinearModel(np.zeros((epochs, 1, n))), (),
    )  # fmt: skip
    truth = Truth(problem.times, np.full((epochs, n), 7.0))
    return evaluate(problem, Estimate(7.0 - errors, cov, "batch"), truth)


def test_windows_are_those_of_the_clock():
    """The whole flight; from a time on, that time included; the last seconds, their start not."""
    times = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    expected = {
        "whole": [True] * 5,
        "settled": [False, False, True, True, True],
        "last20": [False, False, False, True, True],
    }
    assert set(expected) == set(WINDOWS)
    for name, mask in expected.items():
        assert window_mask(times, LIMITS, name).tolist() == mask
    # At 10 Hz times are not exact: 0.1 · 30 is more than 3, 0.1 · 29 less than 3 in binary.
    fine = 0.1 * np.arange(1, 51)
    assert window_mask(fine, LIMITS, "settled").sum() == 21
    assert window_mask(fine, LIMITS, "last20").sum() == 20


def test_errors_on_hand_numbers():
    """A spherical error is a norm over ENU, a window's figure the mean of squares, NEES eᵀP⁻¹e."""
    errors = np.zeros((5, 6))
    errors[:, :3] = [[0, 0, 0], [2, 0, 0], [2, 3, 6], [0, 3, 4], [1, 2, 2]]
    errors[:, 3:] = 0.1 * errors[:, :3]
    evaluation = judged(errors, np.tile(np.diag([4.0] * 3 + [0.04] * 3), (5, 1, 1)))
    assert evaluation.position_error.tolist() == pytest.approx([0, 2, 7, 5, 3])
    assert evaluation.velocity_error.tolist() == pytest.approx([0, 0.2, 0.7, 0.5, 0.3])
    assert evaluation.nees.tolist() == pytest.approx([0, 2, 24.5, 12.5, 4.5])
    assert evaluation.components == pytest.approx(errors)
    assert evaluation.sigmas == pytest.approx(np.tile([2.0] * 3 + [0.2] * 3, (5, 1)))
    figures = window_figures(evaluation, np.arange(1.0, 6.0), LIMITS)
    assert figures["whole"]["position_ms"] == pytest.approx(87 / 5)
    assert figures["settled"]["position_ms"] == pytest.approx(83 / 3)
    assert figures["last20"]["velocity_ms"] == pytest.approx(0.17)
    assert figures["settled"]["nees"] == pytest.approx(41.5 / 3)
    # χ² of six leaves 12.59 with 95 %: only the error of 7 m lies outside.
    assert figures["whole"]["coverage"] == pytest.approx(4 / 5)


def test_an_estimate_without_covariance_has_no_consistency():
    """Without P there are errors and no NEES: not a number, rather than a good one."""
    evaluation = judged(np.ones((5, 6)), None)
    figures = window_figures(evaluation, np.arange(1.0, 6.0), LIMITS)
    assert figures["whole"]["position_ms"] == pytest.approx(3.0)
    assert math.isnan(figures["whole"]["nees"])
    assert math.isnan(figures["whole"]["nis"])
    assert math.isnan(figures["whole"]["coverage"])


@pytest.mark.parametrize(
    ("final", "bound", "ins", "diverged"),
    [
        (9.0, 1.0, 5.0, False),
        (11.0, 1.0, 5.0, True),
        (11.0, 1.0, 20.0, False),
        (21.0, 1.0, 20.0, True),
        (10.0, 1.0, 5.0, False),
        (math.inf, 1.0, 20.0, True),
        (20.0 + 4e-15, 1.0, 20.0, False),  # the INS itself, summed up in another order
    ],
)
def test_divergence_is_worse_than_ten_bounds_and_than_no_aiding(final, bound, ins, diverged):
    """A run diverges when it ends beyond both limits, and not by one of them."""
    assert has_diverged(final, bound, ins) is diverged


def ten_states(seed: int) -> Problem:
    """Two independent five-state problems side by side: six states to be judged, and more."""
    first, second = linear_problem(seed), linear_problem(seed + 1000)

    def beside(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        out = np.zeros((*a.shape[:-2], a.shape[-2] + b.shape[-2], a.shape[-1] + b.shape[-1]))
        out[..., : a.shape[-2], : a.shape[-1]] = a
        out[..., a.shape[-2] :, a.shape[-1] :] = b
        return out

    return Problem(
        times=first.times,
        measurements=np.hstack([first.measurements, second.measurements]),
        noise_cov=beside(first.noise_cov, second.noise_cov),
        transition=beside(first.transition, second.transition),
        process_cov=beside(first.process_cov, second.process_cov),
        prior_mean=np.concatenate([first.prior_mean, second.prior_mean]),
        prior_cov=beside(first.prior_cov, second.prior_cov),
        model=LinearModel(beside(first.model.rows, second.model.rows)),
        layout=(StateBlock("all", slice(0, 10), "mixed"),),
    )


def test_nis_of_a_right_filter_and_of_wrong_ones():
    """The mean NIS of a Kalman filter is the number of components; of an overconfident one more.

    50 problems of 40 epochs and 4 components: 8000 degrees of freedom, a band of 4 ± 0.21 at a
    false-alarm rate of 1e-3. Other causalities have no innovations.
    """
    totals = {"right": 0.0, "overconfident": 0.0}
    count = 0
    for seed in range(50):
        problem = ten_states(seed)
        truth = Truth(problem.times, np.zeros((problem.epochs, 10)))
        mean, cov, _, _ = kalman(problem)
        for kind, claimed in (("right", cov), ("overconfident", 0.2 * cov)):
            nis = evaluate(problem, Estimate(mean, claimed, "filter"), truth).nis
            totals[kind] += nis.sum()
        count += problem.epochs
        nothing = evaluate(problem, Estimate(mean, cov, "batch"), truth).nis
        assert np.isnan(nothing).all()
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 4 * count) / count
    assert low < totals["right"] / count < high
    assert totals["overconfident"] / count > high


def test_a_missing_reading_has_no_innovation():
    """Where h and H are zero and nothing was read; the mean is of the epochs that have one."""
    problem = ten_states(3)
    rows = problem.model.rows.copy()
    rows[10:30] = 0.0
    there = np.ones(problem.epochs, dtype=bool)
    there[10:30] = False
    gapped = changed(
        problem,
        model=LinearModel(rows),
        measurements=problem.measurements * there[:, None],
        present=np.tile(there[:, None], (1, problem.measurements.shape[1])),
    )
    mean, cov, _, _ = kalman(gapped)
    truth = Truth(gapped.times, np.zeros((gapped.epochs, 10)))
    evaluation = evaluate(gapped, Estimate(mean, cov, "filter"), truth)
    assert np.isnan(evaluation.nis).tolist() == (~there).tolist()
    figures = window_figures(evaluation, gapped.times, LIMITS)
    assert figures["whole"]["nis"] == pytest.approx(evaluation.nis[there].mean())


@pytest.mark.parametrize(
    ("causality", "lag"), [("filter", None), ("fixed-lag", 3), ("batch", None)]
)
def test_the_bound_goes_with_the_causality(causality, lag):
    """Each causality is set beside the covariance that an exact estimator of its kind has.

    On a linear problem the bound is the exact posterior covariance: of the filter, of each
    fixed-lag window, of the smoother.
    """
    problem = linear_problem(seed=8)
    rows = problem.model.rows
    bound = posterior_bound(
        problem.transition, problem.process_cov, problem.prior_cov, rows, problem.noise_cov
    )
    _, cov = exact(problem, Estimate(None, None, causality, None if lag is None else float(lag)))
    sigma = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    difference = bound_for(bound, causality, lag) - cov
    assert np.abs(difference / (sigma[:, :, None] * sigma[:, None, :])).max() < 1e-9
    assert np.array_equal(bound_for(bound, "none", None), bound.filtering)
    # More data, less variance.
    assert changed(problem).epochs == len(bound.smoothing)
    assert (np.linalg.det(bound.smoothing[:-5]) < np.linalg.det(bound.filtering[:-5])).all()


DOCUMENTED = [
    "scenario", "case", "estimator", "parameters", "causality", "runs", "failed", "diverged",
    "position_mrse_m", "position_mrse_lo", "position_mrse_hi",
    "velocity_mrse_mps", "velocity_mrse_lo", "velocity_mrse_hi",
    "window", "position_bound_m", "velocity_bound_mps", "position_efficiency",
    "paper_position_m", "paper_velocity_mps", "nees_mean", "nees_lo", "nees_hi", "seconds_per_run",
]  # fmt: skip


def record(run: int, position: float, diverged: bool = False, status: str = "ok") -> dict:
    figures = {"position_ms": position, "velocity_ms": 0.01 * position, "nees": 6.0, "nis": 1.0}
    out = {
        "case": "c", "estimator": "e[a=1]", "name": "e", "parameters": "a=1",
        "causality": "filter", "run": run, "status": status,
    }  # fmt: skip
    if status == "ok":
        out |= {
            "seconds": 0.1 * (run + 1), "map_evaluations": 10, "diverged": diverged,
            "windows": {name: figures | {"coverage": 0.9} for name in WINDOWS},
        }  # fmt: skip
    return out


def summary(records: list[dict], *arguments) -> pd.DataFrame:
    """The summary of records."""
    return summarize(runs_table(records), *arguments)


BOUNDS = {("c", "e[a=1]"): dict.fromkeys(WINDOWS, (2.0, 0.2))}


def test_summary_has_the_documented_columns_and_numbers():
    """One row per case, estimator and window; columns in the documented order, numbers by hand.

    A failed run is counted and in no mean; a diverged one is counted, in the mean, and the mean
    without it stands beside.
    """
    records = [
        record(0, 4.0),
        record(1, 9.0, diverged=True),
        record(2, 5.0),
        record(3, 0.0, status="failed"),
    ]
    table = summary(records, BOUNDS, {"c": (3.5, 0.25)}, "s")
    assert list(table.columns[: len(DOCUMENTED)]) == DOCUMENTED
    assert list(SUMMARY_COLUMNS) == DOCUMENTED
    assert table["window"].tolist() == list(WINDOWS)
    for row in table.to_dict("records"):
        assert [row[key] for key in DOCUMENTED[:5]] == ["s", "c", "e", "a=1", "filter"]
        assert (row["runs"], row["failed"], row["diverged"]) == (4, 1, 1)
        assert row["position_mrse_m"] == pytest.approx(math.sqrt(6.0))
        assert row["velocity_mrse_mps"] == pytest.approx(math.sqrt(0.06))
        assert row["position_mrse_lo"] < row["position_mrse_m"] < row["position_mrse_hi"]
        assert (row["position_bound_m"], row["velocity_bound_mps"]) == (2.0, 0.2)
        assert row["position_efficiency"] == pytest.approx(math.sqrt(6.0) / 2.0)
        assert (row["paper_position_m"], row["paper_velocity_mps"]) == (3.5, 0.25)
        assert row["nees_mean"] == 6.0
        assert (row["nees_lo"], row["nees_hi"]) == statistics.nees_band(3, 6)
        assert row["seconds_per_run"] == pytest.approx(0.2)
        assert row["position_without_diverged_m"] == pytest.approx(math.sqrt(4.5))
        assert row["velocity_median_mps"] == pytest.approx(math.sqrt(0.05))
        assert math.sqrt(0.05) < row["velocity_p95_mps"] < math.sqrt(0.09)
        assert (row["coverage_lo"], row["coverage_hi"]) == statistics.coverage_band(3)
        assert math.isnan(row["nis_lo"]) and math.isnan(row["nis_hi"])


def test_quantiles_are_those_of_the_errors():
    """Of the errors (0, 0.1, ..., 10)² m the median is 5² m, and one in twenty is over 9.5² m."""
    table = summary([record(run, (0.1 * run) ** 4) for run in range(101)], BOUNDS, {}, "s")
    for row in table.to_dict("records"):
        assert (row["position_median_m"], row["position_p95_m"]) == pytest.approx((25.0, 90.25))
        assert (row["velocity_median_mps"], row["velocity_p95_mps"]) == pytest.approx((2.5, 9.025))
        assert row["velocity_efficiency"] == pytest.approx(row["velocity_mrse_mps"] / 0.2)
        assert row["coverage"] == pytest.approx(0.9)
        assert (row["nis_mean"], row["map_evaluations"]) == (1.0, 10.0)


def test_a_failed_run_has_not_locked():
    """Of four runs two locked, one did not and one failed: half of them."""
    records = [
        record(run, 4.0) | {"lock_time_s": time, "false_lock": false}
        for run, (time, false) in enumerate([(3.0, False), (5.0, False), (None, True)])
    ]
    records.append(record(3, 0.0, status="failed"))
    row = summary(records, BOUNDS, {}, "s").iloc[0]
    assert (row["lock_share"], row["false_lock_share"]) == (0.5, 0.25)
    assert row["lock_time_median_s"] == 4.0


def test_bounds_of_position_and_velocity_are_traces():
    """Sums of the three variances each; of the attitude nothing."""
    cov = np.diag([1.0, 2.0, 4.0, 0.1, 0.2, 0.4, 50.0, 60.0, 70.0])[None]
    position, velocity = squared_bounds(cov)
    assert (position[0], velocity[0]) == pytest.approx((7.0, 0.7))


def test_the_time_of_a_run_is_that_of_warm_processes():
    """Runs that also compile and import do not count into the median, unless there are no others.

    Nor do failed ones.
    """
    seconds = {0: (90.0, True), 1: (1.0, False), 2: (80.0, True), 3: (3.0, False), 4: (4.0, False)}
    records = [
        record(run, 4.0) | {"seconds": time, "cold": cold} for run, (time, cold) in seconds.items()
    ]
    failed = record(5, 0.0, status="failed") | {"seconds": 700.0, "cold": False}
    assert set(summary([*records, failed], BOUNDS, {}, "s")["seconds_per_run"]) == {3.0}
    first = [entry for entry in records if entry["cold"]]
    assert set(summary(first, BOUNDS, {}, "s")["seconds_per_run"]) == {85.0}


def test_an_interval_does_not_depend_on_the_company():
    """Cells that share their draws have the intervals that each has alone."""
    generator = np.random.default_rng(8)
    squares = {"one": generator.chisquare(3, 30), "two": generator.chisquare(9, 30),
               "few": generator.chisquare(3, 7)}  # fmt: skip
    cells = [
        record(run, float(value)) | {"case": case}
        for case, values in squares.items()
        for run, value in enumerate(values)
    ]
    table = summarize(runs_table(cells), {}, {}, "s").set_index(["case", "window"])
    for case, values in squares.items():
        row = table.loc[(case, "settled")]
        found = [row[f"position_mrse_{end}"] for end in ("m", "lo", "hi")]
        assert found == pytest.approx(statistics.root_mean_interval(values), rel=1e-12)


def test_the_band_of_the_innovations_counts_the_readings():
    """The NIS has the band of its window's readings; an estimator without innovations has none."""
    readings = {"c": {"whole": (20, 5), "settled": (10, 5)}}
    records = [record(0, 4.0), record(1, 9.0)]
    table = summary(records, BOUNDS, {}, "s", readings).set_index("window")
    for window, epochs in (("whole", 20), ("settled", 10)):
        band = tuple(table.loc[window, ["nis_lo", "nis_hi"]])
        assert band == statistics.nis_band(2, epochs, 5)
    assert math.isnan(table.loc["last20", "nis_lo"])
    for entry in records:
        entry["windows"]["whole"]["nis"] = math.nan
    table = summary(records, BOUNDS, {}, "s", readings).set_index("window")
    assert math.isnan(table.loc["whole", "nis_lo"])


def test_summary_without_a_finished_run():
    """Where every run failed there are counts and no numbers; where nothing ran, no rows."""
    failed = [record(0, 0.0, status="failed"), record(1, 0.0, status="failed")]
    table = summary(failed, BOUNDS, {"c": None}, "s")
    assert list(table.columns[: len(DOCUMENTED)]) == DOCUMENTED
    assert table["failed"].tolist() == [2, 2, 2]
    assert table["position_mrse_m"].isna().all()
    assert table["paper_position_m"].isna().all()
    empty = summary([], BOUNDS, {"c": None}, "s")
    assert len(empty) == 0
    assert list(empty.columns[: len(DOCUMENTED)]) == DOCUMENTED
