"""The rivals of the speed benchmark solve the same problem: their h and H are ggbench's."""

import numpy as np
import pytest
from speed import export, flops, numpy_model, rounds

RUNS = (0, 7)


@pytest.fixture(scope="module")
def both():
    arrays = export.arrays(RUNS)
    models = [problem.model for problem in export.problems(RUNS)]
    return arrays, [numpy_model.NumpyModel(arrays, r) for r in range(len(RUNS))], models


def states(arrays, spread, count=4, seed=5):
    rng = np.random.default_rng(seed)
    return arrays.prior_mean + spread * arrays.scale * rng.standard_normal((count, 15))


@pytest.mark.parametrize("spread", [0.0, 1.0, 100.0])
def test_the_readings_that_numpy_predicts_are_ggbenchs(both, spread):
    arrays, ours, theirs = both
    for run in range(len(RUNS)):
        for k in (0, 3, 77, 199):
            x = states(arrays, spread, seed=k)
            expected = theirs[run].predict(k, x)
            # The tensor is 3000 E: the rounding of a double is 5e-13 E.
            np.testing.assert_allclose(ours[run].predict_all(k, x), expected, rtol=0, atol=1e-9)
            for one, state in zip(expected, x, strict=True):
                np.testing.assert_allclose(ours[run].predict(k, state), one, rtol=0, atol=1e-9)


@pytest.mark.parametrize("spread", [0.0, 1.0, 100.0])
def test_the_jacobian_in_numpy_is_ggbenchs(both, spread):
    arrays, ours, theirs = both
    for run in range(len(RUNS)):
        for k in (0, 3, 77, 199):
            (x,) = states(arrays, spread, count=1, seed=k)
            expected = theirs[run].jacobian(k, x)
            # In units of the noise for one deviation of the prior.
            unit = arrays.scale / np.sqrt(np.diag(arrays.noise_cov))[:, None]
            scaled = (ours[run].jacobian(k, x) - expected) * unit
            assert np.abs(expected * unit).max() > 0.1
            np.testing.assert_allclose(scaled, 0.0, atol=1e-9)


class Counted:
    """A number that counts the additions and multiplications it takes part in."""

    count = 0

    def __init__(self, value=1.0):
        self.value = value

    def operate(self, other):
        Counted.count += 1
        return Counted()

    __add__ = __sub__ = __mul__ = __truediv__ = operate

    def sqrt(self):
        return self.operate(self)


def counted(*shape):
    return np.array([Counted() for _ in range(int(np.prod(shape)))], dtype=object).reshape(shape)


def cholesky(matrix):
    n = len(matrix)
    lower = counted(n, n)
    for j in range(n):
        for i in range(j, n):
            total = matrix[i, j]
            for k in range(j):
                total = total - lower[i, k] * lower[j, k]
            lower[i, j] = total.sqrt() if i == j else total / lower[j, j]
    return lower


def solve(lower, right):
    """Two triangular systems, column by column."""
    for column in right.T:
        for _ in range(2):
            for i in range(len(lower)):
                total = column[i]
                for k in range(i):
                    total = total - lower[i, k] * column[k]
                column[i] = total / lower[i, i]
    return right


def update(x, p, y, s, cross):
    gain = solve(cholesky(s), cross.T.copy()).T
    return x + gain @ y, p - gain @ cross.T


def test_the_operations_of_the_filters_are_those_of_their_equations():
    n, m = 15, 6
    points = 2 * n + 1
    phi, p, q, x = counted(n, n), counted(n, n), counted(n, n), counted(n)
    h, r, y = counted(m, n), counted(m, m), counted(m)

    Counted.count = 0
    x, p = phi @ x, phi @ p @ phi.T + q
    cross = (h @ p).T
    update(x, p, y, h @ cross + r, cross)
    # The formula rounds 2n − 1 up to 2n: a few per cent.
    assert Counted.count == pytest.approx(flops.ekf(n, m, 1), rel=0.05)

    weights = counted(points)
    Counted.count = 0
    cholesky(p), cholesky(p)
    sigmas = counted(points, n) @ phi.T
    x = weights @ sigmas
    p = (sigmas.T * weights) @ sigmas + q
    readings = counted(points, m)
    weights @ readings
    s = (readings.T * weights) @ readings + r
    cross = sigmas.T @ readings
    update(x, p, y, s, cross)
    assert Counted.count == pytest.approx(flops.ukf(n, m, 1), rel=0.06)


@pytest.mark.long
def test_what_gives_another_answer_is_not_timed(both, tmp_path):
    arrays, _, _ = both
    entries = [
        rounds.Entry("ggbench:ekf", "the reference", "ekf"),
        rounds.Entry("ggbench:ekf[iterations=3]", "another filter", "ekf"),
        rounds.Entry("ggbench:no_such_filter", "one that cannot start", "ekf"),
    ]
    found = rounds.measure(
        entries, tmp_path / "unused.npz", tmp_path, rounds.within(arrays.scale, {"ekf": 1e-9}),
        rounds=1, seconds=0.0,
    )  # fmt: skip
    assert [len(item.turns) for item in found] == [1, 0, 0]
    assert "its means differ by" in found[1].refusal
    assert "no_such_filter" in found[2].refusal
