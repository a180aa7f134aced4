"""Disks of accelerometers on a mount: their channels, their noise, what their errors add."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from oracles.rotating_disk import reading_times, signal
from scipy.stats import chi2
from small_cases import ROTATING, small_flight
from thinning import thinned

from ggbench.sensors.gradiometer.instrument import channel
from ggbench.sensors.gradiometer.rotating import (
    SPIN_CHANNELS,
    RotatingErrors,
    RotatingGradiometer,
    channel_noise_eotvos,
)
from ggbench.sensors.gradiometer.spinning_disks import DISK_CHANNELS, SpinningDisks
from ggbench.simulation.error_free_flight import Flight
from ggbench.simulation.random_streams import RandomStreams
from ggbench.simulation.runs import simulate

WHOLE = ROTATING | {"gradiometer.rotating.rotation_hz": 1.0}
"""Whole turns in a reading."""
ORDER = ("xy", "xz", "yz", "xx-yy", "yy-zz", "zz-xx")
DISKS = {"x": (4, 2), "y": (5, 1), "z": (3, 0)}
"""Columns of the two channels of each disk in ORDER."""


def added(
    errors: dict[str, float], changes: dict[str, Any] | None = None
) -> tuple[np.ndarray, Flight]:
    """What errors of the disks add to the readings (K, 6) of a run, and its flight."""
    spoilt = {f"truth.gradiometer.rotating.{key}": value for key, value in errors.items()}
    right = small_flight(WHOLE | (changes or {}))
    wrong = small_flight(WHOLE | (changes or {}) | spoilt)
    readings = [simulate(flight, seed=6, run=0)[0].measurements for flight in (right, wrong)]
    return readings[1] - readings[0], right


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_the_names_of_a_disks_channels_are_its_rows(axis):
    """What a disk is said to measure is what the signal of one measures."""
    rows = np.stack([channel(name) for name in DISK_CHANNELS[axis]])
    np.testing.assert_array_equal(rows, SPIN_CHANNELS[axis])


def test_a_perfect_instrument_reads_its_channels_and_no_trace():
    """Three disks deliver six channels of the tensor in the mount, with no part of its trace."""
    flight = small_flight(WHOLE)
    problem, _ = simulate(flight, seed=6, run=0)
    assert flight.true.gradiometer.components == ORDER
    exact = problem.measurements - flight.true.gradiometer.noise(
        20, RandomStreams(6, 0)["gradiometer/"]
    )
    xx, xy, xz, yy, yz, zz = flight.noise_free.T
    expected = [xy, xz, yz, (xx - yy) / 2.0, (yy - zz) / 2.0, (zz - xx) / 2.0]
    np.testing.assert_allclose(exact, np.transpose(expected), rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(exact[:, 3:].sum(axis=1), 0.0, atol=1e-8)
    one = small_flight(WHOLE | {"gradiometer.rotating.spin_axes": ["y"]})
    assert one.true.gradiometer.components == ("xz", "zz-xx")


@pytest.mark.long
def test_noise_of_the_channels_is_that_of_the_demodulated_accelerometers():
    """A disk's own signal, with noise of each accelerometer, scatters as the problem claims.

    400 readings of two channels: chi-square, false-alarm probability 1e-3.
    """
    flight = small_flight(WHOLE)
    root_psd = 1e-9 * 9.80665
    disk = RotatingGradiometer(0.5, 1.0, 1.0)
    claimed = np.sqrt(flight.model.noise_cov[0, 0])
    assert claimed == pytest.approx(channel_noise_eotvos(disk, root_psd), rel=1e-12)
    times, rng, nothing = reading_times(disk, 64), np.random.default_rng(1), np.zeros(3)
    phase = 4.0 * np.pi * times
    readings = []
    for _ in range(400):
        output = signal(
            instrument=disk,
            errors=RotatingErrors(accelerometer_root_psd=root_psd),
            tensor=np.zeros(6),
            specific_force=nothing,
            angular_rate=nothing,
            angular_acceleration=nothing,
            times=times,
            rng=rng,
        )
        pair = np.mean(2.0 * output * np.sin(phase)), np.mean(-2.0 * output * np.cos(phase))
        readings.append(np.array(pair) / (2.0 * 0.5) * 1e9)
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 800)
    assert low < (np.square(readings) / claimed**2).sum() < high


@pytest.mark.parametrize("name", ["scale_factor_ppm", "baseline_error_ppm"])
def test_a_scale_factor_stretches_the_two_channels_of_a_disk_alike(name):
    """One factor per disk and run, drawn with the stated size, the same at every reading."""
    extra, flight = added({name: 100.0})
    exact = flight.noise_free @ flight.true.gradiometer.channels.T
    factors = []
    for pair in DISKS.values():
        change, reading = extra[:, pair], exact[:, pair]
        factor = (change * reading).sum() / (reading**2).sum()
        np.testing.assert_allclose(change, factor * reading, rtol=0.0, atol=1e-8)
        factors.append(factor)
    assert len(set(factors)) == 3
    assert 1e-6 < np.abs(factors).max() < 4e-4


def test_a_wrong_phase_mixes_the_two_channels_of_a_disk():
    """They turn into each other like the parts of a complex number, by one angle per disk."""
    extra, flight = added({"demodulation_phase_arcmin": 10.0})
    exact = flight.noise_free @ flight.true.gradiometer.channels.T
    for first, second in DISKS.values():
        right = exact[:, first] + 1j * exact[:, second]
        wrong = right + extra[:, first] + 1j * extra[:, second]
        np.testing.assert_allclose(np.abs(wrong), np.abs(right), rtol=1e-9)
        angles = np.angle(wrong / right)
        np.testing.assert_allclose(angles, angles[0], rtol=0.0, atol=1e-9)
        assert 0.0 < abs(angles[0]) < 4.0 * np.radians(10.0 / 60.0)


def test_whole_turns_reject_a_mismatch_that_half_turns_let_through():
    """10 ppm of 9.8 m/s² over half a metre are 2e5 E, of which whole turns leave nothing."""
    errors = {"scale_factor_mismatch_ppm": 10.0}
    whole, _ = added(errors)
    half, _ = added(errors, {"gradiometer.rotating.rotation_hz": 0.5})
    assert np.abs(whole).max() < 1e-6
    assert np.abs(half).max() > 1e4


def test_vibration_in_step_passes_through_a_mismatch():
    """What the disk's turns bring into step with its signal, no demodulation takes away.

    Neither acts alone: 10 ppm of 0.01 m/s² over half a metre are 200 E.
    """
    mismatch, vibration = {"scale_factor_mismatch_ppm": 10.0}, {"vibration_mps2": 0.01}
    both, _ = added(mismatch | vibration)
    alone = [np.abs(added(errors)[0]).max() for errors in (mismatch, vibration)]
    assert max(alone) < 1e-6
    assert 10.0 < np.abs(both).max() < 1e4


@thinned("name", ["scale_factor", "baseline"])
def test_imperfections_are_drawn_anew_with_the_stated_size(name):
    """400 draws of one disk: relative errors are N(0, σ²); false-alarm probability 1e-3."""
    disks = SpinningDisks(RotatingGradiometer(0.3, 0.5, 2.0), ("z",), **{name: 1e-4})
    tensor, still = np.array([[300.0, 0.0, 0.0, -300.0, 0.0, 0.0]]), np.zeros((1, 3))
    exact = tensor @ channel("xx-yy")
    errors = [
        disks.errors(DISK_CHANNELS["z"], tensor, still, still, np.random.default_rng(run))[0, 0]
        for run in range(400)
    ]
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 400)
    assert low < np.square(np.array(errors) / exact).sum() / 1e-8 < high
