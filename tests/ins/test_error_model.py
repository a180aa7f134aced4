"""F, Φ and Q are the linearisation of the mechanization, entry by entry and flight by flight."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from frame_oracles import mechanization_jacobian, metres
from oracles import dense_model
from scipy.linalg import block_diag, expm
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from thinning import thinned

from ggbench.ins import adjoint, error_model, strapdown
from ggbench.ins.delayed_rows import intervals_of, multiply_by_inverse
from ggbench.ins.noise import noise_roots
from ggbench.numerics.lanes import in_lanes, lanes
from ggbench.trajectory.truth import Segment, Trajectory, fly

# Which entries of F are not zero for a general state of motion: x, by rows.
PATTERN = """
x.x.x..........
x.xx...........
.....x.........
x.xxxx.xx...xxx
x.xxxxx.x...xxx
x.xxx.xx....xxx
x.x.x..xxxxx...
x.xx..x.xxxx...
x.xx..xx.xxx...
...............
...............
...............
...............
...............
...............
"""
STRUCTURE = np.array([[c == "x" for c in row] for row in PATTERN.split()])


def random_states(count: int, seed: int):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield (
            np.array([np.radians(rng.uniform(-80, 80)), rng.uniform(-3, 3), rng.uniform(0, 30e3)]),
            rng.uniform(-300.0, 300.0, 3),
            Rotation.from_quat(rng.normal(size=4)).as_matrix(),
            rng.uniform(-20.0, 20.0, 3),
            rng.uniform(-0.1, 0.1, 3),
        )


def system_matrix(position, velocity, c_nb, force) -> np.ndarray:
    matrix = np.full((15, 15), np.nan)
    dense_model.system_matrix(position, velocity, c_nb, c_nb @ force, matrix)
    return matrix


def test_every_entry_of_f_against_the_mechanization():
    """F is the derivative of the mechanization's own rates, in each of its 225 entries.

    Each entry is held to 1e-7 of itself (plus the rounding of the difference), not of its block:
    the terms of curvature are 1e-4 of their neighbours. The derivative of the radii with latitude
    is part of F, so nothing is frozen.
    """
    resolution = []
    for state in random_states(80, seed=1):
        numeric, rounding = mechanization_jacobian(*state)
        matrix = system_matrix(*state[:4])
        tolerance = 1e-7 * np.abs(numeric) + rounding
        excess = np.abs(matrix - numeric) / np.maximum(tolerance, 1e-300)
        worst = np.unravel_index(excess.argmax(), excess.shape)
        assert excess.max() < 1.0, f"entry {worst}: {matrix[worst]} is not {numeric[worst]}"
        np.testing.assert_array_equal(matrix[~STRUCTURE], 0.0)
        resolution.append(rounding[STRUCTURE] / np.abs(numeric[STRUCTURE]))
    # Every entry that is not zero stood out from the rounding, by a thousand in most states.
    assert np.median(resolution, axis=0).max() < 1e-3


def test_f_has_no_entry_that_the_mechanization_lacks():
    """The zeros of F are zeros of the mechanization, whatever the state."""
    for state in random_states(20, seed=2):
        numeric, rounding = mechanization_jacobian(*state)
        assert (np.abs(numeric) <= rounding)[~STRUCTURE].all()


def test_f_of_an_interval_is_that_of_its_middle():
    """Between two samples far apart F is that of the state halfway: of all of it.

    The second-order rule of the transitions. (Over one IMU interval its ends differ by 1e-6.)
    """
    rng = np.random.default_rng(7)
    turn = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    ends = np.array([[0.5, 0.1, 1e3], [0.7, 0.2, 21e3]])
    velocities = np.array([[100.0, -50.0, 20.0], [-30.0, 200.0, 60.0]])
    force = np.array([1.0, 2.0, 9.0])
    between = dense_model.system_matrices(
        ends, velocities, np.stack([turn, turn]), force[np.newaxis] * 0.05, 0.05
    )[0]
    middle = system_matrix(ends.mean(axis=0), velocities.mean(axis=0), turn, force)
    np.testing.assert_allclose(between, middle, rtol=1e-12, atol=1e-25)


def natural_units(position: np.ndarray) -> np.ndarray:
    """(15,) scale that makes errors of a like size in F's variables: metres, m/s, µrad..."""
    metre = 1.0 / 6.4e6
    return np.repeat([metre, 1.0, 1e-3, 1e-6, 1e-3], 3) * [1, 1, 6.4e6, *np.ones(12)]


@pytest.mark.parametrize("dt", [0.005, 0.05, 0.1, 0.5])
def test_one_step_is_van_loans(dt):
    """Φ and Q of an IMU interval are those of the matrix exponential of Van Loan (1978).

    For the state in metres at both ends, which are the same place here. Entries of Q are compared
    with the product of their two standard deviations.
    """
    for state in random_states(20, seed=3):
        matrix = system_matrix(*state[:4])
        noise = error_model.noise_psd(1e-6, 1e-12)
        transition, process_cov = dense_model.transitions(
            matrix[np.newaxis], np.stack([state[0], state[0]]), np.array([1]), dt, noise
        )
        change = block_diag(metres(state[0]), np.eye(12))
        scaled = change @ matrix @ np.linalg.inv(change)
        # Van Loan in units that keep the exponential's rounding small.
        units = natural_units(state[0]) * [6.4e6, 6.4e6, 1.0, *np.ones(12)]
        scaled *= units / units[:, None]
        small = noise / np.outer(units, units)
        oracle = expm(np.block([[-scaled, small], [np.zeros((15, 15)), scaled.T]]) * dt)
        phi = oracle[15:, 15:].T
        q = phi @ oracle[:15, 15:]
        np.testing.assert_allclose(
            transition[0] * units / units[:, None], phi, rtol=1e-9, atol=1e-12
        )
        deviation = np.sqrt(np.diag(q))
        deviation[9:] = 1.0
        np.testing.assert_allclose(
            process_cov[0] / np.outer(units, units) / np.outer(deviation, deviation),
            q / np.outer(deviation, deviation),
            rtol=0.0,
            atol=1e-9,
        )


def test_fewer_orders_do_where_errors_are_slow():
    """Where the short series is taken, Φ and Q are those of the long one to 1e-12, up to its limit.

    It is not taken where an interval is long, or anything but the navigation state moves.
    """
    plain = noise_roots(error_model.noise_psd(1e-6, 1e-12), False)
    longest = 0.0
    for state in random_states(20, seed=4):
        entries = in_lanes(dense_model.sparse(system_matrix(*state[:4])[np.newaxis])[np.newaxis])
        dt = max(dt for dt in np.geomspace(1e-3, 1.0, 200) if adjoint.is_slow(entries, dt, plain))
        longest = max(longest, dt)
        assert not adjoint.is_slow(entries, 1.1 * dt, plain)
        for moved in (
            noise_roots(error_model.noise_psd(1e-6, 1e-12), True),
            noise_roots(error_model.noise_psd(1e-6, 1e-12), False, (1.0, 1.0, 1.0)),
        ):
            assert not adjoint.is_slow(entries, 1e-3, moved)
        f, columns = lanes(1, adjoint.SCALED), lanes(15, 15)
        adjoint.scaled_entries(entries, 0, dt, f)
        columns[np.arange(15), np.arange(15)] = natural_units(state[0])[:, np.newaxis]
        short, factors = columns.copy(), np.zeros((2, adjoint.MOST_FACTORS, 15, columns.shape[2]))
        adjoint.propagate_short_series(f, plain, short, factors[0])
        adjoint.propagate(f, plain, columns, adjoint.series_terms(), factors[1])
        # Blocks of Φ − I, and Q in units of its deviations: nothing that is small goes unseen.
        units = natural_units(state[0])
        change, expected = (
            c[..., 0] / units[:, None] ** 2 * units - np.eye(15) for c in (short, columns)
        )
        for i, j in itertools.product(range(0, 9, 3), range(0, 15, 3)):
            block = np.s_[i : i + 3, j : j + 3]
            np.testing.assert_allclose(
                change[block], expected[block], rtol=0.0, atol=1e-9 * np.abs(expected[block]).max()
            )
        q = np.einsum("smi,smj->sij", factors[..., 0], factors[..., 0])
        deviation = np.sqrt(np.diag(q[1])) + 1e-30
        np.testing.assert_allclose(
            q[0] / deviation / deviation[:, None],
            q[1] / deviation / deviation[:, None],
            rtol=0.0,
            atol=1e-12,
        )
    assert longest > 0.08  # an ordinary IMU's interval


# Along a flight.


@pytest.fixture(scope="module")
def flown() -> tuple[Trajectory, np.ndarray, np.ndarray]:
    """Two minutes of hard manoeuvres, and the error-free increments."""
    truth = fly(
        position=np.array([np.radians(47.0), np.radians(8.0), 4000.0]),
        speed=150.0,
        heading=1.0,
        pitch=0.05,
        roll=0.0,
        segments=[
            Segment(40.0, turn_rate=np.radians(3.0), acceleration=1.0),
            Segment(40.0, turn_rate=np.radians(-4.0), climb_rate=np.radians(0.2)),
            Segment(40.0, acceleration=-1.0, climb_rate=np.radians(-0.3)),
        ],
        dt=0.05,
    )
    count = len(truth.times) - 1
    increments = strapdown.error_free_increments(
        truth.positions, truth.velocities, truth.attitudes, np.zeros((count, 3)), truth.dt
    )
    return truth, *increments


def run_ins(flown, error: np.ndarray, noise: tuple = (0.0, 0.0)):
    """INS track from an initial error (15,), and its (N + 1, 9) error against the truth."""
    truth, angles, velocities = flown
    turn = Rotation.from_rotvec(-error[6:9]).as_matrix()
    to_radians = np.linalg.inv(metres(truth.positions[0]))
    measured = (
        angles + error[9:12] * truth.dt + noise[0],
        velocities + error[12:15] * truth.dt + noise[1],
    )
    track = strapdown.navigate(
        truth.positions[0] + to_radians @ error[0:3],
        truth.velocities[0] + error[3:6],
        turn @ truth.attitudes[0],
        *measured,
        truth.dt,
    )
    return *track, measured[1]


def errors_at(flown, track, samples: np.ndarray) -> np.ndarray:
    """(K, 9) position [m], velocity, attitude error at samples; local metres from Cartesian."""
    truth = flown[0]
    out = np.empty((len(samples), 9))
    for row, n in zip(out, samples, strict=True):
        row[:3] = metres(track[0][n]) @ (track[0][n] - truth.positions[n])
        row[3:6] = track[1][n] - truth.velocities[n]
        row[6:] = Rotation.from_matrix(truth.attitudes[n] @ track[2][n].T).as_rotvec()
    return out


INITIAL = np.concatenate(
    [
        [600.0, -400.0, 300.0],
        [3.0, -4.0, 2.0],
        [2e-3, -1e-3, 3e-3],
        [2e-6, -3e-6, 1e-6],
        [2e-2, 1e-2, -3e-2],
    ]
)
SCALES = np.array([1e3] * 3 + [10.0] * 3 + [5e-3] * 3)


def test_transitions_compose_the_exponentials(flown):
    """Between epochs Φ is the product of the steps' exponentials, and Q their accumulated noise.

    In the state's metres: the change of variables is that of the ends of the interval.
    """
    truth, _, velocities = flown
    matrices = dense_model.system_matrices(
        truth.positions, truth.velocities, truth.attitudes, velocities, truth.dt
    )
    epochs = np.array([20, 21, 60])
    accelerometer, gyro = 1e-3, 1e-5
    transition, process_cov = dense_model.transitions(
        matrices,
        truth.positions,
        epochs,
        truth.dt,
        error_model.noise_psd(accelerometer**2, gyro**2),
    )
    noise = np.diag(np.repeat([0.0, accelerometer**2, gyro**2, 0.0, 0.0], 3))

    def in_metres(n: int) -> np.ndarray:
        return block_diag(metres(truth.positions[n]), np.eye(12))

    start = 0
    for k, end in enumerate(epochs):
        phi, q = np.eye(15), np.zeros((15, 15))
        for n in range(start, end):
            # Van Loan for one step, in units that keep the exponential's rounding small.
            change = in_metres(n)
            back = np.linalg.inv(change)
            scaled = change @ matrices[n] @ back
            block = expm(np.block([[-scaled, noise], [np.zeros((15, 15)), scaled.T]]) * truth.dt)
            step = back @ block[15:, 15:].T @ change
            phi = step @ phi
            q = step @ q @ step.T + back @ block[15:, 15:].T @ block[:15, 15:] @ back.T
        expected = in_metres(end) @ phi @ np.linalg.inv(in_metres(start))
        expected_q = in_metres(end) @ q @ in_metres(end).T
        np.testing.assert_allclose(transition[k], expected, rtol=1e-9, atol=1e-11)
        deviation = np.sqrt(np.diag(expected_q))
        deviation[9:] = 1.0
        scale = np.outer(deviation, deviation)
        np.testing.assert_allclose(process_cov[k] / scale, expected_q / scale, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(process_cov[k], process_cov[k].T, rtol=1e-14)
        start = end


def test_open_loop_error_is_the_propagated_initial_error(flown):
    """A run's INS error is Φ times its initial error, up to the square of the error.

    Halving the error quarters what Φ, taken along the INS's own track, leaves unexplained.
    """
    truth = flown[0]
    samples = np.arange(600, 2401, 600)
    unexplained = []
    for factor in (1.0, 0.5, 0.25):
        track = run_ins(flown, factor * INITIAL)
        matrices = dense_model.system_matrices(*track, truth.dt)
        transition, _ = dense_model.transitions(
            matrices, track[0], samples, truth.dt, error_model.noise_psd(0.0, 0.0)
        )
        state, predicted = factor * INITIAL, []
        for phi in transition:
            state = phi @ state
            predicted.append(state[:9])
        true = errors_at(flown, track, samples)
        unexplained.append(np.linalg.norm((true - predicted) / SCALES, axis=1))
        assert (unexplained[-1] < 0.01 * np.linalg.norm(true / SCALES, axis=1)).all()
    unexplained = np.array(unexplained)
    print("unexplained share", unexplained, unexplained[:-1] / unexplained[1:])
    assert (np.abs(unexplained[:-1] / unexplained[1:] - 4.0) < 0.5).all()


@thinned("delay", [0.0, 0.05, 0.35, 3.1, 3.093, 0.02])
def test_delayed_rows(flown, delay):
    """B x(t) is the position and attitude error of the run at t − τ, also between samples."""
    truth = flown[0]
    track = run_ins(flown, 0.02 * INITIAL)
    matrices = dense_model.system_matrices(*track, truth.dt)
    epochs = np.arange(100, 2401, 100)
    rows = dense_model.delayed_rows(
        matrices, track[0], epochs, np.full(len(epochs), delay), truth.dt
    )
    assert rows.shape == (len(epochs), 6, 15)
    now = np.hstack(
        [errors_at(flown, track, epochs), np.tile(0.02 * INITIAL[9:], (len(epochs), 1))]
    )
    earlier = epochs - delay / truth.dt
    below = np.floor(earlier + 1e-9).astype(int)
    share = (earlier - below)[:, None]
    then = (1.0 - share) * errors_at(flown, track, below)
    then += share * errors_at(flown, track, np.minimum(below + 1, 2400))
    tilt, then = then[:, 6:9], then[:, :3]
    predicted, attitude = np.split(np.einsum("kij,kj->ki", rows, now), 2, axis=1)
    # The errors are 20 m and grow by 0.1 m/s.
    moved = np.abs(then - now[:, :3]).max()
    print(delay, np.abs(predicted - then).max(), "of", moved)
    assert np.abs(predicted - then).max() < 1e-3
    # The attitude errors are 1e-5 rad and change with the turn of the navigation axes.
    assert np.abs(attitude - tilt).max() < 1e-3 * np.abs(tilt).max()
    if delay > 0.1:
        assert moved > 0.03


def test_rows_times_the_inverse_of_a_transition():
    """Of any transition whose biases depend on themselves alone, however far from a triangle."""
    generator = np.random.default_rng(4)
    rows, phi = generator.normal(size=(6, 15)), np.eye(15)
    phi[:9] += generator.uniform(-0.15, 0.15, (9, 15))
    phi[range(9, 15), range(9, 15)] = generator.uniform(0.5, 1.0, 6)
    result, factors = in_lanes(rows[np.newaxis]), in_lanes(phi[np.newaxis])
    multiply_by_inverse(result, factors)
    np.testing.assert_allclose(result[:, :, 0], rows @ np.linalg.inv(phi), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("delay", [0.0, 0.01, 0.05, 0.0749, 0.08, 0.35, 3.093, 4.99])
def test_a_delay_spans_the_intervals_that_it_reaches_into(delay):
    """The instant lies in the first interval, ``part`` before its end, next to the sample named.

    Where metres are turned into radians; half an interval of a fast aircraft moves that by 1e-6.
    """
    dt, epoch = 0.05, 100
    first, part, nearest = intervals_of(delay, epoch, dt)
    instant = epoch * dt - delay
    assert abs(nearest * dt - instant) <= 0.5 * dt + 1e-9
    assert part + (epoch - first - 1) * dt == pytest.approx(delay, abs=1e-9)
    assert first == epoch or -1e-9 < part <= dt + 1e-9


def test_delay_does_not_reach_before_the_start(flown):
    """A first epoch whose delay is longer than the flight so far sees the state at the start."""
    truth = flown[0]
    track = run_ins(flown, 0.02 * INITIAL)
    matrices = dense_model.system_matrices(*track, truth.dt)
    rows = dense_model.delayed_rows(matrices, track[0], np.array([20]), np.array([1.0]), truth.dt)
    transition, _ = dense_model.transitions(
        matrices, track[0], np.array([20]), truth.dt, error_model.noise_psd(0.0, 0.0)
    )
    np.testing.assert_allclose(
        rows[0] @ transition[0], np.eye(15)[[0, 1, 2, 6, 7, 8]], rtol=0.0, atol=1e-9
    )


@pytest.mark.long
def test_process_noise_is_the_scatter_of_real_runs(flown):
    """Errors of INS runs that differ in IMU noise alone have covariance Q, all 9 by 9 of it.

    Two tests of 400 runs, each with a false-alarm probability of 1e-3 (and a fixed seed): the mean
    of eᵀ Q⁻¹ e, and the likelihood ratio of the sample covariance against Q.
    """
    truth = flown[0]
    count = 1000  # 50 s, through a turn
    short = (
        Trajectory(
            truth.times[: count + 1],
            truth.dt,
            truth.positions[: count + 1],
            truth.velocities[: count + 1],
            truth.attitudes[: count + 1],
        ),
        flown[1][:count],
        flown[2][:count],
    )
    gyro, accelerometer = 3e-6, 1e-3
    epochs = np.array([count // 2, count])
    matrices = dense_model.system_matrices(
        short[0].positions, short[0].velocities, short[0].attitudes, short[2], truth.dt
    )
    phi, q = dense_model.transitions(
        matrices,
        short[0].positions,
        epochs,
        truth.dt,
        error_model.noise_psd(accelerometer**2, gyro**2),
    )
    covariance = (phi[1] @ q[0] @ phi[1].T + q[1])[:9, :9]
    rng = np.random.default_rng(5)
    runs = 400
    errors = np.empty((runs, 9))
    for run in range(runs):
        noise = [
            root * np.sqrt(truth.dt) * rng.standard_normal((count, 3))
            for root in (gyro, accelerometer)
        ]
        track = run_ins(short, np.zeros(15), noise)
        errors[run] = errors_at(short, track, np.array([count]))[0]
    scale = np.sqrt(np.diag(covariance))
    white = np.linalg.solve(
        np.linalg.cholesky(covariance / np.outer(scale, scale)), (errors / scale).T
    )
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 9 * runs)
    assert low < (white**2).sum() < high
    sample = white @ white.T / runs
    ratio = runs * (np.trace(sample) - np.linalg.slogdet(sample)[1] - 9)
    assert ratio < chi2.ppf(1.0 - 1e-3, 45)
    # Power: noise blocks exchanged, or Q a tenth too large, would have been noticed.
    assert 9 * runs / 1.1 < low
