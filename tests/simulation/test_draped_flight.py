"""Flights in draped maps: measurement model, bound, estimators and refusals."""

import dataclasses

import numpy as np
import pytest
from small_cases import small_case

from ggbench.gravity.field import OutsideMapError
from ggbench.gravity.gradient_map import MapError
from ggbench.judging.planned import bound_of
from ggbench.maps.recipe import MapRecipe, build, checked, nodes_of
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.runs import simulate

AREA = {
    "field.source": "jacksboro",
    "field.drape": True,
    "field.south_deg": 36.285,
    "field.north_deg": 36.30,
    "field.west_deg": -84.275,
    "field.east_deg": -84.25,
    "field.lowest_m": 50.0,
    "field.highest_m": 350.0,
    "field.height_spacing_m": 50.0,
    "field.spacing_arcmin": 0.08,
}
RECIPE = MapRecipe(
    source="jacksboro",
    south_deg=36.285,
    north_deg=36.30,
    west_deg=-84.275,
    east_deg=-84.25,
    min_height_m=50.0,
    max_height_m=350.0,
    spacing_arcmin=0.08,
    height_spacing_m=50.0,
    drape=True,
)


def draped_case(**changes):
    flight = {
        "trajectory.latitude_deg": 36.29,
        "trajectory.longitude_deg": -84.268,
        "trajectory.height_m": None,
        "trajectory.speed_mps": 40.0,
        "trajectory.heading_deg": 70.0,
        "trajectory.segment": [
            {
                "kind": "terrain-following",
                "terrain": "jacksboro_dem_3arcsec.npz",
                "clearance_m": 150.0,
                "duration_s": 30.0,
            }
        ],
    }
    return small_case(AREA | flight | changes)


@pytest.mark.long
def test_h_and_its_slopes_are_those_of_the_place_above_the_ground():
    """H by differences of h, of a flight whose base changes by a tenth of its way."""
    flight = prepare(draped_case())
    assert flight.field.is_draped and np.ptp(flight.field.base(flight.trajectory.positions)) > 50.0
    problem, truth = simulate(flight, seed=1, run=0)
    for k in (2, len(truth.error_state) - 1):
        x = truth.error_state[k]
        slopes = problem.model.jacobian(k, x)
        for state in range(3):
            step = np.zeros_like(x)
            step[state] = 0.5
            difference = problem.model.predict(k, x + step) - problem.model.predict(k, x - step)
            assert difference == pytest.approx(slopes[:, state], abs=2e-3)
    assert np.isfinite(bound_of(flight.case))


@pytest.mark.long
def test_a_flight_into_the_layers_below_is_refused_with_its_place():
    segment = draped_case().trajectory.segment[0].model_copy(update={"clearance_m": 15.0})
    low = draped_case()
    low = low.model_copy(
        update={"trajectory": low.trajectory.model_copy(update={"segment": (segment,)})}
    )
    with pytest.raises(OutsideMapError, match=r"° N, .*above its base surface, which lies at"):
        prepare(low)


def test_a_draped_recipe_gives_the_nodes_and_their_base():
    recipe = checked(dataclasses.replace(RECIPE, north_deg=36.29, east_deg=-84.27))
    made, nodes = build(recipe), nodes_of(recipe)
    assert made.base == pytest.approx(nodes.base_m) and made.height0 == 50.0
    assert np.abs(made.tensor[..., [0, 3, 5]].sum(axis=-1)).max() < 1e-6 * np.abs(made.tensor).max()
    assert 300.0 < made.base.min() < made.base.max() < 1100.0


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"source": "egm2008_qinling"}, "drape is not allowed for 'egm2008_qinling'"),
        ({"min_height_m": 5.0}, "min_height_m = 5.0 is outside"),
        ({"height_spacing_m": 60.0}, "height_spacing_m = 60.0 is too wide"),
        ({"spacing_arcmin": 0.2}, "the height above the ground"),
    ],
)
def test_a_draped_recipe_that_cannot_be_followed_is_refused(changes, said):
    with pytest.raises(MapError, match=said):
        checked(dataclasses.replace(RECIPE, **changes))
