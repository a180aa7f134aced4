"""Simulated runs: repeatable, paired between cases, statistically what they claim, and tight."""

from __future__ import annotations

import dataclasses
import functools
import types
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from paper_flights import flight
from scipy.stats import chi2
from small_cases import QUIET, small_flight
from thinning import thinned

from ggbench.problem import Problem
from ggbench.sensors.gradiometer.lowpass import prefilter
from ggbench.simulation.error_free_flight import Flight, prepare
from ggbench.simulation.runs import Truth, simulate
from ggbench.trajectory.truth import Trajectory


def arrays_of(problem: Problem) -> dict[str, np.ndarray]:
    return {k: v for k, v in vars(problem).items() if isinstance(v, np.ndarray)}


def changed(base: Flight, **tables: dict[str, Any]) -> Flight:
    """The same flight with other instruments or errors (nothing that changes the track)."""
    case = base.case
    for table, keys in tables.items():
        case = case.model_copy(update={table: getattr(case, table).model_copy(update=keys)})
    return dataclasses.replace(base, case=case)


# Random numbers.


def test_same_seed_same_everything(wang):
    """Seed and run fix every number of a problem and of its truth, whatever ran before."""
    first, truth = simulate(wang, seed=7, run=3)
    simulate(wang, seed=7, run=4)
    again, truth_again = simulate(wang, seed=7, run=3)
    for name, array in arrays_of(first).items():
        np.testing.assert_array_equal(array, getattr(again, name), err_msg=name)
    np.testing.assert_array_equal(truth.error_state, truth_again.error_state)
    state = truth.error_state[50]
    np.testing.assert_array_equal(first.model.predict(50, state), again.model.predict(50, state))


@pytest.mark.parametrize(("seed", "run"), [(7, 4), (8, 3)])
def test_other_seed_or_run_other_errors(wang, seed, run):
    """Neither two runs of a campaign nor two campaigns share an error source."""
    first, truth = simulate(wang, seed=7, run=3)
    other, other_truth = simulate(wang, seed=seed, run=run)
    assert (truth.error_state[0] != other_truth.error_state[0]).all()
    assert (first.measurements != other.measurements).any(axis=0).all()


def test_cases_share_the_random_numbers_of_what_they_share(wang, wang_unfiltered):
    """Run r has the same INS errors whatever gradiometer flies with it, and noise to scale.

    Differences between cases are then differences between the instruments.
    """
    _, truth = simulate(wang, seed=2, run=5)
    quiet, truth_quiet = simulate(flight("0.001E-1Hz-unfiltered"), seed=2, run=5)
    noisy, _ = simulate(wang_unfiltered, seed=2, run=5)
    slow, truth_slow = simulate(flight("0.01E-0.2Hz"), seed=2, run=5)
    np.testing.assert_array_equal(truth.error_state, truth_quiet.error_state)
    np.testing.assert_array_equal(truth.error_state[4::5], truth_slow.error_state)
    np.testing.assert_array_equal(truth.times[4::5], slow.times)
    noise = noisy.measurements - wang_unfiltered.noise_free
    noise_quiet = quiet.measurements - wang_unfiltered.noise_free
    np.testing.assert_allclose(noise, 10.0 * noise_quiet, rtol=0.0, atol=1e-9)
    assert noise.std() == pytest.approx(0.01, rel=0.1)


def test_other_initial_errors_leave_the_noise_alone(wang_unfiltered):
    """A study of the prior changes the prior and nothing else."""
    wide = changed(wang_unfiltered, initial_error={"position_m": 20.0})
    first, truth = simulate(wang_unfiltered, seed=2, run=6)
    other, other_truth = simulate(wide, seed=2, run=6)
    np.testing.assert_array_equal(first.measurements, other.measurements)
    np.testing.assert_array_equal(truth.error_state[:, 9:], other_truth.error_state[:, 9:])
    np.testing.assert_array_equal(np.sqrt(np.diag(other.prior_cov))[:3], 20.0)
    assert (np.abs(other_truth.error_state[0, :3] / truth.error_state[0, :3]) > 2.0).all()


def test_fixed_biases_have_the_stated_size(wang):
    """With ``fixed`` every bias is one standard deviation, with either sign, never zero."""
    fixed = changed(wang, imu={"biases": "fixed"})
    seen = np.array([simulate(fixed, 1, run)[1].error_state[0, 9:] for run in range(6)])
    gyro, accelerometer = np.radians(0.015) / 3600.0, 500e-6 * 9.80665
    np.testing.assert_allclose(np.abs(seen[:, :3]), gyro, rtol=1e-12)
    np.testing.assert_allclose(np.abs(seen[:, 3:]), accelerometer, rtol=1e-12)
    assert (seen < 0.0).any()
    assert (seen > 0.0).any()


# Statistics.


@pytest.fixture(scope="module")
def short(wang_unfiltered) -> Flight:
    """The first four seconds of the flight: cheap enough for hundreds of runs."""
    truth, epochs = wang_unfiltered.trajectory, wang_unfiltered.epochs[:4]
    count = epochs[-1] + 1
    return dataclasses.replace(
        wang_unfiltered,
        trajectory=Trajectory(
            truth.times[:count],
            truth.dt,
            truth.positions[:count],
            truth.velocities[:count],
            truth.attitudes[:count],
        ),
        delta_angles=wang_unfiltered.delta_angles[: count - 1],
        delta_velocities=wang_unfiltered.delta_velocities[: count - 1],
        epochs=epochs,
        noise_free=wang_unfiltered.noise_free[:4],
    )


SMALL_START = {"position_m": 1e-3, "velocity_mps": 1e-3, "attitude_arcmin": 0.01}
TINY_START = {"position_m": 1e-5, "velocity_mps": 1e-6, "attitude_arcmin": 1e-5}
NO_NOISE = {"gyro_noise_deg_per_sqrt_h": 0.0, "accelerometer_noise_ug_per_sqrt_hz": 0.0}
SOURCES: dict[str, dict[str, Any]] = {
    "all": {},
    "noise": {
        "initial_error": TINY_START,
        "imu": {"gyro_bias_deg_per_h": 1e-6, "accelerometer_bias_ug": 1e-4},
    },
    "biases": {"initial_error": SMALL_START, "imu": {"gyro_bias_deg_per_h": 15.0, **NO_NOISE}},
}


@thinned("source", SOURCES)
def test_errors_are_drawn_from_the_prior(short, source):
    """Initial errors, biases and IMU noise of 300 runs are what prior, Φ and Q say.

    Together, and with one source that drowns the others. At the first and the last epoch: the sum
    of xᵀ P⁻¹ x over the runs against chi-square, and each state's own; false-alarm probability
    1e-3 in each epoch.
    """
    flight, runs = changed(short, **SOURCES[source]), 300
    states, covariances = np.empty((runs, 4, 15)), None
    for run in range(runs):
        problem, truth = simulate(flight, seed=11, run=run)
        states[run] = truth.error_state
        if covariances is None:  # those of the first run serve all: Φ differs by 1e-6
            np.testing.assert_array_equal(problem.prior_mean, 0.0)
            p, covariances = problem.prior_cov, []
            for phi, q in zip(problem.transition, problem.process_cov, strict=True):
                p = phi @ p @ phi.T + q
                covariances.append(p)
    for k in (0, 3):
        scale = np.sqrt(np.diag(covariances[k]))
        root = np.linalg.cholesky(covariances[k] / np.outer(scale, scale))
        white = np.linalg.solve(root, (states[:, k] / scale).T)
        low, high = chi2.ppf([2.5e-4, 1.0 - 2.5e-4], white.size)
        assert low < (white**2).sum() < high
        low, high = chi2.ppf([2.5e-4 / 15, 1.0 - 2.5e-4 / 15], runs)
        each = ((states[:, k] / scale) ** 2).sum(axis=0)
        assert ((low < each) & (each < high)).all(), each / runs


@thinned("treatment", ["none", "whitened", "delayed"])
def test_measurements_scatter_as_the_problem_says(wang, treatment):
    """What h(true error) leaves of z is noise before and behind the filter, after the treatment.

    Its power is that of W F Fᵀ Wᵀ + ρ² W Wᵀ, by a normal approximation of the sum of 18000 squares
    (false-alarm probability 1e-3). The problem claims R = σ² I: exact without a filter, and
    whitened, where ρ is the regularisation by default; delayed, it claims nothing.
    """
    kind = {"none": {"filter": "none"}}.get(treatment, {"filter_treatment": treatment})
    behind = changed(wang, gradiometer=kind)
    runs, total = 15, 0.0
    for run in range(runs):
        problem, truth = simulate(behind, seed=12, run=run)
        for k, state in enumerate(truth.error_state):
            residual = problem.measurements[k] - problem.model.predict(k, state)
            total += residual @ np.linalg.solve(problem.noise_cov, residual)
    spec, lowpass = behind.case.gradiometer, behind.true.gradiometer.lowpass
    power = np.eye(problem.epochs)
    if lowpass is not None:
        treated = prefilter(
            lowpass, problem.epochs, spec.filter_treatment, spec.whitening_regularization
        )
        before, after = (treated.apply(w) for w in (lowpass.apply(power), power))
        rho = behind.true.gradiometer.noise_behind_filter / spec.noise_eotvos
        assert rho == (spec.whitening_regularization if treatment == "whitened" else 0.0)
        power = before @ before.T + rho**2 * (after @ after.T)
    sequences = 6 * runs
    deviation = np.sqrt(2.0 * sequences * (power**2).sum())
    assert abs(total - sequences * np.trace(power)) < 3.3 * deviation
    if treatment != "delayed":
        np.testing.assert_allclose(power, np.eye(problem.epochs), atol=1e-6)
        assert total / (sequences * problem.epochs) == pytest.approx(1.0, abs=0.035)


def test_gravity_disturbance_drives_the_ins(wang):
    """Flown through the real field, the INS, which assumes the normal one, drifts by ½ δg t².

    The vertical disturbance of the site is some 1e-4 m/s²: metres after 200 s, as the map says.
    """
    real = prepare(
        wang.case.model_copy(
            update={"field": wang.case.field.model_copy(update={"gravity_disturbance": True})}
        )
    )
    normal = dataclasses.replace(
        real, delta_velocities=wang.delta_velocities, delta_angles=wang.delta_angles
    )
    drift = simulate(real, 1, 0)[1].error_state - simulate(normal, 1, 0)[1].error_state
    felt = real.field.gravity_disturbance(*real.trajectory.positions[real.epochs].T)
    # The INS attributes the missing gravity to itself: δv' = −δg, integrated twice.
    velocity = -np.cumsum(felt, axis=0)
    expected = np.cumsum(velocity, axis=0)[59]
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(drift[59, :3], expected, atol=0.05 * np.abs(expected).max())


def test_an_altimeter_tells_the_height_of_now():
    """In a climb of 20 m/s an INS without other errors stays within millimetres of the truth."""
    climbing = small_flight(
        QUIET
        | {
            "trajectory.segment": [
                {"kind": "climb", "by_height_m": 300.0, "climb_angle_deg": 5.0},
                {"kind": "cruise", "duration_s": 5.0},
            ],
            "altimeter.noise_m_per_sqrt_hz": 1e-4,
            "altimeter.time_constant_s": 2.0,
        }
    )
    assert climbing.trajectory.velocities[:, 2].max() > 15.0
    _, truth = simulate(climbing, 3, 0)
    assert np.abs(truth.error_state[:, 2]).max() < 0.01


# The wall between estimators and the truth.


@pytest.fixture(scope="module")
def run(wang) -> tuple[Flight, Problem, Truth]:
    return wang, *simulate(wang, seed=1, run=0)


def test_problem_arrays_are_read_only(run):
    """An estimator cannot change the problem for those that come after it."""
    _, problem, _ = run
    for name, array in arrays_of(problem).items():
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0
        assert array.flags.c_contiguous, name
    with pytest.raises(dataclasses.FrozenInstanceError):
        problem.measurements = problem.measurements


def reachable(start: object) -> Iterator[object]:
    """All objects within reach of one: attributes, items, array bases, closures, bound objects.

    Not through classes, modules and the globals of functions, which lead everywhere.
    """
    seen: dict[int, object] = {}
    waiting = [start]
    while waiting:
        item = waiting.pop()
        if id(item) in seen or isinstance(item, (type, types.ModuleType, str, bytes, int, float)):
            continue
        seen[id(item)] = item
        yield item
        waiting += list(getattr(item, "__dict__", {}).values())
        for kind in type(item).__mro__:
            slots = kind.__dict__.get("__slots__", ())
            for slot in (slots,) if isinstance(slots, str) else slots:
                waiting.append(getattr(item, slot, None))
        if isinstance(item, np.ndarray):
            waiting.append(item.base)
            if item.dtype == object:
                waiting += list(item.ravel())
        elif isinstance(item, (dict, types.MappingProxyType)):
            waiting += [*item.keys(), *item.values()]
        elif isinstance(item, (list, tuple, set, frozenset)):
            waiting += list(item)
        elif isinstance(item, types.FunctionType):
            cells = item.__closure__ or ()
            waiting += [cell.cell_contents for cell in cells] + list(item.__defaults__ or ())
            waiting += list((item.__kwdefaults__ or {}).values())
        elif isinstance(item, (types.MethodType, types.BuiltinMethodType)):
            waiting += [item.__self__, getattr(item, "__func__", None)]
        elif isinstance(item, functools.partial):
            waiting += [item.func, *item.args, *item.keywords.values()]


def leaks(problem: Problem, flight: Flight, truth: Truth) -> list[str]:
    """What an estimator could find of the truth behind a problem."""
    at_epochs = flight.trajectory.positions[flight.epochs]
    secrets = {
        "true positions": flight.trajectory.positions,
        "true positions at the epochs": at_epochs,
        "true velocities": flight.trajectory.velocities,
        "true attitudes": flight.trajectory.attitudes,
        "error-free angles": flight.delta_angles,
        "error-free velocities": flight.delta_velocities,
        "error state": truth.error_state,
        "noise-free readings": flight.noise_free,
    }
    # Numbers that occur nowhere else, bit by bit: any array that holds a few has part of a secret.
    fingerprints = {
        "true longitudes": flight.trajectory.positions[1:, 1],
        "errors": truth.error_state,
        "noise-free readings": flight.noise_free,
        "gyro increments": flight.delta_angles,
    }
    fingerprints = {name: set(np.ravel(a).tolist()) - {0.0} for name, a in fingerprints.items()}
    forbidden = (
        Truth,
        Flight,
        Trajectory,
        np.random.Generator,
        np.random.BitGenerator,
        np.random.SeedSequence,
    )
    found = []
    for item in reachable(problem):
        if isinstance(item, forbidden):
            found.append(f"a {type(item).__name__}")
        if not isinstance(item, np.ndarray) or item.dtype.kind not in "fc" or item.size == 0:
            continue
        for name, secret in secrets.items():
            if np.may_share_memory(item, secret):
                found.append(f"memory of the {name}")
            for part in (secret, secret[: len(item)] if item.ndim else secret):
                if item.shape == part.shape and np.allclose(item, part, rtol=1e-9, atol=0.0):
                    found.append(f"a copy of the {name}")
        values = set(item.ravel().tolist())
        for name, numbers in fingerprints.items():
            if name == "errors" and np.may_share_memory(item, problem.track.velocities):
                continue  # where the truth flies level, to the east, the INS indicates its error
            if values & numbers:
                found.append(f"some of the {name}")
    return found


def test_no_path_from_the_problem_to_the_truth(run):
    """Whatever an estimator follows from its Problem, it comes upon no truth and no generator."""
    flight, problem, truth = run
    assert leaks(problem, flight, truth) == []
    # The walk was one: it came through the model to the map and to the INS positions.
    arrays = [item for item in reachable(problem) if isinstance(item, np.ndarray)]
    assert any(item is flight.field.tensor_coefficients for item in arrays)
    references = problem.model.arrays.references
    assert any(item is references for item in arrays)
    # ... which are near the true ones, as an INS is, and not they.
    difference = references[:, :2] - flight.trajectory.positions[flight.epochs, :2]
    assert 0.0 < np.abs(difference).max() < 1e-3


class Holder:
    __slots__ = ("content",)

    def __init__(self, content: object) -> None:
        self.content = content


def with_default(secret: np.ndarray) -> types.FunctionType:
    def function(argument: np.ndarray = secret) -> np.ndarray:
        return argument

    return function


PLANTED = {
    "truth object": lambda f, t: t,
    "flight in a list": lambda f, t: [0, {"x": f}],
    "copy of the errors": lambda f, t: t.error_state.copy(),
    "one column of the errors": lambda f, t: t.error_state[:, 0].copy(),
    "view of the positions": lambda f, t: f.trajectory.positions[::20],
    "base of a view": lambda f, t: f.trajectory.positions.reshape(-1)[:3],
    "readings in a closure": lambda f, t: lambda: f.noise_free,
    "readings in a default": lambda f, t: with_default(f.noise_free[:, :2].copy()),
    "bound method": lambda f, t: t.error_state.mean,
    "bound method of a flight": lambda f, t: f.__eq__,
    "partial": lambda f, t: functools.partial(np.add, t.error_state[5].copy()),
    "slots": lambda f, t: Holder(f.noise_free.copy()),
    "generator": lambda f, t: np.random.default_rng(1),
    "object array": lambda f, t: np.array([None, t], dtype=object),
}


@thinned("plant", PLANTED, every=4)
def test_a_planted_truth_is_found(run, plant):
    """The walk of the test above finds truth in every place where one might hide it."""
    flight, problem, truth = run

    class Model:
        def __init__(self, secret: object) -> None:
            self.honest, self.secret = problem.model, secret

    planted = dataclasses.replace(problem, model=Model(PLANTED[plant](flight, truth)))
    assert leaks(planted, flight, truth) != []
