"""Shipped sources of maps, declared in ``shipped.toml``.

A source is a list of parts of the same kinds as in users' maps. A field computed from the EGM2008
geoid differs from the field of the EGM2008 coefficients. The RMS difference is some tenths of an E
over the Qinling mountains and 0.03 E at sea (README of the data).
"""

from __future__ import annotations

import importlib.resources
import json
import tomllib
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .netcdf import Errors
from .parts import Part
from .shipped_parts import KINDS, PartOptions, ShippedPart, SpacingRule

_SPEC = importlib.resources.files(__package__) / "shipped.toml"


class Limits(NamedTuple):
    """Valid region of a source, and limits of the node spacing.

    Attributes
    ----------
    latitudes, longitudes, heights : lower and upper limits [deg], [m above the ellipsoid].
    spacing : largest distances between nodes, as fractions of heights.
    """

    latitudes: tuple[float, float]
    longitudes: tuple[float, float]
    heights: tuple[float, float]
    spacing: SpacingRule


@dataclass(frozen=True)
class ShippedSource:
    """Source of maps among the data files of the package.

    Attributes
    ----------
    provenance : source of the data, in words.
    highest_m : highest height of a map above the ellipsoid [m].
    parts : parts of the field; the field is their sum.
    declaration : entry of the source in ``shipped.toml``.
    """

    provenance: str
    highest_m: float
    parts: tuple[ShippedPart, ...]
    declaration: str = ""

    @property
    def options(self) -> frozenset[str]:
        """Names of the fields of :class:`PartOptions` that affect a part of the source."""
        return frozenset().union(*(part.options for part in self.parts))

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the data files of all parts, without duplicates."""
        return tuple(dict.fromkeys(name for part in self.parts for name in part.files))

    @property
    def errors(self) -> Errors | None:
        """Standard errors of a map, if known; they are unknown for a sum of several parts."""
        return self.parts[0].errors() if len(self.parts) == 1 else None

    def loaded(self, options: PartOptions) -> tuple[Part, ...]:
        """Load the data and return the parts of a map.

        Raises MapError if data are missing or damaged.
        """
        return tuple(part.part(options) for part in self.parts)

    def described(self, options: PartOptions) -> str:
        """Return a text on the source of a map's data, with the effect of the options."""
        notes = (part.note(options) for part in self.parts)
        return "; ".join(filter(None, (self.provenance, *notes)))

    def limits(self) -> Limits:
        """Return the region in which all parts are valid, and the limits of the node spacing.

        Raises MapError if data are missing or damaged.
        """
        extents = [part.extent() for part in self.parts]
        inner = np.array([1.0, -1.0, 1.0, -1.0])  # times a bound: the larger is further inside
        bounds = (inner * np.max([inner * e.bounds for e in extents], axis=0)).tolist()
        lowest = max(extent.floor_m for extent in extents)
        rules = [rule for part in self.parts if (rule := part.spacing())]
        return Limits(
            latitudes=(bounds[0], bounds[1]),
            longitudes=(bounds[2], bounds[3]),
            heights=(lowest, self.highest_m),
            spacing=max(rules, key=lambda rule: rule.ground_m),
        )


def _source(table: dict[str, Any]) -> ShippedSource:
    """Return the source that a table of ``shipped.toml`` declares."""
    parts = (dict(part) for part in table["part"])
    return ShippedSource(
        provenance=table["provenance"],
        highest_m=table["highest_m"],
        parts=tuple(KINDS[part.pop("kind")](**part) for part in parts),
        declaration=json.dumps(table, sort_keys=True),
    )


SOURCES = {name: _source(table) for name, table in tomllib.loads(_SPEC.read_text("utf-8")).items()}
"""Sources by the name that a recipe uses."""
