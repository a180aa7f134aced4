"""Rotating-accelerometer gravity gradiometer: signal and errors.

Four accelerometers are mounted on the rim of a disk. The distance of opposite accelerometers is the
diameter b of the disk (the baseline). The sensitive axes are tangential. The disk spins at the rate
Ω about the z axis of the disk axes (x, y, z). These axes turn with the vehicle or platform at the
angular rate ω but do not spin. Accelerometer 1 is at the angle θ = Ωt. Accelerometers 2, 3 and 4
are at θ + π, θ + π/2 and θ + 3π/2. At the angle θ the radius is r = (cos θ, sin θ, 0) and the
tangent is t = (−sin θ, cos θ, 0). The specific force (acceleration minus gravitation) of the proof
mass at ρ = (b/2) r is

    f = f₀ − Γρ + ω̇×ρ + ω×(ω×ρ) + 2ω×(Ωz×ρ) + Ωz×(Ωz×ρ).

Here f₀ is the specific force at the centre and Γ the gradient tensor. Along t the last two terms
vanish. Of ω̇ only the component ω̇_z appears along t. It cancels in the combined signal S, as does
f₀. The remainder is due to the inertial tensor L = Γ − [ω×][ω×] = Γ − ωωᵀ + ω²I:

    S = (a₁ + a₂) − (a₃ + a₄) = 2b [ (L_xx − L_yy)/2 · sin 2θ − L_xy · cos 2θ ].

The two channels are (L_xx − L_yy)/2 and L_xy. They are the means of 2S sin 2Ωt and −2S cos 2Ωt over
a measurement time of T seconds, divided by 2b. The contribution of ω is computed from gyros. As one
complex number the channels are Z = (L_xx − L_yy)/2 + i L_xy = −(i/b) · mean(S e^{2iΩt}). Any other
part of S at the frequency of e^{2iΩt} is an error. Let F = f_x + i f_y. If T is a whole number of
turns, imperfections cause the following channel errors:

* common errors of scale factor and baseline multiply Z; the common tilt of the sensitive axes
  towards the radius, and the phase error of the demodulation, rotate Z;
* under a constant F, a mismatch of scale factors within a pair adds a term at Ω (the 1Ω term). Over
  whole turns this term has no effect. The retrograde part of F at Ω and the prograde part at 3Ω
  cause errors. A difference of the radial tilts within a pair acts in the same way. If T is an *odd
  number of half turns*, the 1Ω term causes an error: 10³ E for a mismatch of 1e-6 under 10 m/s².
  If the rotation rate has the relative error ε, about the fraction ε of the 1Ω term remains after
  whole turns;
* a tilt towards the spin axis has no effect under a constant f_z, because it adds a constant to the
  signal. If the pairs differ, the part of f_z at 2Ω causes an error. A difference within a pair
  adds terms at Ω from L_xz, L_yz and the Coriolis acceleration 2Ωω. They act like the 1Ω term;
* the mean quadratic coefficient κ adds iκF²/b. A constant force causes an error through this
  imperfection alone;
* a difference in scale factor or radial tilt *between* pairs causes an error only from jitter about
  the spin axis at 2Ω. A difference in scale factor adds ω̇_z. A difference in tilt towards the
  radius adds ω_z through the centripetal acceleration.

Biases and all other constants in the signal are rejected. The list of errors follows Yu and Cai
(2019, arXiv:1905.05009). The equations were derived for this module and are tested against a
simulation from first principles. Tensors are vectors [xx, xy, xz, yy, yz, zz] in E. Forces, rates
and tensors are in disk axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ...errors import GGBenchError
from ...gravity.ellipsoid import EOTVOS
from ...numerics.frozen import frozen

# For each spin axis of the mount: which mount axes are the disk's x, y, z (cyclic, right-handed),
# ``vector[..., DISK_AXES["x"]]``; which components of the mount's tensor are the disk's,
# ``tensor[..., DISK_TENSOR["x"]]``; the rows (2, 6) that take the mount's tensor to the channels.
DISK_AXES = {"x": (1, 2, 0), "y": (2, 0, 1), "z": (0, 1, 2)}
DISK_TENSOR = {"x": (3, 4, 1, 5, 2, 0), "y": (5, 2, 4, 0, 1, 3), "z": (0, 1, 2, 3, 4, 5)}
SPIN_CHANNELS = {
    "x": frozen(np.array([[0, 0, 0, 0.5, 0, -0.5], [0, 0, 0, 0, 1, 0]])),
    "y": frozen(np.array([[-0.5, 0, 0, 0, 0, 0.5], [0, 0, 1, 0, 0, 0]])),
    "z": frozen(np.array([[0.5, 0, 0, -0.5, 0, 0], [0, 1, 0, 0, 0, 0]])),
}


class RotatingGradiometerError(GGBenchError):
    """Invalid parameters of a rotating gradiometer."""


@dataclass(frozen=True)
class RotatingGradiometer:
    """Disk of four accelerometers.

    Attributes
    ----------
    baseline : distance of opposite accelerometers [m].
    rotation_rate_hz : turns of the disk per second, relative to the disk axes [Hz].
    period : time over which one measurement is demodulated [s], a whole number of half turns. Whole
        turns reject the effect of a mismatch within a pair of accelerometers under a constant
        specific force. An odd number of half turns does not.

    Raises
    ------
    RotatingGradiometerError
        If the period is not a whole number of half turns.
    """

    baseline: float
    rotation_rate_hz: float
    period: float

    def __post_init__(self) -> None:
        """Raise RotatingGradiometerError if the period is not a whole number of half turns."""
        halves = 2.0 * self.rotation_rate_hz * self.period
        if round(halves) < 1 or abs(halves - round(halves)) > 1e-9 * halves:
            raise RotatingGradiometerError(
                f"rotating gradiometer: the measurement period of {self.period} s is {halves:.9g} "
                f"half turns at {self.rotation_rate_hz} Hz; it must be a whole number of half "
                "turns, at least 1"
            )

    @property
    def rotation_rate(self) -> float:
        """Spin rate Ω [rad/s]."""
        return 2.0 * math.pi * self.rotation_rate_hz

    @property
    def half_turns(self) -> int:
        """Number of half turns in a measurement."""
        return round(2.0 * self.rotation_rate_hz * self.period)


@dataclass(frozen=True)
class RotatingErrors:
    """Imperfections of a rotating gradiometer; all zero by default.

    Some imperfections have up to four attributes. The attribute without a suffix is the mean of
    the four accelerometers. The suffixes mean:

    - ``_pair12``: accelerometer 1 minus accelerometer 2,
    - ``_pair34``: accelerometer 3 minus accelerometer 4,
    - ``_between_pairs``: mean of 1 and 2 minus mean of 3 and 4.

    Attributes
    ----------
    scale_factor... : relative error of the accelerometers' scale factors.
    baseline : relative error of the baseline (true minus assumed).
    radial_misalignment... : tilt of the sensitive axes towards the radius, outwards [rad].
    axial_misalignment... : tilt of the sensitive axes towards the spin axis [rad]; the mean tilt
        has no effect of first order.
    quadratic... : coefficient of the squared specific force in the output [1/(m/s²)].
    demodulation_phase : phase of the reference signal minus twice the angle of the disk [rad].
    rotation_rate : relative error of the spin rate (true minus assumed); the angle is correct at
        the start of a measurement.
    angular_rate_error : error of the gyros that measure ω, in disk axes [rad/s].
    accelerometer_root_psd : root PSD of the white noise of each accelerometer [m/s²/√Hz]; the mean
        over T has the standard deviation root_psd/√T, as for the inertial sensors.
    """

    scale_factor: float = 0.0
    scale_factor_pair12: float = 0.0
    scale_factor_pair34: float = 0.0
    scale_factor_between_pairs: float = 0.0
    baseline: float = 0.0
    radial_misalignment: float = 0.0
    radial_misalignment_pair12: float = 0.0
    radial_misalignment_pair34: float = 0.0
    radial_misalignment_between_pairs: float = 0.0
    axial_misalignment_pair12: float = 0.0
    axial_misalignment_pair34: float = 0.0
    axial_misalignment_between_pairs: float = 0.0
    quadratic: float = 0.0
    quadratic_between_pairs: float = 0.0
    demodulation_phase: float = 0.0
    rotation_rate: float = 0.0
    angular_rate_error: tuple[float, float, float] = (0.0, 0.0, 0.0)
    accelerometer_root_psd: float = 0.0


@dataclass(frozen=True)
class Vibration:
    """Vibration that is synchronous with the disk; other vibration averages out.

    Attributes
    ----------
    specific_force_cos, specific_force_sin : (3, 3) amplitudes [m/s²] of cos nΩt and sin nΩt in disk
        axes, for n = 1, 2, 3. Row n − 1 contains the x, y and z components for n. The time t is
        zero at the start of a measurement.
    spin_rate_cos, spin_rate_sin : amplitudes [rad/s] of cos 2Ωt and sin 2Ωt in the angular rate
        ω_z.
    """

    specific_force_cos: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    specific_force_sin: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    spin_rate_cos: float = 0.0
    spin_rate_sin: float = 0.0


def centrifugal_channels(angular_rate: np.ndarray) -> np.ndarray:
    """Return the correction (..., 2) [E] of the channels for an angular rate ω (..., 3) [rad/s].

    The correction is (ω_x² − ω_y²)/2 and ω_x ω_y. Added to the channels of the inertial tensor L,
    it gives the channels of the gravitational tensor Γ.
    """
    rate = np.asarray(angular_rate, dtype=float)
    x, y = rate[..., 0], rate[..., 1]
    return np.stack([(x**2 - y**2) / 2.0, x * y], axis=-1) / EOTVOS


def channel_noise_eotvos(instrument: RotatingGradiometer, accelerometer_root_psd: float) -> float:
    """Return the RMS noise [E] of each channel from white noise of the four accelerometers.

    The result is √2 · root_psd / (b √T) for the baseline b and the measurement time T, with
    root_psd [m/s²/√Hz] as in :class:`RotatingErrors`. The noise of the two channels is independent.
    """
    scale = instrument.baseline * math.sqrt(instrument.period) * EOTVOS
    return math.sqrt(2.0) * accelerometer_root_psd / scale
