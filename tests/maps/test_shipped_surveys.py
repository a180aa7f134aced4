"""The measured surveys of the package: their maps, and what is flown over them."""

from __future__ import annotations

import dataclasses
import json
from importlib.resources import files

import numpy as np
import pytest
from thinning import thinned

from ggbench.gravity.field import Field
from ggbench.gravity.gradient_map import MapError
from ggbench.maps.equivalent_sources import residuals
from ggbench.maps.recipe import MapRecipe, build
from ggbench.maps.shipped import SOURCES
from ggbench.maps.shipped_parts import PartOptions
from ggbench.maps.survey_files import read_lines
from ggbench.maps.survey_fit import FitOptions, fit

DATA = files("ggbench.scenarios") / "data" / "measured"
FLOWN = {"vinton2008": ["repeat"], "fosterville2019": ["even"]}
GRADIENTS = [*FLOWN]
LEFT_OUT = {"vinton2008": ["repeat", "140"], "fosterville2019": ["even"]}
MOST_BYTES = 4_000_000
LIMITS = {
    "vinton2008": {"xx": 11.4, "xz": 9.0, "xy": 9.7, "yy": 11.2, "yz": 8.6},
    "fosterville2019": {"xy": 4.5, "xx-yy": 4.4},
}
"""RMS of readings less the map on lines that it does not know [E]."""
one_is_quick = pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name == "vinton2008" else pytest.mark.long)
        for name in GRADIENTS
    ],
)
"""The smaller survey is tested every time."""


def sources(name):
    """Return the masses of a shipped survey."""
    return SOURCES[name].parts[0].part(PartOptions())


def test_all_measured_data_are_small():
    assert sum(len(path.read_bytes()) for path in DATA.iterdir()) < MOST_BYTES


@pytest.mark.long
@one_is_quick
def test_the_map_predicts_lines_that_it_does_not_know(name):
    """As a control, a map of masses of the opposite sign leaves more than the readings have."""
    lines = read_lines(DATA / f"{name}.csv.gz")
    flown = lines.chosen(FLOWN[name])
    right = sources(name)
    wrong = dataclasses.replace(right, masses=-right.masses)
    rms, control = (
        np.sqrt(np.mean(np.concatenate([residuals(s, lines, i) for i in flown]) ** 2, axis=0))
        for s in (right, wrong)
    )
    limits = [LIMITS[name][component] for component in lines.components]
    assert (rms < limits).all(), rms
    readings = lines.values[np.isin(lines.line, flown)].std(axis=0)
    assert (rms < 0.97 * readings).all()
    assert (control > readings).all()


@one_is_quick
def test_the_map_of_a_recipe_is_the_field_of_the_masses(name):
    """To 0.15 E rms along a line, which the nodes allow; it knows its standard error."""
    lines = read_lines(DATA / f"{name}.csv.gz")
    at = lines.samples(5)[20:120]
    latitude, longitude = lines.latitude_deg[at], lines.longitude_deg[at]
    recipe = MapRecipe(
        source=name,
        south_deg=latitude.min() - 0.01,
        north_deg=latitude.max() + 0.01,
        west_deg=longitude.min() - 0.01,
        east_deg=longitude.max() + 0.01,
        min_height_m=np.floor(lines.height_m[at].min() - 60.0),
        max_height_m=lines.height_m[at].max() + 60.0,
        spacing_arcmin=0.06,
        height_spacing_m=60.0,
    )
    made = build(recipe)
    here = np.radians(latitude), np.radians(longitude), lines.height_m[at]
    found = Field.from_map(made).tensor(*here) - Field.normal().tensor(*here)
    points = sources(name).plane.metres(lines)[:, at]
    error = found - sources(name)._fields(points)[:, :6]
    assert np.sqrt(np.mean(error**2)) < 0.15
    np.testing.assert_array_equal(made.standard_error, SOURCES[name].errors[0])
    assert (made.standard_error[:6] > 0.5).all() and (made.standard_error[:6] < 8.0).all()


def test_a_recipe_that_a_survey_cannot_follow_gets_a_sentence():
    inside = {"south_deg": 30.1, "north_deg": 30.15, "west_deg": -93.62, "east_deg": -93.58}
    for change, said in (
        (
            {"min_height_m": -290.0, "max_height_m": 300.0},
            "is outside the range of source 'vinton2008'",
        ),
        ({"min_height_m": 60.0, "max_height_m": 300.0, "spacing_arcmin": 0.2}, "too wide"),
        (
            {"min_height_m": 0.0, "max_height_m": 500.0, "land_correction": False},
            "is not allowed for",
        ),
        (
            {"min_height_m": 0.0, "max_height_m": 500.0, "density_kg_m3": 2000.0},
            "is not allowed for",
        ),
    ):
        usual = {"spacing_arcmin": 0.06, "height_spacing_m": 60.0}
        with pytest.raises(MapError, match=said):
            build(MapRecipe("vinton2008", **(inside | usual | change)))


def test_the_profile_predicts_passes_that_it_does_not_know():
    """Five passes of East Victoria; the field is the same across the line.

    As a control, no profile predicts the passes as seen from 3 km further along.
    """
    lines = read_lines(DATA / "east_victoria2023.csv.gz", quantity="disturbance")
    flown, profile = lines.chosen(["repeat"]), sources("east_victoria2023")
    off = np.concatenate([residuals(profile, lines, index)[:, 0] for index in flown])
    signal = lines.values[np.isin(lines.line, flown)].std()
    assert np.sqrt(np.mean(off**2)) < 2.8 < 19.0 < signal
    points = profile.plane.metres(lines)[:, lines.samples(flown[0])]
    along = points[:, -1] - points[:, 0]
    along[2], length = 0.0, np.hypot(*along[:2])
    across = np.array([-along[1], along[0], 0.0]) / length
    gravity = [
        -1e5 * profile._fields(points + step[:, np.newaxis])[:, 8]
        for step in (0.0 * across, 2e3 * across, -2e3 * across, 3e3 * along / length)
    ]
    for shifted in gravity[1:3]:
        assert (shifted - gravity[0]).std() < 0.6
    assert (gravity[3] - gravity[0]).std() > 3.0


@thinned("name", GRADIENTS)
def test_the_noise_is_of_the_components_that_were_measured(name):
    noise = json.loads((DATA / f"{name}_noise.json").read_text())
    lines = read_lines(DATA / f"{name}.csv.gz")
    assert noise["components"] == list(lines.components)
    assert noise["interval_s"] == 1.0
    assert all(word in noise["provenance"] for word in LEFT_OUT[name])


@pytest.mark.long
def test_the_shipped_masses_are_what_the_lines_give():
    """Two minutes: the masses of Vinton Dome again, from the lines of 3 to 5 July."""
    lines = read_lines(DATA / "vinton2008.csv.gz").without(LEFT_OUT["vinton2008"])
    again = fit(lines, FitOptions(320.0, 190.0, 1.0)).sources
    stored = sources("vinton2008")
    np.testing.assert_allclose(again.places, stored.places, atol=0.051)
    np.testing.assert_allclose(
        again.masses, stored.masses, rtol=0.0, atol=1e-3 * np.abs(stored.masses).max()
    )
