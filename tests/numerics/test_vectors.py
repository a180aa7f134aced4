"""Vectors: a formula written for numbers gives, of eight of them at once, what it gives of each."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
from thinning import thinned

from ggbench.gravity.ellipsoid import (
    metres_per_radian_of,
    normal_gradient_of,
    normal_gradient_slopes_of,
    normal_gravity_of,
)
from ggbench.numerics import lanes
from ggbench.numerics.kernels import LANES, compiled, inlined
from ggbench.numerics.rotations import left_jacobian, multiply, sine_cosine, small_turn, transpose
from ggbench.numerics.vectors import like, load, splat, store


@inlined
def arithmetic(x, y, z):
    """All that vectors can do, with vectors and with numbers on either side."""
    total = like(x, 0.5)
    for _ in range(3):
        total = total * x + 1.25
    total -= y / z
    total += 2.0 - z
    total *= 1.0 / y
    return total, -x, math.sqrt(x * x + y), math.floor(y - z), (x - 3.0) / 2.0, 3.0 / y


@inlined
def field(x, y, z):
    """The normal field at a latitude and a height."""
    sine, cosine = sine_cosine(x)
    height = 1e4 * y
    slopes = normal_gradient_slopes_of(sine, cosine, height)
    return (
        normal_gradient_of(sine, cosine, height)[2],
        slopes[1],
        slopes[6],
        normal_gravity_of(sine, cosine, height)[1],
        metres_per_radian_of(sine, cosine, height)[1],
        sine,
    )


@inlined
def turns(x, y, z):
    """Rotations about (x, y, z)."""
    turn, jacobian = small_turn(x, y, z), left_jacobian(x, y, z)
    square = multiply(turn, transpose(jacobian))
    return square[0], square[1], square[2], square[3], square[5], square[7]


def both(formula):
    """A formula on vectors, and number by number."""

    @compiled
    def of_vectors(given, out):
        found = formula(load(given, 0, 0), load(given, 0, 1), load(given, 0, 2))
        store(out, 0, 0, found[0])
        store(out, 0, 1, found[1])
        store(out, 0, 2, found[2])
        store(out, 0, 3, found[3])
        store(out, 0, 4, found[4])
        store(out, 0, 5, found[5])

    @compiled
    def of_numbers(x, y, z):
        return formula(x, y, z)

    return of_vectors, of_numbers


@thinned("formula", [arithmetic, field, turns])
def test_a_formula_gives_the_same_of_eight_numbers_at_once(formula):
    """To rounding: products and sums of vectors are fused."""
    of_vectors, of_numbers = both(formula)
    given = np.random.default_rng(2).uniform(0.1, 1.2, size=(1, 3, LANES))
    out = lanes.lanes(1, 6)
    of_vectors(given, out)
    expected = np.array([of_numbers(*given[0, :, r]) for r in range(LANES)]).T
    np.testing.assert_allclose(out[0], expected, rtol=1e-12, atol=1e-15)


def test_a_product_in_a_sum_is_rounded_once():
    """Exactly, on any processor: in a sum or a difference, on either side."""

    @compiled
    def of_vectors(given, out):
        x, y, z = load(given, 0, 0), load(given, 0, 1), load(given, 0, 2)
        store(out, 0, 0, x * y + z)
        store(out, 0, 1, z + x * y)
        store(out, 0, 2, x * y - z)
        store(out, 0, 3, z - x * y)
        total = splat(0.5)
        total += x * 1.5
        store(out, 0, 4, total)

    def exact(x, y, z):
        return float(Fraction(x) * Fraction(y) + Fraction(z))

    x, y = np.random.default_rng(4).uniform(0.5, 1.5, size=(2, LANES))
    z = -x * y  # a rounding error is left
    out = lanes.lanes(1, 5)
    of_vectors(np.stack([x, y, z])[np.newaxis], out)
    for r, (a, b, c) in enumerate(zip(x, y, z, strict=True)):
        wanted = [
            exact(a, b, c),
            exact(a, b, c),
            exact(a, b, -c),
            exact(-a, b, c),
            exact(1.5, a, 0.5),
        ]
        assert out[0, :, r].tolist() == wanted
    assert np.any(out[0, 0] != 0.0)


def test_a_number_goes_into_all_lanes():
    @compiled
    def fill(out):
        store(out, 0, 1, 2.5)

    out = lanes.lanes(1, 3)
    fill(out)
    assert (out[0, 1] == 2.5).all()
    assert not out[0, [0, 2]].any()


def test_a_lane_that_is_no_number_stays_alone():
    """The root of a negative number, and what follows from it, is NaN in its lane alone."""
    of_vectors, _ = both(arithmetic)
    given = np.random.default_rng(3).uniform(0.1, 1.2, size=(1, 3, LANES))
    clean = lanes.lanes(1, 6)
    of_vectors(given, clean)
    given[0, 1, 5] = -4.0
    out = lanes.lanes(1, 6)
    of_vectors(given, out)
    assert math.isnan(out[0, 2, 5])
    others = np.arange(LANES) != 5
    np.testing.assert_array_equal(out[:, :, others], clean[:, :, others])
