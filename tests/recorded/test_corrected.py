"""The corrected track, what the readings say, and errors against a reference."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from recorded_flights import GNSS_ONLY, RUN, SEED, recorded
from small_cases import small_flight

import ggbench as gg
from ggbench.numerics.rotations import attitude_matrix
from ggbench.recorded.corrected import EstimateError, against, residual_columns, residuals
from ggbench.recorded.flight import read_flight
from ggbench.recorded.motion import angles_of
from ggbench.simulation.runs import simulate

FLOWN = GNSS_ONLY | {"initial_error.attitude_arcmin": 300.0, "initial_error.position_m": 1000.0}


@pytest.fixture(scope="module")
def flown():
    return small_flight(FLOWN)


def test_the_true_errors_lead_back_to_the_truth(flown):
    """What the INS indicates less its true errors is the true flight: the signs are right."""
    problem, truth = simulate(flown, SEED, RUN)
    exact = gg.Estimate(truth.error_state, None, "batch")
    found = gg.corrected(problem, exact, start=100.0)
    motion = flown.motion_at_epochs
    np.testing.assert_array_equal(found.time_s, problem.times + 100.0)
    for j, name in enumerate(("latitude_deg", "longitude_deg")):
        np.testing.assert_allclose(found[name], np.degrees(motion.positions[:, j]), rtol=1e-12)
    np.testing.assert_allclose(found.height_m, motion.positions[:, 2], rtol=1e-12)
    for j, axis in enumerate(("east", "north", "up")):
        np.testing.assert_allclose(
            found[f"velocity_{axis}_mps"], motion.velocities[:, j], rtol=0.0, atol=1e-10
        )
    wanted = np.degrees(angles_of(motion.attitudes))
    for j, name in enumerate(("heading_deg", "pitch_deg", "roll_deg")):
        np.testing.assert_allclose(found[name], wanted[:, j], rtol=0.0, atol=1e-9)
    assert found.filter(like="sigma").isna().all(axis=None)


def test_angles_are_those_of_the_rotation():
    """Heading, pitch and roll come back from C_nb, all around."""
    rng = np.random.default_rng(1)
    wanted = rng.uniform([0.0, -1.5, -3.1], [6.28, 1.5, 3.1], (200, 3))
    found = angles_of(np.stack([attitude_matrix(*angles) for angles in wanted]))
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-13)


def test_deviations_are_those_of_the_covariance(flown):
    problem, _ = simulate(flown, SEED, RUN)
    estimate = gg.estimate(problem, "ekf")
    found = gg.corrected(problem, estimate)
    sigma = np.sqrt(np.diagonal(estimate.cov, axis1=1, axis2=2)[:, :9])
    np.testing.assert_array_equal(found.filter(like="sigma").to_numpy(), sigma)


def test_whitened_innovations_make_the_nis(flown):
    """Their squares add up to the NIS of the judgement, reading by reading."""
    changed = small_flight(FLOWN | {"truth.gnss.dropouts_s": [[5.0, 9.0]]})
    problem, truth = simulate(changed, SEED, RUN)
    estimate = gg.estimate(problem, "ekf")
    found = residuals(problem, estimate)
    judged = gg.judge(problem, estimate, truth)
    np.testing.assert_allclose(found.nis, judged.nis, rtol=1e-9)
    np.testing.assert_array_equal(np.isnan(found.whitened), ~problem.present)
    columns = residual_columns(problem, found, 7.0)
    assert columns["time_s"][0] == problem.times[0] + 7.0
    reading, predicted = (columns[f"gnss_velocity_N_{part}mps"] for part in ("", "predicted_"))
    assert np.nanstd(reading - predicted) < 1.0
    np.testing.assert_array_equal(columns["gnss_velocity_N_present"], problem.present[:, 4])


def test_a_filter_that_tells_its_nis_is_believed(flown):
    """As its judgement does: what is given as noise need not be what it takes for it."""
    problem, truth = simulate(flown, SEED, RUN)
    estimate = gg.estimate(problem, "ekf")
    told = dataclasses.replace(estimate, nis=0.25 * residuals(problem, estimate).nis)
    found, judged = residuals(problem, told), gg.judge(problem, told, truth)
    np.testing.assert_array_equal(found.nis, told.nis)
    np.testing.assert_array_equal(found.nis, judged.nis)
    with pytest.raises(EstimateError, match="nis has shape"):
        residuals(problem, dataclasses.replace(told, nis=told.nis[1:]))


def test_a_smoother_has_residuals_of_its_own(flown):
    """In units of the noise: a linear problem's are below one, and there is no NIS."""
    problem, _ = simulate(small_flight(GNSS_ONLY), SEED, RUN)
    found = residuals(problem, gg.estimate(problem, "factor-graph[mode=batch]"))
    assert not found.innovations and np.isnan(found.nis).all()
    assert 0.5 < np.sqrt(np.nanmean(found.whitened**2)) < 1.0


def test_errors_against_a_reference_are_those_of_the_judgement(tmp_path, flown):
    problem, truth = simulate(flown, SEED, RUN)
    read = read_flight(recorded(tmp_path / "log", flown))
    estimate = gg.estimate(read.problem, "ekf")
    found = against(read.problem, estimate, read.reference, read.spec.windows)
    judged = gg.judge(problem, gg.estimate(problem, "ekf"), truth, flown.case.windows)
    assert found.states == 6
    np.testing.assert_allclose(found.nees, judged.nees, rtol=1e-6)
    for name, metrics in judged.windows.items():
        for key in ("position_mrse_m", "velocity_mrse_mps", "nees_mean"):
            assert found.windows[name][key] == pytest.approx(metrics[key], rel=1e-6)


def test_a_reference_of_positions_alone_judges_those(tmp_path, flown):
    read = read_flight(recorded(tmp_path / "log", flown))
    errors = read.reference.error_state.copy()
    errors[:, 3:], errors[:5] = np.nan, np.nan
    estimate = gg.estimate(read.problem, "ekf")
    found = against(read.problem, estimate, gg.Truth(read.problem.times, errors), None)
    assert (found.states, len(found.times)) == (3, read.problem.epochs - 5)
    assert np.isfinite(found.nees).all()
    assert list(found.windows) == ["whole"]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"mean": np.zeros((3, 15))}, "shape"),
        ({"mean": np.full((20, 15), np.nan)}, "mean is not finite from epoch 0"),
        ({"cov": np.full((20, 15, 15), np.inf)}, "cov is not finite"),
        ({"cov": -np.tile(np.eye(15), (20, 1, 1))}, "not positive definite"),
    ],
)
def test_an_estimate_that_is_none_is_refused(flown, changes, said):
    problem, _ = simulate(flown, SEED, RUN)
    estimate = dataclasses.replace(gg.estimate(problem, "ekf"), **changes)
    with pytest.raises(EstimateError, match=said):
        residuals(problem, estimate)


def test_a_problem_without_a_track_has_none_to_correct(flown):
    problem, _ = simulate(flown, SEED, RUN)
    estimate = gg.estimate(problem, "ekf")
    with pytest.raises(EstimateError, match="no INS track"):
        gg.corrected(dataclasses.replace(problem, track=None), estimate)
    for wrong in ((estimate, estimate), (problem, problem), (problem, "ekf")):
        with pytest.raises(gg.GGBenchError, match="an object of type"):
            gg.corrected(*wrong)
    with pytest.raises(gg.GGBenchError, match="must be the path of a file"):
        gg.read_flight(3)
