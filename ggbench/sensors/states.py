"""Error states of sensors: prior, dynamics, and columns of C_k or B_k.

Each kind of state is one class. :func:`states_of` returns the states of a set of sensors.
:class:`.ModelArrays` defines C_k and B_k.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from .aiding import AidingSensor, Motion
from .gradiometer.faults import biases
from .gradiometer.instrument import Gradiometer
from .gradiometer.mounting import Mount, with_mounting_angles

MOUNTING = "gradiometer mounting error"
"""Name of the state block of the mounting angles."""


class Seen(NamedTuple):
    """Quantities from which columns of C_k are computed, at the G measurements of a sensor.

    Attributes
    ----------
    motion : INS solution at the measurements of the sensor.
    turning : (..., G, 3) angular rate about the body axes [rad/s].
    gain : (..., G) gain of the measurements; 1 for all sensors but the gradiometer.
    predicted : function that returns the measurements (..., G, c) of the c channels, predicted
        from the INS solution. They are not multiplied by the gain.
    """

    motion: Motion
    turning: np.ndarray
    gain: np.ndarray
    predicted: Callable[[], np.ndarray]


Sensor = AidingSensor | Gradiometer


@dataclass(frozen=True)
class SensorStates:
    """Block of s states for errors of a sensor; the states are constant by default.

    Attributes
    ----------
    name, unit : as in :class:`.problem.StateBlock`.
    sigma : (s,) initial standard deviations.
    stream : name of the random-number stream of a gradiometer's states in a simulation.
    """

    name: str
    unit: str
    sigma: tuple[float, ...]
    stream: ClassVar[str] = ""

    def decay(self, times: np.ndarray) -> np.ndarray:
        """Return the transition factor (K,) of the states from the previous epoch to each epoch.

        ``times`` (K,) are the epochs [s].
        """
        return np.ones(len(times))

    def driven(self, times: np.ndarray) -> np.ndarray:
        """Return the process-noise variance (K,) from the previous epoch to each epoch."""
        return np.zeros(len(times))

    def draw(self, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return random true values (K, s) of the states at the epochs of a run."""
        constant = np.array(self.sigma) * rng.standard_normal(len(self.sigma))
        return np.tile(constant, (len(times), 1))

    def distort(self, readings: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return gradiometer measurements (G, c) plus the effect of true states (G, s)."""
        return readings

    def columns(self, sensor: Sensor, seen: Seen) -> np.ndarray | None:
        """Return the columns (..., G, c, s) of C_k for the c channels of a sensor.

        If all columns are zero, the result is None.
        """
        return None

    def turn(self, mount: Mount, states: slice) -> Mount:
        """Return the mount of a gradiometer with columns of B_k for these states.

        ``states`` is the slice of the states in the state vector.
        """
        return mount


@dataclass(frozen=True)
class GravityDisturbance(SensorStates):
    """Gravity disturbance that the INS does not compensate, ENU [m/s²], as three states.

    The dynamics of these states are part of the INS error model.
    """

    def columns(self, sensor: Sensor, seen: Seen) -> np.ndarray | None:
        """Return the Jacobian W (e, 3) of an aiding sensor, or None for a gradiometer.

        See :attr:`.AidingSensor.weights`.
        """
        return sensor.weights if isinstance(sensor, AidingSensor) else None


@dataclass(frozen=True)
class MountingAngles(SensorStates):
    """Constant rotations of a gradiometer's mount about the mount axes [rad], as states."""

    stream = "mounting"

    def turn(self, mount: Mount, states: slice) -> Mount:
        """Return the mount as a strapdown mount with these angles as attitude errors."""
        return with_mounting_angles(mount, states.start)


@dataclass(frozen=True)
class GradiometerBias(SensorStates):
    """Biases of the channels of a gradiometer [E], as random walks."""

    gradiometer: Gradiometer
    stream = "biases"

    def driven(self, times: np.ndarray) -> np.ndarray:
        """Return the variance (K,) [E²] of the steps of the random walk, drift² Δt."""
        return self.gradiometer.drift**2 * np.diff(times, prepend=0.0)

    def draw(self, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return random walks (K, s) [E] with random initial values."""
        return biases(self.gradiometer, len(self.sigma), times, rng)

    def distort(self, readings: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return measurements (G, c) plus biases (G, s) [E], with s = c."""
        return readings + values

    def columns(self, sensor: Sensor, seen: Seen) -> np.ndarray | None:
        """Return the product (..., G, c, s) of the gain of the filter and the identity matrix.

        Biases pass the low-pass filter as measurements do. For an aiding sensor the result is None.
        """
        if not isinstance(sensor, Gradiometer):
            return None
        return seen.gain[..., np.newaxis, np.newaxis] * np.eye(len(self.sigma))


@dataclass(frozen=True)
class AidingBias(SensorStates):
    """Gauss–Markov biases of an aiding sensor; bias i belongs to channel i."""

    sensor: AidingSensor

    def decay(self, times: np.ndarray) -> np.ndarray:
        """Return the transition factor (K,) of each interval, see :meth:`.AidingSensor.decay`."""
        return self.sensor.decay(times)

    def driven(self, times: np.ndarray) -> np.ndarray:
        """Return the process-noise variance (K,) of each interval.

        It is σ² (1 − e^(−2Δt/T)) for an interval Δt, with the standard deviation σ and the
        correlation time T of the bias. The variance of the bias then remains σ².
        """
        return np.asarray(self.sensor.bias**2 * (1.0 - self.decay(times) ** 2))

    def columns(self, sensor: Sensor, seen: Seen) -> np.ndarray | None:
        """Return the matrix (e, s) that adds bias i to channel i, with ones on its diagonal.

        If ``sensor`` is not the sensor with these biases, the result is None.
        """
        if sensor is not self.sensor:
            return None
        return np.eye(len(self.sensor.channels), len(self.sigma))


@dataclass(frozen=True)
class LeverArmError(SensorStates):
    """Error of the lever arm of an aiding sensor: right, forward, up [m]."""

    sensor: AidingSensor

    def columns(self, sensor: Sensor, seen: Seen) -> np.ndarray | None:
        """Return the Jacobian (..., G, e, 3) of the channels with respect to the lever arm.

        See :meth:`.AidingSensor.by_arm`. If ``sensor`` is not the sensor with this lever arm, the
        result is None.
        """
        return self.sensor.by_arm(seen.motion, seen.turning) if sensor is self.sensor else None


class PlacedStates(NamedTuple):
    """Block of sensor states with its slice of the state vector."""

    states: slice
    kind: SensorStates


def names_of(sensor: AidingSensor) -> tuple[str, str]:
    """Return the names of two state blocks of an aiding sensor: biases and lever-arm errors."""
    name = sensor.name.replace("_", " ")
    return f"{name} bias", f"{name} lever arm error"


def states_of(
    gradiometer: Gradiometer | None,
    aiding: Sequence[AidingSensor],
    disturbance: tuple[float, ...],
    first: int,
) -> list[PlacedStates]:
    """Return the states that follow those of the INS, in the order of the state vector.

    Parameters
    ----------
    gradiometer, aiding : the assumed sensors.
    disturbance : standard deviation of each component of the unknown gravity disturbance [m/s²];
        empty if the disturbance is no state.
    first : index of the first of these states.
    """
    placed = []
    for kind in _kinds(gradiometer, aiding, disturbance):
        if kind.sigma:
            placed.append(PlacedStates(slice(first, first + len(kind.sigma)), kind))
            first += len(kind.sigma)
    return placed


def _kinds(
    gradiometer: Gradiometer | None,
    aiding: Sequence[AidingSensor],
    disturbance: tuple[float, ...],
) -> Iterator[SensorStates]:
    """Yield all kinds of sensor states; for a kind that is not used ``sigma`` is empty."""
    yield GravityDisturbance("gravity disturbance ENU", "m/s²", disturbance)
    if gradiometer is not None:
        yield from gradiometer_states(gradiometer)
    for sensor in aiding:
        bias, arm = names_of(sensor)
        unit = sensor.channels[0].unit
        yield AidingBias(bias, unit, (sensor.bias,) * sensor.biased, sensor)
        yield LeverArmError(arm, "m", (sensor.arm_sigma,) * sensor.armed, sensor)


def gradiometer_states(gradiometer: Gradiometer) -> Iterator[SensorStates]:
    """Yield the state blocks for the errors of a gradiometer."""
    angles = 3 if gradiometer.mounting_sigma > 0.0 else 0
    yield MountingAngles(MOUNTING, "rad", (gradiometer.mounting_sigma,) * angles)
    # A bias that only walks starts from a hundredth of what one reading adds: states are
    # solved for in units of their prior, which must not be nothing against the walk.
    walk = gradiometer.drift * math.sqrt(gradiometer.period)
    sigma = max(gradiometer.bias_eotvos, 1e-2 * walk, 1e-9)
    channels = len(gradiometer.components) if gradiometer.biased else 0
    yield GradiometerBias("gradiometer bias", "E", (sigma,) * channels, gradiometer)


def add_columns(
    linear: np.ndarray,
    at: np.ndarray,
    channels: slice,
    states: Sequence[PlacedStates],
    sensor: Sensor,
    seen: Seen,
) -> None:
    """Fill the columns of the sensor states in C_k, for the channels of one sensor.

    Parameters
    ----------
    linear : (..., K, m, n) C_k, changed.
    at : (G,) indices of the epochs of the sensor's measurements.
    channels : channels of the sensor among all m channels.
    states : state blocks of all sensors.
    sensor, seen : arguments of :meth:`SensorStates.columns`.
    """
    for place, kind in states:
        columns = kind.columns(sensor, seen)
        if columns is not None:
            linear[..., at, channels, place] = columns


def turned(mount: Mount, states: Sequence[PlacedStates]) -> Mount:
    """Return the mount of a gradiometer with the columns of B_k for all states."""
    for place, kind in states:
        mount = kind.turn(mount, place)
    return mount
