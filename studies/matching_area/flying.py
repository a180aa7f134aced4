"""Predictions for each track before it is flown, and the outcome of its flights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from ggbench.block import BlockEstimator
from ggbench.campaign.registry import choose
from ggbench.gravity.field import Field
from ggbench.matchability import information as info
from ggbench.matchability.score import REACH, Cell, score_cell
from ggbench.problem import Estimator
from ggbench.simulation.error_free_flight import Flight, prepare
from ggbench.simulation.flight_bounds import flight_bound
from ggbench.simulation.runs import simulate_block

from .design import (
    DURATION_S,
    GRAVIMETER,
    NEAR,
    RIGHT_M,
    SEED,
    SETTLED_S,
    WEAK_RUNS,
    WIDE,
    Flown,
    Region,
    Track,
    case,
    tracks_of,
    weak,
)

READINGS = round(DURATION_S / WIDE.period_s)
MATCHER = f"tercom[fusion=none,window={READINGS},longest={READINGS},spacing_m=2000,refine=4]"
"""One search over all readings of a track. The fields' correlation lengths are 8 km and more."""
FILTER = "ekf"
_STEPS = 20
"""Offsets from the middle to the end of the reach."""
STATISTICS = (
    "deviation",
    "slope_deviation",
    "roughness",
    "entropy",
    "correlation_m",
    "fractal_dimension",
    "information_m",
)


class Runs(NamedTuple):
    """How many of each kind of flights, by default those of the design."""

    near: int = NEAR.runs
    wide: int = WIDE.runs
    weak: int = WEAK_RUNS


def rows_of_cell(job: tuple[Region, int, Cell, Runs]) -> list[dict[str, Any]]:
    """Return a row for each track through a cell."""
    region, number, cell, runs = job
    rows = []
    of_cell: dict[str, float] = {}
    for track in tracks_of(region, number, cell):
        near = prepare(case(track, NEAR))
        if not of_cell:
            of_cell = _of_cell(near.field, region, cell)
        latitude, longitude = cell.centre
        row: dict[str, Any] = {
            "region": region.name,
            "cell": number,
            "latitude_deg": latitude,
            "longitude_deg": longitude,
            "heading_deg": track.heading_deg,
        }
        row |= of_cell | _said(near) | _near(near, runs.near)
        row |= _matched("wide", track, WIDE, runs.wide) | _matched(
            "weak", track, weak(region), runs.weak
        )
        rows.append(row)
    return rows


def _of_cell(field: Field, region: Region, cell: Cell) -> dict[str, float]:
    """Return the statistics of a cell, of Γ_UU; of a gravimeter's map its roughness."""
    found = score_cell(field, cell, region.scoring(NEAR.instrument))
    of_gravity = score_cell(field, cell, region.scoring(GRAVIMETER))
    return {name: found[name] for name in STATISTICS} | {
        "roughness_gravity": of_gravity["roughness"]
    }


def _said(flight: Flight) -> dict[str, float]:
    """Return what Fisher's information says of the readings' places, by instrument."""
    track = flight.motion_at_epochs.positions
    return {
        name: info.accuracy(info.information(instrument.jacobians(flight.field, track)))
        for name, instrument in (
            ("track_m", NEAR.instrument),
            ("track_uu_m", info.Instrument("uu", 1.0)),
            ("track_gravity_m", GRAVIMETER),
        )
    }


def _near(flight: Flight, runs: int) -> dict[str, float]:
    """Return the bound of a flight, and the error of the filter; of the even and odd runs, too."""
    settled = flight.times >= SETTLED_S - 1e-9
    block, truth = simulate_block(flight, SEED, range(runs))
    found = _filter().estimate_block(block)
    errors = (truth.error_state - found.mean)[:, settled, :2]
    squares = np.mean(np.sum(errors**2, axis=2), axis=1)
    return {
        "bound_m": math.sqrt(float(np.mean(_horizontal(flight)[settled]))),
        "error_m": math.sqrt(float(np.mean(squares))),
        "error_even_m": math.sqrt(float(np.mean(squares[::2]))),
        "error_odd_m": math.sqrt(float(np.mean(squares[1::2]))),
    }


def _matched(name: str, track: Track, flown: Flown, runs: int) -> dict[str, float]:
    """Return what is predicted of single fixes on a track, and what they were.

    ``locked`` and ``false`` are accepted and right or not; ``wrong`` is the best place beyond r₀,
    whether accepted or not, which is what the union bound and the spill predict.
    """
    flight = prepare(case(track, flown))
    positions, reach = flight.motion_at_epochs.positions, REACH * flown.sigma_m
    grid = info.offsets(reach, reach / _STEPS)
    found = info.ambiguity(flight.field, flown.instrument, positions, grid)
    known = info.information(flown.instrument.jacobians(flight.field, positions))
    counts = dict.fromkeys(("locked", "false", "wrong"), 0)
    block, truth = simulate_block(flight, SEED, range(track.first_run, track.first_run + runs))
    for run in range(runs):
        fixes = _matcher().estimate(block.problem(run), np.random.default_rng(0)).fixes
        assert fixes is not None  # a matcher has them
        for k in range(len(fixes)):
            error = fixes.mean[k, :2] - truth.error_state[run, fixes.epoch[k], :2]
            right = bool(np.hypot(*error) <= RIGHT_M)
            counts["wrong"] += not right
            if fixes.accepted[k]:
                counts["locked" if right else "false"] += 1
    return {
        f"{name}_ambiguity": info.least(found, grid, RIGHT_M, reach),
        f"{name}_bound_m": math.sqrt(float(_horizontal(flight)[-1])),
        f"{name}_union": info.false_fix_bound(found, grid, RIGHT_M, reach, flown.sigma_m),
        f"{name}_spill": info.spill(known, RIGHT_M, flown.sigma_m),
        f"{name}_runs": runs,
    } | {f"{name}_{what}": count for what, count in counts.items()}


def _horizontal(flight: Flight) -> np.ndarray:
    """Bound of the horizontal position (K,) at the epochs, given the readings so far [m²]."""
    return np.asarray(np.trace(flight_bound(flight).filtering[:, :2, :2], axis1=1, axis2=2))


@cache
def _filter() -> BlockEstimator:
    found = choose(FILTER).estimator
    assert isinstance(found, BlockEstimator)
    return found


@cache
def _matcher() -> Estimator:
    return choose(MATCHER).estimator


def jobs(regions: Sequence[Region], runs: Runs) -> list[tuple[Region, int, Cell, Runs]]:
    """Return the cells of some regions, each with all that it takes."""
    return [
        (region, number, cell, runs)
        for region in regions
        for number, cell in enumerate(region.cells())
    ]
