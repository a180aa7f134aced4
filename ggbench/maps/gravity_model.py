"""Reader of global gravity field models: files of spherical harmonic coefficients.

The formats are ``.gfc`` files of the International Centre for Global Earth Models (Barthelmes and
Förste 2011), plain or packed with gzip, zip or tar, and the shipped ``.npz`` file.
"""

from __future__ import annotations

import datetime
import functools
import io
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import text_of
from ..files.archives import from_tar, from_zip, gunzipped, read_arrays
from ..files.writing import content_of
from ..gravity.gradient_map import MapError
from ..gravity.harmonics import HarmonicCoefficients
from .gravity_epoch import static

MOST_DEGREE = 5600
"""Highest degree that is read; C and S then need 0.5 GB, a synthesis ten times as much."""

_FLOAT = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?"
_NORMS = ("fully_normalized", "unnormalized")
# The permanent tide in C20, k2 = 0.3 (Lemoine et al. 1998): zero-tide less tide-free.
_ZERO_TIDE_C20 = -4.1736e-9
_TIDE_PARTS = {
    "tide_free": 0.0,
    "zero_tide": 1.0,
    "mean_tide": 1.3 / 0.3,
    "unknown": 0.0,
    "does_not_apply": 0.0,
}
_APART = re.compile(r"[\s_-]+")  # of 'zero tide', 'zero-tide' and 'zero_tide'
_ROW = [("key", "U6"), ("n", int), ("m", int), ("c", float), ("s", float)]
_LEAST_ORDER = 0.95  # highest order, of the highest degree
_HEADER_BEGIN, _HEADER_END = "begin_of_head", re.compile(rb"^[ \t]*end_of_head", re.MULTILINE)
_NO_E = re.compile(rb"([\d.])([-+]\d{3})(?=\s|$)")  # Fortran's 1.09-101
_MOST_HEADER = 2**20
_GZIP, _ZIP, _TAR, _TAR_AT = b"\x1f\x8b", b"PK\x03\x04", b"ustar", 257
_SUFFIX = ".gfc"


@dataclass(frozen=True)
class GravityModel:
    """Name of a model, and coefficients of its whole potential (fully normalised, tide-free)."""

    name: str
    coefficients: HarmonicCoefficients


def read_model(
    path: Path, highest: int | None = None, epoch: datetime.date | None = None
) -> GravityModel:
    """Return the model of a ``.gfc`` file (plain or packed) or of an ``.npz`` file.

    An ``.npz`` file contains ``gm`` [m³/s²], ``r`` [m] and ``cs``: rows (C, S) in the order of
    degree n = 0, 1, ... and, within a degree, order m = 0..n. Degrees above ``highest`` are
    omitted. Time-variable coefficients are reduced to ``epoch``.

    Raises MapError if the file cannot be read or has another format; if coefficients are duplicate
    or missing; if ``highest`` is below 2 or above the degree of the model; if coefficients are
    time-variable and no epoch is given; if an epoch is given for static coefficients.
    """
    content = content_of(path, MapError, "the coefficients ")
    if path.suffix == ".npz":
        if epoch is not None:
            raise MapError(f"{path} is constant in time: remove --epoch.")
        model = _from_arrays(path, content)
    else:
        model = _from_text(path, _unpacked(path, content), highest, epoch)
    whole = model.coefficients
    if highest is not None:
        if not 2 <= highest <= whole.degree:
            raise MapError(
                f"{path} has degrees up to {whole.degree}: degree {highest} is not available; 2 "
                f"to {whole.degree} are allowed."
            )
        whole = whole.between(0, highest)
    return GravityModel(model.name, whole)


def _from_arrays(path: Path, content: bytes) -> GravityModel:
    arrays = read_arrays(content, MapError, str(path), ("cs", "gm", "r"))
    try:
        pairs = np.asarray(arrays["cs"], dtype=float)
        gm, radius = float(arrays["gm"]), float(arrays["r"])
    except Exception as error:  # whatever arrays of other kinds make of themselves
        raise MapError(
            f"{path} contains no coefficients: {text_of(error)}; the arrays cs, gm and r are "
            "needed."
        ) from None
    size = math.isqrt(2 * len(pairs))
    if pairs.ndim != 2 or pairs.shape[1] != 2 or size * (size + 1) // 2 != len(pairs):
        raise MapError(f"{path}: cs must have two columns and (N + 1)(N + 2)/2 rows.")
    cosine, sine = np.zeros((2, size, size))
    cosine[np.tril_indices(size)], sine[np.tril_indices(size)] = pairs.T
    return GravityModel(path.stem, _checked(path, gm, radius, cosine, sine))


def _from_text(
    path: Path, content: bytes, highest: int | None, epoch: datetime.date | None
) -> GravityModel:
    end = _HEADER_END.search(content, 0, _MOST_HEADER)
    if end is None:
        raise MapError(
            f"{path} is not a .gfc file of coefficients: its header has no line 'end_of_head'."
        )
    header = _header(content[: end.start()].decode(errors="replace"))
    start = content.find(b"\n", end.end()) + 1 or len(content)
    product = _first_word(header, "product_type", "gravity_field")
    if product != "gravity_field":
        raise MapError(f"{path}: product_type is {product!r}; only 'gravity_field' is allowed.")
    norm = _first_word(header, "norm", _NORMS[0])
    if norm not in _NORMS:
        raise MapError(f"{path}: norm is {norm!r}; allowed: {', '.join(_NORMS)}.")
    tide = _tide_part(path, header.get("tide_system", "unknown"))
    gm = _number(path, header, "earth_gravity_constant", "gravity_constant")
    radius = _number(path, header, "radius")
    declared = _number(path, header, "max_degree")
    if not (declared == int(declared) and declared >= 2):
        raise MapError(f"{path}: max_degree is {declared:g}; it must be a whole number from 2 on.")
    degree = int(min(declared, highest if highest is not None and highest >= 2 else declared))
    if degree > MOST_DEGREE:
        raise MapError(
            f"{path}: max_degree is {degree}; at most {MOST_DEGREE} is allowed: lower --max-degree."
        )
    intervals = _first_word(header, "format", "") == "icgem2.0"
    content = content[:start] + static(path, content[start:], intervals, epoch)
    cosine, sine = _body(path, content, start, degree, int(declared))
    if norm == "unnormalized":
        _normalise(path, cosine, sine)
    cosine[0, 0] = cosine[0, 0] or 1.0
    cosine[2, 0] -= tide * _ZERO_TIDE_C20
    name = _first_word(header, "modelname", path.name)
    return GravityModel(name, _checked(path, gm, radius, cosine, sine))


def _unpacked(path: Path, content: bytes) -> bytes:
    """Return the unpacked content of a file; of an archive, the content of its only model file."""
    only = functools.partial(_only, path)
    if content.startswith(_GZIP):
        content = gunzipped(content, MapError, str(path))
    if content.startswith(_ZIP):
        return from_zip(content, only, MapError, str(path))
    if content[_TAR_AT:].startswith(_TAR):
        return from_tar(content, only, MapError, str(path))
    return content


def _only(path: Path, files: list[str]) -> str:
    """Return the name of an archive's only file, or of its only ``.gfc`` file."""
    suited = files if len(files) == 1 else [name for name in files if name.endswith(_SUFFIX)]
    if len(suited) != 1:
        raise MapError(
            f"{path} is an archive of {len(files)} files with {len(suited)} files *{_SUFFIX}; "
            "exactly one is allowed: unpack it first."
        )
    return suited[0]


def _header(text: str) -> dict[str, str]:
    """Return the keys of the header and the text after each key; free text above is ignored."""
    pairs = (line.split(maxsplit=1) for line in text.rpartition(_HEADER_BEGIN)[2].splitlines())
    return {words[0].lower(): words[1].strip() for words in pairs if len(words) > 1}


def _first_word(header: dict[str, str], key: str, default: str) -> str:
    """Return the first word after a key; later words on the line are comments."""
    return header[key].split()[0] if key in header else default


def _tide_part(path: Path, stated: str) -> float:
    """Return the fraction of the permanent tide in C20 for a tide system in any spelling."""
    spelled = _APART.sub("_", stated.lower())
    for system, part in _TIDE_PARTS.items():
        if spelled.startswith(system):
            return part
    raise MapError(f"{path}: tide_system is {stated!r}; allowed: {', '.join(_TIDE_PARTS)}.")


def _number(path: Path, header: dict[str, str], *keys: str) -> float:
    for key in keys:
        if key in header:
            word = _first_word(header, key, "")
            if re.fullmatch(_FLOAT, word):
                return float(re.sub("[dD]", "e", word))
            raise MapError(
                f"{path}: {key} is {header[key]!r} and must be a number; free text is allowed "
                f"only before a line '{_HEADER_BEGIN}'."
            )
    raise MapError(f"{path}: its header lacks {keys[0]}.")


def _body(
    path: Path, content: bytes, start: int, degree: int, declared: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return C and S (degree + 1, degree + 1) from the lines after the header.

    ``start`` is the index of the first byte after the header. ``degree`` is the highest degree to
    return, ``declared`` the highest degree that the header states.
    """
    body = content[start:]
    if not body.strip():
        raise MapError(f"{path} has a header, but no coefficients.")
    # Fortran's 1.0D-6; the keywords come back as they were, but for their d.
    body = body.replace(b"D", b"E").replace(b"d", b"e")
    try:
        table = _table(body)
    except ValueError as error:
        try:
            table = _table(_NO_E.sub(rb"\1e\2", body))
        except ValueError:
            raise _bad_line(path, content, start, error) from None
    keys = set(np.unique(table["key"]).tolist())
    if keys != {"gfc"}:
        odd = sorted(keys - {"gfc"})[0]
        raise MapError(f"{path}: a line of coefficients begins with {odd!r}; it must be 'gfc'.")
    n, m = table["n"], table["m"]
    values = np.stack((table["c"], table["s"]), axis=-1)
    bad = ~np.isfinite(values).all(axis=1) | (m < 0) | (m > n) | (n > declared)
    if bad.any():
        line = " ".join(str(item) for item in table[np.argmax(bad)])
        raise MapError(
            f"{path}: {line!r} is not a coefficient: expected are gfc, degree up to {declared}, "
            "order up to the degree, C and S."
        )
    # Without S, the error of C would be taken for it.
    odd = (m == 0) & (values[:, 1] != 0.0)
    if odd.any():
        row = int(np.argmax(odd))
        raise MapError(
            f"{path}: 'gfc {n[row]} 0' has S = {values[row, 1]:g}, but S of order 0 is always 0: "
            "is the column S missing? A line has gfc, degree, order, C and S."
        )
    chosen = n <= degree
    n, m, values = n[chosen], m[chosen], values[chosen]
    count = np.zeros((degree + 1, degree + 1), dtype=np.int32)
    np.add.at(count, (n, m), 1)
    _require_once(path, count)
    cosine, sine = np.zeros((2, degree + 1, degree + 1))
    cosine[n, m], sine[n, m] = values.T
    return cosine, sine


def _table(body: bytes) -> NDArray[np.void]:
    """Return the rows of key, n, m, C and S; errors of the coefficients on a line are ignored."""
    return np.loadtxt(io.BytesIO(body), dtype=_ROW, usecols=range(5), encoding="latin-1", ndmin=1)


def _bad_line(path: Path, content: bytes, start: int, error: ValueError) -> MapError:
    """Return a MapError that states the first line without a valid coefficient."""
    above = content[:start].count(b"\n")
    number = rf"{_FLOAT}|[-+]?(nan|inf)"
    good = re.compile(rf"\w+\s+\d+\s+\d+\s+({number})\s+({number})(\s|$)", re.IGNORECASE)
    for index, line in enumerate(content[start:].decode("latin-1").split("\n")):
        if line.strip() and not good.match(_NO_E.sub(rb"\1e\2", line.strip().encode()).decode()):
            return MapError(
                f"{path}: line {above + index + 1}, {line.strip()[:60]!r}, cannot be read: a "
                "line of coefficients begins with gfc, degree, order, C and S."
            )
    return MapError(f"{path}: its coefficients cannot be read: {text_of(error)}")


def _require_once(path: Path, count: NDArray[np.int32]) -> None:
    """Raise MapError if a coefficient from degree 2 on is missing or duplicate.

    The highest order may be lower than the degree: EGM2008 ends at degree 2190 and order 2159.
    """
    if (count > 1).any():
        n, m = np.argwhere(count > 1)[0]
        raise MapError(f"{path} has the coefficient of degree {n} and order {m} more than once.")
    highest_order = int(np.flatnonzero(count.any(axis=0))[-1]) if count.any() else 0
    degree = len(count) - 1
    if highest_order < _LEAST_ORDER * degree:
        raise MapError(
            f"{path} ends at order {highest_order}, far below degree {degree}: is the file "
            "complete?"
        )
    needed = np.tril(np.ones(count.shape, dtype=bool))
    needed[:2], needed[:, highest_order + 1 :] = False, False
    if (needed & (count == 0)).any():
        n, m = np.argwhere(needed & (count == 0))[0]
        raise MapError(f"{path} lacks the coefficient of degree {n} and order {m}.")


def _normalise(path: Path, cosine: NDArray[np.float64], sine: NDArray[np.float64]) -> None:
    """Convert unnormalised coefficients to fully normalised coefficients, in place."""
    for n in range(len(cosine)):
        for m in range(n + 1):
            twice = 1.0 if m == 0 else 2.0
            log = math.lgamma(n + m + 1) - math.lgamma(n - m + 1)
            if log > 1000.0:
                raise MapError(
                    f"{path}: norm 'unnormalized' works to about degree 85; degree {n} and order "
                    f"{m} exceed double precision."
                )
            factor = math.exp(0.5 * log) / math.sqrt(twice * (2 * n + 1))
            cosine[n, m] *= factor
            sine[n, m] *= factor


def _checked(
    path: Path,
    gm: float,
    radius: float,
    cosine: NDArray[np.float64],
    sine: NDArray[np.float64],
) -> HarmonicCoefficients:
    """Return the coefficients; raise MapError if they are not those of the Earth in SI units."""
    if not (3.98e14 < gm < 3.99e14 and 6.3e6 < radius < 6.4e6):
        raise MapError(
            f"{path}: earth_gravity_constant {gm:g} and radius {radius:g} are not the Earth's in "
            "m³/s² and m."
        )
    if not (np.isfinite(cosine).all() and np.isfinite(sine).all()):
        raise MapError(f"{path} has coefficients that are not finite.")
    if len(cosine) < 3 or not -5.0e-4 < cosine[2, 0] < -4.7e-4:
        raise MapError(
            f"{path}: its coefficient of degree 2 and order 0 must be the Earth's, -4.84e-4; is "
            "the normal field removed already?"
        )
    return HarmonicCoefficients(gm, radius, cosine, sine)
