"""``ggbench imu``: keys of the table ``[imu]`` from a static log."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..errors import GGBenchError

if TYPE_CHECKING:
    from ..recorded.allan import ImuNoise, SensorNoise


@click.command()
@click.argument("log", type=click.Path(path_type=Path))
@click.option(
    "--column",
    multiple=True,
    metavar="KEY=COLUMN",
    help="Column name in the log, optionally with a unit: 'time_s=stamp [us]'; repeatable.",
)
@click.option(
    "--preset",
    type=click.Choice(["euroc", "px4", "ros"]),
    help="Names and units of EuRoC MAV, PX4's sensor_combined or 'rostopic echo -p'.",
)
def imu(log: Path, column: tuple[str, ...], preset: str | None) -> None:
    """Fit the Allan deviation of LOG and print an [imu] table.

    LOG is a record of an hour or more at rest, as CSV or netCDF. Its columns are time_s,
    angular_rate_{x,y,z}_radps and specific_force_{x,y,z}_mps2. Increments delta_angle_{x,y,z}_rad
    and delta_velocity_{x,y,z}_mps may replace the rates and forces. The model is white noise plus
    a Gauss–Markov bias, fitted to the mean of the three axes.
    """
    from ..recorded.allan import imu_noise
    from ..spec.sensors import ImuSpec
    from ..spec.unusual_values import unusual_in

    unequal = [text for text in column if "=" not in text]
    if unequal:
        raise GGBenchError(f"--column {unequal[0]} must be written KEY=COLUMN")
    if column and preset:
        raise GGBenchError("--column and --preset both name the columns: give one of them")
    names = dict(text.split("=", 1) for text in column)
    noise = imu_noise(log, preset or names or None)
    text = "\n".join(_lines(noise, log.name))
    for doubt in noise.doubts:
        click.echo(f"Warning: {doubt}.", err=True)
    table = ImuSpec.model_construct(**tomllib.loads(text)["imu"])
    for key, value, usual in unusual_in(table, "imu."):
        if key.endswith("_s"):
            continue  # of times none is a grade's
        sensor = "gyros" if "gyro" in key else "accelerometers"
        size = "larger" if value > 1.0 else "smaller"
        warning = (
            f"{key} = {value:.3g} is {size} than that of any grade ({usual}): "
            f"{_cause(value, sensor)}"
        )
        click.echo(f"Warning: {warning}", err=True)
    click.echo(text)


def _cause(value: float, sensor: str) -> str:
    """Return the likely cause of a noise value that is outside the range of all grades."""
    if sensor == "gyros" and value > 1.0:
        return (
            f"with gyro columns in °/s the value is {math.radians(value):.3g}; state the unit, "
            "as in --column 'angular_rate_x_radps=angular_rate_x_radps [deg/s]'."
        )
    return f"are the columns of the {sensor} in another unit?"


def _lines(noise: ImuNoise, name: str) -> Iterator[str]:
    from ..simulation.instruments import STANDARD_GRAVITY

    yield "[imu]"
    yield f"# from {name}: {noise.duration:.0f} s at rest; mean of three axes"
    for remark in noise.remarks:
        yield f"# {remark}"
    yield f"period_s = {noise.period:.6g}"
    per_hour = math.degrees(3600.0)
    yield from _keys(
        noise.gyros, "gyro", ("deg_per_sqrt_h", per_hour / 60.0), ("deg_per_h", per_hour), "°/h"
    )
    micro_g = 1e6 / STANDARD_GRAVITY
    yield from _keys(
        noise.accelerometers, "accelerometer", ("ug_per_sqrt_hz", micro_g), ("ug", micro_g), "µg"
    )
    yield "# The turn-on bias cannot be estimated from one log: take it from the data sheet."


def _keys(
    noise: SensorNoise, sensor: str, white: tuple[str, float], bias: tuple[str, float], unit: str
) -> Iterator[str]:
    """Yield lines with the keys of a sensor: white noise, bias, and time constant of the bias.

    ``white`` and ``bias`` have the suffix of a key and the factor from SI units to its unit.
    ``unit`` is the unit of the bias in comments.
    """
    yield f"{sensor}_noise_{white[0]} = {white[1] * noise.white:.3g}"
    instability = f"bias instability at most {bias[1] * noise.instability:.3g} {unit}"
    if noise.bias == 0.0:
        yield f"{sensor}_bias_{bias[0]} = {bias[1] * noise.instability:.3g}"
        yield (
            f"# {sensor}: {instability}; no change of the bias was detected; the bias is set to "
            "this upper limit"
        )
        return
    walk = noise.bias * math.sqrt(2.0 / noise.time)
    yield f"{sensor}_bias_{bias[0]} = {bias[1] * noise.bias:.3g}"
    yield f"{sensor}_bias_time_s = {noise.time:.3g}"
    yield f"# {sensor}: {instability}; random walk {bias[1] * walk:.3g} {unit}/√s"
