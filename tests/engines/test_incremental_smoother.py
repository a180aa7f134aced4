"""Incremental smoothing of eight runs at once beside GTSAM; runs do not depend on others."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from oracles import reference
from problems import block_of_runs, entangled, estimator, smoothed

from ggbench.block import ProblemBlock

pytestmark = pytest.mark.long

INCREMENTAL, LAGGED = "factor-graph", "factor-graph[mode=fixed-lag,lag=20]"


def assert_gtsams(label: str, block: ProblemBlock, limit: float, least: int = 0) -> None:
    """Hold means and covariances to GTSAM's, in deviations of the prior."""
    found = estimator(label).estimate_block(block)
    sigma = np.sqrt(np.diag(block.prior_cov))
    for run in range(block.runs):
        expected = reference(label).estimate(block.problem(run))
        assert (found.causality, found.lag) == (expected.causality, expected.lag)
        assert np.abs((found.mean[run] - expected.mean) / sigma).max() < limit
        assert np.abs((found.cov[run] - expected.cov) / np.outer(sigma, sigma)).max() < limit
    assert (found.info["relinearized"] >= least).all()


@pytest.mark.parametrize("label", [INCREMENTAL, LAGGED])
@pytest.mark.parametrize(
    ("name", "case", "runs", "least"),
    [
        ("wang2013", "0.01E-1Hz", 2, 10),
        ("wrong_model", "noise-3x", 1, 100),
        ("jacksboro_helicopter", "rotating-biases", 1, 10),
    ],
)
def test_each_node_is_gtsams_when_it_is_final(label, name, case, runs, least):
    """Of a platform instrument, of a wrong noise, after which much is linearised anew, of biases.

    To a millionth of the prior: as many nodes must be linearised anew at the same epochs.
    """
    assert_gtsams(label, block_of_runs(name, case, 0, runs), 1e-6, least)


@pytest.mark.parametrize("label", [INCREMENTAL, LAGGED])
def test_of_any_prior_and_any_noise_nodes_are_gtsams(label):
    """A mean that is not zero, and states and channels that correlate; nodes five seconds apart."""
    assert_gtsams(label, entangled(block_of_runs("wang2013", "0.01E-0.2Hz", 0, 1)), 1e-6)


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_with_a_loss_nodes_are_gtsams(loss):
    """Among outliers, where estimates without a loss are others."""
    block = block_of_runs("outliers", "outliers-5pc", 0, 1)
    label = f"factor-graph[mode=fixed-lag,lag=5,loss={loss}]"
    assert_gtsams(label, block, 1e-6, 10)
    plain = estimator("factor-graph[mode=fixed-lag,lag=5]").estimate_block(block)
    apart = estimator(label).estimate_block(block).mean - plain.mean
    assert np.abs(apart / np.sqrt(np.diag(block.prior_cov))).max() > 1e-2


@pytest.mark.parametrize(("lag", "ahead"), [(5.0, 1), (12.0, 2), (40.0, 8), (500.0, 40)])
def test_where_nothing_is_linearised_anew_a_window_is_the_linear_smoother(lag, ahead):
    """Of the flight linearised along its undisturbed motion, where readings change nothing.

    The oracle is Rauch's, Tung's and Striebel's smoother of what the EKF linearises: with readings
    as the model predicts them the prediction is the linearisation's point in both.
    """
    block = block_of_runs("wang2013", "0.01E-0.2Hz", 0, 1)
    problem = block.problem(0)
    x, readings = problem.prior_mean, []
    for k, phi in enumerate(problem.transition):
        x = phi @ x
        readings.append(problem.model.predict(k, x))
    quiet = dataclasses.replace(block, measurements=np.array([readings]))
    found = estimator(f"factor-graph[mode=fixed-lag,lag={lag:g}]").estimate_block(quiet)
    mean, cov = smoothed(quiet.problem(0), ahead)
    sigma = np.sqrt(np.diag(block.prior_cov))
    assert np.abs((found.mean[0] - mean) / sigma).max() < 1e-9
    assert np.abs((found.cov[0] - cov) / np.outer(sigma, sigma)).max() < 1e-9


@pytest.mark.parametrize("mode", ["isam2", "fixed-lag"])
def test_a_run_does_not_depend_on_its_neighbours(mode):
    """Alone, in three and in eleven (the last group not full), shifted by one: the same bits."""
    estimate = estimator(f"factor-graph[mode={mode},relinearize_threshold=0.3]")
    whole = estimate.estimate_block(block_of_runs("wang2013", "0.01E-0.2Hz", 0, 11))
    for first, last in ((0, 1), (4, 7), (1, 11)):
        part = estimate.estimate_block(block_of_runs("wang2013", "0.01E-0.2Hz", first, last))
        np.testing.assert_array_equal(part.mean, whole.mean[first:last])
        np.testing.assert_array_equal(part.cov, whole.cov[first:last])
        for name, values in part.info.items():
            np.testing.assert_array_equal(values, whole.info[name][first:last])


@pytest.mark.parametrize(
    "label", ["factor-graph[mode=fixed-lag,lag=600]", "factor-graph[mode=batch]"]
)
def test_however_much_surer_later_readings_make_an_epoch_covariances_are_gtsams(label):
    """From a prior of 10 km, after which readings to come leave metres.

    A difference of the two, the filter's covariance less what they take, was off by half a variance
    in this run and had a negative eigenvalue.
    """
    block = block_of_runs("matching", "10km", 123, 124)
    found = estimator(label).estimate_block(block)
    expected = estimator(label).estimate(block.problem(0), np.random.default_rng(0))
    assert expected.cov is not None
    sigma = np.sqrt(np.diagonal(expected.cov, axis1=1, axis2=2))
    both = sigma[:, :, np.newaxis] * sigma[:, np.newaxis]
    assert np.abs((found.cov[0] - expected.cov) / both).max() < 1e-5
    assert np.linalg.eigvalsh(found.cov[0] / both).min() > 1e-4
