"""Summary lines of a scenario's flights, and warnings about unusual motion."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import click

from ..figures.numbers import short, some, span
from ..judging.field_scale import on_the_prior
from ..spec.aiding import GnssSpec
from ..trajectory.manoeuvres import BANK_GRAVITY
from .flight_limits import Examined, FlightExtremes
from .map_margins import length, narrow_margins
from .screen import console

MOST_BANK_DEG = 45.0
"""Largest usual bank angle: 1.4 g in a level turn. Surveys bank by 15° to 30°, airliners by 30°."""
MOST_PITCH_DEG = 30.0
"""Largest usual pitch angle; larger angles count as aerobatics (14 CFR 91.307)."""
MOST_VERTICAL = 0.5 * BANK_GRAVITY
"""Largest usual vertical acceleration [m/s²]: half a g is severe turbulence."""
MOST_ACROSS_SHIP = 0.1 * BANK_GRAVITY
"""Largest usual lateral acceleration of a ship [m/s²]: a turn of 65 m radius at 8 m/s."""
HIGHEST_TRACK_M = 15_000.0
"""Largest usual height of a track [m]; larger numbers are probably heights in feet."""
SPEEDS_TRACK_MPS = (0.5, 1000.0)
"""Usual mean speeds of a track [m/s]; outside them the unit of its times is doubtful."""
SECOND_ORDER_M = 10.0
"""Largest tolerable second-order part of the INS error without GNSS positions [m]."""
MOST_HEIGHT_ERROR_M = 10_000.0
"""INS height error [m] above which gravity and map cannot be evaluated, so that runs fail."""
SCHULER_HEIGHT_S = 570.0
"""Time √(R / 2g) [s] in which an unaided height error grows e-fold (Groves 2013, sec. 5.7)."""
HEIGHT_PRIOR_M = 100.0
"""Largest usual σ of the initial height [m]; a barometric height is more accurate."""
_BAROMETER_M = 20.0
_NAMED = 3


def print_flights(examinations: Sequence[Examined]) -> None:
    """Print the flights, INS errors, numbers of measurements and priors of the cases.

    Cases with equal values share a line. Cases of assumptions are omitted.
    """
    cases = [each for each in examinations if not each.study]
    flights: dict[str, list[str]] = {}
    readings: dict[str, list[str]] = {}
    errors: dict[str, list[str]] = {}
    priors: dict[str, list[str]] = {}
    for each in cases:
        flights.setdefault(_flight(each), []).append(each.case.name)
        errors.setdefault(_ins(each), []).append(each.case.name)
        counts = ", ".join(f"{name} {count}" for name, count in each.readings.items())
        readings.setdefault(counts, []).append(each.case.name)
        priors.setdefault(_prior(each), []).append(each.case.name)
    parts = (("Flight", flights), ("INS", errors), ("Readings", readings), ("Prior", priors))
    for what, texts in parts:
        for text, names in texts.items():
            if not text:
                continue
            of = f" in {some(names, most=_NAMED)}" if len(names) < len(cases) else ""
            console.print(f"{what}{of}: {text}", markup=False)


def _flight(each: Examined) -> str:
    flown, margin = each.flown, each.margin
    speeds = span(*(f"{speed:.1f}" for speed in flown.speeds))
    heights = span(*(f"{height:.0f}" for height in flown.heights))
    text = (
        f"{flown.duration:.0f} s, {short(flown.length / 1e3)} km, {speeds} m/s, "
        f"{heights} m high, largest bank {math.degrees(flown.bank):.0f}°; "
    )
    if margin is None:
        return f"{text}no map"
    text += (
        f"{short(margin.border / 1e3)} km from the map's border ({margin.side}), "
        f"{margin.below:.0f} m above its lowest height and {margin.above:.0f} m below its highest"
    )
    if margin.lowest is None:
        return text
    return f"{text}; at least {margin.below + margin.lowest:.0f} m above its base surface"


def _ins(each: Examined) -> str:
    """Return a text on the unaided INS error and the time until which it is linear."""
    error = each.ins
    text = (
        f"unaided INS error up to {length(float(error.horizontal.max()))} horizontally and "
        f"{length(float(error.deviations[:, 2].max()))} in height (1 σ)"
    )
    noises = [
        sensor.position_noise_m
        for sensor in each.case.side("truth").sensor.values()
        if isinstance(sensor, GnssSpec) and sensor.position_noise_m is not None
    ]
    allowed = min(noises, default=SECOND_ORDER_M)
    until = error.linear_until(allowed)
    if math.isinf(until):
        return text
    return (
        f"{text}; after {until:.0f} s the second-order part of the INS error exceeds "
        f"{allowed:g} m, too large for filters about an open-loop INS: use closed-loop"
    )


def _prior(each: Examined) -> str:
    """Return a text on the initial uncertainty in correlation lengths of the field, or ""."""
    if math.isnan(each.correlation_m):
        return ""
    return on_the_prior(each.case.initial_error.position_m, each.correlation_m)


def warn(examinations: Iterable[Examined]) -> None:
    """Print the warnings, and the remarks on height conversions and on initial heights."""
    cases = list(examinations)
    for remark in dict.fromkeys(each.flown.remark for each in cases if each.flown.remark):
        click.echo(f"Note on the track: {remark}.")
    for remark in remarks_on_the_prior(cases):
        click.echo(f"Note: {remark}.")
    for warning in warnings(cases):
        click.echo(f"Warning: {warning}.")


def remarks_on_the_prior(examinations: Iterable[Examined]) -> Iterator[str]:
    """Yield a remark for each large initial standard deviation of the height.

    Cases with the key ``initial_error.height_m`` are skipped. In all other cases ``position_m`` is
    also the standard deviation of the height.
    """
    cases: dict[float, list[str]] = {}
    for each in examinations:
        initial = each.case.initial_error
        if initial.height_m is None and initial.position_m > HEIGHT_PRIOR_M:
            cases.setdefault(initial.position_m, []).append(each.name)
    for position, names in cases.items():
        yield (
            f"in {some(names, most=_NAMED)}, initial_error.position_m = {position:g} is also the "
            "standard deviation of the height, because height_m is missing; for a barometric "
            f"height give height_m = {_BAROMETER_M:g}"
        )


def warnings(examinations: Iterable[Examined]) -> Iterator[str]:
    """Yield a sentence for each implausible motion, unstable height and narrow map margin.

    Cases with the same warning share one sentence. Most sentences state a remedy.
    """
    cases_by_warning: dict[str, list[str]] = {}
    narrow = []
    for each in examinations:
        narrow.append((each.name, each.narrow))
        for what in (*absurdities(each.flown), *_unstable_height(each)):
            cases_by_warning.setdefault(what, []).append(each.name)
    for what, names in cases_by_warning.items():
        yield f"in {some(names, most=_NAMED)}, {what}"
    yield from narrow_margins(narrow)


def absurdities(flown: FlightExtremes) -> Iterator[str]:
    """Yield a sentence for each implausible motion of a flight."""
    if flown.track:
        yield from _other_units(flown)
    bank, pitch = math.degrees(flown.bank), math.degrees(flown.pitch)
    if bank > MOST_BANK_DEG:
        yield (
            f"the flight banks by {bank:.0f}°, {flown.bank_time:.0f} s after the start; more "
            f"than {MOST_BANK_DEG:g}° is unusual for a survey: {_remedy(flown, 'roll_deg')}"
        )
    if pitch > MOST_PITCH_DEG:
        yield (
            f"the flight pitches by {pitch:.0f}°; more than {MOST_PITCH_DEG:g}° is aerobatics: "
            f"{_remedy(flown, 'pitch_deg')}"
        )
    if flown.vertical > MOST_VERTICAL:
        yield (
            f"the flight accelerates by {flown.vertical:.1f} m/s² up or down; more than "
            f"{MOST_VERTICAL:.1f} m/s² (half a g) is severe turbulence: if you do not simulate "
            f"turbulence, {_remedy(flown)}"
        )
    if flown.vehicle == "ship" and flown.across > MOST_ACROSS_SHIP:
        yield (
            f"the ship accelerates by {flown.across:.1f} m/s² to the side; ships turn with at "
            f"most {MOST_ACROSS_SHIP:.1f} m/s²: {_remedy(flown)}"
        )


def _unstable_height(each: Examined) -> Iterator[str]:
    """Yield a sentence if the height of an INS without an altimeter diverges."""
    worst = float(each.ins.deviations[:, 2].max())
    if each.case.altimeter is None and worst > MOST_HEIGHT_ERROR_M:
        yield (
            f"the height error of the INS reaches {worst:.2g} m (1 σ), and runs will fail: "
            f"without an altimeter it grows e-fold every {SCHULER_HEIGHT_S:.0f} s; add "
            "[altimeter] or shorten the flight"
        )


def _other_units(flown: FlightExtremes) -> Iterator[str]:
    """Yield a sentence for each number of a track that seems to be in another unit."""
    height, speed = max(flown.heights), flown.length / flown.duration
    slowest, fastest = SPEEDS_TRACK_MPS
    if height > HIGHEST_TRACK_M:
        yield (
            f"the track is {height:.0f} m high; more than {HIGHEST_TRACK_M:.0f} m is unusual: "
            "height_m must be in metres. If the file has feet, the track is "
            f"{0.3048 * height:.0f} m high: convert the heights"
        )
    if speed < slowest:
        yield (
            f"the track moves at {short(speed)} m/s on average, {short(flown.length)} m in "
            f"{flown.duration:.0f} s; less than {slowest:g} m/s is unusual: time_s must "
            "be in seconds. If the file has milliseconds, the speed is "
            f"{short(1e3 * speed)} m/s: convert the times"
        )
    if speed > fastest:
        yield (
            f"the track moves at {speed:.0f} m/s on average; more than {fastest:.0f} m/s is "
            "unusual: time_s must be in seconds. If the file has minutes, the speed is "
            f"{short(speed / 60.0)} m/s: convert the times"
        )


def _remedy(flown: FlightExtremes, column: str = "") -> str:
    """Return a remedy for an implausible motion.

    ``column`` names the column of a track that replaces a quantity derived from positions; or "".
    """
    if not flown.track:
        return "fly its segments more gently"
    alternative = f", or add a column {column}" if column else ""
    return f"the track is noisy; smooth it ([trajectory] smoothing_s){alternative}"
