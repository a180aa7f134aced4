"""The standard error that a map states, as noise that estimators assume."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from small_cases import blank_map, small_case

from ggbench.gravity.gradient_map import MapError
from ggbench.maps.recipe import write
from ggbench.simulation.suites import suite_of_case

ERROR = np.array([3.0, 1.0, 2.0, 3.0, 2.0, 4.0, np.nan, np.nan, np.nan])


def case(path, **changes):
    usual = {
        "field.source": str(path),
        "gradiometer.instrument": "local-level",
        "gradiometer.components": ["xx", "xy", "xx-yy"],
        "gradiometer.noise_eotvos": 1.0,
        "model.field.standard_error": True,
    }
    return small_case(usual | {key.replace("__", "."): value for key, value in changes.items()})


def test_the_model_has_the_error_of_the_map_and_the_truth_has_not(tmp_path):
    path = tmp_path / "map.nc"
    write(path, dataclasses.replace(blank_map(), standard_error=ERROR))
    variances = np.diag(suite_of_case(case(path), "model").noise_cov)
    assert variances == pytest.approx([1.0 + 9.0, 1.0 + 1.0, 1.0 + 0.25 * 18.0])
    assert np.diag(suite_of_case(case(path), "truth").noise_cov) == pytest.approx(np.ones(3))


def test_a_map_without_a_standard_error_is_named(tmp_path):
    path = tmp_path / "map.nc"
    write(path, blank_map())
    with pytest.raises(MapError, match=r"map\.nc\" contains no standard error"):
        suite_of_case(case(path), "model")
