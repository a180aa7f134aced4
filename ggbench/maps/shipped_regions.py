"""The disturbing field of a region for which the package carries data.

Geoid and harmonic coefficients make it by remove, compute and restore
(:mod:`ggbench.gravity.remove_restore`). What is so rebuilt from the EGM2008 geoid is not EGM2008's
own field: over the Qinling mountains the two differ by some tenths of an E rms, at sea by 0.03 E
(README of the data).

The normal field is no part of the result: :mod:`.gravity.ellipsoid` has it exactly. Tensor
components are ordered [EE, EN, EU, NN, NU, UU], x = east, y = north, z = up.
"""

from __future__ import annotations

import dataclasses
import importlib.resources
import io
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import text_of
from ..gravity.gradient_map import MapError
from ..gravity.harmonics import HarmonicCoefficients, gravity_and_gradient, without_normal_field
from ..gravity.remove_restore import (
    MARGIN_DEG,
    GravityGrid,
    Residual,
    height_anomaly,
    linear_weights,
)

Array = NDArray[np.float64]

COEFFICIENTS = "egm2008_degree120.npz"


@dataclass(frozen=True)
class Source:
    """Data files of a region, and the heights for which their resolution is adequate.

    Attributes
    ----------
    geoid, topography : names of the data files.
    lowest_height_m : above the ellipsoid [m].
    provenance : where the data come from, in words.
    source_depth_m : depth below the ellipsoid of sources whose field would be as smooth [m]. Zero
        for land; at sea, half of the shortest wavelength that the data hold.
    coefficients : name of their data file.
    highest_height_m : above the ellipsoid [m].
    """

    geoid: str
    topography: str
    lowest_height_m: float
    provenance: str
    source_depth_m: float = 0.0
    coefficients: str = COEFFICIENTS
    highest_height_m: float = 30000.0


_REBUILT = (
    "rebuilt from the EGM2008 geoid (NGA) at 2.5 arc minutes and coefficients to degree 120, "
)
_LAND_RELIEF = "relief of 5 arc minutes (ITU-R P.1511-2)"
_SEA_RELIEF = "ETOPO1 topography (NOAA)"
# Whatever the depth of the sea, its field is no steeper than EGM2008 knows it: degree 2160 is a
# wavelength of 10 arc minutes.
_SEA_DEPTH_M = 9270.0

SOURCES = {
    "egm2008_qinling": Source(
        geoid="egm2008_geoid_2.5min_qinling.npz",
        topography="itu_p1511_5min_qinling.npz",
        lowest_height_m=3000.0,
        provenance=f"{_REBUILT}{_LAND_RELIEF}; some tenths of an E rms from EGM2008's own field "
        "at 10 km",
    ),
    # For ships too.
    "egm2008_south_china_sea": Source(
        geoid="egm2008_geoid_2.5min_south_china_sea.npz",
        topography="etopo1_6min_south_china_sea.npz",
        lowest_height_m=0.0,
        provenance=f"{_REBUILT}{_SEA_RELIEF}, South China Sea; 0.03 E rms from EGM2008's own field",
        source_depth_m=_SEA_DEPTH_M,
    ),
    # Above Mont Blanc, 4.8 km.
    "egm2008_alps": Source(
        geoid="egm2008_geoid_2.5min_alps.npz",
        topography="itu_p1511_5min_alps.npz",
        lowest_height_m=5000.0,
        provenance=f"{_REBUILT}{_LAND_RELIEF}, Alps; some tenths of an E rms from EGM2008's own "
        "field at 10 km",
    ),
    # Half a kilometre above the highest ground.
    "egm2008_great_plains": Source(
        geoid="egm2008_geoid_2.5min_great_plains.npz",
        topography="itu_p1511_5min_great_plains.npz",
        lowest_height_m=2000.0,
        provenance=f"{_REBUILT}{_LAND_RELIEF}, Great Plains; some hundredths of an E rms from "
        "EGM2008's own field at 10 km",
    ),
    # For ships too.
    "egm2008_mariana": Source(
        geoid="egm2008_geoid_2.5min_mariana.npz",
        topography="etopo1_6min_mariana.npz",
        lowest_height_m=0.0,
        provenance=f"{_REBUILT}{_SEA_RELIEF}, Mariana trench and arc; 0.02 E rms from EGM2008's "
        "own field at 10 km",
        source_depth_m=_SEA_DEPTH_M,
    ),
}
"""The regions for which the package carries data, by the name that a recipe uses."""


def disturbing_field(
    source: str,
    latitude: ArrayLike,
    longitude: ArrayLike,
    height: ArrayLike,
    land_correction: bool = True,
    relief_smoothing_deg: float = 0.0,
) -> tuple[Array, Array]:
    """The disturbing field of a source, free of interpolation, on latitude x longitude x height.

    Parameters
    ----------
    source : a key of :data:`SOURCES`.
    latitude, longitude : any positions inside the source, shapes (n_lat,), (n_lon,) [rad].
    height : above the ellipsoid, shape (n_h,) [m].
    land_correction : whether to turn the geoid into the height anomaly with the topography.
    relief_smoothing_deg : standard deviation, in latitude and in longitude, of a Gaussian that
        smooths the topography before; 0 leaves it as it is, between its samples bilinear.

    Returns
    -------
    The tensor, (n_lat, n_lon, n_h, 6) [E], and the gravity disturbance, (n_lat, n_lon, n_h, 3)
    [m/s²], both in geodetic ENU axes.

    Raises MapError for a data file that is missing or damaged.
    """
    files = SOURCES[source]
    lat, lon, h = (np.asarray(axis, dtype=float) for axis in (latitude, longitude, height))
    coefficients = disturbing_coefficients(files.coefficients)
    geoid = _geoid(files)
    if land_correction:
        elevation = _elevation(files, geoid, relief_smoothing_deg)
        values = height_anomaly(geoid.values, elevation)
        geoid = dataclasses.replace(geoid, values=values)
    residual = Residual(geoid, coefficients)

    gravity_disturbance, tensor = gravity_and_gradient(coefficients, lat, lon, h)
    residual.add_to(tensor, gravity_disturbance, lat, lon, h)
    return tensor, gravity_disturbance


def extent_deg(source: Source) -> tuple[tuple[float, float], tuple[float, float]]:
    """Latitudes and longitudes, each from and to [deg], between which a source gives a field.

    Raises MapError if its geoid is missing or damaged.
    """
    geoid = _geoid(source)
    lat_deg, lon_deg = geoid.latitude_deg, geoid.longitude_deg
    south, north = lat_deg[0] + MARGIN_DEG, lat_deg[-1] - MARGIN_DEG
    west, east = lon_deg[0] + MARGIN_DEG, lon_deg[-1] - MARGIN_DEG
    return (float(south), float(north)), (float(west), float(east))


def _geoid(files: Source) -> GravityGrid:
    grid = _load(files.geoid, ("lat0", "lon0", "step", "N_1e4m"))
    step = float(grid["step"])
    undulation = 1e-4 * grid["N_1e4m"]
    return GravityGrid("geoid", float(grid["lat0"]), float(grid["lon0"]), step, step, undulation)


def _elevation(files: Source, geoid: GravityGrid, smoothing_deg: float) -> Array:
    """Heights of the land at the nodes of the geoid [m], 0 at sea."""
    topography = _load(files.topography, ("lat", "lon", "z"))
    land = np.maximum(topography["z"], 0.0)
    if smoothing_deg > 0.0:
        steps = [float(np.diff(topography[axis]).mean()) for axis in ("lat", "lon")]
        from scipy.ndimage import gaussian_filter  # not at the top: few reliefs are smoothed

        land = gaussian_filter(land, [smoothing_deg / step for step in steps])
    at_rows = linear_weights(topography["lat"], geoid.latitude_deg)
    at_columns = linear_weights(topography["lon"], geoid.longitude_deg)
    elevation: Array = at_rows @ land @ at_columns.T
    return elevation


def disturbing_coefficients(name: str) -> HarmonicCoefficients:
    """Coefficients in a data file of the package, less those of the normal field."""
    data = _load(name, ("cs", "gm", "r"))
    size = math.isqrt(2 * len(data["cs"]))
    cosine, sine = np.zeros((2, size, size))
    cosine[np.tril_indices(size)], sine[np.tril_indices(size)] = data["cs"].T
    return without_normal_field(
        HarmonicCoefficients(float(data["gm"]), float(data["r"]), cosine, sine)
    )


def data_bytes(name: str) -> bytes:
    """Content of a data file of the package. Raises MapError if it cannot be read."""
    try:
        return (importlib.resources.files("ggbench.scenarios") / "data" / name).read_bytes()
    except (OSError, ModuleNotFoundError) as error:
        raise MapError(
            f"Data file {name} cannot be read ({text_of(error)}); it belongs into the "
            "folder data of ggbench.scenarios, where an installation puts it."
        ) from error


def read_arrays(content: bytes, keys: Iterable[str]) -> dict[str, Any]:
    """Arrays of a NumPy archive, given its bytes.

    Raises one of a dozen kinds of exceptions, of NumPy, zipfile and zlib, if it is damaged.
    """
    with np.load(io.BytesIO(content), allow_pickle=False) as data:
        return {key: data[key] for key in keys}


def _load(name: str, keys: tuple[str, ...]) -> dict[str, Any]:
    """Arrays of a data file of the package."""
    content = data_bytes(name)
    try:
        return read_arrays(content, keys)
    except Exception as error:
        raise MapError(
            f"Data file {name} of ggbench.scenarios is damaged ({text_of(error)}); it must be "
            f"a NumPy archive with the arrays {', '.join(keys)}: install the package again."
        ) from error
