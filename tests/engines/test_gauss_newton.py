"""The compiled Gauss–Newton from many starts beside NumPy's: the same minima, however found."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from oracles import reference
from problems import entangled

from ggbench.block import EstimateBlock, ProblemBlock, block_of
from ggbench.campaign.registry import choose
from ggbench.numerics.frozen import read_only
from ggbench.simulation import error_free_flight
from ggbench.simulation.runs import simulate_block
from ggbench.spec import scenario

pytestmark = pytest.mark.long  # to compile it takes ten times as long as to run it

COMPILED = choose("gauss-newton").estimator
DELAYED = "wang2013", "delayed"
"""A low-pass that is taken as a fixed delay: readings of where the sensor was."""
COLOURED = "fosterville2019", "coloured"
EPOCHS = 60
"""Epochs of a flight that are looked at: a third of a run's time, and as many searches."""


@cache
def block_of_runs(name: str, case: str, runs: int, epochs: int = EPOCHS) -> ProblemBlock:
    loaded = scenario.load(name)
    if (name, case) == DELAYED:
        filtered = loaded.case("0.01E-1Hz")
        gradiometer = filtered.gradiometer.model_copy(update={"filter_treatment": "delayed"})
        found = filtered.model_copy(update={"gradiometer": gradiometer})
    else:
        found = loaded.case(case)
    flight = error_free_flight.prepare(found)
    return simulate_block(flight, 4, range(runs))[0].until(epochs)


def assert_numpy_agrees(
    block: ProblemBlock, found: EstimateBlock, limit: float, **settings
) -> None:
    """The same cost, as many steps from as many starts, moments in the prior's deviations."""
    sigma = np.sqrt(np.diag(block.prior_cov))
    oracle = reference("gauss-newton", **settings)
    for run in range(block.runs):
        expected = oracle.estimate(block.problem(run))
        one = found.estimate(run)
        for key in ("refined", "converged"):
            assert one.info[key] == expected.info[key]
        assert one.info["cost"] == pytest.approx(expected.info["cost"], rel=1e-9, abs=1e-6)
        # A last step that changes the cost by less than rounding may be one engine's alone.
        assert abs(one.info["iterations"] - expected.info["iterations"]) <= expected.info["refined"]
        assert np.abs((one.mean - expected.mean) / sigma).max() < limit
        assert np.abs((one.cov - expected.cov) / np.outer(sigma, sigma)).max() < limit


@pytest.mark.parametrize(
    ("name", "case"),
    [
        ("wide_prior", "1km"),
        ("wide_prior", "10km"),  # hundreds of halvings
        DELAYED,
        ("jacksboro_helicopter", "strapdown"),
        ("jacksboro_helicopter", "rotating-biases"),
        ("gnss_outage", "all"),  # other sensors, with gaps
        ("gnss_outage", "gravimeter"),
        ("ship", "1E-lost"),
        ("ship_strategic", "states"),
    ],
)
def test_numpy_finds_the_same_minimum(name, case):
    """In every one constant states have no noise: Q is singular."""
    block = block_of_runs(name, case, 2)
    assert_numpy_agrees(block, COMPILED.estimate_block(block), 1e-4)


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_with_a_loss_numpy_finds_the_same_minimum(loss):
    """Among outliers, where the minimum without one is another."""
    block = block_of_runs("outliers", "outliers-20pc", 2)
    found = dataclasses.replace(COMPILED, loss=loss).estimate_block(block)
    assert_numpy_agrees(block, found, 1e-4, loss=loss)
    plain = COMPILED.estimate_block(block)
    assert np.abs((plain.mean - found.mean) / np.sqrt(np.diag(block.prior_cov))).max() > 1e-2


@pytest.mark.parametrize(
    "settings",
    [
        {"starts": 1},
        {"window": 0, "refine": 2},
        {"max_iterations": 1},  # a covariance that is not yet that of the minimum
        {"max_iterations": 3, "refine": 1, "spacing_m": 700.0},
        # Screened and halved with a loss, and cut short before minima are the same however found.
        {"max_iterations": 4, "refine": 3, "window": 0, "loss": "huber"},
        {"max_iterations": 4, "refine": 1, "window": 0, "loss": "cauchy", "threshold": 0.5},
    ],
)
def test_what_is_asked_for_is_what_numpy_does(settings):
    block = block_of_runs("wide_prior", "10km", 1)
    found = dataclasses.replace(COMPILED, **settings).estimate_block(block)
    assert_numpy_agrees(block, found, 1e-6, **settings)


def test_of_any_prior_and_any_noise_numpy_finds_the_same_minimum():
    """A mean that is not zero, and states and channels that correlate."""
    block = entangled(block_of_runs("wide_prior", "1km", 1))
    assert_numpy_agrees(block, COMPILED.estimate_block(block), 1e-4)


def test_a_run_does_not_depend_on_its_neighbours():
    """Alone and among others, of which one has its first readings later: the same bits."""
    block = block_of_runs("wide_prior", "10km", 3)
    gain, offset = block.model.gain.copy(), block.model.offset.copy()
    measurements, present = block.measurements.copy(), block.present.copy()
    for array in (gain, offset, measurements, present):
        array[1, :7] = 0
    model = dataclasses.replace(block.model, gain=read_only(gain), offset=read_only(offset))
    odd = dataclasses.replace(block, measurements=measurements, present=present, model=model)
    together = COMPILED.estimate_block(odd)
    assert together.info["refined"].min() > 6  # the window of each says something
    for run in range(3):
        alone = COMPILED.estimate_block(block_of(odd.problem(run)))
        np.testing.assert_array_equal(alone.mean[0], together.mean[run])
        np.testing.assert_array_equal(alone.cov[0], together.cov[run])
        for key, values in alone.info.items():
            assert values[0] == together.info[key][run]
    assert_numpy_agrees(odd, together, 1e-4)


@pytest.mark.parametrize(("name", "case"), [("gnss_outage", "all"), COLOURED])
def test_a_part_of_a_block_is_those_epochs_of_each_run(name, case):
    """With the mean and the covariance that it is given; coloured readings look back beyond it."""
    block = block_of_runs(name, case, 2)
    sigma = np.sqrt(np.diag(block.prior_cov))
    part, cov = block.part(7, 20, sigma, 2.0 * block.prior_cov), 2.0 * block.prior_cov
    for run in range(2):
        found, problem = part.problem(run), block.problem(run)
        for name in ("times", "measurements", "transition", "process_cov", "present"):
            np.testing.assert_array_equal(getattr(found, name), getattr(problem, name)[7:20])
        np.testing.assert_array_equal(found.prior_mean, sigma)
        np.testing.assert_array_equal(found.prior_cov, cov)
        np.testing.assert_array_equal(found.track.positions, problem.track.positions[7:20])
        for k in range(13):
            np.testing.assert_array_equal(found.noise_of(k), problem.noise_of(k + 7))
            for of in ("predict", "jacobian"):
                expected = getattr(problem.model, of)(k + 7, sigma)
                np.testing.assert_array_equal(getattr(found.model, of)(k, sigma), expected)


def test_a_block_of_one_run_knows_where_the_map_ends():
    """What a window's search needs of a problem beside its arrays."""
    problem = block_of_runs("wide_prior", "10km", 1).problem(0)
    again = block_of(problem).problem(0)
    assert again.map is problem.map is not None
    for name in ("positions", "velocities", "attitudes"):
        np.testing.assert_array_equal(getattr(again.track, name), getattr(problem.track, name))


def test_a_run_that_has_no_cost_has_no_answer():
    """Where NumPy's has an exception; the other run has its own, bit by bit."""
    block = block_of_runs("wide_prior", "1km", 2)
    measurements = block.measurements.copy()
    measurements[0, 30] = np.nan
    broken = dataclasses.replace(block, measurements=measurements)
    found = COMPILED.estimate_block(broken)
    assert np.isnan(found.mean[0]).all()
    np.testing.assert_array_equal(found.mean[1], COMPILED.estimate_block(block).mean[1])
    with pytest.raises(FloatingPointError, match="every start"):
        reference("gauss-newton").estimate(broken.problem(0))


def test_a_model_without_arrays_is_refused():
    """A measurement model of the user's own: in the words of every compiled engine."""

    class Own:
        def __init__(self, model):
            self.predict, self.jacobian = model.predict, model.jacobian

    problem = block_of_runs("wide_prior", "1km", 1).problem(0)
    own = dataclasses.replace(problem, model=Own(problem.model))
    assert COMPILED.skip(problem) is None
    assert COMPILED.skip(own) == "a compiled engine needs the model of ggbench, not Own"
