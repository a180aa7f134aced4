"""Survey files: formats with the same lines, and turns of axes."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from survey_formats import RENAMED, ROWS, csv, csv_of_numpy, gdf2, xyz

from ggbench.maps.survey_files import read_lines
from ggbench.maps.survey_lines import AXES, COMPONENTS, in_our_axes


@pytest.mark.parametrize(
    "write, columns", [(csv, {}), (csv_of_numpy, {}), (xyz, RENAMED), (gdf2, RENAMED)]
)
def test_the_formats_hold_the_same_lines(tmp_path, write, columns):
    found = read_lines(write(tmp_path), columns)
    assert found.names == ("10", "20", "900")
    assert found.kinds == ("primary", "primary", "primary" if write is gdf2 else "tie")
    assert found.components == ("xx", "xz")
    expected = np.array([row[2:] for row in ROWS], dtype=float)
    at = (found.time_s, found.latitude_deg, found.longitude_deg, found.height_m)
    np.testing.assert_allclose(np.column_stack([*at, found.values]), expected)


@pytest.mark.parametrize("axes, component", list(product(AXES, COMPONENTS)))
def test_components_turn_as_a_tensor_does(axes, component):
    """A random tensor, turned by a matrix, against names and signs."""
    turn = {
        "east-north-up": np.eye(3),
        "east-north-down": np.diag([1.0, 1.0, -1.0]),
        "north-east-down": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
    }[axes]
    ours = np.random.default_rng(4).normal(size=(3, 3))
    ours += ours.T

    def value(name, tensor):
        return COMPONENTS[name] @ tensor[np.triu_indices(3)]

    name, sign = in_our_axes(component, axes)
    assert sign * value(component, turn @ ours @ turn.T) == pytest.approx(value(name, ours))


def test_samples_with_missing_values_are_left_out(tmp_path):
    path = xyz(tmp_path)
    path.write_text(path.read_text().replace("84.0 6.0", "84.0 *"))
    found = read_lines(path, RENAMED)
    assert found.dropped == 3
    assert np.bincount(found.line).tolist() == [4, 4, 4]
    gdf2(tmp_path)
    dat = tmp_path / "lines.dat"
    dat.write_text(dat.read_text().replace("     6.00", "   -99999"))
    assert read_lines(dat, RENAMED).dropped == 3
