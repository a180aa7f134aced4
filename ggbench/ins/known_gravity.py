"""Gravity disturbance that a mechanization adds, from a map or from integrated gradients.

With a gradiometer no map is needed. During the motion v dt the disturbance changes by T v dt, where
T is the disturbing gradient. Its components also change by the rotation of the local level. The
initial disturbance remains unknown, and measurement noise adds a random walk (Jekeli 2006,
Precision free-inertial navigation with gravity compensation by an onboard gradiometer)::

    δĝ' = T̂ v̂ − ω_en × δĝ,   T̂ = Γ̂ − Γ_normal(p̂),   δĝ(0) = 0

Here ω_en is the transport rate and a hat marks indicated or measured values. After a measurement T̂
is held constant; at the next measurement the trapezoidal rule corrects the integral.
"""

from __future__ import annotations

import math

import numpy as np

from ..gravity.ellipsoid import EOTVOS, normal_gradient_of
from ..gravity.field import DisturbanceMap, Field
from ..numerics.kernels import compiled, copied
from ..numerics.lanes import allocate, lanes
from ..numerics.records import record
from .local_level import frame_rates_of, place_of

COMPONENT = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Index, among the six stored components, of each element (3, 3) of a symmetric tensor."""


@record
class GradientReadings:
    """Measured gradients (ENU) of a group of runs, and the integrated gravity disturbance.

    Attributes
    ----------
    tensors : (G, 6, LANES) measured EE, EN, EU, NN, NU, UU [E]; NaN if missing.
    latest : (N + 1,) number of measurements up to and including each INS sample.
    held : (G + 1, 6, LANES) output: element g is the disturbing gradient [s⁻²] after g
        measurements.
    total : (N + 1, 3, LANES) output: disturbance δĝ at each INS sample, ENU [m/s²].
    """

    tensors: np.ndarray
    latest: np.ndarray
    held: np.ndarray
    total: np.ndarray


@record
class KnownGravity:
    """Gravity disturbance that a mechanization adds to normal gravity.

    It comes from a map or from integrated gradients, or is zero.

    Attributes
    ----------
    map : map of the disturbance, evaluated at the indicated position.
    readings : measured gradients, integrated along the indicated track.
    """

    map: DisturbanceMap
    readings: GradientReadings


def _no_readings() -> GradientReadings:
    """Return an empty set of measurements, without the first call of a kernel, which is slow."""
    tensors, held, total = allocate((0, 6), (1, 6), (0, 3))
    held[:] = 0.0
    return GradientReadings(tensors, np.zeros(0, dtype=np.int64), held, total)


_NO_READINGS = _no_readings()
NO_MAP = Field.normal().disturbance_map
NORMAL_GRAVITY = KnownGravity(NO_MAP, _NO_READINGS)
"""No disturbance: the mechanization uses normal gravity alone."""


def of_map(disturbance: DisturbanceMap) -> KnownGravity:
    """Return the gravity disturbance of a mechanization with a map."""
    return KnownGravity(disturbance, _NO_READINGS)


def of_readings(tensors: np.ndarray, samples: np.ndarray, count: int) -> KnownGravity:
    """Return the gravity disturbance of a mechanization that integrates gradients.

    Parameters
    ----------
    tensors : (G, 6, LANES) measured gradients [E], as in :class:`GradientReadings`.
    samples : (G,) index of the INS sample of each measurement.
    count : number of INS samples, N + 1.
    """
    latest = np.searchsorted(samples, np.arange(count), side="right")
    held = lanes(len(tensors) + 1, 6)
    return KnownGravity(NO_MAP, GradientReadings(tensors, latest, held, lanes(count, 3)))


@compiled
def receive(readings: GradientReadings, track: np.ndarray, n: int) -> None:
    """Store the disturbing gradient of the measurement at INS sample ``n``, if there is one.

    For a missing measurement the previous gradient is stored again.

    Parameters
    ----------
    readings : ``held`` [s⁻²] is filled with measured minus normal gradients.
    track : (N + 1, TRACK, LANES) indicated track, filled up to sample ``n``.
    n : index of the INS sample.
    """
    now = readings.latest[n]
    if now == 0 or (n > 0 and now == readings.latest[n - 1]):
        return
    for r in range(track.shape[2]):
        if math.isnan(readings.tensors[now - 1, 0, r]):
            for j in range(6):
                readings.held[now, j, r] = readings.held[now - 1, j, r]
            continue
        latitude, height = track[n, 0, r], track[n, 2, r]
        ee, nn, nu, uu = normal_gradient_of(math.sin(latitude), math.cos(latitude), height)
        normal = (ee, 0.0, 0.0, nn, nu, uu)
        for j in range(6):
            readings.held[now, j, r] = EOTVOS * (readings.tensors[now - 1, j, r] - normal[j])


@compiled
def receive_all(readings: GradientReadings, track: np.ndarray) -> None:
    """Call :func:`receive` for all samples of a track (N + 1, TRACK, LANES)."""
    for n in range(track.shape[0]):
        receive(readings, track, n)


@copied
def extrapolate(
    readings: GradientReadings,
    track: np.ndarray,
    n: int,
    dt: float,
    moved: np.ndarray,
    disturbance: np.ndarray,
) -> None:
    """Fill ``disturbance`` (1, 3, LANES) with δĝ [m/s²] half an INS interval after sample ``n``.

    δĝ is the gravity disturbance integrated from gradients, in axes ENU. ``dt`` is the INS interval
    [s]. ``moved`` (3, 3, LANES) is the state of :func:`integrate`.
    """
    known = readings.latest[n]
    for r in range(track.shape[2]):
        for i in range(3):
            value = moved[1, i, r]
            for j in range(3):
                beyond = moved[0, j, r] + 0.5 * dt * track[n, 3 + j, r]
                value += readings.held[known, COMPONENT[i, j], r] * beyond
            disturbance[0, i, r] = value


@compiled
def _turn(
    readings: GradientReadings, track: np.ndarray, n: int, dt: float, r: int, moved: np.ndarray
) -> None:
    """Rotate δĝ of run ``r`` to the local-level axes after a step of ``dt`` seconds."""
    place = place_of(track[n, 0, r], track[n, 2, r])
    _, _, w_0, w_1, w_2 = frame_rates_of(place, track[n, 3, r], track[n, 4, r])
    g_0, g_1 = readings.total[n, 0, r], readings.total[n, 1, r]
    g_2 = readings.total[n, 2, r]
    moved[1, 0, r] -= dt * (w_1 * g_2 - w_2 * g_1)
    moved[1, 1, r] -= dt * (w_2 * g_0 - w_0 * g_2)
    moved[1, 2, r] -= dt * (w_0 * g_1 - w_1 * g_0)


@copied
def integrate(
    readings: GradientReadings, track: np.ndarray, n: int, dt: float, moved: np.ndarray
) -> None:
    """Propagate the gravity disturbance δĝ from sample ``n`` of a track to sample n + 1.

    δĝ is integrated from gradients, in axes ENU.

    Parameters
    ----------
    readings, track : as in :func:`receive`.
    dt : INS interval [s].
    moved : (3, 3, LANES) state of the integration. Row 0 is the displacement since the last
        measurement, ENU [m]. Row 1 is δĝ at the last measurement, in present local-level axes
        [m/s²]. Row 2 is 1 after the first measurement and 0 before.
    """
    before, now = readings.latest[n], readings.latest[n + 1]
    receive(readings, track, n + 1)
    for r in range(track.shape[2]):
        _turn(readings, track, n, dt, r, moved)
        for j in range(3):
            moved[0, j, r] += 0.5 * dt * (track[n, 3 + j, r] + track[n + 1, 3 + j, r])
        fresh = now > before and not math.isnan(readings.tensors[now - 1, 0, r])
        first = fresh and moved[2, 0, r] == 0.0
        for i in range(3):
            change = 0.0
            for j in range(3):
                c = COMPONENT[i, j]
                rate = readings.held[now, c, r]
                if fresh and not first:
                    rate = 0.5 * (rate + readings.held[before, c, r])
                change += rate * moved[0, j, r]
            readings.total[n + 1, i, r] = moved[1, i, r] + change
        if fresh:
            for i in range(3):
                moved[0, i, r] = 0.0
                moved[1, i, r] = readings.total[n + 1, i, r]
                moved[2, i, r] = 1.0
