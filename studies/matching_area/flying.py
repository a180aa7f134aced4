"""Predictions for each track, and outcomes of the flights along it."""

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
"""Matcher with one search over all measurements of a track.

The search spacing of 2 km is small compared with the correlation lengths, which are at least 8 km.
"""
FILTER = "ekf"
_STEPS = 20
"""Number of offsets from the centre of the search grid to its border."""
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
    """Number of runs per track for each kind of flights; the defaults are those of the design."""

    near: int = NEAR.runs
    wide: int = WIDE.runs
    weak: int = WEAK_RUNS


def rows_of_cell(job: tuple[Region, int, Cell, Runs]) -> list[dict[str, Any]]:
    """Fly the tracks through a cell and return one row per track."""
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
    """Return the statistics of Γ_UU in a cell, and the roughness of the gravity disturbance."""
    found = score_cell(field, cell, region.scoring(NEAR.instrument))
    of_gravity = score_cell(field, cell, region.scoring(GRAVIMETER))
    return {name: found[name] for name in STATISTICS} | {
        "roughness_gravity": of_gravity["roughness"]
    }


def _said(flight: Flight) -> dict[str, float]:
    """Return the CRLB [m] of the measurements along a flight, for each instrument."""
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
    """Return the bound and the filter's error of a flight [m].

    All values are horizontal RMS values from :data:`.design.SETTLED_S` on. The errors of even runs
    and of odd runs are also included.
    """
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
    """Return predictions and outcomes of single fixes on a track.

    ``locked`` counts the accepted fixes with an error of at most r₀, and ``false`` the other
    accepted fixes. ``wrong`` counts all fixes with an error above r₀, also if they are rejected.
    The union bound and the spill together predict the share of ``wrong``. r₀ is
    :data:`.design.RIGHT_M`.
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
        assert fixes is not None  # matchers return fixes
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
    """Return the bound of the horizontal variance (K,) [m²], from measurements up to each epoch."""
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
    """Return the arguments of :func:`rows_of_cell` for all cells of some regions."""
    return [
        (region, number, cell, runs)
        for region in regions
        for number, cell in enumerate(region.cells())
    ]
