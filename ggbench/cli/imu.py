"""``ggbench imu``: the keys of [imu] from a log at rest."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from ..recorded.allan import ImuNoise, SensorNoise


@click.command()
@click.argument("log", type=click.Path(path_type=Path))
def imu(log: Path) -> None:
    """Print the [imu] table of the sensors in LOG, by their Allan deviation.

    LOG is a record at rest, an hour or more: CSV or netCDF with time_s, angular_rate_x_radps and so
    on, specific_force_x_mps2 and so on, or increments as of [imu_record]. White noise and a bias
    that changes (Gauss–Markov) are fitted to the mean of the three axes.
    """
    from ..recorded.allan import imu_noise

    click.echo("\n".join(_lines(imu_noise(log), log.name)))


def _lines(noise: ImuNoise, name: str) -> Iterator[str]:
    from ..simulation.instruments import STANDARD_GRAVITY

    yield "[imu]"
    yield f"# from {name}: {noise.duration:.0f} s at rest; mean of three axes"
    yield f"period_s = {noise.period:.6g}"
    per_hour = math.degrees(3600.0)
    yield from _keys(
        noise.gyros, "gyro", ("deg_per_sqrt_h", per_hour / 60.0), ("deg_per_h", per_hour), "°/h"
    )
    micro_g = 1e6 / STANDARD_GRAVITY
    yield from _keys(
        noise.accelerometers, "accelerometer", ("ug_per_sqrt_hz", micro_g), ("ug", micro_g), "µg"
    )
    yield "# The constant bias of a start is in no log of one start: see the data sheet."


def _keys(
    noise: SensorNoise, sensor: str, white: tuple[str, float], bias: tuple[str, float], unit: str
) -> Iterator[str]:
    """Yield the keys of a sensor: white noise and bias with their units and factors to them."""
    yield f"{sensor}_noise_{white[0]} = {white[1] * noise.white:.3g}"
    instability = f"bias instability at most {bias[1] * noise.instability:.3g} {unit}"
    if noise.bias == 0.0:
        yield f"{sensor}_bias_{bias[0]} = {bias[1] * noise.instability:.3g}"
        yield f"# {sensor}: {instability}; no change of the bias is seen, and the key is that limit"
        return
    walk = noise.bias * math.sqrt(2.0 / noise.time)
    yield f"{sensor}_bias_{bias[0]} = {bias[1] * noise.bias:.3g}"
    yield f"{sensor}_bias_time_s = {noise.time:.3g}"
    yield f"# {sensor}: {instability}; random walk {bias[1] * walk:.3g} {unit}/√s"
