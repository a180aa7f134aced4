"""The choice of a measured map by navigation: the smoother, and what the maps must not know."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from made_surveys import survey
from measured_surveys.navigating import maps_without, noise_without
from measured_surveys.smoothing import GriddedMap, fly

from ggbench.gravity.coloured_noise import VectorAutoregression
from ggbench.maps.equivalent_sources import EquivalentSources, Plane, Settings

COARSE = Settings(900.0, 900.0, 0.1)
FOLDS = [[0, 5, 10], [1, 6, 11], [2, 7], [3, 8], [4, 9]]


def test_the_smoother_finds_the_drawn_errors_of_the_ins():
    """Readings have no noise: the error falls from hundreds of metres to interpolation's.

    As a control, a map of no field leaves the errors as they were drawn.
    """
    lines, rng = survey(), np.random.default_rng(3)
    plane = Plane.under(lines)
    places = np.array([*rng.uniform(-3000.0, 3000.0, (2, 60)), rng.uniform(-700.0, -400.0, 60)])
    sources = EquivalentSources(plane, places, rng.normal(0.0, 30.0, 60))
    noise = VectorAutoregression(lines.components, 1.0, np.zeros((0, 5, 5)), 0.01 * np.eye(5))
    samples = lines.samples(6)
    points, readings = plane.metres(lines).T[samples], sources.along(lines, samples)
    flat = dataclasses.replace(sources, masses=np.zeros(60))
    for drawn in rng.standard_normal((2, 6)):
        found, _ = fly(GriddedMap(sources, lines), noise, points, readings, drawn)
        left, nees = fly(GriddedMap(flat, lines), noise, points, readings, drawn)
        assert found < 1.0
        assert left > 100.0
        assert nees == pytest.approx(drawn @ drawn)


def test_neither_map_nor_noise_of_a_fold_knows_its_lines():
    """To rounding. As a control, those of the other folds do."""
    lines, rng = survey(noise=1.0), np.random.default_rng(4)
    values = lines.values.copy()
    values[lines.samples(5)] += rng.normal(0.0, 30.0, (60, 5))
    both = [lines, dataclasses.replace(lines, values=values)]
    first, second = (maps_without(each, COARSE, FOLDS) for each in both)
    np.testing.assert_allclose(first[0].masses, second[0].masses, atol=1e-6)
    assert np.abs(first[1].masses - second[1].masses).max() > 1.0
    left = rng.standard_normal((5, 2, 200, 5))
    spoilt = left.copy()
    spoilt[0] *= 2.0
    first, second = (noise_without(list(each), lines.components) for each in (left, spoilt))
    assert np.array_equal(first[0].innovation_cov, second[0].innovation_cov)
    assert not np.array_equal(first[1].innovation_cov, second[1].innovation_cov)
