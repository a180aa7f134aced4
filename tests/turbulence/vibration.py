"""What gusts add to the noise of rotating disks: accelerations at their spin, isolated in part.

In a gust each reading has its own vibration, so that what a disk's imperfections make of it is
noise, and no bias as of a rotor that turns in step.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import welch

from ggbench.sensors.gradiometer.rotating import DISK_AXES, RotatingGradiometer, Vibration
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
"""Those of the scenario ``jacksboro_helicopter``."""
_RATE = 50.0  # [Hz]


def flown(track: str) -> np.ndarray:
    """Return the accelerations (N, 3) of a track as it is flown here [m/s²], ENU, 50 a second."""
    truth = along(read_track(track, TrackLimits()), 1.0 / _RATE, 0.0, 0.0)
    return np.asarray(np.diff(truth.velocities, axis=0) * _RATE)


def amplitudes(track: str) -> np.ndarray:
    """Return root-mean-square amplitudes (3, 3) [m/s²] at 1, 2 and 3 Hz (rows), ENU.

    Of what a reading of one second has of a one-sided spectral density S: √(2 S · 1 Hz).
    """
    frequencies, density = welch(flown(track), _RATE, nperseg=int(10 * _RATE), axis=0)
    at = [int(np.argmin(np.abs(frequencies - n))) for n in (1.0, 2.0, 3.0)]
    return np.asarray(np.sqrt(2.0 * density[at]))


def noise(amplitude: np.ndarray, runs: int = 100, readings: int = 40, seed: int = 1) -> float:
    """Return the root mean square [E] of the noise that vibrations make, over runs and channels."""
    rng = np.random.default_rng(seed)
    still, hanging = np.zeros((1, 6)), np.array([0.0, 0.0, 9.81])
    variances = []
    for _ in range(runs):
        for axis in DISKS.spin_axes:
            order = list(DISK_AXES[axis])
            errors = DISKS._draw(rng)
            each = ISOLATION * amplitude[:, order] / np.sqrt(2.0)
            found = [
                channel_errors(
                    DISKS.instrument, errors, still, hanging[np.newaxis, order],
                    np.zeros((1, 3)), Vibration(*(each * rng.standard_normal((2, 3, 3)))),
                )[0]
                for _ in range(readings)
            ]  # fmt: skip
            variances.append(np.var(found, axis=0, ddof=1))
    return float(np.sqrt(np.mean(variances)))
