"""Error states of sensors: prior, dynamics, and their columns of C_k or B_k.

Each kind of state is one class. :func:`states_of` lists the states of a suite.
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
"""Name of the mounting angles among the states."""


class Seen(NamedTuple):
    """Inputs of columns of C_k at the measurements of a sensor (..., G, .) along INS tracks.

    Attributes
    ----------
    motion : INS solution at the measurements of the sensor.
    turning : (..., G, 3) angular rate about the body's axes [rad/s].
    gain : (..., G) factor of the measurements; one except for a gradiometer.
    predicted : returns the measurements (..., G, c) predicted by h at the motion, without the gain.
    """

    motion: Motion
    turning: np.ndarray
    gain: np.ndarray
    predicted: Callable[[], np.ndarray]


Sensor = AidingSensor | Gradiometer


@dataclass(frozen=True)
class SensorStates:
    """A block of states for errors of sensors, constant by default.

    Attributes
    ----------
    name, unit : as in :class:`.problem.StateBlock`.
    sigma : (s,) initial standard deviations.
    stream : name of the random numbers of a gradiometer's states in a simulation.
    """

    name: str
    unit: str
    sigma: tuple[float, ...]
    stream: ClassVar[str] = ""

    def decay(self, times: np.ndarray) -> np.ndarray:
        """Return the factor (K,) from each epoch to the next; ``times`` (K,) [s]."""
        return np.ones(len(times))

    def driven(self, times: np.ndarray) -> np.ndarray:
        """Return the variance (K,) that process noise adds before each epoch."""
        return np.zeros(len(times))

    def draw(self, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return true values (K, s) of a run at its epochs."""
        constant = np.array(self.sigma) * rng.standard_normal(len(self.sigma))
        return np.tile(constant, (len(times), 1))

    def distort(self, readings: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return exact gradiometer measurements (G, c) with errors of true values (G, s)."""
        return readings

    def columns(self, sensor: Sensor, seen: Seen) -> np.ndarray | None:
        """Return the columns of C_k (..., G, c, s) of a sensor's channels; None for zeros."""
        return None

    def turn(self, mount: Mount, states: slice) -> Mount:
        """Return a gradiometer's mount with the columns of B_k of these ``states``."""
        return mount


@dataclass(frozen=True)
class GravityDisturbance(SensorStates):
    """Gravity disturbance [m/s²] unknown to INS and map; its dynamics are those of the INS."""

    def columns(self, sensor: Sensor, seen: Seen) -> np.ndarray | None:
        """Return W (e, 3) of a gravimeter, see :attr:`.AidingSensor.weights`."""
        return sensor.weights if isinstance(sensor, AidingSensor) else None


@dataclass(frozen=True)
class MountingAngles(SensorStates):
    """Constant rotations of a gradiometer's mount about its axes [rad]."""

    stream = "mounting"

    def turn(self, mount: Mount, states: slice) -> Mount:
        """Return the mount as a strapdown mount with these angles as attitude error."""
        return with_mounting_angles(mount, states.start)


@dataclass(frozen=True)
class GradiometerBias(SensorStates):
    """Biases of a gradiometer's channels, random walks [E]."""

    gradiometer: Gradiometer
    stream = "biases"

    def driven(self, times: np.ndarray) -> np.ndarray:
        """Return the variance (K,) [E²] of the walk's steps, drift² Δt."""
        return self.gradiometer.drift**2 * np.diff(times, prepend=0.0)

    def draw(self, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return random walks (K, s) [E] that begin at a random constant."""
        return biases(self.gradiometer, len(self.sigma), times, rng)

    def distort(self, readings: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return readings (G, c) plus biases (G, s), s = c [E]."""
        return readings + values

    def columns(self, sensor: Sensor, seen: Seen) -> np.ndarray | None:
        """Return gain times identity (..., G, c, s): biases are filtered as readings are."""
        if not isinstance(sensor, Gradiometer):
            return None
        return seen.gain[..., np.newaxis, np.newaxis] * np.eye(len(self.sigma))


@dataclass(frozen=True)
class AidingBias(SensorStates):
    """Biases of the first channels of an aiding sensor, Gauss–Markov processes."""

    sensor: AidingSensor

    def decay(self, times: np.ndarray) -> np.ndarray:
        """Return e^(−Δt/T) (K,)."""
        return self.sensor.decay(times)

    def driven(self, times: np.ndarray) -> np.ndarray:
        """Return σ² (1 − e^(−2 Δt/T)) (K,), which keeps the variance of the process constant."""
        return np.asarray(self.sensor.bias**2 * (1.0 - self.decay(times) ** 2))

    def columns(self, sensor: Sensor, seen: Seen) -> np.ndarray | None:
        """Return ones (e, s) where a bias belongs to a channel, zeros elsewhere."""
        if sensor is not self.sensor:
            return None
        return np.eye(len(self.sensor.channels), len(self.sigma))


@dataclass(frozen=True)
class LeverArmError(SensorStates):
    """Error of an aiding sensor's lever arm: right, forward, up [m]."""

    sensor: AidingSensor

    def columns(self, sensor: Sensor, seen: Seen) -> np.ndarray | None:
        """Return the Jacobian (..., G, e, 3) by the lever arm, see :meth:`.AidingSensor.by_arm`."""
        return self.sensor.by_arm(seen.motion, seen.turning) if sensor is self.sensor else None


class PlacedStates(NamedTuple):
    """A block of states and its slice of the state vector."""

    states: slice
    kind: SensorStates


def names_of(sensor: AidingSensor) -> tuple[str, str]:
    """Return the names of an aiding sensor's biases and of its lever arm's errors in a layout."""
    name = sensor.name.replace("_", " ")
    return f"{name} bias", f"{name} lever arm error"


def states_of(
    gradiometer: Gradiometer | None,
    aiding: Sequence[AidingSensor],
    disturbance: tuple[float, ...],
    first: int,
) -> list[PlacedStates]:
    """Return the states after those of the INS, in the order of the state vector.

    Parameters
    ----------
    gradiometer, aiding : the sensors.
    disturbance : σ of the unknown gravity disturbance [m/s²]; () if it is no state.
    first : index of the first.
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
    """Yield all states that sensors may have; those that they have not are of no number."""
    yield GravityDisturbance("gravity disturbance ENU", "m/s²", disturbance)
    if gradiometer is not None:
        yield from gradiometer_states(gradiometer)
    for sensor in aiding:
        bias, arm = names_of(sensor)
        unit = sensor.channels[0].unit
        yield AidingBias(bias, unit, (sensor.bias,) * sensor.biased, sensor)
        yield LeverArmError(arm, "m", (sensor.arm_sigma,) * sensor.armed, sensor)


def gradiometer_states(gradiometer: Gradiometer) -> Iterator[SensorStates]:
    """Yield the states for errors of a gradiometer."""
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
    """Fill the columns of C_k (..., K, m, n) of a sensor's channels by its states.

    Parameters
    ----------
    linear : C_k, changed.
    at : (G,) epochs of the sensor's measurements.
    channels : channels of the sensor among the m.
    states : states of all sensors.
    sensor, seen : arguments of :meth:`SensorStates.columns`.
    """
    for place, kind in states:
        columns = kind.columns(sensor, seen)
        if columns is not None:
            linear[..., at, channels, place] = columns


def turned(mount: Mount, states: Sequence[PlacedStates]) -> Mount:
    """Return a gradiometer's mount with all columns of B_k."""
    for place, kind in states:
        mount = kind.turn(mount, place)
    return mount
