"""Truth and model of a case, each of which changes its own side alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from problems import SMALL
from small_cases import ROTATING, SEVERAL, rough_map, small_case, small_flight

from ggbench.campaign import result_keys
from ggbench.simulation.runs import simulate
from ggbench.spec import scenario
from ggbench.spec.case import CaseSpec


def test_new_keys_leave_the_identity_of_old_cases():
    """Results that were stored before a key existed are still those of their case."""
    assert scenario.load("noise_rate_sweep").cases[0].content_hash.startswith("b8723016c6f6")
    unfiltered = scenario.load("wang2013").case("0.01E-1Hz-unfiltered")
    assert unfiltered.content_hash.startswith("43063d721784")


def test_a_new_default_changes_the_identity_of_what_it_touches():
    """Results of another regularisation of the whitening are not those of the case as it is.

    A case that states the earlier default is the earlier case.
    """
    case = scenario.load("wang2013").case("0.01E-1Hz")

    def with_regularization(case: CaseSpec, value: float) -> str:
        changed = case.gradiometer.model_copy(update={"whitening_regularization": value})
        return case.model_copy(update={"gradiometer": changed}).content_hash

    assert with_regularization(case, 1e-6).startswith("5d1e55b21b60")
    assert len({with_regularization(case, value) for value in (1e-6, 1e-3, 1e-2)}) == 3
    unfiltered = small_case()
    assert with_regularization(unfiltered, 1e-6) == unfiltered.content_hash


def test_a_case_survives_the_store():
    """A case that was written as JSON and read back is the same case, with the same results."""
    cases = [case for name in scenario.shipped() for case in scenario.load(name).cases[:12]]
    cases += [
        small_case(ROTATING),
        small_case(
            ROTATING
            | {
                "truth.gradiometer.rotating.scale_factor_ppm": 10.0,
                "gradiometer.rotating.spin_axes": ["y", "z"],
            }
        ),
        small_case({"truth.gradiometer.noise_density_eotvos_per_sqrt_hz": 0.1}),
        small_case({"field.source": "a.nc", "model.field.error": {"density_factor": 1.1}}),
        small_case(
            SEVERAL
            | {"truth.sensor.stern.dropouts_s": [[1.0, 2.0]], "model.sensor.sea_level.bias_m": 0.0}
        ),
    ]
    for case in cases:
        again = CaseSpec.model_validate_json(case.model_dump_json())
        assert again == case
        assert again.content_hash == case.content_hash
        assert again.side("truth") == case.side("truth")
        assert again.side("model") == case.side("model")


def test_a_default_that_is_written_out_changes_nothing():
    """Truth and model that say what holds anyway are no other problem."""
    plain = small_case()
    written = small_case(
        {
            "truth.imu.gyro_scale_factor_ppm": 0.0,
            "truth.gradiometer.dropouts_s": [],
            "gradiometer.instrument": "platform",
            "gradiometer.bias_eotvos": 0.0,
        }
    )
    assert written.content_hash == plain.content_hash
    assert result_keys.problem_key(written, 1) == result_keys.problem_key(plain, 1)


# Each side alone.

OF_THE_READINGS: dict[str, dict[str, Any]] = {
    "noise": {"truth.gradiometer.noise_eotvos": 0.1},
    "density": {"truth.gradiometer.noise_density_eotvos_per_sqrt_hz": 0.1},
    "bias": {"truth.gradiometer.bias_eotvos": 0.1},
    "drift": {"truth.gradiometer.drift_eotvos_per_sqrt_h": 1.0},
    "noise behind the filter": {"truth.gradiometer.noise_behind_filter_eotvos": 0.01},
    "scale factor": {"truth.gradiometer.scale_factor_ppm": 100.0},
    "misalignment": {"truth.gradiometer.misalignment_arcmin": 1.0},
    "outliers": {"truth.gradiometer.outlier_share": 0.2, "truth.gradiometer.outlier_eotvos": 1.0},
    "clock": {"truth.gradiometer.clock_error_s": 1.0},
    "jitter": {"truth.gradiometer.timing_jitter_s": 0.1},
}
OF_THE_INS: dict[str, dict[str, Any]] = {
    "gyro bias": {"truth.imu.gyro_bias_deg_per_h": 0.1},
    "gyro noise": {"truth.imu.gyro_noise_deg_per_sqrt_h": 0.05},
    "accelerometer bias": {"truth.imu.accelerometer_bias_ug": 5000.0},
    "accelerometer noise": {"truth.imu.accelerometer_noise_ug_per_sqrt_hz": 1000.0},
    "gyro drift": {"truth.imu.gyro_bias_time_s": 10.0},
    "accelerometer drift": {"truth.imu.accelerometer_bias_time_s": 10.0},
    "gyro scale factor": {"truth.imu.gyro_scale_factor_ppm": 1000.0},
    "accelerometer scale factor": {"truth.imu.accelerometer_scale_factor_ppm": 1000.0},
    "gyro misalignment": {"truth.imu.gyro_misalignment_arcmin": 10.0},
    "accelerometer misalignment": {"truth.imu.accelerometer_misalignment_arcmin": 10.0},
    "position": {"truth.initial_error.position_m": 50.0},
    "height": {"truth.initial_error.height_m": 50.0},
    "velocity": {"truth.initial_error.velocity_mps": 1.0},
    "attitude": {"truth.initial_error.attitude_arcmin": 10.0},
}
OF_THE_MODEL: dict[str, tuple[dict[str, Any], str]] = {
    "noise": ({"model.gradiometer.noise_eotvos": 0.1}, "noise_cov"),
    "density": ({"model.gradiometer.noise_density_eotvos_per_sqrt_hz": 0.1}, "noise_cov"),
    "bias": ({"model.gradiometer.bias_eotvos": 0.1}, "prior_cov"),
    "drift": ({"model.gradiometer.drift_eotvos_per_sqrt_h": 1.0}, "process_cov"),
    "noise behind the filter": (
        {"model.gradiometer.noise_behind_filter_eotvos": 0.01},
        "noise_cov",
    ),
    "gyro bias": ({"model.imu.gyro_bias_deg_per_h": 0.1}, "prior_cov"),
    "gyro noise": ({"model.imu.gyro_noise_deg_per_sqrt_h": 0.05}, "process_cov"),
    "accelerometer bias": ({"model.imu.accelerometer_bias_ug": 5000.0}, "prior_cov"),
    "accelerometer noise": (
        {"model.imu.accelerometer_noise_ug_per_sqrt_hz": 1000.0},
        "process_cov",
    ),
    "gyro drift": ({"model.imu.gyro_bias_time_s": 10.0}, "transition"),
    "accelerometer drift": ({"model.imu.accelerometer_bias_time_s": 10.0}, "process_cov"),
    "position": ({"model.initial_error.position_m": 50.0}, "prior_cov"),
    "height": ({"model.initial_error.height_m": 50.0}, "prior_cov"),
}
BELIEFS = ("noise_cov", "prior_mean", "prior_cov", "transition", "process_cov")


@pytest.fixture(scope="module")
def right():
    """A run of a small flight whose model is right."""
    return simulate(small_flight(), seed=3, run=1)


def forecasts(problem) -> np.ndarray:
    """What h says at all epochs of no error and for an error of position and attitude."""
    state = np.zeros(problem.dimension)
    state[:9] = [100.0, -50.0, 20.0, 0.1, 0.2, -0.1, 1e-3, -2e-3, 1e-3]
    return np.array(
        [problem.model.predict(k, np.stack([0.0 * state, state])) for k in range(problem.epochs)]
    )


@pytest.mark.parametrize("what", OF_THE_READINGS)
def test_truth_of_the_gradiometer_changes_the_readings_alone(what, right):
    """No number of the problem but the measurements tells of a gradiometer's true errors."""
    problem, truth = right
    other, other_truth = simulate(small_flight(OF_THE_READINGS[what]), seed=3, run=1)
    assert (problem.measurements != other.measurements).any()
    for name in BELIEFS:
        np.testing.assert_array_equal(getattr(other, name), getattr(problem, name), err_msg=name)
    np.testing.assert_array_equal(forecasts(other), forecasts(problem))
    np.testing.assert_array_equal(other_truth.error_state, truth.error_state)
    assert other.layout == problem.layout


@pytest.mark.parametrize("what", OF_THE_INS)
def test_truth_of_the_ins_changes_its_errors_alone(what, right):
    """The gradiometer flies with the aircraft, whatever the INS; what is claimed stays.

    Φ, Q follow the INS track, which is another by metres: to 1e-3 of the largest entry they are
    the same, where a claim of ten times the noise would be a hundred times off.
    """
    problem, truth = right
    other, other_truth = simulate(small_flight(OF_THE_INS[what]), seed=3, run=1)
    np.testing.assert_array_equal(other.measurements, problem.measurements)
    assert (other_truth.error_state[-1, :9] != truth.error_state[-1, :9]).any()
    for name in ("noise_cov", "prior_mean", "prior_cov"):
        np.testing.assert_array_equal(getattr(other, name), getattr(problem, name), err_msg=name)
    scale = np.sqrt(np.einsum("kii->ki", problem.process_cov)).max(axis=0) + 1e-30
    np.testing.assert_allclose(
        other.process_cov / np.outer(scale, scale),
        problem.process_cov / np.outer(scale, scale),
        rtol=0.0,
        atol=0.02,
    )


@pytest.mark.parametrize("what", OF_THE_MODEL)
def test_model_changes_what_is_claimed_alone(what, right):
    """A wrong belief changes what an estimator is told, and no measurement and no error."""
    problem, truth = right
    changes, claimed = OF_THE_MODEL[what]
    other, other_truth = simulate(small_flight(changes), seed=3, run=1)
    np.testing.assert_array_equal(other.measurements, problem.measurements)
    np.testing.assert_array_equal(other_truth.error_state[:, :15], truth.error_state)
    np.testing.assert_array_equal(other_truth.error_state[:, 15:], 0.0)
    before, after = getattr(problem, claimed), getattr(other, claimed)
    assert before.shape != after.shape or (before != after).any()


def test_truth_and_model_may_fly_over_different_maps(tmp_path):
    """Readings come from the truth's map, h from the model's; equal maps are one and the same."""
    one, two = (rough_map(tmp_path / f"{n}.nc", seed=n) for n in (1, 2))
    both = simulate(small_flight({"field.source": one}), seed=3, run=1)[0]
    split = simulate(
        small_flight({"truth.field.source": one, "model.field.source": two}), seed=3, run=1
    )[0]
    other = simulate(small_flight({"field.source": two}), seed=3, run=1)[0]
    np.testing.assert_array_equal(split.measurements, both.measurements)
    np.testing.assert_array_equal(forecasts(split), forecasts(other))
    assert np.abs(forecasts(split) - forecasts(both)).max() > 1.0


# Two ways to state the noise.


@pytest.mark.parametrize("side", ["truth", "model"])
def test_each_statement_of_the_noise_replaces_the_other(side, tmp_path):
    """The later one holds, for truth, model and cases; a density D at 1 Hz is D/√2 RMS."""
    density = f"{side}.gradiometer.noise_density_eotvos_per_sqrt_hz"
    flight = small_flight({density: 0.2})
    given, kept = (flight.true, flight.model) if side == "truth" else (flight.model, flight.true)
    assert given.gradiometer.noise_eotvos == pytest.approx(0.2 / np.sqrt(2.0))
    assert kept.gradiometer.noise_eotvos == 0.01
    reverse = small_case(
        {
            "gradiometer.noise_eotvos": None,
            "gradiometer.noise_density_eotvos_per_sqrt_hz": 0.2,
            f"{side}.gradiometer.noise_eotvos": 0.3,
        }
    )
    assert reverse.side(side).gradiometer.noise_eotvos == 0.3
    path = tmp_path / "small.toml"
    path.write_text(
        SMALL + f"{side}.gradiometer.noise_eotvos = 0.3\n[[case]]\n"
        'name = "density"\ntitle = "as a density"\n'
        "gradiometer.noise_density_eotvos_per_sqrt_hz = 0.4\n"
        f"{side}.gradiometer.noise_density_eotvos_per_sqrt_hz = 0.5\n"
    )
    noisy, density_case = scenario.load(str(path)).cases[1:]
    assert noisy.side(side).gradiometer.noise_eotvos == 0.3
    assert density_case.gradiometer.noise_density_eotvos_per_sqrt_hz == 0.4
    assert density_case.side(side).gradiometer.noise_density_eotvos_per_sqrt_hz == 0.5


@pytest.mark.parametrize("side", ["truth", "model"])
def test_a_stated_noise_replaces_that_of_the_accelerometers(side):
    """The noise of a rotating instrument, too, may be another in truth or model."""
    flight = small_flight(ROTATING | {f"{side}.gradiometer.noise_eotvos": 3.0})
    given, kept = (flight.true, flight.model) if side == "truth" else (flight.model, flight.true)
    assert given.gradiometer.noise_eotvos == 3.0
    assert kept.gradiometer.noise_eotvos == pytest.approx(np.sqrt(2.0) * 9.80665 / 0.5)


def test_a_case_states_its_noise_in_the_other_way(tmp_path):
    """A case's noise replaces that of the base's accelerometers, and theirs replaces the base's."""
    disks = "gradiometer.rotating.baseline_m = 0.5\ngradiometer.rotating.rotation_hz = 0.5\n"
    path = tmp_path / "small.toml"
    path.write_text(
        SMALL + f'[[case]]\nname = "a"\ntitle = "a"\n{disks}'
        "gradiometer.rotating.accelerometer_noise_ng_per_sqrt_hz = 1.0\n"
    )
    case = scenario.load(str(path)).cases[-1]
    assert case.gradiometer.noise_eotvos is None
    path.write_text(
        SMALL.replace(
            "noise_eotvos = 0.01",
            "rotating = { baseline_m = 0.5, rotation_hz = 0.5, "
            "accelerometer_noise_ng_per_sqrt_hz = 1.0 }",
        )
        + '[[case]]\nname = "a"\ntitle = "a"\ngradiometer.noise_eotvos = 2.0\n'
    )
    case = scenario.load(str(path)).cases[-1]
    assert case.gradiometer.noise_eotvos == 2.0
    assert case.gradiometer.rotating.baseline_m == 0.5


# Identity.


def test_a_problem_is_its_maps_content_wherever_they_lie(tmp_path):
    """Another place of a map changes no key; another content of truth's or model's map does."""
    one, same, two = (
        rough_map(Path(tmp_path / f"{name}.nc"), seed=seed)
        for name, seed in (("one", 1), ("same", 1), ("two", 2))
    )
    Path(same).write_bytes(Path(one).read_bytes())

    def key(**sources: str) -> str:
        changes = {f"{side}.field.source": path for side, path in sources.items()}
        return result_keys.problem_key(small_case(changes), seed=1)

    found = {
        (t, m): key(truth=path, model=believed)
        for t, path in (("one", one), ("two", two))
        for m, believed in (("one", one), ("two", two))
    }
    assert len(set(found.values())) == 4
    assert key(truth=same, model=two) == found["one", "two"]
    assert key(truth=two, model=same) == found["two", "one"]
    # What both share may be said once.
    assert result_keys.problem_key(small_case({"field.source": same}), 1) == found["one", "one"]
    assert result_keys.problem_key(small_case(), 1) not in found.values()


def test_every_error_of_a_model_map_is_another_problem():
    """Two maps from one file that are degraded differently are not confused."""
    base = {"field.source": "egm2008_qinling"}
    errors = (
        {},
        {"density_factor": 1.1},
        {"white_noise_eotvos": 1.0},
        {"white_noise_eotvos": 1.0, "seed": 2},
        {"resolution_km": 1.0},
    )
    cases = [
        small_case(base | ({f"{side}.field.error": error} if error else {}))
        for side in ("truth", "model")
        for error in errors
    ]
    hashes = [case.content_hash for case in cases]
    assert len(set(hashes)) == len(hashes) - 1  # the two without any error are one
