"""Estimators that take many runs at once: the same records, and a failure costs one run."""

from __future__ import annotations

import sqlite3

import numpy as np
import pytest
from campaigns import assert_equal, plan, ran, records, small
from problems import SMALL, linear_problem
from thinning import thinned

from ggbench.campaign import execution, flights, runner, running
from ggbench.campaign import records as kept
from ggbench.campaign.registry import choose
from ggbench.results.folder import Results
from ggbench.simulation.runs import simulate

MANY = """
import os, time
from dataclasses import dataclass
from typing import Literal
import numpy as np
from ggbench.block import BlockEstimator, EstimateBlock
from ggbench.campaign.registry import choose


@dataclass(frozen=True)
class Many(BlockEstimator):
    way: Literal["good", "nis", "nan mean", "nan cov", "indefinite", "raise", "exit", "sleep",
                 "nothing", "batch", "short", "no count", "complex", "masked nis",
                 "masked info"] = "good"
    name = "many"
    causality = "filter"

    def estimate_block(self, block, rngs):
        ekf = choose("ekf").estimator
        each = [ekf.estimate(block.problem(r), None) for r in range(block.runs)]
        mean, cov = np.stack([e.mean for e in each]), np.stack([e.cov for e in each])
        info = {"map_evaluations": np.full(block.runs, 7), "first": block.measurements[:, 0, 0]}
        bad = block.measurements[:, 0, 0] > THRESHOLD
        causality, nis = "filter", None
        if self.way == "nis":
            nis = np.tile(np.where(np.arange(block.epochs) < 2, np.nan, 3.0), (block.runs, 1))
        if self.way == "nan mean":
            mean[bad, 3] = np.nan
        if self.way == "nan cov":
            cov[bad, 5, 14, 2] = np.inf
        if self.way == "indefinite":
            east, north = cov[bad, 4, 0, 0], cov[bad, 4, 1, 1]
            cov[bad, 4, 1, 0] = cov[bad, 4, 0, 1] = 1.1 * np.sqrt(east * north)
        if self.way == "raise" and bad.any():
            raise ArithmeticError("not this one")
        if self.way == "exit" and bad.any():
            os._exit(7)
        if self.way == "sleep" and bad.any():
            time.sleep(1000.0)
        if self.way == "nothing":
            return None
        if self.way == "batch":
            causality = "batch"
        if self.way == "short":
            mean = mean[:-1]
        if self.way == "no count":
            del info["map_evaluations"]
        if self.way == "complex":
            info["remark"] = np.full(block.runs, 1j)
        if self.way == "masked nis":
            nis = np.ma.masked_less(np.tile(np.arange(block.epochs), (block.runs, 1)), 3)
        if self.way == "masked info":
            info["repairs"] = np.ma.masked_all(block.runs)
        return EstimateBlock(mean=mean, cov=cov, nis=nis, causality=causality, info=info)
"""
OF_THE_ESTIMATOR = ("name", "parameters", "info", "map_evaluations", "estimator")


@pytest.fixture
def many(tmp_path, monkeypatch) -> str:
    """The file of an estimator that takes many runs at once, bad in one of 6 of case base."""
    monkeypatch.chdir(tmp_path)  # a whole path would be too long for the figures of a report
    flight = flights.flight_of(small(tmp_path).cases[0])
    first = [simulate(flight, 5, run)[0].measurements[0, 0] for run in range(6)]
    threshold = np.mean(np.sort(first)[-2:])
    (tmp_path / "many.py").write_text(MANY.replace("THRESHOLD", repr(float(threshold))))
    return "many.py"


def assert_close(one: object, other: object) -> None:
    """Equal, or numbers that differ by less than the simulations may: 1e-9 m of 1 mm."""
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for name in one:
            assert_close(one[name], other[name])
    elif isinstance(one, float):
        assert one == pytest.approx(other, rel=1e-6, nan_ok=True)
    else:
        assert one == other


def test_a_block_of_long_flights_has_fewer_runs(tmp_path, monkeypatch):
    """As many as the matrices of their epochs have room for, but as many as kernels take at once.

    Of a flight that fails the size does not matter: every run's record says why.
    """
    case = small(tmp_path, SMALL).case("base")
    assert flights.runs_at_once(case) == 32
    flight = flights.flight_of(case)
    bytes_of_a_run = 8 * len(flight.times) * 3 * 15 * 15
    monkeypatch.setattr(flights, "BLOCK_BYTES", 16 * bytes_of_a_run)
    assert flights.runs_at_once(case) == 16
    monkeypatch.setattr(flights, "BLOCK_BYTES", 16 * bytes_of_a_run - 1)
    assert flights.runs_at_once(case) == 8
    monkeypatch.setattr(flights, "BLOCK_BYTES", 1)
    assert flights.runs_at_once(case) == 8
    monkeypatch.setattr(flights, "flight_of", lambda case: 1 / 0)
    assert flights.runs_at_once(case) == 32


@thinned("required", ["", "required_m = 100.0"])
def test_records_of_a_block_are_those_of_single_runs(required, many, tmp_path, monkeypatch):
    """Field by field, the judgement of runs at once is that of each alone, series and detail too.

    In blocks of three, the last of which is not full.
    """
    monkeypatch.setattr(flights, "BLOCK_RUNS", 3)
    loaded = small(tmp_path, SMALL.replace("[windows]", f"[windows]\n{required}", 1))
    results = ran(tmp_path, labels=("ekf", many), runs=7, scenario=loaded)
    found = records(results)
    assert len(found) == 2 * 2 * 7
    for (case, label, run), single in found.items():
        if label != "ekf":
            continue
        block = found[case, many, run]
        assert block["map_evaluations"] == 7
        assert_close(
            *({k: v for k, v in r.items() if k not in OF_THE_ESTIMATOR} for r in (single, block))
        )
        assert results.series_of(case, many, run) == pytest.approx(
            results.series_of(case, "ekf", run), rel=1e-5, nan_ok=True
        )
        info = block["info"]["first"]
        flight = flights.flight_of(loaded.case(case))
        assert info == pytest.approx(simulate(flight, 5, run)[0].measurements[0, 0])
    assert results.detail("base", many, 0) == pytest.approx(
        results.detail("base", "ekf", 0), rel=1e-5, abs=1e-6, nan_ok=True
    )
    pairs = results.pairs()
    assert (pairs["runs"] == 7).all()


def test_a_block_is_all_that_there_is_to_write(many, tmp_path):
    """An estimator that knows only blocks takes one run like any other, or says why it cannot."""
    problem, _ = simulate(flights.flight_of(small(tmp_path).cases[0]), 5, 0)
    estimator, rng = choose(many).estimator, np.random.default_rng(0)
    assert estimator.skip(problem) is None
    found = estimator.estimate(problem, rng)
    assert found.info == {"map_evaluations": 7, "first": problem.measurements[0, 0]}
    expected = choose("ekf").estimator.estimate(problem, rng)
    np.testing.assert_allclose(found.mean, expected.mean, rtol=1e-12)
    reason = "a compiled engine needs the model of ggbench, not LinearModel"
    assert estimator.skip(linear_problem(seed=0)) == reason
    with pytest.raises(TypeError, match=reason):
        estimator.estimate(linear_problem(seed=0), rng)


def test_innovations_that_an_engine_delivers_are_those_of_the_record(many, tmp_path):
    """A NIS that comes with the estimates is averaged over the epochs that have one."""
    label = f"{many}[way=nis]"
    results = ran(tmp_path, labels=(label,), runs=2)
    for record in results.records():
        assert [record[f"{w}_nis"] for w in ("whole", "settled")] == [3.0, 3.0]
    assert np.isnan(results.series("base", label)[:, :2, 3]).all()


@thinned(
    ("way", "reason"),
    [
        ("nan mean", "ValueError: the estimate's mean is not finite from epoch 3 on"),
        ("nan cov", "ValueError: the estimate's cov is not finite from epoch 5 on"),
        ("indefinite", "ValueError: the estimate's cov is not positive definite at epoch 4"),
        ("raise", "ArithmeticError: not this one"),
    ],
    every=4,
)
def test_a_run_that_fails_in_a_block_fails_alone(way, reason, many, tmp_path):
    """What is wrong with one run is its record; the runs beside it are as if it were not."""
    options = {"runs": 6, "cases": ("base",)}
    good = records(ran(tmp_path, "good", labels=(many,), **options))
    label = f"{many}[way={way}]"
    found = records(ran(tmp_path, "bad", labels=(label,), **options))
    failed = [run for _, _, run in found if found["base", label, run]["status"] != "ok"]
    assert [found["base", label, run]["reason"] for run in failed] == [reason]
    for run in set(range(6)) - set(failed):
        assert_close(
            {k: v for k, v in found["base", label, run].items() if k not in OF_THE_ESTIMATOR},
            {k: v for k, v in good["base", many, run].items() if k not in OF_THE_ESTIMATOR},
        )


@thinned(
    ("way", "reason"),
    [
        ("nothing", r"TypeError: estimate_block\(\) must return EstimateBlock, not NoneType"),
        ("batch", "the estimate is 'batch' with lag None, but the estimator declares 'filter'"),
        ("short", r"the estimate's mean has shape \(0, 20, 15\), not \(1, 20, 15\)"),
        ("no count", "the estimate's info has no map_evaluations"),
        ("masked nis", "the estimate's nis is masked in 3 of 20 places"),
        ("masked info", "the estimate's info repairs is masked in 1 of 1 places"),
        (
            "complex",
            "the entry remark of the estimate's info must be a number or a text for each run",
        ),
    ],
)
def test_an_engine_that_does_not_keep_to_the_interface_is_told(way, reason, many, tmp_path):
    """Whatever an estimate of many runs lacks is the reason in the records of all of them."""
    results = ran(tmp_path, labels=("ins", f"{many}[way={way}]"), runs=2, cases=("base",))
    statuses = [r["status"] for r in results.records()]
    assert statuses == ["ok"] * 2 + ["failed"] * 2
    for record in list(results.records())[2:]:
        with pytest.raises(ValueError, match=reason):
            raise ValueError(record["reason"])


@pytest.mark.long
@pytest.mark.parametrize(
    ("way", "reason"),
    [
        ("exit", "its process ended with exit code 7, twice"),
        ("sleep", "over its time limit of 20 s"),
    ],
)
def test_a_death_in_a_block_costs_its_own_run_only(way, reason, many, tmp_path):
    """A run that takes its process with it, or never ends, is a record; its block is not.

    What runs at once may take no longer than one run; too slow together, they run one by one: each
    of the others has its result.
    """
    label = f"{many}[way={way}]"
    options = {"runs": 6, "cases": ("base",), "jobs": 1, "limit": 20.0}
    results = ran(tmp_path, labels=(label, "ins"), **options)
    table = results.runs()
    assert len(table) == 12
    assert (table.loc[table["estimator"] == "ins", "status"] == "ok").all()
    failed = table[table["status"] != "ok"]
    assert failed["reason"].tolist() == [reason]


@pytest.mark.long
def test_an_interrupted_block_goes_on_with_the_runs_that_are_missing(many, tmp_path, monkeypatch):
    """Runs that are stored are not run again, whichever they are, and the end is the same."""
    labels = ("filterpy-ekf", many)
    whole = ran(tmp_path, "whole", labels=labels, runs=8)
    folder = ran(tmp_path, "parts", labels=labels, runs=8)
    folder.store.close()
    with sqlite3.connect(folder.folder / "records.sqlite") as connection:
        connection.execute("DELETE FROM records WHERE run IN (1, 4, 5)")
    connection.close()
    work = plan(tmp_path, "parts", labels, runs=8)
    store, _ = work.open()
    tasks = work.tasks(store)
    assert tasks.results == work.missing(store) == 2 * 2 * 3
    blocks = [list(task.runs) for task in tasks if task.estimators[0][0] == many]
    assert blocks == [[1, 4, 5]] * 2
    assert {len(task.runs) for task in tasks if task.estimators[0][0] == "filterpy-ekf"} == {1}
    ran_runs = []
    real = flights.simulate_block

    def seen(flight, seed, runs):
        ran_runs.append(list(runs))
        return real(flight, seed, runs)

    monkeypatch.setattr(flights, "simulate_block", seen)
    running.execute(execution.in_process(tasks), store, lambda batch: None)
    assert [runs for runs in ran_runs if len(runs) > 1] == [[1, 4, 5]] * 2
    assert work.missing(store) == 0
    assert_equal(Results(store.folder, store), whole)


@pytest.mark.long
def test_blocks_do_not_depend_on_the_number_of_processes(many, tmp_path):
    """Runs at once, in this process or in two others: the same bits."""
    options = {"labels": ("ins", many), "runs": 20}
    assert_equal(ran(tmp_path, "one", **options), ran(tmp_path, "two", jobs=2, **options))


def test_time_series_are_kept_of_the_first_runs(many, tmp_path, monkeypatch):
    """However many runs there are, figures over time are made of the first; tables of all."""
    monkeypatch.setattr(kept, "SERIES_RUNS", 3)
    results = ran(tmp_path, labels=("ekf", many), runs=5)
    for label in ("ekf", many):
        assert len(results.series("base", label)) == 3
        assert results.series_of("base", label, 3) is None
    assert (results.metrics()["runs"] == 5).all()


DICE = """
from dataclasses import dataclass
import numpy as np
from ggbench.block import BlockEstimator, EstimateBlock


@dataclass(frozen=True)
class Dice(BlockEstimator):
    sides: int = 6
    name = "dice"
    causality = "filter"
    exact_if_linear_gaussian = False

    def estimate_block(self, block, rngs=()):
        mean = np.zeros((block.runs, block.epochs, block.dimension))
        cov = np.broadcast_to(block.prior_cov, (*mean.shape, block.dimension))
        thrown = [rng.random() for _, rng in zip(range(block.runs), rngs, strict=True)]
        info = {"map_evaluations": np.zeros(block.runs, dtype=int), "thrown": np.array(thrown)}
        return EstimateBlock(mean, cov, "filter", info=info)
"""


@pytest.fixture
def dice(tmp_path, monkeypatch) -> str:
    """The file of an estimator that takes many runs at once and draws a number for each."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "dice.py").write_text(DICE)
    return "dice.py"


def thrown(results: Results, label: str) -> dict[tuple[str, int], float]:
    """What each (case, run) has drawn."""
    found = records(results).items()
    return {(case, run): r["info"]["thrown"] for (case, name, run), r in found if name == label}


def test_what_a_run_of_a_block_draws_depends_on_nothing_but_the_run(dice, tmp_path, monkeypatch):
    """Seed, run and estimator alone choose a run's numbers: not its block, nor coming alone."""
    whole = thrown(ran(tmp_path, "whole", labels=(dice,), runs=5), dice)
    assert len(set(whole.values())) == 5  # of each run others; both cases fly with the same
    monkeypatch.setattr(flights, "BLOCK_RUNS", 2)
    assert thrown(ran(tmp_path, "pairs", labels=(dice,), runs=5), dice) == whole
    choice = choose(dice)
    problem, _ = simulate(flights.flight_of(small(tmp_path).cases[0]), 5, 3)
    alone = choice.estimator.estimate(problem, runner.estimator_rng(5, 3, choice))
    assert alone.info["thrown"] == whole["base", 3]
    other = f"{dice}[sides=20]"
    assert not set(thrown(ran(tmp_path, "other", labels=(other,), runs=5), other).values()) & set(
        whole.values()
    )


def test_a_block_that_draws_asks_for_as_many_generators_as_runs(dice, tmp_path):
    """A generator too few would be a run without randomness of its own."""
    block = flights.simulated(small(tmp_path).cases[0], 5, (0, 1)).block
    estimator = choose(dice).estimator
    assert not estimator.exact_if_linear_gaussian
    with pytest.raises(ValueError, match="zip"):
        estimator.estimate_block(block, [np.random.default_rng(0)])
