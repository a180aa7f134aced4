"""Judging many runs at once: against plain linear algebra, and each run for itself."""

from __future__ import annotations

import numpy as np
import pytest

from ggbench.judging import run_errors
from ggbench.spec.case import WindowsSpec

RUNS, EPOCHS, STATES = 5, 12, 9
SCALES = 10.0 ** np.array([3, 2, 0, -2, 0, 1, -6, -7, -9])
"""Standard deviations as different as those of metres and radians."""


def block(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Truth, estimates and full covariances of several runs."""
    rng = np.random.default_rng(seed)
    roots = rng.standard_normal((RUNS, EPOCHS, STATES, 2 * STATES)) * SCALES[:, None]
    cov = roots @ np.swapaxes(roots, -1, -2)
    truth, mean = rng.standard_normal((2, RUNS, EPOCHS, STATES)) * 4.0 * SCALES
    return truth, mean, cov


def test_consistency_is_that_of_the_inverse():
    """NEES is eᵀP⁻¹e of the six judged states, σ the root of the diagonal, whatever the units."""
    truth, mean, cov = block(1)
    found, flaws = run_errors.evaluate_block(truth, mean, cov)
    assert flaws == [""] * RUNS
    error = (truth - mean)[..., :6]
    inverse = np.linalg.inv(cov[..., :6, :6])
    assert found.nees == pytest.approx(np.einsum("rki,rkij,rkj->rk", error, inverse, error))
    assert found.sigmas == pytest.approx(np.sqrt(np.diagonal(cov, axis1=2, axis2=3))[..., :6])
    assert found.position_error == pytest.approx(np.linalg.norm(error[..., :3], axis=-1))
    assert found.velocity_error == pytest.approx(np.linalg.norm(error[..., 3:], axis=-1))


def test_a_run_is_judged_as_if_it_were_alone():
    """To the last bit, whatever is beside it: other runs, fewer of them, or damaged ones."""
    truth, mean, cov = block(2)
    windows = WindowsSpec(settled_from_s=3.0, last_s=2.0)
    times = np.arange(1.0, EPOCHS + 1.0)
    whole, _ = run_errors.evaluate_block(truth, mean, cov)
    metrics = run_errors.window_means(whole, times, windows)
    spoilt = mean.copy()
    spoilt[1] = np.nan
    beside, flaws = run_errors.evaluate_block(truth, spoilt, cov)
    assert [bool(flaw) for flaw in flaws] == [run == 1 for run in range(RUNS)]
    for run in (0, 2, 3, 4):
        alone, _ = run_errors.evaluate_block(*(a[run : run + 1] for a in (truth, mean, cov)))
        for name, values in vars(alone).items():
            assert np.array_equal(values[0], getattr(whole, name)[run], equal_nan=True)
            assert np.array_equal(values[0], getattr(beside, name)[run], equal_nan=True)
        own = run_errors.window_means(alone, times, windows)[0]
        assert np.array_equal(own, metrics[run], equal_nan=True)


def shifted(cov: np.ndarray, eigenvalue: float) -> np.ndarray:
    """A covariance whose judged correlation has this smallest eigenvalue."""
    sigma = np.sqrt(np.diag(cov))
    values, vectors = np.linalg.eigh((cov / np.outer(sigma, sigma))[:6, :6])
    values[0] = eigenvalue
    out = cov.copy()
    out[:6, :6] = (vectors * values) @ vectors.T * np.outer(sigma[:6], sigma[:6])
    return out


@pytest.mark.parametrize(
    ("eigenvalue", "good"), [(1e-3, True), (1e-9, True), (-1e-9, False), (-0.1, False)]
)
def test_a_covariance_is_positive_definite_in_the_units_of_its_deviations(eigenvalue, good):
    """What counts is the sign of the correlation's smallest eigenvalue: metres or radians alike."""
    truth, mean, cov = block(3)
    cov[2, 7] = shifted(cov[2, 7], eigenvalue)
    _, flaws = run_errors.evaluate_block(truth, mean, cov)
    flaw = "" if good else "the estimate's cov is not positive definite at epoch 7"
    assert flaws == ["", "", flaw, "", ""]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_the_first_flaw_is_told(value):
    """Numbers that are none, of any state: the first epoch; the mean's before the covariance's."""
    truth, mean, cov = block(4)
    mean[0, 5:, 8] = value
    cov[0, 2, 0, 0] = value
    cov[1, 6, 8, 3] = value
    cov[1, 2] = shifted(cov[1, 2], -1.0)
    cov[3, 4, 1, 1] = 0.0
    _, flaws = run_errors.evaluate_block(truth, mean, cov)
    assert flaws == [
        "the estimate's mean is not finite from epoch 5 on",
        "the estimate's cov is not finite from epoch 6 on",
        "",
        "the estimate's cov is not positive definite at epoch 4",
        "",
    ]


def test_the_region_of_95_percent_ends_where_tables_say():
    """χ² of six degrees of freedom: 12.592 (tables) is exceeded in 5 % of all epochs.

    And by errors drawn from their own covariance: 100 000 of them, within 5 deviations of the share
    (false alarms 6e-7).
    """
    times = np.arange(1.0, 3.0)
    windows = WindowsSpec(settled_from_s=0.0, last_s=1.0)
    for nees, share in ((12.58, 1.0), (12.60, 0.0)):
        error = np.full((1, 2, 6), np.sqrt(nees / 6.0))
        found, _ = run_errors.evaluate_block(error, 0.0 * error, np.tile(np.eye(6), (1, 2, 1, 1)))
        metrics = run_errors.window_metrics(
            run_errors.Evaluation(**{name: value[0] for name, value in vars(found).items()}),
            times,
            windows,
        )
        assert [metrics[name]["coverage"] for name in run_errors.WINDOWS] == [share] * 3
    epochs = 100_000
    error = np.random.default_rng(7).standard_normal((1, epochs, 6))
    cov = np.tile(np.eye(6), (1, epochs, 1, 1))
    found, _ = run_errors.evaluate_block(error, np.zeros_like(error), cov)
    means = run_errors.window_means(found, np.arange(float(epochs)), windows)
    assert means[0, 0, 4] == pytest.approx(0.95, abs=5.0 * np.sqrt(0.95 * 0.05 / epochs))
