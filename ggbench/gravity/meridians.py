"""Longitudes modulo whole turns, and areas that may cross the date line.

Longitudes of 275.7° and −84.3° are equal, as are 181° and −179°. Before a comparison, :func:`turns`
gives the whole turns to add to a longitude. The sum is *in the turn of* another longitude: the two
differ by at most half a turn.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.floating]

_REGULAR = 0.02  # of a step: more than coordinates in single precision are off


def turns(longitude: ArrayLike, about: ArrayLike, turn: float = 360.0) -> Any:
    """Return the multiple of a turn that shifts ``longitude`` to within half a turn of ``about``.

    Arguments and result are in degrees, or in the unit of ``turn``. For NaN the result is 0.
    """
    count = np.rint((np.asarray(about) - longitude) / turn)
    return turn * np.where(np.isfinite(count), count, 0.0)[()]


def eastern(west: float, east: float) -> float:
    """Return an eastern bound [deg], shifted by whole turns to the east of a western bound.

    Example: 181 for the western bound 179 and the eastern bound −179. If the area would then be
    wider than half a turn, the bound is unchanged. Such an area goes around the Earth, or its
    bounds are in the wrong order.
    """
    further = east - 360.0 * np.floor((east - west) / 360.0)
    return float(further) if 0.0 < further - west <= 180.0 else east


def rolled(values: Array, west: float, step: float, about: float) -> tuple[Array, float]:
    """Return a global grid (n_lat, n_lon) that begins half a turn west of a meridian.

    The columns are rolled in longitude. The second result is the new first longitude [deg]. Grids
    that do not go around the Earth are unchanged.

    Parameters
    ----------
    values : (n_lat, n_lon) values of the grid.
    west, step : first longitude and spacing of the columns [deg].
    about : longitude of the meridian [deg].
    """
    around = round(360.0 / step)
    if values.shape[1] < around or abs(around * step - 360.0) > _REGULAR * step:
        return values, west
    shift = round((about - 180.0 - west) / step)
    return np.roll(values[:, :around], -shift, axis=1), west + shift * step


class Area(NamedTuple):
    """Bounds of an area [deg]; longitudes are defined up to whole turns; None: no limit."""

    south: float | None = None
    north: float | None = None
    west: float | None = None
    east: float | None = None

    def about(self, longitude: float) -> Area:
        """Return the area, shifted by whole turns to a place near a longitude [deg].

        The middle of the area is then within half a turn of the longitude. If the area has only one
        limit in longitude, this limit is within half a turn.
        """
        west, east = self.west, self.east
        if west is not None and east is not None:
            east = eastern(west, east)
            turn = float(turns(0.5 * (west + east), longitude))
            return self._replace(west=west + turn, east=east + turn)
        west, east = (s if s is None else s + float(turns(s, longitude)) for s in (west, east))
        return self._replace(west=west, east=east)

    def widened(self, latitude: float, longitude: float) -> Area:
        """Return the area with its limits moved outwards by margins [deg].

        ``latitude`` is the margin to the north and to the south. ``longitude`` is the margin to the
        east and to the west.
        """
        added = (-latitude, latitude, -longitude, longitude)
        return Area(*(s if s is None else s + a for s, a in zip(self, added, strict=True)))

    def within(self, latitude: Array, longitude: Array) -> Area:
        """Return the intersection of the area with the bounding box of positions (N,) [deg].

        A side without a limit becomes the side of the bounding box.
        """
        bounds = latitude.min(), latitude.max(), longitude.min(), longitude.max()
        pick = (max, min, max, min)
        return Area(
            *(
                float(bound if side is None else inner(side, bound))
                for side, bound, inner in zip(self, bounds, pick, strict=True)
            )
        )

    def holds(self, latitude: Array, longitude: Array) -> NDArray[np.bool_]:
        """Return a mask (...) of the positions within the area.

        Parameters
        ----------
        latitude, longitude : positions [deg], with shapes that broadcast to (...). Longitudes are
            compared without whole turns, so shift the area by :meth:`about` first.
        """
        inside = np.ones(np.broadcast(latitude, longitude).shape, dtype=bool)
        for values, low, high in ((latitude, *self[:2]), (longitude, *self[2:])):
            inside &= (-math.inf if low is None else low) <= values
            inside &= values <= (math.inf if high is None else high)
        return inside
