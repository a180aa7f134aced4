"""Point masses: their field is right, and they find the field of a survey."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from choclo import point
from made_surveys import field, survey

from ggbench.gravity.gradient_map import MapError
from ggbench.gravity.point_masses import fields, responses
from ggbench.maps.equivalent_sources import Plane, weights_of
from ggbench.maps.netcdf import Nodes
from ggbench.maps.survey_fit import FitOptions, fit

WANTED = FitOptions(500.0, 300.0, 1e-3)
COMPONENTS = ("ee", "en", "eu", "nn", "nu", "uu", "e", "n", "u")


@pytest.fixture(scope="module")
def quiet():
    """The map of a survey without noise, each line of which has a constant of its own."""
    return fit(survey(), WANTED)


@pytest.mark.parametrize(
    "names", [("eu", "u"), pytest.param(COMPONENTS, marks=pytest.mark.long)], ids=len
)
def test_the_field_is_that_of_choclo(names):
    rng = np.random.default_rng(1)
    points, places = rng.normal(0.0, 500.0, (3, 4)), rng.normal(0.0, 500.0, (3, 7))
    places[2] -= 2000.0
    masses = rng.normal(0.0, 10.0, 7)
    found = np.empty((4, 9))
    fields(points, places, masses, found)
    for name in names:
        k = COMPONENTS.index(name)
        kernel = getattr(point, f"gravity_{name}")
        expected = [
            sum(kernel(*at, *place, 1e9 * m) for place, m in zip(places.T, masses, strict=True))
            for at in points.T
        ]
        unit = 1e9 if k < 6 else 1.0
        np.testing.assert_allclose(found[:, k], np.array(expected) * unit, rtol=1e-6)


def test_the_response_to_unit_masses_adds_up_to_the_field():
    rng = np.random.default_rng(2)
    points, places = rng.normal(0.0, 500.0, (3, 5)), rng.normal(-3000.0, 300.0, (3, 6))
    masses, weights = rng.normal(0.0, 10.0, 6), rng.normal(size=(2, 9))
    whole, unit = np.empty((5, 9)), np.empty((2, 5, 6))
    fields(points, places, masses, whole)
    responses(points, places, weights, unit)
    np.testing.assert_allclose(unit @ masses, weights @ whole.T, rtol=1e-9, atol=1e-12)


def test_the_masses_find_the_field_between_the_lines(quiet):
    """To 15 % of its deviations over the survey, without its edges, in all six components.

    What changes to the east alone is a constant of a north–south line: EE, EU and UU err most.
    """
    lines = quiet.lines
    east, north = np.meshgrid(np.arange(750.0, 2700.0, 300.0), np.arange(1000.0, 5000.0, 250.0))
    truth = field(np.array([east.ravel(), north.ravel(), np.full(east.size, 90.0)]))[:, :6]
    first = Plane.under(lines).place(np.array([30.0]), np.array([-93.0]))
    at = np.array([east.ravel() + first[0], north.ravel() + first[1], np.full(east.size, 90.0)])
    found = quiet.sources._fields(at)[:, :6]
    error = (found - truth) - (found - truth).mean(axis=0)
    assert (error.std(axis=0) < 0.15 * truth.std(axis=0)).all()


def test_a_constant_of_a_line_changes_nothing(quiet):
    lines = survey()
    rng = np.random.default_rng(3)
    more = lines.values + rng.normal(0.0, 50.0, (len(lines.names), 5))[lines.line]
    other = fit(dataclasses.replace(lines, values=more), WANTED)
    np.testing.assert_allclose(other.sources.masses, quiet.sources.masses, atol=1e-6)


def test_layers_are_harmonic_and_as_along_the_lines(quiet):
    lines, samples = quiet.lines, np.array([130, 300])
    for sample in samples:
        nodes = Nodes(
            lines.latitude_deg[[sample]], lines.longitude_deg[[sample]], lines.height_m[[sample]]
        )
        ((tensor, _),) = quiet.sources.layers(nodes)
        np.testing.assert_allclose(tensor[0, 0, [0, 3, 5]].sum(), 0.0, atol=1e-9)
        along = quiet.sources.along(lines, np.array([sample]))[0]
        np.testing.assert_allclose(weights_of(lines)[:, :6] @ tensor[0, 0], along, atol=1e-9)


def test_a_survey_wider_than_the_plane_and_too_many_masses_are_refused():
    lines = survey()
    wide = dataclasses.replace(lines, latitude_deg=30.0 + 100.0 * (lines.latitude_deg - 30.0))
    with pytest.raises(MapError, match="the plane approximation allows 150 km"):
        fit(wide, WANTED)
    with pytest.raises(MapError, match="increase --source-spacing"):
        fit(lines, FitOptions(500.0, 20.0, 0.1))
