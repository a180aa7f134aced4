"""A small survey that is made up: lines over some masses, with noise."""

from __future__ import annotations

import numpy as np

from ggbench.gravity.point_masses import fields
from ggbench.maps.equivalent_sources import weights_of
from ggbench.maps.survey_lines import SurveyLines

LATITUDE, LONGITUDE = 30.0, -93.0
LINES, SAMPLES = 12, 60
SPACING_M, STEP_M, HEIGHT_M = 300.0, 100.0, 80.0
TENSOR = ("xx", "xy", "xz", "yy", "yz")
PER_DEGREE = 110_851.0, 96_486.0
"""Metres in a degree of latitude and longitude at 30° N, close enough for a survey of 6 km."""


def survey(components=TENSOR, noise=0.0, seed=1, repeats=()):
    """Return north–south lines 300 m apart; ``repeats`` are flown again, under the name ``n.1``."""
    rng = np.random.default_rng(seed)
    order = [*range(LINES), *repeats]
    east = SPACING_M * np.repeat(order, SAMPLES) + rng.normal(0.0, 5.0, len(order) * SAMPLES)
    north = np.tile(STEP_M * np.arange(SAMPLES), len(order))
    height = HEIGHT_M + rng.normal(0.0, 5.0, east.size)
    lines = SurveyLines(
        names=(*(str(i) for i in range(LINES)), *(f"{i}.1" for i in repeats)),
        kinds=("primary",) * LINES + ("repeat",) * len(repeats),
        line=np.repeat(np.arange(len(order)), SAMPLES),
        time_s=np.arange(east.size, dtype=float),
        latitude_deg=LATITUDE + north / PER_DEGREE[0],
        longitude_deg=LONGITUDE + east / PER_DEGREE[1],
        height_m=height,
        components=tuple(components),
        values=np.zeros((east.size, len(components))),
    )
    exact = field(np.array([east, north, height])) @ weights_of(lines).T
    lines.values[:] = (
        exact
        + noise * rng.standard_normal(exact.shape)
        + rng.normal(0.0, 20.0, (len(order), len(components))).repeat(SAMPLES, axis=0)
    )
    return lines


def field(points):
    """Return the nine components (n, 9) at points east, north, up (3, n) [m]."""
    rng = np.random.default_rng(5)
    places = np.array(
        [rng.uniform(0.0, 3300.0, 20), rng.uniform(0.0, 6000.0, 20), rng.uniform(-1500, -700, 20)]
    )
    found = np.empty((points.shape[1], 9))
    fields(np.ascontiguousarray(points), places, rng.normal(0.0, 60.0, 20), found)
    return found
