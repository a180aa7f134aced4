"""Noise keys from a log at rest: those that the log was simulated with."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from click.testing import CliRunner
from refusals import refused
from scipy.signal import lfilter

from ggbench.cli.main import main
from ggbench.recorded import columns as files
from ggbench.recorded.allan import imu_noise
from ggbench.recorded.inertial import DELTAS, RATES
from ggbench.spec.flight import FlightError
from ggbench.spec.sensors import ImuSpec

PERIOD = 0.05
COUNT = 72_000  # an hour
GYRO = (0.3, 20.0, 60.0)  # °/√h, °/h, s
FORCE = (80.0, 300.0, 40.0)  # µg/√Hz, µg, s


def triad(white: float, bias: float, time: float, rng: np.random.Generator) -> np.ndarray:
    """Readings (N, 3) of white noise of a root PSD and a Gauss–Markov bias."""
    kept = np.exp(-PERIOD / time)
    drawn = rng.standard_normal((COUNT, 3)) * np.sqrt(1.0 - kept**2)
    drawn[0] /= np.sqrt(1.0 - kept**2)
    wander = lfilter([1.0], [1.0, -kept], drawn, axis=0)
    return white / np.sqrt(PERIOD) * rng.standard_normal((COUNT, 3)) + bias * wander


def readings(wanders: bool = True, seed: int = 3) -> np.ndarray:
    """Rates and forces (N, 6) at rest."""
    rng = np.random.default_rng(seed)
    degree, micro_g = np.pi / 180.0, 9.80665e-6
    part = float(wanders)
    gyros = triad(GYRO[0] * degree / 60.0, part * GYRO[1] * degree / 3600.0, GYRO[2], rng)
    forces = triad(FORCE[0] * micro_g, part * FORCE[1] * micro_g, FORCE[2], rng)
    return np.hstack([gyros + 1e-4, forces + np.array([0.05, -0.1, 9.8])])


def log(path, values: np.ndarray, names=RATES, times=None) -> str:
    times = PERIOD * np.arange(len(values)) if times is None else times
    files.write(path, {"time_s": times} | dict(zip(names, values.T, strict=True)))
    return str(path)


def printed(path: str) -> dict[str, float]:
    result = CliRunner().invoke(main, ["imu", path])
    assert result.exit_code == 0, result.output
    return tomllib.loads(result.output)["imu"]


@pytest.mark.long
@pytest.mark.parametrize("names", [RATES, DELTAS])
def test_the_keys_are_those_of_the_simulation(names, tmp_path):
    """White noise within 3 %, the bias within 15 % and its time within 30 %.

    An hour holds 60 and 90 correlation times of three axes: the bias's variance scatters by 10 %
    and the time by 12 %.
    """
    values = readings() * (PERIOD if names is DELTAS else 1.0)
    found = printed(log(tmp_path / "log.csv", values, names))
    spec = ImuSpec.model_validate(found)  # a table that a scenario can have
    assert spec.period_s == pytest.approx(PERIOD)
    for white, bias, time, expected in (
        (spec.gyro_noise_deg_per_sqrt_h, spec.gyro_bias_deg_per_h, spec.gyro_bias_time_s, GYRO),
        (
            spec.accelerometer_noise_ug_per_sqrt_hz,
            spec.accelerometer_bias_ug,
            spec.accelerometer_bias_time_s,
            FORCE,
        ),
    ):
        assert white == pytest.approx(expected[0], rel=0.03)
        assert bias == pytest.approx(expected[1], rel=0.15)
        assert time == pytest.approx(expected[2], rel=0.30)


def test_white_noise_alone_has_no_bias_time(tmp_path):
    """The bias is then the least flicker noise that the log could hide."""
    found = printed(log(tmp_path / "log.csv", readings(wanders=False)))
    assert found["gyro_noise_deg_per_sqrt_h"] == pytest.approx(GYRO[0], rel=0.02)
    assert "gyro_bias_time_s" not in found and "accelerometer_bias_time_s" not in found
    # 0.3 °/√h over 400 s, √(1/9) h.
    assert found["gyro_bias_deg_per_h"] == pytest.approx(0.3 / np.sqrt(1 / 9) / 0.664, rel=0.3)


def at_rest(
    samples: int = 2000,
    gaps: tuple[int, ...] = (),
    force: float = 1.0,
    moved: float = 0.0,
    back: int = 0,
) -> dict[str, np.ndarray]:
    """Readings and times with gaps of a second, a factor, a motion and a time that goes back."""
    values, times = readings()[:samples], PERIOD * np.arange(samples)
    for first in gaps:
        times[first:] += 1.0
    values[:, 3:] *= force
    values[1000:1100, 3] += moved
    if back:
        times[back] = times[back - 2]
    return {"values": values, "times": times}


BAD = {
    "a short log": ({"samples": 999}, "has 999 samples; at least 1000"),
    "two gaps": (
        {"gaps": (600, 1300)},
        "longest part without gaps has 700 samples; an Allan deviation needs at least 1000",
    ),
    "forces in g": (
        {"force": 1.0 / 9.80665},
        r"mean specific force is 0.9\d+ m/s².* check the unit; the unit may be g",
    ),
    "a motion": ({"moved": 2.0}, "is not at rest: .* cut the log"),
    "a time that goes back": ({"back": 1000}, "times must increase"),
    "no rates and forces": (
        "time_s,gyro_x\n" + "".join(f"{t},0\n" for t in range(9)),
        "needs all columns angular_rate_x_radps",
    ),
}
"""Changes of a log at rest or its text, and messages."""


@pytest.mark.parametrize("kind", BAD)
def test_a_log_that_says_nothing_has_its_sentence(kind, tmp_path):
    content, expected = BAD[kind]
    path = tmp_path / "log.csv"
    if isinstance(content, str):
        path.write_text(content)
    else:
        log(path, **at_rest(**content))
    with refused(FlightError, expected):
        imu_noise(path)
