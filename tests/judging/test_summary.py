"""Judging: numbers worked out by hand, and statistics that keep their promises."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from problems import LinearModel, changed, exact, kalman, linear_problem
from scipy.stats import chi2

from ggbench.judging import statistics
from ggbench.judging.bootstrap import root_ratio_intervals
from ggbench.judging.bounds import bound_for, squared_bounds
from ggbench.judging.run_errors import (
    WINDOWS,
    Evaluation,
    evaluate,
    has_diverged,
    window_mask,
    window_metrics,
)
from ggbench.judging.summary import METRICS, metrics, ordered
from ggbench.problem import Estimate, Problem, StateBlock
from ggbench.results.columns import BLANK
from ggbench.simulation.bound import posterior_bound
from ggbench.simulation.runs import Truth
from ggbench.spec.case import WindowsSpec

LIMITS = WindowsSpec(settled_from_s=3.0, last_s=2.0)


def judged(errors: np.ndarray, cov: np.ndarray | None) -> Evaluation:
    """The judgement of an estimate with given errors (K, 6)."""
    epochs, n = errors.shape
    zero = np.zeros((epochs, n, n))
    problem = Problem(
        times=np.arange(1.0, epochs + 1.0),
        measurements=np.zeros((epochs, 1)),
        noise_cov=np.eye(1),
        transition=zero + np.eye(n),
        process_cov=zero,
        prior_mean=np.zeros(n),
        prior_cov=np.eye(n),
        model=LinearModel(np.zeros((epochs, 1, n))),
        layout=(),
    )
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
    """A spherical error is a norm over ENU, a window's metric the mean of squares, NEES eᵀP⁻¹e."""
    errors = np.zeros((5, 6))
    errors[:, :3] = [[0, 0, 0], [2, 0, 0], [2, 3, 6], [0, 3, 4], [1, 2, 2]]
    errors[:, 3:] = 0.1 * errors[:, :3]
    evaluation = judged(errors, np.tile(np.diag([4.0] * 3 + [0.04] * 3), (5, 1, 1)))
    assert evaluation.position_error.tolist() == pytest.approx([0, 2, 7, 5, 3])
    assert evaluation.velocity_error.tolist() == pytest.approx([0, 0.2, 0.7, 0.5, 0.3])
    assert evaluation.nees.tolist() == pytest.approx([0, 2, 24.5, 12.5, 4.5])
    assert evaluation.components == pytest.approx(errors)
    assert evaluation.sigmas == pytest.approx(np.tile([2.0] * 3 + [0.2] * 3, (5, 1)))
    found = window_metrics(evaluation, np.arange(1.0, 6.0), LIMITS)
    assert found["whole"]["position_ms"] == pytest.approx(87 / 5)
    assert found["settled"]["position_ms"] == pytest.approx(83 / 3)
    assert found["last20"]["velocity_ms"] == pytest.approx(0.17)
    assert found["settled"]["nees"] == pytest.approx(41.5 / 3)
    # χ² of six leaves 12.59 with 95 %: only the error of 7 m lies outside.
    assert found["whole"]["coverage"] == pytest.approx(4 / 5)


def test_an_estimate_without_covariance_has_no_consistency():
    """Without P there are errors and no NEES: not a number, rather than a good one."""
    evaluation = judged(np.ones((5, 6)), None)
    found = window_metrics(evaluation, np.arange(1.0, 6.0), LIMITS)
    assert found["whole"]["position_ms"] == pytest.approx(3.0)
    assert math.isnan(found["whole"]["nees"])
    assert math.isnan(found["whole"]["nis"])
    assert math.isnan(found["whole"]["coverage"])


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
    found = window_metrics(evaluation, gapped.times, LIMITS)
    assert found["whole"]["nis"] == pytest.approx(evaluation.nis[there].mean())


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


def record(run: int, position: float, diverged: bool = False, status: str = "ok") -> dict:
    """A row of a table of runs."""
    metrics_of = {
        "position_ms": position,
        "velocity_ms": 0.01 * position,
        "nees": 6.0,
        "nis": 1.0,
        "coverage": 0.95,
        "bound_position_ms": 4.0,
        "bound_velocity_ms": 0.04,
        "oracle_position_ms": position / 1.21,
        "oracle_velocity_ms": 1.0,
    }
    row = BLANK | {
        "case": "c",
        "estimator": "e[a=1]",
        "name": "e",
        "parameters": "a=1",
        "causality": "filter",
        "run": run,
        "status": status,
        "diverged": diverged,
        "false_fix": False,
        "map_evaluations": math.nan,
    }
    if status == "ok":
        row |= {
            "seconds": 0.1 * (run + 1),
            "map_evaluations": 10,
            "required_m": 2.5,
            "final_position_error_m": math.sqrt(position),
            "final_ins_error_m": 9.0,
            "converged_s": 3.0 + run if position <= 6.25 else math.nan,
            "false_fix": position > 6.25,
            **{f"{window}_{name}": v for window in WINDOWS for name, v in metrics_of.items()},
        }
    return row


def table_of(rows: list[dict], *arguments, draws: int | None = None) -> pd.DataFrame:
    """The metrics of runs; with draws, run r belongs to cluster r modulo their number."""
    runs = pd.DataFrame(rows, columns=["case", "estimator", *BLANK])
    return metrics(runs.assign(draw=runs["run"] % (draws or 10**6)), *(arguments or ({},)))


def test_metrics_on_hand_numbers():
    """One row per case, estimator and window, with numbers worked out by hand.

    A failed run is counted, does not succeed, and is in no mean; a diverged one is in the mean.
    """
    records = [
        record(0, 4.0),
        record(1, 9.0, diverged=True),
        record(2, 5.0),
        record(3, 0.0, status="failed"),
    ]
    table = table_of(records, {"c": (3.5, 0.25)})
    assert tuple(table.columns) == METRICS
    assert table["window"].tolist() == list(WINDOWS)
    for row in table.to_dict("records"):
        assert [row[key] for key in METRICS[:5]] == ["c", "e[a=1]", "e", "a=1", "filter"]
        assert (row["runs"], row["failed"], row["diverged"], row["draws"]) == (4, 1, 1, 4)
        assert row["rms_m"] == pytest.approx(math.sqrt(6.0))
        assert row["velocity_rms_mps"] == pytest.approx(math.sqrt(0.06))
        assert math.isnan(row["rms_lo"]) and math.isnan(row["rms_hi"])  # three runs
        assert (row["median_m"], row["p95_m"]) == pytest.approx((math.sqrt(5.0), math.sqrt(8.6)))
        assert (row["bound_m"], row["velocity_bound_mps"]) == pytest.approx((2.0, 0.2))
        assert row["efficiency"] == pytest.approx(1.1)
        assert (row["published_m"], row["published_mps"]) == (3.5, 0.25)
        assert row["success"] == 0.5  # of 4, of which one failed and one ends 3 m away
        assert row["false_fixes"] == 0.25
        assert row["converged_s"] == 4.0
        assert row["nees"] == 6.0
        assert (row["nees_lo"], row["nees_hi"]) == statistics.mean_band(3, 6)
        assert row["seconds_per_run"] == pytest.approx(0.2)
        assert row["consistency"] == "consistent"  # one false fix of four runs is no evidence
        assert math.isnan(row["times_ins"])
        assert math.isnan(row["nis_lo"]) and math.isnan(row["nis_hi"])


def test_a_wrong_model_has_no_efficiency():
    """Without an oracle the model is wrong: there is an RMS error, and no ratio to the bound."""
    records = [record(run, 4.0) for run in range(3)]
    for entry in records:
        entry |= dict.fromkeys((f"{window}_oracle_position_ms" for window in WINDOWS), math.nan)
    table = table_of(records)
    assert table["efficiency"].isna().all()
    assert (table["rms_m"] == 2.0).all() and (table["bound_m"] == 2.0).all()


def test_errors_over_the_ins_are_of_common_runs():
    """The INS flew runs 0 to 3, of which the estimator has two."""
    ins = [
        record(run, 16.0 * (run + 1)) | {"estimator": "ins", "causality": "none"}
        for run in range(4)
    ]
    table = table_of([*ins, record(2, 12.0), record(3, 16.0), record(9, 1e9)])
    found = table.set_index(["estimator", "window"])["times_ins"]
    assert found["e[a=1]", "settled"] == pytest.approx(0.5)
    assert found["ins", "whole"] == 1.0


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
    assert set(table_of([*records, failed])["seconds_per_run"]) == {3.0}
    first = [entry for entry in records if entry["cold"]]
    assert set(table_of(first)["seconds_per_run"]) == {85.0}


def test_an_interval_does_not_depend_on_the_company():
    """Cells that share their draws have the intervals that each has alone."""
    generator = np.random.default_rng(8)
    squares = {
        "one": generator.chisquare(3, 30),
        "two": generator.chisquare(9, 30),
        "few": generator.chisquare(3, 35),
    }
    cells = [
        record(run, float(value)) | {"case": case}
        for case, values in squares.items()
        for run, value in enumerate(values)
    ]
    table = table_of(cells).set_index(["case", "window"])
    for case, values in squares.items():
        found = [table.loc[(case, "settled"), f"rms_{end}"] for end in ("m", "lo", "hi")]
        alone = root_ratio_intervals([(values, np.ones(len(values)), np.arange(len(values)))])
        assert found == pytest.approx(alone[0], rel=1e-12)


def test_runs_that_share_a_draw_are_one_cluster():
    """200 runs over twenty map errors are twenty samples, in every interval and band."""
    records = [record(run, 4.0 + (run % 20)) for run in range(200)]
    row, alone = table_of(records, draws=20).iloc[0], table_of(records).iloc[0]
    assert row["draws"] == 20
    assert row["rms_hi"] - row["rms_lo"] > 2.5 * (alone["rms_hi"] - alone["rms_lo"])
    assert (row["nees_lo"], row["nees_hi"]) == statistics.mean_band(20, 6)


def test_the_ratio_to_the_oracle_is_paired():
    """An efficient filter prints 1.00 where the draw moves both errors by tens of per cent."""
    generator = np.random.default_rng(4)
    records = []
    for run in range(60):
        square = float(generator.chisquare(3))
        entry = record(run, square * float(generator.lognormal(0.0, 0.02)))
        entry |= {f"{window}_oracle_position_ms": square for window in WINDOWS}
        records.append(entry)
    row = table_of(records).iloc[0]
    assert row["efficiency"] == pytest.approx(1.0, abs=0.005)
    assert 0.99 < row["efficiency_lo"] < row["efficiency"] < row["efficiency_hi"] < 1.01
    assert row["rms_hi"] / row["rms_lo"] > 1.15


def lost_runs(count: int, total: int = 50) -> list[dict]:
    """Runs of which some end 100 m off with a NEES of 40."""
    lost = [record(run, 1e4) | {"last20_nees": 40.0} for run in range(count)]
    return lost + [record(run, 4.0) for run in range(count, total)]


def test_lost_runs_are_counted_apart():
    """Beyond χ² of 99.9 % and outside the required error; either alone is not lost.

    The median, and the RMS error of the others, do not know of them.
    """
    row = table_of(lost_runs(2)).iloc[0]
    assert (row["lost"], row["diverged"], row["failed"]) == (2, 0, 0)
    assert row["rms_m"] == pytest.approx(math.sqrt((2e4 + 48 * 4.0) / 50))
    assert (row["median_m"], row["kept_rms_m"]) == pytest.approx((2.0, 2.0))
    assert table_of(lost_runs(3)).iloc[0]["p95_m"] > 50.0
    for change in ({"last20_nees": 22.4}, {"final_position_error_m": 2.4}, {"status": "failed"}):
        changed_runs = [entry | change for entry in lost_runs(2)[:2]] + lost_runs(2)[2:]
        assert table_of(changed_runs).iloc[0]["lost"] == 0
    everything = table_of(lost_runs(50)).iloc[0]
    assert everything["lost"] == 50 and math.isnan(everything["kept_rms_m"])


@pytest.mark.parametrize(("hits", "as_ins"), [(30, True), (34, True), (45, False), (20, True)])
def test_success_is_compared_with_that_of_the_ins(hits, as_ins):
    """The INS succeeds in 30 of 50 runs: with 34 an estimator is no surer, with 45 it is."""

    def flown(label: str, causality: str, count: int) -> list[dict]:
        return [
            record(run, 4.0 if run < count else 16.0) | {"estimator": label, "causality": causality}
            for run in range(50)
        ]

    table = table_of([*flown("ins", "none", 30), *flown("e", "filter", hits)])
    found = table.groupby("estimator")["as_ins"].first()
    assert (found["e"], found["ins"]) == (as_ins, False)
    table = table_of([*flown("ins", "none", 15), *flown("e", "filter", hits)])
    assert not table["as_ins"].any()  # of 30 % nothing is said


def test_noise_that_does_not_fit_is_said():
    """A NIS of 1 where five channels are measured; of right noise nothing is said."""
    sizes = {"c": {"whole": (20, 5), "settled": (10, 1), "last20": (5, 1)}}
    records = [record(run, 4.0) | {"settled_nis": 1.0 + 0.1 * (run % 3 - 1)} for run in range(20)]
    table = table_of(records, {}, sizes).set_index("window")
    assert table["noise_fit"].to_dict() == {"whole": "R does not fit", "settled": "", "last20": ""}
    assert table.loc["whole", "nis"] == 1.0


def test_the_band_of_the_innovations_counts_the_measurements():
    """The NIS has the band of its window; an estimator without innovations has none."""
    sizes = {"c": {"whole": (20, 5), "settled": (10, 5)}}
    records = [record(0, 4.0), record(1, 9.0)]
    table = table_of(records, {}, sizes).set_index("window")
    for window, epochs in (("whole", 20), ("settled", 10)):
        band = tuple(table.loc[window, ["nis_lo", "nis_hi"]])
        assert band == statistics.mean_band(2 * epochs, 5)
    assert math.isnan(table.loc["last20", "nis_lo"])
    for entry in records:
        entry["whole_nis"] = math.nan
    table = table_of(records, {}, sizes).set_index("window")
    assert math.isnan(table.loc["whole", "nis_lo"])


def test_metrics_without_a_finished_run():
    """Where every run failed there are counts and no numbers; where nothing ran, no rows."""
    table = table_of([record(0, 0.0, status="failed"), record(1, 0.0, status="failed")])
    assert table["failed"].tolist() == [2, 2, 2]
    assert table["rms_m"].isna().all()
    assert (table["success"] == 0.0).all()
    assert (table["noise_fit"] == "").all() and not table["as_ins"].any()
    empty = table_of([])
    assert len(empty) == 0
    assert tuple(empty.columns) == METRICS


def test_rows_are_ordered_by_error_and_smoothers_come_last():
    kinds = (("smoother", 1.0, "batch"), ("far", 9.0, "filter"), ("near", 4.0, "filter"))
    records = [
        record(0, error) | {"estimator": label, "causality": causality}
        for label, error, causality in kinds
    ]
    rows = ordered(table_of(records), "c")
    assert [row["estimator"] for row in rows] == ["near", "far", "smoother"]
