"""Error states of sensors: prior, dynamics, and their columns of C_k or B_k.

Each kind of state is one class. A suite lists those that it has, see :func:`states_of`.
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
    """What columns of C_k depend on, where a sensor is read (..., G, .) along INS tracks.

    Attributes
    ----------
    motion : what the INS indicates of the sensor's place when it is read.
    turning : (..., G, 3) angular rate about the body's axes [rad/s].
    gain : (..., G) that multiplies the readings; one but for a gradiometer.
    predicted : returns the readings (..., G, c) that h predicts at the motion, but for the gain.
    """

    motion: Motion
    turning: np.ndarray
    gain: np.ndarray
    predicted: Callable[[], np.ndarray]


Sensor = AidingSensor | Gradiometer


@dataclass(frozen=True)
class SensorStates:
    """A block of states that are errors of sensors, constant if a kind does not say otherwise.

    Attributes
    ----------
    name, unit : as :class:`.problem.StateBlock` has them.
    sigma : (s,) standard deviations at the start.
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
        """Return true values (K, s) of a run at its epochs [s]."""
        constant = np.array(self.sigma) * rng.standard_normal(len(self.sigma))
        return np.tile(constant, (len(times), 1))

    def distort(self, readings: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return exact readings (G, c) of a gradiometer with errors of true values (G, s)."""
        return readings

    def columns(self, sensor: Sensor, seen: Seen) -> np.ndarray | None:
        """Return the columns of C_k (..., G, c, s) of a sensor's channels; None for zeros."""
        return None

    def turn(self, mount: Mount, states: slice) -> Mount:
        """Return a gradiometer's mount with the columns of B_k of these ``states``."""
        return mount


@dataclass(frozen=True)
class GravityDisturbance(SensorStates):
    """Gravity that neither the INS nor its map knows [m/s²]; its motion is that of the INS."""

    def columns(self, sensor: Sensor, seen: Seen) -> np.ndarray | None:
        """Return W (e, 3) of a gravimeter, see :attr:`.AidingSensor.weights`."""
        return sensor.weights if isinstance(sensor, AidingSensor) else None


@dataclass(frozen=True)
class MountingAngles(SensorStates):
    """Angles by which the axes of a gradiometer's mount are turned [rad]."""

    stream = "mounting"

    def turn(self, mount: Mount, states: slice) -> Mount:
        """Return the mount as one that is fixed to a body, whose attitude error they are."""
        return with_mounting_angles(mount, states.start)


@dataclass(frozen=True)
class GradiometerBias(SensorStates):
    """Biases of a gradiometer's channels that walk [E]."""

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
    """A block of states and its place among all."""

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
    """Return the states behind those of the INS, in the order of the state vector.

    Parameters
    ----------
    gradiometer, aiding : the sensors.
    disturbance : σ of the gravity that the INS does not know [m/s²]; () if it is no state.
    first : number of states before them.
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
    """Yield the states that are errors of a gradiometer."""
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
    at : (G,) epochs at which the sensor is read.
    channels : of the m, the sensor's.
    states : those of all sensors.
    sensor, seen : as the kinds take them.
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
