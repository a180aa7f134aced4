"""Noise of rotating disks due to gusts.

Gusts accelerate the aircraft at one, two and three times the spin frequency. A mount isolates the
disks in part. The vibration differs between measurements, so its effect on an imperfect disk is
noise. The vibration of a rotor synchronous with the disks would cause a bias.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.signal import welch

from ggbench.sensors.gradiometer.rotating import (
    DISK_AXES,
    RotatingErrors,
    RotatingGradiometer,
    Vibration,
)
from ggbench.sensors.gradiometer.rotating_budget import channel_errors
from ggbench.sensors.gradiometer.spinning_disks import SpinningDisks
from ggbench.trajectory.track import TrackLimits, read_track
from ggbench.trajectory.truth import along

ISOLATION = 1e-3
"""Share of the aircraft's vibration that reaches the disks."""
DISKS = SpinningDisks(
    RotatingGradiometer(0.3, 1.0, 1.0),
    ("x", "y", "z"),
    scale_factor_mismatch=1e-6,
    misalignment=float(np.radians(0.01 / 60.0)),
)
"""Disks with the imperfections of the scenario ``jacksboro_helicopter``, without its vibration."""
_RATE = 50.0  # sampling rate [Hz]


def flown(track: str) -> np.ndarray:
    """Return the accelerations (N, 3) [m/s²] along a track in ENU, at 50 Hz.

    ``track`` is the path of a track file. The accelerations are differences of the resampled
    velocities.
    """
    truth = along(read_track(track, TrackLimits()), 1.0 / _RATE, 0.0, 0.0)
    return np.asarray(np.diff(truth.velocities, axis=0) * _RATE)


def amplitudes(track: str) -> np.ndarray:
    """Return the RMS amplitudes (3, 3) [m/s²] of vibration at 1, 2 and 3 Hz (rows), in ENU.

    A measurement takes one second. The RMS amplitude is therefore √(2 S · 1 Hz), with the one-sided
    spectral density S of the acceleration.
    """
    frequencies, density = welch(flown(track), _RATE, nperseg=int(10 * _RATE), axis=0)
    at = [int(np.argmin(np.abs(frequencies - n))) for n in (1.0, 2.0, 3.0)]
    return np.asarray(np.sqrt(2.0 * density[at]))


def noise(amplitude: np.ndarray) -> float:
    """Return the RMS noise [E] due to vibration, over all disks and channels.

    ``amplitude`` (3, 3) contains RMS amplitudes from :func:`amplitudes` [m/s²]. At each frequency
    and along each axis, the cosine and the sine each have half of the squared amplitude. The
    channel errors of a disk are linear in both.
    """
    variances = np.zeros((len(DISKS.spin_axes), *_answers(0).shape[1:]))
    for number, axis in enumerate(DISKS.spin_axes):
        half = 0.5 * (ISOLATION * amplitude[:, list(DISK_AXES[axis])]) ** 2
        weights = np.concatenate([half.ravel(), half.ravel()])
        variances[number] = np.einsum("v,vdc->dc", weights, _answers(number) ** 2)
    return float(np.sqrt(variances.mean()))


@cache
def _answers(number: int, disks: int = 100) -> np.ndarray:
    """Return the channel errors (18, disks, 2) [E] due to vibrations of 1 m/s².

    ``number`` is the index of the spin axis. The 18 vibrations are the cosines and sines at three
    frequencies along three axes. The imperfections of each disk are random.
    """
    axis, rng = DISKS.spin_axes[number], np.random.default_rng((1, number))
    hanging = np.array([[0.0, 0.0, 9.81]])[:, list(DISK_AXES[axis])]
    found = np.empty((18, disks, 2))
    for disk in range(disks):
        errors = DISKS._draw(rng)

        def added(vibration: np.ndarray, errors: RotatingErrors = errors) -> np.ndarray:
            return channel_errors(
                DISKS.instrument,
                errors,
                np.zeros((1, 6)),
                hanging,
                np.zeros((1, 3)),
                Vibration(*vibration.reshape(2, 3, 3)),
            )[0]

        still = added(np.zeros(18))
        found[:, disk] = [added(unit) - still for unit in np.eye(18)]
    return found
