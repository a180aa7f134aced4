"""The rotating gradiometer: signal, demodulation, error budget and noise."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from oracles.rotating_disk import demodulate, reading_times, signal
from oracles.rotating_disk import motion as shaking
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from thinning import thinned

from ggbench.errors import GGBenchError
from ggbench.sensors.gradiometer.rotating import (
    DISK_AXES,
    DISK_TENSOR,
    SPIN_CHANNELS,
    RotatingErrors,
    RotatingGradiometer,
    Vibration,
    centrifugal_channels,
    channel_noise_eotvos,
)
from ggbench.sensors.gradiometer.rotating_budget import channel_errors, error_budget

WHOLE = RotatingGradiometer(0.3, 0.25, 12.0)  # three turns
ODD = RotatingGradiometer(0.4, 0.5, 3.0)  # one turn and a half
VIBRATION = Vibration(
    np.array([[0.3, -0.2, 0.5], [-0.4, 0.6, 0.3], [0.2, 0.4, -0.5]]),
    np.array([[-0.5, 0.3, 0.2], [0.4, 0.2, -0.6], [0.1, -0.3, 0.4]]),
    2e-3,
    -3e-3,
)
SCALARS = [
    entry.name
    for entry in dataclasses.fields(RotatingErrors)
    if entry.name not in ("angular_rate_error", "accelerometer_root_psd")
]


def motion(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A tensor [E], a specific force [m/s²] and an angular rate [rad/s] in disk axes."""
    tensor = np.array([-1530.0, 0.0, 0.0, -1540.0, 0.0, 3070.0]) + rng.normal(0.0, 300.0, 6)
    return tensor, rng.normal(0.0, 6.0, 3), rng.normal(0.0, 0.02, 3)


def read(instrument, errors, tensor, force, rate, vibration=None, samples=6000) -> np.ndarray:
    """The gravitational channels as the instrument reads them, first principles throughout."""
    times = reading_times(instrument, samples)
    added = np.zeros((3, samples, 3))
    if vibration is not None:
        added = np.array(shaking(vibration, instrument, times))
    sum_signal = signal(
        instrument=instrument,
        errors=errors,
        tensor=tensor,
        specific_force=force + added[0],
        angular_rate=rate + added[1],
        angular_acceleration=added[2],
        times=times,
    )
    indicated = rate + np.array(errors.angular_rate_error)
    return demodulate(instrument, sum_signal, times) + centrifugal_channels(indicated)


def simulated_error(instrument, errors, tensor, force, rate, vibration=None) -> np.ndarray:
    """What the errors change in the reading."""
    ideal = read(instrument, RotatingErrors(), tensor, force, rate, vibration)
    return read(instrument, errors, tensor, force, rate, vibration) - ideal


def close(found: np.ndarray, expected: np.ndarray) -> bool:
    """Equal to 1e-3 of the effect, or to 1e-5 E: a sample of 10 m/s² is rounded to 3e-5 E."""
    scale = np.abs(expected).max()
    return bool(np.abs(found - expected).max() <= 1e-3 * scale + 1e-5)


@pytest.mark.parametrize("half_turns", [1, 2, 5, 8, 31])
def test_a_perfect_instrument_at_rest_reads_the_tensor(half_turns):
    instrument = RotatingGradiometer(0.3, 0.25, 2.0 * half_turns)
    tensor, _, _ = motion(np.random.default_rng(half_turns))
    reading = read(instrument, RotatingErrors(), tensor, np.zeros(3), np.zeros(3))
    expected = [(tensor[0] - tensor[3]) / 2.0, tensor[1]]
    np.testing.assert_allclose(reading, expected, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("instrument", [WHOLE, ODD])
def test_a_perfect_instrument_feels_neither_force_nor_angular_acceleration(instrument):
    rng = np.random.default_rng(3)
    times = reading_times(instrument, 6000)
    for _ in range(5):
        tensor, force, rate = motion(rng)
        shaken = force + shaking(VIBRATION, instrument, times)[0]
        sum_signal = signal(
            instrument=instrument,
            errors=RotatingErrors(),
            tensor=tensor,
            specific_force=shaken,
            angular_rate=rate,
            angular_acceleration=rng.normal(size=3),
            times=times,
        )
        reading = demodulate(instrument, sum_signal, times) + centrifugal_channels(rate)
        # 1e-6 E: what rounding leaves of 10 m/s² over the baseline.
        np.testing.assert_allclose(reading, SPIN_CHANNELS["z"] @ tensor, rtol=0.0, atol=1e-6)


def test_an_angular_rate_enters_as_the_inertial_tensor():
    rate = np.array([0.3, -0.2, 0.7])
    skew = np.array([[0, -rate[2], rate[1]], [rate[2], 0, -rate[0]], [-rate[1], rate[0], 0]])
    inertial = -skew @ skew * 1e9
    times = reading_times(WHOLE, 3000)
    sum_signal = signal(
        instrument=WHOLE,
        errors=RotatingErrors(),
        tensor=np.zeros(6),
        specific_force=np.zeros(3),
        angular_rate=rate,
        angular_acceleration=np.zeros(3),
        times=times,
    )
    expected = [(inertial[0, 0] - inertial[1, 1]) / 2.0, inertial[0, 1]]
    np.testing.assert_allclose(demodulate(WHOLE, sum_signal, times), expected, rtol=1e-12)


def test_the_signal_is_that_of_masses_moved_through_inertial_space():
    """Kinematics by differentiating the proof masses' inertial positions twice, numerically.

    The tensor, rates and errors are far larger than any real ones, so that each term is seen.
    """
    rng = np.random.default_rng(5)
    instrument = RotatingGradiometer(0.3, 0.5, 2.0)
    direction = rng.normal(size=3) / 2.0
    start, growth = 0.7, 0.4  # the disk axes turn by (start t + growth t²/2) · direction
    tensor = rng.normal(0.0, 3e8, 6)
    force = rng.normal(size=3)
    scale, lean, tilt, square = rng.normal(0.0, 0.1, (4, 4))
    square[0] = square[1] = square[:2].mean()
    square[2] = square[3] = square[2:].mean()
    tilt -= tilt.mean()
    errors = RotatingErrors(baseline=0.1, rotation_rate=0.05, demodulation_phase=0.3)
    for name, four in (
        ("scale_factor", scale),
        ("radial_misalignment", lean),
        ("axial_misalignment", tilt),
        ("quadratic", square),
    ):
        values = {
            name: four.mean(),
            f"{name}_pair12": four[0] - four[1],
            f"{name}_pair34": four[2] - four[3],
            f"{name}_between_pairs": four[:2].mean() - four[2:].mean(),
        }
        known = {key: value for key, value in values.items() if hasattr(errors, key)}
        errors = dataclasses.replace(errors, **known)

    def turned(t: float) -> np.ndarray:
        return Rotation.from_rotvec((start * t + growth * t**2 / 2.0) * direction).as_matrix()

    def place(t: float, n: int) -> np.ndarray:
        angle = np.pi * 1.05 * t - 0.15 + (0.0, np.pi, np.pi / 2.0, 1.5 * np.pi)[n]
        return 0.165 * np.array([np.cos(angle), np.sin(angle), 0.0])

    gamma = 1e-9 * tensor[[0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3)
    times = np.linspace(0.1, 1.9, 25)
    h, weights = 2e-3, np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0
    expected = []
    for t in times:
        total = 0.0
        for n, sign in enumerate((1, 1, -1, -1)):
            steps = [turned(t + k * h) @ place(t + k * h, n) for k in (-2, -1, 0, 1, 2)]
            acceleration = turned(t).T @ (weights @ np.array(steps)) / h**2
            felt = force + acceleration - gamma @ place(t, n)
            radial = place(t, n) / 0.165
            tangent = np.cross([0.0, 0.0, 1.0], radial)
            inside = np.cos(lean[n]) * tangent + np.sin(lean[n]) * radial
            along = felt @ (np.cos(tilt[n]) * inside + np.sin(tilt[n]) * np.array([0, 0, 1.0]))
            total += sign * ((1.0 + scale[n]) * along + square[n] * along**2)
        expected.append(total)
    rates = (start + growth * times)[:, None] * direction
    found = signal(
        instrument=instrument,
        errors=errors,
        tensor=tensor,
        specific_force=force,
        angular_rate=rates,
        angular_acceleration=growth * direction,
        times=times,
    )
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-8)


@thinned("vibration", [None, VIBRATION], ids=["steady", "vibrating"])
@pytest.mark.parametrize("instrument", [WHOLE, ODD], ids=["whole", "odd"])
@pytest.mark.parametrize("name", SCALARS)
def test_each_error_of_the_budget_is_the_simulated_one(name, instrument, vibration):
    rng = np.random.default_rng(7)
    for _ in range(2):
        world = (*motion(rng), vibration)
        plus, minus = (RotatingErrors(**{name: value}) for value in (1e-5, -1e-5))
        # Half the difference: free of the second order, which the budget leaves out.
        simulated = (read(instrument, plus, *world) - read(instrument, minus, *world)) / 2.0
        budget = error_budget(instrument, plus, *world)
        assert close(simulated, budget.pop(name))
        assert all(np.abs(row).max() < 1e-9 for row in budget.values())


def test_every_error_is_seen_in_some_motion():
    """So that no row of the budget is compared with nothing."""
    errors = RotatingErrors(**dict.fromkeys(SCALARS, 1e-5), angular_rate_error=(1e-5,) * 3)
    tensor, force, rate = motion(np.random.default_rng(8))
    budget = error_budget(ODD, errors, tensor, force, rate, VIBRATION)
    assert min(np.abs(row).max() for row in budget.values()) > 1e-2


def test_an_error_of_the_gyros_leaves_its_product_with_the_rate():
    rng = np.random.default_rng(9)
    tensor, force, rate = motion(rng)
    errors = RotatingErrors(angular_rate_error=(1e-5, -2e-5, 3e-5))
    expected = channel_errors(WHOLE, errors, tensor, force, rate)
    assert close(simulated_error(WHOLE, errors, tensor, force, rate), expected)
    x, y, _ = rate
    first_order = [(1e-5 * x + 2e-5 * y) * 1e9, (1e-5 * y - 2e-5 * x) * 1e9]
    assert expected == pytest.approx(first_order, rel=5e-3)


@pytest.mark.parametrize("vibration", [None, VIBRATION], ids=["steady", "vibrating"])
@pytest.mark.parametrize("instrument", [WHOLE, ODD], ids=["whole", "odd"])
def test_all_errors_together(instrument, vibration):
    rng = np.random.default_rng(11)
    for _ in range(3):
        tensor, force, rate = motion(rng)
        small = dict(zip(SCALARS, rng.normal(0.0, 1e-6, len(SCALARS)), strict=True))
        small |= {"rotation_rate": 2e-4, "demodulation_phase": -3e-4}
        errors = RotatingErrors(**small, angular_rate_error=tuple(rng.normal(0.0, 1e-6, 3)))
        assert close(
            simulated_error(instrument, errors, tensor, force, rate, vibration),
            channel_errors(instrument, errors, tensor, force, rate, vibration),
        )


def test_a_mismatch_under_a_constant_force_is_rejected_by_whole_turns_alone():
    """And it leaks by the relative error of the rotation rate: −ε of the amplitude at 1Ω."""
    tensor, force, rate = motion(np.random.default_rng(13))
    mismatch = RotatingErrors(scale_factor_pair12=1e-6)
    assert np.abs(simulated_error(WHOLE, mismatch, tensor, force, rate)).max() < 1e-5
    assert np.abs(simulated_error(ODD, mismatch, tensor, force, rate)).max() > 100.0
    slow = RotatingErrors(rotation_rate=1e-4)
    both = dataclasses.replace(mismatch, rotation_rate=1e-4)
    leak = simulated_error(WHOLE, both, tensor, force, rate)
    leak -= simulated_error(WHOLE, slow, tensor, force, rate)
    amplitude = 1e-6 * np.hypot(*force[:2]) / 0.3 * 1e9
    assert 1e-5 * amplitude < np.abs(leak).max() < 1e-3 * amplitude
    assert close(leak, error_budget(WHOLE, both, tensor, force, rate)["scale_factor_pair12"])


@pytest.mark.parametrize("name", [name for name in SCALARS if "pair" in name])
def test_a_reference_far_out_of_step_lets_every_difference_through_as_foretold(name):
    """Large errors of phase and rotation rate, in an odd number of half turns."""
    world = (*motion(np.random.default_rng(15)), VIBRATION)
    reference = RotatingErrors(demodulation_phase=0.3, rotation_rate=0.02)
    errors = dataclasses.replace(reference, **{name: 1e-5})
    simulated = read(ODD, errors, *world) - read(ODD, reference, *world)
    expected = error_budget(ODD, errors, *world)[name]
    assert np.abs(expected).max() > 1.0
    assert close(simulated, expected)


def test_jitter_about_the_spin_axis_meets_a_cross_rate_in_the_axial_lean():
    """L_xz holds −ω_x ω_z: large rates, so that it is not hidden by Coriolis' 2Ωω."""
    vibration = Vibration(spin_rate_cos=0.3, spin_rate_sin=-0.2)
    world = (np.zeros(6), np.zeros(3), np.array([0.5, -0.3, 0.4]), vibration)
    for name in ("axial_misalignment_pair12", "axial_misalignment_pair34"):
        plus, minus = (RotatingErrors(**{name: value}) for value in (1e-5, -1e-5))
        simulated = (read(ODD, plus, *world) - read(ODD, minus, *world)) / 2.0
        assert close(simulated, error_budget(ODD, plus, *world)[name])


@pytest.mark.parametrize("name", ["axial_misalignment_pair12", "axial_misalignment_pair34"])
def test_an_axial_lean_measures_gradients_along_the_spin_axis(name):
    """Γ_xz and Γ_yz without rotation, whose Coriolis acceleration would hide them."""
    world = (np.array([0.0, 0.0, 2e4, 0.0, -3e4, 0.0]), np.zeros(3), np.zeros(3))
    plus, minus = (RotatingErrors(**{name: value}) for value in (1e-5, -1e-5))
    simulated = (read(ODD, plus, *world) - read(ODD, minus, *world)) / 2.0
    budget = error_budget(ODD, plus, *world)[name]
    assert np.abs(budget).max() > 1e-2
    assert close(simulated, budget)


@pytest.mark.parametrize("instrument", [WHOLE, ODD], ids=["whole", "odd"])
def test_an_isotropic_tensor_is_not_seen_whatever_the_errors(instrument):
    rng = np.random.default_rng(17)
    tensor, force, rate = motion(rng)
    isotropic = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0]) * 3000.0
    errors = RotatingErrors(**dict(zip(SCALARS, rng.normal(0.0, 1e-5, len(SCALARS)), strict=True)))
    change = read(instrument, errors, tensor + isotropic, force, rate)
    change -= read(instrument, errors, tensor, force, rate)
    assert np.abs(change).max() < 1e-5
    closed = channel_errors(instrument, errors, tensor + isotropic, force, rate)
    closed -= channel_errors(instrument, errors, tensor, force, rate)
    assert np.abs(closed).max() < 1e-6


def test_epochs_are_treated_one_by_one():
    rng = np.random.default_rng(19)
    errors = RotatingErrors(
        **dict(zip(SCALARS, rng.normal(0.0, 1e-5, len(SCALARS)), strict=True)),
        angular_rate_error=(1e-6, 2e-6, 0.0),
    )
    epochs = [motion(rng) for _ in range(4)]
    tensors, forces, rates = (np.array(a) for a in zip(*epochs, strict=True))
    together = channel_errors(ODD, errors, tensors, forces, rates, VIBRATION)
    assert together.shape == (4, 2)
    for k, epoch in enumerate(epochs):
        alone = channel_errors(ODD, errors, *epoch, VIBRATION)
        np.testing.assert_allclose(together[k], alone, rtol=1e-12)
    still = channel_errors(ODD, errors, tensors, np.zeros(3), np.zeros(3))
    assert still.shape == (4, 2)


@pytest.mark.parametrize("spin", ["x", "y", "z"])
def test_a_disk_about_each_axis_reads_the_mounts_tensor_turned_into_its_own_axes(spin):
    turn = np.eye(3)[list(DISK_AXES[spin])]  # from mount to disk axes
    assert np.linalg.det(turn) == pytest.approx(1.0)
    assert turn[2] @ np.eye(3)["xyz".index(spin)] == 1.0
    tensor, _, _ = motion(np.random.default_rng(23))
    full = tensor[[0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3)
    disk = (turn @ full @ turn.T)[np.triu_indices(3)]
    np.testing.assert_array_equal(tensor[list(DISK_TENSOR[spin])], disk)
    channels = SPIN_CHANNELS[spin] @ tensor
    reading = read(WHOLE, RotatingErrors(), disk, np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(channels, reading, atol=1e-9)


def test_three_disks_read_all_of_the_tensor_but_its_trace():
    rows = np.vstack(list(SPIN_CHANNELS.values()))
    assert np.linalg.matrix_rank(rows) == 5
    np.testing.assert_allclose(rows @ [1.0, 0.0, 0.0, 1.0, 0.0, 1.0], 0.0)


@pytest.mark.long
@pytest.mark.parametrize(
    ("instrument", "samples", "readings"),
    [
        (WHOLE, 96, 700),
        (WHOLE, 96, 2000),
        (WHOLE, 1000, 2000),
        (RotatingGradiometer(0.6, 1.0, 0.5), 64, 2000),
    ],
)
def test_noise_of_a_channel(instrument, samples, readings):
    """Variance and correlation of the readings; false-alarm rate 1e-6 for each bound."""
    rng = np.random.default_rng(29)
    errors = RotatingErrors(accelerometer_root_psd=1e-8)
    times = reading_times(instrument, samples)
    still = (np.zeros(6), np.zeros(3), np.zeros(3), np.zeros(3))
    silent = demodulate(instrument, signal(instrument, errors, *still, times), times)
    noise = np.array(
        [
            demodulate(instrument, signal(instrument, errors, *still, times, rng), times) - silent
            for _ in range(readings)
        ]
    )
    sigma = channel_noise_eotvos(instrument, errors.accelerometer_root_psd)
    low, high = chi2.ppf([5e-7, 1.0 - 5e-7], readings)
    for channel in noise.T:
        assert low < np.sum((channel / sigma) ** 2) < high
    # Half the variance of the sum and the difference of independent channels is that of one.
    for combined in (noise[:, 0] + noise[:, 1], noise[:, 0] - noise[:, 1]):
        assert low < np.sum((combined / sigma) ** 2) / 2.0 < high


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ((0.3, 0.25, 1.0), "is 0.5 half turns"),
        ((0.3, 0.25, 1e-12), "at least 1"),
        ((0.3, 0.25, 9.0), "is 4.5 half turns .* must be a whole number"),
    ],
)
def test_an_instrument_that_cannot_be(values, words):
    with pytest.raises(GGBenchError, match=words):
        RotatingGradiometer(*values)
