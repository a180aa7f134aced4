"""What the low-pass does to estimators: its start, and the noise behind it, told or not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from paper_flights import flight
from scipy.stats import chi2
from small_cases import QUIET, small_flight
from thinning import thinned

from ggbench.campaign import registry
from ggbench.campaign.records import shared_arrays
from ggbench.judging.run_errors import evaluate_block
from ggbench.results.store import DETAILED_RUN
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.runs import simulate, simulate_block
from ggbench.spec.gradiometer import GradiometerSpec, TrueGradiometer
from ggbench.spec.sensors import TruthSpec

FILTERED = {"gradiometer.filter": "butterworth"}
BEHIND = "gradiometer.noise_behind_filter_eotvos"


@pytest.mark.parametrize("filtered", [True, False])
def test_it_is_white_noise_on_the_output_and_nothing_else_changes(filtered):
    """Of the stated RMS at every epoch, though the noise before the filter is coloured by it.

    80 runs of 20 epochs and six channels, undone by the treatment's inverse: variance and
    correlation from epoch to epoch, chi-square and 3.9 deviations; false-alarm probability 1e-4
    each.
    """
    filter_ = FILTERED if filtered else {}
    # Behind a filter that is whitened there is noise by default.
    quiet, noisy = (small_flight(filter_ | {f"truth.{BEHIND}": rms}) for rms in (0.0, 0.002))
    runs = range(80)
    (without, truth), (with_it, truth_with) = (
        simulate_block(each, 21, runs) for each in (quiet, noisy)
    )
    np.testing.assert_array_equal(truth.error_state, truth_with.error_state)
    np.testing.assert_array_equal(with_it.noise_cov, without.noise_cov)
    np.testing.assert_array_equal(with_it.model.offset, without.model.offset)
    added = with_it.measurements - without.measurements
    if filtered:
        matrix = quiet.model.treatment(len(quiet.times)).apply(np.eye(len(quiet.times)))
        added = np.linalg.solve(matrix, added)
    unit = added / 0.002
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], unit.size)
    assert low < (unit**2).sum() < high
    products = unit[:, 1:] * unit[:, :-1]
    assert abs(products.sum()) / np.sqrt(products.size) < 3.9
    assert abs((unit[..., 0] * unit[..., 1]).sum()) / np.sqrt(unit[..., 0].size) < 3.9


@pytest.mark.parametrize("period", [0.5, 1.0, 2.0])
def test_noise_and_filter_are_of_the_rate_of_the_readings(period):
    """RMS = density √(rate/2) (Nyquist), and half the power passes at the cut-off in hertz."""
    flight = small_flight(
        {
            "gradiometer.period_s": period,
            "gradiometer.noise_eotvos": None,
            "gradiometer.noise_density_eotvos_per_sqrt_hz": 0.04,
            "gradiometer.filter": "butterworth",
            "gradiometer.filter_cutoff_hz": 0.1,
        }
    )
    instrument = flight.true.gradiometer
    assert instrument.noise_eotvos == pytest.approx(0.04 * np.sqrt(0.5 / period))
    times = period * np.arange(round(2000.0 / period))
    wave = instrument.lowpass.apply(np.sin(2.0 * np.pi * 0.1 * times)[:, np.newaxis])[:, 0]
    settled = wave[len(wave) // 2 :]
    assert np.sqrt(2.0 * np.mean(settled**2)) == pytest.approx(np.sqrt(0.5), rel=0.02)


@pytest.mark.parametrize("treatment", ["whitened", "delayed"])
def test_biases_go_through_the_filter(treatment):
    """Those that walk come out as the filter makes them; of constant ones h knows all."""
    filtered = FILTERED | QUIET | {"gradiometer.filter_treatment": treatment}
    bias, drift = "gradiometer.bias_eotvos", "gradiometer.drift_eotvos_per_sqrt_h"
    problem, truth = simulate(small_flight(filtered | {bias: 100.0}), 23, 0)
    assert np.abs(truth.error_state[:, 15:]).max() > 50.0
    predicted = [problem.model.predict(k, x) for k, x in enumerate(truth.error_state)]
    assert np.abs((problem.measurements - predicted) / np.sqrt(problem.noise_cov[0, 0])).max() < 6.0

    still, walking = (small_flight(filtered | {bias: 1.0, drift: d}) for d in (0.0, 1000.0))
    (without, truth), (with_it, walked) = (simulate(each, 23, 0) for each in (still, walking))
    walk = (walked.error_state - truth.error_state)[:, 15:]
    assert np.ptp(walk, axis=0).max() > 10.0
    prefilter, lowpass = still.model.treatment(len(still.times)), still.true.gradiometer.lowpass
    np.testing.assert_allclose(
        with_it.measurements - without.measurements,
        prefilter.apply(lowpass.apply(walk)),
        rtol=0.0,
        atol=1e-6,
    )


@thinned("behind", [1e-4, 1e-3, 0.01, 0.1])
@pytest.mark.parametrize("filtered", [True, False])
def test_who_is_told_has_white_residuals_of_the_claimed_noise(behind, filtered):
    """What h(true error) leaves of the readings is N(0, R), uncorrelated from epoch to epoch.

    From a hundredth of the noise before the filter to ten times it. 60 runs of 20 epochs and six
    channels: chi-square, and 3.9 deviations of the sum of products of neighbouring epochs;
    false-alarm probability 1e-4 each.
    """
    told = small_flight((FILTERED if filtered else {}) | {BEHIND: behind})
    residuals = []
    for run in range(60):
        problem, truth = simulate(told, 22, run)
        predicted = [problem.model.predict(k, x) for k, x in enumerate(truth.error_state)]
        residuals.append((problem.measurements - predicted) / np.sqrt(problem.noise_cov[0, 0]))
    unit = np.array(residuals)
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], unit.size)
    assert low < (unit**2).sum() < high
    for lag in (1, 2, 3):
        products = unit[:, lag:] * unit[:, :-lag]
        assert abs(products.sum()) / np.sqrt(products.size) < 3.9


@pytest.mark.parametrize(("treatment", "claimed"), [("whitened", 0.03), ("delayed", 0.05)])
def test_who_is_told_claims_what_the_treatment_leaves(treatment, claimed):
    """Whitening makes one noise of those before and behind the filter; delayed, both are there."""
    told = small_flight(
        FILTERED
        | {
            "gradiometer.noise_eotvos": 0.03,
            BEHIND: 0.04,
            "gradiometer.filter_treatment": treatment,
        }
    )
    problem, _ = simulate(told, 22, 0)
    np.testing.assert_allclose(problem.noise_cov, claimed**2 * np.eye(6), rtol=1e-12)


@pytest.mark.parametrize("period", [0.5, 2.0])
def test_a_delayed_reading_is_compared_with_where_the_vehicle_was(period):
    """As many readings ago as the filter delays them, to a centimetre."""
    made = small_flight(
        FILTERED
        | QUIET
        | {
            "gradiometer.period_s": period,
            "gradiometer.filter_cutoff_hz": 0.2,
            "gradiometer.filter_treatment": "delayed",
        }
    )
    problem, _ = simulate(made, 22, 0)
    truth, delays = made.trajectory, made.model.treatment(len(made.times)).delay_samples
    assert period * delays.max() > 1.0
    expected = np.interp(made.times - period * delays, truth.times, truth.positions[:, 1])
    east = (problem.model.arrays.references[:, 1] - expected) * made.metres[:, 1]
    assert np.abs(east).max() < 0.01


@pytest.mark.parametrize("treatment", ["whitened", "delayed"])
def test_a_delayed_reading_is_compared_with_how_the_vehicle_lay(treatment):
    """In a turn of 3°/s with the instrument fixed to it; to half of what one sample turns it by."""
    turn = {"kind": "turn", "by_heading_deg": 90.0, "turn_rate_deg_per_s": 3.0}
    made = small_flight(
        FILTERED
        | QUIET
        | {
            "trajectory.segment": [turn],
            "gradiometer.instrument": "strapdown",
            "gradiometer.filter_treatment": treatment,
        }
    )
    problem, _ = simulate(made, 22, 0)
    truth, delays = made.trajectory, made.model.treatment(len(made.times)).delay_samples
    assert delays.max() > 1.0
    lay = truth.attitudes[np.rint((made.times - delays) / truth.dt).astype(int)]
    assert np.abs(problem.model.arrays.attitudes - lay).max() < 0.003


@thinned("name", ["0.01E-1Hz", "0.001E-1Hz"])
def test_the_paper_survives_noise_behind_its_filter_that_nobody_is_told_of(name):
    """By default a hundredth of the noise before the filter costs the EKF of 40 flights 2 %.

    The same flights and noises with and without it; the NEES stays within 10 % of what it is.
    (With a filter inverted to one part in a million the error is tens of kilometres.)
    """
    case = flight(name).case
    name_of = "whitening_regularization"
    usual = {name_of: GradiometerSpec.model_fields[name_of].default}
    made = prepare(
        case.model_copy(update={"gradiometer": case.gradiometer.model_copy(update=usual)})
    )
    sigma = made.true.gradiometer.noise_eotvos
    true = TrueGradiometer(noise_behind_filter_eotvos=0.01 * sigma)
    case = made.case.model_copy(update={"truth": TruthSpec(gradiometer=true)})
    noisy = dataclasses.replace(made, case=case)
    estimator = registry.choose("ekf").estimator
    errors, nees = [], []
    for each in (made, noisy):
        problems, truth = simulate_block(each, 23, range(40))
        found = estimator.estimate_block(problems)
        judged, _ = evaluate_block(truth.error_state, found.mean, found.cov)
        errors.append(np.sqrt(np.mean(judged.position_error[:, 100:] ** 2)))
        nees.append(judged.nees[:, 100:].mean())
    assert errors[1] == pytest.approx(errors[0], rel=0.02)
    assert nees[1] == pytest.approx(nees[0], rel=0.1)


@thinned("cutoff", [0.1, 0.4], every=2)
@pytest.mark.parametrize("treatment", ["whitened", "delayed"])
def test_a_filter_with_a_large_transient_misleads_nobody(treatment, cutoff):
    """Whose start answers noise with tens of it: the NEES of 40 flights of the EKF stays 6.

    To 15 %, over the second half of the flight. (Taken as outputs of the usual noise those of the
    start would throw it off by ten deviations and more.)
    """
    made = flight("0.01E-1Hz")
    changes = {"filter_cutoff_hz": cutoff, "filter_treatment": treatment}
    gradiometer = made.case.gradiometer.model_copy(update=changes)
    case = made.case.model_copy(update={"gradiometer": gradiometer})
    problems, truth = simulate_block(dataclasses.replace(made, case=case), 24, range(40))
    found = registry.choose("ekf").estimator.estimate_block(problems)
    judged, _ = evaluate_block(truth.error_state, found.mean, found.cov)
    assert judged.nees[:, 100:].mean() == pytest.approx(6.0, rel=0.15)


@pytest.mark.parametrize("filtered", [True, False])
def test_the_figure_of_the_readings_shows_those_of_a_run(filtered):
    """Γ_UU of the detailed run as its instrument delivered it, all noises included.

    Held level, so that zz is Γ_UU, and delayed, so that outputs are not touched but at the start.
    """
    made = small_flight(
        {
            "gradiometer.instrument": "local-level",
            "gradiometer.filter_treatment": "delayed",
            f"truth.{BEHIND}": 0.003,
        }
        | (FILTERED if filtered else {})
    )
    problem, _ = simulate(made, 5, DETAILED_RUN)
    shown = shared_arrays(made, 5, [])["filtered" if filtered else "noisy"]
    np.testing.assert_allclose(shown[14:], problem.measurements[14:, 5], rtol=1e-13)
