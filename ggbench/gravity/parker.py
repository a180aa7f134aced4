"""Gravity and gravity gradient above a terrain, by Parker's (1973) series of Fourier transforms.

The masses lie between the zero level and the terrain: rock on land, and the density deficit of
water at sea. Their attraction at the height z is, in the wavenumber domain,

    F[g_U] = −2πG exp(−k (z − z₀)) Σₙ kⁿ⁻¹/n! F[Σ ρ (s − z₀)ⁿ],

where s is the surface of the land or of the sea floor and ρ its density contrast (Parker 1973, eq.
4). F is the horizontal Fourier transform, k the wavenumber [rad/m] and G the gravitational
constant. The inner sum is over both surfaces. The height z₀ is midway between their lowest and
their highest point. All other components follow by multiplication with the wavenumbers. The series
converges only above the highest ground.

Beyond its edges the terrain is continued by its mirror image, which fades into the mean height of
the edge over a tenth of the terrain's longer side. Farther away the ground is level at this mean
height. The true ground beyond the edges is unknown and has an effect: ground that is 100 m higher
beyond the distance D changes the field by 4 E · (10 km / D), smoothly. Wavelengths as short as the
height above the ground are correct at a distance of a few such heights from the edge.

The Earth is assumed to be flat, in a conformal map projection. This assumption neglects mainly the
rotation of the axes with the position. For an attraction (E, N, U) and the Earth's radius R the
neglected terms are U/R in EE and NN, −2U/R in UU, −E/R in EU and −N/R in NU. For 1e-3 m/s² (100
mGal) they are 0.16 E (U/R) and 0.31 E (2U/R). An example is a mountain range that is 2.4 km high
and 150 km wide, with a field of 40 E and 100 mGal RMS. Apart from the terms above, the error of
the computed field is 0.06 E and 0.5 mGal RMS.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike, DTypeLike, NDArray
from scipy.ndimage import spline_filter

from .ellipsoid import EOTVOS, radii_of_curvature
from .meridians import turns
from .plane_splines import evaluate, resample
from .stereographic import Plane, plane_at, scale_factor, to_plane
from .terrain import Terrain, TerrainError

GRAVITATIONAL_CONSTANT = 6.6743e-11

_SPACING_PER_HEIGHT = 0.25  # of the Fourier grid, to the height above the highest ground
_MOST_NODES = 30_000_000  # of the Fourier grid: about four gigabytes
BORDER = 0.1
"""Ratio of the width of a terrain's continuation beyond its edges to its longer side."""
_MARGIN_NODES = 8  # of the Fourier grid, beyond the border
_LARGEST_DISTORTION = 5e-3  # of lengths, by the map
FEWEST_ORDERS = 6
_MOST_ORDERS = 80
CONVERGED = 1e-4  # rms of what is left of the series [E]
_CLEARANCE_PER_HALF_RELIEF = 0.15  # which the most orders take, about
_COARSE_NODES = 64  # per axis, for the field of the periodic images
_COARSE_PERIODS = 8
_EDGE = 0.5  # cells beyond the outermost nodes that belong to the terrain


@dataclass(frozen=True)
class TerrainOptions:
    """Densities of a terrain, and order of Parker's series.

    Attributes
    ----------
    density : density of the ground [kg/m³].
    water_density : density of water [kg/m³]. Water covers all ground below the zero level.
    order : minimum order of the series, 6 to 80. Higher orders, up to 80, are added until the
        remainder is below 1e-4 E RMS at the lowest height.

    Raises TerrainError for a density outside 0 to 10000 kg/m³ or an order outside 6 to 80.
    """

    density: float = 2670.0
    water_density: float = 1030.0
    order: int = 8

    def __post_init__(self) -> None:
        for name in ("density", "water_density"):
            value = getattr(self, name)
            if not 0.0 <= value <= 1e4:  # NaN fails too
                raise TerrainError(f"{name} = {value} must lie between 0 and 10000 kg/m³.")
        if self.order not in range(FEWEST_ORDERS, _MOST_ORDERS + 1):
            raise TerrainError(
                f"order = {self.order} must be a whole number from {FEWEST_ORDERS} to "
                f"{_MOST_ORDERS}."
            )


def terrain_layers(
    terrain: Terrain,
    latitude: ArrayLike,
    longitude: ArrayLike,
    height: ArrayLike,
    options: TerrainOptions | None = None,
    geoid_height: float = 0.0,
    dtype: DTypeLike = np.float32,
) -> Iterator[tuple[NDArray[np.floating], NDArray[np.floating]]]:
    """Yield the field of a terrain's masses at one height after the other, to limit memory.

    Parameters
    ----------
    terrain : heights above the zero level.
    latitude, longitude : grid of positions within the terrain, shapes (n_lat,), (n_lon,) [rad].
    height : heights above the ellipsoid, shape (n_h,) [m], all above the highest ground.
    options : densities and order; by default those of :class:`TerrainOptions`.
    geoid_height : height of the terrain's zero level above the ellipsoid [m].
    dtype : float64, or float32 for half the memory and an error of about 1e-5 E.

    Yields
    ------
    Tensor (n_lat, n_lon, 6) [E] and gravity vector (n_lat, n_lon, 3) [m/s²] for each height, in
    geodetic ENU axes. Both are computed for a flat Earth.

    Raises
    ------
    TerrainError : at the first iteration, in these cases: a position is outside the terrain; a
        position or the geoid height is not finite; a height is below the highest ground, or so
        close above it that the series or the Fourier grid becomes too large; the terrain is too
        wide for a plane.
    """
    lat, lon, heights = (
        _axis(values, name)
        for values, name in ((latitude, "latitude"), (longitude, "longitude"), (height, "height"))
    )
    _check_inside(terrain, lat, lon)
    if not math.isfinite(geoid_height):
        raise TerrainError(f"geoid_height = {geoid_height} must be a finite number.")
    levels = heights - geoid_height
    series = _Series(terrain, options or TerrainOptions(), levels)
    for level in levels:
        fine, coarse = series.fields(level, np.dtype(dtype))
        tensor = np.empty((lat.size, lon.size, 6), dtype)
        vector = np.empty((lat.size, lon.size, 3), dtype)
        evaluate(
            latitude=lat,
            longitude=lon,
            plane=series.plane,
            origin=series.origin,
            step=series.step,
            fine=fine,
            coarse_step=series.coarse_step,
            coarse=coarse,
            level_gravity=series.level_gravity,
            tensor=tensor,
            vector=vector,
        )
        yield tensor, vector


def least_clearance(terrain: Terrain, nodes: int = _MOST_NODES) -> float:
    """Return the smallest clearance [m] above the highest ground that a Fourier grid allows.

    ``nodes`` is the largest number of nodes of this grid. The nodes must be at most a quarter of
    the clearance apart, and not farther apart than the nodes of the terrain.

    Raises TerrainError for a terrain that is too wide for a plane.
    """
    _, _, size = _laid_flat(terrain)
    around = size + 2.0 * BORDER * float(size.max())
    step = math.sqrt(float(around.prod()) / nodes)
    return min(step, max(_native(terrain))) / _SPACING_PER_HEIGHT


def converging_clearance(terrain: Terrain) -> float:
    """Return the clearance [m] above the highest ground at which the series needs order 80.

    Order 80 is the highest order that is allowed. The value is approximate.
    """
    return _CLEARANCE_PER_HALF_RELIEF * 0.5 * float(np.ptp(terrain.height_m))


def _laid_flat(terrain: Terrain) -> tuple[Plane, NDArray, NDArray]:
    """Return the plane of a terrain, and the terrain's bounding box on the plane.

    The box is given by its south-western corner (2,) and its size in x and y (2,) [m].
    """
    lat, lon = np.radians(terrain.latitudes_deg), np.radians(terrain.longitudes_deg)
    plane = plane_at(0.5 * (lat[0] + lat[-1]), 0.5 * (lon[0] + lon[-1]))
    distortion = max(abs(scale_factor(a, lon[0], plane) - 1.0) for a in lat[[0, -1]])
    if not (distortion <= _LARGEST_DISTORTION and lon[-1] - lon[0] < math.pi):
        raise TerrainError(
            f"{terrain.name} is too wide for the plane approximation, "
            f"{np.ptp(terrain.latitudes_deg):g} by {np.ptp(terrain.longitudes_deg):g} degrees: "
            "crop it to about 10 degrees."
        )
    rim = [(a, b) for a in lat for b in lon[[0, -1]]] + [(a, b) for a in lat[[0, -1]] for b in lon]
    points = np.array([to_plane(a, b, plane)[:2] for a, b in rim])
    return plane, points.min(axis=0), np.ptp(points, axis=0)


def _native(terrain: Terrain) -> tuple[float, float]:
    """Return the node spacing of a terrain to the east and to the north at its centre [m]."""
    lat = np.radians(terrain.latitudes_deg)
    middle = 0.5 * (lat[0] + lat[-1])
    meridian, prime_vertical = radii_of_curvature(middle)
    return (
        math.radians(terrain.longitude_step_deg) * prime_vertical * math.cos(middle),
        math.radians(terrain.latitude_step_deg) * meridian,
    )


class _Series:
    """Parker's series at the lowest height, on a grid of the plane around the terrain."""

    def __init__(self, terrain: Terrain, options: TerrainOptions, levels: NDArray) -> None:
        self._lay_grid(terrain, levels)
        surface, edge = self._sample(terrain)
        layers = density_layers(surface, edge, options)
        del surface
        # The ground at the level of the edge: an infinite slab.
        slab = sum(density * edge_level for _, edge_level, density in layers)
        self.level_gravity = -2.0 * math.pi * GRAVITATIONAL_CONSTANT * slab
        self._sum(layers, options)

    def _lay_grid(self, terrain: Terrain, levels: NDArray) -> None:
        self.plane, corner, size = _laid_flat(terrain)
        ground = terrain.height_m
        highest = float(ground.max())
        self._lowest_level = float(levels.min())
        clearance = self._lowest_level - highest
        if not clearance > 0.0:
            raise TerrainError(
                f"The lowest height lies {-clearance:g} m below the highest ground of "
                f"{terrain.name} ({highest:g} m above its zero level): Parker's series converges "
                "only above it."
            )
        self.step = np.minimum(_native(terrain), _SPACING_PER_HEIGHT * clearance)
        # Of the terrain alone: a field must not depend on what other heights are asked for.
        self.border = BORDER * float(size.max())
        counts = np.ceil((size + 2.0 * self.border) / self.step) + 2 * _MARGIN_NODES
        if counts.prod() > _MOST_NODES:
            allowed = math.sqrt((size + 2.0 * self.border).prod() / _MOST_NODES)
            raise TerrainError(
                f"A lowest height {clearance:.3g} m above the highest ground of {terrain.name} "
                f"needs {counts.prod():.2g} Fourier nodes; {_MOST_NODES:.2g} are allowed: crop "
                "or coarsen the terrain, or raise the lowest height to "
                f"{allowed / _SPACING_PER_HEIGHT:.3g} m above the highest ground."
            )
        self.count = [scipy.fft.next_fast_len(int(n), real=True) for n in counts]  # x, y
        self.origin = corner - 0.5 * (self.count * self.step - size)
        self._name = terrain.name
        self._highest = highest

    def _sample(self, terrain: Terrain) -> tuple[NDArray, float]:
        """Return heights on the grid (n_y, n_x) [m], and the mean height of the edge [m]."""
        ground = np.ascontiguousarray(terrain.height_m, dtype=float)
        edge = float(
            np.concatenate((ground[0], ground[-1], ground[1:-1, 0], ground[1:-1, -1])).mean()
        )
        surface = np.empty(self.count[::-1])
        south_west = np.radians((terrain.south_deg, terrain.west_deg))
        steps = np.radians((terrain.latitude_step_deg, terrain.longitude_step_deg))
        meridian, prime_vertical = radii_of_curvature(np.radians(terrain.latitudes_deg.mean()))
        metres = np.array([meridian, prime_vertical * self.plane.cosine]) * steps
        resample(
            ground=ground,
            coefficients=spline_filter(ground, 3, mode="mirror"),
            south_west=south_west,
            steps=steps,
            metres=metres,
            edge=edge,
            border=self.border,
            plane=self.plane,
            origin=self.origin,
            step=self.step,
            surface=surface,
        )
        return surface, edge

    def _sum(self, layers: list[tuple[NDArray, float, float]], options: TerrainOptions) -> None:
        n_x, n_y = self.count
        self._k_x, self._k_y, k = _wavenumbers(n_x, n_y, self.step)
        top = max(surface.max() for surface, _, _ in layers)
        bottom = min(surface.min() for surface, _, _ in layers)
        self.middle = 0.5 * (top + bottom)
        half = max(0.5 * (top - bottom), 1e-3)
        distance = self._lowest_level - self.middle
        relative = []
        for surface, edge, density in layers:
            surface -= self.middle  # in place, for these arrays are large
            surface /= half
            relative.append((surface, (edge - self.middle) / half, density))
        powers = [np.ones((n_y, n_x)) for _ in relative]

        factor = half * np.exp(-k * distance)
        self._spectrum = np.zeros(k.shape, complex)
        self._moments: list[NDArray] = []
        remainder = math.inf
        for n in range(1, _MOST_ORDERS + 1):
            moment = np.zeros((n_y, n_x))
            for power, (surface, edge, density) in zip(powers, relative, strict=True):
                power *= surface
                moment += density * power
                moment -= density * edge**n
            term = scipy.fft.rfft2(moment, workers=2)
            del moment
            if n <= 2:
                self._moments.append(half**n / n * _lowest_harmonics(term, self.count))
            term *= factor
            self._spectrum += term
            term *= k
            rms = 2.0 * math.pi * GRAVITATIONAL_CONSTANT / EOTVOS * math.sqrt(2.0)
            rms *= float(np.linalg.norm(term)) / (n_x * n_y)
            # From here on the terms shrink at least as a geometric series does.
            remainder = rms / (1.0 - half / distance)
            if n >= options.order and remainder < CONVERGED:
                break
            factor *= k * (half / (n + 1))
        else:
            raise TerrainError(
                f"Parker's series has an error of {remainder:.2g} E after {_MOST_ORDERS} orders; "
                f"at most {CONVERGED:g} E is allowed. The lowest height is "
                f"{self._lowest_level - self._highest:.3g} m above the highest ground of "
                f"{self._name}: raise it; about {_CLEARANCE_PER_HALF_RELIEF * half:.3g} m or "
                "somewhat more is needed."
            )
        self.orders = n

    def fields(self, level: float, dtype: np.dtype) -> tuple[NDArray, NDArray]:
        """Return spline coefficients of the eight components at a level, and of a correction.

        The components are those of :func:`_components`. The Fourier series describes a terrain that
        is repeated periodically. The correction removes the field of the periodic images. This
        field is smooth, so coarse grids and two orders of the series are sufficient. The correction
        is the field with eight times the period minus the field with the original period.

        Returns
        -------
        Coefficients (8, n_y, n_x) on the fine grid and (8, m_y, m_x) on the coarse grid; the field
        is the sum of both splines.
        """
        n_x, n_y = self.count
        k_x, k_y, k = self._k_x, self._k_y, np.hypot(self._k_x, self._k_y[:, np.newaxis])
        continued = self._spectrum * np.exp(-k * (level - self._lowest_level))
        for wavenumber, axis, step in ((k_y, 0, self.step[1]), (k_x, 1, self.step[0])):
            # The transform of the cubic B-spline at the nodes: coefficients that interpolate.
            spline = (2.0 + np.cos(wavenumber * step)) / 3.0
            continued /= np.expand_dims(spline, 1 - axis)
        fine = np.empty((8, n_y, n_x), dtype)
        for index, component in enumerate(_components(continued, k_x, k_y, k, n_x, dtype)):
            fine[index] = component

        m_y, m_x = self._moments[0].shape
        coarse = np.zeros((8, m_y, m_x))
        for sign, periods in ((1.0, _COARSE_PERIODS), (-1.0, 1)):
            shape = (periods * m_y, periods * m_x)
            k_x, k_y, k = _wavenumbers(shape[1], shape[0], self.coarse_step)
            # rfft2 fills up with level ground.
            continued = np.zeros(k.shape, complex)
            for order, moment in enumerate(self._moments):
                continued += k**order * scipy.fft.rfft2(moment, shape)
            continued *= np.exp(-k * (level - self.middle))
            parts = _components(continued, k_x, k_y, k, shape[1], np.dtype(float))
            for index, component in enumerate(parts):
                coarse[index] += sign * component[:m_y, :m_x]
        return fine, np.array([spline_filter(part, 3, mode="mirror") for part in coarse])

    @property
    def coarse_step(self) -> NDArray:
        """Spacing (2,) of the coarse grid in x and y [m]. Both grids have the same origin."""
        return self.step * self.count / np.array(self._moments[0].shape[::-1])


def density_layers(
    surface: NDArray, edge: float, options: TerrainOptions
) -> list[tuple[NDArray, float, float]]:
    """Split a terrain into a layer of rock above the zero level and a layer of water below it.

    Parameters
    ----------
    surface : (n_y, n_x) heights of the ground [m]; negative heights are the sea floor.
    edge : constant height of the ground beyond the edge [m].
    options : densities of rock and water.

    Returns
    -------
    One or two layers, each with its surface (n_y, n_x) [m], the height of this surface beyond the
    edge [m], and the density contrast between surface and zero level [kg/m³].
    """
    below = options.density - options.water_density
    lowest, highest = min(surface.min(), edge), max(surface.max(), edge)
    if lowest >= 0.0:
        return [(surface, edge, options.density)]
    if highest <= 0.0:
        return [(surface, edge, below)]
    return [
        (np.maximum(surface, 0.0), max(edge, 0.0), options.density),
        (np.minimum(surface, 0.0), min(edge, 0.0), below),
    ]


def _wavenumbers(n_x: int, n_y: int, step: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    k_x = 2.0 * np.pi * scipy.fft.rfftfreq(n_x, step[0])
    k_y = 2.0 * np.pi * scipy.fft.fftfreq(n_y, step[1])
    return k_x, k_y, np.hypot(k_x, k_y[:, np.newaxis])


def _lowest_harmonics(spectrum: NDArray, count: list[int]) -> NDArray:
    """Return a smoothed surface on a coarse grid, from its spectrum on the fine grid.

    Both grids have the same period. ``count`` is the number of nodes n_x, n_y of the fine grid.
    """
    (n_x, n_y), (m_x, m_y) = count, (min(_COARSE_NODES, n) for n in count)
    half = (m_y - 1) // 2
    columns = (m_x + 1) // 2  # without the Nyquist term of an even number
    coarse = np.zeros((m_y, m_x // 2 + 1), complex)
    coarse[: half + 1, :columns] = spectrum[: half + 1, :columns]
    coarse[-half:, :columns] = spectrum[-half:, :columns]
    # A Gaussian one node wide keeps the smoothed surface from ringing.
    k_x, k_y, _ = _wavenumbers(m_x, m_y, np.ones(2))
    coarse *= np.exp(-0.5 * (k_x**2 + k_y[:, np.newaxis] ** 2))
    coarse *= m_x * m_y / (n_x * n_y)
    return scipy.fft.irfft2(coarse, (m_y, m_x))


def _components(
    continued: NDArray, k_x: NDArray, k_y: NDArray, k: NDArray, n_x: int, dtype: np.dtype
) -> Iterator[NDArray]:
    """Yield EE, EN, EU, NN, NU [E], E, N, U [m/s²] in the axes of the plane.

    ``continued`` is the spectrum of −g_U / 2πG at the level, with wavenumbers k_x, k_y and k [1/m].
    """
    single = dtype == np.dtype(np.float32)
    shape = (continued.shape[0], n_x)
    column = k_y[:, np.newaxis]
    up = -2.0 * np.pi * GRAVITATIONAL_CONSTANT * continued
    inverse = np.divide(1.0, k, out=np.zeros_like(k), where=k > 0.0)
    factors = (
        lambda: k_x**2 * inverse / EOTVOS,
        lambda: k_x * column * inverse / EOTVOS,
        lambda: 1j * k_x / EOTVOS,
        lambda: column**2 * inverse / EOTVOS,
        lambda: 1j * column / EOTVOS,
        lambda: -1j * k_x * inverse,
        lambda: -1j * column * inverse,
        lambda: 1.0,
    )
    for factor in factors:
        spectrum = up * factor()
        if single:
            spectrum = spectrum.astype(np.complex64)
        yield scipy.fft.irfft2(spectrum, shape, overwrite_x=True, workers=2)


def _axis(values: ArrayLike, name: str) -> NDArray:
    axis = np.asarray(values, dtype=float)
    if axis.ndim != 1 or axis.size == 0 or not np.isfinite(axis).all():
        raise TerrainError(f"{name} must be one or more finite numbers.")
    return axis


def _check_inside(terrain: Terrain, latitude: NDArray, longitude: NDArray) -> None:
    """Raise TerrainError unless all positions [rad] lie within the cells of the terrain."""
    limits = (
        ("latitude", np.degrees(latitude), terrain.latitudes_deg, terrain.latitude_step_deg),
        ("longitude", np.degrees(longitude), terrain.longitudes_deg, terrain.longitude_step_deg),
    )
    for name, degrees, nodes, step in limits:
        low, high = nodes[0] - _EDGE * step, nodes[-1] + _EDGE * step
        if name == "longitude":  # the same meridian, counted as the terrain counts
            degrees = degrees + turns(degrees, 0.5 * (low + high))
        if not (low - 1e-9 <= degrees.min() and degrees.max() <= high + 1e-9):
            raise TerrainError(
                f"{name} {degrees.min():.6g} to {degrees.max():.6g} degrees is not within "
                f"{terrain.name}: {low:.6f} to {high:.6f} is allowed."
            )
