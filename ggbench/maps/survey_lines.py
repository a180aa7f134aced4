"""Lines of an airborne gravity survey in east-north-up axes, and selection of lines.

:mod:`.survey_files` reads the lines. Components are named like the channels of the gradiometer:
``xx`` is east-east, ``xz`` east-up, ``xx-yy`` half the difference of xx and yy.
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
"""Weights of the tensor [EE, EN, EU, NN, NU, UU] for each component, by name."""
DISTURBANCE = "disturbance"
"""The component of scalar gravity [mGal]: positive where gravity is stronger than normal."""
ANOMALY = "anomaly"
"""Name of free-air gravity anomalies in a file [mGal], which are converted to disturbances."""
Turn = Mapping[str, tuple[str, int]]
"""Change of axes: for each axis the parallel axis of another frame, and the sign."""
AXES: Mapping[str, Turn] = {
    "east-north-up": {"x": ("x", 1), "y": ("y", 1), "z": ("z", 1)},
    "east-north-down": {"x": ("x", 1), "y": ("y", 1), "z": ("z", -1)},
    "north-east-down": {"x": ("y", 1), "y": ("x", 1), "z": ("z", -1)},
}
"""Axes of a file: for each the parallel axis of east-north-up, and the sign."""
CONVENTIONS: tuple[Turn, ...] = tuple(
    {"x": (x, a), "y": (y, b), "z": ("z", c)}
    for x, y in ("xy", "yx")
    for a, b, c in ((1, 1, 1), (1, 1, -1), (1, -1, 1), (-1, 1, 1))
)
"""The eight axis conventions of a level tensor; east-north-up is the first.

Reversing all three axes leaves a tensor unchanged; of each such pair only one is listed.
"""
PRIMARY, TIE = "primary", "tie"


def zero_rows(measured: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the mask (N,) of missing samples, in which all gradients (N, c) are exactly 0.

    No gradiometer measures 0 in several components at once. A single component may be 0: for c = 1
    no sample is missing.
    """
    return np.asarray((measured == 0.0).all(axis=1) & (measured.shape[1] > 1))


@dataclasses.dataclass(frozen=True)
class SurveyLines:
    """Samples of survey lines, in the order of flight within each line.

    Attributes
    ----------
    names, kinds : name and kind of each line; a kind is ``primary``, ``tie``, ``repeat`` or another
        word from the file.
    line : (N,) index of the line of each sample.
    time_s : (N,) time of each sample.
    latitude_deg, longitude_deg, height_m : (N,) position of each sample; heights are above the
        ellipsoid.
    components : names of the measured components. They are keys of :data:`COMPONENTS`, or only
        :data:`DISTURBANCE`.
    values : (N, len(components)) measured gradients [E] in east-north-up axes, or gravity
        disturbances [mGal].
    dropped : number of samples omitted because of a missing value.
    remarks : texts on units and missing values.
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
        """Measured quantity: gradient or disturbance."""
        return "disturbance" if self.components == (DISTURBANCE,) else "gradient"

    @property
    def unit(self) -> str:
        """Unit of ``values``."""
        return "mGal" if self.quantity == "disturbance" else "E"

    def samples(self, index: int) -> NDArray[np.int64]:
        """Return the indices (N,) of the samples of the line ``index``."""
        return np.flatnonzero(self.line == index)

    def only(self, lines: Sequence[int]) -> SurveyLines:
        """Return a survey of only the lines with these indices, in the order of this survey."""
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
        """Return the indices of the lines that match any of the patterns.

        A pattern is the name of a line, a wildcard pattern such as ``*.1``, or a kind of line.

        Raises MapError if a pattern matches no line.
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
        """Return a survey without the lines that match a pattern, see :meth:`chosen`.

        Raises MapError if a pattern matches no line, or if no line remains.
        """
        out = self.chosen(patterns)
        if len(out) == len(self.names):
            raise MapError("--leave-out excludes all lines: no line remains for the map.")
        return self.only([index for index in range(len(self.names)) if index not in set(out)])


def in_our_axes(component: str, axes: str) -> tuple[str, int]:
    """Convert a component from a file's axes to east-north-up; return its new name and its sign.

    ``axes`` is a key of :data:`AXES`. Example: ``xz`` in the axes north, east, down is ``yz`` with
    the opposite sign, and ``xx-yy`` is ``xx-yy`` with the opposite sign.
    """
    return turned(component, AXES[axes])


def turned(component: str, turn: Turn) -> tuple[str, int]:
    """Return the name and the sign of a component in rotated or reflected axes.

    For each axis of the file, ``turn`` contains the parallel axis of the new system and a sign. The
    sign is −1 if the two axes have opposite directions, else 1.
    """
    if "-" in component:
        first, second = (f"{turn[pair[0]][0]}" * 2 for pair in component.split("-"))
        straight = f"{first}-{second}"
        return (straight, 1) if straight in COMPONENTS else (f"{second}-{first}", -1)
    letters, signs = zip(*(turn[letter] for letter in component), strict=True)
    return "".join(sorted(letters)), signs[0] * signs[1]


def axes_in_words(turn: Turn, names: tuple[str, str, str, str, str, str]) -> str:
    """Return a description of axes, such as ``x north, y east, z down``.

    ``names`` contains the names of the directions of x, y and z, then the names of the opposite
    directions.
    """
    order = "xyz"
    return ", ".join(
        f"{axis} {names[order.index(other) + (0 if sign > 0 else 3)]}"
        for axis, (other, sign) in turn.items()
    )


def _some(names: Sequence[str]) -> str:
    """Return a list of names as text; a long list is shortened to the first and the last names."""
    return ", ".join(names) if len(names) <= 8 else f"{', '.join(names[:6])}, ... {names[-1]}"
