"""Coloured noise: its file, its law, and a whitening by which the likelihood is exact."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_noise import NOISE
from thinning import thinned

from ggbench.gravity.coloured_noise import (
    ColouredNoiseError,
    VectorAutoregression,
    Whitening,
    read_noise,
)
from ggbench.trajectory.terrain_following import terrain_path

WHITE = VectorAutoregression(("xx",), 1.0, np.zeros((0, 1, 1)), np.array([[4.0]]))


def joint(noise: VectorAutoregression, count: int) -> np.ndarray:
    """Covariance (count m, count m) of readings one after the other, the first one first."""
    gamma = noise.autocovariance(count)
    blocks = [
        [gamma[i - j] if i >= j else gamma[j - i].T for j in range(count)] for i in range(count)
    ]
    return np.block(blocks)


def whitened(noise: VectorAutoregression, missing: list[bool]) -> Whitening:
    return noise.whitening(np.arange(len(missing)) * noise.interval, np.array(missing))


def matrix(whitening: Whitening) -> np.ndarray:
    """The whitening as a matrix (G m, G m) of all readings."""
    count, _, m, _ = whitening.weights.shape
    unit = np.eye(count * m).reshape(count * m, count, m)
    return whitening.apply(unit).reshape(count * m, count * m).T


def test_the_autocovariance_is_that_of_the_recursion():
    """Γ_0 = Σ A_i Γ_iᵀ + Σ and Γ_l = Σ A_i Γ_{l−i}: Yule–Walker."""
    gamma = NOISE.autocovariance(6)
    back = [np.swapaxes(g, 0, 1) for g in gamma]
    first = sum(a @ back[i + 1] for i, a in enumerate(NOISE.coefficients))
    np.testing.assert_allclose(first + NOISE.innovation_cov, gamma[0], atol=1e-12)
    for lag in range(1, 7):
        terms = [gamma[lag - i] if lag >= i else back[i - lag] for i in (1, 2)]
        expected = sum(a @ g for a, g in zip(NOISE.coefficients, terms, strict=True))
        np.testing.assert_allclose(gamma[lag], expected, atol=1e-12)
    np.testing.assert_array_equal(WHITE.autocovariance(2)[:, 0, 0], [4.0, 0.0, 0.0])


def test_whitened_noise_is_white_from_the_first_reading_on():
    """W Γ Wᵀ = I ⊗ D², and |W| is that of the Cholesky factors: the likelihood is the exact one."""
    count = 7
    w, covariance = matrix(whitened(NOISE, [False] * count)), joint(NOISE, count)
    variances = np.tile(NOISE.deviations**2, count)
    np.testing.assert_allclose(w @ covariance @ w.T, np.diag(variances), atol=1e-12)
    found = np.log(variances).sum() - 2.0 * np.linalg.slogdet(w)[1]
    assert found == pytest.approx(np.linalg.slogdet(covariance)[1], abs=1e-10)


def test_one_autoregression_per_channel_does_not_whiten():
    """A negative control: without the terms across channels what is left is correlated."""
    alone = VectorAutoregression(
        NOISE.components, 1.0, NOISE.coefficients * np.eye(2), NOISE.innovation_cov * np.eye(2)
    )
    w = matrix(whitened(alone, [False] * 7))
    left = w @ joint(NOISE, 7) @ w.T
    assert np.abs(left - np.diag(np.diag(left))).max() > 0.1


def test_a_long_gap_begins_a_stretch_of_its_own():
    """Also a pause that is no multiple of the interval. What is missing has no weight."""
    start = whitened(NOISE, [False] * 3)
    gap = whitened(NOISE, [False] * 3 + [True] * 64 + [False] * 2)
    np.testing.assert_array_equal(gap.weights[:3], start.weights)
    np.testing.assert_array_equal(gap.weights[3:67], 0.0)
    np.testing.assert_array_equal(gap.weights[67:], start.weights[:2])
    for pause in (6.5, 70.0):
        paused = NOISE.whitening(
            np.array([0.0, 1.0, 2.0, 2.0 + pause, 3.0 + pause]), np.zeros(5, dtype=bool)
        )
        np.testing.assert_array_equal(paused.weights[3:], start.weights[:2])
        np.testing.assert_array_equal(paused.lags[3:], start.lags[:2])


def test_a_pause_in_time_is_a_gap():
    """Readings that are not listed have the weights of readings that are listed as missing."""
    absent = np.array([False, False, False, True, True, False, False])
    listed = NOISE.whitening(np.arange(7.0), absent)
    paused = NOISE.whitening(np.arange(7.0)[~absent], np.zeros(5, dtype=bool))
    np.testing.assert_array_equal(paused.weights, listed.weights[~absent])


LONG_MEMORY = VectorAutoregression(("xx",), 1.0, np.array([[[0.95]]]), np.array([[4.0]]))
VINTON = read_noise(terrain_path("measured/vinton2008_noise.json"))


def least_squares(rows: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """Return the estimator (n, N) of least variance of N readings, and so its covariance."""
    weighted = np.linalg.solve(cov, rows)
    return np.asarray(np.linalg.solve(rows.T @ weighted, weighted.T))


@thinned("every", [20, 10, 4, 2])
@pytest.mark.parametrize(
    ("noise", "within"),
    [(NOISE, 0.0075), (VINTON, 0.0075), (LONG_MEMORY, 1e-9)],
    ids=["second order", "vinton", "first order"],
)
def test_gaps_keep_the_bound_and_the_estimate(noise, within, every):
    """Three unknowns from 160 readings with gaps, against dense generalised least squares.

    The declared σ and the true one are the least ones within 0.75 %. The estimate differs by less
    than 15 % of its σ. Negative control: noise that is forgotten at a gap declares a σ that is more
    than 1 % below the least one.
    """
    count, m = 160, len(noise.components)
    rng, k = np.random.default_rng(1), np.arange(160)
    missing = k % every == every - 1
    rates, phases = rng.uniform(0.02, 0.2, (3, m)), rng.uniform(0.0, 6.0, (3, m))
    slopes = np.cos(rates[:, np.newaxis] * k[:, np.newaxis] + phases[:, np.newaxis])
    there = np.repeat(~missing, m)
    rows, cov = slopes.reshape(3, -1).T[there], joint(noise, count)[np.ix_(there, there)]
    dense = least_squares(rows, cov)
    least = np.sqrt(np.diag(dense @ cov @ dense.T))
    readings = rows @ np.ones(3) + np.linalg.cholesky(cov) @ rng.standard_normal(len(rows))

    def declared(whitening: Whitening) -> tuple[np.ndarray, np.ndarray]:
        """Return the estimator (3, N) of the readings that exist, and the declared σ (3,)."""
        white = matrix(whitening)[np.ix_(there, there)]
        white /= np.tile(noise.deviations, count)[there][:, np.newaxis]
        estimator = least_squares(white @ rows, np.eye(len(rows)))
        return estimator @ white, np.sqrt(np.diag(estimator @ estimator.T))

    estimator, sigma = declared(noise.whitening(k * noise.interval, missing))
    np.testing.assert_allclose(sigma, least, rtol=within)
    np.testing.assert_allclose(np.sqrt(np.diag(estimator @ cov @ estimator.T)), least, rtol=within)
    assert (np.abs(estimator @ readings - dense @ readings) < 0.15 * least).all()
    forgetting = (k + 0.5 * np.cumsum(missing)) * noise.interval
    _, sigma = declared(noise.whitening(forgetting, missing))
    assert (sigma / least).min() < 0.99


@pytest.mark.long
def test_simulated_noise_has_the_law_of_the_model():
    """Covariances over 20000 processes, start included; 5 σ of the largest of 48: 3e-5 at most."""
    runs, count = 20000, 4
    rng = np.random.default_rng(3)
    noise = np.stack([NOISE.simulate(rng.standard_normal((count, 2))) for _ in range(runs)])
    flat = noise.reshape(runs, -1)
    expected = joint(NOISE, count)
    variances = np.diag(expected)
    sigma = np.sqrt((np.outer(variances, variances) + expected**2) / runs)
    assert (np.abs(flat.T @ flat / runs - expected) < 5.0 * sigma).all()


def test_whitening_inverts_the_simulation():
    """The white numbers come back, in units of the deviations."""
    drawn = np.random.default_rng(4).standard_normal((9, 2))
    back = whitened(NOISE, [False] * 9).apply(NOISE.simulate(drawn))
    np.testing.assert_allclose(back, drawn * NOISE.deviations, atol=1e-12)


def test_a_file_keeps_the_model(tmp_path):
    path = tmp_path / "noise.json"
    NOISE.write(path)
    found = read_noise(path)
    assert (found.components, found.interval) == (NOISE.components, NOISE.interval)
    np.testing.assert_array_equal(found.coefficients, NOISE.coefficients)
    np.testing.assert_array_equal(found.innovation_cov, NOISE.innovation_cov)
    WHITE.write(path)
    assert read_noise(path).order == 0
    with pytest.raises(ValueError, match="read-only"):
        found.coefficients[0] = 0.0


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"coefficients": [[[1.1, 0.0], [0.0, 0.1]]]}, "not stable: its spectral radius is 1.1"),
        ({"coefficients": [[[0.1]]]}, "coefficients have shape (1, 1, 1)"),
        ({"coefficients": [[[0.1, 0.2], [0.3]]]}, "coefficients must be numbers"),
        ({"innovation_cov_eotvos2": [[1.0, 2.0], [2.0, 1.0]]}, "symmetric and positive definite"),
        ({"innovation_cov_eotvos2": [[1.0, 0.2], [0.1, 1.0]]}, "symmetric and positive definite"),
        ({"components": ["xx", "xx"]}, "without duplicates"),
        ({"components": "xx"}, "components must be a list of names"),
        ({"interval_s": 0.0}, "interval_s is 0 and must be positive"),
        ({"interval_s": "soon"}, "interval_s must be numbers"),
        ({"format": "another"}, 'must be an object with "format": "ggbench coloured noise 1"'),
        ({"provenance": None}, "has no provenance"),
    ],
)
def test_a_bad_file_is_refused_in_a_sentence(tmp_path: Path, changes: dict[str, Any], said: str):
    path = tmp_path / "noise.json"
    NOISE.write(path)
    content = json.loads(path.read_text()) | changes
    path.write_text(json.dumps({k: v for k, v in content.items() if v is not None}))
    with pytest.raises(ColouredNoiseError) as raised:
        read_noise(path)
    assert said in str(raised.value)
    assert str(path) in str(raised.value)


def test_a_file_that_is_none_is_refused(tmp_path):
    with pytest.raises(ColouredNoiseError, match="cannot read the noise model"):
        read_noise(tmp_path / "gone.json")
    (tmp_path / "text.json").write_text("{")
    with pytest.raises(ColouredNoiseError, match="is not JSON"):
        read_noise(tmp_path / "text.json")
