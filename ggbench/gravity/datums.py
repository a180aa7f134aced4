"""Datums of grids: tests for WGS 84, and the zero level of heights."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .optional_modules import imported
from .terrain import TerrainError

_NEAR_M = 5.0
"""Largest shift from WGS 84 that is ignored [m]: NAD83 has up to 2 m, older datums 50 m."""
_METRES_PER_DEGREE = 111e3
_VERTICAL = re.compile(r'VERT(?:_CS|CRS)\["([^"]+)"')
_DOWN = re.compile(r'VERT(?:_CS|CRS)\[.*AXIS\["[^"]*",\s*down', re.IGNORECASE | re.DOTALL)
_ELLIPSOIDAL = re.compile(r'AXIS\["(?:ellipsoidal height|h\b)[^"]*"', re.IGNORECASE)


def name_of(crs: Any) -> str:
    """Return the name of a coordinate reference system of rasterio."""
    match = re.search(r'"([^"]+)"', crs.to_wkt())
    return match[1] if match else str(crs)


def is_another(crs: Any, longitude: float, latitude: float, path: Path) -> bool:
    """Return whether a geographic coordinate system ``crs`` differs by over 5 m from WGS 84.

    ``longitude`` and ``latitude`` [deg] are the position of the comparison, in ``crs``.

    Raises TerrainError if rasterio is not installed; the message names the file ``path``.
    """
    warp = imported("rasterio.warp", path)
    (east,), (north,) = warp.transform(crs, "EPSG:4326", [longitude], [latitude])[:2]
    off = np.array([(east - longitude + 180.0) % 360.0 - 180.0, north - latitude])
    off[0] *= np.cos(np.radians(latitude))
    return not _METRES_PER_DEGREE * np.hypot(*off) <= _NEAR_M


def vertical(crs: Any) -> tuple[str, bool]:
    """Return the zero level of heights, and whether heights are positive down.

    ``crs`` is the coordinate reference system of the heights, or None. The zero level is a text for
    remarks; it is "" if ``crs`` states none.
    """
    if crs is None:
        return "", False
    wkt = crs.to_wkt()
    if match := _VERTICAL.search(wkt):
        return f"vertical datum {match[1]}", _DOWN.search(wkt) is not None
    return ELLIPSOIDAL if _ELLIPSOIDAL.search(wkt) else "", False


ELLIPSOIDAL = "heights are above the ellipsoid"


def require_wgs84(
    variables: Mapping[Any, Any], variable: Any, place: tuple[float, float], path: Path
) -> None:
    """Raise TerrainError if the grid mapping of a netCDF variable differs from WGS 84.

    A geographic system may differ by up to 5 m, see :func:`is_another`. The error is also raised if
    the prime meridian is not Greenwich, or if the reference system is invalid.

    ``variables`` are all variables of the file, including the grid mapping. ``place`` is the
    longitude and latitude of a point within the grid [deg].
    """
    name = variable.attrs.get("grid_mapping", variable.encoding.get("grid_mapping"))
    mapping = variables.get(name) if isinstance(name, str) else None
    if mapping is None:
        return
    meridian = mapping.attrs.get("longitude_of_prime_meridian", 0.0)
    wkt = mapping.attrs.get("crs_wkt", mapping.attrs.get("spatial_ref", ""))
    if isinstance(meridian, str) or np.any(np.asarray(meridian) != 0.0):
        raise TerrainError(
            f"{path.name} has its prime meridian at {meridian} degrees; only Greenwich is "
            "allowed: warp the grid to EPSG:4326 with gdalwarp."
        )
    if not isinstance(wkt, str) or not wkt.strip():
        return
    try:
        crs = imported("rasterio.crs", path).CRS.from_wkt(wkt)
        another = crs.is_geographic and is_another(crs, *place, path)
    except TerrainError:
        raise
    except Exception:  # rasterio's own, of a text that is no reference system
        reason = f"{path.name} has an invalid reference system: {wkt[:60]!r}."
        raise TerrainError(reason) from None
    if another:
        raise TerrainError(
            f"{path.name} is in {name_of(crs)}; only WGS 84 is allowed: warp the grid to "
            "EPSG:4326 with gdalwarp."
        )
