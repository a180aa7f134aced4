"""Logs as people have them: clocks in other units, names of other programs, gaps, increments."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from click.testing import CliRunner
from recorded_flights import GNSS_ONLY, edit, edit_rows, recorded
from thinning import thinned

from ggbench.cli.main import main
from ggbench.recorded import columns as files
from ggbench.recorded.allan import imu_noise
from ggbench.recorded.flight import read_flight
from ggbench.recorded.inertial import DELTAS, RATES
from ggbench.spec.flight import FlightError

COUNT, PERIOD = 4000, 0.02
TIMES = PERIOD * np.arange(COUNT)
RNG = np.random.default_rng(8)
GYROS = RNG.normal(0.0, 1e-4, (COUNT, 3)) + 1e-5
FORCES = RNG.normal([0.02, -0.03, 9.8], 1e-3, (COUNT, 3))
VALUES = np.hstack([GYROS, FORCES])


def log(path, values=VALUES, times=TIMES, names=("time_s", *RATES), head="{}", form="%.9g"):
    rows = np.column_stack([times, values])
    text = head.format(",".join(names))
    np.savetxt(path, rows, fmt=["%.17g", *[form] * 6], delimiter=",", header=text, comments="")
    return path


def run(*words, code=0):
    result = CliRunner().invoke(main, ["imu", *map(str, words)])
    assert result.exit_code == code, (result.output, result.exception)
    return result


def keys(*words):
    return tomllib.loads(run(*words).stdout)["imu"]


@pytest.fixture
def plain(tmp_path):
    return keys(log(tmp_path / "plain.csv"))


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
@thinned("start", [0.0, 1.4e9])
def test_times_in_another_unit_are_refused_or_converted(unit, factor, start, plain, tmp_path):
    """Without a statement they are refused; in brackets of the name or of the option converted."""
    path = log(tmp_path / "a.csv", times=np.round(factor * (start + TIMES)))
    assert f"[{unit}]" in run(path, code=2).output
    assert keys(path, "--column", f"time_s=time_s [{unit}]") == pytest.approx(plain, rel=1e-3)
    named = log(tmp_path / "b.csv", times=factor * TIMES, names=(f"time_s [{unit}]", *RATES))
    assert keys(named) == pytest.approx(plain, rel=1e-6)
    with pytest.raises(
        FlightError, match="names a column 'time_s' in 'mgal'; allowed units of time_s"
    ):
        imu_noise(path, {"time_s": "time_s [mGal]"})


def test_slow_samples_are_taken_where_seconds_are_stated(tmp_path):
    path = log(tmp_path / "a.csv", times=np.arange(COUNT))
    assert "too long for an IMU" in run(path, code=2).output
    assert keys(path, "--column", "time_s=time_s [s]")["period_s"] == 1.0


@pytest.mark.parametrize("noise", [0.05, 0.5])
def test_gyros_in_degrees_are_warned_of(noise, tmp_path):
    """By their noise, which is beyond any grade; as a control, in rad/s they are right."""
    gyros = np.random.default_rng(2).normal(0.0, noise, (COUNT, 3))
    path = log(tmp_path / "a.csv", np.hstack([gyros, FORCES]))
    result = run(path)
    assert "is larger than that of any grade" in result.stderr and "°/s" in result.stderr
    options = [f"--column={name}={name} [deg/s]" for name in RATES[:3]]
    right = run(path, *options)
    assert "Warning" not in right.stderr
    found = [tomllib.loads(r.stdout)["imu"]["gyro_noise_deg_per_sqrt_h"] for r in (result, right)]
    assert found[0] / found[1] == pytest.approx(np.degrees(1.0), rel=0.01)


@pytest.mark.parametrize(("unit", "factor"), [("deg/s", 1.0), ("deg/h", 3600.0)])
def test_good_gyros_in_degrees_show_the_rotation_of_the_earth(unit, factor, tmp_path):
    """Its 15.04° an hour; as a control, in rad/s nothing is said."""
    rates = np.random.default_rng(3).normal([0.0, 5.4e-5, 4.9e-5], 1e-7, (COUNT, 3))
    log(tmp_path / "a.csv", np.hstack([rates, FORCES]), form="%.12g")
    assert "Warning" not in run(tmp_path / "a.csv").stderr
    log(tmp_path / "a.csv", np.hstack([factor * np.degrees(rates), FORCES]), form="%.12g")
    assert f"the Earth's rotation in {unit}" in run(tmp_path / "a.csv").stderr


OTHERS = {
    "euroc": (
        "timestamp [ns]",
        *(f"w_RS_S_{a} [rad s^-1]" for a in "xyz"),
        *(f"a_RS_S_{a} [m s^-2]" for a in "xyz"),
        1e9,
    ),
    "px4": (
        "timestamp",
        *(f"gyro_rad[{n}]" for n in range(3)),
        *(f"accelerometer_m_s2[{n}]" for n in range(3)),
        1e6,
    ),
    "ros": (
        "%time",
        *(f"field.angular_velocity.{a}" for a in "xyz"),
        *(f"field.linear_acceleration.{a}" for a in "xyz"),
        1e9,
    ),
}


@pytest.mark.parametrize("preset", OTHERS)
@pytest.mark.parametrize("head", ["{}", "#{}"])
def test_names_of_other_programs_have_presets(preset, head, plain, tmp_path):
    """Which a file without one is told of."""
    *names, factor = OTHERS[preset]
    path = log(tmp_path / "a.csv", times=np.round(factor * TIMES), names=names, head=head)
    assert keys(path, "--preset", preset) == pytest.approx(plain, rel=1e-3)
    assert f'give columns = "{preset}"' in run(path, code=2).output


def test_names_and_units_of_a_log_are_given_by_options(plain, tmp_path):
    """A log of Xsens: remarks behind //, tabs, ticks of 0.1 ms, and a counter."""
    names = (
        "PacketCounter",
        "SampleTimeFine",
        *(f"Gyr_{a}" for a in "XYZ"),
        *(f"Acc_{a}" for a in "XYZ"),
    )
    rows = [
        "\t".join([f"{n:05d}", f"{round(1e4 * t)}", *(f"{v:.9g}" for v in row)])
        for n, (t, row) in enumerate(zip(TIMES, VALUES, strict=True))
    ]
    text = "\n".join(["// Start Time: Unknown", "// Update Rate: 50.0Hz", "\t".join(names), *rows])
    (tmp_path / "x.txt").write_text(text)
    options = ["--column", "time_s=SampleTimeFine [1e-4 s]"]
    for own, name in zip(RATES, names[2:], strict=True):
        options += ["--column", f"{own}={name}"]
    assert keys(tmp_path / "x.txt", *options) == pytest.approx(plain, rel=1e-3)
    assert "has no" not in run(tmp_path / "x.txt", *options[:2], code=2).output
    said = run(tmp_path / "x.txt", "--column", "time_s=Ticks", code=2).output
    assert "names no column 'Ticks' for time_s" in said
    assert (
        "columns.speed is not a column"
        in run(tmp_path / "x.txt", "--column", "speed=a", code=2).output
    )


@pytest.mark.parametrize("share", [0.01, 0.05])
def test_lost_samples_are_skipped_and_said(share, plain, tmp_path):
    """White noise stays what it is, to its scatter of 2 %; no bias is made up."""
    kept = np.random.default_rng(4).random(COUNT) > share
    result = run(log(tmp_path / "a.csv", VALUES[kept], TIMES[kept]))
    assert "missing samples are skipped" in result.stdout
    found = tomllib.loads(result.stdout)["imu"]
    assert "gyro_bias_time_s" not in found
    assert found["period_s"] == PERIOD
    assert found["gyro_noise_deg_per_sqrt_h"] == pytest.approx(
        plain["gyro_noise_deg_per_sqrt_h"], rel=0.03
    )


def test_of_a_log_with_a_gap_the_longest_piece_is_used(tmp_path):
    kept = np.r_[0:1000, 1500:COUNT]
    result = run(log(tmp_path / "a.csv", VALUES[kept], TIMES[kept]))
    assert "1 gap of up to 10.02 s: only the longest gap-free piece" in result.stdout
    alone = log(tmp_path / "b.csv", VALUES[1500:], TIMES[1500:])
    assert tomllib.loads(result.stdout)["imu"] == keys(alone)
    kept = np.r_[0:900, 1500:2400]
    said = run(log(tmp_path / "c.csv", VALUES[kept], TIMES[kept]), code=2).output
    assert "longest part without gaps has 900 samples" in " ".join(said.split())


def test_stamps_that_jitter_lose_nothing(plain, tmp_path):
    jitter = np.random.default_rng(5).uniform(-0.4, 0.4, COUNT) * PERIOD
    result = run(log(tmp_path / "a.csv", times=TIMES + jitter))
    assert "times jitter" in result.stdout and "lost" not in result.stdout
    assert tomllib.loads(result.stdout)["imu"] == pytest.approx(plain, rel=1e-2)


def test_increments_under_names_of_rates_are_named_and_the_reverse(tmp_path):
    increments = log(tmp_path / "a.csv", PERIOD * VALUES)
    said = run(increments, code=2).output
    assert "increments (0.196 = 9.8 × 0.02 s): rename them delta_velocity" in said
    rates = log(tmp_path / "b.csv", VALUES, names=("time_s", *DELTAS))
    said = run(rates, code=2).output
    assert "rates (490 = 9.8 / 0.02 s): rename them specific_force" in said
    in_g = log(tmp_path / "c.csv", np.hstack([GYROS, FORCES / 9.80665]))
    assert "the unit may be g" in run(in_g, code=2).output


def test_a_flight_of_increments_under_names_of_rates_is_named(tmp_path):
    """And the reverse, in the file of a recorded flight."""
    path = recorded(tmp_path / "log", GNSS_ONLY)
    period = 0.1

    def as_rates(table):
        return table.rename(columns=dict(zip(DELTAS, RATES, strict=True)))

    def divided(table):
        table[list(DELTAS)] /= period

    edit_rows(path.parent / "imu.csv", as_rates)
    with pytest.raises(
        FlightError, match=r"be g, or the columns may be increments \(0\.9\d+ = 9\.\d+ × 0\.1 s\)"
    ):
        read_flight(path)
    path = recorded(tmp_path / "other", GNSS_ONLY)
    edit_rows(path.parent / "imu.csv", divided)
    with pytest.raises(FlightError, match=r"may be rates \(9\d\.\d = 9\.\d+ / 0\.1 s\)"):
        read_flight(path)


def test_records_of_a_flight_may_have_other_names_and_units(tmp_path):
    """Milliseconds, feet and knots of a receiver: the same problem to a millimetre."""
    path = recorded(tmp_path / "log", GNSS_ONLY)
    before = read_flight(path).problem

    def renamed(table):
        table["time_s"] *= 1e3
        table["height_m"] /= 0.3048
        speeds = [name for name in table if name.startswith("velocity")]
        table[speeds] *= 3600.0 / 1852.0
        return table.rename(
            columns={"time_s": "Stamp", "height_m": "Alt[0]"}
            | {name: name.upper() for name in speeds}
        )

    edit_rows(path.parent / "gnss.csv", renamed)
    names = {"time_s": "stamp [ms]", "height_m": "Alt[0] [ft]"}
    axes = ("east", "north", "up")
    names |= {f"velocity_{a}_mps": f"velocity_{a}_mps [knots]" for a in axes}
    after = read_flight(edit(path, {"gnss.columns": names})).problem
    np.testing.assert_allclose(after.measurements, before.measurements, atol=1e-3)
    with pytest.raises(FlightError, match=r"names no column 'alt' for height_m"):
        read_flight(edit(path, {"gnss.columns": names | {"height_m": "alt"}}))
    with pytest.raises(FlightError, match=r"gnss\.columns: must be a table of names or one of"):
        read_flight(edit(path, {"gnss.columns": "px5"}))


def test_a_variable_of_netcdf_is_converted_by_its_units(tmp_path):
    import netCDF4

    with netCDF4.Dataset(tmp_path / "a.nc", "w") as file:
        file.createDimension("n", 3)
        for name, units, values in (("t", "ms", [0, 1000, 2000]), ("alt", "ft", [100, 200, 300])):
            variable = file.createVariable(name, "f8", ("n",))
            variable.units = units
            variable[:] = values
    found = files.read(tmp_path / "a.nc", ("height_m",), names={"time_s": "t", "height_m": "alt"})
    np.testing.assert_allclose(found["time_s"], [0.0, 1.0, 2.0])
    np.testing.assert_allclose(found["height_m"], [30.48, 60.96, 91.44])


def test_a_log_that_lacks_too_many_samples_is_refused(tmp_path):
    kept = np.arange(COUNT) % 5 != 4
    said = run(log(tmp_path / "a.csv", VALUES[kept], TIMES[kept]), code=2).output
    assert "of the samples are missing" in " ".join(said.split())


def test_an_axis_that_is_constant_and_marks_of_missing_values_are_refused(tmp_path):
    values = VALUES.copy()
    values[:, 1] = 1e-5
    path = log(tmp_path / "constant.csv", values)
    message = " ".join(run(path, code=2).output.split())
    assert "constant on axis y: their noise" in message and "finite" not in message
    values = VALUES.copy()
    values[700, 5] = -9999.0
    output = run(log(tmp_path / "mark.csv", values), code=2).output
    assert "line 702: specific_force_z_mps2 is -9999 and must lie between" in output


def test_noise_below_any_grade_is_not_called_larger(tmp_path):
    values = np.hstack([1e-12 * GYROS, FORCES])
    result = run(log(tmp_path / "a.csv", values))
    assert "smaller than that of any grade" in result.stderr and "larger" not in result.stderr
