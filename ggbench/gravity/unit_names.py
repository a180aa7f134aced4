"""Names of units in files, with the quantity and the factor to SI units."""

from __future__ import annotations

import math
import re
from typing import NamedTuple


class Unit(NamedTuple):
    """Unit of a quantity, with the factor to the SI unit."""

    quantity: str
    factor: float


_DEGREE = math.pi / 180.0
_US_FOOT = 1200.0 / 3937.0
_UNITS = {
    "length": {
        1.0: "m", 0.3048: "ft|internationalft", _US_FOOT: "us-ft|ftus|ussurveyft|ftus|usft",
        0.1: "dm|decim", 0.01: "cm", 1e-3: "mm", 1000.0: "km", 1852.0: "nmi|nauticalmile",
    },
    "gravity": {
        1.0: "m/s2|ms-2|mps2|ms2", 1e-5: "mgal|10-5m/s2", 1e-8: "ugal", 1e-2: "gal|cm/s2|cms-2",
        1e-6: "um/s2|ums-2|ums2|gu|g.u.|gravityunit|gravityunits",
        1e-3: "mm/s2|mms-2|mms2",
        1e-9: "nm/s2|nms-2|nms2", 9.80665: "g", 9.80665e-3: "mg", 9.80665e-6: "ug",
        0.3048: "ft/s2",
    },
    "gradient": {
        1e-9: "e|e.u.|eotvos|etvs|eotvosunit|eotvosunits|ns-2|n/s2|ns2|10-9s-2",
        1.0: "s-2|1/s2|/s2",
        1e-12: "me", 1e-6: "ke|us-2|10-6s-2", 1e-5: "mgal/m", 1e-8: "mgal/km|ugal/m",
    },
    "angle": {
        _DEGREE: "deg|degn|dege|degnorth|degeast|degtrue|ddeg|decimaldeg", 1.0: "rad",
        1e-3: "mrad", 1e-6: "urad", _DEGREE / 60.0: "arcmin|'", _DEGREE / 3600.0: "arcsec|as|\"",
        math.pi / 200.0: "gon|grad",
    },
    "time": {
        1.0: "s", 1e-3: "ms|msec", 1e-6: "us|usec", 1e-9: "ns|nsec", 60.0: "min", 3600.0: "h",
        86_400.0: "d|day|days",
    },
    "speed": {
        1.0: "m/s|ms-1|mps", 1e-2: "cm/s|cms-1", 1e-3: "mm/s|mms-1", 1.0 / 3.6: "km/h|kmh|kph",
        1852.0 / 3600.0: "kn", 0.3048: "ft/s|fps", 0.44704: "mph|mi/h", 0.3048 / 60.0: "ft/min",
    },
    "angular rate": {
        1.0: "rad/s|rads-1|radps", _DEGREE: "deg/s|degs-1|dps", _DEGREE / 3600.0: "deg/h",
        1e-3: "mrad/s",
    },
    "magnetic field": {1e-9: "nt|gamma|gammas", 1e-6: "ut", 1e-4: "gauss"},
    "magnetic gradient": {1e-9: "nt/m|ntm|ntm-1", 1e-12: "nt/km"},
    "density": {1.0: "kg/m3", 1e3: "g/cm3|g/cc"},
    "temperature": {1.0: "k|kelvin|degc|celsius"},
    "pressure": {1.0: "pa", 100.0: "hpa|mbar|millibar|millibars"},
    "counts": {1.0: "cps|counts|ngy/h"},
}  # fmt: skip
_WORDS = (
    (r"[μµ]", "u"), ("²", "2"), ("³", "3"), ("⁻", "-"), ("¹", "1"), ("ö", "o"), ("°", "deg"),
    (r"nautical mile", "nmi"), (r"\bmicro", "u"), (r"\bmilli(?!bar)", "m"), (r"\bnano", "n"),
    (r"\bcenti", "c"), (r"\bdeci(?=m)", "d"), (r"\bkilo", "k"),
    (r"met(?:re|er)(?:\(s\)|s)?", "m"), (r"arc[ -]?sec(?:ond)?s?", "arcsec"),
    (r"arc[ -]?min(?:ute)?s?", "arcmin"), (r"(?<!arc)(?<![a-z])([mun]?)sec(?:ond)?s?", r"\1s"),
    (r"(?<!arc)min(?:ute)?s?(?![a-z])", "min"), (r"(?<![a-z])(?:hour|hr)s?", "h"),
    (r"deg(?:ree|a)?s?(?![a-z])", "deg"), (r"degrees?", "deg"), (r"radians?", "rad"),
    (r"\bper\b", "/"), (r"squared", "2"), (r"f(?:oo|ee)t", "ft"),
    (r"gals?(?![a-z])|galileos?", "gal"), (r"knots?|\bkts?\b", "kn"),
    (r"(?<![a-z])e(?:o|u)(?:tvos)?s?(?![a-z])", "e"), (r"(?<=[num])tesla", "t"),
    (r"/s/s$", "/s2"), (r"\*\*|\^|[*·_ ]", ""), (r"\s", ""),
)  # fmt: skip
"""Patterns of long unit names in lower case, with the short names of the tables."""
_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*[*×·]?\s*(?=[^\d/.])(.+)")
_BRACKETS = re.compile(r"\s*[\[(]\s*([^\[\]()]*?)\s*[\])]")
_ZERO_LEVEL = re.compile(r"[\s,(]+((above|over|rel\w*)\b.*|a\.?\s?s\.?\s?l\.?|a?msl)\)?$")
_CAPITAL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_SEPARATOR = re.compile(r"[_\s.,:;-]+")
_GLUED = re.compile(
    r"(?:.(?=gu$|mgal$)|(?:alt|altitude|height|elev|hgt|ht)(?=f))(gu|mgal|ft|feet)$", re.IGNORECASE
)
_LETTERS = frozenset("mseh")
"""Units of one letter that count at the end of a name."""
_SPELLINGS = {
    "s2": "1/s2",
    **{f"{metre}_s2": f"{metre}/s2" for metre in ("m", "mm", "um", "nm")},
    **{f"{angle}_s": f"{angle}/s" for angle in ("deg", "rad", "m")},
    "degps": "deg/s",
    "deg_h": "deg/h",
}
_SI = {"gradient": "1/s2", "gravity": "m/s2"}
_RARELY_WORDS = frozenset(("nt", "ntm", "nt/m", "mgal", "ugal", "eotvos", "ft", "feet"))
"""Units that rarely end a name by chance; they count even if the key has another quantity."""
_BASE = {
    "_s": Unit("time", 1.0),
    "_m": Unit("length", 1.0),
    "_deg": Unit("angle", _DEGREE),
    "_rad": Unit("angle", 1.0),
    "_mps": Unit("speed", 1.0),
    "_mps2": Unit("gravity", 1.0),
    "_radps": Unit("angular rate", 1.0),
    "_eotvos": Unit("gradient", 1e-9),
    "_mgal": Unit("gravity", 1e-5),
}
"""Quantity and SI factor of the unit for each suffix of a key."""


def _plain(unit: str) -> str:
    text = " ".join(unit.strip().casefold().replace("_", " ").split())
    for word, short in _WORDS:
        text = re.sub(word, short, text)
    return text


_NAMES = {
    name: Unit(quantity, factor)
    for quantity, factors in _UNITS.items()
    for factor, names in factors.items()
    for name in names.split("|")
}


def unit_named(text: str) -> Unit | None:
    """Return the unit that a text names, or None if the unit is unknown.

    A number before the unit is a factor: ``1e-7 deg``. A zero level after the unit is ignored:
    ``meters above mean sea level``.
    """
    for each in (text, _ZERO_LEVEL.sub("", text.strip().casefold())):
        if unit := _NAMES.get(_plain(each)):
            return unit
    number = _NUMBER.fullmatch(text.strip().casefold())
    if number and (unit := _NAMES.get(_plain(number[2]))):
        return Unit(unit.quantity, float(number[1]) * unit.factor)
    return None


def has_zero_level(text: str) -> bool:
    """Return whether a unit states a zero level, as in ``meters above mean sea level``."""
    return _ZERO_LEVEL.search(text.strip().casefold()) is not None


def factor_to_key(unit: str, key: str) -> float | None:
    """Return the factor from a unit to the unit of a key; None if their quantities differ.

    The unit of a key follows from its suffix. Example: the factor is 1000.0 from ``km`` to
    ``height_m``. For an unknown unit the result is None.
    """
    quantity, factor = base_of(key)
    named = unit_named(unit)
    return named.factor / factor if named is not None and named.quantity == quantity else None


def base_of(key: str) -> Unit:
    """Return the unit of a key from its suffix, for example metres for ``height_m``."""
    return next(base for end, base in _BASE.items() if key.endswith(end))


def examples_for(key: str) -> str:
    """Return a text for messages: examples of the units that are allowed for a key."""
    return ", ".join(names.split("|")[0] for names in _UNITS[base_of(key).quantity].values())


def unit_at_end(text: str, key: str) -> str:
    """Return the unit at the end of a name or a description; "" if there is none.

    Examples: ``ALT_FT``, ``HeightFeet``, ``GFAAGU``, ``Grav um/s2``. The unit must belong to the
    quantity of ``key``, or it must be a unit that rarely ends a name by chance, such as nT.
    """
    quantity = base_of(key).quantity
    split = _CAPITAL.sub("_", text.strip())
    ends = [split[match.end() :].casefold() for match in _SEPARATOR.finditer(split)]
    if match := _GLUED.search(text.strip()):
        ends.append(match[1].casefold())
    for end in ends:
        if len(end) == 1 and end not in _LETTERS:
            continue
        for spelling in (end, _SPELLINGS.get(end, ""), _SI.get(quantity, "") * (end == "si")):
            unit = unit_named(spelling) if spelling else None
            if unit and (unit.quantity == quantity or end.replace("_", "") in _RARELY_WORDS):
                return spelling.replace("_", "")
    return ""


def unit_in_brackets(text: str) -> str:
    """Return the last unit in brackets within a text; "" if there is none.

    Brackets without a unit, as in ``gravity (EGM2008)``, are ignored.
    """
    units = [
        candidate for candidate in _BRACKETS.findall(text) if unit_named(candidate) is not None
    ]
    return units[-1] if units else ""


def without_unit(text: str) -> tuple[str, str]:
    """Split ``name [unit]`` into name and unit; the unit is "" if the last brackets contain none.

    The content of the last brackets is a unit unless it is empty or a plain number.
    """
    match = re.fullmatch(r"(.*?)" + _BRACKETS.pattern, text.strip())
    if match is None or not match[2] or match[2].isdigit():
        return text.strip(), ""
    return match[1].strip(), match[2]
