"""Readings taken in by exact stages: what comes out is the posterior, however sharp they are.

Statistical tests have fixed seeds and say how often other seeds would fail them.
"""

from __future__ import annotations

import numpy as np
import pytest

from ggbench.engines import annealing
from ggbench.engines.annealing import Annealed, annealed, whitening

COUNT = 4000


def draws(count: int, rank: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((count, rank))


def of_a_line(noise: np.ndarray, spread: np.ndarray, rows: np.ndarray, z: np.ndarray) -> Annealed:
    """Draws of a standard normal p after a reading z = H p + C l + noise."""
    space = whitening(noise, spread)

    def read(normals: np.ndarray) -> np.ndarray:
        return (z - normals @ rows.T) @ space.rows.T

    rng = np.random.default_rng(2)
    return annealed(
        normals=draws(COUNT, rows.shape[1]),
        read=read,
        space=space,
        count=COUNT,
        least=1000.0,
        resampling="systematic",
        rng=rng,
    )


@pytest.mark.parametrize("linear", [0.0, 1.0], ids=["drawn states alone", "linear states, too"])
def test_a_sharp_reading_leaves_kalmans_posterior(linear):
    """Three states of which a reading tells a hundredth of the prior, or is blurred by others.

    Mean to 0.1 deviations, covariance to 15 %, log evidence to 0.6: five deviations of what seeds
    scatter by or more.
    """
    rng = np.random.default_rng(3)
    rows, root = rng.normal(size=(4, 3)), rng.normal(size=(4, 4))
    noise = 1e-4 * (root @ root.T + np.eye(4))
    spread = linear * np.outer(root[0], root[0])
    z = rows @ np.array([0.7, -0.4, 0.2])
    found = of_a_line(noise, spread, rows, z)

    total = rows @ rows.T + spread + noise
    gain = np.linalg.solve(total, rows).T
    mean, cov = gain @ z, np.eye(3) - gain @ rows
    evidence = -0.5 * (z @ np.linalg.solve(total, z) + np.linalg.slogdet(2 * np.pi * total)[1])
    assert found.stages > 3
    sigma = np.sqrt(np.diag(cov))
    assert np.abs((found.normals.mean(axis=0) - mean) / sigma).max() < 0.1
    assert np.abs((np.cov(found.normals.T) - cov) / np.outer(sigma, sigma)).max() < 0.15
    assert found.evidence == pytest.approx(evidence, abs=0.6)
    assert len(np.unique(found.normals[:, 0])) > 0.9 * COUNT


def two_modes(rng: np.random.Generator) -> np.ndarray:
    """Draws after a reading |p| = 1 ± 0.02 of a standard normal p; p > 0 counts three times."""
    space = whitening(np.diag([0.02**2, 1.0]), np.zeros((2, 2)))

    def read(normals: np.ndarray) -> np.ndarray:
        side = np.where(normals > 0.0, 0.0, np.sqrt(2.0 * np.log(3.0)))
        return np.hstack([np.abs(normals) - 1.0, side]) @ space.rows.T

    return annealed(
        normals=draws(COUNT, 1),
        read=read,
        space=space,
        count=COUNT,
        least=1000.0,
        resampling="systematic",
        rng=rng,
    ).normals[:, 0]


def test_modes_keep_their_weights_and_their_widths():
    """Three quarters in one mode, each as wide as the reading says: no stage blurs them.

    To 0.04 and 10 %: four deviations of what seeds scatter by.
    """
    found = two_modes(np.random.default_rng(4))
    assert np.mean(found > 0.0) == pytest.approx(0.75, abs=0.04)
    for mode in (found[found > 0.0], found[found < 0.0]):
        assert mode.std() == pytest.approx(0.02, rel=0.1)


def test_a_step_that_is_always_taken_is_seen(monkeypatch):
    """Negative control: without the Metropolis rule draws lie outside of both modes."""

    class Reckless(np.random.Generator):
        def exponential(self, size):
            return np.full(size, np.inf)

    apart = [
        np.mean(np.abs(np.abs(two_modes(kind(np.random.PCG64(4)))) - 1.0) > 0.1)
        for kind in (np.random.Generator, Reckless)
    ]
    assert apart[0] == 0.0
    assert apart[1] > 0.1


def test_a_stage_that_cannot_leave_as_many_as_asked_for_comes_to_an_end():
    """With 999 of 1000 to be left there are sixty stages, and what remains is taken at once."""
    space = whitening(np.eye(1), np.zeros((1, 1)))
    rng = np.random.default_rng(5)
    found = annealed(
        normals=draws(1000, 1),
        read=lambda p: 100.0 * (p - 1.0),
        space=space,
        count=1000,
        least=999.0,
        resampling="residual",
        rng=rng,
    )
    assert found.stages == annealing.MOST_STAGES
    assert np.isfinite(found.normals).all()
    assert np.abs(found.normals - 1.0).max() < 0.5


def test_positions_that_have_no_reading_weigh_nothing():
    """NaN is no likelihood: no draw ends there."""
    space = whitening(np.eye(1), np.zeros((1, 1)))

    def read(normals: np.ndarray) -> np.ndarray:
        return np.where(normals > 0.0, np.nan, normals)

    rng = np.random.default_rng(6)
    found = annealed(
        normals=draws(COUNT, 1),
        read=read,
        space=space,
        count=COUNT,
        least=1000.0,
        resampling="systematic",
        rng=rng,
    )
    assert (found.normals <= 0.0).all()
