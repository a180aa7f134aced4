"""Surveys that were flown, as sources of maps: the point masses that reproduce their lines.

``studies/measured_surveys`` finds the masses from the lines, as ``ggbench map build --lines`` does.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import text_of
from ..gravity.gradient_map import MapError
from .equivalent_sources import EquivalentSources, Plane
from .netcdf import Errors, Nodes
from .shipped_regions import data_bytes, read_arrays

Array = NDArray[np.floating]

_MARGIN_DEG = 0.05  # around the lines: there a map is continued by the masses at their edge
_LEAST_CLEARANCE = 0.25  # of the depth of the masses: below, each of them is seen
_HIGHEST_M = 5000.0
KEYS = ("plane", "places", "masses", "standard_error", "error_distance", "bounds", "depth_m")
"""Arrays of a file: latitude and longitude [deg]; see :class:`EquivalentSources` and
:class:`ggbench.gravity.gradient_map.GradientMap`; south, north, west, east of the lines [deg]."""


@dataclass(frozen=True)
class SurveySource:
    """A survey among the package's data: the file of its masses, and where it comes from."""

    file: str
    provenance: str


SURVEYS = {
    "vinton2008": SurveySource(
        "measured/vinton2008_masses.npz",
        "airborne gradiometry of Vinton Dome, Louisiana (Bell Geospace, July 2008), the flights of "
        "3 to 5 July, by point masses",
    ),
    "fosterville2019": SurveySource(
        "measured/fosterville2019_masses.npz",
        "airborne gradiometry of Fosterville, Victoria (Falcon, February 2019), every other line, "
        "by point masses",
    ),
    "east_victoria2023": SurveySource(
        "measured/east_victoria2023_masses.npz",
        "airborne gravimetry of one line of East Victoria (AIRGrav, Sander Geophysics, 2023), five "
        "of ten passes, by point masses",
    ),
}
"""Surveys by the name that a recipe uses."""


def survey_disturbing_field(
    name: str, latitude: Array, longitude: Array, height: Array
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the field of a survey's masses on latitude x longitude x height.

    The tensor, (n_lat, n_lon, n_h, 6) [E], and the gravity disturbance, (n_lat, n_lon, n_h, 3)
    [m/s²]. Raises MapError if the file of the masses is damaged.
    """
    stored = _stored(name)
    plane = Plane(*map(float, stored["plane"]))
    sources = EquivalentSources(plane, stored["places"], stored["masses"])
    nodes = Nodes(np.degrees(latitude), np.degrees(longitude), height)
    tensors, disturbances = zip(*sources.layers(nodes), strict=True)
    return np.stack(tensors, axis=2), np.stack(disturbances, axis=2)


def survey_errors(name: str) -> Errors:
    """Return the standard errors of a survey's map and the distances of their correlation."""
    stored = _stored(name)
    return stored["standard_error"], stored["error_distance"]


def survey_extent_deg(name: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return latitudes and longitudes, each from and to [deg], between which a map may lie."""
    south, north, west, east = map(float, _stored(name)["bounds"])
    return (south - _MARGIN_DEG, north + _MARGIN_DEG), (west - _MARGIN_DEG, east + _MARGIN_DEG)


def survey_heights_m(name: str) -> tuple[float, float]:
    """Return the lowest and the highest height of a map [m]."""
    clearance = _LEAST_CLEARANCE * float(_stored(name)["depth_m"])
    return float(np.ceil(highest_mass_m(name) + clearance)), _HIGHEST_M


def highest_mass_m(name: str) -> float:
    """Return the height of the highest mass [m]."""
    return float(_stored(name)["places"][2].max())


@lru_cache(maxsize=4)
def _stored(name: str) -> dict[str, Any]:
    file = SURVEYS[name].file
    try:
        return {
            key: value.astype(float) for key, value in read_arrays(data_bytes(file), KEYS).items()
        }
    except MapError:
        raise
    except Exception as error:
        raise MapError(
            f"Data file {file} of ggbench.scenarios is damaged ({text_of(error)}); it must "
            f"hold the arrays {', '.join(KEYS)}: install the package again."
        ) from error
