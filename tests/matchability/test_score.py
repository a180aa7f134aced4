"""Cells of a map: where they lie, what is said of each, and what cannot be asked."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from small_cases import blank_map
from thinning import thinned

from ggbench.gravity.degraded_map import MapDegradation, degrade
from ggbench.gravity.field import Field
from ggbench.gravity.gradient_map import MapError
from ggbench.maps.recipe import write
from ggbench.matchability import information as info
from ggbench.matchability.score import (
    HEADINGS,
    Bounds,
    Cell,
    Design,
    cells_of,
    score,
    score_cell,
    tracks,
)
from ggbench.matchability.sources import named_map

DESIGN = Design(10_000.0, 0.07, spacing_m=200.0, sigma_m=1500.0, readings=11)
SIDES = ("south_deg", "north_deg", "west_deg", "east_deg")


@pytest.fixture(scope="module")
def rough():
    noise = MapDegradation(correlated_noise_eotvos=10.0, correlation_m=3000.0, seed=1)
    return degrade(blank_map(), noise)


@pytest.fixture(scope="module")
def field(rough):
    return Field.from_map(rough)


@pytest.fixture(scope="module")
def scored(field):
    return score(field, DESIGN)


def test_cells_tile_what_the_map_surrounds(field, scored):
    table = scored.table
    assert len(table) == 9
    assert len(table) == len(table[["south_deg", "west_deg"]].drop_duplicates())
    south, north, west, east = table[[*SIDES]].to_numpy().T
    np.testing.assert_allclose([north - south, east - west], 0.07, atol=1e-9)
    # As far as a position is sought, 4.5 km, every track lies in the map.
    design = scored.design
    for row in table[[*SIDES]].to_numpy():
        for _, track in tracks(Cell(*row), design):
            for angle in np.arange(0.0, 2.0 * np.pi, 0.5):
                offset = design.reach * np.array([math.cos(angle), math.sin(angle)])
                assert field.covers(info.moved(track, offset), 0.0).all()
    # And no other row or column would fit.
    taken = np.array([north.max() - south.min(), east.max() - west.min()])
    room = np.degrees(field.upper - field.lower)[:2] - taken
    assert (room < 0.07 + 2.0 * np.degrees(design.reach / np.array([6.36e6, 5.3e6]))).all()


def test_a_cell_is_scored_by_what_is_in_it(field, scored):
    """Against the definitions: nodes, readings a square kilometre, tracks of four headings."""
    design, row = scored.design, scored.table.iloc[4]
    cell = Cell(*row[[*SIDES]])
    latitude, longitude = np.meshgrid(
        np.radians(np.linspace(cell.south, cell.north, 101)),
        np.radians(np.linspace(cell.west, cell.east, 101)),
        indexing="ij",
    )
    vertical = field.vertical_disturbance(latitude, longitude, 10_000.0)
    assert row["span"] < np.ptp(vertical) * 2.0
    assert row["deviation"] < vertical.std() * 1.01  # a plane is taken away
    positions = np.stack([latitude, longitude, np.full_like(latitude, 1e4)], -1).reshape(-1, 3)
    mean = info.information(design.instrument.jacobians(field, positions)) / len(positions)
    assert row["information_m"] == pytest.approx(info.accuracy(mean), rel=0.03)
    accuracies = []
    for heading, track in tracks(cell, design):
        assert heading in HEADINGS
        assert len(track) == 11
        known = info.information(design.instrument.jacobians(field, track))
        accuracies.append(info.accuracy(known))
    assert row["best_track_m"] == pytest.approx(min(accuracies))
    assert row["best_heading_deg"] == HEADINGS[int(np.argmin(accuracies))]
    assert row["track_m"] == pytest.approx(math.sqrt(np.mean(np.square(accuracies))))
    denser = dataclasses.replace(design, per_km2=4.0)
    assert score_cell(field, cell, denser)["information_m"] == pytest.approx(
        0.5 * row["information_m"]
    )


def test_tracks_are_straight_and_as_long_as_asked():
    cell = Cell(33.0, 33.5, 108.0, 108.5)
    design = dataclasses.replace(DESIGN, track_m=10e3)
    for heading, track in tracks(cell, design):
        ends = (track[-1] - track[0])[1::-1] * (math.cos(math.radians(33.25)) * 6.389e6, 6.363e6)
        assert np.hypot(*ends) == pytest.approx(10e3, rel=2e-3)
        assert math.degrees(math.atan2(*ends)) % 360.0 == pytest.approx(heading, abs=0.2)
        np.testing.assert_allclose(track.mean(axis=0)[:2], np.radians([33.25, 108.25]), atol=1e-9)


def test_noise_only_scales_what_knows_of_it(field, scored):
    noisy = score(field, dataclasses.replace(DESIGN, instrument=info.Instrument("tensor", 2.0)))
    for name in ("information_m", "track_m", "best_track_m"):
        np.testing.assert_allclose(noisy.table[name], 2.0 * scored.table[name])
    np.testing.assert_allclose(noisy.table["ambiguity"], scored.table["ambiguity"] / 4.0)
    for name in ("deviation", "roughness", "index"):
        np.testing.assert_array_equal(noisy.table[name], scored.table[name])


@thinned("kind", ["uu", "gravity"])
def test_a_single_channel_says_less_than_all(field, scored, kind):
    alone = score(field, dataclasses.replace(DESIGN, instrument=info.Instrument(kind, 1.0)))
    assert (alone.table["track_m"] > scored.table["track_m"]).all()
    if kind == "uu":
        np.testing.assert_array_equal(alone.table["roughness"], scored.table["roughness"])


def test_a_map_of_nothing_has_no_good_cell():
    """No traceback, and no division by zero that somebody sees."""
    found = score(Field.from_map(blank_map()), DESIGN)
    assert found.components is None
    assert (found.table["grade"] == "").all()
    assert (found.table["deviation"] < 1e-9).all()
    assert (found.table["track_m"] > 1e5).all()


def test_bounds_hold_the_cells(field):
    cells, _ = cells_of(field, DESIGN, Bounds(33.48, 33.60, None, 108.06), "it")
    assert cells
    assert min(c.south for c in cells) >= 33.48 - 1e-9
    assert max(c.north for c in cells) <= 33.60 + 1e-9
    assert max(c.east for c in cells) <= 108.06 + 1e-9


@pytest.mark.parametrize(
    ("changes", "bounds", "sentence"),
    [
        (
            {"height_m": 20e3},
            Bounds(),
            "the height 20000 m is outside it, which has 9500 to 10500 m",
        ),
        ({"cell_deg": 1.0, "spacing_m": None}, Bounds(), "no cell of 1°"),
        ({}, Bounds(40.0), "no cell of 0.07°"),
        ({"cell_deg": 0.0005, "spacing_m": None}, Bounds(), "at most 20000 are allowed"),
        ({"spacing_m": 2000.0}, Bounds(), "it does not have 8 to 1000 nodes along a side"),
    ],
)
def test_what_the_map_does_not_hold(field, changes, bounds, sentence):
    with pytest.raises(MapError, match=sentence):
        cells_of(field, dataclasses.replace(DESIGN, **changes), bounds, "it")


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"cell_deg": 0.0}, "the side of a cell is 0° and must be positive"),
        ({"sigma_m": math.inf}, "the deviation of the position is inf m"),
        ({"track_m": -1.0}, "the track is -1 m"),
        ({"readings": 1}, "a track must have 2 to 10000 measurements, found 1"),
        ({"right_m": 4500.0}, "below the search radius of 4500 m"),
        ({"height_m": math.nan}, "the height is nan m"),
    ],
)
def test_what_cannot_be_asked(changes, sentence):
    with pytest.raises(MapError, match=sentence):
        dataclasses.replace(DESIGN, **changes)


def test_the_normal_field_has_nothing_to_score():
    with pytest.raises(MapError, match="normal field has no map"):
        score(Field.normal(), DESIGN)


def test_a_file_is_scored_at_its_lowest_nodes(tmp_path, rough):
    write(tmp_path / "own.nc", rough)
    design = dataclasses.replace(DESIGN, height_m=None)
    found, height = named_map(str(tmp_path / "own.nc"), design, Bounds())
    assert height == 9500.0
    assert found.tensor.shape == rough.tensor.shape


@pytest.mark.parametrize("height", [None, 1200.0, 2000.0, 3000.0])
def test_a_shipped_terrain_is_made_about_any_height_that_it_gives(height, monkeypatch):
    """The recipe is one that can be followed, and reaches as far as the cells need."""
    from ggbench.maps import recipe
    from ggbench.matchability import sources

    made = []
    monkeypatch.setattr(sources, "load_or_build", made.append)
    design = Design(height, 0.03, sigma_m=500.0)
    bounds = Bounds(36.25, 36.35, -84.30, -84.20)
    _, found = named_map("jacksboro", design, bounds)
    (asked,) = made
    recipe.checked(asked)
    assert found == (1126.0 if height is None else height)
    assert asked.min_height_m <= found <= asked.max_height_m
    assert asked.south_deg < 36.25 - 1500.0 / 111e3
    assert asked.east_deg > -84.20 + 1500.0 / 90e3


def test_maps_that_are_none():
    for name, sentence in (
        ("nosuch", "nosuch is not a map: give a file"),
        ("nosuch.nc", "cannot read the map nosuch.nc"),
    ):
        with pytest.raises(MapError, match=sentence):
            named_map(name, DESIGN, Bounds())
    with pytest.raises(MapError, match="the height 100 m is outside egm2008_qinling"):
        named_map("egm2008_qinling", dataclasses.replace(DESIGN, height_m=100.0), Bounds())
    with pytest.raises(MapError, match=r"no cell of 0.5° .* jacksboro \(31.7 km by 30 km\)"):
        named_map("jacksboro", Design(), Bounds())
    with pytest.raises(MapError, match="egm2008_qinling lies outside the bounds"):
        named_map("egm2008_qinling", DESIGN, Bounds(south=60.0))


def test_bounds_in_another_turn_hold_the_same_cells(field):
    expected, _ = cells_of(field, DESIGN, Bounds(33.48, 33.60, 107.9, 108.06), "it")
    found, _ = cells_of(field, DESIGN, Bounds(33.48, 33.60, 107.9 - 360.0, 108.06), "it")
    assert len(found) == len(expected)
    assert np.allclose(found, expected)
