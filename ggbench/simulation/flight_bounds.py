"""Cramér–Rao bounds along error-free flights."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..numerics.lanes import groups
from ..sensors.aiding import Motion
from ..sensors.model import DelayedInsSolution, SensorModel
from .bound import Bound, posterior_bound
from .error_free_flight import Flight
from .formulation import arrays_along
from .sensor_suite import SensorSuite


def bounds(flights: Sequence[Flight]) -> list[Bound]:
    """Return the posterior Cramér–Rao bounds of several flights of one case.

    H and Φ are evaluated at the truth. Noise, biases, initial errors, field and latency are the
    true ones. Gradients behind a low-pass filter are whitened, as for estimators. Outliers, errors
    that are not states, and noise due to motion are omitted. The result thus remains a lower bound.
    The information of a measurement is multiplied by the expected share of runs in which it is
    available.

    Parameters
    ----------
    flights : flights of one case.

    Raises
    ------
    ValueError
        If the flights differ in epochs or maps.
    """
    return _bounds(flights, flights[0].true)


def flight_bound(flight: Flight) -> Bound:
    """Return the posterior Cramér–Rao bound of a flight, see :func:`bounds`."""
    return bounds([flight])[0]


def unfiltered_bound(flight: Flight) -> Bound:
    """Return the bound of a flight without the gradiometer's low-pass filter.

    The noise behind the filter is also omitted.
    """
    instrument, true = flight.true.gradiometer, flight.true
    if instrument is not None and instrument.lowpass is not None:
        instrument = dataclasses.replace(instrument, lowpass=None, noise_behind_filter=0.0)
        true = dataclasses.replace(true, gradiometer=instrument)
    return _bounds([flight], true)[0]


def require_together(first: Flight, other: Flight) -> None:
    """Raise ValueError unless two flights share epochs, number of INS samples, and maps."""
    if first is other:
        return
    if not (
        np.array_equal(first.epochs, other.epochs)
        and len(first.delta_angles) == len(other.delta_angles)
        and first.field is other.field
        and first.model_field is other.model_field
    ):
        raise ValueError("flights with different epochs or maps cannot be combined")


def _bounds(flights: Sequence[Flight], true: SensorSuite) -> list[Bound]:
    bounds_of = []
    for some in groups(len(flights)):
        systems = zip(flights[some], *_systems(flights[some], true), strict=True)
        bounds_of += [_bound(flight, true, *system) for flight, *system in systems]
    return bounds_of


def _systems(flights: Sequence[Flight], true: SensorSuite) -> tuple[np.ndarray, ...]:
    """Return Φ, Q (R, K, n, n) and delay matrices (R, K, 6, 15) along the truth of R flights.

    The delay matrices map an error at an epoch to the error at the delayed time.
    """
    first = flights[0]
    for flight in flights:
        require_together(first, flight)
    exact, missing = zip(*(flight.exact_gradients for flight in flights), strict=True)
    return true.systems(
        [Motion.of(flight.trajectory) for flight in flights],
        [flight.delta_velocities for flight in flights],
        first.epochs,
        first.schedule.delays(true),
        first.trajectory.dt,
        first.added_gravity(first.field, (np.concatenate(exact), np.concatenate(missing))),
    )


def _bound(
    flight: Flight,
    true: SensorSuite,
    transition: np.ndarray,
    process_cov: np.ndarray,
    rows: np.ndarray,
) -> Bound:
    when, motion = flight.schedule, flight.motion_at_epochs
    delays, positions, attitudes = when.delays(true), motion.positions, motion.attitudes
    if delays.any():
        positions, attitudes = flight.trajectory.at(when.times - delays)
    model = SensorModel(
        arrays_along(
            model=true,
            field=flight.field,
            when=when,
            ins=motion,
            delayed=DelayedInsSolution(delays, positions, attitudes, rows),
            missing=np.zeros(len(when.gradients), dtype=bool),
            others=true.aiding_model(flight.field, when.aiding, motion, flight.turning),
            whitening=true.whitening(when.times[when.gradients], flight.absent),
        )
    )
    epochs = len(flight.epochs)
    jacobians = model.jacobian_along(np.arange(epochs), np.zeros((epochs, true.dimension)))
    jacobians *= np.sqrt(flight.expected)[:, :, np.newaxis]
    return posterior_bound(
        transition,
        process_cov,
        true.prior_cov,
        jacobians,
        _noise_cov(flight, true),
        flight.ticks,
    )


def _noise_cov(flight: Flight, true: SensorSuite) -> np.ndarray:
    """Return the noise covariance (m, m) for the bound.

    Noise with heavy tails has more Fisher information than Gaussian noise of the same variance. The
    gradiometer's white noise variance is divided by the ratio of both values.
    """
    noise_cov = true.noise_cov.copy()
    if true.gradiometer is not None and flight.faults.information > 1.0:
        own, share = np.arange(true.gradients), 1.0 - 1.0 / flight.faults.information
        noise_cov[own, own] -= share * true.gradiometer.noise_eotvos**2
    return noise_cov
