"""Sources of maps that the package carries, declared in ``shipped.toml``.

A source is a list of parts, of the same kinds as a user's map. What is rebuilt from the EGM2008
geoid is not EGM2008's own field: over the Qinling mountains the two differ by some tenths of an E
rms, at sea by 0.03 E (README of the data).
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
    """Where a source has a field, and how far apart nodes may be.

    Attributes
    ----------
    latitudes, longitudes, heights : from and to [deg], [m above the ellipsoid].
    spacing : the rule of the spacings.
    """

    latitudes: tuple[float, float]
    longitudes: tuple[float, float]
    heights: tuple[float, float]
    spacing: SpacingRule


@dataclass(frozen=True)
class ShippedSource:
    """A source of maps among the package's data.

    Attributes
    ----------
    provenance : where the data come from, in words.
    highest_m : highest height of a map above the ellipsoid [m].
    parts : whose sum is the field.
    declaration : the source as it stands in ``shipped.toml``.
    """

    provenance: str
    highest_m: float
    parts: tuple[ShippedPart, ...]
    declaration: str = ""

    @property
    def options(self) -> frozenset[str]:
        """Fields of :class:`PartOptions` that some part follows."""
        return frozenset().union(*(part.options for part in self.parts))

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the data files, each once."""
        return tuple(dict.fromkeys(name for part in self.parts for name in part.files))

    @property
    def errors(self) -> Errors | None:
        """Standard errors of a map of one part, if they are known; of a sum they never are."""
        return self.parts[0].errors() if len(self.parts) == 1 else None

    def loaded(self, options: PartOptions) -> tuple[Part, ...]:
        """Return the parts of a map. Raises MapError for data that are missing or damaged."""
        return tuple(part.part(options) for part in self.parts)

    def described(self, options: PartOptions) -> str:
        """Return where a map comes from, in words."""
        notes = (part.note(options) for part in self.parts)
        return "; ".join(filter(None, (self.provenance, *notes)))

    def limits(self) -> Limits:
        """Return the limits of all parts. Raises MapError as :meth:`loaded` does."""
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
    """Return a source of a table of ``shipped.toml``."""
    parts = (dict(part) for part in table["part"])
    return ShippedSource(
        provenance=table["provenance"],
        highest_m=table["highest_m"],
        parts=tuple(KINDS[part.pop("kind")](**part) for part in parts),
        declaration=json.dumps(table, sort_keys=True),
    )


SOURCES = {name: _source(table) for name, table in tomllib.loads(_SPEC.read_text("utf-8")).items()}
"""Sources by the name that a recipe uses."""
