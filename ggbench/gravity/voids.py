"""Detection and interpolation of void cells of a grid."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import griddata
from scipy.ndimage import binary_dilation, distance_transform_edt

from .meridians import Area
from .terrain import TerrainError
from .units import Units

Array = NDArray[np.floating]

_MARKS = (-32768.0, -32767.0, -9999.0, -99999.0)  # values that are none, whatever the unit
_MARKS_BEYOND = (32767.0, 9999.0, 99999.0, 999999.0, -999999.0)  # where nothing is as large
_MARKS_APART = (-99.0, -999.0, 999.0, -10000.0)  # where they are far from all other values
_APART = 0.1  # of the range of the other values
_OF_SINGLE = 1e-6  # relative difference of equal numbers in single precision
_HUGE = 1e20  # no value is as large: 1.7e38 (Surfer), 3.4e38 (ESRI), 9.97e36 (netCDF)
_MOST_VOIDS = 0.01  # share of the cells that may be filled
_SAMPLED = 1_000_000  # cells of which it is seen whether they lie in an area


def marks_removed(written: Array, values: Array, units: Units) -> tuple[Array, str]:
    """Return values with declared and common void values replaced by NaN, and a remark.

    Void values are

    - the declared void values of ``units``;
    - -9999, -99999, -32767, -32768 and numbers of magnitude 1e20 or more;
    - 9999, 99999, 32767, 999999 and -999999, if outside the limits of the quantity;
    - -99, -999, 999 and -10000, if far from all other values.

    The remark names common void values that were replaced but not declared; "" if there are none.

    Parameters
    ----------
    written : (...) numbers in the file.
    values : (...) the same numbers in SI units.
    units : additional void values, and limits of the quantity.
    """
    marked = np.zeros(np.shape(written), dtype=bool)
    for mark in units.voids:
        marked |= np.isclose(written, mark, rtol=_OF_SINGLE, atol=0.0)
    values = np.where(marked, np.nan, values)
    beyond = (values < units.lowest) | (values > units.highest)
    void = np.isin(written, _MARKS) | (beyond & np.isin(written, _MARKS_BEYOND))
    void = (void | (np.abs(written) >= _HUGE)) & ~marked
    others = np.isfinite(values) & ~void & ~marked & ~np.isin(written, _MARKS_APART)
    if others.any() and np.isin(written, _MARKS_APART).any():
        low, high = float(written[others].min()), float(written[others].max())
        for mark in _MARKS_APART:
            if max(low - mark, mark - high) > max(_APART * (high - low), abs(0.1 * mark)):
                void |= (written == mark) & ~marked
    if not void.any():
        return values, ""
    marks = ", ".join(f"{mark:.8g}" for mark in np.unique(written[void])[:3])
    return np.where(
        void, np.nan, values
    ), f"undeclared {marks} read as voids; declare others with --void VALUE"


def without_voids(
    heights: Array,
    name: str,
    to_degrees: Callable[[NDArray[Any], NDArray[Any]], tuple[Array, Array]],
    area: Area | None,
) -> tuple[Array, str]:
    """Return heights with voids filled by interpolation, and a remark ("" without voids).

    Parameters
    ----------
    heights : (rows, columns) [m]; voids are not finite.
    name : name of the file, for messages.
    to_degrees : function that returns latitudes and longitudes (N,) [deg] of rows and columns (N,).
    area : area in which voids are counted; None: everywhere. Voids outside the area are filled,
        however many there are.

    Raises TerrainError if one per cent or more of the cells in the area are voids.
    """
    void = ~np.isfinite(heights)
    if not void.any():
        return heights, ""
    rows, columns = np.nonzero(void)
    latitude, longitude = to_degrees(rows, columns)
    count, cells, first, where = rows.size, void.size, 0, ""
    counting = void
    if area is not None:
        # As many cells as there are in the area, by a sample of them.
        stride = math.ceil(math.sqrt(void.size / _SAMPLED))
        row, column = (np.append(np.arange(0, n - 1, stride), n - 1) for n in void.shape)
        sampled = to_degrees(*(a.ravel() for a in np.meshgrid(row, column, indexing="ij")))
        placed = area.about(float(longitude.mean())).within(*sampled)
        within = placed.holds(latitude, longitude)
        count, first = int(within.sum()), int(within.argmax())
        cells = max(count, round(float(placed.holds(*sampled).mean()) * void.size))
        where = " of the area needed, {:.4g}° to {:.4g}° N, {:.4g}° to {:.4g}° E".format(*placed)
        counting = np.zeros_like(void)
        counting[rows[within], columns[within]] = True
    place = f"{latitude[first]:.5f}, {longitude[first]:.5f}"
    if void.all() or (count > 0 and count >= _MOST_VOIDS * cells):
        raise TerrainError(
            f"{name} has {count} voids among {cells} cells{where}, the first at latitude, "
            f"longitude {place}; less than {_MOST_VOIDS:.0%} are allowed: fill them, for example "
            "with gdal_fillnodata, or choose bounds without voids."
        )
    everywhere = rows.size < _MOST_VOIDS * void.size
    filled = _filled(heights, void, void if everywhere else counting)
    outside = f", {rows.size - count} of them outside of the area needed" if where else ""
    return filled, f"{rows.size} voids filled, the first at {place}{outside}"


def _filled(heights: Array, void: NDArray[np.bool_], linear: NDArray[np.bool_]) -> Array:
    """Return heights with filled voids.

    Voids in the mask ``linear`` are interpolated linearly from the cells around them, if they lie
    between such cells. All other voids have the value of the nearest cell.
    """
    nearest = distance_transform_edt(void, return_distances=False, return_indices=True)
    filled = heights[tuple(nearest)]
    around = binary_dilation(linear, np.ones((3, 3))) & ~void
    sources, targets = np.argwhere(around), np.argwhere(linear)
    if len(np.unique(sources[:, 0])) > 1 and len(np.unique(sources[:, 1])) > 1:
        between = griddata(sources, heights[around], targets, method="linear")
        inside = np.isfinite(between)
        filled[tuple(targets[inside].T)] = between[inside]
    return filled
