"""Cells as hidden states, held to brute force over all paths and to the Kalman smoother."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from problems import LinearModel, changed, kalman, smoothed

from ggbench.engines.trellis import Trellis, cell_sides, step_probabilities
from ggbench.problem import Problem, StateBlock


def walk(seed: int, n: int, epochs: int, step: float, slope: float = 1.0) -> Problem:
    """Positions that walk, of unit prior, each read with a deviation of 0.7."""
    generator = np.random.default_rng(seed)
    x = generator.standard_normal(n)
    track = x + np.cumsum(step * generator.standard_normal((epochs, n)), axis=0)
    return Problem(
        times=np.arange(1.0, epochs + 1.0),
        measurements=slope * track + 0.7 * generator.standard_normal((epochs, n)),
        noise_cov=0.49 * np.eye(n),
        transition=np.tile(np.eye(n), (epochs, 1, 1)),
        process_cov=np.tile(step**2 * np.eye(n), (epochs, 1, 1)),
        prior_mean=np.zeros(n),
        prior_cov=np.eye(n),
        model=LinearModel(np.tile(slope * np.eye(n), (epochs, 1, 1))),
        layout=(StateBlock("position", slice(0, n), "m"),),
    )


def without_more(problem: Problem) -> np.ndarray:
    """No noise beside the problem's own."""
    channels = problem.measurements.shape[1]
    return np.zeros((problem.epochs, channels, channels))


def every_path(problem: Problem, side: float) -> tuple[np.ndarray, np.ndarray]:
    """All paths (N, K + 1, n) of three cells along each axis and what they lead to; their shares.

    Written out: prior, steps by their probabilities, and the likelihood of a Gaussian with the
    noise and, for a slope of one, a uniform cell's side² / 12.
    """
    n = problem.dimension
    probability = step_probabilities(float(problem.process_cov[0, 0, 0]) / side**2)
    half = len(probability) // 2
    steps = list(product(range(-half, half + 1), repeat=n))
    paths = np.array(list(product((-1, 0, 1), repeat=n)))[:, None]
    share = np.exp(-0.5 * (side * paths[:, 0]) ** 2).prod(axis=1)
    for k in range(problem.epochs):
        paths = np.concatenate(
            [np.concatenate([paths, paths[:, -1:] + step], axis=1) for step in steps]
        )
        share = np.concatenate([share * np.prod(probability[np.add(s, half)]) for s in steps])
        off = problem.measurements[k] - side * paths[:, -1]
        share = share * np.exp(-0.5 * (off**2).sum(axis=1) / (0.49 + side**2 / 12.0))
    return paths, share / share.sum()


@pytest.mark.parametrize(("n", "epochs", "step"), [(1, 3, 0.3), (1, 3, 1.0), (2, 2, 0.02)])
@pytest.mark.parametrize("seed", range(3))
def test_forward_backward_and_viterbi_are_brute_force(n, epochs, step, seed):
    """Probabilities of all cells to 1e-8, and the best of all paths, of which there are many.

    Of three cells along an axis that walk and are read thrice (twice, of two axes).
    """
    problem, side = walk(seed, n, epochs, step), 3.5
    trellis = Trellis(problem, np.full(n, side), 10_000, without_more(problem))
    paths, shares = every_path(problem, side)
    assert len(paths) > 1000
    best = paths[np.argmax(shares)]
    found = zip(trellis.layers, trellis.smoothed(), trellis.best_path(), strict=True)
    for k, (layer, smooth, cell) in enumerate(found):
        assert layer.shape == tuple(np.ptp(layer.indices(np.arange(len(smooth))), axis=0) + 1)
        places = layer.places(np.arange(len(smooth)))
        for place, probability in zip(places, smooth, strict=True):
            here = (paths[:, k] == np.rint(place / side)).all(axis=1)
            assert probability == pytest.approx(shares[here].sum(), abs=1e-8)
        assert smooth.sum() == pytest.approx(1.0)
        np.testing.assert_array_equal(np.rint(places[cell] / side), best[k])


def test_the_last_layer_knows_nothing_more_than_the_forward_pass():
    """And the others do: without that, a backward pass that does nothing would be right above."""
    problem = walk(0, 1, 3, 0.3)
    trellis = Trellis(problem, np.full(1, 0.5), 1000, without_more(problem))
    smooth = trellis.smoothed()
    np.testing.assert_array_equal(smooth[-1], trellis.layers[-1].forward)
    assert np.abs(smooth[0] - trellis.layers[0].forward).max() > 0.01


@pytest.mark.parametrize("variance", [0.0, 1e-4, 0.3, 2.0, 50.0])
def test_steps_have_the_variance_of_the_noise_and_compose(variance):
    """Two steps are one of twice the variance, however small against a cell (1e-9)."""
    one, two = step_probabilities(variance), step_probabilities(2.0 * variance)
    cells = np.arange(len(one)) - len(one) // 2
    assert one @ cells**2 == pytest.approx(variance, rel=1e-6)
    twice = np.convolve(one, one)
    margin = (len(twice) - len(two)) // 2
    np.testing.assert_allclose(twice[margin : margin + len(two)], two, atol=1e-9)


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize("turn", [False, True])
def test_fine_cells_are_the_kalman_filter_and_smoother(n, turn):
    """Of a linear problem: means to 0.02 deviations, variances to 2 %.

    Lattices may be moved and turned by the dynamics: that smears nothing.
    """
    problem = walk(5, n, 8, 0.4)
    if turn:
        angle = 0.3
        rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        problem = changed(problem, transition=np.tile(rotation[:n, :n], (8, 1, 1)))
    trellis = Trellis(problem, np.full(n, 0.1), 200_000, without_more(problem))
    mean, cov, _, _ = kalman(problem)
    both = ((mean, cov), smoothed(problem, 8))
    forward = [layer.forward for layer in trellis.layers]
    for shares, (mean, cov) in zip((forward, trellis.smoothed()), both, strict=True):
        for k, (layer, share) in enumerate(zip(trellis.layers[1:], shares[1:], strict=True)):
            found, spread = layer.moments(share)
            sigma = np.sqrt(np.diag(cov[k]))
            assert np.abs((found - mean[k]) / sigma).max() < 0.02
            np.testing.assert_allclose(np.diag(spread), sigma**2, rtol=0.02)


def test_coarse_cells_admit_how_coarse_they_are():
    """Cells of twenty deviations of a reading: its noise is that of a position within the cell.

    Without it the nearest centre would be the only cell, and its neighbours impossible.
    """
    problem = walk(1, 1, 5, 0.1, slope=20.0)
    trellis = Trellis(problem, np.ones(1), 1000, without_more(problem))
    truth = problem.measurements[-1] / 20.0
    mean, cov = trellis.layers[-1].moments(trellis.layers[-1].forward)
    assert 0.2 < np.sqrt(cov[0, 0]) < 1.0
    assert abs(mean[0] - truth[0]) < 2.0 * np.sqrt(cov[0, 0])


def test_noise_that_is_told_beside_the_problems_own_counts():
    """A reading that depends on what is no state says less."""
    problem = walk(2, 1, 3, 0.3)
    widths = []
    for more in (0.0, 25.0):
        trellis = Trellis(problem, np.full(1, 0.2), 1000, more + without_more(problem))
        widths.append(trellis.layers[-1].moments(trellis.layers[-1].forward)[1][0, 0])
    assert widths[1] > 1.5 * widths[0]


def test_no_more_cells_are_kept_than_asked_for():
    """The likeliest ones; and an epoch without a reading only widens them."""
    problem = walk(3, 2, 4, 1.0)
    problem = changed(problem, present=np.zeros((4, 2), dtype=bool))
    free = Trellis(problem, np.full(2, 0.5), 100_000, without_more(problem))
    kept = Trellis(problem, np.full(2, 0.5), 300, without_more(problem))
    sizes = [len(layer.cells) for layer in free.layers]
    assert sizes == sorted(sizes) and sizes[-1] > 300
    assert max(len(layer.cells) for layer in kept.layers) <= 300
    mean, cov = free.layers[-1].moments(free.layers[-1].forward)
    np.testing.assert_allclose(np.diag(cov), 1.0 + 4.0 + 0.25 / 12.0, rtol=0.01)
    assert np.abs(mean).max() < 1e-9


@pytest.mark.parametrize("most", [10, 1000, 100_000])
def test_cells_are_made_larger_to_fit(most):
    """Along axes that are wider than a cell; of the others a cell is a deviation."""
    sides = cell_sides(np.diag([1e6, 4e6, 25.0]), 20.0, most)
    count = np.prod(2.0 * np.ceil(3.5 * np.array([1e3, 2e3, 5.0]) / sides) + 1.0)
    assert count <= max(most, 9**3)
    assert sides[2] == 5.0


def test_a_field_without_numbers_is_an_exception():
    problem = walk(0, 1, 3, 0.3)
    nowhere = changed(problem, measurements=np.full((3, 1), np.inf))
    with pytest.raises(FloatingPointError, match="no cell"):
        Trellis(nowhere, np.ones(1), 100, without_more(problem))
