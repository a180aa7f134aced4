"""Runs with tracks and map errors of their own: each is what it is alone, whatever its block."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import TIMINGS, ran, small
from problems import SMALL
from small_cases import rough_map, small_case

from ggbench.block import ProblemBlock, joined
from ggbench.campaign import flights, result_keys
from ggbench.campaign.registry import choose
from ggbench.campaign.runner import Task, run_task
from ggbench.results.database import Result
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.runs import simulate_block
from ggbench.spec.case import CaseSpec

LABELS = ("ins", "ekf", "filterpy-ekf", "factor-graph[mode=fixed-lag,lag=3]")
ERROR = {"truth.field.error.correlated_noise_eotvos": 5.0, "truth.field.error.correlation_km": 2.0}
DRAWN = ERROR | {"draw.tracks": 3, "draw.start_km": 0.5, "draw.heading_deg": 20.0, "draw.maps": 2}


@pytest.fixture(scope="module")
def rough(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A map of 100 E, so that measurements depend on their places."""
    path = Path(tmp_path_factory.mktemp("maps")) / "map.nc"
    return {"field.source": rough_map(path, rms=100.0), "initial_error.position_m": 50.0}


def flown(case: CaseSpec, runs: tuple[int, ...]) -> dict[tuple[str, int], Result]:
    """Results of some runs of a case, by estimator and run."""
    keys = {result_keys.run_key(case, choose(label).content, 5): label for label in LABELS}
    task = Task(case, "", runs, 5, tuple((label, key) for key, label in keys.items()))
    found = [result for step in run_task(task) if isinstance(step, list) for result in step]
    return {(keys[result.key], result.record["run"]): result for result in found}


def facts(result: Result) -> tuple[Any, ...]:
    """A result without its key and what clocks and memory say; arrays as their bytes."""
    record = {key: value for key, value in result.record.items() if key not in TIMINGS}
    arrays = [None if a is None else a.tobytes() for a in (result.series, result.detail)]
    return repr(record), *arrays


def assert_same(found: dict, expected: dict) -> None:
    assert found.keys() == expected.keys()
    for key, result in expected.items():
        assert result.record["status"] == "ok", result.record
        assert facts(found[key]) == facts(result), key


def simulated(case: CaseSpec, runs: tuple[int, ...]) -> ProblemBlock:
    return flights.simulated(case, 5, runs).block


def test_a_run_of_a_block_is_the_run_alone(rough):
    """Bit by bit: its measurements, Φ and Q, and what its model predicts; so are its results."""
    case = small_case(rough | DRAWN)
    runs = (0, 2, 4, 6)  # of one map error, the last of the first one's track
    block = simulated(case, runs)
    states = np.random.default_rng(1).normal(size=(block.epochs, block.dimension))
    for r, run in enumerate(runs):
        one, alone = block.problem(r), simulated(case, (run,)).problem(0)
        for name in (
            "times",
            "measurements",
            "noise_cov",
            "transition",
            "process_cov",
            "prior_mean",
            "prior_cov",
            "present",
        ):
            assert np.array_equal(getattr(one, name), getattr(alone, name)), name
        at = np.arange(block.epochs)
        assert np.array_equal(
            one.model.predict_along(at, states), alone.model.predict_along(at, states)
        )
        assert np.array_equal(
            one.model.jacobian_along(at, states), alone.model.jacobian_along(at, states)
        )
    together = flown(case, (0, 1, 2, 3, 4, 6))
    # Bounds are large: flights that are kept do not keep them, too.
    assert "bound" not in vars(flights.flight_of(case))
    for run in (0, 3, 4):
        assert_same({k: v for k, v in together.items() if k[1] == run}, flown(case, (run,)))


def test_drawn_runs_differ_as_their_draws_do(rough):
    """A negative control: neither tracks nor map errors are those of run 0."""
    case = small_case(rough | DRAWN)
    first, other_track, other_map = (prepare(case.of_run(run)).noise_free for run in (0, 2, 3))
    assert np.abs(first - other_track).max() > 1.0
    assert np.abs(first - other_map).max() > 0.1
    assert np.array_equal(first, prepare(case.of_run(6)).noise_free)


def test_blocks_of_other_maps_are_not_joined(rough):
    """Nor of other epochs; those of other tracks are."""
    case = small_case(rough | DRAWN | {"model.field.error.correlated_noise_eotvos": 5.0})
    blocks = {run: simulate_block(prepare(case.of_run(run)), 5, [run])[0] for run in (0, 1, 2)}
    assert joined([blocks[0], blocks[2]]).runs == 2
    with pytest.raises(ValueError, match="different epochs, maps or gaps cannot be joined"):
        joined([blocks[0], blocks[1]])
    later = dataclasses.replace(blocks[2], times=blocks[2].times + 1.0)
    with pytest.raises(ValueError, match="different epochs, maps or gaps cannot be joined"):
        joined([blocks[0], later])


def test_a_block_never_mixes_maps(rough, monkeypatch):
    """Whatever runs are asked for, and however many a block may have."""
    case = small_case(rough | DRAWN)
    monkeypatch.setattr(flights, "BLOCK_RUNS", 4)
    blocks = [list(runs) for runs in flights.groups_of_runs(case, tuple(range(1, 12)))]
    assert sorted(run for runs in blocks for run in runs) == list(range(1, 12))
    for runs in blocks:
        assert len({run % 2 for run in runs}) == 1 and len(runs) <= 4


def test_results_of_one_map_draw_are_those_of_a_plain_case_with_its_seed(rough):
    """Run 1 and run 4 of three map errors are runs 1 and 4 of the case with the second seed."""
    drawn = small_case(rough | ERROR | {"draw.maps": 3, "truth.field.error.seed": 11})
    plain = small_case(rough | ERROR | {"truth.field.error.seed": 12})
    assert_same(flown(drawn, (1, 4)), flown(plain, (1, 4)))
    other = flown(small_case(rough | ERROR | {"truth.field.error.seed": 11}), (1,))
    assert facts(other["ekf", 1]) != facts(flown(plain, (1,))["ekf", 1])


def test_tables_count_the_draws(tmp_path):
    """Metrics have the number of clusters, runs the number of their own."""
    text = SMALL.replace("[windows]", "[draw]\ntracks = 2\nstart_km = 1.0\n\n[windows]", 1)
    results = ran(tmp_path, labels=("ins", "ekf"), runs=5, scenario=small(tmp_path, text))
    assert (results.metrics()["draws"] == 2).all() and (results.cases()["draws"] == 2).all()
    runs = results.runs()
    assert runs["draw"].tolist() == (runs["run"] % 2).tolist()
