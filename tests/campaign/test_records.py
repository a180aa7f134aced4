"""What one run is given, how it is judged, and under which key its record is kept."""

from __future__ import annotations

import ast
import importlib.metadata
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from campaigns import failed, plan, ran, records, small
from problems import SMALL
from small_cases import rough_map, small_case, small_flight

import ggbench.estimators
from ggbench.block import BlockEstimator, EstimateBlock, ProblemBlock
from ggbench.campaign import records as recording
from ggbench.campaign import registry, result_keys, runner
from ggbench.engines.innovations import innovations_squared
from ggbench.estimator_spec import EstimatorSpec
from ggbench.judging.references import CaseBound
from ggbench.judging.run_errors import WINDOWS
from ggbench.results.database import Result
from ggbench.results.store import DETAILED_RUN, MOST_KEPT, SERIES_RUNS
from ggbench.simulation.error_free_flight import Flight
from ggbench.simulation.flight_bounds import flight_bound
from ggbench.simulation.runs import simulate, simulate_block
from ggbench.spec.trajectory import TrajectorySpec

DRAWING = """
from dataclasses import dataclass
import numpy as np
from ggbench.problem import Estimate, Estimator


@dataclass(frozen=True)
class Drawing(Estimator):
    way: int = 0
    name = "drawing"
    causality = "filter"

    def estimate(self, problem, rng):
        mean = np.zeros((problem.epochs, problem.dimension))
        return Estimate(mean, None, "filter", info={"drawn": rng.random()})
"""


def test_every_run_of_every_estimator_draws_numbers_of_its_own(tmp_path):
    """Another run, seed, parameter or class draws anew; a run that is repeated draws the same."""
    (tmp_path / "drawing.py").write_text(DRAWING)
    (tmp_path / "other.py").write_text(DRAWING.replace("class Drawing", "class Other"))
    labels = [f"{tmp_path}/{name}" for name in ("drawing.py", "drawing.py[way=1]", "other.py")]

    def drawn(folder: str, seed: int) -> dict[tuple[str, str, int], float]:
        found = records(ran(tmp_path, folder, labels, runs=3, seed=seed, cases=("base",)))
        return {key: record["info"]["drawn"] for key, record in found.items()}

    first, again, other = drawn("a", 5), drawn("b", 5), drawn("c", 6)
    assert first == again
    assert len({*first.values(), *other.values()}) == 2 * len(labels) * 3


def third_party(file: Path) -> set[str]:
    """Top-level modules that a file imports, neither its own nor of the standard library."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            found.add(node.module.partition(".")[0])
    return found - set(sys.stdlib_module_names) - {"ggbench"}


def test_libraries_below_the_estimators_are_in_the_key(monkeypatch):
    """A new version of anything that an estimator computes with is another result."""
    used = {"scipy", "numba"}  # below the rooms
    for file in Path(ggbench.estimators.__file__).parent.glob("*.py"):
        used |= third_party(file)
    used -= {"pydantic"}  # it checks parameters and computes nothing
    assert {"numpy", "gtsam", "filterpy"} < used
    case, content = small_case(), registry.choose("ins").content

    def key() -> str:
        result_keys.environment.cache_clear()
        return result_keys.run_key(case, content, 1)

    before, installed = key(), importlib.metadata.version
    for package in sorted(used):
        with monkeypatch.context() as patch:
            patch.setattr(
                importlib.metadata,
                "version",
                lambda name, package=package: "0.0" if name == package else installed(name),
            )
            assert key() != before, package
    assert key() == before


def evaluated(
    flight: Flight, blanks: list[dict], states: np.ndarray, made: recording.TimedEstimates
) -> list[Result]:
    """Results of estimates; the oracle's errors are left out."""
    return recording.evaluate_runs(
        blanks,
        "key",
        flight=flight,
        error_state=states,
        estimated=made,
        bound=CaseBound(flight, flight_bound(flight)),
        oracle=lambda _: np.full((len(blanks), len(WINDOWS), 2), np.nan),
        problem_of=lambda r: simulate(flight, 1, blanks[r]["run"])[0],
    )


def judged(
    flight: Flight, ins: np.ndarray, left: np.ndarray, causality="filter", lag: float | None = None
) -> list[Result]:
    """Results of runs of which the INS is off by ``ins`` [m] and an estimate by ``left`` [m]."""
    runs, epochs, n = len(ins), len(flight.times), 15
    states = np.zeros((runs, epochs, n))
    states[..., 1] = ins[:, None]
    mean = states.copy()
    mean[..., 1] -= left[:, None]
    cov = np.tile(np.eye(n), (runs, epochs, 1, 1))
    made = recording.TimedEstimates(
        mean=mean,
        cov=cov,
        nis=np.zeros((runs, epochs)),
        causality=causality,
        lag=lag,
        info=[{}] * runs,
        evaluations=[0] * runs,
        seconds=0.5,
    )
    blanks = [recording.new_record(registry.choose("ekf"), run, 1) for run in range(runs)]
    return evaluated(flight, blanks, states, made)


def test_a_run_has_diverged_if_the_ins_alone_ends_nearer():
    """Beyond ten bounds an estimate is lost only if it is beyond the INS of its own run, too."""
    flight = small_flight()
    limit = 10.0 * np.sqrt(np.trace(flight_bound(flight).filtering[-1, :3, :3]))
    ins = np.array([3.0, 3.0, 3.0, 0.0, 0.0]) * limit
    left = np.array([1.1, 2.9, 3.1, 0.9, 1.1]) * limit
    found = [result.record for result in judged(flight, ins, left)]
    assert [record["diverged"] for record in found] == [False, False, True, False, True]
    assert [record["final_ins_error_m"] for record in found] == pytest.approx(ins)
    assert [record["final_position_error_m"] for record in found] == pytest.approx(left)


@pytest.mark.parametrize(
    ("period", "lag", "epochs"),
    [(1.0, 2.0, 2), (1.0, 2.9, 2), (1.0, 0.5, 0), (0.1, 0.3, 3), (0.1, 0.39, 3), (2.0, 3.0, 1)],
)
def test_a_fixed_lag_is_set_beside_what_it_has_seen(period, lag, epochs):
    """The bound of a lag that ends between two epochs is that of the earlier: no later reading."""
    flight = small_flight({"gradiometer.period_s": period})
    (result,) = judged(flight, np.ones(1), np.ones(1), "fixed-lag", lag)
    assert result.record["bound"] == f"fixed-lag-{epochs}"


@pytest.mark.parametrize(
    ("causality", "bound"), [("filter", "filter"), ("none", "filter"), ("batch", "batch")]
)
def test_the_bound_of_a_causality(causality, bound):
    """An estimate is set beside the bound of its causality; the INS beside what aiding gives."""
    (result,) = judged(small_flight(), np.ones(1), np.ones(1), causality)
    assert result.record["bound"] == bound


def recorded(flight: Flight, runs: range, **changes: object) -> list[Result]:
    """Results of runs with errors, deviations, NIS and remarks that all differ from each other."""
    count, epochs, n = len(runs), len(flight.times), 15
    generator = np.random.default_rng(9)
    states = generator.uniform(1.0, 2.0, (count, epochs, n))
    mean = states - generator.uniform(0.1, 0.9, states.shape)
    cov = np.einsum("rki,ij->rkij", generator.uniform(1.0, 9.0, states.shape), np.eye(n))
    given = {
        "mean": mean,
        "cov": cov,
        "nis": generator.uniform(4.0, 9.0, (count, epochs)),
        "causality": "filter",
        "lag": None,
        "info": [{"of": run} for run in runs],
        "evaluations": [10 + run for run in runs],
        "seconds": 0.5,
    }
    made = recording.TimedEstimates(**(given | changes))
    blanks = [recording.new_record(registry.choose("ekf"), run, 1) for run in runs]
    return evaluated(flight, blanks, states, made)


def test_series_and_details_are_what_their_columns_say():
    """Metrics of windows are means of the series; components and deviations stand in their order.

    Whoever reads a record finds its own run's remarks and map points in it.
    """
    flight = small_flight()
    for run, result in enumerate(recorded(flight, range(3))):
        record, series = result.record, result.series.astype(float)
        assert record["whole_position_ms"] == pytest.approx(np.mean(series[:, 0] ** 2), rel=1e-6)
        assert record["whole_velocity_ms"] == pytest.approx(np.mean(series[:, 1] ** 2), rel=1e-6)
        assert record["whole_nees"] == pytest.approx(np.mean(series[:, 2]), rel=1e-6)
        assert record["whole_nis"] == pytest.approx(np.mean(series[:, 3]), rel=1e-6)
        assert record["final_position_error_m"] == pytest.approx(series[-1, 0], rel=1e-6)
        assert (record["info"], record["map_evaluations"]) == ({"of": run}, 10 + run)
        assert (result.detail is not None) == (run == DETAILED_RUN)
        if result.detail is not None:
            errors, sigmas, gravity = np.split(result.detail.astype(float), 3, axis=1)
            assert np.isnan(gravity).all()  # which is no state here
            assert np.linalg.norm(errors[:, :3], axis=1) == pytest.approx(series[:, 0], rel=1e-6)
            assert np.linalg.norm(errors[:, 3:], axis=1) == pytest.approx(series[:, 1], rel=1e-6)
            assert np.sum((errors / sigmas) ** 2, axis=1) == pytest.approx(series[:, 2], rel=1e-5)


def test_only_filters_have_innovations():
    """A smoother's record has no NIS, whatever it was given; a filter's own is of its own run."""
    flight = small_flight()
    for causality, lag in (("batch", None), ("fixed-lag", 2.0), ("none", None)):
        for result in recorded(flight, range(2), causality=causality, lag=lag):
            assert np.isnan(result.record["whole_nis"])
    problem, _ = simulate(flight, 1, 1)
    prior = np.tile(problem.prior_cov, (2, problem.epochs, 1, 1))
    zero = np.zeros((2, problem.epochs, problem.dimension))
    results = recorded(flight, range(2), mean=zero, cov=prior, nis=None)
    wanted = innovations_squared(problem, zero[1], prior[1])
    assert results[1].series[:, 3] == pytest.approx(wanted, rel=1e-6)


def test_series_are_of_the_first_runs():
    """Of more runs than figures need, records are kept and series are not."""
    kept = recorded(small_flight(), range(SERIES_RUNS - 1, SERIES_RUNS + 1))
    assert [result.series is not None for result in kept] == [True, False]


def test_a_false_fix_is_claimed_at_the_end():
    """By the deviations of the last epoch, not by those of the first."""
    flight = small_flight({"windows.required_m": 5.0})
    epochs = len(flight.times)
    for first, last, false in ((1e-2, 1e4, False), (1e4, 1e-2, True)):
        variances = np.linspace(first, last, epochs)[None, :, None, None] * np.eye(15)
        mean = np.full((1, epochs, 15), 100.0)
        (result,) = recorded(flight, range(1), mean=mean, cov=variances)
        assert np.isnan(result.record["converged_s"]) and result.record["false_fix"] == false


def test_figures_show_the_noise_that_the_detailed_run_had():
    """Of its vertical component; behind the filter that of the filter, of both signals."""
    flight = small_flight()
    arrays = recording.shared_arrays(flight, 5, [])
    problem, _ = simulate(flight, 5, DETAILED_RUN)
    zz = problem.measurements[:, 5] - flight.noise_free[:, 5]
    assert arrays["noisy"] - arrays["vertical"] == pytest.approx(zz, abs=1e-9)
    flight = small_flight({"gradiometer.filter": "butterworth"})
    arrays = recording.shared_arrays(flight, 5, [])
    apply = flight.true.gradiometer.lowpass.apply
    assert arrays["filtered"] == pytest.approx(apply(arrays["noisy"]))
    assert arrays["filtered_true"] == pytest.approx(apply(arrays["vertical"]))


def test_figures_show_the_map_without_the_normal_field(tmp_path):
    """A map of 10 E rms is some tens of E where it lies; the normal field would be 3000 E."""
    flight = small_flight({"field.source": rough_map(tmp_path / "rough.nc")})
    arrays = recording.shared_arrays(flight, 5, [])
    assert 2.0 < np.std(arrays["map_vertical"]) < 30.0
    assert np.abs(arrays["map_vertical"]).max() < 100.0
    for name, degrees in (("latitude", 33.5), ("longitude", 108.0)):
        nodes = np.degrees(arrays[f"map_{name}"])
        assert nodes[0] < degrees < nodes[-1]
        assert np.ptp(nodes) == pytest.approx(39 * 0.5 / 60.0)


def test_a_long_flight_keeps_an_even_choice_of_its_epochs():
    """Series and shared arrays agree on which."""
    flight = small_flight({"trajectory.repeat": 3, "gradiometer.period_s": 0.1})
    kept = recording.shared_arrays(flight, 5, [])["kept"]
    assert len(flight.times) == 600 and len(kept) == MOST_KEPT
    (result,) = recorded(flight, range(1))
    assert len(result.series) == len(kept)
    assert result.record["final_position_error_m"] == pytest.approx(result.series[-1, 0], rel=1e-6)


def test_an_estimators_first_run_in_a_process_is_cold(tmp_path, monkeypatch):
    """Each estimator's own first one, and no other."""
    monkeypatch.setattr(runner, "_warm", set())
    labels = ("filterpy-ekf", "filterpy-ukf")
    for record in ran(tmp_path, labels=labels, runs=2).records():
        assert record["cold"] == ((record["case"], record["run"]) == ("base", 0))


@pytest.mark.parametrize("side", ["truth", "model"])
def test_the_map_of_either_side_is_in_the_key(side, tmp_path):
    """Another map of the truth alone, or of the estimators alone, is another result."""
    keys = set()
    for seed in (1, 2):
        path = rough_map(tmp_path / f"{seed}.nc", seed)
        case = small_case({f"{side}.field.source": path})
        keys.add(result_keys.problem_key(case, 1))
    assert len(keys) == 2


def test_the_content_of_a_track_is_in_the_key(tmp_path):
    """The same case over a track that has since changed is another one; its place is no part."""
    rows = "time_s,latitude_deg,longitude_deg,height_m\n0,33.5,108,10000\n20,33.5,{},10000\n"
    keys = []
    for name, end in (("a", 108.05), ("b", 108.05), ("c", 108.06)):
        (tmp_path / f"{name}.csv").write_text(rows.format(end))
        track = TrajectorySpec(file=str(tmp_path / f"{name}.csv"))
        case = small_case().model_copy(update={"trajectory": track})
        keys.append(result_keys.problem_key(case, 1))
    assert keys[0] == keys[1] != keys[2]


def test_a_lag_that_is_asked_for_later_gets_its_bound(tmp_path):
    """A folder holds the bound of every lag that any of its estimators has had."""
    for lag in (2, 5):
        results = ran(tmp_path, labels=(f"factor-graph[mode=fixed-lag,lag={lag}]",), runs=1)
        names = set(results.arrays("base"))
        rows = results.metrics().query("window == 'settled' and case == 'base'")
        results.store.close()
    assert {"bound-fixed-lag-2", "bound-fixed-lag-5"} <= names
    bounds = rows.set_index("estimator")["bound_m"]
    assert len(bounds) == 2 and bounds.iloc[1] < bounds.iloc[0]


def test_two_cases_of_one_content_are_run_once(tmp_path):
    """Under two names a case is flown once, and both names are in the tables."""
    text = SMALL.replace("gradiometer.noise_eotvos = 0.1", "gradiometer.noise_eotvos = 0.01")
    work = plan(tmp_path, "out", ("ins",), scenario=small(tmp_path, text))
    store, _ = work.open()
    assert work.tasks(store).results == 3
    store.close()
    results = ran(tmp_path, labels=("ins",), scenario=small(tmp_path, text))
    assert {record["case"] for record in results.records()} == {"base", "noisy"}


@dataclass(frozen=True)
class Zeros(BlockEstimator):
    """Estimates no error, of each run after so many points of the map as its number says."""

    name = "zeros"
    causality = "filter"

    def estimate_block(self, block: ProblemBlock, rngs=()) -> EstimateBlock:
        mean = np.zeros((block.runs, block.epochs, block.dimension))
        counts = {"map_evaluations": np.arange(block.runs), "steps": 7 + np.arange(block.runs)}
        return EstimateBlock(mean, mean[..., None] + np.eye(block.dimension), "filter", info=counts)


def test_runs_of_a_block_share_its_time_and_keep_their_own_counts(monkeypatch):
    """Four runs that take eight seconds together take two each."""
    block, _ = simulate_block(small_flight(), 1, range(4))
    monkeypatch.setattr(runner, "clock", iter([0.0, 8.0]).__next__)
    choice = registry.Choice(EstimatorSpec("zeros"), Zeros())
    rngs = [np.random.default_rng(run) for run in range(4)]
    found = runner.timed_estimates(block, 0, choice, rngs)
    assert found.seconds == 2.0
    assert list(found.evaluations) == [0, 1, 2, 3]
    assert list(found.info) == [{"steps": 7}, {"steps": 8}, {"steps": 9}, {"steps": 10}]


def test_tasks_hold_every_run_once(tmp_path, monkeypatch):
    """However many runs a task may have, of estimators that take them at once or one by one."""
    monkeypatch.setattr("ggbench.campaign.plan.TASK_RUNS", 4)
    work = plan(tmp_path, "out", ("ins", "ekf"), runs=11)
    store, _ = work.open()
    tasks = work.tasks(store)
    found = [
        (task.case.name, label, run)
        for task in tasks
        for label, _ in task.estimators
        for run in task.runs
    ]
    assert len(found) == len(set(found)) == tasks.results == 2 * 2 * 11
    assert max(len(task.runs) for task in work.tasks(store)) == 4
    store.close()


def test_a_lost_run_is_there_and_may_be_tried_again(tmp_path):
    """A death counts as a result of the campaign; a campaign with more time has it to do."""
    work = plan(tmp_path, "out", ("ins",), runs=2, cases=("base",), limit=60.0)
    store, _ = work.open()
    assert (work.missing(store), work.tasks(store).results) == (2, 2)
    ((_, _, ((_, key),)),) = work.plan.cells()
    store.add(
        [Result(key, failed(run), retry_above=limit) for run, limit in enumerate((60.0, 5.0))]
    )
    assert (work.missing(store), work.tasks(store).results) == (0, 1)
    store.close()
