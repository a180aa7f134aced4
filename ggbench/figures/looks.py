"""How each estimator is drawn: one table for all figures, whoever else is in them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple
from zlib import crc32

from .style import INS

_COLOURS = {
    "ekf": (
        "tab:blue",
        "navy",
        "deepskyblue",
        "slateblue",
        "cadetblue",
        "dodgerblue",
        "lightblue",
    ),
    "ukf": (
        "tab:orange",
        "saddlebrown",
        "goldenrod",
        "lightsalmon",
        "orangered",
        "wheat",
    ),
    "factor-graph": (
        "tab:green",
        "darkolivegreen",
        "limegreen",
        "teal",
        "yellowgreen",
        "springgreen",
    ),
    "gaussian-sum": ("tab:red", "maroon"),
    "gauss-newton": ("tab:purple", "orchid"),
    "closed-loop": ("tab:cyan",),
    "particle": ("tab:brown", "sandybrown", "sienna"),
    "rao-blackwellised": (
        "tab:pink",
        "hotpink",
        "palevioletred",
        "mediumvioletred",
        "lightpink",
        "plum",
        "magenta",
    ),
    "unscented-particle": ("darkviolet", "mediumpurple"),
    "gaussian-particle": ("peru", "burlywood"),
    "correlation": (
        "royalblue",
        "cornflowerblue",
        "lightskyblue",
        "firebrick",
        "coral",
        "darkgoldenrod",
        "khaki",
    ),
    "tercom": (
        "darkcyan",
        "mediumturquoise",
        "darkseagreen",
        "darkgreen",
        "lightseagreen",
        "mediumseagreen",
    ),
    "sitan": ("rebeccapurple", "thistle"),
    "iccp": ("slategray",),
    "viterbi": ("tomato",),
}
"""Shades of each estimator; its variants take them in the order of the next table."""
_VARIANTS = {
    "ekf": (
        "",
        "iterations=5",
        "loss=cauchy",
        "loss=huber",
        "noise_memory=20",
        "gate=0.999",
        "underweighting=0.2",
    ),
    "ukf": (
        "points=cubature",
        "points=julier",
        "points=merwe",
        "points=cubature,loss=cauchy",
        "points=cubature,gate=0.999",
        "points=cubature,underweighting=0.2",
    ),
    "factor-graph": (
        "mode=batch",
        "mode=isam2",
        "mode=fixed-lag",
        "mode=batch,loss=cauchy",
        "loss=cauchy",
        "mode=fixed-lag,loss=cauchy",
    ),
    "gaussian-sum": ("", "loss=cauchy"),
    "gauss-newton": ("", "loss=cauchy"),
    "closed-loop": ("",),
    "particle": ("", "regularisation=1", "tempering=0.25,kernel=0.1"),
    "rao-blackwellised": (
        "",
        "tempering=0,kernel=0,jitter=0,straight=0,start=1",
        "jitter=0,straight=0",
        "straight=0",
        "jitter=1,straight=0",
        "kernel=0.5",
        "tempering=0,kernel=0",
    ),
    "unscented-particle": ("", "weights=likelihood"),
    "gaussian-particle": ("", "proposal=ekf"),
    "correlation": (
        "",
        "association=nearest",
        "association=reciprocal",
        "candidates=nodes,association=nearest",
        "candidates=nodes,association=reciprocal",
        "candidates=nodes,association=nearest,descending=false",
        "candidates=nodes,association=nearest,differenced=false",
    ),
    "tercom": (
        "",
        "criterion=mad,loss=cauchy",
        "fusion=kalman",
        "misfit=30",
        "window=60,longest=60",
        "loss=cauchy",
    ),
    "sitan": ("", "bank=auto,most=1000"),
    "iccp": ("",),
    "viterbi": ("",),
}
_DEFAULTS = {"factor-graph": "mode=isam2"}
"""What a label without a variant stands for, where a variant in the table says it."""
_REDUCED = {
    "filter=ekf": "steelblue",
    "filter=particle": "crimson",
    "filter=gaussian-particle": "darkorange",
    "filter=unscented-particle": "mediumorchid",
    "filter=unscented-particle,weights=likelihood": "lightsteelblue",
    "filter=unscented-particle,weights=exact": "indianred",
    "filter=strong-tracking": "seagreen",
    "filter=strong-tracking,beta=3": "darkkhaki",
}
"""Colours of filters of some of the states; which noise they are told, line and marker say."""
_NOISES = ("1e-07", "1e-06", "1e-05", "0.0001", "0.001", "0.01")
_PARTICLES = "particles", ("25", "100", "250", "300", "1000", "10000", "30000")
_SIZES = {
    "correlation": ("window", ("12", "30", "60")),
    **dict.fromkeys(("ekf", "ukf", "gaussian-sum", "factor-graph"), ("noise_scale", ("3", "10"))),
}
"""What an estimator may have more or fewer of, if not particles: its colour stays."""
_SIZE_MARKERS = "v^<>dDh"
_OTHERS = ("deeppink", "chocolate", "olive", "tan", "mediumaquamarine", "rosybrown")
"""Colours of estimators that the package does not know: neither the INS's nor the bound's."""
_NUMBER = re.compile(r"[-+.\de]+")
_LINES = ("-", "--", "-.", ":")
_MARKERS = {
    "ekf": "osphHdD",
    "ukf": "D^v<Xs",
    "factor-graph": "PX*dhp",
    "gaussian-sum": "><",
    "gauss-newton": "8p",
    "closed-loop": "*",
    "particle": "oHd",
    "rao-blackwellised": "PpD*<>d",
    "unscented-particle": "X8",
    "gaussian-particle": "s+",
    "correlation": "PXoshDd",
    "tercom": "*XhPds",
    "sitan": "s8",
    "iccp": "+",
    "viterbi": "p",
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
    # A fixed lag is as long as a scenario's readings ask for.
    variant = ",".join(part for part in variant.split(",") if not part.startswith("lag="))
    variant = variant or _DEFAULTS.get(name, "")
    if name == "reduced":
        return _known_reduced(variant)
    parameter, sizes = _SIZES.get(name, _PARTICLES)
    rest, size = _split(variant, parameter)
    if rest not in _VARIANTS.get(name, ()) or (size and size not in sizes):
        return None
    number = _VARIANTS[name].index(rest)
    if size:
        step = sizes.index(size)
        line = _LINES[(number + 1 + step % 3) % 4]  # another one than the plain estimator's
        return Look(_COLOURS[name][number], line, _SIZE_MARKERS[step])
    return Look(_COLOURS[name][number], _LINES[number % 4], _MARKERS[name][number])


def _split(variant: str, parameter: str) -> tuple[str, str]:
    """Return what a label says beside a parameter, and the parameter's value, "" for none."""
    parts = variant.split(",")
    named = next((part for part in parts if part.startswith(f"{parameter}=")), "")
    rest = ",".join(part for part in parts if part != named)
    return rest, named.removeprefix(f"{parameter}=")


def _known_reduced(variant: str) -> Look | None:
    rest, value = _split(variant, "noise")
    if rest not in _REDUCED or value not in _NOISES:
        return None
    number = _NOISES.index(value)
    return Look(_REDUCED[rest], _LINES[number % 4], "os^vD*"[number])


def _choices(label: str) -> list[Look]:
    """All looks of an estimator that is in no table, those first that its label says.

    Where that differs from one in the table by numbers alone, it keeps the colour of that one.
    """
    name = label.partition("[")[0]
    plain = _known(_without_numbers(label))
    shades = _COLOURS.get(name, _OTHERS) if plain is None else (plain.color,)
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


def _without_numbers(label: str) -> str:
    """Return a label without the parameters whose values are numbers."""
    name, _, variant = label.removesuffix("]").partition("[")
    words = [part for part in variant.split(",") if not _NUMBER.fullmatch(part.partition("=")[2])]
    return f"{name}[{','.join(words)}]"
