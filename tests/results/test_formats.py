"""What a manifest, a record and shared arrays must hold, and what is made of a spoilt record."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from ggbench.results.formats import flaw_of_arrays, flaw_of_record, read_records, stand_in

METRICS = {"position_ms": 4.0, "velocity_ms": 0.1, "nees": 3.0, "nis": 6.0, "coverage": 0.7,
           "bound_position_ms": 3.0, "bound_velocity_ms": 0.1,
           "oracle_position_ms": 3.5, "oracle_velocity_ms": 0.1}  # fmt: skip
FAILED = {"name": "a", "parameters": "", "causality": "filter", "run": 3, "seed": 1,
          "status": "failed", "reason": "none"}  # fmt: skip
FINISHED = {
    **{key: FAILED[key] for key in ("name", "parameters", "causality", "run", "seed")},
    "status": "ok", "seconds": 0.1, "bound": "filter", "map_evaluations": 20,
    "peak_memory_mb": 100.0, "diverged": False, "final_position_error_m": 2.0,
    "final_ins_error_m": 9.0, "required_m": 3.0, "converged_s": 4.0, "false_fix": False,
    "windows": dict.fromkeys(("whole", "settled", "last20"), METRICS),
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        ({"run": -1}, "run"),
        ({"seed": -1}, "seed"),
        ({"seconds": -0.1}, "seconds"),
        ({"map_evaluations": -1}, "map_evaluations"),
        ({"map_evaluations": 2.5}, "map_evaluations"),
        ({"final_position_error_m": "2.0"}, "final_position_error_m"),
        ({"causality": "future"}, "causality"),
        ({"diverged": 1}, "diverged"),
        ({"required_m": -1.0}, "required_m"),
        ({"converged_s": "4.0"}, "converged_s"),
        ({"false_fix": None}, "false_fix"),
        ({"windows": FINISHED["windows"] | {"whole": METRICS | {"bound_position_ms": -1.0}}},
         "windows.whole.bound_position_ms"),
        ({"windows": {"whole": METRICS, "settled": METRICS}}, "windows.last20"),
        ({"windows": FINISHED["windows"] | {"whole": METRICS | {"velocity_ms": -1.0}}},
         "windows.whole.velocity_ms"),
    ],
)  # fmt: skip
def test_a_record_that_is_none_is_told_by_its_place(changes, place):
    """Counts and squares are not negative, numbers are no texts, and no window is missing."""
    assert flaw_of_record(FINISHED) is None and flaw_of_record(FAILED) is None
    assert place in flaw_of_record(FINISHED | changes)


def test_metrics_may_be_undefined():
    """An estimate without a covariance has no NEES, a flight without measurements no NIS.

    A run whose model is wrong has no oracle; one that does not converge has no time.
    """
    names = ("nees", "nis", "coverage", "oracle_position_ms", "oracle_velocity_ms")
    undefined = METRICS | dict.fromkeys(names, np.nan)
    windows = FINISHED["windows"] | {"settled": undefined}
    assert flaw_of_record(FINISHED | {"windows": windows, "converged_s": None}) is None


def test_one_spoilt_text_spoils_no_other():
    """Of texts read at once each stands for itself; two records in one text are none."""
    good = json.dumps(FAILED)
    found = read_records([good, "{", json.dumps(FINISHED), f"{good},{good}", "{}", None, good])
    assert [found[n] for n in (0, 2, 6)] == [FAILED, FINISHED, FAILED]
    assert all(isinstance(found[n], str) for n in (1, 3, 4, 5))
    assert found[3] == "it is no single record"


def test_a_run_whose_record_is_spoilt_has_failed_under_its_estimators_name():
    """What its text still tells comes first, then what other runs tell, then that it is unknown."""
    other = {"name": "ekf", "parameters": "n=2", "causality": "filter", "seed": 5}
    lost = {"run": 4, "status": "failed", "reason": "spoilt"}
    told = {"name": "ukf", "seed": 8}
    unknown = {"name": "?", "parameters": "", "causality": "none", "seed": 0}
    assert stand_in("{", 4, "spoilt", other) == other | lost
    assert stand_in("{", 4, "spoilt", {}) == unknown | lost
    assert stand_in(json.dumps(told | {"run": 9}), 4, "spoilt", other) == other | told | lost
    assert stand_in(json.dumps({"name": "ukf", "seed": "8"}), 4, "spoilt", other) == other | lost
    assert flaw_of_record(unknown | lost) is None


EPOCHS = 6
ARRAYS = {
    "times": np.arange(1.0, 7.0), "kept": np.array([0, 3, 5]), "track": np.ones((EPOCHS, 3)),
    "bound-filter": np.ones((EPOCHS, 2)), "bound-batch": np.ones((EPOCHS, 2)),
    "bound-fixed-lag-3": np.ones((EPOCHS, 2)), "present": np.linspace(0.0, 1.0, EPOCHS),
    "vertical": np.ones(EPOCHS), "noisy": np.ones(EPOCHS), "filtered": np.ones(EPOCHS),
    "filtered_true": np.ones(EPOCHS), "gradient_times": np.arange(1.0, 7.0),
    "channels": np.full(EPOCHS, 5.0), "response": np.ones((EPOCHS, 9)),
    "gravity": np.ones((EPOCHS, 8)), "map_latitude": np.ones(4),
    "map_longitude": np.ones(7), "map_vertical": np.ones((4, 7)),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "value", "flaw"),
    [
        ("track", np.ones((EPOCHS, 2)), r"its track has the shape \(6, 2\)"),
        ("vertical", np.ones((EPOCHS, 1)), r"its vertical has the shape \(6, 1\)"),
        ("filtered", np.ones(EPOCHS - 1), r"its filtered has the shape \(5,\)"),
        ("gradient_times", np.ones(EPOCHS - 1), "has the shape"),
        ("response", np.ones((EPOCHS, 8)), r"its response has the shape \(6, 8\)"),
        ("gravity", np.ones(EPOCHS), r"its gravity has the shape \(6,\)"),
        ("channels", np.full(EPOCHS, -1.0), "its channels holds less than none"),
        ("bound-fixed-lag-3", np.ones(EPOCHS), r"its bound-fixed-lag-3 has the shape \(6,\)"),
        ("bound-fixed-lag-x", np.ones((EPOCHS, 2)), "an unknown bound-fixed-lag-x"),
        ("times", np.arange(1, 7), "its times holds int64"),
        ("kept", np.array([0.0, 3.0]), "its kept holds float64"),
        ("kept", np.array([], dtype=int), "other epochs"),
        ("kept", np.array([-1, 3]), "other epochs"),
        ("present", np.linspace(-0.1, 1.0, EPOCHS), "more than shares"),
        ("noisy", np.full(EPOCHS, np.inf), "its noisy is not finite"),
        ("map_vertical", np.ones((7, 4)), "its map has another size"),
        ("map_latitude", np.ones((4, 1)), "no latitudes or longitudes"),
        ("map_longitude", np.arange(7), "no latitudes or longitudes"),
    ],
)
def test_shared_arrays_that_fit_no_flight_are_told(name, value, flaw):
    """Each has its own shape and kind; a map is as large as its latitudes by its longitudes."""
    assert flaw_of_arrays(ARRAYS) is None
    assert re.search(flaw, flaw_of_arrays(ARRAYS | {name: value}))
