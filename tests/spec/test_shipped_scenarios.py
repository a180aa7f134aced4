"""Every scenario that is shipped can be flown, within its map, and its runs are what they claim.

Over the normal field, as the maps take half a minute each; that a flight stays within its map is
seen from its recipe.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.stats import chi2
from small_cases import over_the_normal_field
from thinning import thinned

from ggbench.campaign import registry
from ggbench.estimator_spec import EstimatorSpec
from ggbench.judging.references import CaseBound
from ggbench.maps.recipe import checked, nodes_of
from ggbench.simulation.error_free_flight import Flight, prepare
from ggbench.simulation.field_source import map_recipe
from ggbench.simulation.flight_bounds import flight_bound
from ggbench.simulation.runs import simulate
from ggbench.spec import scenario
from ggbench.spec.gradiometer import GradiometerChange, TrueGradiometer

SAMPLES = 20_000
"""IMU samples beyond which one case of a scenario stands for all."""
load = functools.cache(scenario.load)


def chosen(name: str) -> list[str]:
    """The cases of a scenario, or the first of a sweep or of long flights."""
    loaded = load(name)
    first = loaded.cases[0]
    long = first.trajectory.duration_s > SAMPLES * first.imu.period_s
    return [case.name for case in (loaded.cases[:1] if long or loaded.sweep else loaded.cases)]


LATER = (
    "long_transit",
    "vinton2008_flight",
    "zhou2015",
    *sorted(set(scenario.shipped()) - {*sorted(scenario.shipped())[::6]}),
)
"""Scenarios whose flights take longest to make, and five of six of the others."""
each_case = pytest.mark.parametrize(
    ("name", "case"),
    [
        pytest.param(name, case, marks=pytest.mark.long if number or name in LATER else ())
        for name in scenario.shipped()
        for number, case in enumerate(chosen(name))
    ],
)
"""The first case of every sixth scenario is daily, all others are long."""


@functools.cache
def flown(name: str, case: str) -> Flight:
    return prepare(over_the_normal_field(load(name).case(case)))


@thinned("name", scenario.shipped())
def test_a_shipped_scenario_names_estimators_that_exist(name):
    """A campaign of it can begin."""
    loaded = load(name)
    chosen = registry.choose_all(
        [*loaded.campaign.estimators, loaded.campaign.assumption_estimator]
    )
    assert len(chosen) >= 2
    assert loaded.notes


@each_case
def test_a_shipped_flight_stays_within_its_maps(name, case):
    """Truth's and model's map can be made as they are described, and cover the flight."""
    flight = flown(name, case)
    positions = flight.trajectory.positions
    if flight.case.trajectory.made_up_turns:  # nothing is measured there
        positions = positions[flight.epochs][~flight.absent]
    where = positions * np.array([180.0 / np.pi, 180.0 / np.pi, 1.0])
    for side in ("truth", "model"):
        field = load(name).case(case).side(side).field
        if field.source == "normal":
            continue
        recipe = map_recipe(field)
        checked(recipe)
        low = [recipe.south_deg, recipe.west_deg, recipe.min_height_m]
        high = [recipe.north_deg, recipe.east_deg, recipe.max_height_m]
        within = where.copy()
        if recipe.drape:
            nodes = nodes_of(recipe)
            axes = nodes.latitude_deg, nodes.longitude_deg
            within[:, 2] -= RegularGridInterpolator(axes, nodes.base_m)(where[:, :2])
        assert (within.min(axis=0) >= low).all()
        assert (within.max(axis=0) <= high).all()


@each_case
def test_a_shipped_case_is_simulated_as_it_is_told(name, case):
    """A run of finite numbers; where the model is right, z − h(true error) is noise of its R.

    Chi-square of all readings, false-alarm probability 1e-4 per case. Behind a filter they are not
    white, and only finite; of readings that were measured no noise is known.
    """
    flight = flown(name, case)
    problem, truth = simulate(flight, seed=1, run=0)
    for array in (
        problem.measurements,
        problem.transition,
        problem.process_cov,
        problem.prior_cov,
        truth.error_state,
    ):
        assert np.isfinite(array).all()
    assert np.isfinite(CaseBound(flight, flight_bound(flight)).final_m)
    spec = flight.case
    told = (
        (spec.gradiometer is None or spec.gradiometer.filter == "none")
        and not spec.measured_sensors()
        and spec.truth.gradiometer == TrueGradiometer()
        and spec.model.gradiometer == GradiometerChange()
    )
    if not told:
        return
    left = np.array(
        [
            z - problem.model.predict(k, x)
            for k, (z, x) in enumerate(zip(problem.measurements, truth.error_state, strict=True))
        ]
    )
    total = np.einsum("ki,ij,kj->", left, np.linalg.inv(problem.noise_cov), left)
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], np.count_nonzero(problem.present))
    assert low < total < high


def test_comparisons_name_estimators_as_the_runs_do():
    """Up to the order of parameters; a default that a label states would hide the comparison."""
    comparisons = [c for name in scenario.shipped() for c in scenario.load(name).comparisons]
    labels = {label for c in comparisons for value in c.values for label in c.labels(value)}
    assert len(labels) > 20
    for label in labels:
        assert EstimatorSpec.parse(label) == registry.choose(label).spec, label
    stated = EstimatorSpec.parse("correlation[candidates=basins]")
    assert stated != registry.choose("correlation[candidates=basins]").spec
