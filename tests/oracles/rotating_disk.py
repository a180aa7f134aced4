"""The signal of a rotating disk of accelerometers from first principles, and its demodulation."""

from __future__ import annotations

import math

import numpy as np

from ggbench.gravity.ellipsoid import EOTVOS
from ggbench.sensors.gradiometer.rotating import RotatingErrors, RotatingGradiometer, Vibration


def motion(
    vibration: Vibration, instrument: RotatingGradiometer, times: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what it adds to specific force, angular rate, angular acceleration: 3 × (n, 3)."""
    angle = instrument.rotation_rate * times[:, None]
    force = np.cos(angle * (1, 2, 3)) @ vibration.specific_force_cos
    force += np.sin(angle * (1, 2, 3)) @ vibration.specific_force_sin
    cosine, sine = np.cos(2.0 * angle[:, 0]), np.sin(2.0 * angle[:, 0])
    rate, acceleration = np.zeros_like(force), np.zeros_like(force)
    rate[:, 2] = vibration.spin_rate_cos * cosine + vibration.spin_rate_sin * sine
    acceleration[:, 2] = vibration.spin_rate_sin * cosine - vibration.spin_rate_cos * sine
    return force, rate, 2.0 * instrument.rotation_rate * acceleration


def reading_times(instrument: RotatingGradiometer, samples: int) -> np.ndarray:
    """Return the middles (samples,) [s] of equal parts of a reading, from its beginning."""
    return (np.arange(samples) + 0.5) * (instrument.period / samples)


def _four(errors: RotatingErrors, name: str) -> list[float]:
    """Return an error of each of the four accelerometers; a difference without a name is zero."""
    mean, pair12, pair34, between = (
        getattr(errors, name + suffix, 0.0)
        for suffix in ("", "_pair12", "_pair34", "_between_pairs")
    )
    first, second = mean + between / 2.0, mean - between / 2.0
    return [first + pair12 / 2, first - pair12 / 2, second + pair34 / 2, second - pair34 / 2]


def signal(
    instrument: RotatingGradiometer,
    errors: RotatingErrors,
    tensor: np.ndarray,
    specific_force: np.ndarray,
    angular_rate: np.ndarray,
    angular_acceleration: np.ndarray,
    times: np.ndarray,
    rng: np.random.Generator | None = None,
) -> np.ndarray:
    """Return the sum signal (n,) [m/s²], computed from each proof mass's motion.

    Parameters
    ----------
    instrument, errors : the disk and its imperfections.
    tensor : (6,) or (n, 6) gravitational tensor in disk axes [E].
    specific_force : (3,) or (n, 3) at the disk's centre [m/s²].
    angular_rate, angular_acceleration : (3,) or (n, 3) of the disk axes [rad/s, rad/s²].
    times : (n,) sampling times [s] from the beginning of the reading, evenly spaced.
    rng : draws the accelerometers' noise, one sample per time; without it there is none.
    """
    count = len(times)
    gamma = EOTVOS * np.broadcast_to(np.asarray(tensor, dtype=float), (count, 6))
    force, rate, acceleration = (
        np.broadcast_to(np.asarray(a, dtype=float), (count, 3))
        for a in (specific_force, angular_rate, angular_acceleration)
    )
    spin = instrument.rotation_rate * (1.0 + errors.rotation_rate)
    angle = spin * times - errors.demodulation_phase / 2.0
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros(count)
    scale = _four(errors, "scale_factor")
    radial = _four(errors, "radial_misalignment")
    axial = _four(errors, "axial_misalignment")
    quadratic = _four(errors, "quadratic")
    radius = 0.5 * instrument.baseline * (1.0 + errors.baseline)

    total = np.zeros(count)
    for n, (sign, cosine, sine) in enumerate(((1, c, s), (1, -c, -s), (-1, -s, c), (-1, s, -c))):
        r = np.stack([cosine, sine, zero], axis=1)
        t = np.stack([-sine, cosine, zero], axis=1)
        place, velocity = radius * r, radius * spin * t
        attraction = np.stack(
            [
                gamma[:, 0] * place[:, 0] + gamma[:, 1] * place[:, 1],
                gamma[:, 1] * place[:, 0] + gamma[:, 3] * place[:, 1],
                gamma[:, 2] * place[:, 0] + gamma[:, 4] * place[:, 1],
            ],
            axis=1,
        )
        felt = (
            force
            - attraction
            + np.cross(acceleration, place)
            + np.cross(rate, np.cross(rate, place))
            + 2.0 * np.cross(rate, velocity)
        )
        # The spin's own centripetal acceleration is radial exactly: rounding must not tilt it.
        along_radius = np.einsum("ij,ij->i", felt, r) - spin**2 * radius
        along_tangent = np.einsum("ij,ij->i", felt, t)
        sensed = (
            math.cos(axial[n])
            * (math.cos(radial[n]) * along_tangent + math.sin(radial[n]) * along_radius)
            + math.sin(axial[n]) * (felt[:, 2])
        )
        output = (1.0 + scale[n]) * sensed + quadratic[n] * sensed**2
        if rng is not None:
            density = errors.accelerometer_root_psd / math.sqrt(instrument.period / count)
            output = output + density * rng.standard_normal(count)
        total += sign * output
    return total


def demodulate(
    instrument: RotatingGradiometer, signal: np.ndarray, times: np.ndarray
) -> np.ndarray:
    """Return the two channels (L_xx − L_yy)/2, L_xy (2,) [E] of one reading.

    Parameters
    ----------
    instrument : the disk, as assumed.
    signal : (n,) sum signal [m/s²].
    times : (n,) its times [s] from the beginning of the reading: n even steps of period/n.
    """
    angle = 2.0 * instrument.rotation_rate * times
    gain = instrument.baseline * EOTVOS
    return np.array([np.mean(signal * np.sin(angle)), -np.mean(signal * np.cos(angle))]) / gain
