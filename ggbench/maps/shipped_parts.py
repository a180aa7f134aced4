"""Map parts from shipped data.

Each kind of part is a class in :data:`KINDS`. Its attributes are the keys of a part in
``shipped.toml``. Its method ``part`` returns a :class:`.parts.Part`. Maps of users' data consist of
such parts, too.
"""

from __future__ import annotations

import dataclasses
import math
from functools import lru_cache
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from ..gravity.harmonics import HarmonicCoefficients, without_normal_field
from ..gravity.remove_restore import (
    MARGIN_DEG,
    GravityGrid,
    Residual,
    height_anomaly,
    linear_weights,
)
from ..gravity.terrain import Terrain
from .equivalent_sources import EquivalentSources, Plane
from .netcdf import Errors
from .nodes import EVERYWHERE, SourceExtent
from .package_data import damaged, data_arrays
from .parts import HarmonicPart, Part, ResidualPart, TerrainPart

Array = NDArray[np.float64]

COEFFICIENTS = "egm2008_degree120.npz"
_GEOID_KEYS = ("lat0", "lon0", "step", "N_1e4m")
_TERRAIN_KEYS = ("south_deg", "west_deg", "latitude_step_deg", "longitude_step_deg", "height_m")
MASS_KEYS = (
    "plane",
    "places",
    "masses",
    "standard_error",
    "error_distance",
    "bounds",
    "depth_m",
)
"""Arrays of a file of point masses.

``plane`` is latitude and longitude of the plane's point [deg]. ``places`` and ``masses`` are those
of :class:`EquivalentSources`. ``standard_error`` and ``error_distance`` are those of
:class:`ggbench.gravity.gradient_map.GradientMap`. ``bounds`` are south, north, west and east of
the lines [deg]. ``depth_m`` is the depth below the flights [m].
"""
_LINES_MARGIN_DEG = 0.05  # around lines: there a map is continued by the masses at their edge
_LEAST_CLEARANCE = 0.25  # of the depth of the masses: below, each of them is seen


@dataclasses.dataclass(frozen=True)
class PartOptions:
    """Options of a recipe that change the parts of its source.

    Attributes
    ----------
    land_correction : whether to convert a geoid to the height anomaly with the topography.
    relief_smoothing_deg : standard deviation, in latitude and in longitude, of a Gaussian that
        smooths a topography or terrain before it is used; 0: none.
    density_kg_m3 : density of the ground of a terrain.
    """

    land_correction: bool = True
    relief_smoothing_deg: float = 0.0
    density_kg_m3: float = 2670.0

    @property
    def relief(self) -> str:
        """Description of the smoothing of topography or terrain."""
        if self.relief_smoothing_deg > 0.0:
            return f"relief smoothed by {self.relief_smoothing_deg} deg"
        return "relief not smoothed"


@dataclasses.dataclass(frozen=True)
class SpacingRule:
    """Largest distances between the nodes of a map, as fractions of heights.

    Attributes
    ----------
    share : largest horizontal distance, as a fraction of the height of the third layer above
        ``ground_m``.
    vertical_share : largest vertical distance, as a fraction of the height of the lowest layer
        above ``vertical_ground_m``.
    ground_m, vertical_ground_m : reference levels of these heights [m].
    words, vertical_words : horizontal and vertical limit in words, for the end of a message.
    """

    share: float
    vertical_share: float
    ground_m: float
    vertical_ground_m: float
    words: str
    vertical_words: str


class ShippedPart(Protocol):
    """Declaration of one part of a shipped source."""

    options: ClassVar[frozenset[str]]
    """Names of the fields of :class:`PartOptions` that affect this kind of part."""

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the data files of the part."""
        ...

    def part(self, options: PartOptions) -> Part:
        """Load the data and return the part.

        Raises MapError if data are missing or damaged.
        """
        ...

    def extent(self) -> SourceExtent:
        """Return the region in which the part is valid.

        Raises MapError if data are missing or damaged.
        """
        ...

    def spacing(self) -> SpacingRule | None:
        """Return the limits of the node spacing; None if another part sets them."""
        ...

    def errors(self) -> Errors | None:
        """Return standard errors and correlation distances of a map that has only this part.

        Return None if they are unknown.
        """
        ...

    def note(self, options: PartOptions) -> str:
        """Return a text on the effect of the options on the part; "" if there is none."""
        ...


@dataclasses.dataclass(frozen=True)
class ShippedHarmonics:
    """Spherical harmonics of a shipped model, summed at every node."""

    options: ClassVar[frozenset[str]] = frozenset()
    file: str

    @property
    def files(self) -> tuple[str, ...]:
        """Name of the file of the coefficients."""
        return (self.file,)

    def part(self, options: PartOptions) -> Part:
        """Return the part, without interpolation between nodes."""
        return HarmonicPart(disturbing_coefficients(self.file), nodes_per_half_wave=math.inf)

    def extent(self) -> SourceExtent:
        """Return the whole Earth as the valid region."""
        return SourceExtent(EVERYWHERE, EVERYWHERE, -math.inf, -math.inf, -math.inf)

    def spacing(self) -> None:
        """Return None: a residual part has shorter wavelengths and sets the limits."""

    def errors(self) -> None:
        """Return None: the standard errors are unknown."""

    def note(self, options: PartOptions) -> str:
        """Return an empty text: no option has an effect."""
        return ""


@dataclasses.dataclass(frozen=True)
class ShippedGeoid:
    """Shipped geoid minus harmonics, with a topography for the land correction.

    Attributes
    ----------
    file, coefficients, topography : names of the data files.
    lowest_m : lowest height above the ellipsoid for which the resolution of the data is adequate
        [m].
    source_depth_m : depth below the ellipsoid [m] of masses whose field would be as smooth as the
        data: zero for land; at sea, half the shortest wavelength of the data.
    """

    SHARE: ClassVar[float] = 0.25
    options: ClassVar[frozenset[str]] = frozenset({"land_correction", "relief_smoothing_deg"})
    file: str
    coefficients: str
    topography: str
    lowest_m: float
    source_depth_m: float = 0.0

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the files of the geoid, the topography and the coefficients."""
        return self.file, self.topography, self.coefficients

    def part(self, options: PartOptions) -> Part:
        """Return the residual field of the geoid, without the harmonics."""
        geoid = self.grid()
        if options.land_correction:
            elevation = self.elevation(geoid, options.relief_smoothing_deg)
            geoid = dataclasses.replace(geoid, values=height_anomaly(geoid.values, elevation))
        return ResidualPart(Residual(geoid, disturbing_coefficients(self.coefficients)))

    def extent(self) -> SourceExtent:
        """Return the area of the geoid without its edges."""
        geoid = self.grid()
        lat, lon = geoid.latitude_deg, geoid.longitude_deg
        bounds = np.array(
            [lat[0] + MARGIN_DEG, lat[-1] - MARGIN_DEG, lon[0] + MARGIN_DEG, lon[-1] - MARGIN_DEG]
        )
        return SourceExtent(bounds, bounds, self.lowest_m, self.lowest_m, -self.source_depth_m)

    def spacing(self) -> SpacingRule:
        """Return the limits of the node spacing: a quarter of the height above the masses.

        Spline errors are then at most 1e-3 E. For the vertical limit the height counts from half
        the depth of the masses. This limit is stricter, because the error is largest in the lowest
        layer, where the spline ends.
        """
        words = vertical_words = "a quarter of the height"
        if self.source_depth_m > 0.0:
            words += f" above sources at a depth of {self.source_depth_m:g} m"
            vertical_words += f" above half the sources' depth of {self.source_depth_m:g} m"
        return SpacingRule(
            share=self.SHARE,
            vertical_share=self.SHARE,
            ground_m=0.0 - self.source_depth_m,
            vertical_ground_m=0.0 - 0.5 * self.source_depth_m,
            words=words,
            vertical_words=vertical_words,
        )

    def errors(self) -> None:
        """Return None: the standard errors are unknown."""

    def note(self, options: PartOptions) -> str:
        """Return a text on the correction that converts the geoid to the height anomaly."""
        if not options.land_correction:
            return "without land correction"
        return f"with land correction, {options.relief}"

    def grid(self) -> GravityGrid:
        """Return the geoid as a grid."""
        grid = data_arrays(self.file, _GEOID_KEYS)
        step = float(grid["step"])
        values = 1e-4 * grid["N_1e4m"]
        return GravityGrid("geoid", float(grid["lat0"]), float(grid["lon0"]), step, step, values)

    def elevation(self, geoid: GravityGrid, smoothing_deg: float) -> Array:
        """Return the land heights (n_lat, n_lon) [m] at the nodes of the geoid; 0 at sea."""
        topography = data_arrays(self.topography, ("lat", "lon", "z"))
        land = np.maximum(topography["z"], 0.0)
        if smoothing_deg > 0.0:
            steps = [float(np.diff(topography[axis]).mean()) for axis in ("lat", "lon")]
            from scipy.ndimage import gaussian_filter  # not at the top: few reliefs are smoothed

            land = gaussian_filter(land, [smoothing_deg / step for step in steps])
        at_rows = linear_weights(topography["lat"], geoid.latitude_deg)
        at_columns = linear_weights(topography["lon"], geoid.longitude_deg)
        elevation: Array = at_rows @ land @ at_columns.T
        return elevation


@dataclasses.dataclass(frozen=True)
class ShippedTerrain:
    """Masses of a shipped terrain; the field is computed by Parker's series.

    Attributes
    ----------
    file : name of the data file.
    clearance_m : smallest height of a map above the highest ground [m]. At lower heights Parker's
        series has too many terms. A terrain with a larger range of heights needs a larger value.
    """

    SHARE: ClassVar[float] = 0.6  # 0.01 E rms at a tenth of a kilometre above the highest ground
    options: ClassVar[frozenset[str]] = frozenset({"relief_smoothing_deg", "density_kg_m3"})
    file: str
    clearance_m: float = 50.0

    @property
    def files(self) -> tuple[str, ...]:
        """Name of the file of the heights."""
        return (self.file,)

    def part(self, options: PartOptions) -> Part:
        """Return the field of the terrain's masses in double precision."""
        from ..gravity.parker import TerrainOptions  # compiled, which a map in the cache needs not

        terrain = self.terrain()
        if options.relief_smoothing_deg > 0.0:
            from scipy.ndimage import gaussian_filter

            steps = (terrain.latitude_step_deg, terrain.longitude_step_deg)
            sigma = [options.relief_smoothing_deg / step for step in steps]
            smooth = gaussian_filter(terrain.height_m.astype(float), sigma, mode="nearest")
            terrain = dataclasses.replace(terrain, height_m=smooth)
        density = TerrainOptions(density=options.density_kg_m3)
        return TerrainPart(terrain, density, dtype="float64")

    def extent(self) -> SourceExtent:
        """Return the area of the terrain; the lowest height is ``clearance_m`` above the summit."""
        terrain = self.terrain()
        sides = (terrain.latitudes_deg, terrain.longitudes_deg)
        bounds = np.array([limit for side in sides for limit in (side[0], side[-1])])
        highest = float(terrain.height_m.max())
        lowest = float(math.ceil(highest + self.clearance_m))
        return SourceExtent(bounds, bounds, lowest, lowest, highest)

    def spacing(self) -> SpacingRule:
        """Return the largest node spacings, relative to the height above the highest ground."""
        highest = float(self.terrain().height_m.max())
        words = f"the height above the highest ground (at {highest:g} m)"
        return SpacingRule(
            share=self.SHARE,
            vertical_share=1.0,
            ground_m=highest,
            vertical_ground_m=highest,
            words=f"{self.SHARE:g} of {words}",
            vertical_words=words,
        )

    def errors(self) -> None:
        """Return None: the standard errors are unknown."""

    def note(self, options: PartOptions) -> str:
        """Return a text on the density and the smoothing of the terrain."""
        return f"{options.density_kg_m3:g} kg/m³, {options.relief}"

    def terrain(self) -> Terrain:
        """Load and return the terrain.

        Raises MapError if the file is missing or damaged.
        """
        return shipped_terrain(self.file)


@dataclasses.dataclass(frozen=True)
class ShippedMasses:
    """Point masses that were fitted to the lines of a survey.

    ``studies/measured_surveys`` makes the fit with the method of ``ggbench map build --lines``.
    """

    SHARE: ClassVar[float] = 0.35  # 0.1 E rms
    options: ClassVar[frozenset[str]] = frozenset()
    file: str

    @property
    def files(self) -> tuple[str, ...]:
        """Name of the file of the masses."""
        return (self.file,)

    def part(self, options: PartOptions) -> EquivalentSources:
        """Load and return the point masses."""
        stored = _masses(self.file)
        plane = Plane(*map(float, stored["plane"]))
        return EquivalentSources(plane, stored["places"], stored["masses"])

    def extent(self) -> SourceExtent:
        """Return the area of the survey lines plus a margin, at heights above the masses."""
        stored = _masses(self.file)
        bounds = stored["bounds"] + _LINES_MARGIN_DEG * np.array([-1.0, 1.0, -1.0, 1.0])
        highest = self._highest_m
        lowest = float(np.ceil(highest + _LEAST_CLEARANCE * float(stored["depth_m"])))
        return SourceExtent(bounds, bounds, lowest, lowest, highest)

    def spacing(self) -> SpacingRule:
        """Return the largest node spacing, relative to the height above the highest point mass."""
        highest = self._highest_m
        words = f"{self.SHARE:g} of the height above the highest point mass (at {highest:.0f} m)"
        return SpacingRule(
            share=self.SHARE,
            vertical_share=self.SHARE,
            ground_m=highest,
            vertical_ground_m=highest,
            words=words,
            vertical_words=words,
        )

    def errors(self) -> Errors:
        """Return standard errors (9,) and correlation distances (9,) [m] of the nine components."""
        stored = _masses(self.file)
        return stored["standard_error"], stored["error_distance"]

    def note(self, options: PartOptions) -> str:
        """Return an empty text: no option has an effect."""
        return ""

    @property
    def _highest_m(self) -> float:
        return float(_masses(self.file)["places"][2].max())


KINDS: dict[str, type] = {
    "harmonics": ShippedHarmonics,
    "geoid": ShippedGeoid,
    "terrain": ShippedTerrain,
    "point-masses": ShippedMasses,
}
"""Kinds of parts by their name in ``shipped.toml``."""


def disturbing_coefficients(name: str) -> HarmonicCoefficients:
    """Return the coefficients of a data file, minus those of the normal field."""
    data = data_arrays(name, ("cs", "gm", "r"))
    size = math.isqrt(2 * len(data["cs"]))
    cosine, sine = np.zeros((2, size, size))
    cosine[np.tril_indices(size)], sine[np.tril_indices(size)] = data["cs"].T
    return without_normal_field(
        HarmonicCoefficients(float(data["gm"]), float(data["r"]), cosine, sine)
    )


@lru_cache(maxsize=4)
def shipped_terrain(file: str) -> Terrain:
    """Return the terrain stored in a data file of the package.

    Raises
    ------
    GGBenchError
        If the file is missing, damaged or contains no terrain.
    """
    arrays = data_arrays(file, _TERRAIN_KEYS)
    try:
        south, west, latitude_step, longitude_step = (
            float(arrays[key]) for key in _TERRAIN_KEYS[:4]
        )
        heights = arrays["height_m"].astype(float)
        return Terrain(south, west, latitude_step, longitude_step, heights, file)
    except Exception as error:
        raise damaged(file, _TERRAIN_KEYS, error) from error


@lru_cache(maxsize=4)
def _masses(file: str) -> dict[str, Any]:
    arrays = data_arrays(file, MASS_KEYS)
    try:
        return {key: value.astype(float) for key, value in arrays.items()}
    except Exception as error:
        raise damaged(file, MASS_KEYS, error) from error
