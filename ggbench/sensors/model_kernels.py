"""Compiled measurement equation: h and H at eight states at a time.

All estimators use these kernels. :class:`.ModelArrays` defines the equation and its symbols. A
vector contains eight states: of eight runs in compiled estimators, or of one run for other
estimators.
"""

from __future__ import annotations

import math

import numpy as np

from ..gravity.ellipsoid import ROTATION_RATE, metres_per_radian_of, normal_gradient_of
from ..gravity.field import Tensor, gradient_of
from ..gravity.spline import spline_tensor_slopes, spline_tensors
from ..numerics import lanes
from ..numerics.kernels import compiled, inlined
from ..numerics.records import record
from ..numerics.rotations import Matrix, left_jacobian, multiply, sine_cosine, small_turn, transpose
from ..numerics.vectors import load, splat, store
from .gradiometer.instrument import (
    LOCAL_LEVEL,
    PLATFORM,
    STRAPDOWN,
    inertial_matrix,
    rotated,
    sum_of,
    turn_of,
)
from .gravity_kernels import add_gravity
from .model_arrays import (
    EpochContext,
    ModelArrays,
    PointScratch,
    epoch_context,
    load_epoch,
    point_scratch,
)

_TURN = 2.0 * math.pi


@inlined
def _near_zero(angle: float) -> float:
    """Return an angle reduced to the interval from −π to π."""
    return angle - _TURN * math.floor(angle / _TURN + 0.5)


@inlined
def _displaced(
    latitude: float, longitude: float, height: float, east: float, north: float, up: float
) -> tuple[float, float, float, float, float]:
    """Return an INS position minus a position error ENU [m], and metres per radian (north, east).

    The metres per radian are those at the INS position, so the result is linear in the error.
    """
    sine, cosine = sine_cosine(latitude)
    per_north, per_east = metres_per_radian_of(sine, cosine, height)
    return (
        latitude - north / per_north, longitude - east / per_east, height - up, per_north, per_east
    )  # fmt: skip


@inlined
def _whole_turns_less(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the rotation vector of the same rotation with an angle of at most π."""
    angle = math.sqrt(x * x + y * y + z * z + 1e-300)
    factor = _near_zero(angle) / angle
    return factor * x, factor * y, factor * z


@inlined
def _body_matrix(c_nb: Matrix, error: tuple[float, float, float]) -> Matrix:
    """Return the true C_bn from the INS attitude C_nb and an attitude error [rad]."""
    return transpose(multiply(small_turn(error[0], error[1], error[2]), c_nb))


@inlined
def _combined(channel: np.ndarray, t: Tensor) -> float:
    """Return the value of a channel (6,) for a tensor."""
    return (
        channel[0] * t[0] + channel[1] * t[1] + channel[2] * t[2]
        + channel[3] * t[3] + channel[4] * t[4] + channel[5] * t[5]
    )  # fmt: skip


@inlined
def _attitude_error(errors: np.ndarray, s: int) -> tuple[float, float, float]:
    """Return the attitude error (three vectors) of the points ``s`` from errors (6, S, lanes)."""
    return _whole_turns_less(load(errors, 3, s), load(errors, 4, s), load(errors, 5, s))


@inlined
def _attitude(context: EpochContext) -> Matrix:
    """Return C_nb of eight runs."""
    c = context.attitudes
    return (
        load(c, 0, 0), load(c, 0, 1), load(c, 0, 2),
        load(c, 0, 3), load(c, 0, 4), load(c, 0, 5),
        load(c, 0, 6), load(c, 0, 7), load(c, 0, 8),
    )  # fmt: skip


@compiled
def read(
    model: ModelArrays,
    k: int,
    context: EpochContext,
    errors: np.ndarray,
    vectors: int,
    count: int,
    points: PointScratch,
    out: np.ndarray,
) -> None:
    """Fill the gradiometer's terms of h, offset_k + gain_k Σ_i S_ki T [E], at several points.

    Parameters
    ----------
    model : arrays of a block.
    k : epoch.
    context : parameters of the runs at this epoch, from :func:`.load_epoch`.
    errors : (6, S, lanes) B_k x of each point: position error ENU [m] and attitude error [rad]. The
        points are in S vectors. Attitude errors are used only for a strapdown instrument.
    vectors : number of vectors of points to evaluate, at most S.
    count : number of points to evaluate; these are the first ones in memory order.
    points : scratch for S vectors.
    out : (g, S, lanes) output.
    """
    places, tensors, reference = points.places, points.tensors, context.references
    at = min(k, model.lags.shape[0] - 1)
    for i in range(model.lags.shape[1]):
        if model.lags[at, i] < 0:
            continue
        epoch, channels = k - model.lags[at, i], model.combined[at, i]
        latitude, longitude, height = (
            load(reference, i, 0), load(reference, i, 1), load(reference, i, 2),
        )  # fmt: skip
        for s in range(vectors):
            place = _displaced(
                latitude, longitude, height,
                load(errors, 0, s), load(errors, 1, s), load(errors, 2, s),
            )  # fmt: skip
            store(places, 0, s, place[0])
            store(places, 1, s, place[1])
            store(places, 2, s, place[2])
        if model.coefficients.size > 0:
            size = places.shape[1] * places.shape[2]
            spline_tensors(
                positions=places.reshape((3, size)),
                count=count,
                origin=model.origin,
                step=model.step,
                coefficients=model.coefficients,
                base=model.base,
                out=tensors.reshape((24, size)),
            )
        gain, turned = load(context.gain, 0, 0), ROTATION_RATE * model.times[epoch]
        for s in range(vectors):
            sine, cosine = sine_cosine(_near_zero(load(places, 0, s)))
            ee, nn, nu, uu = normal_gradient_of(sine, cosine, load(places, 2, s))
            t = (
                load(tensors, 0, s) + ee, load(tensors, 1, s), load(tensors, 2, s),
                load(tensors, 3, s) + nn, load(tensors, 4, s) + nu, load(tensors, 5, s) + uu,
            )  # fmt: skip
            if model.instrument == PLATFORM:
                sine_a, cosine_a = sine_cosine(_near_zero(load(places, 1, s) + turned))
                t = rotated(inertial_matrix(sine, cosine, sine_a, cosine_a), t)
            elif model.instrument == STRAPDOWN:
                t = rotated(_body_matrix(_attitude(context), _attitude_error(errors, s)), t)
            for c in range(out.shape[0]):
                before = load(context.offset, 0, c) if i == 0 else load(out, c, s)
                store(out, c, s, before + gain * _combined(channels[c], t))


@inlined
def _put_column(
    channels: np.ndarray, t: Tensor, factor: float, i: int, j: int, out: np.ndarray
) -> None:
    """Add a factor times the channels of a tensor to column ``j`` of a Jacobian (m, 6, lanes).

    ``i`` is the index of the combined measurement. The first one, ``i`` = 0, overwrites the column.
    """
    for c in range(channels.shape[0]):
        value = factor * _combined(channels[c], t)
        store(out, c, j, value if i == 0 else load(out, c, j) + value)


@compiled
def linearise_reading(
    model: ModelArrays,
    k: int,
    context: EpochContext,
    errors: np.ndarray,
    count: int,
    points: PointScratch,
    predicted: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill the gradiometer's terms of h [E], as :func:`read`, and their derivative.

    There is one point for each run. For a platform the derivative with respect to the position is
    D6(C_in) { ∂Γ/∂r + [∂L_φ/∂φ][∂φ_in/∂r] } (Wang et al. 2013, eqs. 11 and 12). The first term is
    the change of the field, the second term is due to the rotation of the local level. D6(C_in)
    rotates both from ENU to inertial axes. An attitude error above π is replaced by the equivalent
    smaller rotation.

    Parameters
    ----------
    model, k, context, points : as in :func:`read`.
    errors : (6, 1, lanes) instrument errors B_k x of each run.
    count : number of lanes to evaluate.
    predicted : (1, m, lanes) output; only the g gradiometer channels are filled.
    out : (g, 6, lanes) output, derivative with respect to ``errors`` [E/m; E/rad]; the last three
        columns are filled only for a strapdown instrument.
    """
    places, found, reference = points.places, points.tensors, context.references
    at = min(k, model.lags.shape[0] - 1)
    for i in range(model.lags.shape[1]):
        if model.lags[at, i] < 0:
            continue
        epoch, channels = k - model.lags[at, i], model.combined[at, i]
        latitude, longitude, height, per_north, per_east = _displaced(
            load(reference, i, 0), load(reference, i, 1), load(reference, i, 2),
            load(errors, 0, 0), load(errors, 1, 0), load(errors, 2, 0),
        )  # fmt: skip
        if model.coefficients.size > 0:
            store(places, 0, 0, latitude)
            store(places, 1, 0, longitude)
            store(places, 2, 0, height)
            size = places.shape[1] * places.shape[2]
            spline_tensor_slopes(
                positions=places.reshape((3, size)),
                count=count,
                origin=model.origin,
                step=model.step,
                coefficients=model.coefficients,
                base=model.base,
                work=points.work,
                out=found.reshape((24, size)),
            )
        sine, cosine = sine_cosine(_near_zero(latitude))
        t, slopes, north, east = gradient_of(
            sine, cosine, height,
            (
                load(found, 0, 0), load(found, 1, 0), load(found, 2, 0),
                load(found, 3, 0), load(found, 4, 0), load(found, 5, 0),
            ),
            (_along(found, 6), _along(found, 7), _along(found, 8)),
        )  # fmt: skip
        d_e, d_n, d_u = slopes
        gain, error = load(context.gain, 0, 0), _attitude_error(errors, 0)
        if model.instrument != LOCAL_LEVEL:
            if model.instrument == PLATFORM:
                turned = longitude + ROTATION_RATE * model.times[epoch]
                sine_a, cosine_a = sine_cosine(_near_zero(turned))
                c = inertial_matrix(sine, cosine, sine_a, cosine_a)
                # The local level turns for a metre to the east and to the north.
                d_e = sum_of(d_e, turn_of(t, 0.0, cosine / east, sine / east))
                d_n = sum_of(d_n, turn_of(t, -1.0 / north, 0.0, 0.0))
            else:
                c = _body_matrix(_attitude(context), error)
            d_e, d_n, d_u = rotated(c, d_e), rotated(c, d_n), rotated(c, d_u)
            if model.instrument == STRAPDOWN:
                # The mount turns with the body, so the tensor turns against it.
                j = left_jacobian(error[0], error[1], error[2])
                for axis in range(3):
                    turn = turn_of(t, -j[axis], -j[3 + axis], -j[6 + axis])
                    _put_column(channels, rotated(c, turn), gain, i, 3 + axis, out)
            t = rotated(c, t)
        for m in range(channels.shape[0]):
            before = load(context.offset, 0, m) if i == 0 else load(predicted, 0, m)
            store(predicted, 0, m, before + gain * _combined(channels[m], t))
        # The error's metres are measured at the reference, the slope's at the displaced point.
        _put_column(channels, d_e, -gain * east / per_east, i, 0, out)
        _put_column(channels, d_n, -gain * north / per_north, i, 1, out)
        _put_column(channels, d_u, -gain, i, 2, out)


@inlined
def _along(found: np.ndarray, first: int) -> Tensor:
    """Return a derivative of the spline tensor; ``first`` is the row of its first component."""
    return (
        load(found, first, 0), load(found, first + 3, 0), load(found, first + 6, 0),
        load(found, first + 9, 0), load(found, first + 12, 0), load(found, first + 15, 0),
    )  # fmt: skip


@compiled
def moving_errors(instrument: int) -> int:
    """Return the number of instrument errors B_k x on which gradient measurements depend.

    For a strapdown instrument these are the six errors of position and attitude. For other
    instruments they are the first three, the errors of position.
    """
    return 6 if instrument == STRAPDOWN else 3


@record
class Expansion:
    """Linearised h of eight runs, with h(x) and H = A B_k + D at one state x of each run.

    Attributes
    ----------
    slope : (g, 6, lanes) A, derivative of the gradiometer channels with respect to B_k x [E/m;
        E/rad]; the first :func:`moving_errors` columns are used.
    b : (:func:`moving_errors`, 15 or more, lanes) B_k, which maps states to instrument errors.
    errors : (6, 1, lanes) instrument errors B_k x of each run.
    linear : (m, n, lanes) D = C_k + W_k ∂δg/∂x, for the channels from ``first_linear`` on.
    by_tensor : (1, m, lanes) h without the terms C_k x + W_k δg.
    predicted : (1, m, lanes) h.
    context : parameters of h at the epoch.
    points : scratch.
    """

    slope: np.ndarray
    b: np.ndarray
    errors: np.ndarray
    linear: np.ndarray
    by_tensor: np.ndarray
    predicted: np.ndarray
    context: EpochContext
    points: PointScratch


@compiled
def expansion_of(model: ModelArrays) -> Expansion:
    """Return an unfilled :class:`Expansion` for a block."""
    new = lanes.lanes
    g, m, n = model.channels.shape[0], model.linear.shape[2], model.linear.shape[3]
    return Expansion(
        slope=new(g, 6),
        b=new(moving_errors(model.instrument), model.rows.shape[3]),
        errors=new(6, 1),
        linear=new(m, n),
        by_tensor=new(1, m),
        predicted=new(1, m),
        context=epoch_context(model),
        points=point_scratch(1),
    )


@compiled
def load_expansion(model: ModelArrays, group: np.ndarray, k: int, out: Expansion) -> None:
    """Fill the parts of ``out`` that do not depend on states: B_k, C_k and ``context``.

    ``group`` (lanes,) are the runs.
    """
    lanes.gather_rows(model.rows, group, k, out.b.shape[0], out.b)
    load_epoch(model, group, k, out.context)
    if model.first_linear < model.linear.shape[2]:
        lanes.gather_rows(model.linear, group, k, out.linear.shape[0], out.linear)


@inlined
def _displace(x: np.ndarray, out: Expansion) -> None:
    """Fill ``out.errors`` with the instrument errors B_k x."""
    for i in range(out.b.shape[0]):
        total = splat(0.0)
        for j in range(out.b.shape[1]):
            total += load(out.b, i, j) * load(x, 0, j)
        store(out.errors, i, 0, total)


@inlined
def _add_linear(model: ModelArrays, x: np.ndarray, evaluated: int, out: Expansion) -> None:
    """Fill h without δg; ``out.by_tensor`` already has the first ``evaluated`` channels."""
    columns = model.columns
    for c in range(out.predicted.shape[1]):
        if c >= evaluated:
            store(out.by_tensor, 0, c, load(out.context.offset, 0, c))
        total = load(out.by_tensor, 0, c)
        if c >= model.first_linear:
            for s in range(columns.shape[0]):
                total += load(out.linear, c, columns[s]) * load(x, 0, columns[s])
        store(out.predicted, 0, c, total)


@compiled
def predict_runs(
    model: ModelArrays, group: np.ndarray, count: int, k: int, x: np.ndarray, out: Expansion
) -> None:
    """Fill ``out.predicted`` with h at one state of each run.

    Parameters
    ----------
    model : arrays of a block.
    group : (lanes,) runs; unused lanes repeat a run.
    count : number of different runs in the group.
    k : epoch.
    x : (1, n, lanes) states, one run per lane.
    out : output, already filled by :func:`load_expansion`.
    """
    m, g, width = out.predicted.shape[1], out.slope.shape[0], out.predicted.shape[2]
    evaluated = 0
    if g > 0 and out.context.gain.any():
        evaluated = g
        _displace(x, out)
        by_channel = out.by_tensor.reshape((m, 1, width))[:g]
        read(
            model=model,
            k=k,
            context=out.context,
            errors=out.errors,
            vectors=1,
            count=count,
            points=out.points,
            out=by_channel,
        )
    _add_linear(model, x, evaluated, out)
    add_gravity(
        model=model,
        group=group,
        count=count,
        k=k,
        x=x,
        predicted=out.predicted,
        slope=out.linear[:0],
    )


@compiled
def expand(
    model: ModelArrays, group: np.ndarray, count: int, k: int, x: np.ndarray, out: Expansion
) -> None:
    """Fill ``out`` with h (1, m, lanes) and its Jacobian at one state of each run.

    Parameters
    ----------
    model, group, count, k, x : as in :func:`predict_runs`.
    out : output; no previous call of :func:`load_expansion` is needed.
    """
    load_expansion(model, group, k, out)
    _displace(x, out)
    evaluated = 0
    if out.slope.shape[0] > 0 and out.context.gain.any():
        evaluated = out.slope.shape[0]
        linearise_reading(
            model=model,
            k=k,
            context=out.context,
            errors=out.errors,
            count=count,
            points=out.points,
            predicted=out.by_tensor,
            out=out.slope,
        )
    else:
        out.slope[:] = 0.0
    _add_linear(model, x, evaluated, out)
    add_gravity(
        model=model, group=group, count=count, k=k, x=x, predicted=out.predicted, slope=out.linear
    )


@inlined
def _fill_lanes(states: np.ndarray, first: int, count: int, x: np.ndarray) -> None:
    """Fill x (1, n, lanes) with ``count`` of the states (N, n) from ``first`` on."""
    for r in range(x.shape[2]):
        state = states[first + min(r, count - 1)]
        for j in range(state.shape[0]):
            x[0, j, r] = state[j]


@compiled
def predict(model: ModelArrays, k: int, states: np.ndarray) -> np.ndarray:
    """Return h (N, m) at states (N, n) at epoch ``k``; ``model`` is a block of one run."""
    group, at, x = lanes.group_members(0, 1), expansion_of(model), lanes.lanes(1, states.shape[1])
    out = np.empty((states.shape[0], model.offset.shape[2]))
    load_expansion(model, group, k, at)
    for first in lanes.group_starts(states.shape[0]):
        count = lanes.count_from(first, states.shape[0])
        _fill_lanes(states, first, count, x)
        predict_runs(model, group, count, k, x, at)
        for r in range(count):
            for c in range(out.shape[1]):
                out[first + r, c] = at.predicted[0, c, r]
    return out


@compiled
def _linearise(
    model: ModelArrays,
    k: int,
    states: np.ndarray,
    x: np.ndarray,
    at: Expansion,
    predicted: np.ndarray,
    out: np.ndarray,
) -> None:
    """Fill h (N, m) and H (N, m, n) of states (N, n) at an epoch; x and ``at`` are scratch."""
    group, g, (moving, width) = lanes.group_members(0, 1), at.slope.shape[0], at.b.shape[:2]
    out[:] = 0.0
    for first in lanes.group_starts(states.shape[0]):
        count = lanes.count_from(first, states.shape[0])
        _fill_lanes(states, first, count, x)
        expand(model, group, count, k, x, at)
        for r in range(count):
            for c in range(out.shape[1]):
                predicted[first + r, c] = at.predicted[0, c, r]
                if c < g:
                    for j in range(moving):
                        for i in range(width):
                            out[first + r, c, i] += at.slope[c, j, r] * at.b[j, i, r]
                if c >= model.first_linear:
                    for i in model.columns:
                        out[first + r, c, i] += at.linear[c, i, r]


@compiled
def linearise(
    model: ModelArrays, k: int, states: np.ndarray, predicted: np.ndarray, out: np.ndarray
) -> None:
    """Fill h (N, m) and H (N, m, n) at states (N, n) at epoch ``k``.

    ``model`` is a block of one run. The array ``predicted`` receives h, the array ``out`` H.
    """
    x = lanes.lanes(1, states.shape[1])
    _linearise(
        model=model, k=k, states=states, x=x, at=expansion_of(model), predicted=predicted, out=out
    )


@compiled
def linearised(
    model: ModelArrays, at: np.ndarray, states: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return h (N, m) and H (N, m, n) at epochs ``at`` (N,), with one state for each epoch.

    ``model`` is a block of one run, and ``states`` are (N, n).
    """
    count, m = states.shape[0], model.offset.shape[2]
    predicted, out = np.empty((count, m)), np.empty((count, m, states.shape[1]))
    x, expansion = lanes.lanes(1, states.shape[1]), expansion_of(model)
    for i in range(count):
        some = slice(i, i + 1)
        _linearise(
            model=model,
            k=at[i],
            states=states[some],
            x=x,
            at=expansion,
            predicted=predicted[some],
            out=out[some],
        )
    return predicted, out
