"""Simulated gradiometer measurements with all errors, and true instrument states."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..sensors.gradiometer.instrument import Gradiometer, readings
from ..sensors.states import MOUNTING, SensorStates, gradiometer_states
from .error_free_flight import Flight, gradiometer_places
from .random_streams import RandomStreams


class Gradients(NamedTuple):
    """Gradiometer measurements of R runs.

    Attributes
    ----------
    output : (R, G, g) measurements [E] at G epochs in g channels, filtered if there is a low-pass
        filter.
    missing : (R, G) mask of missing measurements.
    states : true values of the instrument's states. Each kind of states has an array (R, K, s)
        under its name, with the values of its s states at all K epochs.
    """

    output: np.ndarray
    missing: np.ndarray
    states: dict[str, np.ndarray]

    def of_runs(self, some: slice) -> Gradients:
        """Return the arrays of a slice of the runs."""
        states = {name: values[some] for name, values in self.states.items()}
        return Gradients(self.output[some], self.missing[some], states)

    @classmethod
    def joined(cls, parts: Sequence[Gradients]) -> Gradients:
        """Join the arrays of several groups of runs."""
        if len(parts) == 1:
            return parts[0]
        output, missing, states = zip(*parts, strict=True)
        values = {name: np.concatenate([of[name] for of in states]) for name in states[0]}
        return cls(np.concatenate(output), np.concatenate(missing), values)


def gradients(flight: Flight, streams: Sequence[RandomStreams]) -> Gradients:
    """Simulate the gradiometer measurements of R runs.

    If there is no gradiometer, the result has no measurements and no states.
    """
    runs, width, instrument = len(streams), flight.model.gradients, flight.true.gradiometer
    if instrument is not None and flight.measured is not None:
        # What was measured is the same in all runs; biases are those that the truth adds.
        output = np.tile(np.nan_to_num(flight.measured), (runs, 1, 1))
        kinds, states = _drawn_states(flight, instrument, streams)
        for kind in kinds:
            values = states[kind.name][:, flight.gradient_epochs]
            output = np.stack(list(map(kind.distort, output, values)))
        return Gradients(output, np.tile(flight.absent, (runs, 1)), states)
    if instrument is not None:
        return _with_errors(flight, instrument, streams)
    none = np.zeros((runs, 0), dtype=bool)
    return Gradients(np.zeros((runs, 0, width)), none, {})


def _drawn_states(
    flight: Flight, instrument: Gradiometer, streams: Sequence[RandomStreams]
) -> tuple[list[SensorStates], dict[str, np.ndarray]]:
    """Return the error states of a gradiometer, and their random true values (R, K, s) by name."""
    kinds = [kind for kind in gradiometer_states(instrument) if kind.sigma]
    return kinds, {
        kind.name: np.stack(
            [kind.draw(flight.times, of_run[f"gradiometer/{kind.stream}"]) for of_run in streams]
        )
        for kind in kinds
    }


def _with_errors(
    flight: Flight, instrument: Gradiometer, streams: Sequence[RandomStreams]
) -> Gradients:
    """Return simulated gradiometer measurements of R runs, with all errors."""
    faults, at = flight.faults, flight.gradient_epochs
    times = flight.times[at]
    channels = instrument.channels
    undistorted = flight.noise_free @ channels.T
    output = np.empty((len(streams), len(times), len(channels)))
    kinds, states = _drawn_states(flight, instrument, streams)
    states.setdefault(MOUNTING, np.zeros((len(streams), len(flight.times), 3)))
    for run, of_run in enumerate(streams):
        tensors, exact = flight.noise_free, undistorted
        if faults.clock > 0.0 or faults.jitter > 0.0:
            tensors = _mistimed(flight, of_run["gradiometer/timing"])
        if faults.tilt > 0.0:
            tensors = faults.tilted(tensors, times, of_run["gradiometer/tilt"])
        if tensors is not flight.noise_free:
            exact = tensors @ channels.T
        angles = states[MOUNTING][run]
        if faults.distorts or flight.disks is not None or angles.any():
            angles += faults.mounting(of_run["gradiometer/errors"])
            exact = faults.distort(tensors, channels, angles[0], of_run["gradiometer/errors"])
        if flight.disks is not None:
            exact = exact + flight.disks.errors(
                instrument.components, tensors, *flight.motion, of_run["gradiometer/errors"]
            )
        if faults.scale_drift > 0.0:
            exact = exact * faults.drifted(times, len(channels), of_run["gradiometer/scale"])
        for kind in kinds:
            exact = kind.distort(exact, states[kind.name][run, at])
        noise = instrument.noise(len(times), of_run["gradiometer/"])
        if math.isfinite(faults.freedom):
            noise *= faults.tails(noise.shape, of_run["gradiometer/tails"])
        noise *= flight.noise_growth[:, np.newaxis]
        output[run] = exact + noise
        if faults.outlier_share > 0.0:
            output[run] += faults.outliers(times, len(channels), of_run["gradiometer/outliers"])
    if instrument.lowpass is not None:
        output = instrument.lowpass.apply(output)
    if instrument.noise_behind_filter > 0.0:
        for run, of_run in enumerate(streams):
            output[run] += instrument.noise_behind(len(times), of_run["gradiometer/behind_filter"])
    return Gradients(output, _missing(flight, streams), states)


def _missing(flight: Flight, streams: Sequence[RandomStreams]) -> np.ndarray:
    """Return the mask (R, G) of gradiometer measurements that drop out."""
    faults, times = flight.faults, flight.times[flight.gradient_epochs]
    if faults.dropout_share > 0.0:
        return np.stack(
            [faults.missing(times, of_run["gradiometer/dropouts"]) for of_run in streams]
        )
    return np.tile(faults.in_dropouts(times), (len(streams), 1))


def _mistimed(flight: Flight, rng: np.random.Generator) -> np.ndarray:
    """Return the tensors (G, 6) [E] at measurement times with clock error and jitter."""
    truth, faults, times = flight.trajectory, flight.faults, flight.times[flight.gradient_epochs]
    clock = faults.clock * rng.standard_normal()
    reading_times = times - flight.latency + faults.jitter * rng.standard_normal(len(times))
    reading_times = np.clip(reading_times, truth.times[0], truth.times[-1])
    positions, attitudes = truth.at(reading_times)
    places = gradiometer_places(flight.case, positions, attitudes)
    return readings(flight.field, places, reading_times + clock, attitudes, flight.instrument)
