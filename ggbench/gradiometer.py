"""The gravity gradiometer: its reading, its noise and filter, and the measurement model h, H.

An inertially stabilised (platform) gradiometer reads the gravitational gradient tensor in inertial
axes, L^i = C_in Γ^n C_inᵀ with C_in = C_in(L, λ + ω_ie t): a position error shows because the field
changes and because the local level turns against inertial space. Inertial axes coincide with ECEF
axes at t = 0. Tensors are vectors [xx, xy, xz, yy, yz, zz], in E.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from .earth import ROTATION_RATE
from .field import Field, gradient_at
from .ins_error import metres_per_radian
from .lowpass import LowPass, Prefilter
from .problem import frozen

COMPONENTS = ("xx", "xy", "xz", "yy", "yz", "zz")


@njit(cache=True)
def inertial_from_local(latitude: float, longitude: float, time: float, out: np.ndarray) -> None:
    """Fill C_in (3, 3): ENU at a geodetic position to inertial axes at ``time`` [s] (eq. 10)."""
    angle = longitude + ROTATION_RATE * time
    sin_l, cos_l = math.sin(latitude), math.cos(latitude)
    sin_a, cos_a = math.sin(angle), math.cos(angle)
    out[0, 0], out[0, 1], out[0, 2] = -sin_a, -sin_l * cos_a, cos_l * cos_a
    out[1, 0], out[1, 1], out[1, 2] = cos_a, -sin_l * sin_a, cos_l * sin_a
    out[2, 0], out[2, 1], out[2, 2] = 0.0, cos_l, sin_l


@njit(cache=True)
def rotate_tensor(rotation: np.ndarray, tensor: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` with vec6(C M Cᵀ) of the symmetric tensor vec6(M) (the paper's D6(C) vec6)."""
    half = np.empty((3, 3))
    xx, xy, xz, yy, yz, zz = tensor[0], tensor[1], tensor[2], tensor[3], tensor[4], tensor[5]
    for i in range(3):
        a, b, c = rotation[i, 0], rotation[i, 1], rotation[i, 2]
        half[i, 0] = a * xx + b * xy + c * xz
        half[i, 1] = a * xy + b * yy + c * yz
        half[i, 2] = a * xz + b * yz + c * zz
    m = 0
    for i in range(3):
        for j in range(i, 3):
            out[m] = (
                half[i, 0] * rotation[j, 0]
                + half[i, 1] * rotation[j, 1]
                + half[i, 2] * rotation[j, 2]
            )
            m += 1


@njit(cache=True)
def _displaced(reference: np.ndarray, east: float, north: float, up: float) -> np.ndarray:
    """Return reference − (east, north, up) [m] as (L, λ, h), linear as the error state is."""
    per_north, per_east = metres_per_radian(reference)
    return np.array(
        [reference[0] - north / per_north, reference[1] - east / per_east, reference[2] - up]
    )


@njit(cache=True)
def reading_at(
    position: np.ndarray,
    time: float,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    out: np.ndarray,
) -> bool:
    """Fill the noise-free reading (6,) [E] at (L, λ, h) and time [s]; return: inside the map."""
    tensor = np.empty(6)
    derivative = np.empty((6, 3))
    rotation = np.empty((3, 3))
    inside = gradient_at(position, origin, step, coefficients, tensor, derivative)
    inertial_from_local(position[0], position[1], time, rotation)
    rotate_tensor(rotation, tensor, out)
    return inside


@njit(cache=True)
def reading_jacobian_at(
    position: np.ndarray,
    time: float,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill ∂(reading)/∂(east, north, up) (6, 3) [E/m] at (L, λ, h) and time [s] (eqs. 11, 12).

    D6(C_in) { ∂Γ/∂r + [∂L_φ/∂φ][∂φ_in/∂r] }: the field's change and the local level's turn.
    """
    tensor = np.empty(6)
    derivative = np.empty((6, 3))
    rotation = np.empty((3, 3))
    column = np.empty(6)
    gradient_at(position, origin, step, coefficients, tensor, derivative)
    inertial_from_local(position[0], position[1], time, rotation)
    xx, xy, xz, yy, yz, zz = tensor[0], tensor[1], tensor[2], tensor[3], tensor[4], tensor[5]
    per_north, per_east = metres_per_radian(position)
    for axis in range(3):
        # φ_in: the rotation of the local level for one metre along the axis.
        phi_x = phi_y = phi_z = 0.0
        if axis == 0:
            phi_y = math.cos(position[0]) / per_east
            phi_z = math.sin(position[0]) / per_east
        elif axis == 1:
            phi_x = -1.0 / per_north
        column[0] = derivative[0, axis] + 2.0 * xz * phi_y - 2.0 * xy * phi_z
        column[1] = derivative[1, axis] - xz * phi_x + yz * phi_y + (xx - yy) * phi_z
        column[2] = derivative[2, axis] + xy * phi_x + (zz - xx) * phi_y - yz * phi_z
        column[3] = derivative[3, axis] - 2.0 * yz * phi_x + 2.0 * xy * phi_z
        column[4] = derivative[4, axis] + (yy - zz) * phi_x - xy * phi_y + xz * phi_z
        column[5] = derivative[5, axis] + 2.0 * yz * phi_x - 2.0 * xz * phi_y
        rotate_tensor(rotation, column, out[:, axis])


@njit(cache=True)
def _readings(
    positions: np.ndarray,
    times: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
) -> np.ndarray:
    """Return the noise-free readings (K, 6) at (K, 3) positions and (K,) times."""
    out = np.empty((positions.shape[0], 6))
    for k in range(positions.shape[0]):
        reading_at(positions[k], times[k], origin, step, coefficients, out[k])
    return out


@njit(cache=True)
def _predict(
    states: np.ndarray,
    rows: np.ndarray,
    reference: np.ndarray,
    time: float,
    offset: np.ndarray,
    gain: float,
    selected: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
) -> np.ndarray:
    """Return h (N, m) of N states: offset + gain · reading(reference − B x)."""
    out = np.empty((states.shape[0], selected.shape[0]))
    reading = np.empty(6)
    error = np.empty(3)
    for n in range(states.shape[0]):
        for axis in range(3):
            error[axis] = 0.0
            for i in range(states.shape[1]):
                error[axis] += rows[axis, i] * states[n, i]
        position = _displaced(reference, error[0], error[1], error[2])
        reading_at(position, time, origin, step, coefficients, reading)
        for m in range(selected.shape[0]):
            out[n, m] = offset[m] + gain * reading[selected[m]]
    return out


@njit(cache=True)
def _jacobian(
    state: np.ndarray,
    rows: np.ndarray,
    reference: np.ndarray,
    time: float,
    gain: float,
    selected: np.ndarray,
    origin: np.ndarray,
    step: np.ndarray,
    coefficients: np.ndarray,
) -> np.ndarray:
    """Return H (m, n) of one state."""
    error = np.zeros(3)
    for axis in range(3):
        for i in range(state.shape[0]):
            error[axis] += rows[axis, i] * state[i]
    position = _displaced(reference, error[0], error[1], error[2])
    slope = np.empty((6, 3))
    reading_jacobian_at(position, time, origin, step, coefficients, slope)
    # The state's metres are measured at the reference, the slope's at the displaced point.
    reference_north, reference_east = metres_per_radian(reference)
    north, east = metres_per_radian(position)
    slope[:, 0] *= east / reference_east
    slope[:, 1] *= north / reference_north
    out = np.empty((selected.shape[0], state.shape[0]))
    for m in range(selected.shape[0]):
        for i in range(state.shape[0]):
            out[m, i] = -gain * (
                slope[selected[m], 0] * rows[0, i]
                + slope[selected[m], 1] * rows[1, i]
                + slope[selected[m], 2] * rows[2, i]
            )
    return out


def readings(field: Field, positions: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return noise-free readings (K, 6) [E] of a platform gradiometer along a track.

    Parameters
    ----------
    field : the gradient field.
    positions : (K, 3) geodetic latitude, longitude [rad], height [m].
    times : (K,) [s] since the inertial frame coincided with ECEF.

    Raises
    ------
    OutsideMapError
        If a position lies outside the map; the message names it and the map's bounds.
    """
    field.tensor(*positions.T)  # raises outside the map, which the kernel below would extend
    return _readings(positions, times, field.origin, field.step, field.tensor_coefficients)


@dataclass(frozen=True)
class Gradiometer:
    """An inertially stabilised gradiometer.

    Attributes
    ----------
    noise_eotvos : RMS of the white noise of each component, before the filter [E].
    lowpass : the instrument's filter, or None.
    components : which of the six components it delivers.
    """

    noise_eotvos: float
    lowpass: LowPass | None
    components: tuple[str, ...] = COMPONENTS

    @property
    def selected(self) -> np.ndarray:
        """Indices of the delivered components in the six."""
        return np.array([COMPONENTS.index(name) for name in self.components])

    def output(self, noise_free: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return the instrument's output (K, m) [E] for noise-free readings (K, 6) [E]."""
        exact = noise_free[:, self.selected]
        # All six are drawn, so that a subset of components sees the same noise in them.
        noisy = exact + self.noise_eotvos * rng.standard_normal(noise_free.shape)[:, self.selected]
        return noisy if self.lowpass is None else self.lowpass.apply(noisy)


def noise_rms(root_psd: float, rate_hz: float) -> float:
    """Return N_RMS = √(D_NSD² f / 2) of a noise density [E/√Hz] at an update rate [Hz] (eq. 1)."""
    return math.sqrt(root_psd**2 * rate_hz / 2.0)


class GradiometerModel:
    """The measurement model of all estimators: h(k, x) and its Jacobian H(k, x).

    h(k, x) = ẑ_k + g_k [L(p̂_k − B_k x) − L(p̂_k)], where ẑ is the reading predicted along the INS
    track and passed through the same filter and prefilter as the instrument's output, p̂_k the INS
    position at t_k − τ_k, B_k x the position error there, and g_k the chain's gain. Without a
    filter this is L(p_INS − δr). Outside the map the field at its border is continued.

    Parameters
    ----------
    field, gradiometer : the map and the instrument, as the estimators know them.
    times : (K,) measurement epochs [s].
    positions : (K, 3) INS positions at the epochs [rad, rad, m].
    delayed_positions : (K, 3) INS positions at t_k − τ_k.
    delays : (K,) τ_k [s].
    rows : (K, 3, n) B_k: from x(t_k) to the position error at t_k − τ_k [m].
    treatment : the prefilter of the instrument's output.
    """

    def __init__(
        self,
        field: Field,
        gradiometer: Gradiometer,
        times: np.ndarray,
        positions: np.ndarray,
        delayed_positions: np.ndarray,
        delays: np.ndarray,
        rows: np.ndarray,
        treatment: Prefilter,
    ) -> None:
        self._map = (field.origin, field.step, field.tensor_coefficients)
        self._selected = gradiometer.selected
        self._references = frozen(delayed_positions)
        self._times = frozen(times - delays)
        self._rows = frozen(rows)
        self._gain = treatment.gain
        predicted = _readings(positions, times, *self._map)[:, self._selected]
        if gradiometer.lowpass is not None:
            predicted = treatment.apply(gradiometer.lowpass.apply(predicted))
        at_reference = _readings(self._references, self._times, *self._map)[:, self._selected]
        self._offset = frozen(predicted - self._gain[:, None] * at_reference)

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return h (..., m) [E] at epoch ``k`` for states x (..., n); any leading axes."""
        states = self._states(k, x)
        flat = states.reshape(-1, states.shape[-1])
        out = _predict(
            flat, self._rows[k], self._references[k], self._times[k], self._offset[k],
            self._gain[k], self._selected, *self._map,
        )  # fmt: skip
        return out.reshape(*states.shape[:-1], out.shape[-1])

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return H = ∂h/∂x (m, n) [E per unit of the state] at epoch ``k`` and state x (n,)."""
        state = self._states(k, x)
        if state.ndim != 1:
            raise ValueError(f"the Jacobian is taken at one state (n,), not at {state.shape}")
        return _jacobian(
            state, self._rows[k], self._references[k],
            self._times[k], self._gain[k], self._selected, *self._map,
        )  # fmt: skip

    def _states(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return states ready for the kernels, which check nothing."""
        states = np.ascontiguousarray(x, dtype=float)
        epochs, _, n = self._rows.shape
        if not 0 <= k < epochs:
            raise IndexError(f"there is no epoch {k}; the problem has epochs 0 to {epochs - 1}")
        if states.ndim == 0 or states.shape[-1] != n:
            raise ValueError(f"states must be (..., {n}), not {states.shape}")
        return states


def parse_components(names: Sequence[str]) -> tuple[str, ...]:
    """Return component names in the standard order."""
    return tuple(name for name in COMPONENTS if name in names)
