"""Draped layers of a map: base surface, and fields at constant heights above it.

The base surface is the upper envelope of the terrain, smoothed over the distance between the map's
nodes. It is nowhere below the ground, so a height above the base surface is at most the height
above ground.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, maximum_filter, uniform_filter

from ..gravity.gradient_map import MapError
from ..gravity.meridians import turns
from ..gravity.spline import spline_coefficients, surface_heights
from .netcdf import Layer, Nodes, step_of
from .parts import Part, TerrainPart, smoothed, terrain_about

if TYPE_CHECKING:
    from ..gravity.terrain import Terrain
    from ..gravity.terrain_masses import TerrainMasses

Array = NDArray[np.floating]

_RAISED = 4
"""Number of local corrections of the base surface, before the whole surface is raised."""
_LEVELS = 12
"""Level layers between which a smooth field is interpolated by a polynomial in the height."""
_MOST_BYTES = 1.75e9
"""Largest memory of the stored level layers, with nine components each [bytes]."""
_REACH = 4.0
"""Ratio of the height range of the level layers to the depth of the downward continuation."""
_LEAST_REACH_M = 2000.0


def base_surface(
    terrain: Terrain, geoid_height_m: float, latitude_deg: Array, longitude_deg: Array
) -> NDArray[np.float64]:
    """Return heights (n_lat, n_lon) of the base surface above the ellipsoid [m] at the nodes.

    The height is a running maximum of the terrain, followed by a running mean of the same width.
    The window extends to each side by half the distance between nodes, and by at least one cell of
    the terrain. Nodes are raised where the spline through the nodes would otherwise lie below a
    cell of the terrain. ``geoid_height_m`` is the height of the terrain's zero level above the
    ellipsoid.
    """
    steps = terrain.latitude_step_deg, terrain.longitude_step_deg
    nodes = latitude_deg, longitude_deg
    width = [
        2 * max(1, math.ceil(0.5 * step_of(axis) / step)) + 1
        for axis, step in zip(nodes, steps, strict=True)
    ]
    margins = [count * step for count, step in zip(width, steps, strict=True)]
    terrain = terrain.crop(
        latitude_deg[0] - margins[0],
        latitude_deg[-1] + margins[0],
        longitude_deg[0] - margins[1],
        longitude_deg[-1] + margins[1],
    )
    ground = np.asarray(terrain.height_m, dtype=np.float32)
    envelope = uniform_filter(maximum_filter(ground, width, mode="nearest"), width, mode="nearest")
    turn = float(turns(longitude_deg.mean(), terrain.longitudes_deg.mean()))
    first = terrain.south_deg, terrain.west_deg - turn
    places = np.meshgrid(
        *((axis - low) / step for axis, low, step in zip(nodes, first, steps, strict=True)),
        indexing="ij",
    )
    base: NDArray[np.float64] = map_coordinates(
        envelope.astype(float), places, order=1, mode="nearest"
    )
    for _ in range(_RAISED):
        low = _raise_needed(base, ground, first, steps, nodes)
        if not low.any():
            break
        base += maximum_filter(low, 3)
    base += float(_raise_needed(base, ground, first, steps, nodes).max())
    return base + geoid_height_m


def _raise_needed(
    base: Array,
    ground: Array,
    first: tuple[float, float],
    steps: tuple[float, float],
    nodes: tuple[Array, Array],
) -> Array:
    """Return the largest height (n_lat, n_lon) [m] of cells above a base, at the nearest node."""
    # Twice as dense as the cells: their middles, and their sides and corners with all neighbours.
    fine = np.repeat(np.repeat(ground, 2, axis=0), 2, axis=1)
    fine = maximum_filter(fine, 2, origin=-1)[:-1, :-1]
    axes = [
        low + 0.5 * step * np.arange(count)
        for low, step, count in zip(first, steps, fine.shape, strict=True)
    ]
    masks = [(axis >= n[0]) & (axis <= n[-1]) for axis, n in zip(axes, nodes, strict=True)]
    fine = fine[np.ix_(*masks)]
    axes = [axis[keep] for axis, keep in zip(axes, masks, strict=True)]
    origin = np.array([nodes[0][0], nodes[1][0], 0.0])
    step = np.array([step_of(nodes[0]), step_of(nodes[1]), 1.0])
    coefficients = spline_coefficients(spline_coefficients(base, 0), 1)
    needed = np.zeros_like(base)
    columns = np.clip(np.rint((axes[1] - origin[1]) / step[1]).astype(int), 0, base.shape[1] - 1)
    points = np.zeros((axes[1].size, 3))
    points[:, 1] = axes[1]
    surface = np.empty(axes[1].size)
    for latitude, heights in zip(axes[0], fine, strict=True):
        points[:, 0] = latitude
        surface_heights(points, origin, step, coefficients, surface)
        row = min(round((latitude - origin[0]) / step[0]), base.shape[0] - 1)
        np.maximum.at(needed[row], columns, np.maximum(heights - surface, 0.0))
    return needed


@dataclasses.dataclass(frozen=True)
class DrapedTerrain:
    """Map part: the field of a terrain's masses on draped layers.

    Attributes
    ----------
    masses : masses of the terrain.
    ratio : smallest ratio of distance to block size at which a line mass replaces a block of
        terrain cells. It sets the accuracy, see :meth:`.TerrainMasses.field`.
    smooth : smoothed terrain whose field is subtracted; None: no subtraction.
    """

    masses: TerrainMasses
    ratio: float
    smooth: SmoothTerrain | None = None

    @classmethod
    def of(
        cls, part: TerrainPart, nodes: Nodes, tolerance: float, continued: bool = True
    ) -> tuple[DrapedTerrain, float]:
        """Return the terrain part of a draped map, and its approximation error [E].

        The error is due to line masses in place of the terrain's columns.

        Parameters
        ----------
        part : the terrain, and the degree from which its field is used.
        nodes : nodes of a draped map, with the height of the base surface.
        tolerance : largest error from line masses in place of columns [E], see
            :meth:`.TerrainMasses.ratio_for`.
        continued : whether the ground is continued beyond the edges of the terrain.
        """
        from ..gravity.terrain_masses import TerrainMasses  # compiled, as a cached map needs not

        masses = TerrainMasses.of(
            terrain_about(part.terrain, nodes), part.options, part.geoid_height_m, continued
        )
        lowest = points_of(nodes, float(nodes.height_m[0]))
        ratio, error = masses.ratio_for(lowest, tolerance)
        return cls(masses, ratio, SmoothTerrain.of(part, nodes)), error

    def layers(self, nodes: Nodes) -> Iterator[Layer]:
        """Yield tensor and gravity disturbance of each draped layer, from the lowest up."""
        smooth_layers = (
            None if self.smooth is None else on_levels(self.smooth, nodes, self.smooth.floor_m)
        )
        for height in nodes.height_m:
            tensor, vector = self.masses.field(points_of(nodes, height), self.ratio)
            tensor = tensor.reshape(*nodes.shape[:2], 6)
            vector = vector.reshape(*nodes.shape[:2], 3)
            if smooth_layers is not None:
                smooth_tensor, smooth_vector = next(smooth_layers)
                tensor -= smooth_tensor
                vector -= smooth_vector
            yield tensor, vector


@dataclasses.dataclass(frozen=True)
class SmoothTerrain:
    """Map part: the field of a smoothed terrain on level layers above its highest point.

    Attributes
    ----------
    part : the smoothed terrain.
    floor_m : lowest height at which Parker's series converges quickly [m].
    """

    part: TerrainPart
    floor_m: float

    @classmethod
    def of(cls, part: TerrainPart, nodes: Nodes) -> SmoothTerrain | None:
        """Return the terrain smoothed to ``part.above_degree``; None if this degree is None.

        The field of the smoothed terrain is subtracted from the field of ``part``.
        """
        from .ground import Ground

        if part.above_degree is None:
            return None
        terrain = smoothed(terrain_about(part.terrain, nodes), part.above_degree, part.options)
        # A field that is continued downwards has its rounding multiplied by some thousands.
        whole = dataclasses.replace(part, terrain=terrain, above_degree=None, dtype="float64")
        return cls(whole, Ground(terrain, part.geoid_height_m).lowest_m())

    def layers(self, nodes: Nodes) -> Iterator[Layer]:
        """Yield the field of the whole smoothed terrain on level layers."""
        return self.part.layers(nodes)


def points_of(nodes: Nodes, height: float) -> NDArray[np.float64]:
    """Return an array (N, 3) of the latitude, longitude [rad] and height [m] of N nodes.

    The nodes are those of one layer. Returned heights are above the ellipsoid. The argument
    ``height`` is the height of the layer above the base surface [m].
    """
    assert nodes.base_m is not None
    lat, lon = np.meshgrid(
        np.radians(nodes.latitude_deg), np.radians(nodes.longitude_deg), indexing="ij"
    )
    return np.stack([lat.ravel(), lon.ravel(), nodes.base_m.ravel() + height], axis=-1)


def draped(part: Part, nodes: Nodes) -> Iterator[Layer]:
    """Yield the layers of a map part on the nodes of a draped map."""
    return part.layers(nodes) if isinstance(part, DrapedTerrain) else on_levels(part, nodes)


def on_levels(part: Part, nodes: Nodes, floor: float = -math.inf) -> Iterator[Layer]:
    """Yield a field on draped layers, interpolated between level layers.

    The interpolation is a polynomial in the height through level layers at Chebyshev points. All
    level layers lie above ``floor`` [m]. If the floor is above the lowest node, the field is
    extrapolated downwards, which is accurate only for a smooth field.

    Raises MapError if a layer has too many nodes.
    """
    assert nodes.base_m is not None
    lowest = float(nodes.base_m.min() + nodes.height_m[0])
    dtype = np.dtype(np.float64 if floor > lowest else np.float32)
    most = int(_MOST_BYTES / (_LEVELS * 9 * dtype.itemsize))
    if nodes.base_m.size > most:
        raise MapError(
            f"a layer of the draped map has {nodes.base_m.size} nodes; with harmonics or a "
            f"gravity grid at most {most} are allowed: use a smaller area or a wider spacing."
        )
    highest = float(nodes.base_m.max() + nodes.height_m[-1])
    low, high = max(lowest, floor), highest
    if floor > lowest:
        high = max(highest, low + max(_REACH * (low - lowest), _LEAST_REACH_M))
    angles = math.pi * (np.arange(_LEVELS) + 0.5) / _LEVELS
    heights = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(angles)
    level = Nodes(nodes.latitude_deg, nodes.longitude_deg, heights)
    layers = [np.concatenate(layer, axis=-1).astype(dtype) for layer in part.layers(level)]
    for height in nodes.height_m:
        weights = _polynomials(heights, nodes.base_m + height)
        total = np.zeros((*nodes.shape[:2], 9))
        for weight, layer in zip(weights, layers, strict=True):
            total += weight[..., np.newaxis] * layer
        yield total[..., :6], total[..., 6:]


def _polynomials(nodes: Array, places: Array) -> Array:
    """Return the Lagrange polynomials (n, ...) of nodes (n,), evaluated at ``places`` (...)."""
    weights = np.ones((nodes.size, *places.shape))
    for i, node in enumerate(nodes):
        for other in np.delete(nodes, i):
            weights[i] *= (places - other) / (node - other)
    return weights


def summed(parts: Sequence[Part], nodes: Nodes) -> Iterator[Layer]:
    """Yield the sum of all parts on draped layers, from the lowest up."""
    first, *others = (draped(part, nodes) for part in parts)
    for tensor, vector in first:
        for layers in others:
            more_tensor, more_vector = next(layers)
            tensor += more_tensor
            vector += more_vector
        yield tensor, vector
