"""h and H of the aiding sensors along INS tracks, compiled: linear but for the map's gravity.

What a GNSS receiver, a log, a barometer or a gravimeter reads depends on the INS's errors in
position, velocity and attitude linearly, to what their squares are worth (see each sensor), and on
the gravity disturbance of the map at the place, which is no straight line.
"""

from __future__ import annotations

import numpy as np

from ..gravity.ellipsoid import metres_per_radian_of
from ..gravity.field import DisturbanceMap
from ..gravity.spline import vector_at
from ..numerics import lanes
from ..numerics.kernels import compiled, copied, inlined
from ..numerics.records import record
from ..numerics.rotations import sine_cosine
from ..numerics.vectors import load, splat, store

MOVED, INS_STATES = 9, 15
"""Position, velocity and attitude error: the states on which these readings depend. Others come
after the INS's own: gravity, biases and lever arms."""


@record
class Aiding:
    """The channels of the aiding sensors as arrays.

    h(k, x) = offset_k + present_k · (A_k x[:9] + W (δg(p̂_k − x[:3]) + d) + b + L_k l). For many
    runs at once (a block) the arrays that differ from run to run have the run as leading axis.

    Attributes
    ----------
    rows : (K, e, 9) A_k [unit of the channel per unit of the state].
    bias : (e,) index of the state that is a channel's bias; −1 for none.
    arm : (e,) index of the first of three states l, errors of a lever arm [m]; −1 for none.
    by_arm : (K, e, 3) L_k [unit of the channel per m]; (K, 0, 3) without such states.
    gravity : (e, 3) W [unit of the channel per m/s²], of the disturbance ENU.
    state : the first of three states d that are what the map lacks of it; −1 for none.
    places : (K, 3) INS positions at the epochs [rad, rad, m].
    present : (K, e) one, or zero where a channel delivers nothing.
    map : the gravity disturbance of the field that the estimators assume.
    """

    rows: np.ndarray
    bias: np.ndarray
    arm: np.ndarray
    by_arm: np.ndarray
    gravity: np.ndarray
    state: int
    places: np.ndarray
    present: np.ndarray
    map: DisturbanceMap


OF_A_RUN = ("rows", "by_arm", "places", "present")
"""The arrays that differ from run to run."""


@compiled
def disturbance_at(
    aiding: Aiding, run: int, k: int, error: np.ndarray, value: np.ndarray, slope: np.ndarray
) -> None:
    """Fill the gravity disturbance (3,), ENU [m/s²], where a run is if its INS errs so.

    Parameters
    ----------
    aiding, run, k : of a block; run and epoch.
    error : (3,) position error ENU [m].
    slope : (3, 3) output, how it changes with a metre of error to the east, to the north and up.
    """
    if aiding.map.coefficients.size == 0:
        value[:] = 0.0
        slope[:] = 0.0
        return
    place = aiding.places[run, k]
    sine, cosine = sine_cosine(place[0])
    per_north, per_east = metres_per_radian_of(sine, cosine, place[2])
    at = np.empty(3)
    at[0] = place[0] - error[1] / per_north
    at[1] = place[1] - error[0] / per_east
    at[2] = place[2] - error[2]
    along = np.empty((3, 3))
    vector_at(at, aiding.map.origin, aiding.map.step, aiding.map.coefficients, value, along)
    for i in range(3):
        slope[i, 0] = -along[i, 1] / per_east
        slope[i, 1] = -along[i, 0] / per_north
        slope[i, 2] = -along[i, 2]


@compiled
def weighs_gravity(aiding: Aiding, run: int, k: int) -> bool:
    """Return whether any channel that a run has at an epoch depends on the map's gravity."""
    for c in range(aiding.gravity.shape[0]):
        if aiding.present[run, k, c] != 0.0:
            for i in range(3):
                if aiding.gravity[c, i] != 0.0:
                    return True
    return False


@inlined
def column_of(aiding: Aiding, run: int, k: int, c: int, j: int) -> float:
    """Return what a channel that a run has at an epoch makes of a state behind the INS's own."""
    value = 1.0 if aiding.bias[c] == j else 0.0
    if aiding.arm[c] >= 0 and aiding.arm[c] <= j < aiding.arm[c] + 3:
        value += aiding.by_arm[run, k, c, j - aiding.arm[c]]
    if aiding.state >= 0 and aiding.state <= j < aiding.state + 3:
        value += aiding.gravity[c, j - aiding.state]
    return value


@compiled
def linearise_aiding(
    aiding: Aiding,
    group: np.ndarray,
    count: int,
    k: int,
    offset: np.ndarray,
    x: np.ndarray,
    predicted: np.ndarray,
    slope: np.ndarray,
) -> None:
    """Fill h, of all states, and its derivative by the first nine, of each run.

    Parameters
    ----------
    aiding : of a block.
    group : (lanes,) runs, of which ``count`` differ.
    k : epoch.
    offset, predicted : (1, m, lanes); the last e of the m channels are used and filled.
    x : (1, n, lanes) states.
    slope : (e, 9, lanes) output.
    """
    channels = slope.shape[0]
    if channels == 0:
        return
    first = predicted.shape[1] - channels
    lanes.gather_rows(aiding.rows, group, k, channels, slope)
    for c in range(channels):
        total = load(offset, 0, first + c)
        for j in range(MOVED):
            total += load(slope, c, j) * load(x, 0, j)
        store(predicted, 0, first + c, total)
        for r in range(count):
            if aiding.present[group[r], k, c] != 0.0:
                for j in range(INS_STATES, x.shape[1]):
                    predicted[0, first + c, r] += column_of(aiding, group[r], k, c, j) * x[0, j, r]
    error, value, along = np.empty(3), np.empty(3), np.empty((3, 3))
    for r in range(count):
        run = group[r]
        if not weighs_gravity(aiding, run, k):
            continue
        for i in range(3):
            error[i] = x[0, i, r]
        disturbance_at(aiding, run, k, error, value, along)
        for c in range(channels):
            if aiding.present[run, k, c] != 0.0:
                for i in range(3):
                    weight = aiding.gravity[c, i]
                    predicted[0, first + c, r] += weight * value[i]
                    for j in range(3):
                        slope[c, j, r] += weight * along[i, j]


@compiled
def read_aiding_pairs(
    aiding: Aiding,
    group: np.ndarray,
    count: int,
    k: int,
    x: np.ndarray,
    lower: np.ndarray,
    spread: float,
    slope: np.ndarray,
    odd: np.ndarray,
    even: np.ndarray,
) -> None:
    """Fill half the difference and half the sum of h(x ± d_q) − h(x), d_q = spread · L_q.

    Parameters
    ----------
    aiding, group, count, k, x : as in :func:`linearise_aiding`.
    lower : (n, n, lanes) lower triangular root of P.
    slope : (e, 9, lanes) at x.
    odd, even : (m, n, lanes) output, of the last e channels.
    """
    channels, n = slope.shape[0], odd.shape[1]
    if channels == 0:
        return
    first, factor = odd.shape[0] - channels, splat(spread)
    for c in range(channels):
        for q in range(n):
            total = splat(0.0)
            for j in range(q, MOVED):
                total += load(slope, c, j) * load(lower, j, q)
            store(odd, first + c, q, factor * total)
            store(even, first + c, q, splat(0.0))
            for r in range(count):
                if aiding.present[group[r], k, c] != 0.0:
                    for j in range(max(q, INS_STATES), n):
                        value = column_of(aiding, group[r], k, c, j) * lower[j, q, r]
                        odd[first + c, q, r] += spread * value
    error, centre, plus, minus = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    along, unused = np.empty((3, 3)), np.empty((3, 3))
    for r in range(count):
        run = group[r]
        if not weighs_gravity(aiding, run, k):
            continue
        for i in range(3):
            error[i] = x[0, i, r]
        disturbance_at(aiding, run, k, error, centre, along)
        for q in range(3):  # the others do not move the place
            for i in range(3):
                error[i] = x[0, i, r] + (spread * lower[i, q, r] if i >= q else 0.0)
            disturbance_at(aiding, run, k, error, plus, unused)
            for i in range(3):
                error[i] = x[0, i, r] - (spread * lower[i, q, r] if i >= q else 0.0)
            disturbance_at(aiding, run, k, error, minus, unused)
            for c in range(channels):
                if aiding.present[run, k, c] == 0.0:
                    continue
                for i in range(3):
                    weight = aiding.gravity[c, i]
                    straight = 0.0
                    for j in range(q, 3):
                        straight += along[i, j] * lower[j, q, r]
                    bent = 0.5 * (plus[i] - minus[i]) - spread * straight
                    odd[first + c, q, r] += weight * bent
                    even[first + c, q, r] += weight * (0.5 * (plus[i] + minus[i]) - centre[i])


@copied
def predict_aiding(aiding: Aiding, k: int, states: np.ndarray, out: np.ndarray) -> None:
    """Add h without its offset to the last e channels of out (N, m) at states (N, n), of one run.

    ``aiding`` is a block of one run.
    """
    channels = aiding.bias.shape[0]
    first = out.shape[1] - channels
    value, along = np.empty(3), np.empty((3, 3))
    weighs = weighs_gravity(aiding, 0, k)
    for p in range(states.shape[0]):
        if weighs:
            disturbance_at(aiding, 0, k, states[p, :3], value, along)
        for c in range(channels):
            if aiding.present[0, k, c] == 0.0:
                continue
            for j in range(MOVED):
                out[p, first + c] += aiding.rows[0, k, c, j] * states[p, j]
            for j in range(INS_STATES, states.shape[1]):
                out[p, first + c] += column_of(aiding, 0, k, c, j) * states[p, j]
            if weighs:
                for i in range(3):
                    out[p, first + c] += aiding.gravity[c, i] * value[i]


@copied
def linearise_aiding_of_run(
    aiding: Aiding, k: int, state: np.ndarray, predicted: np.ndarray, out: np.ndarray
) -> None:
    """Add h without its offset to the last e channels of ``predicted`` (m,); fill their H (m, n).

    At a state (n,), of a block of one run.
    """
    channels = aiding.bias.shape[0]
    first = out.shape[0] - channels
    value, along = np.empty(3), np.empty((3, 3))
    weighs = weighs_gravity(aiding, 0, k)
    if weighs:
        disturbance_at(aiding, 0, k, state[:3], value, along)
    for c in range(channels):
        if aiding.present[0, k, c] == 0.0:
            continue
        for j in range(MOVED):
            out[first + c, j] = aiding.rows[0, k, c, j]
        for j in range(INS_STATES, state.shape[0]):
            out[first + c, j] = column_of(aiding, 0, k, c, j)
        for j in range(state.shape[0]):
            predicted[first + c] += out[first + c, j] * state[j]
        if weighs:
            for i in range(3):
                predicted[first + c] += aiding.gravity[c, i] * value[i]
                for j in range(3):
                    out[first + c, j] += aiding.gravity[c, i] * along[i, j]
