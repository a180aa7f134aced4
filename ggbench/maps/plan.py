"""Plan of a map from users' files: parts, nodes and attributes."""

from __future__ import annotations

import dataclasses
import datetime
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..files.writing import sha256_of
from ..gravity.datums import ELLIPSOIDAL
from ..gravity.ellipsoid import SEMI_MAJOR_AXIS
from ..gravity.gradient_map import MapError
from ..gravity.harmonics import HarmonicCoefficients, without_normal_field
from ..gravity.meridians import Area
from ..gravity.remove_restore import MARGIN_DEG, TAPER_DEG, Residual, height_anomaly
from ..numerics.source import VERSION
from . import drape
from .gravity_grid import elevation_at, read_grid
from .gravity_model import read_model
from .ground import Ground
from .netcdf import TENSOR, VECTOR, Errors, Layer, Nodes, described
from .nodes import EVERYWHERE, GridRequest, SourceExtent, nodes_for
from .parts import (
    FILTER_ORDER,
    HarmonicPart,
    Part,
    ResidualPart,
    TerrainPart,
    summed,
)
from .shipped_parts import COEFFICIENTS, disturbing_coefficients

if TYPE_CHECKING:
    from ..gravity.terrain import Terrain

Array = NDArray[np.floating]

TOLERANCE_EOTVOS = 0.5
"""Default of the largest error from approximating terrain masses in a draped map [E]."""
_SHIPPED_DEGREE = 120
_WORTH_SAYING_M = 1.0
"""Geoid height from which on a remark on the zero level is made [m]."""
_INSET = 0.1  # of a terrain's width: nearer to its edges what lies beyond them matters most


@dataclasses.dataclass(frozen=True)
class Inputs:
    """Inputs of a map from users' files; see ``ggbench map build --help``.

    Attributes
    ----------
    terrain, coefficients, grid, land_correction : paths of files; None if not used.
    grid_kind : ``geoid``, ``anomaly`` or ``disturbance``.
    grid_height_m : height of the grid's values above the ellipsoid [m].
    min_degree, max_degree : lowest and highest degree of the coefficients that is used.
    epoch : epoch of time-variable coefficients.
    terrain_from_degree : degree up to which the other files contain the field; the terrain adds
        shorter wavelengths.
    density, water_density, order : density of the ground and density of water [kg/m³], and order
        of Parker's series; see :mod:`ggbench.gravity.parker`.
    geoid_height_m : height of the terrain's zero level above the ellipsoid [m]; None: EGM2008 for a
        draped map, 0 for a map of level layers.
    voids : additional values that mark voids in terrains and grids.
    clearance_m : planned height of the flight above the ground; None if unknown.
    drape : heights of the lowest and highest layer above the base surface of a draped map [m];
        None: level layers.
    tolerance_eotvos : largest error from approximating the terrain's masses in a draped map [E].
    continued : whether the terrain of a draped map is continued beyond its edges.
    """

    terrain: Path | None = None
    coefficients: Path | None = None
    grid: Path | None = None
    grid_kind: str = "geoid"
    grid_height_m: float = 0.0
    land_correction: Path | None = None
    min_degree: int = 2
    max_degree: int | None = None
    epoch: datetime.date | None = None
    terrain_from_degree: int | None = None
    density: float = 2670.0
    water_density: float = 1030.0
    order: int = 8
    geoid_height_m: float | None = None
    voids: tuple[float, ...] = ()
    clearance_m: float | None = None
    drape: tuple[float, float] | None = None
    tolerance_eotvos: float = TOLERANCE_EOTVOS
    continued: bool = True


LayersFor = Callable[[Nodes, float], tuple[float, float]]


@dataclasses.dataclass(frozen=True)
class Plan:
    """Map that can be computed, with standard errors if they are known."""

    parts: tuple[Part, ...]
    nodes: Nodes
    attributes: dict[str, str]
    remarks: tuple[str, ...]
    errors: Errors | None = None

    def layers(self) -> Iterator[Layer]:
        """Yield the layers of the map, from the lowest up."""
        if self.nodes.base_m is not None:
            return drape.summed(self.parts, self.nodes)
        return summed(self.parts, self.nodes)


def plan(
    inputs: Inputs, request: GridRequest, command: str, layers_for: LayersFor | None = None
) -> Plan:
    """Return the plan of a map.

    Parameters
    ----------
    inputs : files and options.
    request : requested nodes.
    command : the user's command, for the ``history`` attribute of the file.
    layers_for : function that chooses the lowest and the highest layer of a draped map [m above the
        base surface]. Its arguments are nodes with a base surface, and the height of the terrain's
        zero level [m above the ellipsoid]. If this function is given, ``inputs.drape`` is only a
        first guess.

    Raises MapError or TerrainError if a file is invalid, files contradict each other, or bounds are
    outside the inputs.
    """
    sources = _Sources(inputs, request.area)
    if layers_for is not None:
        inputs = sources.layered(inputs, request, layers_for)
    nodes, remarks = nodes_for(sources.extents, request, inputs.drape)
    if inputs.drape is not None:
        nodes = sources.drape(inputs, nodes)
    elif sources.ground is not None:
        remarks.append(sources.ground.remark(nodes))
    if sources.ground is not None:
        remarks += sources.ground.beyond(nodes, inputs.density)
    attributes = {
        "title": f"Gravity-gradient map: {sources.title}",
        "source": "; ".join(sources.words),
        "history": f"ggbench {VERSION}: {command}",
        "source_files": described(sources.hashes),
        "parameters": described(sources.parameters),
    }
    return Plan(tuple(sources.parts), nodes, attributes, (*sources.remarks, *remarks))


def _with_base(part: TerrainPart, nodes: Nodes) -> Nodes:
    """Return nodes with the base surface of a terrain."""
    base = drape.base_surface(
        part.terrain, part.geoid_height_m, nodes.latitude_deg, nodes.longitude_deg
    )
    return dataclasses.replace(nodes, base_m=base)


class _Sources:
    """Parts of a map with their extents, descriptions, remarks and file hashes."""

    def __init__(self, inputs: Inputs, area: Area) -> None:
        self._area = area
        self.ground: Ground | None = None
        self.parts: list[Part] = []
        self.extents: list[SourceExtent] = []
        self.words: list[str] = []
        self.remarks: list[str] = []
        self.hashes: dict[str, str] = {}
        self.parameters: dict[str, Any] = {}
        if not (inputs.terrain or inputs.coefficients or inputs.grid):
            raise MapError(
                "a map needs a source: give --terrain, --coefficients, --geoid, --anomaly, "
                "--disturbance or --lines."
            )
        if inputs.land_correction and (inputs.grid is None or inputs.grid_kind != "geoid"):
            raise MapError(
                "--land-correction requires --geoid, which it converts to height anomalies."
            )
        self._check_heights(inputs)
        coefficients = self._coefficients(inputs)
        if inputs.grid:
            assert coefficients is not None
            self._grid(inputs, inputs.grid, coefficients)
        if inputs.terrain:
            self._terrain(inputs, inputs.terrain, coefficients)
        files = (inputs.coefficients, inputs.grid, inputs.terrain)
        self.title = " + ".join(path.name for path in files if path)

    @staticmethod
    def _check_heights(inputs: Inputs) -> None:
        """Raise MapError if a height is not finite, or if an option lacks its input file."""
        for option, value in (
            ("--grid-height", inputs.grid_height_m),
            ("--geoid-height", inputs.geoid_height_m or 0.0),
            ("--clearance", inputs.clearance_m or 0.0),
        ):
            if not math.isfinite(value):
                raise MapError(f"{option} {value:g} must be a finite number.")
        default = Inputs()
        if inputs.grid is None and inputs.grid_height_m != default.grid_height_m:
            raise MapError("--grid-height requires --anomaly or --disturbance.")
        terrain = (
            "density",
            "water_density",
            "order",
            "geoid_height_m",
            "terrain_from_degree",
            "clearance_m",
        )
        if inputs.drape is not None and inputs.terrain is None:
            raise MapError("--drape requires --terrain.")
        if inputs.drape is None and not (
            inputs.continued and inputs.tolerance_eotvos == default.tolerance_eotvos
        ):
            raise MapError("--tolerance and --beyond require --drape.")
        if not 0.0 < inputs.tolerance_eotvos < math.inf:
            raise MapError(f"--tolerance {inputs.tolerance_eotvos:g} E must be positive.")
        changed = any(getattr(inputs, key) != getattr(default, key) for key in terrain)
        if inputs.terrain is None and changed:
            raise MapError(
                "--density, --water-density, --order, --geoid-height, --terrain-from-degree and "
                "--clearance require --terrain."
            )

    def _coefficients(self, inputs: Inputs) -> HarmonicCoefficients | None:
        if inputs.coefficients is None:
            if inputs.epoch is not None:
                raise MapError("--epoch requires --coefficients that vary with time.")
            if inputs.grid is None:
                if inputs.max_degree is not None or inputs.min_degree > 2:
                    raise MapError("--max-degree and --min-degree require --coefficients.")
                return None
            whole = disturbing_coefficients(COEFFICIENTS)
            name, highest = "EGM2008", inputs.max_degree or _SHIPPED_DEGREE
            if highest > whole.degree:
                raise MapError(
                    f"the package contains EGM2008 to degree {whole.degree}: for degree "
                    f"{highest} give --coefficients."
                )
            whole = whole.between(0, highest)
        else:
            self.hashes[inputs.coefficients.name] = sha256_of(inputs.coefficients, MapError)
            model = read_model(inputs.coefficients, inputs.max_degree, inputs.epoch)
            name = model.name if inputs.epoch is None else f"{model.name} at {inputs.epoch}"
            whole = without_normal_field(model.coefficients)
        lowest = inputs.min_degree
        if not 2 <= lowest <= whole.degree:
            raise MapError(
                f"--min-degree {lowest} must lie between 2 and the highest degree, {whole.degree}."
            )
        if lowest > 2:
            if inputs.grid is not None:
                raise MapError(
                    "--min-degree is allowed only with coefficients alone or with coefficients "
                    "and a terrain."
                )
            whole = whole.between(lowest, whole.degree)
        self.parameters |= {"coefficients": name, "degrees": [lowest, whole.degree]}
        self.words.append(f"{name}, spherical harmonics of degree {lowest} to {whole.degree}")
        self.parts.append(HarmonicPart(whole))
        half_wave = math.pi * SEMI_MAJOR_AXIS / whole.degree
        self.extents.append(SourceExtent(EVERYWHERE, EVERYWHERE, -12e3, 0.0, -half_wave))
        return whole

    def _grid(self, inputs: Inputs, path: Path, coefficients: HarmonicCoefficients) -> None:
        self.hashes[path.name] = sha256_of(path, MapError)
        # Harmonics of higher degree leave a residual of shorter waves, which needs less of an edge.
        narrower = min(1.0, _SHIPPED_DEGREE / coefficients.degree)
        margin = narrower * MARGIN_DEG
        area = self._area.widened(margin, margin)
        grid = read_grid(path, inputs.grid_kind, inputs.grid_height_m, area, inputs.voids)
        if inputs.grid_kind == "geoid" and inputs.grid_height_m != 0.0:
            raise MapError("--grid-height is for gravity grids: a geoid refers to the ellipsoid.")
        self.remarks += grid.remarks
        word = f"{inputs.grid_kind} grid {path.name} less the harmonics"
        if grid.is_height_anomaly and inputs.land_correction:
            raise MapError(f"{path} already contains height anomalies: remove --land-correction.")
        if inputs.land_correction:
            sides = grid.latitude_deg[[0, -1]].tolist(), grid.longitude_deg[[0, -1]].tolist()
            around = Area(*sides[0], *sides[1])
            terrain = self._read_terrain(inputs.land_correction, around, inputs.voids)
            values = height_anomaly(grid.values, elevation_at(grid, terrain))
            grid = dataclasses.replace(grid, values=values)
            word += f", land correction with {inputs.land_correction.name}"
        elif inputs.grid_kind == "geoid" and not grid.is_height_anomaly:
            self.remarks.append(
                "the geoid is used as the height anomaly; on land, convert it with "
                "--land-correction"
            )
        self.words.append(word)
        lat, lon = grid.latitude_deg, grid.longitude_deg
        bounds = np.array([lat[0], lat[-1], lon[0], lon[-1]])
        good = bounds + margin * np.array([1.0, -1.0, 1.0, -1.0])
        if not (good[0] < good[1] and good[2] < good[3]):
            raise MapError(
                f"{path} spans {lat[-1] - lat[0]:.3g}° x {lon[-1] - lon[0]:.3g}°; with harmonics "
                f"to degree {coefficients.degree} a margin of {margin:.3g}° is cut off at each "
                "edge and nothing remains: use a larger grid or harmonics of higher degree."
            )
        self.parts.append(ResidualPart(Residual(grid, coefficients, narrower * TAPER_DEG)))
        height = grid.height_m
        step = math.radians(max(grid.latitude_step_deg, grid.longitude_step_deg))
        sources = height - step * SEMI_MAJOR_AXIS
        self.extents.append(SourceExtent(good, good, height, height, sources))
        self.parameters |= {"grid": inputs.grid_kind, "grid_height_m": height}

    def _terrain(
        self, inputs: Inputs, path: Path, coefficients: HarmonicCoefficients | None
    ) -> None:
        from ..gravity.parker import TerrainOptions

        options = TerrainOptions(inputs.density, inputs.water_density, inputs.order)
        terrain = self._read_terrain(path, self._around(self._area), inputs.voids)
        if inputs.geoid_height_m and ELLIPSOIDAL in terrain.name:
            raise MapError(
                f"{path.name} declares that {ELLIPSOIDAL}: remove --geoid-height "
                f"{inputs.geoid_height_m:g}."
            )
        zero_level = self._zero_level(inputs, terrain)
        degree = inputs.terrain_from_degree
        if degree is not None and coefficients is None:
            raise MapError("--terrain-from-degree requires --coefficients or a gravity grid.")
        if coefficients is not None and degree is None:
            if inputs.grid is not None:
                raise MapError(
                    "a gravity grid with a terrain needs --terrain-from-degree: the highest "
                    "degree of the grid."
                )
            degree = coefficients.degree
        if degree is not None and degree < 2:
            raise MapError(f"--terrain-from-degree {degree} must be at least 2.")
        self.parts.append(TerrainPart(terrain, options, degree, zero_level))
        how = "Parker's series" if inputs.drape is None else "prisms and columns"
        word = f"terrain {path.name}, {options.density:g} kg/m³, by {how}"
        if degree is not None:
            word += f", only wavelengths shorter than that of degree {degree}"
        self.words.append(word)
        self.parameters |= {
            "density_kg_m3": options.density,
            "water_density_kg_m3": options.water_density,
            "order": options.order,
            "geoid_height_m": zero_level,
        }
        if degree is not None:
            self.parameters |= {
                "terrain_from_degree": degree,
                "terrain_filter": f"Butterworth, order {FILTER_ORDER}",
            }
        if degree is None:
            self.remarks.append(
                "a map from a terrain alone contains only the attraction of the masses between the "
                "zero level and the ground. Masses below the zero level and the true ground beyond "
                "the edges are missing (--coefficients adds their long wavelengths)"
            )
        self._add_terrain_extent(terrain, inputs, zero_level)

    def layered(self, inputs: Inputs, request: GridRequest, layers_for: LayersFor) -> Inputs:
        """Return inputs with the layers that a function chooses for the base of the ground."""
        (ground,) = (part for part in self.parts if isinstance(part, TerrainPart))
        # The base depends on the spacing of nodes, and that on the lowest layer: twice.
        for _ in range(2):
            nodes, _ = nodes_for(self.extents, request, inputs.drape)
            layers = layers_for(_with_base(ground, nodes), ground.geoid_height_m)
            inputs = dataclasses.replace(inputs, drape=layers)
        return inputs

    def drape(self, inputs: Inputs, nodes: Nodes) -> Nodes:
        """Return nodes with their base; replace the terrain's part by one for draped layers."""
        for index, part in enumerate(self.parts):
            if not isinstance(part, TerrainPart):
                continue
            nodes = _with_base(part, nodes)
            base = nodes.base_m
            assert base is not None
            self._require_above_grids(float(base.min() + nodes.height_m[0]))
            ground, error = drape.DrapedTerrain.of(
                part, nodes, inputs.tolerance_eotvos, inputs.continued
            )
            self.parts[index] = ground
            above = base.ravel() - ground.masses.ground(*drape.points_of(nodes, 0.0)[:, :2].T)
            self.remarks.append(
                f"the layers lie {nodes.height_m[0]:g} to {nodes.height_m[-1]:g} m above a base "
                f"surface. This surface lies at ellipsoidal heights of {base.min():.0f} to "
                f"{base.max():.0f} m, at most {above.max():.0f} m above the ground (on average "
                f"{above.mean():.0f} m)"
            )
            self.remarks.append(
                "terrain columns are modelled as prisms up to a distance of "
                f"{ground.ratio:g} column widths, and as line masses beyond; the error is at most "
                f"{error:.2g} E on the lowest layer"
            )
            self.parameters |= {
                "prisms_to_widths": ground.ratio,
                "columns_error_eotvos": float(f"{error:.3g}"),
                "beyond": "mirror" if inputs.continued else "nothing",
            }
        return nodes

    def _require_above_grids(self, lowest: float) -> None:
        """Raise MapError if the lowest node of a draped map [m] is below a gravity grid."""
        floors = [extent.floor_m for extent in self.extents if not extent.ground]
        floor = max(floors, default=-math.inf)
        if lowest < floor:
            raise MapError(
                f"the lowest node of the draped map lies at {lowest:.0f} m, below the gravity "
                f"grid at {floor:g} m: increase --clearance-from, or exclude low ground."
            )

    def _zero_level(self, inputs: Inputs, terrain: Terrain) -> float:
        """Return the height of a terrain's zero level above the ellipsoid [m], and add a remark."""
        assert inputs.terrain is not None
        if inputs.geoid_height_m is not None or ELLIPSOIDAL in terrain.name:
            return inputs.geoid_height_m or 0.0
        from .geoid import geoid_heights

        sides = terrain.latitudes_deg[[0, -1]], terrain.longitudes_deg[[0, -1]]
        area = self._area.within(*sides)
        assert None not in area
        corners = np.array([(a, b) for a in area[:2] for b in area[2:]], dtype=float)
        undulations = geoid_heights(*corners.T)
        height = round(float(undulations.mean()), 1)
        heights = f"heights of {inputs.terrain.name} are assumed to be"
        lowest, highest = undulations.min(), undulations.max()
        model = f"EGM2008 to degree 120, {lowest:.1f} to {highest:.1f} m at its corners"
        if inputs.drape is not None:
            self.remarks.append(
                f"{heights} above sea level, which lies {height:g} m above the ellipsoid "
                f"({model}). --geoid-height sets another value. Heights of tracks must be above "
                "the ellipsoid"
            )
            return height
        if abs(height) >= _WORTH_SAYING_M:
            self.remarks.append(
                f"{heights} above the ellipsoid, like heights of GNSS receivers. If they are above "
                f"sea level, give --geoid-height {height:g} ({model})"
            )
        return 0.0

    def _add_terrain_extent(self, terrain: Terrain, inputs: Inputs, zero_level: float) -> None:
        n_lat, n_lon = terrain.height_m.shape
        south, west = terrain.south_deg, terrain.west_deg
        spans = terrain.latitude_step_deg * (n_lat - 1), terrain.longitude_step_deg * (n_lon - 1)
        bounds = np.array([south, south + spans[0], west, west + spans[1]])
        inset = _INSET * np.repeat(spans, 2) * np.array([1.0, -1.0, 1.0, -1.0])
        ground = Ground(terrain, zero_level, self._area, inputs.clearance_m)
        self.extents.append(
            SourceExtent(
                bounds,
                bounds + inset,
                ground.floor_m(),
                ground.lowest_m(),
                ground.highest_m,
                str(ground),
            )
        )
        self.ground = ground

    @staticmethod
    def _around(area: Area) -> Area | None:
        """Return an area with a margin of terrain for accurate edges; None without bounds."""
        if area == Area():
            return None
        share = _INSET / (1.0 - 2.0 * _INSET)
        middle = Area() if area.west is None else area.about(area.west)
        return area.widened(
            *(
                0.0 if low is None or high is None else share * max(0.0, high - low)
                for low, high in (area[:2], middle[2:])
            )
        )

    def _read_terrain(self, path: Path, area: Area | None, voids: tuple[float, ...]) -> Terrain:
        from ..gravity.terrain_files import read_terrain

        self.hashes[path.name] = sha256_of(path, MapError)
        terrain = read_terrain(path, area, voids)
        if "," in terrain.name.removeprefix(path.name):  # voids, units, a projection
            self.remarks.append(f"read {terrain.name}")
        return terrain


class LayersWithRms:
    """Iterator over the layers of a map that also stores the RMS of each layer's components."""

    def __init__(self, layers: Iterator[Layer]) -> None:
        self._layers = layers
        self.rms: list[Array] = []

    def __iter__(self) -> Iterator[Layer]:
        for tensor, disturbance in self._layers:
            rms = [
                math.sqrt(np.einsum("ij,ij->", plane, plane, dtype=float) / plane.size)
                for values, count in ((tensor, len(TENSOR)), (disturbance, len(VECTOR)))
                for plane in (values[..., index] for index in range(count))
            ]
            self.rms.append(np.array(rms))
            yield tensor, disturbance
