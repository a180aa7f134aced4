"""Gravity and gravity gradient of a terrain, at any point above the ground.

Parker's series (:mod:`.parker`) converges only above the highest summit. Sums over the columns of
:mod:`.terrain_columns` are valid at every point above the ground. The masses are those of Parker's
series. Each cell of the terrain has the height of its node. By default the terrain is
continued beyond its edges by its mirror image. The mirror image fades into the mean height of the
edge over a tenth of the terrain's longer side. Without this continuation there are no
masses beyond the edges.

Around each point the Earth is flat. The docstring of :mod:`.parker` states the error of this
approximation.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..files.writing import end_if_asked
from .ellipsoid import EOTVOS, radii_of_curvature
from .meridians import turns
from .parker import BORDER, GRAVITATIONAL_CONSTANT, TerrainOptions, density_layers
from .terrain import Terrain, TerrainError
from .terrain_columns import Columns, add_columns, fill_parents

Array = NDArray[np.float64]

RATIOS = (2.0, 3.0, 4.0, 6.0, 8.0, 12.0)
"""Choices for the smallest ratio of distance to width at which a block is a line mass."""
_REFERENCE = 24.0
"""Ratio of the reference for the errors of all other ratios."""
_SAMPLES = 32
"""Number of points at which these errors are computed."""
_AT_ONCE = 512
"""Number of points in one task of a thread."""
_EDGE = 0.5
"""Cells beyond the outermost nodes that belong to the terrain."""


@dataclass(frozen=True)
class TerrainMasses:
    """Masses of a terrain, for sums at points above the ground.

    Attributes
    ----------
    terrain : heights above the zero level.
    layers : columns of the land, and columns of the density deficit of the sea. They reach from a
        base to the ground. Let e be the mean height of the edge of the grid. If the terrain is
        continued beyond it, the base is max(e, 0) for the land and min(e, 0) for the sea. Otherwise
        both bases are 0.
    geoid_height : height of the terrain's zero level above the ellipsoid [m].
    """

    terrain: Terrain
    layers: tuple[Columns, ...]
    geoid_height: float

    @classmethod
    def of(
        cls,
        terrain: Terrain,
        options: TerrainOptions | None = None,
        geoid_height: float = 0.0,
        continued: bool = True,
    ) -> TerrainMasses:
        """Return the masses of a terrain.

        Parameters
        ----------
        terrain : heights above the zero level.
        options : densities; by default those of :class:`.parker.TerrainOptions`.
        geoid_height : height of the terrain's zero level above the ellipsoid [m].
        continued : whether the ground is continued beyond the edges of the terrain.

        Raises
        ------
        TerrainError
            If the geoid height is not finite.
        """
        if not math.isfinite(geoid_height):
            raise TerrainError(f"geoid_height = {geoid_height} must be a finite number.")
        surface, edge, rows, columns = np.asarray(terrain.height_m, dtype=float), 0.0, 0, 0
        if continued:
            surface, edge, rows, columns = _continued(terrain)
        steps = np.radians([terrain.latitude_step_deg, terrain.longitude_step_deg])
        corner = np.radians([terrain.south_deg, terrain.west_deg]) - steps * (rows, columns)
        layers = density_layers(surface, edge, options or TerrainOptions())
        return cls(
            terrain,
            tuple(
                _columns(heights, base, density, corner, steps) for heights, base, density in layers
            ),
            geoid_height,
        )

    def field(self, points: Array, ratio: float) -> tuple[Array, Array]:
        """Return the tensor (N, 6) [E] and the gravity vector (N, 3) [m/s²], ENU.

        Parameters
        ----------
        points : (N, 3) latitude, longitude [rad], height above the ellipsoid [m].
        ratio : a block is a line mass if the ratio of its distance to its size is at least this
            number, see :func:`.add_columns`.

        Raises
        ------
        TerrainError
            If a point is not above the ground; the message states the point.
        KeyboardInterrupt
            If the user interrupts the computation.
        """
        points = self._above_ground(points)
        out = np.zeros((len(points), 9))
        parts = [slice(at, at + _AT_ONCE) for at in range(0, len(points), _AT_ONCE)]

        def add(part: slice) -> None:
            end_if_asked()  # a layer may take minutes
            for columns in self.layers:
                add_columns(columns, points[part], ratio, out[part])

        with ThreadPoolExecutor(os.cpu_count()) as pool:
            for _ in pool.map(add, parts):
                pass
        for columns in self.layers:
            _add_plate(columns, points[:, 2], out)
        out *= GRAVITATIONAL_CONSTANT
        return out[:, :6] / EOTVOS, out[:, 6:]

    def ratio_for(self, points: Array, tolerance: float) -> tuple[float, float]:
        """Return the smallest ``ratio`` of :meth:`field` with errors of at most a tolerance [E].

        The ratio is one of :data:`RATIOS`. If none has errors within the tolerance, the largest one
        is returned. Errors are computed at a sample of the points (N, 3). They are differences from
        a sum with the ratio 24, which contains more prisms. The second result is the largest error
        of any tensor component [E].
        """
        some = points[np.linspace(0, len(points) - 1, min(_SAMPLES, len(points))).astype(int)]
        exact, _ = self.field(some, _REFERENCE)
        ratio, error = RATIOS[-1], math.inf
        for ratio in RATIOS:
            error = float(np.abs(self.field(some, ratio)[0] - exact).max())
            if error <= tolerance:
                break
        return ratio, error

    def ground(self, latitude: Array, longitude: Array) -> Array:
        """Return the height of the ground (N,) above the ellipsoid [m] at positions (N,) [rad].

        Raises
        ------
        TerrainError
            If a position lies outside the terrain.
        """
        terrain, indices = self.terrain, []
        for name, first, step, count, degrees in (
            ("latitude", terrain.south_deg, terrain.latitude_step_deg, 0, np.degrees(latitude)),
            ("longitude", terrain.west_deg, terrain.longitude_step_deg, 1, np.degrees(longitude)),
        ):
            last = terrain.height_m.shape[count] - 1
            if name == "longitude":
                degrees = degrees + turns(degrees, first + 0.5 * step * last)
            at = (degrees - first) / step
            inside = np.abs(at - 0.5 * last) <= 0.5 * last + _EDGE + 1e-6  # NaN fails too
            if not inside.all():
                raise TerrainError(
                    f"{name} {degrees[np.argmin(inside)]:.6g} degrees is not within "
                    f"{terrain.name}: {first - _EDGE * step:.6f} to "
                    f"{first + (last + _EDGE) * step:.6f} is allowed."
                )
            indices.append(np.clip(np.rint(at).astype(int), 0, last))
        return np.asarray(terrain.height_m, dtype=float)[tuple(indices)] + self.geoid_height

    def _above_ground(self, points: Array) -> Array:
        """Return points (N, 3) with heights above the zero level, in the turn of the terrain.

        Raises TerrainError if a point is not above the ground.
        """
        moved = np.array(points, dtype=float)
        above = moved[:, 2] - self.ground(moved[:, 0], moved[:, 1])
        if not (above > 0.0).all():  # NaN fails too
            worst = int(np.argmin(np.where(above > 0.0, np.inf, above)))
            latitude, longitude = np.degrees(moved[worst, :2])
            raise TerrainError(
                f"the point {latitude:.5f}° N, {longitude:.5f}° E, {moved[worst, 2]:.6g} m lies "
                f"{-above[worst]:.3g} m below the ground of {self.terrain.name}; fields are "
                "computed only above the ground."
            )
        middle = np.radians(self.terrain.longitudes_deg.mean())
        moved[:, 1] += turns(moved[:, 1], middle, math.tau)
        moved[:, 2] -= self.geoid_height
        return moved


def _add_plate(columns: Columns, levels: Array, out: Array) -> None:
    """Add the field of an infinite plate between zero level and base of columns to ``out`` (N, 9).

    ``levels`` (N,) are the heights of the points above the zero level [m].
    """
    low, high = min(columns.base, 0.0), max(columns.base, 0.0)
    density = math.copysign(columns.density, columns.base)
    below = np.clip(levels, low, high) - low
    out[:, 8] -= 2.0 * math.pi * density * (2.0 * below - (high - low))
    out[:, 5] -= np.where((low < levels) & (levels < high), 4.0 * math.pi * density, 0.0)


def _continued(terrain: Terrain) -> tuple[Array, float, int, int]:
    """Return the heights of a terrain continued beyond its edges.

    Returns
    -------
    Heights [m]; mean height of the edge [m]; numbers of rows and of columns added on each side.
    """
    heights = np.asarray(terrain.height_m, dtype=float)
    edge = float(
        np.concatenate((heights[0], heights[-1], heights[1:-1, 0], heights[1:-1, -1])).mean()
    )
    middle = math.radians(terrain.latitudes_deg.mean())
    meridian, prime_vertical = radii_of_curvature(middle)
    metres = np.radians([terrain.latitude_step_deg, terrain.longitude_step_deg]) * [
        meridian,
        prime_vertical * math.cos(middle),
    ]
    counts = np.array(heights.shape)
    border = BORDER * float(((counts - 1) * metres).max())
    added = np.minimum(np.ceil(border / metres).astype(int), counts - 1)
    around = np.pad(heights, [(n, n) for n in added], mode="reflect")
    beyond = [
        np.maximum(0.0, np.abs(np.arange(n + 2 * a) - a - 0.5 * (n - 1)) - 0.5 * (n - 1)) * metre
        for n, a, metre in zip(counts, added, metres, strict=True)
    ]
    outside = np.minimum(np.hypot(beyond[0][:, np.newaxis], beyond[1]) / border, 1.0)
    around = edge + np.cos(0.5 * math.pi * outside) ** 2 * (around - edge)
    return around, edge, int(added[0]), int(added[1])


def _columns(
    heights: Array, base: float, density: float, south_west: Array, steps: Array
) -> Columns:
    """Return the columns between ``base`` and ``heights``, with the blocks of all levels."""
    cells = np.zeros((*_even(heights.shape), 4), np.float32)
    cells[: heights.shape[0], : heights.shape[1], 0] = heights - base
    levels = [cells]
    while max(levels[-1].shape[:2]) > 2:
        rows, columns = levels[-1].shape[:2]
        parents = np.zeros((rows // 2 * (columns // 2), 4), np.float32)
        fill_parents(levels[-1].reshape(-1, 4), rows, columns, parents)
        shape = (rows // 2, columns // 2)
        padded = np.zeros((*_even(shape), 4), np.float32)
        padded[: shape[0], : shape[1]] = parents.reshape(*shape, 4)
        levels.append(padded)
    sizes = [level.shape[0] * level.shape[1] for level in levels]
    return Columns(
        blocks=np.concatenate([level.reshape(-1, 4) for level in levels]),
        first=np.cumsum([0, *sizes[:-1]]),
        shape=np.array([level.shape[:2] for level in levels]),
        south_west=south_west,
        steps=steps,
        base=base,
        density=density,
    )


def _even(shape: Iterable[int]) -> tuple[int, ...]:
    """Return numbers rounded up to even numbers."""
    return tuple(n + n % 2 for n in shape)
