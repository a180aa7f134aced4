"""The compiled filters: the same answers as filterpy's, whatever other runs there are."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numba
import numpy as np
import pytest
from oracles import reference
from problems import entangled

from ggbench.block import ProblemBlock, block_of
from ggbench.campaign import registry
from ggbench.engines.innovations import innovations_squared
from ggbench.numerics.frozen import read_only
from ggbench.simulation import error_free_flight
from ggbench.simulation.runs import simulate_block
from ggbench.spec import scenario

SEED = 11
CASES = {
    "wang2013": "0.001E-1Hz",  # six channels, three equations
    "jacksboro_drone": "1E",  # close to the masses, where the field bends most
    "jacksboro_helicopter": "rotating-biases",  # 21 states
    "wide_prior": "10km",
}
EPOCHS = {"wide_prior": 4}
"""Epochs compared, if not 40. Ten kilometres off filterpy's UKF multiplies a change of the prior in
its last bit by 1e9 within 40 epochs, so no two implementations stay together for longer."""
GRAVIMETER = "gnss_outage", "gravimeter"
LARGE = "jacksboro_drone", "wide_prior", "gnss_outage"
"""Cases over maps that no other daily test of this file needs."""


def _quick(case: tuple[str, str]) -> Any:
    return pytest.param(case, marks=pytest.mark.long if case[0] in LARGE else ())


STRAPDOWN = "jacksboro_helicopter", "strapdown"
BIASED = "wang2013", "biased"
"""Biases behind a low-pass: gains that are neither one nor zero."""


@functools.cache
def prepared(name: str, case: str) -> ProblemBlock:
    """Three runs of a case, cut off after some epochs."""
    cases = {item.name: item for item in scenario.load(name).cases}
    if (name, case) == BIASED:
        filtered = cases["0.01E-1Hz"]
        gradiometer = filtered.gradiometer.model_copy(update={"bias_eotvos": 0.05})
        cases[case] = filtered.model_copy(update={"gradiometer": gradiometer})
    block, _ = simulate_block(error_free_flight.prepare(cases[case]), SEED, range(3))
    return cut(block, [0, 1, 2], EPOCHS.get(name, 40))


def cut(block: ProblemBlock, runs: list[int], epochs: int) -> ProblemBlock:
    """Some runs of a block, in some order, up to an epoch."""
    # Read-only, as all arrays of a block are: what may be written to is compiled once more.
    model = block.model.mapped(lambda array: read_only(array[runs, :epochs]))
    return ProblemBlock(
        times=block.times[:epochs],
        measurements=block.measurements[runs, :epochs],
        noise_cov=block.noise_cov,
        transition=block.transition[runs, :epochs],
        process_cov=block.process_cov[runs, :epochs],
        prior_mean=block.prior_mean,
        prior_cov=block.prior_cov,
        model=dataclasses.replace(model, times=read_only(block.model.times[:epochs])),
        layout=block.layout,
        present=block.present[runs, :epochs],
    )


def assert_filterpy_agrees(block: ProblemBlock, name: str) -> None:
    """Assert that the compiled filter finds in every run what filterpy's of that name finds.

    To a millionth of the prior. An iterated update ends within a thousandth of a deviation of the
    most probable state, where the last halving of a step is decided by rounding: to a ten
    thousandth. Its covariance, which follows the state's slopes, to two millionths.
    """
    limit = 1e-4 if "iterations" in name else 1e-6
    found = registry.choose(name).estimator.estimate_block(block)
    expected_of = reference(name)
    sigma = np.sqrt(np.diag(block.prior_cov))
    for run in range(block.runs):
        expected = expected_of.estimate(block.problem(run))
        assert np.abs((found.mean[run] - expected.mean) / sigma).max() < limit
        scale = np.outer(sigma, sigma)
        assert np.abs((found.cov[run] - expected.cov) / scale).max() < min(limit, 2e-6)
        nis = innovations_squared(block.problem(run), found.mean[run], found.cov[run])
        np.testing.assert_allclose(found.nis[run], nis, rtol=1e-6)
        if "linearisations" in expected.info:
            assert found.info["linearisations"][run] == expected.info["linearisations"]


ROBUST = (
    "ekf[iterations=5]",
    "ekf[loss=huber]",
    "ekf[iterations=5,loss=cauchy]",
    "ukf[points=cubature,loss=cauchy]",
    "ukf[loss=huber]",
)
ADAPTIVE = (
    "ekf[noise_memory=9]",
    "ekf[iterations=5,noise_memory=9]",
    "ekf[iterations=3,loss=cauchy,noise_memory=9]",
)


def _long(name: str) -> object:
    return pytest.param(name, marks=pytest.mark.long)


COMPILED_APART = [_long(name) for name in (*ROBUST, *ADAPTIVE)]
"""Kernels of their own, which take far longer to compile than to run."""


@pytest.mark.parametrize("name", ["ekf", "ukf", "ukf[points=merwe]", *COMPILED_APART])
@pytest.mark.parametrize(
    "case", [_quick(case) for case in (*CASES.items(), STRAPDOWN, BIASED)], ids="-".join
)
def test_filterpy_gives_the_same_answer(case: tuple[str, str], name: str) -> None:
    assert_filterpy_agrees(prepared(*case), name)


@pytest.mark.parametrize("points", ["julier", "merwe", "cubature"])
def test_filterpy_itself_gives_the_same_answer(points: str) -> None:
    """With nothing of its unscented filter overridden, to a millionth of the prior."""
    block = prepared("wang2013", CASES["wang2013"])
    found = registry.choose(f"ukf[points={points}]").estimator.estimate_block(block)
    framework = registry.choose(f"filterpy-ukf[points={points}]").estimator
    sigma = np.sqrt(np.diag(block.prior_cov))
    expected = framework.estimate(block.problem(0), np.random.default_rng(0))
    assert np.abs((found.mean[0] - expected.mean) / sigma).max() < 1e-6
    assert np.abs((found.cov[0] - expected.cov) / np.outer(sigma, sigma)).max() < 1e-6


@pytest.mark.parametrize("name", ["ekf", "ukf"])
@pytest.mark.parametrize("case", ["wang2013", "jacksboro_helicopter"])  # without biases, and with
def test_of_any_prior_and_any_noise_filterpy_gives_the_same_answer(case: str, name: str) -> None:
    """A mean that is not zero, and states and channels that correlate."""
    assert_filterpy_agrees(entangled(prepared(case, CASES[case])), name)


def test_the_map_is_not_asked_at_points_that_are_next_to_the_mean() -> None:
    """Of a position known to micrometres one evaluation of each epoch is left, that of the mean."""
    block = prepared("wang2013", CASES["wang2013"])
    sure = dataclasses.replace(
        block, prior_cov=1e-14 * block.prior_cov, process_cov=1e-14 * block.process_cov
    )
    found = registry.choose("ukf").estimator.estimate_block(sure)
    assert found.info["map_evaluations"].tolist() == [block.epochs] * block.runs


@pytest.mark.parametrize(
    "case", [_quick(case) for case in (*CASES.items(), GRAVIMETER)], ids="-".join
)
def test_a_run_alone_is_of_the_types_of_a_block(case: tuple[str, str]) -> None:
    """So that kernels are compiled once: with biases, and a gravimeter's, and without."""
    name, label = case
    flight = error_free_flight.prepare(scenario.load(name).case(label))
    block, _ = simulate_block(flight, SEED, range(2))
    assert numba.typeof(block_of(block.problem(1)).model) == numba.typeof(block.model)


ALONE = [
    "ekf",
    "ukf",
    *(_long(name) for name in (*ROBUST[2:4], ADAPTIVE[2])),
]


@pytest.mark.parametrize("name", ALONE)
@pytest.mark.parametrize("case", [("wang2013", "0.001E-1Hz"), STRAPDOWN], ids="-".join)
def test_neighbours_change_no_bit_of_a_run(case: tuple[str, str], name: str) -> None:
    """In a block of eleven the last group is filled up, and each run has other neighbours."""
    block, estimator = prepared(*case), registry.choose(name).estimator
    many = [2, 0, 0, 1, 2, 1, 1, 0, 2, 1, 0]
    whole = estimator.estimate_block(cut(block, many, block.epochs))
    three = estimator.estimate_block(block)
    for run in range(3):
        alone = estimator.estimate_block(cut(block, [run], block.epochs))
        places = [place for place, other in enumerate(many) if other == run]
        for item, one in [(whole, place) for place in places] + [(three, run)]:
            np.testing.assert_array_equal(item.mean[one], alone.mean[0])
            np.testing.assert_array_equal(item.cov[one], alone.cov[0])
            np.testing.assert_array_equal(item.nis[one], alone.nis[0])
            for key, counted in item.info.items():
                assert counted[one] == alone.info[key][0]


@pytest.mark.parametrize("name", ["ekf", "ukf"])
@pytest.mark.parametrize("case", ["wang2013", "jacksboro_helicopter"])  # without biases, and with
def test_a_neighbour_without_readings_or_with_other_dynamics_changes_no_bit(
    case: str, name: str
) -> None:
    """A run whose reading is missing, and one whose constant states wander, beside an ordinary."""
    estimator = registry.choose(f"{name}").estimator
    block = prepared(case, CASES[case])
    gain, offset = block.model.gain.copy(), block.model.offset.copy()
    measurements, process_cov = block.measurements.copy(), block.process_cov.copy()
    linear, present = block.model.linear.copy(), block.present.copy()
    for array in (gain, offset, linear, measurements, present):
        array[1, 5:9] = 0.0
    process_cov[2, 10:] += np.diag(1e-6 * np.diag(block.prior_cov))
    odd = dataclasses.replace(
        block,
        measurements=measurements,
        present=present,
        process_cov=process_cov,
        model=dataclasses.replace(
            block.model,
            gain=read_only(gain),
            offset=read_only(offset),
            linear=read_only(linear),
        ),
    )
    found, usual = estimator.estimate_block(odd), estimator.estimate_block(block)
    np.testing.assert_array_equal(found.cov[0], usual.cov[0])
    np.testing.assert_array_equal(found.mean[0], usual.mean[0])
    turned = estimator.estimate_block(cut(odd, [1, 2, 0], odd.epochs))
    np.testing.assert_array_equal(turned.cov, found.cov[[1, 2, 0]])
    np.testing.assert_array_equal(turned.mean, found.mean[[1, 2, 0]])
    assert np.isnan(found.nis[1, 5:9]).all()
    if name == "ukf":  # where there is no reading, no sigma point looks at the map
        fewer = usual.info["map_evaluations"] - found.info["map_evaluations"]
        assert fewer[0] == 0 and fewer[1] >= 4 * 2 * 3
    assert np.isfinite(found.nis[[0, 2]]).all()
    sigma = np.sqrt(np.diag(block.prior_cov))
    for run in (1, 2):
        expected = reference(name).estimate(odd.problem(run))
        assert np.abs((found.mean[run] - expected.mean) / sigma).max() < 1e-7
        assert np.abs((found.cov[run] - expected.cov) / np.outer(sigma, sigma)).max() < 1e-7


def test_a_neighbour_with_other_points_far_from_its_mean_changes_no_bit() -> None:
    """A run that comes to know all but its position, beside one that needs more of the map."""
    block = prepared(*BIASED)
    transition, process_cov = block.transition.copy(), block.process_cov.copy()
    transition[1, 25:, 3:15] = 0.0
    process_cov[1, 25:, 3:15] = process_cov[1, 25:, :, 3:15] = 0.0
    process_cov[1, 25:, range(3, 15), range(3, 15)] = 1e-10
    odd = dataclasses.replace(block, transition=transition, process_cov=process_cov)
    estimator = registry.choose("ukf").estimator
    beside, alone = (estimator.estimate_block(cut(odd, runs, 40)) for runs in ([0, 1], [1]))
    evaluations = beside.info["map_evaluations"]
    assert evaluations[1] == alone.info["map_evaluations"][0] < evaluations[0]
    np.testing.assert_array_equal(beside.mean[1], alone.mean[0])
    np.testing.assert_array_equal(beside.cov[1], alone.cov[0])


def test_a_covariance_that_is_no_longer_positive_is_repaired_as_filterpys_is() -> None:
    """A centre weight of −14 breaks P where the position is known to 100 m; one run is whole."""
    block = prepared("wide_prior", "0.1km")
    found = registry.choose("ukf[kappa=-14]").estimator.estimate_block(block)
    sigma = np.sqrt(np.diag(block.prior_cov))
    for run in range(block.runs):
        expected = reference("ukf[kappa=-14]").estimate(block.problem(run))
        repairs = expected.info["covariance_repairs"]
        assert found.info["covariance_repairs"][run] == repairs > 0
        assert np.abs((found.mean[run] - expected.mean) / sigma).max() < 1e-6
        assert np.abs((found.cov[run] - expected.cov) / np.outer(sigma, sigma)).max() < 1e-6
