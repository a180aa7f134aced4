"""What a map is planned to be, of the files a user gives: its waves, its nodes, what is good."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from grids import write_grid
from random_harmonics import write_gfc

from ggbench.gravity.ellipsoid import SEMI_MAJOR_AXIS
from ggbench.gravity.gradient_map import MapError
from ggbench.gravity.harmonics import gravity_and_gradient, without_normal_field
from ggbench.maps.gravity_model import read_model
from ggbench.maps.nodes import GridRequest
from ggbench.maps.plan import Inputs, plan

BOX = GridRequest(
    south_deg=40.0,
    north_deg=41.0,
    west_deg=7.0,
    east_deg=8.0,
    lowest_m=3000.0,
    highest_m=6000.0,
    spacing_deg=0.25,
    height_spacing_m=1000.0,
)


@pytest.fixture
def coefficients(tmp_path) -> Path:
    path = tmp_path / "model.gfc"
    write_gfc(path, 240)
    return path


def geoid_of_nothing(folder: Path) -> Path:
    """Write a geoid of zero metres, 36° to 46° N, 2° to 12° E."""
    path = folder / "grid.nc"
    write_grid(path, "geoid", "m", np.zeros((101, 101)), south=36.0, west=2.0, step=0.1)
    return path


def test_the_highest_degree_asked_for_is_the_highest_that_is_removed(tmp_path):
    """Also of the coefficients that the package carries: a grid holds the rest."""
    for asked, degree in ((60, 60), (None, 120)):
        inputs = Inputs(grid=geoid_of_nothing(tmp_path), max_degree=asked)
        made = plan(inputs, BOX, "test")
        assert json.loads(made.attributes["parameters"])["degrees"] == [2, degree]
        assert made.parts[0].coefficients.degree == degree


def test_nodes_are_as_dense_as_half_the_shortest_wave_asks(coefficients):
    """Harmonics of degree n vary as if from sources half a wavelength, πR/n, down."""
    for degree in (120, 240):
        request = GridRequest(40.0, 45.0, 7.0, 12.0, 1000.0, 9000.0)
        made = plan(Inputs(coefficients=coefficients, max_degree=degree), request, "test")
        quarter = 0.25 * (1000.0 + math.pi * SEMI_MAJOR_AXIS / degree)
        step = math.radians(float(np.diff(made.nodes.latitude_deg).mean())) * SEMI_MAJOR_AXIS
        assert 0.9 * quarter < step <= quarter


def test_the_lowest_degree_asked_for_is_the_lowest_in_the_map(coefficients):
    inputs = Inputs(coefficients=coefficients, min_degree=30, max_degree=60)
    tensor, vector = next(plan(inputs, BOX, "test").layers())
    model = without_normal_field(read_model(coefficients, 60).coefficients)
    place = [math.radians(40.0)], [math.radians(7.0)], [3000.0]
    for lowest, same in ((30, True), (2, False)):
        expected_vector, expected = gravity_and_gradient(model.between(lowest, 60), *place)
        assert np.allclose(tensor[0, 0], expected[0, 0, 0], atol=1e-4) == same
        assert np.allclose(vector[0, 0], expected_vector[0, 0, 0], atol=1e-9) == same


def test_harmonics_of_higher_degree_need_less_of_a_grids_edge(coefficients, tmp_path):
    """What is left of the grid has shorter waves: of degree 240 half the edge of degree 120."""
    path = geoid_of_nothing(tmp_path)
    edges = {}
    for degree in (60, 120, 240):
        inputs = Inputs(coefficients=coefficients, max_degree=degree, grid=path)
        request = GridRequest(
            lowest_m=3000.0, highest_m=6000.0, spacing_deg=0.1, height_spacing_m=1000.0
        )
        nodes = plan(inputs, request, "test").nodes
        edges[degree] = float(nodes.latitude_deg[0]) - 36.0
    assert edges[60] == pytest.approx(edges[120])  # never more than what was measured to be enough
    assert edges[240] == pytest.approx(0.5 * edges[120], abs=0.1)


def test_what_was_assumed_of_a_grid_is_said(tmp_path):
    """A grid of gravity without a unit, and a geoid that is used as the height anomaly."""
    path = tmp_path / "grid.nc"
    write_grid(path, "gravity", "", np.zeros((101, 101)), south=36.0, west=2.0, step=0.1)
    made = plan(Inputs(grid=path, grid_kind="anomaly", max_degree=60), BOX, "test")
    assert "grid.nc: no unit given, mGal assumed" in made.remarks
    made = plan(Inputs(grid=geoid_of_nothing(tmp_path), max_degree=60), BOX, "test")
    assert any("used as the height anomaly" in remark for remark in made.remarks)


def test_height_anomalies_need_no_correction_of_land(tmp_path):
    """Nothing advises it, and it is refused, as it would be made twice."""
    path = tmp_path / "grid.nc"
    write_grid(path, "height_anomaly", "m", np.zeros((101, 101)), south=36.0, west=2.0, step=0.1)
    made = plan(Inputs(grid=path, max_degree=60), BOX, "test")
    assert not any("land-correction" in remark for remark in made.remarks)
    with pytest.raises(
        MapError, match="already contains height anomalies: remove --land-correction"
    ):
        plan(Inputs(grid=path, max_degree=60, land_correction=path), BOX, "test")
