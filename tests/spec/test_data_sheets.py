"""Factors from units of data sheets to keys, as the page on sensors has them."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from ggbench.spec.gradiometer import GradiometerSpec
from ggbench.spec.sensors import ImuSpec

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "own_sensor.md"
ROWS = re.findall(r"^\| [a-z ]+ \[(\S+)\] \| (\S+) \| `(\w+)` \|$", PAGE.read_text(), re.MULTILINE)
HOUR, G = 3600.0, 9.80665
SI = {
    "°/s/√Hz": math.radians(1.0),
    "°/h/√Hz": math.radians(1.0) / HOUR,
    "rad/s/√Hz": 1.0,
    "°/s": math.radians(1.0),
    "mrad/s": 1e-3,
    "m/s/√h": 1.0 / math.sqrt(HOUR),
    "m/s²/√Hz": 1.0,
    "ft/s/√h": 0.3048 / math.sqrt(HOUR),
    "mg": 1e-3 * G,
    "m/s²": 1.0,
    "mGal": 1e-5,
    "s⁻²/√Hz": 1.0,
}
OF_KEY = {
    "gyro_noise_deg_per_sqrt_h": math.radians(1.0) / math.sqrt(HOUR),
    "gyro_bias_deg_per_h": math.radians(1.0) / HOUR,
    "accelerometer_noise_ug_per_sqrt_hz": 1e-6 * G,
    "accelerometer_bias_ug": 1e-6 * G,
    "noise_density_eotvos_per_sqrt_hz": 1e-9,
}
"""SI units of a unit of each key."""


def test_the_page_has_all_units():
    assert {unit for unit, _, _ in ROWS} == set(SI)


@pytest.mark.parametrize(("unit", "factor", "key"), ROWS)
def test_a_factor_is_right_to_its_digits(unit, factor, key):
    assert float(factor) == pytest.approx(SI[unit] / OF_KEY[key], rel=5e-5)
    assert key in ImuSpec.model_fields or key in GradiometerSpec.model_fields
