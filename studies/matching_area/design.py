"""Design of the study: cells, tracks and flights."""

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
"""Largest error of a right fix [m]."""
SEED = 5


@dataclass(frozen=True)
class Region:
    """Region of the study, with its map, flights and cells.

    Attributes
    ----------
    name : name in the table.
    title : name on the page.
    source : source of the map.
    map : bounds of the map.
    height_m : height of the flights [m].
    weak : instrument of the flights with frequent false fixes, see :func:`weak`.
    side : number of cells along each axis; cells are evenly spaced and not adjacent.
    margin_deg : distance between the bounds of the map and the first cells [deg].
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
        """Return the design of the scores of the cells; its tracks have only two positions."""
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
    """Prior and measurements of flights along a track.

    Attributes
    ----------
    sigma_m : standard deviation of the position prior, per axis [m].
    instrument : gradiometer that measures the tensor or Γ_UU, with its noise in E.
    period_s : time between measurements [s].
    runs : number of runs per track.
    """

    sigma_m: float
    instrument: Instrument
    period_s: float
    runs: int

    @property
    def components(self) -> list[str]:
        """Channels of the gradiometer; its x axis points east."""
        every = ["xx", "xy", "xz", "yy", "yz", "zz"]
        return every[-1:] if self.instrument.kind == "uu" else every


NEAR = Flown(100.0, Instrument("tensor", 1.0), 1.0, 100)
"""Flights for the local accuracy, with a prior that is narrow enough to linearise."""
WIDE = Flown(5000.0, Instrument("tensor", 1.0), 5.0, 4)
"""Flights for fixes with the same instrument and a wide prior."""
WEAK_RUNS = 10
GRAVIMETER = Instrument("gravity", 1.0)


def weak(region: Region) -> Flown:
    """Return flights with frequent false fixes; :data:`WIDE` has too few false fixes.

    These flights measure only Γ_UU and have a wider prior. With the chosen noise, about half of the
    tracks have 2 to 50 % of predicted false fixes.
    """
    return Flown(10_000.0, region.weak, WIDE.period_s, WEAK_RUNS)


class Track(NamedTuple):
    """Straight track through the centre of a cell."""

    region: Region
    number: int
    cell: Cell
    heading_deg: float
    start_deg: tuple[float, float]

    @property
    def first_run(self) -> int:
        """Number of the first run of fixes; it differs between the tracks of a region."""
        return 1000 * (len(HEADINGS) * self.number + HEADINGS.index(self.heading_deg))


def tracks_of(region: Region, number: int, cell: Cell) -> Iterator[Track]:
    """Yield the tracks through a cell of a region; ``number`` is the number of the cell."""
    for heading, positions in tracks(cell, region.scoring(NEAR.instrument)):
        latitude, longitude = (math.degrees(angle) for angle in positions[0, :2])
        yield Track(region, number, cell, heading, (latitude, longitude))


def case(track: Track, flown: Flown) -> CaseSpec:
    """Return the case of flights along a track, from the content of a scenario file."""
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
    """Return a smaller region, with other bounds of the map and ``side`` cells along each axis."""
    return replace(region, map=bounds, side=side)
