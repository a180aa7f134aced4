"""Maps with added errors, so that the assumed field differs from the true field.

Four errors of real maps can be added: limited resolution, a wrong density of the masses, white
noise at the nodes, and noise with a correlation length such as the line spacing of a survey.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .ellipsoid import EOTVOS, metres_per_radian
from .gradient_map import GradientMap, MapError

Array = NDArray[np.float64]

_MOST_NODES = 4_000_000  # of the plane of a random field: some seconds per layer of the map
_LEAST_LEVELS, _LEVELS_PER_LENGTH = 12, 4.0
"""Levels for the interpolation of a random field by a polynomial in the height.

The first value is the smallest number of levels. The second value is the number of additional
levels per correlation length between the lowest and the highest node.
"""
_DEEPEST = 0.5
"""Largest depth of a node below the mean height of its layer, in correlation lengths.

At this depth a random field is three times as large, and it grows quickly below.
"""


@dataclass(frozen=True)
class MapDegradation:
    """Errors to add to a map. The same seed gives the same errors.

    Attributes
    ----------
    resolution_m : standard deviation of a horizontal Gaussian that smooths the map; 0 for none.
    density_factor : factor on the whole disturbing field, equivalent to a factor on the density of
        its masses.
    white_noise_eotvos : RMS of white noise in each tensor component at each node [E]; all values
        are independent.
    correlated_noise_eotvos : RMS of Γ_UU of a random field at the lowest nodes [E]. The field is
        harmonic: all tensor components and the gravity disturbance come from one random potential,
        continued upwards, so curl and Laplacian stay zero. In a draped map the random field is
        larger in valleys than above summits.
    correlation_m : distance at which the correlation of Γ_UU of the random field is 1/e [m], at the
        mean height of the lowest nodes.
    seed : seed of the random numbers.
    """

    resolution_m: float = 0.0
    density_factor: float = 1.0
    white_noise_eotvos: float = 0.0
    correlated_noise_eotvos: float = 0.0
    correlation_m: float = 10e3
    seed: int = 1


def degrade(right: GradientMap, degradation: MapDegradation) -> GradientMap:
    """Return a copy of the error-free map ``right``, with errors.

    The copy is smoothed, then scaled. After this, noise is added.

    Raises MapError if the map is narrower than ``resolution_m``. With correlated noise, MapError is
    also raised in three cases:

    - the correlation length is shorter than the node spacing;
    - the correlation length is so long that the random field needs too many nodes;
    - the map is draped, and the correlation length is below twice the depth of the base surface.
      The depth is the mean height of the surface minus its lowest height.
    """
    _check(right, degradation)
    tensor = np.asarray(right.tensor, dtype=float)
    disturbance = np.asarray(right.gravity_disturbance, dtype=float)
    north, east = _node_distances(right)
    if degradation.resolution_m > 0.0:
        from scipy.ndimage import gaussian_filter1d  # not at the top: few maps are smoothed

        tensor, disturbance = (
            gaussian_filter1d(
                gaussian_filter1d(values, degradation.resolution_m / north, axis=0),
                degradation.resolution_m / east,
                axis=1,
            )
            for values in (tensor, disturbance)
        )
    if degradation.density_factor != 1.0:
        tensor, disturbance = (degradation.density_factor * v for v in (tensor, disturbance))
    white, correlated = (
        np.random.default_rng(child) for child in np.random.SeedSequence(degradation.seed).spawn(2)
    )
    if degradation.white_noise_eotvos > 0.0:
        tensor = tensor + degradation.white_noise_eotvos * white.standard_normal(tensor.shape)
    if degradation.correlated_noise_eotvos > 0.0:
        noise, gravity = _harmonic_noise(right, degradation, north, east, correlated)
        # In place: new memory for a map takes as long as the sum.
        noise += tensor
        gravity += disturbance
        tensor, disturbance = noise, gravity
    changes = ", ".join(
        f"{key} {value:g}" for key, value in vars(degradation).items() if key != "seed"
    )
    return replace(
        right,
        tensor=tensor,
        gravity_disturbance=disturbance,
        provenance=f"{right.provenance}; degraded: {changes}",
    )


def _check(grid: GradientMap, degradation: MapDegradation) -> None:
    """Raise MapError if the smoothing or correlation length does not suit the map."""
    steps = _node_distances(grid)
    side = min(n * step for n, step in zip(grid.tensor.shape[:2], steps, strict=True))
    if degradation.resolution_m > side:
        raise MapError(
            f"the map error has resolution_km = {0.001 * degradation.resolution_m:g}, which must "
            f"be at most the width of the map, {0.001 * side:.3g} km"
        )
    if degradation.correlated_noise_eotvos == 0.0:
        return
    correlation = f"correlation_km = {1e-3 * degradation.correlation_m:g}"
    if grid.base is not None:
        depth = float(grid.base.mean() - grid.base.min())
        if _DEEPEST * degradation.correlation_m < depth:
            raise MapError(
                f"the map error has {correlation}, too short for the base surface, whose lowest "
                f"point is {depth:.0f} m below its mean: at least "
                f"{1e-3 * depth / _DEEPEST:.3g} km is allowed"
            )
    if degradation.correlation_m < max(steps):
        raise MapError(
            f"the map error has {correlation}, which must be at least the node spacing, "
            f"{0.001 * max(steps):.3g} km"
        )
    if math.prod(_plane_shape(grid, degradation, *steps)) > _MOST_NODES:
        raise MapError(
            f"the map error has {correlation}, too long for a node spacing of "
            f"{0.001 * min(steps):.3g} km: the random field would need too many nodes"
        )


def _plane_shape(
    grid: GradientMap, degradation: MapDegradation, north: float, east: float
) -> tuple[int, int]:
    """Return the numbers of nodes (north, east) of the plane on which a random field is computed.

    The plane is four correlation lengths wider than the map, so that the periodic images of the
    random field do not correlate within the map.
    """
    n_lat, n_lon = grid.tensor.shape[:2]
    beyond = 4.0 * degradation.correlation_m
    return n_lat + math.ceil(beyond / north), n_lon + math.ceil(beyond / east)


def _node_distances(grid: GradientMap) -> tuple[float, float]:
    """Return the node spacing to the north and to the east at the middle latitude [m]."""
    count = grid.tensor.shape[0]
    base = 0.0 if grid.base is None else float(grid.base.mean())
    latitude = grid.latitude0 + 0.5 * (count - 1) * grid.latitude_step
    middle = np.array([latitude, 0.0, base + grid.height0])
    per_north, per_east = metres_per_radian(middle)
    return per_north * grid.latitude_step, per_east * grid.longitude_step


def _harmonic_noise(
    grid: GradientMap,
    degradation: MapDegradation,
    north: float,
    east: float,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Return a random harmonic field on the nodes: tensor [E] and gravity vector [m/s²].

    At the lowest layer Γ_UU has the covariance σ² exp(−d²/ℓ²) at the distance d. Its spectrum is
    also a Gaussian. In a draped map Γ_UU has this correlation at the mean height of the lowest
    layer. The mean variance over this layer is σ².
    """
    n_lat, n_lon, n_h = grid.tensor.shape[:3]
    pad_lat, pad_lon = _plane_shape(grid, degradation, north, east)
    # Of a real field half of the spectrum says all.
    k_n = 2.0 * np.pi * np.fft.fftfreq(pad_lat, north)[:, np.newaxis]
    k_e = 2.0 * np.pi * np.fft.rfftfreq(pad_lon, east)[np.newaxis, :]
    k = np.hypot(k_n, k_e)
    # The square root of the spectrum of exp(−d²/ℓ²), scaled to unit variance.
    shape = np.exp(-((k * degradation.correlation_m) ** 2) / 8.0)
    shape[0, 0] = 0.0
    twice = np.full(k.shape[1], 2.0)
    twice[0] = 1.0
    twice[-1] = 2.0 if pad_lon % 2 else 1.0
    shape *= math.sqrt(pad_lat * pad_lon / np.sum(twice * shape**2))
    vertical = np.fft.rfft2(rng.standard_normal((pad_lat, pad_lon))) * shape
    with np.errstate(divide="ignore", invalid="ignore"):
        potential = np.where(k > 0.0, vertical / k**2, 0.0)
    heights = _heights_above_reference(grid)
    variances = _relative_variance(heights[..., 0], degradation.correlation_m)
    potential *= degradation.correlated_noise_eotvos * EOTVOS / math.sqrt(variances.mean())
    # Of the highest wave number there is no odd derivative on a grid.
    odd = k_n.copy()
    if pad_lat % 2 == 0:
        odd[pad_lat // 2] = 0.0
    slopes = [1j * k_e, 1j * odd, -k]
    tensor, gravity = np.empty((n_lat, n_lon, n_h, 6)), np.empty((n_lat, n_lon, n_h, 3))

    def on_nodes(spectrum: Array) -> Array:
        # As irfft2 does it, but the rows beyond the map are not turned back along the other axis.
        rows = np.fft.ifft(spectrum, axis=0)[:n_lat]
        return np.fft.irfft(rows, pad_lon, axis=1)[:, :n_lon]

    def planes(fading: Array) -> Iterator[tuple[Array, int, Array]]:
        """Yield each component of the field on a level: output array, component index, values.

        ``fading`` is the factor of the upward continuation in the wavenumber domain.
        """
        continued = potential * fading
        first = [continued * slope for slope in slopes]
        for i in range(3):
            yield gravity, i, on_nodes(first[i])
        pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
        for column, (i, j) in enumerate(pairs):
            second = -(k_n**2) * continued if i == j == 1 else first[i] * slopes[j]
            yield tensor, column, on_nodes(second) / EOTVOS

    if grid.base is None:
        for layer in range(n_h):
            for array, index, values in planes(np.exp(-k * grid.height_step * layer)):
                array[:, :, layer, index] = values
        return tensor, gravity
    tensor[...], gravity[...] = 0.0, 0.0
    levels = _levels(heights, degradation.correlation_m)
    for level in levels:
        others = levels[levels != level]
        weight = np.ones_like(heights)  # of the level in the polynomial through all of them
        for other in others:
            weight *= (heights - other) / (level - other)
        for array, index, values in planes(np.exp(-k * level)):
            array[..., index] += weight * values[:, :, np.newaxis]
    return tensor, gravity


def _heights_above_reference(grid: GradientMap) -> Array:
    """Return heights of nodes above the mean height of the lowest layer [m].

    The shape is (n_lat, n_lon, n_h), or (1, 1, n_h) for level layers.
    """
    above = grid.height_step * np.arange(grid.tensor.shape[2], dtype=float)
    if grid.base is None:
        return above[np.newaxis, np.newaxis]
    return np.asarray(grid.base - grid.base.mean())[..., np.newaxis] + above


def _relative_variance(height: Array, correlation_m: float) -> Array:
    """Return the variance of a random Γ_UU at heights z (...) [m], relative to that at z = 0.

    It is the mean of exp(−2kz) over the wavenumbers k, weighted by the spectrum k exp(−k²ℓ²/4).
    """
    from scipy.special import erfcx

    a = 2.0 * height / correlation_m
    return np.asarray(1.0 - math.sqrt(math.pi) * a * erfcx(a))


def _levels(heights: Array, correlation_m: float) -> Array:
    """Return Chebyshev nodes over the range of the heights [m]."""
    low, high = float(heights.min()), float(heights.max())
    count = _LEAST_LEVELS + math.ceil(_LEVELS_PER_LENGTH * (high - low) / correlation_m)
    angles = math.pi * (np.arange(count) + 0.5) / count
    return np.asarray(0.5 * (low + high) - 0.5 * (high - low) * np.cos(angles))
