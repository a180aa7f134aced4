"""Situations are those of the set-up."""

from __future__ import annotations

import math
import tomllib
from typing import Any

import pytest
from problems import SMALL
from small_cases import CONSTANT, ON_BOARD, STATES, small_case

from ggbench.judging.situations import SITUATIONS, is_right_model, model_errors, situation_of
from ggbench.spec import scenario
from ggbench.spec.case import CaseSpec


def case() -> CaseSpec:
    return scenario.parse(tomllib.loads(SMALL), "s", "s").cases[0]


@pytest.mark.parametrize(
    ("changes", "situation"),
    [
        ({}, "plain"),
        ({"position_m": 1000.0}, "wide"),
        ({"position_m": 999.0}, "between"),
        ({"position_m": 200.0}, "between"),
        ({"position_m": 199.0}, "plain"),
        ({"position_m": 5e3, "correlation_m": 3e4}, "plain"),
        ({"position_m": 5e3, "correlation_m": math.nan}, "plain"),
        ({"duration_s": 1800.0}, "long"),
        ({"duration_s": 1799.0}, "plain"),
        ({"duration_s": 1800.0, "position_m": 5e3}, "wide"),
        ({"gradiometer": None}, "scalar"),
        ({"gradiometer": None, "duration_s": 1800.0, "position_m": 5e3}, "scalar"),
    ],
)
def test_situations_are_those_of_the_keys(changes, situation):
    """A wide prior is wide against the field, here of 1 km: σ/ℓ decides."""
    spec = case()
    if position := changes.get("position_m"):
        wide = spec.initial_error.model_copy(update={"position_m": position})
        spec = spec.model_copy(update={"initial_error": wide})
    if "gradiometer" in changes:
        spec = spec.model_copy(update={"gradiometer": None})
    if duration := changes.get("duration_s"):
        segment = spec.trajectory.segment[0].model_copy(update={"duration_s": duration})
        path = spec.trajectory.model_copy(update={"segment": (segment,)})
        spec = spec.model_copy(update={"trajectory": path})
    assert situation_of(spec, changes.get("correlation_m", 1000.0)) == situation
    assert situation in SITUATIONS


@pytest.mark.parametrize(
    ("keys", "situation"),
    [
        ({"truth": {"gradiometer": {"outlier_share": 0.1}, "field": {"source": "x"}}}, "readings"),
        ({"truth": {"gnss": {"dropouts_s": [[1.0, 2.0]]}, "imu": {}}}, "outage"),
        ({"truth": {"barometer": {"dropout_share": 0.1}}}, "readings"),
        ({"truth": {"field": {"error": {"resolution_km": 5.0}}}}, "map"),
        ({"model": {"field": {"density_kg_m3": 2600.0}}}, "map"),
        ({"model": {"gradiometer": {"noise_eotvos": 1.0}}}, "model"),
        ({"model": {"gradiometer": {"noise_eotvos": 1.0}, "field": {"source": "x"}}}, "map"),
        (
            {"model": {"gradiometer": {"bias_eotvos": 1.0}, "field": {"source": "x"}}},
            "modelled-map",
        ),
        ({"model": {"gradiometer": {"bias_eotvos": 1.0}}}, "model"),
        ({"truth": {"imu": {"gyro_scale_factor_ppm": 9.0}}}, "model"),
        ({"truth": {"imu": {}, "field": {}}}, "plain"),
        ({"model": {"imu": {"gyro_bias_deg_per_h": 0.0}}}, "model"),
        ({"model": {"field": {"land_correction": False}}}, "map"),
    ],
)
def test_what_truth_and_model_disagree_on_makes_a_situation(keys, situation):
    """Outliers before a wrong map, that before any other error; zero and false are changes."""

    class Changed(CaseSpec):
        def model_dump(self, **options: Any) -> dict[str, Any]:
            return super().model_dump(**options) | keys

    assert situation_of(Changed(**dict(small_case(ON_BOARD)))) == situation


@pytest.mark.parametrize(
    ("felt", "compensate", "situation"),
    [(False, False, "plain"), (True, False, "gravity"), (True, True, "plain")],
)
@pytest.mark.parametrize("side", ["both", "truth"])
def test_gravity_that_is_felt_and_not_compensated_makes_a_situation(
    side, felt, compensate, situation
):
    """Wherever the file says so; one that the mechanization takes from its map makes none."""
    spec = case()
    changed = {"gravity_disturbance": felt}
    if side == "both":
        spec = spec.model_copy(update={"field": spec.field.model_copy(update=changed)})
    else:
        truth = spec.truth.model_copy(update={"field": spec.truth.field.model_copy(update=changed)})
        spec = spec.model_copy(update={"truth": truth})
    field = spec.model.field.model_copy(update={"compensate": compensate})
    spec = spec.model_copy(update={"model": spec.model.model_copy(update={"field": field})})
    assert situation_of(spec) == situation
    assert model_errors(spec) == (["gravity"] if situation == "gravity" else [])


@pytest.mark.parametrize(
    ("changes", "right"),
    [
        ({}, True),
        ({"filter": "butterworth", "filter_cutoff_hz": 0.2}, True),
        ({"filter": "butterworth", "filter_cutoff_hz": 0.2, "filter_treatment": "delayed"}, False),
        ({"filter_treatment": "delayed"}, True),
    ],
)
def test_a_delayed_filter_leaves_noise_that_is_assumed_white(changes, right):
    spec = case()
    changed = spec.gradiometer.model_copy(update=changes)
    assert is_right_model(spec.model_copy(update={"gradiometer": changed})) is right


def test_gaps_at_known_times_are_no_error_of_the_model():
    text = SMALL + "\n[truth.gradiometer]\ndropouts_s = [[5.0, 8.0]]\n"
    spec = scenario.parse(tomllib.loads(text), "s", "s").cases[0]
    assert is_right_model(spec) and situation_of(spec) == "readings"


@pytest.mark.parametrize(
    ("changes", "errors"),
    [
        ({}, []),
        (CONSTANT, ["gravity"]),
        (CONSTANT | STATES, []),
        ({"truth.gradiometer.dropouts_s": [[5.0, 9.0]]}, []),
        ({"truth.gradiometer.bias_eotvos": 3.0}, ["gradiometer"]),
        ({f"{side}.gradiometer.bias_eotvos": 3.0 for side in ("truth", "model")}, []),
        (
            {"truth.gradiometer.bias_eotvos": 3.0, "truth.imu.gyro_bias_deg_per_h": 1.0},
            ["gradiometer", "imu"],
        ),
    ],
)
def test_model_errors_are_tables_in_which_truth_and_model_differ(changes, errors):
    """Known gaps, a modelled disturbance and equal errors of both are none."""
    assert model_errors(small_case(changes)) == errors
