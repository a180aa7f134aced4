"""Files as they arrive damaged: bytes flipped, lines lost, numbers, units and encodings changed."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

_NUMBER = re.compile(rb"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_][A-Za-z_0-9]{2,}")
_NUMBERS = (
    *b"nan NaN inf -inf 1e308 -1e308 1e-320 0 -0.0 -1".split(),
    b"",
    *b"abc 1,5 --5 1e400".split(),
    b"9" * 400,
    *b"1.5.2 0x10 1_000".split(),
    "٣".encode(),
    *b"true [1] 1e999999999 2147483648 -9223372036854775809 99999 1.09-101".split(),
    b'"7"',
    b"360",
    b"180",
)
_WORDS = (
    *b"m ft km deg rad mGal E down up time_s latitude_deg height_m".split(),
    *b"heading_deg x".split(),
    b"",
    b"time_ms",
    "höhe".encode("latin-1"),
    *b"NaN end_of_head free-air bouguer zero_tide gfct WGS84 source kind".split(),
)
_SEPARATORS = (b", ", b";", b"\t", b" ", b"|", b"=", b":")


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """Return a content with one to three kinds of damage."""
    for _ in range(int(rng.integers(1, 4))):
        content = _DAMAGES[int(rng.integers(len(_DAMAGES)))](content, rng)
    return content


def _flipped(content: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(content)
    for _ in range(int(rng.integers(1, 9)) if content else 0):
        changed[int(rng.integers(len(changed)))] = int(rng.integers(256))
    return bytes(changed)


def _cut(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: int(rng.integers(len(content) + 1))]


def _slice(content: bytes, rng: np.random.Generator) -> tuple[int, int]:
    first, last = sorted(rng.integers(0, len(content) + 1, 2).tolist())
    return first, min(last, first + 2000)


def _without_slice(content: bytes, rng: np.random.Generator) -> bytes:
    first, last = _slice(content, rng)
    return content[:first] + content[last:]


def _doubled_slice(content: bytes, rng: np.random.Generator) -> bytes:
    first, last = _slice(content, rng)
    return content[:last] + content[first:]


def _lines(content: bytes, rng: np.random.Generator) -> bytes:
    """Delete, repeat or exchange lines, more often at the beginning."""
    lines = content.split(b"\n")
    one, other = (int(len(lines) * rng.random() ** 3) for _ in range(2))
    action = int(rng.integers(3))
    if action == 0:
        del lines[one]
    elif action == 1:
        lines.insert(other, lines[one])
    else:
        lines[one], lines[other] = lines[other], lines[one]
    return b"\n".join(lines)


def _separators(content: bytes, rng: np.random.Generator) -> bytes:
    one, other = rng.choice(len(_SEPARATORS), 2, replace=False)
    return content.replace(_SEPARATORS[one], _SEPARATORS[other])


def _replaced(pattern: re.Pattern[bytes], by: tuple[bytes, ...]):
    """Return a damage that puts something else in the place of a match, rather an early one."""

    def damage(content: bytes, rng: np.random.Generator) -> bytes:
        found = [*pattern.finditer(content[:20000])]
        if not found:
            return content
        match = found[int(len(found) * rng.random() ** 2)]
        return content[: match.start()] + by[int(rng.integers(len(by)))] + content[match.end() :]

    return damage


def _scaled(content: bytes, rng: np.random.Generator) -> bytes:
    """Multiply every number of a text in its first lines, as a change of units does."""
    factor = float(rng.choice([1e-3, 1e3, 0.3048, 57.29578, 1e6, -1.0]))

    def scale(match: re.Match[bytes]) -> bytes:
        return repr(float(match[0]) * factor).encode() if len(match[0]) < 30 else match[0]

    return _NUMBER.sub(scale, content, count=int(rng.integers(1, 500)))


def _encoded(content: bytes, rng: np.random.Generator) -> bytes:
    text = content.decode("latin-1")
    ways = (
        lambda: text.encode("utf-16"),
        lambda: text.encode("utf-8"),
        lambda: b"\xef\xbb\xbf" + content,
        lambda: content.replace(b"\n", b"\r"),
        lambda: content.replace(b"\n", b"\r\n"),
        lambda: content.replace(b".", b", "),
        lambda: b"\x00" + content,
        lambda: b"",
        lambda: content.upper(),
        lambda: content.replace(b"\n", b""),
    )
    return ways[int(rng.integers(len(ways)))]()


_DAMAGES = (
    _flipped,
    _cut,
    _without_slice,
    _doubled_slice,
    _lines,
    _separators,
    _scaled,
    _encoded,
    _replaced(_NUMBER, _NUMBERS),
    _replaced(_NUMBER, _NUMBERS),
    _replaced(_WORD, _WORDS),
)


_ODD = (
    "",
    *["m", "ft", "km", "furlong", "mGal", "m/s2", "E", "degrees", "radians", "NaN", "é"],
    "metres above sea level",
    *["down", "up", "sideways", "depth", "latitude", "longitude", "projection_x_coordinate"],
    5,
    -1.0,
    0,
    np.nan,
    np.inf,
    np.array([1.0, 2.0]),
    np.int8(3),
)
_ATTRIBUTES = (
    "units",
    "positive",
    "standard_name",
    "long_name",
    "scale_factor",
    "add_offset",
    "valid_min",
    "grid_mapping",
    "format",
    "calendar",
    "coordinates",
)
_OF_ARRAYS = (
    lambda a, rng: a.T,
    lambda a, rng: a.ravel(),
    lambda a, rng: a[..., :-1],
    lambda a, rng: a[:1],
    lambda a, rng: a[..., np.newaxis],
    lambda a, rng: a[..., ::-1],
    lambda a, rng: a[:0],
    lambda a, rng: a.ravel()[0] if a.size else a,
    lambda a, rng: np.full_like(a, np.nan),
    lambda a, rng: np.where(rng.random(a.shape) < 0.02, np.nan, a),
    lambda a, rng: np.where(rng.random(a.shape) < 0.02, np.inf, a),
    lambda a, rng: np.where(rng.random(a.shape) < 0.02, 9999.0, a),
    lambda a, rng: a * float(rng.choice([0.0, -1.0, 1e3, 1e-3, 1e300, 0.3048, 57.3])),
    lambda a, rng: a + float(rng.choice([360.0, 90.0, -180.0, 1e9])),
    lambda a, rng: a + 0j,
    lambda a, rng: a > 0.0,
    lambda a, rng: a.astype("U8"),
    lambda a, rng: a.astype(np.float16),
    lambda a, rng: np.round(a).astype(np.int64),
    lambda a, rng: rng.permutation(a) if a.ndim else a,
)


def mutated_arrays(
    arrays: dict[str, np.ndarray], attributes: dict[str, Any], rng: np.random.Generator
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return named arrays and attributes of one of them with one or two kinds of damage."""
    arrays, attributes = dict(arrays), dict(attributes)
    for _ in range(int(rng.integers(1, 3))):
        names = [*arrays]
        if not names:
            break
        name = names[int(rng.integers(len(names)))]
        action = int(rng.integers(6))
        if action == 0:
            del arrays[name]
        elif action == 1:
            other = ("x", "y", "lat", "lon", name.upper(), f"{name}2")[int(rng.integers(6))]
            arrays[other] = arrays.pop(name)
        elif action == 2:
            key = _ATTRIBUTES[int(rng.integers(len(_ATTRIBUTES)))]
            attributes[key] = _ODD[int(rng.integers(len(_ODD)))]
        else:
            change = _OF_ARRAYS[int(rng.integers(len(_OF_ARRAYS)))]
            with np.errstate(all="ignore"):
                arrays[name] = np.asarray(change(np.asarray(arrays[name]), rng))
    return arrays, attributes
