"""How each estimator is drawn: one table for all figures, whoever else is in them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple
from zlib import crc32

from .style import INS

_COLOURS = {
    "ekf": ("tab:blue", "navy", "deepskyblue", "slateblue", "cadetblue"),
    "ukf": ("tab:orange", "saddlebrown", "goldenrod", "lightsalmon"),
    "factor-graph": ("tab:green", "darkolivegreen", "limegreen", "teal", "yellowgreen"),
    "gaussian-sum": ("tab:red", "maroon"),
    "gauss-newton": ("tab:purple", "orchid"),
    "closed-loop": ("tab:cyan",),
    "particle": ("tab:brown",),
    "rao-blackwellised": ("tab:pink",),
    "unscented-particle": ("darkviolet",),
    "gaussian-particle": ("peru",),
}
"""Shades of each estimator; its variants take them in the order of the next table."""
_VARIANTS = {
    "ekf": ("", "iterations=5", "loss=cauchy", "loss=huber", "noise_memory=20"),
    "ukf": ("points=cubature", "points=julier", "points=merwe", "points=cubature,loss=cauchy"),
    "factor-graph": (
        "mode=batch",
        "mode=isam2",
        "mode=fixed-lag",
        "mode=batch,loss=cauchy",
        "mode=batch,engine=numba",
    ),
    "gaussian-sum": ("", "loss=cauchy"),
    "gauss-newton": ("", "loss=cauchy"),
    "closed-loop": ("",),
    "particle": ("",),
    "rao-blackwellised": ("",),
    "unscented-particle": ("",),
    "gaussian-particle": ("",),
}
_REDUCED = {
    "filter=ekf": "steelblue",
    "filter=particle": "crimson",
    "filter=gaussian-particle": "darkorange",
    "filter=unscented-particle": "mediumorchid",
    "filter=strong-tracking": "seagreen",
    "filter=strong-tracking,beta=3": "darkkhaki",
}
"""Colours of filters of some of the states; which noise they are told, line and marker say."""
_NOISES = ("1e-07", "1e-06", "1e-05", "0.0001", "0.001", "0.01")
_OTHERS = ("deeppink", "chocolate", "olive", "tan", "mediumaquamarine", "rosybrown")
"""Colours of estimators that the package does not know: neither the INS's nor the bound's."""
_LINES = ("-", "--", "-.", ":")
_MARKERS = {
    "ekf": "osphH",
    "ukf": "D^v<",
    "factor-graph": "PX*dh",
    "gaussian-sum": "><",
    "gauss-newton": "8p",
    "closed-loop": "*",
    "particle": "o",
    "rao-blackwellised": "P",
    "unscented-particle": "X",
    "gaussian-particle": "s",
}
_OTHER_MARKERS = "os^vD"


class Look(NamedTuple):
    """How an estimator is drawn: Matplotlib's names of a colour, a line and a marker."""

    color: str
    ls: str
    marker: str


def looks(labels: Iterable[str]) -> dict[str, Look]:
    """Return how each estimator is drawn: the same in every figure, whoever stands beside it.

    One that the package does not know gets what its label says by a hash, and something else only
    if another one in the same figure has that already.
    """
    labels = list(dict.fromkeys(labels))
    drawn = {label: look for label in labels if (look := _known(label)) is not None}
    taken = set(drawn.values())
    for label in labels:
        if label not in drawn:
            choices = _choices(label)
            drawn[label] = next((look for look in choices if look not in taken), choices[0])
            taken.add(drawn[label])
    return {label: drawn[label] for label in labels}


def _known(label: str) -> Look | None:
    if label == "ins":
        return Look(INS, "-", "x")
    name, _, variant = label.removesuffix("]").partition("[")
    if name == "reduced":
        return _known_reduced(variant)
    if variant not in _VARIANTS.get(name, ()):
        return None
    number = _VARIANTS[name].index(variant)
    return Look(_COLOURS[name][number], _LINES[number % 4], _MARKERS[name][number])


def _known_reduced(variant: str) -> Look | None:
    noise = next((part for part in variant.split(",") if part.startswith("noise=")), "")
    rest = ",".join(part for part in variant.split(",") if part != noise)
    value = noise.removeprefix("noise=")
    if rest not in _REDUCED or value not in _NOISES:
        return None
    number = _NOISES.index(value)
    return Look(_REDUCED[rest], _LINES[number % 4], "os^vD*"[number])


def _choices(label: str) -> list[Look]:
    """All looks of an estimator that is in no table, those first that its label says."""
    name = label.partition("[")[0]
    shades = _COLOURS.get(name, _OTHERS)
    number = crc32((label if name in _COLOURS else name).encode())
    line = crc32(label.encode())
    return [
        Look(
            shades[(number + shade) % len(shades)],
            _LINES[(line + style) % 4],
            _OTHER_MARKERS[(line + style) % len(_OTHER_MARKERS)],
        )
        for shade in range(len(shades))
        for style in range(4)
    ]
