"""Flights along tracks of the user's own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from error_free import closure
from problems import SMALL
from tracks import NAMES, NEAR_ZERO, ROWS, WHIRL, read, text, with_row, write

from ggbench.campaign import result_keys
from ggbench.errors import GGBenchError
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.runs import simulate
from ggbench.simulation.true_motion import trajectory_of
from ggbench.spec import scenario
from ggbench.spec.trajectory import TrajectorySpec
from ggbench.trajectory.manoeuvres import TrajectoryError
from ggbench.trajectory.truth import Trajectory


def degrees(flight: Trajectory, every: int) -> np.ndarray:
    """Rows of a CSV file (N, 4)."""
    positions = flight.positions[::every]
    return np.column_stack([flight.times[::every], np.degrees(positions[:, :2]), positions[:, 2]])


def distance(one: np.ndarray, other: np.ndarray) -> float:
    """Greatest distance [m] between positions (N, 3) near one another."""
    scale = np.stack([np.full(len(one), 6.38e6), 6.38e6 * np.cos(one[:, 0]), np.ones(len(one))])
    return float(np.abs((one - other) * scale.T).max())


@pytest.fixture(scope="module")
def hour() -> Trajectory:
    """A bit more than an hour of turns, climbs and changes of speed, known at 100 Hz."""
    lap = [
        {"kind": "cruise", "distance_km": 30.0},
        {"kind": "turn", "by_heading_deg": 180.0, "bank_deg": 25.0},
        {"kind": "climb", "by_height_m": 300.0, "climb_angle_deg": 3.0},
        {"kind": "cruise", "distance_km": 30.0},
        {"kind": "turn", "by_heading_deg": -180.0, "bank_deg": 25.0},
        {"kind": "climb", "by_height_m": -300.0, "vertical_speed_mps": 7.0},
        {"kind": "speed", "to_speed_mps": 170.0, "acceleration_mps2": 1.0},
        {"kind": "speed", "to_speed_mps": 200.0, "acceleration_mps2": 1.0},
    ]
    start = {"latitude_deg": 33.5, "longitude_deg": 179.9, "height_m": 3000.0}
    return trajectory_of(
        TrajectorySpec.model_validate(
            start | {"speed_mps": 200.0, "heading_deg": 80.0, "segment": lap, "repeat": 6}
        ),
        0.01,
    )


@pytest.mark.long
@pytest.mark.parametrize("rate", [1, 10])
def test_the_truth_is_where_the_track_is(hour, tmp_path, rate):
    """Over an hour, across 180° E, within 5 cm of every row, and smooth in between.

    Velocity and attitude are those of the flight that wrote the file, which banked for the same
    turns; from 1 Hz, but for what a second hides.
    """
    rows = degrees(hour, 100 // rate)
    rows[:, 2] = (rows[:, 2] + 180.0) % 360.0 - 180.0
    assert np.ptp(rows[:, 2]) > 300.0
    asked = read(write(tmp_path / "track.csv", rows))
    flight = trajectory_of(asked, 0.05)
    assert asked.duration_s == pytest.approx(rows[-1, 0], abs=1e-9)
    assert flight.times[-1] > 3600.0
    same = hour.positions[:: 100 // rate].copy()
    at_rows = flight.positions[:: 20 // rate]
    assert np.abs(at_rows[0, 1]) <= np.pi
    count = min(len(at_rows), len(same))
    assert distance(at_rows[:count], same[:count]) < 0.05
    every = slice(None, 5 * len(flight.times), 5)
    count = min(len(flight.times), len(hour.times[every]))
    velocity = flight.velocities[:count] - hour.velocities[every][:count]
    assert np.abs(velocity).max() < (0.05 if rate == 1 else 0.005)
    turn = flight.attitudes[:count] @ hour.attitudes[every][:count].transpose(0, 2, 1)
    assert np.degrees(np.abs(turn - np.eye(3)).max()) < 0.6
    position, speed, attitude = closure(flight)
    assert np.abs(position).max() < 1.0
    assert np.abs(position[: 200 * 20]).max() < 1e-3
    assert np.abs(speed).max() < 1e-3
    assert attitude.max() < 1e-9


def test_a_straight_course_needs_no_bank_though_meridians_converge(tmp_path):
    """At 80° N, to the north-east at a constant heading: level to 0.01°.

    The angle between the meridians on its way would be mistaken for a turn with a bank of 0.2°.
    """
    start = {"latitude_deg": 80.0, "longitude_deg": 10.0, "height_m": 3000.0}
    course = start | {"speed_mps": 250.0, "heading_deg": 45.0, "segment": [{"duration_s": 200.0}]}
    flown = trajectory_of(TrajectorySpec.model_validate(course), 0.05)
    again = trajectory_of(read(write(tmp_path / "track.csv", degrees(flown, 20), decimals=12)), 0.1)
    tilt = np.degrees(np.abs(again.attitudes[20:-20, 2, :2]))
    assert tilt.max() < 0.01


@pytest.mark.long
def test_rows_denser_than_the_samples_leave_no_drift(hour, tmp_path):
    """Rounded to millimetres at 100 Hz, they wiggle by 0.1 m/s: no reason to go astray."""
    rows = degrees(hour, 1)[:130_000]
    rng = np.random.default_rng(5)
    rows[:, 3] += rng.uniform(-5e-4, 5e-4, len(rows))
    file = write(tmp_path / "dense.csv", rows, decimals=8)
    flight = trajectory_of(read(file, vehicle="ship", max_acceleration_mps2=200.0), 0.05)
    assert distance(flight.positions, hour.positions[:130_000:5]) < 0.01


def test_smoothing_takes_noise_away(hour, tmp_path):
    """Noise of 0.3 m at 10 Hz is refused; smoothed, half of a wave of that period is left."""
    rows = degrees(hour, 10)[:6000]
    noisy = rows.copy()
    noisy[:, 1:3] += np.degrees(np.random.default_rng(6).normal(0.0, 0.3, (6000, 2)) / 6.38e6)
    noisy[:, 3] += np.random.default_rng(7).normal(0.0, 0.3, 6000)
    file = write(tmp_path / "noisy.csv", noisy)
    with pytest.raises(TrajectoryError, match=r"acceleration of .* remove noise with smoothing_s"):
        trajectory_of(read(file), 0.05)
    flight = trajectory_of(read(file, smoothing_s=6.0), 0.05)
    assert distance(flight.positions[::200], hour.positions[::1000][:60]) < 1.0
    assert np.abs(np.diff(flight.velocities, axis=0)).max() / 0.05 < 8.0
    rows[:, 3] += 100.0 * np.sin(2.0 * np.pi * rows[:, 0] / 20.0)
    rows[:, 3] -= hour.positions[::10, 2][:6000]
    wave = trajectory_of(read(write(tmp_path / "wave.csv", rows), smoothing_s=20.0), 0.1)
    middle = wave.positions[1000:5000, 2]
    np.testing.assert_allclose(
        middle, 50.0 * np.sin(2.0 * np.pi * wave.times[1000:5000] / 20.0), atol=0.1
    )


def test_smoothing_does_not_depend_on_how_dense_the_rows_are(tmp_path):
    """Half of a wave of the period is left, where rows are 0.2 s apart and where they are 1 s."""
    times = np.concatenate([np.arange(0.0, 300.0, 0.2), np.arange(300.0, 600.0)])
    rows = np.column_stack([times, 33.0 + 1e-3 * times, 108.0 + 0.0 * times, 0.0 * times])
    rows[:, 3] = 1000.0 + 20.0 * np.sin(2.0 * np.pi * times / 20.0)
    flight = trajectory_of(read(write(tmp_path / "wave.csv", rows), smoothing_s=20.0), 0.1)
    middle = (flight.times > 50.0) & (flight.times < 550.0) & (np.abs(flight.times - 300.0) > 40.0)
    wave = 1000.0 + 10.0 * np.sin(2.0 * np.pi * flight.times / 20.0)
    np.testing.assert_allclose(flight.positions[middle, 2], wave[middle], atol=0.2)


def test_attitude_comes_from_the_columns(tmp_path):
    """Heading through north, pitch and roll, where they are given; a crab angle stays one."""
    times = np.arange(0.0, 60.0)
    heading, pitch, roll = (350.0 + 0.5 * times) % 360.0, 3.0 + 0.0 * times, np.sin(times / 5.0)
    rows = np.column_stack(
        [times, 30.0 + 1e-3 * times, 100.0 + 0.0 * times, 500.0 + times, heading, pitch, roll]
    )
    flight = trajectory_of(
        read(write(tmp_path / "a.csv", rows, NAMES + ",Yaw,pitch,ROLL_DEG")), 0.1
    )
    forward, right = flight.attitudes[:, :, 1], flight.attitudes[:, :, 0]
    headings = np.degrees(np.unwrap(np.arctan2(forward[:, 0], forward[:, 1]))) + 360.0
    np.testing.assert_allclose(headings[::10], 350.0 + 0.5 * times, atol=1e-6)
    np.testing.assert_allclose(np.degrees(np.arcsin(forward[:, 2])), 3.0, atol=1e-6)
    rolled = np.degrees(np.arctan2(-right[::10, 2], flight.attitudes[::10, 2, 2]))
    np.testing.assert_allclose(rolled, roll, atol=1e-6)


def test_a_ship_waits_without_losing_its_heading(tmp_path):
    """While it lies still it keeps its heading; it turns without leaning and pitches not."""
    times = np.arange(0.0, 300.0)
    speed = np.interp(times, [0, 60, 80, 200, 220, 300], [5, 5, 0, 0, 5, 5])
    north = np.cumsum(speed)
    rows = np.column_stack(
        [times, 10.0 + np.degrees(north / 6.34e6), 0.0 * times, 0.2 * np.sin(times / 9.0)]
    )
    flight = trajectory_of(read(write(tmp_path / "ship.csv", rows), vehicle="ship"), 0.1)
    turned = flight.attitudes - np.eye(3)
    assert np.degrees(np.abs(turned).max()) < 1.0
    np.testing.assert_allclose(flight.attitudes[:, 2, 2], 1.0, atol=1e-12)


def test_level_flight_has_the_attitude_that_is_given(tmp_path):
    """Where the track gives none: nose up and leaning as an aircraft is in straight flight."""
    times = np.arange(0.0, 30.0)
    rows = np.column_stack([times, 30.0 + 1e-3 * times, 100.0 + 0.0 * times, 500.0 + 0.0 * times])
    file = write(tmp_path / "level.csv", rows)
    flight = trajectory_of(read(file, pitch_deg=3.0, roll_deg=2.0), 0.1)
    rolled = np.arctan2(-flight.attitudes[:, 2, 0], flight.attitudes[:, 2, 2])
    np.testing.assert_allclose(np.degrees(np.arcsin(flight.attitudes[:, 2, 1])), 3.0, atol=1e-3)
    np.testing.assert_allclose(np.degrees(rolled), 2.0, atol=1e-3)


def test_a_track_is_flown_to_its_last_row(tmp_path):
    """0.7 s are seven intervals of 0.1 s, though in binary a little less."""
    times = np.linspace(0.0, 0.7, 8)
    rows = np.column_stack([times, 30.0 + 1e-3 * times, 100.0 + 0.0 * times, 500.0 + 0.0 * times])
    flight = trajectory_of(read(write(tmp_path / "short.csv", rows)), 0.1)
    assert len(flight.times) == 8


def test_a_degree_of_longitude_is_short_in_the_north(tmp_path):
    """At 80° a tenth of a degree is 1.9 km, and not as on the equator 11 km, in a second."""
    times = np.arange(0.0, 20.0)
    rows = np.column_stack([times, 80.0 + 0.0 * times, 100.0 + 0.1 * times, 500.0 + 0.0 * times])
    assert read(write(tmp_path / "fast.csv", rows)).duration_s == 19.0


def test_what_has_not_yet_moved_points_where_it_will_go(tmp_path):
    """Eastwards, before it starts and after it has stopped."""
    times = np.arange(0.0, 120.0)
    east = np.cumsum(np.interp(times, [0, 30, 50, 80, 100, 120], [0, 0, 5, 5, 0, 0]))
    rows = np.column_stack([times, 0.0 * times, np.degrees(east / 6.378e6), 0.0 * times])
    flight = trajectory_of(read(write(tmp_path / "bus.csv", rows), vehicle="ship"), 0.1)
    np.testing.assert_allclose(flight.attitudes[:, 0, 1], 1.0, atol=1e-6)


@pytest.mark.parametrize("around", [0.0, 360.0])
def test_a_track_crosses_greenwich(tmp_path, around):
    """In either notation of longitudes there is no jump."""
    times = np.arange(0.0, 20.0)
    rows = np.column_stack([times, 51.5 + 0.0 * times, 1e-3 * (times - 9.0), 500.0 + 0.0 * times])
    rows[:, 2] += np.where(rows[:, 2] < 0.0, around, 0.0)
    flight = trajectory_of(read(write(tmp_path / "thames.csv", rows)), 0.1)
    assert np.degrees(np.ptp(flight.positions[:, 1])) == pytest.approx(0.019, rel=1e-3)


def test_a_whirl_is_flown_with_short_intervals(tmp_path):
    """Of 60° from second to second."""
    path = tmp_path / "whirl.csv"
    path.write_text(WHIRL)
    assert trajectory_of(read(str(path)), 0.4).times[-1] == pytest.approx(18.8)


def test_smoothing_is_as_wide_as_a_thousand_steps(tmp_path):
    path = tmp_path / "track.csv"
    path.write_text(text())
    assert read(str(path), smoothing_s=1000.0).duration_s == 19.0


SAME = {
    "as it is": text(),
    "byte order mark": "\ufeff" + text(),
    "of Windows": text().replace("\n", "\r\n"),
    "of an old Mac": text().replace("\n", "\r"),
    "semicolons": text().replace(",", ";"),
    "tabs": text().replace(",", "\t"),
    "spaces": text().replace(",", " , "),
    "quoted": '"' + text().strip().replace(",", '","').replace("\n", '"\n"') + '"',
    "a quoted comma": text([f'{row},"48.1,11.5 ""N"""' for row in ROWS], NAMES + ',"place, deg"'),
    "names behind a #": "# " + text(names="time,lat,lon,alt"),
    "names behind a remark": '# flight 7, of "May\n#' + text(),
    "a # of names above names": "# time_s,height_m,roll\n" + text(),
    "names behind a #, then units": "#" + text(names=NAMES + "\n# s,deg,deg,m"),
    "separator of Excel": "sep=;\n" + text().replace(",", ";"),
    "other names": text(names="T,Latitude,LON,Alt"),
    "remarks above": "# a flight\n\n" + text(),
    "empty lines below": text() + "\n\n",
    "column of names": text([row + ",CALL-SIGN" for row in ROWS], NAMES + ",call"),
    "other order": text(
        [",".join(row.split(",")[::-1]) for row in ROWS], ",".join(NAMES.split(",")[::-1])
    ),
    "units in brackets": text(names="time [s],Latitude (deg),lon[°],alt [m]"),
    "feet in brackets": text(
        [f"{r.rpartition(',')[0]},{float(r.rpartition(',')[2]) / 0.3048:.9f}" for r in ROWS],
        "time [s],lat [deg],lon [deg],alt (ft)",
    ),
    "units behind a #": "# time [s],lat [deg],lon [deg],alt [m]\n" + text()[len(NAMES) + 1 :],
    "dates": text(
        [
            f"2024-02-29T23:59:{50 + t}Z,{r.partition(',')[2]}"
            if t < 10
            else f"2024-03-01 00:00:{t - 10:02}.000,{r.partition(',')[2]}"
            for t, r in enumerate(ROWS)
        ]
    ),
    "another clock": text(
        [f"{1.7e9 + t:.0f}," + row.partition(",")[2] for t, row in enumerate(ROWS)]
    ),
}


@pytest.mark.parametrize("kind", SAME)
def test_one_track_in_many_spellings(kind, tmp_path):
    """Separators, line ends, names and what stands around the numbers change nothing."""
    path = tmp_path / "track.csv"
    path.write_bytes(SAME[kind].encode())
    flight = trajectory_of(read(str(path)), 0.1)
    path.write_text(text())
    plain = trajectory_of(read(str(path)), 0.1)
    np.testing.assert_allclose(flight.positions, plain.positions, rtol=0.0, atol=1e-9)


def test_degrees_near_zero_are_degrees(tmp_path):
    """Only where all of latitude and longitude could be radians is it doubted."""
    rows = NEAR_ZERO
    path = tmp_path / "track.csv"
    path.write_text(text(rows, "time_s,lat,lon,height_m"))
    assert np.degrees(trajectory_of(read(str(path)), 0.1).positions[0, 0]) == pytest.approx(1.6)
    path.write_text(
        text(
            [row.replace(",1.6", ",1.5").replace(",3.0", ",3.2") for row in rows],
            "time_s,lat,lon,height_m",
        )
    )
    assert np.degrees(trajectory_of(read(str(path)), 0.1).positions[0, 0]) == pytest.approx(1.5)


def test_limits_can_be_widened(tmp_path):
    """A gap that is meant, and a rocket."""
    path = tmp_path / "track.csv"
    path.write_text(text(ROWS[:5] + ROWS[12:]))
    assert read(str(path), max_gap_s=8.0).duration_s == 19.0
    path.write_text(with_row("3,33.004,108.003,3000"))
    assert read(str(path), max_acceleration_mps2=1000.0).duration_s == 19.0


# In a scenario.


def test_a_scenario_flies_a_track(hour, tmp_path):
    """Up to a simulated run; another content is another problem, another place is not."""
    rows = degrees(hour, 100)[:30]
    file = Path(write(tmp_path / "track.csv", rows))
    start, end = SMALL.index("[trajectory]"), SMALL.index("[imu]")
    path = tmp_path / "small.toml"

    def load(track: Path) -> scenario.CaseSpec:
        path.write_text(f'{SMALL[:start]}[trajectory]\nfile = "{track}"\n\n{SMALL[end:]}')
        return scenario.load(str(path)).cases[0]

    case = load(file)
    flight = prepare(case)
    assert flight.times[-1] == 29.0
    problem, _ = simulate(flight, seed=1, run=0)
    assert problem.epochs == 29
    key = result_keys.problem_key(case, 1)
    copy = tmp_path / "copy.csv"
    copy.write_bytes(file.read_bytes())
    assert result_keys.problem_key(load(copy), 1) == key
    rows[:, 3] += 100.0
    write(file, rows)
    assert result_keys.problem_key(case, 1) != key
    again = prepare(case)
    assert again.trajectory.positions[0, 2] == pytest.approx(3100.0)
    file.write_text(with_row("3,33.003,E108,3000"))
    with pytest.raises(GGBenchError, match=r"^track .*line 5: longitude_deg is 'E10"):
        prepare(case)
    write(file, rows[:8])
    with pytest.raises(GGBenchError, match=r"settled_from_s is 10 s .* last reading, at 7 s"):
        prepare(case)
    # Without the track there is no flight; results of old can still be read.
    file.unlink()
    old = load(file)
    assert scenario.from_text(path.read_text(), "small", "").cases[0] == old
    with pytest.raises(GGBenchError, match=r"cannot read .*track.csv: No such file"):
        prepare(case)
