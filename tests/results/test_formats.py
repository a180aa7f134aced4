"""Checks of the arrays that all runs of a case share."""

from __future__ import annotations

import re

import numpy as np
import pytest

from ggbench.results.formats import flaw_of_arrays

EPOCHS = 6
ARRAYS = {
    "times": np.arange(1.0, 7.0),
    "kept": np.array([0, 3, 5]),
    "track": np.ones((EPOCHS, 3)),
    "bound-filter": np.ones((EPOCHS, 2)),
    "bound-batch": np.ones((EPOCHS, 2)),
    "bound-fixed-lag-3": np.ones((EPOCHS, 2)),
    "present": np.linspace(0.0, 1.0, EPOCHS),
    "vertical": np.ones(EPOCHS),
    "noisy": np.ones(EPOCHS),
    "filtered": np.ones(EPOCHS),
    "filtered_true": np.ones(EPOCHS),
    "gradient_times": np.arange(1.0, 7.0),
    "channels": np.full(EPOCHS, 5.0),
    "response": np.ones((EPOCHS, 9)),
    "gravity": np.ones((EPOCHS, 8)),
    "map_latitude": np.ones(4),
    "map_longitude": np.ones(7),
    "map_vertical": np.ones((4, 7)),
}


@pytest.mark.parametrize(
    ("name", "value", "flaw"),
    [
        ("track", np.ones((EPOCHS, 2)), r"its track has the shape \(6, 2\)"),
        ("vertical", np.ones((EPOCHS, 1)), r"its vertical has the shape \(6, 1\)"),
        ("filtered", np.ones(EPOCHS - 1), r"its filtered has the shape \(5,\)"),
        ("gradient_times", np.ones(EPOCHS - 1), "has the shape"),
        ("response", np.ones((EPOCHS, 8)), r"its response has the shape \(6, 8\)"),
        ("gravity", np.ones(EPOCHS), r"its gravity has the shape \(6,\)"),
        ("channels", np.full(EPOCHS, -1.0), "its array channels contains negative numbers"),
        ("bound-fixed-lag-3", np.ones(EPOCHS), r"its bound-fixed-lag-3 has the shape \(6,\)"),
        ("bound-fixed-lag-x", np.ones((EPOCHS, 2)), "an unknown bound-fixed-lag-x"),
        ("times", np.arange(1, 7), "its times holds int64"),
        ("kept", np.array([0.0, 3.0]), "its kept holds float64"),
        ("kept", np.array([], dtype=int), "epochs that do not exist"),
        ("kept", np.array([-1, 3]), "epochs that do not exist"),
        ("kept", np.array([0, EPOCHS]), "epochs that do not exist"),
        ("bound-filter", np.full((EPOCHS, 2), np.nan), "its bound-filter is not finite"),
        ("present", np.linspace(-0.1, 1.0, EPOCHS), "values outside 0 to 1"),
        ("noisy", np.full(EPOCHS, np.inf), "its noisy is not finite"),
        ("map_vertical", np.ones((7, 4)), "its map does not match"),
        ("map_latitude", np.ones((4, 1)), "no latitudes or longitudes"),
        ("map_longitude", np.arange(7), "no latitudes or longitudes"),
    ],
)
def test_shared_arrays_that_fit_no_flight_are_told(name, value, flaw):
    """Each has its own shape and kind; a map is as large as its latitudes by its longitudes."""
    assert flaw_of_arrays(ARRAYS) is None
    assert re.search(flaw, flaw_of_arrays(ARRAYS | {name: value}))
