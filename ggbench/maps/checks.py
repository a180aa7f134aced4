"""Validation of map files: size, values and attributes."""

from __future__ import annotations

import math
import unicodedata

import numpy as np
from numpy.typing import NDArray

from ..gravity.gradient_map import MapError

_BYTES_PER_NODE = 9 * 8
MOST_NODES_READ = 20_000_000
"""Largest number of nodes in memory at the same time: 1.4 GB, and twice that for a spline."""
MOST_NODES = 10_000_000_000
"""Largest number of nodes of a file that is read by layers: 720 GB in double precision."""
MOST_ON_AXIS = 1_000_000
LARGEST_GRADIENT = 1e4
"""Largest allowed component of a disturbing gradient [E]. At the surface of the ground the gradient
changes by 4 pi G rho: 2240 E for rock. Only a density near that of osmium (19000 E)
would exceed the limit."""
LARGEST_DISTURBANCE = 0.1
"""Largest allowed component of a gravity disturbance [m/s²], ten times that of mountains."""
_MOST_TEXT = 4000
_TRACE_SHARE, _TRACE = 1e-5, 1e-3
"""Largest allowed trace of a tensor: as a fraction of the largest component, and in E.

The larger of the two limits applies. They allow for rounding in single precision, also if a
remaining field is the difference of fields a thousand times as large.
"""
_SI = 1e-9 * LARGEST_GRADIENT
_HIDDEN = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}


def require_size(what: str, shape: tuple[int, ...], most: int) -> None:
    """Raise MapError if a map of this shape has more than ``most`` nodes.

    ``what`` is the subject of the message.
    """
    nodes = math.prod(map(int, shape))
    if nodes > most:
        raise MapError(
            f"{what} has {nodes} nodes in the area needed ({' x '.join(map(str, shape))}), "
            f"{nodes * _BYTES_PER_NODE / 1e9:.3g} GB in memory; at most {most} "
            f"({most * _BYTES_PER_NODE / 1e9:.3g} GB) are allowed: use a smaller area "
            "or a wider spacing."
        )


def require_possible(
    what: str, tensor: NDArray[np.floating], disturbance: NDArray[np.floating]
) -> None:
    """Raise MapError if the values of a map are impossible for a disturbing field.

    Parameters
    ----------
    what : the map, as subject of the message.
    tensor : (..., 6) disturbing tensor [E].
    disturbance : (..., 3) gravity disturbance [m/s²].
    """
    largest = _largest(tensor)
    if largest > LARGEST_GRADIENT:
        raise MapError(
            f"{what}: its largest gradient is {largest:.3g} E; at most {LARGEST_GRADIENT:g} E "
            "are allowed: correct the values or the unit."
        )
    if 0.0 < largest < _SI:
        raise MapError(
            f"{what}: its largest gradient is only {largest:.3g} E; the values seem to be in "
            "s⁻²: multiply the gradients by 1e9."
        )
    strongest = _largest(disturbance)
    if strongest > LARGEST_DISTURBANCE:
        raise MapError(
            f"{what}: its largest gravity disturbance is {strongest:.3g} m/s²; at most "
            f"{LARGEST_DISTURBANCE:g} m/s² are allowed: correct the values or the unit (1 mGal "
            "is 1e-5 m/s²)."
        )
    trace = _largest(tensor[..., 0] + tensor[..., 3] + tensor[..., 5])
    rounding = max(_TRACE_SHARE * largest, _TRACE)
    if trace > rounding:
        raise MapError(
            f"{what}: EE + NN + UU reaches {trace:.3g} E and must be zero outside masses; "
            f"rounding allows {rounding:.3g} E."
        )


def clean_text(text: str) -> str:
    """Return an untrusted text without control characters and with limited length."""
    clean = text[:_MOST_TEXT]
    clean = "".join("�" if unicodedata.category(c) in _HIDDEN else c for c in clean.strip())
    return clean if len(text) <= _MOST_TEXT else f"{clean}… ({len(text)} characters)"


def _largest(values: NDArray[np.floating]) -> float:
    """Return the largest magnitude without copying the values."""
    return max(float(values.max()), -float(values.min()))
