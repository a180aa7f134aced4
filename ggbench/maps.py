"""Gravity-gradient maps: the disturbing field on a grid, made from real data and kept in a cache.

A map is made by remove, compute and restore (Hofmann-Wellenhof and Moritz 2006, ch. 8):

1. the geoid of the source becomes the disturbing potential at the ellipsoid by Bruns' formula;
2. the synthesis of the harmonic coefficients of low degree is removed;
3. the residual is continued upwards as a Fourier series in latitude and longitude;
4. the coefficients of low degree are restored exactly at altitude.

The normal field is no part of a map: :mod:`ggbench.earth` has it exactly. Tensor components are
ordered [EE, EN, EU, NN, NU, UU], x = east, y = north, z = up.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import importlib.resources
import io
import json
import math
import os
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter

from .earth import EOTVOS, SEMI_MAJOR_AXIS, normal_gravity, radii_of_curvature
from .errors import GGBenchError
from .spherical_harmonics import (
    HarmonicCoefficients,
    gravity_and_gradient,
    potential,
    without_normal_field,
)

Array = NDArray[np.float64]

CACHE_VARIABLE = "GGBENCH_CACHE_DIR"
"""Environment variable that names another cache folder than the user's."""

_BUILDING_MODULES = ("earth.py", "maps.py", "spherical_harmonics.py")
_TAPER_DEG = 1.0  # the residual fades to zero over this width along the edges of its grid
_MARGIN_DEG = 1.5  # a map keeps this distance from them: the taper and five heights of 10 km
_BAND_DEG = 0.5  # one flat-Earth wavenumber grid per band of latitude
_SPACING_PER_HEIGHT = 0.25
_FEWEST_NODES = 4  # per axis, what a cubic spline needs
_MOST_NODES = 5_000_000  # in all: about half a gigabyte
_MARGIN_NODES = 2  # lowest layers, which serve as the margin of an interpolation in height
# The geoid of land lies inside the masses; the potential that continues the outer field down to the
# ellipsoid exceeds it by 2 pi G rho H². In height anomaly, for 2670 kg/m³: this times H² [1/m].
_GEOID_TO_HEIGHT_ANOMALY = 1.142e-7
# The relief comes as point samples, whose squares carry aliased ruggedness. This Gaussian passes
# 0.7 of degree 800 and 0.3 of degree 1400; a regression of the geoid on the relief and its square
# finds 0.3 to 0.6 of the sampled square real there. The width was picked by a reference profile
# at 10 km (see tests/test_maps.py) from a range that the regression leaves open.
_RELIEF_SMOOTHING_DEG = 0.06


class MapError(GGBenchError):
    """A gradient map cannot be made as asked, or its data cannot be read."""


@dataclass(frozen=True)
class _Source:
    """Data files of a region, and the heights for which their resolution is adequate."""

    geoid: str
    topography: str
    coefficients: str
    lowest_height_m: float
    highest_height_m: float
    provenance: str


SOURCES = {
    "egm2008_qinling": _Source(
        geoid="egm2008_geoid_2.5min_qinling.npz",
        topography="etopo1_6min_qinling.npz",
        coefficients="egm2008_degree120.npz",
        lowest_height_m=3000.0,
        highest_height_m=30000.0,
        provenance="EGM2008 geoid (NGA) at 2.5 arc minutes and coefficients to degree 120, "
        "ETOPO1 topography (NOAA)",
    )
}
"""The regions for which the package carries data, by the name that a recipe uses."""


@dataclass(frozen=True)
class GradientMap:
    """The disturbing field on a grid regular in geodetic latitude, longitude and height.

    Attributes
    ----------
    latitude0, longitude0, height0 : the first node [rad, rad, m].
    latitude_step, longitude_step, height_step : distances between nodes [rad, rad, m].
    tensor : gradient tensor without the normal field, (n_lat, n_lon, n_h, 6) [E], ENU.
    gravity_disturbance : gravity vector without the normal field, (n_lat, n_lon, n_h, 3) [m/s²],
        ENU; its gradient is the tensor.
    provenance : where the map comes from, in words.
    """

    latitude0: float
    longitude0: float
    height0: float
    latitude_step: float
    longitude_step: float
    height_step: float
    tensor: Array
    gravity_disturbance: Array
    provenance: str


@dataclass(frozen=True)
class MapRecipe:
    """What map to make: the same recipe always gives the same map.

    Nodes start at the south-western, lowest corner; the last ones lie on the other bounds, or
    beyond them by less than one spacing.

    Attributes
    ----------
    source : a key of :data:`SOURCES`.
    south_deg, north_deg, west_deg, east_deg : bounds [deg].
    min_height_m, max_height_m : bounds [m above the ellipsoid].
    spacing_arcmin : in latitude and in longitude. At most a quarter of the height above the
        sources, that is above the ellipsoid, in all but the two lowest layers of nodes; the error
        of a cubic spline is then below 1e-3 E.
    height_spacing_m : at most a quarter of the lowest height.
    land_correction : whether to turn the geoid into the height anomaly with the topography.
    """

    source: str
    south_deg: float
    north_deg: float
    west_deg: float
    east_deg: float
    min_height_m: float
    max_height_m: float
    spacing_arcmin: float = 1.25
    height_spacing_m: float = 500.0
    land_correction: bool = True


def load_or_build(recipe: MapRecipe) -> GradientMap:
    """Return the map of a recipe from the cache, or build it and put it there.

    The cache is a folder of files named by a hash of the recipe, the data and the code that
    builds, so it never goes stale. A damaged file is replaced; a folder that cannot be written
    costs only time. :data:`CACHE_VARIABLE` moves it.

    Raises MapError as :func:`build` does.
    """
    _check(recipe)
    folder = os.environ.get(CACHE_VARIABLE) or platformdirs.user_cache_path("ggbench")
    path = Path(folder) / "maps" / f"{_cache_key(recipe)}.npz"
    gradient_map = _read(path)
    if gradient_map is None:
        gradient_map = build(recipe)
        # Without a copy on disk the map itself is as good.
        with contextlib.suppress(OSError):
            _write(path, gradient_map)
    return gradient_map


def build(recipe: MapRecipe) -> GradientMap:
    """Make the map of a recipe.

    Raises
    ------
    MapError : unknown source; bounds in the wrong order or outside the source; a spacing too wide
        for the height; a data file missing or damaged.
    """
    _check(recipe)
    step = math.radians(recipe.spacing_arcmin / 60.0)
    south, west = math.radians(recipe.south_deg), math.radians(recipe.west_deg)
    n_lat, n_lon, n_h = _node_counts(recipe)
    tensor, gravity_disturbance = disturbing_field(
        recipe.source,
        south + step * np.arange(n_lat),
        west + step * np.arange(n_lon),
        recipe.min_height_m + recipe.height_spacing_m * np.arange(n_h),
        recipe.land_correction,
    )
    correction = (
        f"with land correction, relief smoothed by {_RELIEF_SMOOTHING_DEG} deg"
        if recipe.land_correction
        else "without land correction"
    )
    return GradientMap(
        latitude0=south,
        longitude0=west,
        height0=float(recipe.min_height_m),
        latitude_step=step,
        longitude_step=step,
        height_step=float(recipe.height_spacing_m),
        tensor=tensor,
        gravity_disturbance=gravity_disturbance,
        provenance=f"{SOURCES[recipe.source].provenance}; {correction}",
    )


def disturbing_field(
    source: str,
    latitude: ArrayLike,
    longitude: ArrayLike,
    height: ArrayLike,
    land_correction: bool = True,
) -> tuple[Array, Array]:
    """The disturbing field of a source, free of interpolation, on latitude x longitude x height.

    Parameters
    ----------
    source : a key of :data:`SOURCES`.
    latitude, longitude : any positions inside the source, shapes (n_lat,), (n_lon,) [rad].
    height : above the ellipsoid, shape (n_h,) [m].
    land_correction : as in :class:`MapRecipe`.

    Returns
    -------
    The tensor, (n_lat, n_lon, n_h, 6) [E], and the gravity disturbance, (n_lat, n_lon, n_h, 3)
    [m/s²], both in geodetic ENU axes.

    Raises MapError for an unknown source and a data file that is missing or damaged.
    """
    files = _source(source)
    lat, lon, h = (np.asarray(axis, dtype=float) for axis in (latitude, longitude, height))
    coefficients = _disturbing_coefficients(files)
    residual = _Residual(files, coefficients, land_correction)

    gravity_disturbance, tensor = gravity_and_gradient(coefficients, lat, lon, h)
    band = math.radians(_BAND_DEG)
    first, last = math.floor(lat.min() / band), math.floor(lat.max() / band) + 1
    centres = band * np.arange(first, last + 1)
    for centre, weight in zip(centres, _linear_weights(centres, lat).T, strict=True):
        rows = np.flatnonzero(weight)
        if rows.size:
            vector, gradient = residual.field(lat[rows], lon, h, centre)
            blend = weight[rows, np.newaxis, np.newaxis, np.newaxis]
            gravity_disturbance[rows] += blend * vector
            tensor[rows] += blend * gradient
    return tensor, gravity_disturbance


class _Residual:
    """The disturbing potential at the ellipsoid beyond the coefficients, as a Fourier series."""

    def __init__(
        self, files: _Source, coefficients: HarmonicCoefficients, land_correction: bool
    ) -> None:
        grid = _load(files.geoid, ("lat0", "lon0", "step", "N_1e4m"))
        height_anomaly = 1e-4 * grid["N_1e4m"]
        lat_deg, lon_deg = (
            float(grid[corner]) + float(grid["step"]) * np.arange(count)
            for corner, count in zip(("lat0", "lon0"), height_anomaly.shape, strict=True)
        )
        if land_correction:
            topography = _load(files.topography, ("lat", "lon", "z"))
            smoothing = _RELIEF_SMOOTHING_DEG / np.diff(topography["lat"]).mean()
            land = gaussian_filter(np.maximum(topography["z"], 0.0), smoothing)
            at_rows = _linear_weights(topography["lat"], lat_deg)
            at_columns = _linear_weights(topography["lon"], lon_deg)
            elevation = at_rows @ land @ at_columns.T
            height_anomaly = height_anomaly + _GEOID_TO_HEIGHT_ANOMALY * elevation**2

        lat, lon = np.radians(lat_deg), np.radians(lon_deg)
        gamma = np.array([normal_gravity(angle, 0.0)[0] for angle in lat])
        residual = gamma[:, np.newaxis] * height_anomaly  # Bruns
        residual -= potential(coefficients, lat, lon, np.zeros(1))[:, :, 0]
        # With the mean goes the zero-degree term of the geoid, and any offset of its datum.
        residual -= residual.mean()
        residual *= np.outer(_taper(lat_deg), _taper(lon_deg))

        step = math.radians(float(grid["step"]))
        # A real field of odd dimensions (a grid with both its ends) has no Nyquist term.
        self._series = np.fft.rfft2(residual) / residual.size
        self._series[:, 1:] *= 2.0
        self._wavenumber_lat = 2.0 * np.pi * np.fft.fftfreq(len(lat), step)  # [1/rad]
        self._wavenumber_lon = 2.0 * np.pi * np.fft.rfftfreq(len(lon), step)
        self._south, self._west = lat[0], lon[0]

    def field(
        self, latitude: Array, longitude: Array, height: Array, centre: float
    ) -> tuple[Array, Array]:
        """Gravity vector and gradient tensor, with the convergence of one latitude ``centre``.

        The horizontal Laplacian of a wave on the sphere of radius R is -n(n+1)/R²; that gives
        its degree n, not a whole number, and with it the continuation (R/(R+h))^(n+1), the
        vertical derivative -(n+1)/(R+h), and so all derivatives. For n -> infinity this is the
        flat Earth's exp(-kh), whose tensor is one or two per cent off at degree 120.
        Second derivatives are covariant: in axes that turn with the position, gravity itself
        enters the tensor (Hofmann-Wellenhof and Moritz 2006).
        """
        meridian, prime_vertical = radii_of_curvature(centre)
        radius = math.sqrt(meridian * prime_vertical)
        eigenvalue = (self._wavenumber_lat[:, np.newaxis] / meridian) ** 2 + (
            self._wavenumber_lon / (prime_vertical * math.cos(centre))
        ) ** 2
        degree = np.sqrt(0.25 + radius**2 * eigenvalue) - 0.5

        i_k = 1j * self._wavenumber_lat
        wave_lat = np.exp(np.outer(latitude - self._south, i_k))
        waves_lat = np.concatenate((wave_lat, wave_lat * i_k, wave_lat * i_k**2))
        i_k = 1j * self._wavenumber_lon
        wave_lon = np.exp(np.outer(longitude - self._west, i_k))
        waves_lon = np.concatenate((wave_lon, wave_lon * i_k, wave_lon * i_k**2)).T

        shape = (latitude.size, longitude.size, height.size)
        vector, tensor = np.empty((*shape, 3)), np.empty((*shape, 6))
        cosine, tangent = np.cos(latitude)[:, np.newaxis], np.tan(latitude)[:, np.newaxis]
        radii_north, radii_east = np.array([radii_of_curvature(a) for a in latitude]).T[..., None]
        for index, h in enumerate(height):
            r = radius + h
            continued = self._series * (radius / r) ** (degree + 1.0)
            # d[i, j]: i-th derivative in latitude, j-th in longitude.
            d, d_up = (
                (waves_lat @ series @ waves_lon)
                .real.reshape(3, latitude.size, 3, longitude.size)
                .swapaxes(1, 2)
                for series in (continued, continued * (-(degree + 1.0) / r))
            )
            r_north, r_east = radii_north + h, radii_east + h
            per_lon = r_east * cosine  # metres per radian of longitude
            east, north, up = d[0, 1] / per_lon, d[1, 0] / r_north, d_up[0, 0]
            ee = d[0, 2] / per_lon**2 + (up - tangent * north) / r_east
            en = d[1, 1] / (per_lon * r_north) + tangent * east / r_east
            eu = d_up[0, 1] / per_lon - east / r_east
            nn = d[2, 0] / r_north**2 + up / r_north
            nu = d_up[1, 0] / r_north - north / r_north
            vector[:, :, index] = np.stack((east, north, up), axis=-1)
            tensor[:, :, index] = np.stack((ee, en, eu, nn, nu, -ee - nn), axis=-1) / EOTVOS
        return vector, tensor


def _disturbing_coefficients(files: _Source) -> HarmonicCoefficients:
    data = _load(files.coefficients, ("cs", "gm", "r"))
    size = math.isqrt(2 * len(data["cs"]))
    cosine, sine = np.zeros((2, size, size))
    cosine[np.tril_indices(size)], sine[np.tril_indices(size)] = data["cs"].T
    return without_normal_field(
        HarmonicCoefficients(float(data["gm"]), float(data["r"]), cosine, sine)
    )


def _linear_weights(nodes: Array, points: Array) -> Array:
    """Matrix (n_points, n_nodes) of linear interpolation between ascending nodes."""
    nodes = np.asarray(nodes, dtype=float)
    left = np.clip(np.searchsorted(nodes, points, side="right") - 1, 0, nodes.size - 2)
    fraction = (points - nodes[left]) / (nodes[left + 1] - nodes[left])
    weights = np.zeros((points.size, nodes.size))
    rows = np.arange(points.size)
    weights[rows, left] = 1.0 - fraction
    weights[rows, left + 1] = fraction
    return weights


def _taper(degrees: Array) -> Array:
    """Cosine taper: zero at both ends of an axis, one from _TAPER_DEG inwards."""
    inwards = np.minimum(degrees - degrees[0], degrees[-1] - degrees)
    return np.sin(0.5 * np.pi * np.clip(inwards / _TAPER_DEG, 0.0, 1.0)) ** 2


def _source(name: str) -> _Source:
    if name not in SOURCES:
        raise MapError(f"Unknown map source {name!r}; allowed: {', '.join(sorted(SOURCES))}.")
    return SOURCES[name]


def _check(recipe: MapRecipe) -> None:
    """Raise MapError if the recipe cannot be followed. Comparisons are such that NaN fails."""
    files = _source(recipe.source)
    for name in ("spacing_arcmin", "height_spacing_m"):
        if not 0.0 < getattr(recipe, name) < math.inf:
            raise MapError(f"{name} = {getattr(recipe, name)} must be positive and finite.")

    grid = _load(files.geoid, ("lat0", "lon0", "step", "N_1e4m"))
    rows, columns = grid["N_1e4m"].shape
    extents = (
        ("south_deg", "north_deg", float(grid["lat0"]), rows),
        ("west_deg", "east_deg", float(grid["lon0"]), columns),
    )
    limits = [
        (low, high, first + _MARGIN_DEG, first + (n - 1) * float(grid["step"]) - _MARGIN_DEG)
        for low, high, first, n in extents
    ]
    limits.append(("min_height_m", "max_height_m", files.lowest_height_m, files.highest_height_m))
    for low, high, least, most in limits:
        lower, upper = getattr(recipe, low), getattr(recipe, high)
        if not lower < upper:
            raise MapError(f"{low} = {lower} must be less than {high} = {upper}.")
        for name, value in ((low, lower), (high, upper)):
            if not least <= value <= most:
                raise MapError(
                    f"{name} = {value} lies outside what source {recipe.source!r} can give: "
                    f"{least:g} to {most:g} is allowed."
                )

    if recipe.height_spacing_m > _SPACING_PER_HEIGHT * recipe.min_height_m:
        raise MapError(
            f"height_spacing_m = {recipe.height_spacing_m} is too wide for min_height_m = "
            f"{recipe.min_height_m}: at most {_SPACING_PER_HEIGHT * recipe.min_height_m:g} "
            "is allowed, a quarter of that height."
        )
    height = recipe.min_height_m + _MARGIN_NODES * recipe.height_spacing_m
    widest = math.degrees(_SPACING_PER_HEIGHT * height / SEMI_MAJOR_AXIS) * 60.0
    if recipe.spacing_arcmin > widest:
        raise MapError(
            f"spacing_arcmin = {recipe.spacing_arcmin} is too wide for a map that serves heights "
            f"from {height:g} m: at most {widest:.3g} is allowed, a quarter of that height."
        )
    counts = _node_counts(recipe)
    if min(counts) < _FEWEST_NODES or math.prod(counts) > _MOST_NODES:
        raise MapError(
            f"Bounds and spacings give {counts} nodes in latitude, longitude and height: at least "
            f"{_FEWEST_NODES} in each and at most {_MOST_NODES} in all are allowed."
        )


def _node_counts(recipe: MapRecipe) -> tuple[int, int, int]:
    step_deg = recipe.spacing_arcmin / 60.0
    cells = (
        (recipe.north_deg - recipe.south_deg) / step_deg,
        (recipe.east_deg - recipe.west_deg) / step_deg,
        (recipe.max_height_m - recipe.min_height_m) / recipe.height_spacing_m,
    )
    # A bound that rounding puts a hair beyond a node needs no further node.
    n_lat, n_lon, n_h = (math.ceil(count - 1e-6) + 1 for count in cells)
    return n_lat, n_lon, n_h


def _data_bytes(name: str) -> bytes:
    try:
        return (importlib.resources.files("ggbench.scenarios") / "data" / name).read_bytes()
    except (OSError, ModuleNotFoundError) as error:
        raise MapError(
            f"Data file {name} cannot be read ({error}); it belongs into the folder data of "
            "ggbench.scenarios, where an installation puts it."
        ) from error


def _arrays(content: bytes, keys: Iterable[str]) -> dict[str, Any]:
    """Arrays of a NumPy archive; damage makes NumPy, zipfile and zlib raise a dozen kinds."""
    with np.load(io.BytesIO(content), allow_pickle=False) as data:
        return {key: data[key] for key in keys}


def _load(name: str, keys: tuple[str, ...]) -> dict[str, Any]:
    """Arrays of a data file of the package."""
    content = _data_bytes(name)
    try:
        return _arrays(content, keys)
    except Exception as error:
        raise MapError(
            f"Data file {name} of ggbench.scenarios is damaged ({error}); it must be a NumPy "
            f"archive with the arrays {', '.join(keys)}: install the package again."
        ) from error


def _cache_key(recipe: MapRecipe) -> str:
    """Hash of all that determines the map: recipe, data, code."""
    values = [v if isinstance(v, str) else float(v) for v in dataclasses.astuple(recipe)]
    digest = hashlib.sha256(json.dumps(values).encode())
    files = SOURCES[recipe.source]
    for name in (files.geoid, files.topography, files.coefficients):
        digest.update(hashlib.sha256(_data_bytes(name)).digest())
    for name in _BUILDING_MODULES:
        source = (importlib.resources.files("ggbench") / name).read_bytes()
        digest.update(hashlib.sha256(source).digest())
    return digest.hexdigest()[:32]


def _read(path: Path) -> GradientMap | None:
    """The map in a cache file, or None if there is none or it is damaged."""
    try:
        arrays = _arrays(path.read_bytes(), [f.name for f in dataclasses.fields(GradientMap)])
        return GradientMap(**{k: v if v.ndim else v.item() for k, v in arrays.items()})
    except Exception:
        return None


def _write(path: Path, gradient_map: GradientMap) -> None:
    """Put the map into the cache in one stroke: a reader sees a whole file or none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".tmp", delete=False) as file:
        temporary = Path(file.name)
        try:
            np.savez(file, **vars(gradient_map))
            file.close()
            temporary.replace(path)
        except BaseException:
            temporary.unlink()
            raise
