"""Error budget of a rotating-accelerometer gradiometer: channel error per imperfection.

The effects are closed formulas of first order. Notation and conventions are those of
:mod:`.gradiometer.rotating`.
"""

from __future__ import annotations

import numpy as np

from ...gravity.ellipsoid import EOTVOS
from .rotating import (
    SPIN_CHANNELS,
    RotatingErrors,
    RotatingGradiometer,
    Vibration,
    centrifugal_channels,
)

Harmonics = dict[int, np.ndarray]  # X(t) = Σ X_n exp(inΩt); each X_n complex, (...)


def _force_harmonics(force: np.ndarray, vibration: Vibration | None) -> tuple[Harmonics, Harmonics]:
    """Return the harmonics of F = f_x + i f_y and of f_z; force (..., 3) is the constant part."""
    plane: Harmonics = {0: force[..., 0] + 1j * force[..., 1]}
    axial: Harmonics = {0: force[..., 2] + 0j}
    if vibration is not None:
        for n in (1, 2, 3):
            a, b = vibration.specific_force_cos[n - 1], vibration.specific_force_sin[n - 1]
            forward, backward = (a - 1j * b) / 2.0, (a + 1j * b) / 2.0
            plane[n] = forward[0] + 1j * forward[1]
            plane[-n] = backward[0] + 1j * backward[1]
            axial[n], axial[-n] = forward[2], backward[2]
    return plane, axial


def _product(left: Harmonics, right: Harmonics) -> Harmonics:
    """Return the harmonics of a product."""
    out: Harmonics = {}
    for n, a in left.items():
        for m, b in right.items():
            out[n + m] = out.get(n + m, 0.0) + a * b
    return out


def error_budget(
    instrument: RotatingGradiometer,
    errors: RotatingErrors,
    tensor: np.ndarray,
    specific_force: np.ndarray,
    angular_rate: np.ndarray,
    vibration: Vibration | None = None,
) -> dict[str, np.ndarray]:
    """Return the error (..., 2) [E] of the two channels from each imperfection, to first order.

    An error is the measured channel, corrected with the gyros, minus the channel of the
    gravitational tensor. Motion is constant during a measurement except for ``vibration``. The
    effect of ``angular_rate_error`` is exact.

    ``rotation_rate`` and ``demodulation_phase`` change the demodulation of the other errors
    (for example the 1Ω leak). The error of each other imperfection includes this effect. All other
    products of imperfections are neglected.

    Parameters
    ----------
    instrument, errors : the disk and its imperfections.
    tensor : (..., 6) gravitational tensor in disk axes [E].
    specific_force, angular_rate : (..., 3) in disk axes [m/s²], [rad/s]; leading axes broadcast.
    vibration : vibration synchronous with the disk, equal for all measurements.

    Returns
    -------
    Errors by name of the attribute of :class:`.RotatingErrors`, without the noise.
    """
    tensor, force, rate = (
        np.asarray(a, dtype=float) for a in (tensor, specific_force, angular_rate)
    )
    shape = np.broadcast_shapes(tensor.shape[:-1], force.shape[:-1], rate.shape[:-1])
    b, spin = instrument.baseline, instrument.rotation_rate
    phase, slip = errors.demodulation_phase, errors.rotation_rate
    gamma = EOTVOS * tensor
    ideal = tensor @ SPIN_CHANNELS["z"].T - centrifugal_channels(rate)
    z = EOTVOS * (ideal[..., 0] + 1j * ideal[..., 1])

    def mean(x: float) -> complex:
        """Return the mean of e^{ixΩt} over the measurement time."""
        halves = instrument.half_turns
        return complex(np.exp(0.5j * np.pi * x * halves) * np.sinc(0.5 * x * halves))

    def channel(x: Harmonics, k: int) -> np.ndarray:
        """Return the part of the complex channel Z due to the term Re(X e^{−ikθ}) of the signal S.

        ``x`` contains the harmonics X_n of X = Σ X_n e^{inΩt}.
        """
        out = np.zeros((), dtype=complex)
        for n, amplitude in x.items():
            own = np.exp(0.5j * k * phase) * mean(2 + n - k * (1.0 + slip))
            image = np.exp(-0.5j * k * phase) * mean(2 - n + k * (1.0 + slip))
            out = out + 0.5 * (amplitude * own + np.conj(amplitude) * image)
        return -1j / b * out

    # f₀ along the radius and the tangent: of 1, Re(F e^{−iθ}) and Re(−iF e^{−iθ}), with the
    # opposite sign of 2; of 3 and 4, a quarter turn on, Re(−iF e^{−iθ}) and Re(−F e^{−iθ}).
    plane, along_spin = _force_harmonics(force, vibration)
    conjugate = {-n: np.conj(x) for n, x in plane.items()}
    along_1 = channel(plane, 1)
    along_3 = channel({n: -1j * x for n, x in plane.items()}, 1)
    across_3 = channel({n: -x for n, x in plane.items()}, 1)
    # Along the spin axis, of 1: −(b/2) (L r)_z and Coriolis' 2Ω (b/2) ω·r.
    cross = rate[..., 0] + 1j * rate[..., 1]
    l_z = gamma[..., 2] + 1j * gamma[..., 4] - cross * rate[..., 2]
    out_of_plane = {0: 0.5 * b * (2.0 * spin * (1.0 + slip) * cross - l_z)}
    jitter = 0j  # ω_z = its constant part + Re(jitter · e^{2iΩt})
    if vibration is not None:
        jitter = complex(vibration.spin_rate_cos, -vibration.spin_rate_sin)
        out_of_plane[2] = 0.25 * b * cross * jitter
        out_of_plane[-2] = 0.25 * b * cross * jitter.conjugate()

    per_unit: dict[str, np.ndarray] = {
        "scale_factor": z,
        "scale_factor_pair12": along_3,
        "scale_factor_pair34": -across_3,
        "scale_factor_between_pairs": channel({2: np.asarray(2j * spin * b * jitter)}, 0),
        "baseline": z,
        "radial_misalignment": 1j * z,
        "radial_misalignment_pair12": along_1,
        "radial_misalignment_pair34": -along_3,
        # The centripetal acceleration −(b/2)(Ω + ω_z)², linearised in the jitter.
        "radial_misalignment_between_pairs": channel(
            {2: -2.0 * b * (spin * (1.0 + slip) + rate[..., 2]) * jitter}, 0
        ),
        "axial_misalignment_pair12": channel(out_of_plane, 1),
        "axial_misalignment_pair34": channel({n: 1j * x for n, x in out_of_plane.items()}, 1),
        "axial_misalignment_between_pairs": 2.0 * channel(along_spin, 0),
        # Squares along the tangent: −Re(F² e^{−2iθ}) is 1's less 3's, |F|² their sum.
        "quadratic": channel({n: -2.0 * x for n, x in _product(plane, plane).items()}, 2),
        "quadratic_between_pairs": channel(_product(plane, conjugate), 0),
    }
    complex_rows = {name: getattr(errors, name) * value for name, value in per_unit.items()}
    complex_rows["demodulation_phase"] = (np.exp(1j * phase) - 1.0) * z
    complex_rows["rotation_rate"] = (mean(-2.0 * slip) - 1.0) * z - mean(4 + 2.0 * slip) * z.conj()

    rows = {n: np.stack([v.real, v.imag], axis=-1) / EOTVOS for n, v in complex_rows.items()}
    indicated = rate + np.asarray(errors.angular_rate_error, dtype=float)
    rows["angular_rate_error"] = centrifugal_channels(indicated) - centrifugal_channels(rate)
    return {name: np.broadcast_to(row, (*shape, 2)).copy() for name, row in rows.items()}


def channel_errors(
    instrument: RotatingGradiometer,
    errors: RotatingErrors,
    tensor: np.ndarray,
    specific_force: np.ndarray,
    angular_rate: np.ndarray,
    vibration: Vibration | None = None,
) -> np.ndarray:
    """Return the total error (..., 2) [E] of the two channels, the sum of :func:`error_budget`."""
    rows = error_budget(instrument, errors, tensor, specific_force, angular_rate, vibration)
    return np.sum(list(rows.values()), axis=0)
