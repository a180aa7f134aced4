"""The gradiometer: tensors in inertial axes, the measurement model and its Jacobian, the noise."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from frame_oracles import local_axes, metres, square
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from ggbench.gravity import ellipsoid
from ggbench.gravity.field import Field, OutsideMapError
from ggbench.sensors.aiding import Motion
from ggbench.sensors.gradiometer.instrument import (
    COMPONENTS,
    Gradiometer,
    inertial_from_local,
    noise_rms,
    parse_components,
    readings,
    rotate_tensors,
)
from ggbench.sensors.gradiometer.lowpass import prefilter
from ggbench.sensors.model import (
    NO_MAP,
    AidingChannels,
    DelayedInsSolution,
    SensorModel,
    model_arrays,
)
from ggbench.simulation.error_free_flight import Flight
from ggbench.simulation.runs import simulate

LOST = np.array([3e5, -3e5, 1e4])  # a position error [m] that leads out of the map
TREATMENTS = {
    "unfiltered": ("none", "whitened"),
    "whitened": ("butterworth", "whitened"),
    "delayed": ("butterworth", "delayed"),
}


@pytest.fixture(scope="module", params=list(TREATMENTS))
def chain(request, wang) -> tuple[Flight, object, object]:
    """A flight, a problem and its truth for each treatment of the filter."""
    kind, treatment = TREATMENTS[request.param]
    spec = wang.case.gradiometer.model_copy(update={"filter": kind, "filter_treatment": treatment})
    flight = dataclasses.replace(wang, case=wang.case.model_copy(update={"gradiometer": spec}))
    return flight, *simulate(flight, seed=1, run=0)


def plain_model(field: Field, positions: np.ndarray, times: np.ndarray, components=COMPONENTS):
    """The model of an unfiltered gradiometer whose state is the position error alone, (3,) [m]."""
    count = len(times)
    level, still = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    return SensorModel(
        model_arrays(
            field,
            Gradiometer(0.01, None, components),
            times,
            Motion(positions, still, level),
            DelayedInsSolution(
                np.zeros(count), positions, level, np.tile(np.eye(6, 3), (count, 1, 1))
            ),
            prefilter(None, count, "whitened", 0.0),
            missing=np.zeros(count, dtype=bool),
            at=np.arange(count),
            others=AidingChannels(
                np.zeros((count, 0)), np.zeros((count, 0, 3)), np.zeros((count, 0, 3)), NO_MAP
            ),
            states=[],
            whitening=None,
        )
    )


def world(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions all over the Earth, and times of a day."""
    rng = np.random.default_rng(seed)
    low, high = [-1.4, -3.1, 0.0], [1.4, 3.1, 30e3]
    return rng.uniform(low, high, (count, 3)), rng.uniform(0.0, 86164.0, count)


def numeric_jacobian(model, k: int, state: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Central differences of fourth order: a step of a metre, small against the map's cells."""
    columns = []
    for axis, step in enumerate(steps):
        unit = step * np.eye(len(state))[axis]
        near = model.predict(k, state + unit) - model.predict(k, state - unit)
        far = model.predict(k, state + 2.0 * unit) - model.predict(k, state - 2.0 * unit)
        columns.append((8.0 * near - far) / (12.0 * step))
    return np.stack(columns, axis=-1)


# Tensors in rotating axes.


def test_rotate_tensors_is_a_rotation():
    """C M Cᵀ keeps trace, norm and eigenvalues, and is what its definition says (D6)."""
    rng = np.random.default_rng(1)
    for _ in range(50):
        tensor = 1e3 * rng.normal(size=6)
        rotation = Rotation.from_quat(rng.normal(size=4)).as_matrix()
        out = rotate_tensors(rotation, tensor)
        before, after = square(tensor), square(out)
        np.testing.assert_allclose(after, rotation @ before @ rotation.T, atol=1e-11)
        assert np.trace(after) == pytest.approx(np.trace(before), abs=1e-11)
        np.testing.assert_allclose(
            np.linalg.eigvalsh(after), np.linalg.eigvalsh(before), rtol=0.0, atol=1e-10
        )
        back = rotate_tensors(rotation.T, out)
        np.testing.assert_allclose(back, tensor, rtol=0.0, atol=1e-11)


def test_inertial_axes_coincide_with_ecef_at_time_zero():
    """C_in takes the local vertical to where it points in space; later the earth has turned."""
    positions, times = world(20, seed=2)
    level = np.stack([local_axes(latitude, longitude) for latitude, longitude, _ in positions])
    found = inertial_from_local(positions, np.zeros(20))
    np.testing.assert_allclose(found, level, atol=1e-15)
    turned = Rotation.from_rotvec(np.outer(ellipsoid.ROTATION_RATE * times, [0.0, 0.0, 1.0]))
    found = inertial_from_local(positions, times)
    np.testing.assert_allclose(found, turned.as_matrix() @ level, atol=1e-14)


def test_a_fixed_point_reads_the_same_after_a_sidereal_day():
    """The earth turns once against the platform in 2π/ω; a few hours later nothing is as before."""
    positions, times = world(20, seed=3)
    field = Field.normal()
    now = readings(field, positions, times)
    day = 2.0 * np.pi / ellipsoid.ROTATION_RATE
    np.testing.assert_allclose(readings(field, positions, times + day), now, rtol=0.0, atol=1e-8)
    hours = readings(field, positions, times + 3 * 3600.0)
    assert (np.abs(hours - now).max(axis=1) > 10.0).all()


def test_only_the_sum_of_longitude_and_earth_rotation_is_seen_in_the_normal_field():
    """A zonal field looks from the next meridian as it will look from here a little later."""
    positions, times = world(20, seed=4)
    later = times + 600.0
    east = positions + np.array([0.0, 600.0 * ellipsoid.ROTATION_RATE, 0.0])
    np.testing.assert_allclose(
        readings(Field.normal(), positions, later),
        readings(Field.normal(), east, times),
        rtol=0.0,
        atol=1e-8,
    )


def test_readings_outside_the_map_are_refused(wang):
    """Truth that leaves the map is an error, not an extrapolation."""
    positions = wang.trajectory.positions[wang.epochs][:2].copy()
    positions[1, 2] = 20e3
    with pytest.raises(OutsideMapError):
        readings(wang.field, positions, np.zeros(2))


# The measurement model.


def test_jacobian_all_over_the_world():
    """H is the slope of h for all components, anywhere, at any time, however large the error.

    The frame's turn (3e-4 E/m from the 4600 E between up and level) is part of it.
    """
    positions, times = world(100, seed=5)
    model = plain_model(Field.normal(), positions, times)
    errors = np.random.default_rng(6).normal(size=(100, 3)) * [2e3, 2e3, 500.0]
    for k, error in enumerate(errors):
        numeric = numeric_jacobian(model, k, error, np.array([200.0, 200.0, 200.0]))
        # Rounding of 3000 E over 200 m; H is 1e-3 E/m.
        np.testing.assert_allclose(model.jacobian(k, error), numeric, rtol=0.0, atol=2e-10)


def test_jacobian_in_the_map(chain):
    """H is the slope of h in all 15 states, behind filter and treatment, delays included."""
    flight, problem, _ = chain
    rng = np.random.default_rng(7)
    largest = 0.0
    for k in [0, 3, 6, 7, 8, 50, *rng.integers(9, 200, 20)]:
        jacobian = problem.model.jacobian(k, np.zeros(15))
        sizes = np.array([300.0] * 3 + [1.0] * 3 + [1e-3] * 3 + [1e-6] * 3 + [1e-2] * 3)
        state = sizes * rng.normal(size=15)
        # Steps that move the delayed position by about a metre; columns without effect: any step.
        effect = np.abs(problem.model.arrays.rows[k]).max(axis=0)
        steps = 1.0 / np.where(effect > 1e-12, effect, 1.0)
        jacobian = problem.model.jacobian(k, state)
        numeric = numeric_jacobian(problem.model, k, state, steps)
        np.testing.assert_allclose(jacobian * steps, numeric * steps, rtol=0.0, atol=1e-8)
        largest = max(largest, np.abs(jacobian[:, :3]).max())
        assert jacobian.shape == (len(flight.true.gradiometer.components), 15)
    assert largest > 1e-3


def test_model_at_the_true_error_is_the_true_reading(wang_unfiltered):
    """Without a filter h(k, true error) is the noise-free reading, to rounding.

    So the sign of the error, its metres and the time of the rotation are those of the simulation.
    """
    flight = wang_unfiltered
    problem, truth = simulate(flight, seed=1, run=0)
    predicted = np.array([problem.model.predict(k, x) for k, x in enumerate(truth.error_state)])
    worst = np.abs(predicted - flight.noise_free).max()
    print(f"model at the truth: {worst:.1e} E")
    assert worst < 1e-8
    without = np.array([problem.model.predict(k, np.zeros(15)) for k in range(problem.epochs)])
    assert np.abs(without - flight.noise_free).max() > 0.01


def test_model_at_the_true_error_explains_the_filtered_output(chain):
    """Behind the filter, what h leaves unexplained of a noise-free run is small against the noise.

    The delay and gain of slow signals stand for the filter's whole response: good to 0.01 σ rms
    and to 0.05 σ in the worst reading.
    """
    flight, problem, truth = chain
    spec = flight.case.gradiometer
    noise_free = flight.noise_free
    if flight.true.gradiometer.lowpass is not None:
        treatment = prefilter(
            flight.true.gradiometer.lowpass,
            problem.epochs,
            spec.filter_treatment,
            spec.whitening_regularization,
        )
        noise_free = treatment.apply(flight.true.gradiometer.lowpass.apply(noise_free))
    predicted = np.array([problem.model.predict(k, x) for k, x in enumerate(truth.error_state)])
    unexplained = (predicted - noise_free) / flight.true.gradiometer.noise_eotvos
    print(
        f"{np.sqrt((unexplained**2).mean()):.1e} σ rms, {np.abs(unexplained).max():.1e} σ at most"
    )
    assert np.sqrt((unexplained**2).mean()) < 0.01
    assert np.abs(unexplained).max() < 0.05


@pytest.mark.parametrize("shape", [(), (1,), (7,), (2, 3), (2, 1, 2), (0,)])
def test_predict_takes_any_leading_axes(chain, shape):
    """Sigma points, particles and search grids in one call give what each gives alone."""
    _, problem, _ = chain
    states = np.random.default_rng(8).normal(size=(*shape, 15)) * np.sqrt(
        np.diag(problem.prior_cov)
    )
    together = problem.model.predict(60, states)
    assert together.shape == (*shape, 6)
    for index in np.ndindex(shape):
        np.testing.assert_array_equal(together[index], problem.model.predict(60, states[index]))
    # A view that is not contiguous is as good.
    if len(shape) == 2:
        np.testing.assert_array_equal(
            problem.model.predict(60, states.swapaxes(0, 1)), together.swapaxes(0, 1)
        )


def test_component_subset(wang):
    """An instrument with fewer components delivers those of the full one, in the standard order."""
    positions, times = wang.trajectory.positions[wang.epochs], wang.times
    full = plain_model(wang.field, positions, times)
    names = parse_components(["zz", "xy"])
    assert names == ("xy", "zz")
    part = plain_model(wang.field, positions, times, names)
    state = np.array([100.0, -50.0, 20.0])
    for k in (0, 99):
        np.testing.assert_array_equal(part.predict(k, state), full.predict(k, state)[[1, 5]])
        np.testing.assert_array_equal(part.jacobian(k, state), full.jacobian(k, state)[[1, 5]])
    noisy = {
        components: Gradiometer(0.01, None, components).noise(200, np.random.default_rng(9))
        for components in (COMPONENTS, names)
    }
    np.testing.assert_array_equal(noisy[names], noisy[COMPONENTS][:, [1, 5]])


def test_a_lost_state_has_a_number_or_none():
    """Far beyond the map h stays finite; a state that is not a number has no reading."""
    positions, times = world(1, seed=10)
    model = plain_model(Field.normal(), positions, times)
    assert np.isfinite(model.predict(0, LOST)).all()
    for axis in range(3):
        error = np.zeros(3)
        error[axis] = np.nan
        assert np.isnan(model.predict(0, error)).any()


def test_a_lost_state_in_a_map(wang):
    """The same with a map, whose border is continued."""
    model = plain_model(wang.field, wang.trajectory.positions[wang.epochs], wang.times)
    assert np.isfinite(model.predict(5, LOST)).all()
    assert np.isfinite(model.jacobian(5, LOST)).all()
    for axis in range(3):
        error = np.zeros(3)
        error[axis] = np.nan
        assert np.isnan(model.predict(5, error)).any()


def test_displacement_is_linear_in_metres_at_the_reference():
    """The model of an error of some metres is the reading at the point so many metres away."""
    positions, times = world(20, seed=11)
    model = plain_model(Field.normal(), positions, times)
    error = np.array([30.0, -20.0, 10.0])
    moved = np.array([p - np.linalg.solve(metres(p), error) for p in positions])
    expected = readings(Field.normal(), moved, times)
    actual = np.array([model.predict(k, error) for k in range(20)])
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=1e-9)


# Noise.


def test_noise_rms_of_a_density():
    """Eq. 1: white noise of density D, sampled at f, has the power D² f/2 (one-sided)."""
    assert noise_rms(2.0, 1.0) == pytest.approx(np.sqrt(2.0))
    # From the physics: white noise of RMS σ at rate f spreads σ² over 0..f/2.
    rate, rms = 4.0, 0.03
    noise = rms * np.random.default_rng(12).normal(size=2**16)
    power = np.abs(np.fft.rfft(noise)) ** 2 * 2.0 / (rate * len(noise))
    assert noise_rms(np.sqrt(power[1:-1].mean()), rate) == pytest.approx(rms, rel=0.02)


def test_output_noise_has_the_stated_rms(wang):
    """Noise of the unfiltered output is white, of the stated RMS, alike in all components.

    Chi-square with a false-alarm probability of 1e-3 over all, and per component.
    """
    instrument = Gradiometer(0.01, None)
    rng = np.random.default_rng(13)
    noise = np.array([instrument.noise(len(wang.noise_free), rng) for _ in range(50)]).reshape(
        -1, 6
    )
    white = noise / 0.01
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], white.size)
    assert low < (white**2).sum() < high
    low, high = chi2.ppf([1e-4, 1.0 - 1e-4], len(white))
    each = (white**2).sum(axis=0)
    assert ((low < each) & (each < high)).all()
    correlation = np.corrcoef(white.T) - np.eye(6)
    assert np.abs(correlation).max() < 4.5 / np.sqrt(len(white))
    successive = (white[1:] * white[:-1]).mean(axis=0)
    assert np.abs(successive).max() < 4.5 / np.sqrt(len(white))
