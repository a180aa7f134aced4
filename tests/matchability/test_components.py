"""The index by principal components: its orientation, and what is left out of it."""

from __future__ import annotations

import numpy as np
import pytest

from ggbench.matchability.components import (
    GRADES,
    KEPT_VARIANCE,
    ORIENTATION,
    grades,
    principal_components,
)


def cells(seed, count=80, noise=0.4):
    """Statistics that one quality drives, each in its own sense and unit; and the quality."""
    rng = np.random.default_rng(seed)
    quality = rng.standard_normal(count)
    found = {}
    for name, sign in ORIENTATION.items():
        unit = 10.0 ** rng.uniform(-4, 4)
        found[name] = unit * np.exp(sign * quality + noise * rng.standard_normal(count))
    return found, quality


@pytest.mark.parametrize("seed", range(8))
def test_the_index_points_to_what_is_taken_for_better(seed):
    """Whatever sign an eigenvector comes with."""
    statistics, quality = cells(seed)
    found = principal_components(statistics)
    assert np.corrcoef(found.index, quality)[0, 1] > 0.95
    assert found.vectors[0, 0] > 0.0
    assert found.explained.sum() == pytest.approx(1.0)
    assert (np.diff(found.explained) <= 0.0).all()
    shares = np.cumsum(found.explained)
    assert shares[found.kept - 1] >= KEPT_VARIANCE
    assert found.kept == 1 or shares[found.kept - 2] < KEPT_VARIANCE
    np.testing.assert_allclose(found.vectors.T @ found.vectors, np.eye(5), atol=1e-12)


def test_every_component_rises_with_the_deviation():
    """Statistics of several causes, so that all components are in the index."""
    rng = np.random.default_rng(3)
    statistics = {name: np.exp(rng.standard_normal(60)) for name in ORIENTATION}
    found = principal_components(statistics)
    x = np.log(np.stack([*statistics.values()], axis=1)) * np.array([*ORIENTATION.values()])
    x = (x - x.mean(axis=0)) / x.std(axis=0, ddof=1)
    scores = x @ found.vectors
    assert found.kept >= 4
    assert (np.corrcoef(scores.T, x[:, 0])[-1, :-1] >= 0.0).all()
    expected = scores[:, : found.kept] @ found.explained[: found.kept]
    np.testing.assert_allclose(found.index, expected, atol=1e-12)
    np.testing.assert_allclose(np.var(scores, axis=0, ddof=1) / 5.0, found.explained, atol=1e-12)


def test_units_do_not_matter():
    statistics, _ = cells(1)
    scaled = {name: 1e3 * values for name, values in statistics.items()}
    one, other = (principal_components(s).index for s in (statistics, scaled))
    np.testing.assert_allclose(one, other, atol=1e-9)


def test_flat_cells_are_left_out_and_in_the_lowest_third():
    statistics, _ = cells(2)
    statistics["deviation"][3] = 0.0
    statistics["correlation_m"][5] = np.nan
    found = principal_components(statistics)
    assert [*np.flatnonzero(np.isnan(found.index))] == [3, 5]
    given = grades(found.index)
    assert given[3] == given[5] == GRADES[0]
    known = [g for i, g in enumerate(given) if i not in (3, 5)]
    assert [known.count(g) for g in GRADES] == [26, 26, 26]
    assert given[int(np.nanargmax(found.index))] == GRADES[2]


def test_too_few_cells_have_no_index():
    statistics, _ = cells(4, count=5)
    assert principal_components(statistics) is None
    statistics, _ = cells(4)
    statistics["entropy"][:] = 0.9
    assert principal_components(statistics) is None
    assert grades(np.full(3, np.nan)) == [GRADES[0]] * 3
