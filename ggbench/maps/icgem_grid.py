"""Reader of grid files (``.gdf``) of ICGEM's calculation service."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import text_of
from ..gravity.ellipsoid import SEMI_MAJOR_AXIS
from ..gravity.gradient_map import MapError

Array = NDArray[np.floating]

_NEAR_M = 1.0  # by which the radius of a system may differ: EGM96's by 0.7 m
_KINDS = {
    **dict.fromkeys(("geoid", "height_anomaly", "height_anomaly_ell"), "geoid"),
    **dict.fromkeys(("gravity_anomaly", "gravity_anomaly_cl", "gravity_anomaly_sa"), "anomaly"),
    **dict.fromkeys(("gravity_disturbance", "gravity_disturbance_sa"), "disturbance"),
}
"""Kind of grid by ICGEM's name of the functional."""


class ReadGrid(NamedTuple):
    """Content of a grid file.

    Attributes
    ----------
    latitude, longitude : coordinates of the nodes (n_lat,), (n_lon,) [deg], in any order.
    values : (n_lat, n_lon), NaN for gaps.
    remarks : texts on assumptions about the content.
    height_m : height of the values above the ellipsoid; None if not stated.
    is_height_anomaly : whether the file states that its values are height anomalies.
    """

    latitude: Array
    longitude: Array
    values: Array
    remarks: tuple[str, ...] = ()
    height_m: float | None = None
    is_height_anomaly: bool = False


def read_icgem(path: Path, kind: str) -> tuple[ReadGrid, str]:
    """Return the grid of a ``.gdf`` file and the unit of its values.

    ``kind`` is ``geoid``, ``anomaly`` or ``disturbance``. The unit is empty if the header states
    none.

    Raises MapError if the file has another format, or its header states another quantity.
    """
    text = path.read_text(errors="replace")
    head, _, body = text.partition("end_of_head")
    header = {words[0]: words[1] for words in map(str.split, head.splitlines()) if len(words) > 1}
    functional = header.get("functional", "").lower()
    _require_kind(path, functional, kind)
    try:
        rows = np.loadtxt(body.splitlines()[1:], ndmin=2)
        shape = int(header["latitude_parallels"]), int(header["longitude_parallels"])
        grid = rows.reshape(*shape, rows.shape[1])
        height = float(header.get("height_over_ell", 0.0)) if kind != "geoid" else 0.0
        gap = float(header.get("gapvalue", "nan"))
        radius = float(header.get("radiusrefsys", SEMI_MAJOR_AXIS))
    except (ValueError, KeyError, IndexError) as error:
        raise MapError(f"{path} is not a grid in the format of ICGEM: {text_of(error)}.") from None
    if abs(radius - SEMI_MAJOR_AXIS) > _NEAR_M:
        raise MapError(
            f"{path} refers to an ellipsoid of radius {radius:g} m; WGS84 and GRS80, "
            f"{SEMI_MAJOR_AXIS:g} m, are allowed."
        )
    if grid.shape[2] != 3 and kind != "geoid":
        raise MapError(
            f"{path} has values on the topography; values at one height above the ellipsoid are "
            "needed."
        )
    read = ReadGrid(
        grid[:, 0, 1],
        grid[0, :, 0],
        np.where(grid[:, :, -1] == gap, np.nan, grid[:, :, -1]),
        () if functional else (f"{path.name} states no functional; --{kind} is assumed",),
        height,
        functional.startswith("height_anomaly"),
    )
    return read, header.get("unit", "")


def _require_kind(path: Path, functional: str, kind: str) -> None:
    """Raise MapError if a header's functional differs from the ``kind`` stated by the user."""
    stated = _KINDS.get(functional)
    if not functional or stated == kind:
        return
    if stated is not None:
        raise MapError(
            f"{path}: its functional is {functional}, not a {kind}: give the file as --{stated}."
        )
    reason = ""
    if functional in ("gravity_anomaly_bg", "gravity_anomaly_csb"):
        reason = " (Bouguer anomalies exclude the attraction of the rock)"
    raise MapError(
        f"{path}: a map cannot be built from its functional {functional}{reason}; allowed are "
        f"{', '.join(_KINDS)}."
    )
