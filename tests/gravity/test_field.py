"""The gradient field: an exact, smooth spline over the normal field, safe beyond its edges."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from frame_oracles import difference, metres, third_derivatives

from ggbench.gravity.field import (
    Field,
    OutsideMapError,
    gradients_and_slopes,
)
from ggbench.gravity.gradient_map import GradientMap
from ggbench.gravity.spline import (
    TENSOR_WORK,
    spline_coefficients,
    spline_tensor_slopes,
    vector_at,
)

ORIGIN = np.array([0.58, 1.88, 9000.0])
STEP = np.array([4e-4, 5e-4, 500.0])
LEVEL = np.zeros((0, 0))
"""The base of level layers."""
NODES = (6, 4, 7)
UPPER = ORIGIN + STEP * (np.array(NODES) - 1)


def make_map(tensor: np.ndarray, disturbance: np.ndarray) -> GradientMap:
    return GradientMap(*ORIGIN, *STEP, tensor, disturbance, provenance="made for a test")


@pytest.fixture(scope="module")
def rough() -> Field:
    """A field of random node values: nothing is smooth in it but the spline itself."""
    rng = np.random.default_rng(1)
    return Field.from_map(
        make_map(rng.normal(size=(*NODES, 6)), 1e-4 * rng.normal(size=(*NODES, 3)))
    )


def inside(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(ORIGIN, UPPER, (count, 3))


def spline(field: Field, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return of_tensors(field.tensor_coefficients, position, field.origin, field.step)


def of_tensors(
    coefficients: np.ndarray, position: np.ndarray, origin: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the tensor (6,) and its derivatives (6, 3) at a position."""
    found = np.empty((24, 1))
    spline_tensor_slopes(
        positions=position[:, np.newaxis],
        count=1,
        origin=origin,
        step=step,
        coefficients=coefficients,
        base=LEVEL,
        work=np.empty(TENSOR_WORK),
        out=found,
    )
    return found[:6, 0], found[6:, 0].reshape(6, 3)


def kernel(field: Field, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    value, derivative = np.empty((1, 6)), np.empty((1, 6, 3))
    gradients_and_slopes(
        positions=position[np.newaxis],
        origin=field.origin,
        step=field.step,
        coefficients=field.tensor_coefficients,
        base=field.base_coefficients,
        values=value,
        derivatives=derivative,
    )
    return value[0], derivative[0]


def test_spline_reproduces_cubic_polynomials():
    """A field that is a cubic in each coordinate comes back exactly, up to the last node.

    Four nodes, the fewest, along one axis; points in all cells, on faces, edges and corners.
    """
    rng = np.random.default_rng(2)
    polynomial = rng.normal(size=(4, 4, 4, 6))

    def evaluate(cells: np.ndarray, orders: tuple[int, int, int] = (0, 0, 0)) -> np.ndarray:
        """Polynomial, or a derivative of it, in units of cells from the middle of the grid."""
        powers = []
        for axis, order in enumerate(orders):
            x = (cells[..., axis] - 0.5 * (NODES[axis] - 1)) / NODES[axis]
            if order == 0:
                powers.append(np.stack([x**p for p in range(4)], axis=-1))
            else:
                columns = [np.zeros_like(x)] + [p * x ** (p - 1) for p in range(1, 4)]
                powers.append(np.stack(columns, axis=-1) / NODES[axis])
        return np.einsum("...i,...j,...k,ijkm->...m", *powers, polynomial)

    grid = np.stack(np.meshgrid(*(np.arange(n) for n in NODES), indexing="ij"), axis=-1)
    coefficients = evaluate(grid.astype(float))
    for axis in range(3):
        coefficients = spline_coefficients(coefficients, axis)
    corners = np.array(list(itertools.product(*((0.0, n / 2 - 0.5, n - 1.0) for n in NODES))))
    points = np.concatenate([rng.uniform(0.0, np.array(NODES) - 1.0, (300, 3)), corners])
    three = np.ascontiguousarray(coefficients[..., :3])
    for point in points:
        value, derivative = of_tensors(coefficients, point, np.zeros(3), np.ones(3))
        np.testing.assert_allclose(value, evaluate(point), rtol=0.0, atol=1e-12)
        slopes = [evaluate(point, orders) for orders in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
        np.testing.assert_allclose(derivative, np.stack(slopes, axis=-1), rtol=0.0, atol=1e-12)
        vector, along = np.empty(3), np.empty((3, 3))
        vector_at(
            position=point,
            origin=np.zeros(3),
            step=np.ones(3),
            coefficients=three,
            base=LEVEL,
            value=vector,
            derivative=along,
        )
        np.testing.assert_allclose(vector, value[:3], rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(along, derivative[:3], rtol=0.0, atol=1e-14)


def test_map_nodes_and_normal_field_add_up():
    """At its nodes the field is the map's tensor plus the normal one, component by component."""
    rng = np.random.default_rng(3)
    tensor, disturbance = rng.normal(size=(*NODES, 6)), 1e-4 * rng.normal(size=(*NODES, 3))
    field = Field.from_map(make_map(tensor, disturbance))
    nodes = [o + s * np.arange(n) for o, s, n in zip(ORIGIN, STEP, NODES, strict=True)]
    grid = np.meshgrid(*nodes, indexing="ij")
    np.testing.assert_allclose(
        field.tensor(*grid) - Field.normal().tensor(*grid), tensor, rtol=0.0, atol=1e-11
    )
    np.testing.assert_allclose(field.gravity_disturbance(*grid), disturbance, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_continuous_with_its_derivative_across_cells(rough, axis):
    """Neither the field nor its slope jumps where a track crosses from one cell into the next."""
    for point in inside(40, seed=4 + axis):
        for node in range(1, NODES[axis] - 1):
            sides = []
            for side in (-1e-9, 1e-9):
                at = point.copy()
                at[axis] = ORIGIN[axis] + STEP[axis] * (node + side)
                sides.append(spline(rough, at))
            (below, slope_below), (above, slope_above) = sides
            np.testing.assert_allclose(below, above, rtol=0.0, atol=1e-7)
            np.testing.assert_allclose(slope_below * STEP, slope_above * STEP, rtol=0.0, atol=1e-7)
            # Piecewise constants or lines through these nodes would fail: they vary by this much.
            assert np.abs(slope_below * STEP).max() > 0.1


def test_derivative_is_per_metre_east_north_up(rough):
    """The derivative is the change of the tensor for a step over the ground, spline and normal."""
    # A sixth-order difference within one cell, where the field is analytic.
    cells = np.random.default_rng(8).integers(0, np.array(NODES) - 1, (60, 3))
    for point in ORIGIN + STEP * (cells + np.random.default_rng(9).uniform(0.2, 0.8, (60, 3))):
        _, derivative = rough.tensor_and_derivative(*point)
        to_radians = np.linalg.inv(metres(point))
        numeric = np.stack(
            [
                difference(
                    lambda d, axis=axis, at=point, to=to_radians: rough.tensor(
                        *(at + to @ (d * np.eye(3)[axis]))
                    ),
                    30.0,
                )
                for axis in range(3)
            ],
            axis=-1,
        )
        np.testing.assert_allclose(derivative, numeric, rtol=0.0, atol=1e-9)
        assert np.abs(derivative).max() > 1e-4


@pytest.mark.parametrize("shape", [(), (1,), (5,), (2, 3), (2, 0, 3), (2, 1, 4, 1)])
def test_any_batch_shape(rough, shape):
    """Positions of any shape, broadcast, give in each place what that position gives alone."""
    points = inside(int(np.prod(shape)), seed=10).reshape(*shape, 3)
    latitude, longitude, height = np.moveaxis(points, -1, 0)
    value, derivative = rough.tensor_and_derivative(latitude, longitude, height)
    disturbance = rough.gravity_disturbance(latitude, longitude, height)
    assert value.shape == (*shape, 6)
    assert derivative.shape == (*shape, 6, 3)
    assert disturbance.shape == (*shape, 3)
    for index in np.ndindex(shape):
        alone, alone_derivative = rough.tensor_and_derivative(*points[index])
        np.testing.assert_array_equal(value[index], alone)
        np.testing.assert_array_equal(derivative[index], alone_derivative)
        np.testing.assert_array_equal(disturbance[index], rough.gravity_disturbance(*points[index]))
    if len(shape) == 2 and points.size:
        spread = rough.tensor(latitude[:, :1], longitude[:, :1], height[:1, :])
        np.testing.assert_array_equal(
            spread[-1, 0], rough.tensor(latitude[-1, 0], longitude[-1, 0], height[0, 0])
        )


def test_outside_names_the_position_and_the_bounds(rough):
    """Whoever leaves the map is told where they were and what the map covers."""
    latitude, longitude, height = inside(3, seed=11).T
    longitude[1] = UPPER[1] + 1e-3
    for query in (rough.tensor, rough.tensor_and_derivative, rough.gravity_disturbance):
        with pytest.raises(OutsideMapError) as caught:
            query(latitude, longitude, height)
        sentence = str(caught.value)
        for number in (
            f"{np.degrees(latitude[1]):.5f}",
            f"{np.degrees(longitude[1]):.5f}",
            f"{height[1]:.0f} m",
            *(f"{np.degrees(bound):.3f}" for bound in (*ORIGIN[:2], *UPPER[:2])),
            f"{ORIGIN[2]:.0f} to {UPPER[2]:.0f} m",
        ):
            assert number in sentence


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_every_bound_is_a_bound(rough, axis, side):
    """On a border node, computed with rounding, one is inside; a thousandth of a cell on, not."""
    point = inside(1, seed=12)[0]
    border = UPPER[axis] if side > 0.0 else ORIGIN[axis]
    point[axis] = border * (1.0 + side * 2e-16)
    rough.tensor(*point)
    rough.gravity_disturbance(*point)
    point[axis] = border + side * 1e-3 * STEP[axis]
    with pytest.raises(OutsideMapError):
        rough.tensor(*point)
    with pytest.raises(OutsideMapError):
        rough.gravity_disturbance(*point)


@pytest.mark.parametrize("distance", [1e-3, 0.5, 3.0, 1e3])
def test_kernel_continues_the_border_outside(rough, distance):
    """Beyond the map the disturbing field stays what it is at the border: continuous, finite."""
    for point in inside(20, seed=13):
        for axis, side in itertools.product(range(3), (-1.0, 1.0)):
            border = point.copy()
            border[axis] = UPPER[axis] if side > 0.0 else ORIGIN[axis]
            beyond = border.copy()
            beyond[axis] += side * distance * STEP[axis]
            value, slope = spline(rough, beyond)
            at_border, slope_at_border = spline(rough, border)
            np.testing.assert_allclose(value, at_border, rtol=0.0, atol=1e-12)
            along = [other for other in range(3) if other != axis]
            np.testing.assert_array_equal(slope[:, axis], 0.0)
            np.testing.assert_allclose(
                slope[:, along] * STEP[along], slope_at_border[:, along] * STEP[along], atol=1e-12
            )


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("number", [np.inf, -np.inf, 1e300, -1e300, 1e18])
def test_kernel_survives_any_number(rough, axis, number):
    """No trial point of an estimator, however lost, reads outside the coefficients' memory."""
    point = inside(1, seed=14)[0]
    point[axis] = number
    kernel(rough, point)
    stored = rough.tensor_coefficients
    disturbing, _ = spline(rough, point)
    # Weights of a spline are positive and sum to one: its values lie within the coefficients.
    assert disturbing.min() >= stored.min()
    assert disturbing.max() <= stored.max()
    with pytest.raises(OutsideMapError):
        rough.tensor(*point)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_nan_in_nan_out(rough, axis):
    """A position that is not a number has no gradient: it must not be given one."""
    point = inside(1, seed=15)[0]
    point[axis] = np.nan
    for field in (rough, Field.normal()):
        value, _ = kernel(field, point)
        if axis == 1 and not field.has_map:
            continue  # the normal field is the same at every longitude
        assert np.isnan(value).any(), field.has_map
    with pytest.raises(OutsideMapError):
        rough.tensor(*point)


def test_normal_field_alone_is_valid_everywhere():
    """Without a map there is no outside, and the accelerometers feel normal gravity only."""
    field = Field.normal()
    assert not field.has_map
    assert np.isfinite(field.tensor([-1.5, 0.0, 1.5], [0.0, 3.0, -3.0], 1e5)).all()
    np.testing.assert_array_equal(field.gravity_disturbance([0.1, 0.2], 0.0, 0.0), 0.0)


# The real field: what interpolation leaves of the laws that the field obeys.


def track_positions(field: Field, count: int, seed: int) -> np.ndarray:
    """Random positions in the middle three quarters of the map."""
    margin = (field.upper - field.origin) / 8.0
    return np.random.default_rng(seed).uniform(
        field.origin + margin, field.upper - margin, (count, 3)
    )


def test_real_field_is_trace_free(wang):
    """trace(Γ) = 0 between the nodes as well as on them: splines of all components are alike."""
    value, derivative = wang.field.tensor_and_derivative(
        *track_positions(wang.field, 300, seed=16).T
    )
    assert np.abs(value[:, 0] + value[:, 3] + value[:, 5]).max() < 1e-9
    assert np.abs(derivative[:, 0] + derivative[:, 3] + derivative[:, 5]).max() < 1e-12


def test_real_field_is_curl_free(wang):
    """Third derivatives of the potential are symmetric, within the error of interpolation.

    The map's spline costs 1e-3 E at nodes 2 km apart, so a few 1e-6 E/m in the slope, a thousandth
    of the disturbing field's slope (4e-3 E/m).
    """
    worst = largest = 0.0
    normal = Field.normal()
    for position in track_positions(wang.field, 100, seed=17):
        value, derivative = wang.field.tensor_and_derivative(*position)
        third = third_derivatives(value, derivative, position)
        disturbing = third - third_derivatives(*normal.tensor_and_derivative(*position), position)
        largest = max(largest, np.abs(disturbing).max())
        for order in ((0, 2, 1), (2, 1, 0), (1, 2, 0)):
            worst = max(worst, np.abs(third - third.transpose(order)).max())
    print(f"curl {worst:.2e} of {largest:.2e} E/m")
    assert worst < 1e-5
    assert largest > 100.0 * worst
