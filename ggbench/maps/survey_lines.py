"""Lines of an airborne gravity survey in axes of ggbench, and their selection.

:mod:`.survey_files` reads them. Components have the names of the gradiometer's channels: ``xx`` is
east-east, ``xz`` east-up, ``xx-yy`` half the difference of xx and yy.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..gravity.gradient_map import MapError

Array = NDArray[np.float64]
Quantity = Literal["gradient", "disturbance", "anomaly"]

COMPONENTS = {
    "xx": (1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    "xy": (0.0, 1.0, 0.0, 0.0, 0.0, 0.0),
    "xz": (0.0, 0.0, 1.0, 0.0, 0.0, 0.0),
    "yy": (0.0, 0.0, 0.0, 1.0, 0.0, 0.0),
    "yz": (0.0, 0.0, 0.0, 0.0, 1.0, 0.0),
    "zz": (0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
    "xx-yy": (0.5, 0.0, 0.0, -0.5, 0.0, 0.0),
    "yy-zz": (0.0, 0.0, 0.0, 0.5, 0.0, -0.5),
    "zz-xx": (-0.5, 0.0, 0.0, 0.0, 0.0, 0.5),
}
"""What each component is of the tensor [EE, EN, EU, NN, NU, UU]."""
DISTURBANCE = "disturbance"
"""The component of scalar gravity [mGal]: positive where gravity is stronger than normal."""
ANOMALY = "anomaly"
"""Free-air gravity anomalies of a file [mGal], of which disturbances are made."""
Turn = Mapping[str, tuple[str, int]]
"""Which axis of another frame each axis is, and in which direction."""
AXES: Mapping[str, Turn] = {
    "east-north-up": {"x": ("x", 1), "y": ("y", 1), "z": ("z", 1)},
    "east-north-down": {"x": ("x", 1), "y": ("y", 1), "z": ("z", -1)},
    "north-east-down": {"x": ("y", 1), "y": ("x", 1), "z": ("z", -1)},
}
"""Axes of a file: which of ours, and in which direction, each of them is."""
CONVENTIONS: tuple[Turn, ...] = tuple(
    {"x": (x, a), "y": (y, b), "z": ("z", c)}
    for x, y in ("xy", "yx")
    for a, b, c in ((1, 1, 1), (1, 1, -1), (1, -1, 1), (-1, 1, 1))
)
"""The eight conventions in which a level tensor comes: ours first. All signs turned are none."""
PRIMARY, TIE = "primary", "tie"


@dataclasses.dataclass(frozen=True)
class SurveyLines:
    """Samples of survey lines, in the order of flight within each line.

    Attributes
    ----------
    names, kinds : of the lines; a kind is ``primary``, ``tie``, ``repeat`` or a word of the file.
    line : index of each sample's line, (N,).
    time_s : of each sample, (N,).
    latitude_deg, longitude_deg, height_m : of each sample, (N,); above the ellipsoid.
    components : names, see :data:`COMPONENTS`, or only :data:`DISTURBANCE`.
    values : (N, len(components)) [E], axes east, north, up; or [mGal].
    dropped : number of samples omitted because of a missing value.
    remarks : on units and missing values.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    line: NDArray[np.int64]
    time_s: Array
    latitude_deg: Array
    longitude_deg: Array
    height_m: Array
    components: tuple[str, ...]
    values: Array
    dropped: int = 0
    remarks: tuple[str, ...] = ()

    @property
    def quantity(self) -> Quantity:
        """Measured quantity."""
        return "disturbance" if self.components == (DISTURBANCE,) else "gradient"

    @property
    def unit(self) -> str:
        """Unit of the values."""
        return "mGal" if self.quantity == "disturbance" else "E"

    def samples(self, index: int) -> NDArray[np.int64]:
        """Return the indices (N,) of the samples of a line."""
        return np.flatnonzero(self.line == index)

    def only(self, lines: Sequence[int]) -> SurveyLines:
        """Return only some of the lines, in the same order."""
        numbers = sorted(lines)
        samples = np.isin(self.line, numbers)
        return dataclasses.replace(
            self,
            names=tuple(self.names[i] for i in numbers),
            kinds=tuple(self.kinds[i] for i in numbers),
            line=np.searchsorted(numbers, self.line[samples]),
            time_s=self.time_s[samples],
            latitude_deg=self.latitude_deg[samples],
            longitude_deg=self.longitude_deg[samples],
            height_m=self.height_m[samples],
            values=self.values[samples],
        )

    def chosen(self, patterns: Sequence[str]) -> list[int]:
        """Return the lines of patterns: a name, a pattern such as ``*.1``, or a kind.

        Raises MapError if a pattern names no line.
        """
        numbers: set[int] = set()
        for pattern in patterns:
            those = {
                index
                for index, (name, kind) in enumerate(zip(self.names, self.kinds, strict=True))
                if kind == pattern or fnmatchcase(name, pattern)
            }
            if not those:
                raise MapError(
                    f"no line has the name or kind {pattern!r}; the {len(self.names)} lines are "
                    f"{_some(self.names)}; kinds: {', '.join(sorted(set(self.kinds)))}."
                )
            numbers |= those
        return sorted(numbers)

    def without(self, patterns: Sequence[str]) -> SurveyLines:
        """Return the lines that match no pattern, see :meth:`chosen`.

        Raises MapError if a pattern names no line, or no line remains.
        """
        out = self.chosen(patterns)
        if len(out) == len(self.names):
            raise MapError("--leave-out excludes all lines: no line remains for the map.")
        return self.only([index for index in range(len(self.names)) if index not in set(out)])


def in_our_axes(component: str, axes: str) -> tuple[str, int]:
    """Return name and sign of a component of a file in axes of ggbench; see :func:`turned`.

    In axes north, east, down ``xz`` is ``yz`` with the opposite sign, and ``xx-yy`` changes its
    sign.
    """
    return turned(component, AXES[axes])


def turned(component: str, turn: Turn) -> tuple[str, int]:
    """Return name and sign of a component in other axes.

    ``turn`` contains, for each axis of the file, the parallel axis of the other system and its
    sign.
    """
    if "-" in component:
        first, second = (f"{turn[pair[0]][0]}" * 2 for pair in component.split("-"))
        straight = f"{first}-{second}"
        return (straight, 1) if straight in COMPONENTS else (f"{second}-{first}", -1)
    letters, signs = zip(*(turn[letter] for letter in component), strict=True)
    return "".join(sorted(letters)), signs[0] * signs[1]


def axes_in_words(turn: Turn, names: tuple[str, str, str, str, str, str]) -> str:
    """Return axes in words, as in ``x north, y east, z down``.

    ``names`` contains the directions of x, y and z, then the three opposite directions.
    """
    order = "xyz"
    return ", ".join(
        f"{axis} {names[order.index(other) + (0 if sign > 0 else 3)]}"
        for axis, (other, sign) in turn.items()
    )


def _some(names: Sequence[str]) -> str:
    """The first names and the last one, in words."""
    return ", ".join(names) if len(names) <= 8 else f"{', '.join(names[:6])}, ... {names[-1]}"
