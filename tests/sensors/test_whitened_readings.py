"""Coloured noise ahead of every estimator: h and H combine the readings as whitening does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from laws import likely
from scipy.stats import chi2
from small_cases import rough_map, small_case, small_flight
from small_noise import NOISE

from ggbench.errors import GGBenchError
from ggbench.estimators.ekf import ExtendedKalmanFilter
from ggbench.estimators.gauss_newton import GaussNewton
from ggbench.gravity.ellipsoid import metres_per_radian
from ggbench.judging.references import CaseBound
from ggbench.judging.run_errors import WINDOWS, evaluate
from ggbench.simulation.flight_bounds import flight_bound
from ggbench.simulation.runs import simulate, simulate_block


@pytest.fixture(scope="module")
def coloured(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """A map of 300 E, and an instrument of two channels with coloured noise of some E."""
    folder = Path(tmp_path_factory.mktemp("coloured"))
    NOISE.write(folder / "noise.json")
    return {
        "field.source": rough_map(folder / "map.nc", rms=300.0),
        "gradiometer.instrument": "local-level",
        "gradiometer.components": ["xx", "xz"],
        "gradiometer.noise_eotvos": None,
        "gradiometer.coloured_noise": str(folder / "noise.json"),
        "trajectory.segment": [{"duration_s": 20.0, "turn_rate_deg_per_s": 2.0}],
    }


def test_h_is_the_whitened_field_at_the_displaced_track(coloured):
    """In plain NumPy: every reading at the INS position then, less the position error of now."""
    flight = small_flight(coloured | {"truth.gradiometer.dropouts_s": [[9.5, 12.5]]})
    problem, _ = simulate(flight, 5, 1)
    states = 20.0 * np.random.default_rng(1).normal(size=(problem.epochs, problem.dimension))
    whitening = NOISE.whitening(flight.times, flight.absent)
    channels = np.array([[1.0, 0, 0, 0, 0, 0], [0, 0, 1.0, 0, 0, 0]])
    track, found = problem.track.positions, problem.model.predict_along
    for k, state in enumerate(states):
        expected = np.zeros(2)
        for weights, lag in zip(whitening.weights[k], whitening.lags[k], strict=True):
            if lag < 0:
                continue
            north, east = metres_per_radian(track[k - lag])
            place = track[k - lag] - state[[1, 0, 2]] / [north, east, 1.0]
            expected += weights @ channels @ flight.model_field.tensor(*place)
        np.testing.assert_allclose(
            found(np.array([k]), state[np.newaxis])[0], expected, rtol=0.0, atol=1e-4
        )
    assert not problem.present[9:12].any()
    np.testing.assert_array_equal(problem.measurements[9:12], 0.0)
    assert list(whitening.lags[12]) == [0, 4, 5]  # behind the gap of three readings


def test_the_jacobian_is_the_slope_of_h(coloured):
    """Central differences of a metre, at states of some metres, one and many at a time."""
    problem, _ = simulate(small_flight(coloured), 5, 1)
    state = np.random.default_rng(2).normal(size=problem.dimension)
    for k in (0, 1, 7):
        slope = problem.model.jacobian(k, state)
        assert np.abs(slope[:, :3]).max() > 1e-3
        np.testing.assert_array_equal(slope[:, 3:], 0.0)
        for axis in range(3):
            step = np.eye(problem.dimension)[axis]
            ends = problem.model.predict(k, np.stack([state + step, state - step]))
            np.testing.assert_allclose(0.5 * (ends[0] - ends[1]), slope[:, axis], atol=2e-4)
        np.testing.assert_array_equal(
            problem.model.jacobian_along(np.array([k]), state[np.newaxis])[0], slope
        )


def test_mounting_angles_turn_each_of_the_combined_readings(coloured):
    """The slope of h by the three states, by central differences of a tenth of a milliradian."""
    mounted = coloured | {"gradiometer.mounting_sigma_arcmin": 3.0}
    problem, _ = simulate(small_flight(mounted), 5, 1)
    state = 1e-3 * np.random.default_rng(2).normal(size=problem.dimension)
    for k in (0, 1, 7):
        slope = problem.model.jacobian(k, state)[:, 15:]
        assert slope.shape == (2, 3) and np.abs(slope).max() > 1e3
        for axis in range(3):
            step = 1e-4 * np.eye(problem.dimension)[15 + axis]
            ends = problem.model.predict(k, np.stack([state + step, state - step]))
            np.testing.assert_allclose((ends[0] - ends[1]) / 2e-4, slope[:, axis], atol=1e-3)


@pytest.mark.parametrize("mounting_arcmin", [0.0, 3.0])
def test_readings_are_whitened_as_they_come(coloured, mounting_arcmin):
    """What truth leaves is the white noise that was drawn: its squares follow χ².

    Also of a mount that is turned by angles which are states.
    """
    flight = small_flight(
        coloured
        | {"initial_error.velocity_mps": 1e-3}
        | {"gradiometer.mounting_sigma_arcmin": mounting_arcmin}
    )
    block, truth = simulate_block(flight, 5, range(50))
    np.testing.assert_array_equal(block.noise_cov, np.diag(NOISE.deviations**2))
    left = [
        block.problem(run).measurements
        - block.problem(run).model.predict_along(np.arange(block.epochs), truth.error_state[run])
        for run in range(block.runs)
    ]
    white = np.stack(left) / NOISE.deviations
    assert likely((white**2).sum(), chi2(white.size))
    later = (white[:, 1:] * white[:, :-1]).mean(axis=(0, 1))
    assert (np.abs(later) < 4.0 / np.sqrt(50 * (block.epochs - 1))).all()  # 4 σ: 1e-4 together


def test_constant_biases_are_whitened_as_the_readings_are(coloured):
    """Columns of the biases: the whitening of ones in one channel, across a gap.

    Negative control: columns that are not whitened differ by more than a tenth.
    """
    gap = {"truth.gradiometer.dropouts_s": [[9.5, 12.5]]}
    flight = small_flight(coloured | gap | {"gradiometer.bias_eotvos": 50.0})
    problem, _ = simulate(flight, 5, 1)
    epochs = np.arange(problem.epochs)
    slopes = problem.model.jacobian_along(epochs, np.zeros((problem.epochs, problem.dimension)))
    biases = slopes[:, :, 15:]
    whitening = NOISE.whitening(flight.times, flight.absent)
    expected = [whitening.apply(np.tile(unit, (problem.epochs, 1))) for unit in np.eye(2)]
    np.testing.assert_allclose(biases, np.stack(expected, axis=-1), rtol=0.0, atol=1e-12)
    assert not biases[9:12].any()
    assert np.abs(biases[5] - np.eye(2)).max() > 0.1


def test_the_information_on_biases_is_that_of_the_dense_covariance(coloured):
    """Generalised least squares in plain NumPy, with the noise's covariance of all readings."""
    flight = small_flight(coloured | {"gradiometer.bias_eotvos": 50.0})
    problem, _ = simulate(flight, 5, 1)
    epochs = np.arange(problem.epochs)
    slopes = problem.model.jacobian_along(epochs, np.zeros((problem.epochs, problem.dimension)))
    inverse = np.linalg.inv(problem.noise_cov)
    information = np.einsum("kca,cd,kdb->ab", slopes[:, :, 15:], inverse, slopes[:, :, 15:])
    lags = NOISE.autocovariance(problem.epochs)
    blocks = [[lags[i - j] if i >= j else lags[j - i].T for j in epochs] for i in epochs]
    ones = np.tile(np.eye(2), (problem.epochs, 1))
    exact = ones.T @ np.linalg.solve(np.block(blocks), ones)
    np.testing.assert_allclose(information, exact, rtol=1e-8)


@pytest.mark.parametrize("bias_eotvos", [0.0, 50.0])
def test_biases_of_truth_reach_whitened_readings(coloured, bias_eotvos):
    """With the true states, residuals are white of the declared σ; χ² at its false-alarm rate."""
    flight = small_flight(
        coloured | {"initial_error.velocity_mps": 1e-3, "gradiometer.bias_eotvos": bias_eotvos}
    )
    block, truth = simulate_block(flight, 5, range(50))
    white, blind = [], []
    for run in range(block.runs):
        problem, states = block.problem(run), truth.error_state[run]
        for found, at in ((white, states), (blind, states * (np.arange(states.shape[-1]) < 15))):
            found.append(problem.measurements - problem.model.predict_along(np.arange(20), at))
    squares = (np.stack(white) / NOISE.deviations) ** 2
    assert likely(squares.sum(), chi2(squares.size))
    unmodelled = (np.stack(blind) / NOISE.deviations) ** 2
    assert likely(unmodelled.sum(), chi2(squares.size)) == (bias_eotvos == 0.0)


@pytest.mark.parametrize("spread", [1.0, 4.0])
def test_white_noise_in_a_file_is_white_noise(coloured, tmp_path, spread):
    """A negative control: of order zero the problem is that of noise_eotvos, bit by bit."""
    from ggbench.gravity.coloured_noise import VectorAutoregression

    path = tmp_path / "white.json"
    VectorAutoregression(
        ("xx", "xz"), 1.0, np.zeros((0, 2, 2)), spread**2 * np.eye(2), "white"
    ).write(path)
    one = small_case(coloured | {"gradiometer.coloured_noise": str(path)})
    two = small_case(
        {k: v for k, v in coloured.items() if "noise" not in k}
        | {"gradiometer.noise_eotvos": spread}
    )
    from ggbench.simulation.error_free_flight import prepare

    (first, _), (second, _) = (simulate(prepare(case), 5, 1) for case in (one, two))
    np.testing.assert_allclose(first.measurements, second.measurements, rtol=0.0, atol=1e-9)
    np.testing.assert_array_equal(first.noise_cov, second.noise_cov)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"gradiometer.components": ["xx", "yz"]}, "has components xx, xz, but the gradiometer"),
        ({"gradiometer.period_s": 2.0}, "has interval_s 1, but gradiometer.period_s is 2"),
        ({"gradiometer.coloured_noise": "gone.json"}, "cannot read the noise model gone.json"),
        ({"gradiometer.drift_eotvos_per_sqrt_h": 1.0}, "drift_eotvos_per_sqrt_h must be 0"),
        ({"gradiometer.filter": "butterworth"}, "coloured_noise and filter exclude each other"),
        ({"gradiometer.latency_s": 0.1}, "coloured_noise and latency_s exclude each other"),
        ({"gradiometer.instrument": "strapdown"}, "exclude each other"),
        ({"gradiometer.noise_eotvos": 1.0}, "give exactly one of noise_eotvos"),
        ({"truth.gradiometer.dropout_share": 0.1}, "need white noise"),
        ({"truth.gradiometer.noise_freedom": 4.0}, "need white noise"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_sentence(coloured, changes, said):
    with pytest.raises(GGBenchError) as raised:
        flight_bound(small_flight(coloured | changes))
    assert said in str(raised.value)


@pytest.mark.long
def test_the_ekf_attains_the_bound_in_coloured_noise(coloured):
    """RMS over the bound 0.97 to 1.03, NEES of 6 within ±5 %: 6 σ of 400 runs of 20 epochs."""
    flight, runs = small_flight(coloured), 400
    bound = CaseBound(flight, flight_bound(flight)).means("filter")[WINDOWS.index("whole"), 0]
    squares, nees, nis = [], [], []
    for run in range(runs):
        problem, truth = simulate(flight, 5, run)
        found = evaluate(
            problem, ExtendedKalmanFilter().estimate(problem, np.random.default_rng(0)), truth
        )
        squares.append((found.position_error**2).mean())
        nees.append(found.nees.mean())
        nis.append(found.nis.mean())
    assert 0.97 < np.sqrt(np.mean(squares) / bound) < 1.03
    assert 5.7 < np.mean(nees) < 6.3
    assert 1.9 < np.mean(nis) < 2.1
    problem, truth = simulate(flight, 5, 0)
    smoothed = GaussNewton(starts=1).estimate(problem, np.random.default_rng(0))
    assert evaluate(problem, smoothed, truth).nees.mean() < 20.0
