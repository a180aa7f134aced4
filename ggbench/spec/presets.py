"""Presets: inertial sensors by grade, and published gradiometers.

A preset supplies the keys that a table omits. It is replaced by its numbers, so a case with a
preset equals a case with the same numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Literal, NamedTuple

NOISES = ("noise_eotvos", "noise_density_eotvos_per_sqrt_hz", "coloured_noise")
"""The ways to state the gradiometer's noise; one replaces the others."""
Grade = Literal["consumer", "tactical", "navigation", "strategic"]
PublishedGradiometer = Literal["ftg-2008", "falcon-2019", "atom-2002", "superconducting-2002"]


class Preset(NamedTuple):
    """Values of keys, and the source of the values."""

    values: Mapping[str, Any]
    source: str


def _imu(
    gyro_bias: float, gyro_noise: float, accelerometer_bias: float, noise: float, source: str
) -> Preset:
    values = {
        "gyro_bias_deg_per_h": gyro_bias,
        "gyro_noise_deg_per_sqrt_h": gyro_noise,
        "accelerometer_bias_ug": accelerometer_bias,
        "accelerometer_noise_ug_per_sqrt_hz": noise,
    }
    return Preset(values, source)


_GROVES = (
    "P. D. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems"
)
_EL_SHEIMY = "N. El-Sheimy, A. Youssef, Satellite Navigation 1:2 (2020), Table 1"
IMU_GRADES: Mapping[str, Preset] = {
    "consumer": _imu(200.0, 1.0, 10e3, 1000.0, f"{_GROVES}, Inertial_Demo_3, rounded"),
    "tactical": _imu(10.0, 0.01, 1000.0, 100.0, f"{_GROVES}, Inertial_Demo_1, rounded"),
    "navigation": _imu(
        gyro_bias=0.01,
        gyro_noise=0.002,
        accelerometer_bias=30.0,
        noise=20.0,
        source=f"{_GROVES}, Inertial_Demo_2, rounded; gyro bias: {_EL_SHEIMY}",
    ),
    "strategic": _imu(
        gyro_bias=0.0003,
        gyro_noise=0.0001,
        accelerometer_bias=1.0,
        noise=1.0,
        source=f"biases: {_EL_SHEIMY}; middle of the range for gyros, upper end for "
        "accelerometers; noise: assumed, as in the scenario ship_strategic",
    ),
}
"""Inertial sensors by grade, from the worst to the best."""

_SURVEY = "estimated from held-back lines (scenarios/data/measured)"
GRADIOMETERS: Mapping[str, Preset] = {
    "ftg-2008": Preset(
        {
            "period_s": 1.0,
            "instrument": "local-level",
            "components": ["xx", "xy", "xz", "yy", "yz"],
            "coloured_noise": "measured/vinton2008_noise.json",
        },
        f"full-tensor gradiometer of Bell Geospace over Vinton Dome, 9 to 11 E RMS, {_SURVEY}",
    ),
    "falcon-2019": Preset(
        {
            "period_s": 1.0,
            "instrument": "local-level",
            "components": ["xy", "xx-yy"],
            "coloured_noise": "measured/fosterville2019_noise.json",
        },
        f"Falcon gradiometer over Fosterville, 4.5 E RMS, {_SURVEY}",
    ),
    "atom-2002": Preset(
        {
            "instrument": "local-level",
            "components": ["zz"],
            "noise_density_eotvos_per_sqrt_hz": 4.0,
        },
        "J. M. McGuirk et al., Physical Review A 65, 033608 (2002), abstract; in the laboratory",
    ),
    "superconducting-2002": Preset(
        {
            "instrument": "platform",
            "components": ["xx", "yy", "zz"],
            "noise_density_eotvos_per_sqrt_hz": 0.02,
        },
        "M. V. Moody et al., Review of Scientific Instruments 73, 3957 (2002), abstract; in the "
        "laboratory",
    ),
}
"""Gradiometers after published instruments."""
PRESETS: Mapping[str, tuple[str, Mapping[str, Preset]]] = {
    "imu": ("grade", IMU_GRADES),
    "gradiometer": ("preset", GRADIOMETERS),
}
"""Tables that have presets: the key that names one, and the presets."""


def expanded(table: str, content: Any) -> Any:
    """Return the content of a table with its preset replaced by numbers.

    Keys that the table states have priority. An unknown preset is unchanged; a later check of the
    key refuses this preset.
    """
    key, presets = PRESETS[table]
    if not isinstance(content, Mapping):
        return content
    preset = presets.get(content[key]) if isinstance(content.get(key), str) else None
    if preset is None:
        return content
    written = {name: value for name, value in content.items() if name != key}
    filled = dict(preset.values)
    if any(written.get(noise) is not None for noise in NOISES):
        filled = {name: value for name, value in filled.items() if name not in NOISES}
    return filled | {name: value for name, value in written.items() if value is not None}


def replaced(change: Mapping[str, Any]) -> Iterable[str]:
    """Return the keys that are replaced if a table of changes states a preset.

    If ``change`` has no preset, the result is empty.
    """
    for key, presets in PRESETS.values():
        if isinstance(change.get(key), str) and change[key] in presets:
            return {*presets[change[key]].values, *(NOISES if key == "preset" else ())}
    return ()


_LARGEST = ((0.002, "strategic"), (0.05, "navigation"), (45.0, "tactical"))
"""Largest gyro bias of each grade [°/h]; a larger one is consumer grade."""


def grade_of(gyro_bias: float) -> str:
    """Return the grade of inertial sensors in words for a gyro bias [°/h]."""
    return next((name for most, name in _LARGEST if gyro_bias <= most), "consumer")
