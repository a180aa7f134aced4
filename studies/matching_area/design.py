"""The design of the study: cells, tracks, flights."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ggbench.matchability.information import Instrument
from ggbench.matchability.score import HEADINGS, Bounds, Cell, Design, tracks
from ggbench.spec import scenario
from ggbench.spec.case import CaseSpec

CELL_DEG = 0.5
TRACK_M = 50_000.0
SPEED_MPS = 250.0
DURATION_S = TRACK_M / SPEED_MPS
SETTLED_S = 0.5 * DURATION_S
RIGHT_M = 2500.0
"""How far off a fix may be and be the right one."""
SEED = 5


@dataclass(frozen=True)
class Region:
    """Where cells lie.

    Attributes
    ----------
    name : in the table. title : in words. source : of the map. map : its bounds.
    height_m : of the flights. weak : what reads the field on flights that are to fail.
    side : cells along each axis, spread evenly, no two adjacent.
    margin_deg : between the bounds of the map and the first cells.
    """

    name: str
    title: str
    source: str
    map: Bounds
    height_m: float
    weak: Instrument
    side: int = 8
    margin_deg: float = 0.4

    def cells(self) -> list[Cell]:
        """Return the cells, row by row from the south."""
        starts = [
            np.linspace(low + self.margin_deg, high - self.margin_deg - CELL_DEG, self.side)
            for low, high in ((self.map.south, self.map.north), (self.map.west, self.map.east))
        ]
        return [
            Cell(float(south), float(south) + CELL_DEG, float(west), float(west) + CELL_DEG)
            for south in starts[0]
            for west in starts[1]
        ]

    def scoring(self, instrument: Instrument) -> Design:
        """Return what the cells are asked for; of tracks only where they begin and end."""
        return Design(
            height_m=self.height_m,
            cell_deg=CELL_DEG,
            instrument=instrument,
            spacing_m=1000.0,
            track_m=TRACK_M,
            readings=2,
            sigma_m=WIDE.sigma_m,
            right_m=RIGHT_M,
        )


REGIONS = (
    Region(
        "qinling",
        "Qinling, height 10 km",
        "egm2008_qinling",
        Bounds(28.6, 38.4, 102.6, 114.4),
        10_000.0,
        Instrument("uu", 2.0),
    ),
    Region(
        "sea",
        "South China Sea, height 1 km",
        "egm2008_south_china_sea",
        Bounds(11.5, 22.5, 110.5, 119.7),
        1000.0,
        Instrument("uu", 6.0),
    ),
)


@dataclass(frozen=True)
class Flown:
    """How a track is flown: what is known before, and what reads the field.

    Attributes
    ----------
    sigma_m : of the position before, per axis. instrument : tensor or uu, its noise in E.
    period_s : from one reading to the next. runs : of each track.
    """

    sigma_m: float
    instrument: Instrument
    period_s: float
    runs: int

    @property
    def components(self) -> list[str]:
        """Channels of the gradiometer, whose x is to the east."""
        every = ["xx", "xy", "xz", "yy", "yz", "zz"]
        return every[-1:] if self.instrument.kind == "uu" else every


NEAR = Flown(100.0, Instrument("tensor", 1.0), 1.0, 100)
"""For the local accuracy: the place is known well enough to linearise."""
WIDE = Flown(5000.0, Instrument("tensor", 1.0), 5.0, 4)
"""For locking on with the same instrument."""
WEAK_RUNS = 10
GRAVIMETER = Instrument("gravity", 1.0)


def weak(region: Region) -> Flown:
    """Return how tracks are flown for false fixes, of which WIDE has too few.

    Less is read and less is known; the noise is such that about half of the tracks are predicted to
    have 2 to 50 % of false fixes.
    """
    return Flown(10_000.0, region.weak, WIDE.period_s, WEAK_RUNS)


class Track(NamedTuple):
    """A straight track through the centre of a cell."""

    region: Region
    number: int
    cell: Cell
    heading_deg: float
    start_deg: tuple[float, float]

    @property
    def first_run(self) -> int:
        """From which the runs are counted where they are to be other ones on every track."""
        return 1000 * (len(HEADINGS) * self.number + HEADINGS.index(self.heading_deg))


def tracks_of(region: Region, number: int, cell: Cell) -> Iterator[Track]:
    """Yield the tracks through a cell of a region, whose number it is."""
    for heading, positions in tracks(cell, region.scoring(NEAR.instrument)):
        latitude, longitude = (math.degrees(angle) for angle in positions[0, :2])
        yield Track(region, number, cell, heading, (latitude, longitude))


def case(track: Track, flown: Flown) -> CaseSpec:
    """Return the case of a track, as a scenario file would say it."""
    region = track.region
    document: dict[str, Any] = {
        "title": "A track of the study of matching areas",
        "description": "Straight and level through the centre of a cell.",
        "trajectory": {
            "latitude_deg": track.start_deg[0],
            "longitude_deg": track.start_deg[1],
            "height_m": region.height_m,
            "speed_mps": SPEED_MPS,
            "heading_deg": track.heading_deg,
            "segment": [{"kind": "cruise", "duration_s": DURATION_S}],
        },
        "imu": {
            "period_s": 0.1,
            "gyro_bias_deg_per_h": 0.005,
            "gyro_noise_deg_per_sqrt_h": 0.001,
            "accelerometer_bias_ug": 30.0,
            "accelerometer_noise_ug_per_sqrt_hz": 10.0,
        },
        "initial_error": {
            "position_m": flown.sigma_m,
            "velocity_mps": 0.1,
            "attitude_arcmin": 0.3,
            "height_m": 20.0,
        },
        "gradiometer": {
            "period_s": flown.period_s,
            "noise_eotvos": flown.instrument.noise,
            "instrument": "local-level",
            "components": flown.components,
        },
        "field": {
            "source": region.source,
            **{f"{side}_deg": bound for side, bound in region.map._asdict().items()},
            "lowest_m": region.height_m - 1000.0,
            "highest_m": region.height_m + 1000.0,
            "spacing_arcmin": 1.25,
            "height_spacing_m": 500.0,
        },
        "windows": {"settled_from_s": SETTLED_S, "last_s": 20.0},
        "campaign": {"runs": flown.runs, "seed": SEED, "estimators": ["ekf"]},
        "case": [{"name": "track", "title": "track"}],
    }
    return scenario.parse(document, "matching_area", "matching_area").cases[0]


def smaller(region: Region, bounds: Bounds, side: int) -> Region:
    """Return a region of which there is less: another map and so many cells along each axis."""
    return replace(region, map=bounds, side=side)
