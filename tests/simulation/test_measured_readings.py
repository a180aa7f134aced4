"""Readings that were measured: the lines of a survey are flown, and deliver what they had."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_cases import small_case
from small_noise import LINES, MIDDLE, NOISE, SECONDS, keys_of_lines, survey_folder

from ggbench.campaign import flights, result_keys
from ggbench.campaign.result_keys import input_files
from ggbench.errors import GGBenchError
from ggbench.gravity.ellipsoid import metres_per_radian
from ggbench.gravity.field import Field
from ggbench.judging.situations import is_right_model, situation_of
from ggbench.report.conditions import gradiometer_conditions, map_conditions, other_conditions
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.flight_bounds import flight_bound
from ggbench.simulation.runs import simulate, simulate_block
from ggbench.trajectory.survey_lines import read_lines


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return survey_folder(tmp_path_factory.mktemp("measured"))


@pytest.fixture
def keys(folder: Path) -> dict[str, Any]:
    return keys_of_lines(folder)


def test_a_reading_reaches_the_problem_as_it_was_measured(folder, keys):
    """The middle of a line, less the normal field at its places; the INS's errors do not touch it.

    The truth is the surveyed track, and the map of nothing predicts the normal field.
    """
    case = small_case(keys).of_run(1)
    line = read_lines(str(folder / "lines.csv"))["20.1"]
    flight = prepare(case)
    part = line.middle(MIDDLE)
    assert (part.start, part.stop) == (3, 24)  # the middle of 27 samples
    normal = Field.normal().tensor(*flight.trajectory.positions[flight.epochs].T)[:, [0, 2]]
    one, other = (simulate(flight, 5, run)[0].measurements for run in (1, 4))
    np.testing.assert_array_equal(one, other)
    read = np.stack([line.readings[name][part][1:] for name in ("xx", "xz")], axis=-1)
    np.testing.assert_allclose(one - normal, read, rtol=0.0, atol=1e-9)
    surveyed = np.stack([line.places[key] for key in ("latitude_deg", "longitude_deg")], axis=-1)
    off = flight.trajectory.positions[flight.epochs, :2] - np.radians(surveyed[part][1:])
    assert np.abs(off * metres_per_radian(flight.trajectory.positions[0])).max() < 0.01
    assert line.kind == "repeat"


def test_coloured_noise_is_whitened_behind_it(folder, keys):
    """What estimators receive is the whitening of the same readings."""
    white = prepare(small_case(keys).of_run(0))
    noise = {
        "gradiometer.noise_eotvos": None,
        "gradiometer.coloured_noise": str(folder / "noise.json"),
    }
    flight = prepare(small_case(keys | noise).of_run(0))
    whitening = NOISE.whitening(flight.times, flight.absent)
    np.testing.assert_array_equal(
        simulate(flight, 5, 0)[0].measurements,
        whitening.apply(simulate(white, 5, 0)[0].measurements),
    )


def test_runs_fly_the_lines_in_equal_shares(keys):
    """Run r flies line r modulo their number; that is its cluster; results are of a block, too."""
    case = small_case(keys)
    flown = [case.of_run(run).trajectory.lines for run in range(9)]
    assert Counter(flown) == {(name,): 3 for name in LINES}
    assert [case.cluster(run) for run in range(6)] == [0, 1, 2, 0, 1, 2]
    assert case.drawn
    block = flights.simulated(case, 5, (0, 1, 2, 3)).block
    for run in range(4):
        alone = simulate_block(prepare(case.of_run(run)), 5, [run])[0]
        np.testing.assert_array_equal(block.measurements[run], alone.measurements[0])
    assert not np.array_equal(block.measurements[0], block.measurements[1])
    np.testing.assert_array_equal(block.measurements[0], block.measurements[3])
    assert not np.array_equal(block.tracks[0], block.tracks[3])


def test_a_missing_reading_is_no_reading(folder, keys, tmp_path):
    """An empty cell: nothing is present, the bound counts without it, whitening bridges it."""
    rows = (folder / "lines.csv").read_text().splitlines()
    gap = 1 + 2 + 10  # of the first line: the tenth reading of the flight
    cells = rows[gap].split(",")
    rows[gap] = ",".join([*cells[:7], "", *cells[8:]])
    (tmp_path / "gap.csv").write_text("\n".join(rows))
    with_gap = keys | {"trajectory.file": str(tmp_path / "gap.csv"), "trajectory.lines": ["10"]}
    noise = {
        "gradiometer.noise_eotvos": None,
        "gradiometer.coloured_noise": str(folder / "noise.json"),
    }
    flight = prepare(small_case(with_gap | noise))
    problem, _ = simulate(flight, 5, 0)
    assert np.flatnonzero(~problem.present.all(axis=1)).tolist() == [9]
    np.testing.assert_array_equal(problem.measurements[9], 0.0)
    np.testing.assert_array_equal(flight_bound(flight).jacobians[9], 0.0)
    assert np.isfinite(problem.measurements).all()
    there = np.arange(20) != 9
    paused = NOISE.whitening(flight.times[there], np.zeros(19, dtype=bool))
    expected = paused.apply(flight.measured[there])
    np.testing.assert_allclose(problem.measurements[there], expected, atol=1e-9)


def test_zeros_beside_other_gradients_are_gradients(folder, tmp_path):
    rows = (folder / "lines.csv").read_text().splitlines()
    rows[7] = ",".join([*rows[7].split(",")[:7], "0.0,-0.0,2.5"])
    (tmp_path / "lines.csv").write_text("\n".join(rows))
    assert [*read_lines(str(tmp_path / "lines.csv"))] == [*LINES]


def test_all_lines_are_flown_by_their_times_with_turns_between(folder, keys, tmp_path):
    """Readings on lines only, the turns smooth, of the speeds of the lines' ends; one cluster."""
    rows = (folder / "lines.csv").read_text().splitlines()
    lines = read_lines(str(folder / "lines.csv")).values()
    day = {
        "trajectory.lines": [*LINES][::-1],
        "trajectory.made_up_turns": True,
        "trajectory.smoothing_s": 4.0,
    }
    whole = {key: value for key, value in keys.items() if key != "trajectory.middle_s"}
    sooner = [row.split(",") for row in rows[1:]]  # lines 200 s apart instead of 1000 s
    for cells in sooner:
        cells[3] = str(float(cells[3]) % 1000.0 + 200.0 * (float(cells[3]) // 1000.0))
    path = tmp_path / "day.csv"
    path.write_text("\n".join([rows[0], *(",".join(cells) for cells in sooner)]))
    case = small_case(whole | day | {"trajectory.file": str(path)})
    flight = prepare(case)
    assert flight.times[-1] == 2 * 200.0 + SECONDS + 2
    begun = [0.0, 200.0, 400.0]
    on = [(flight.times >= t) & (flight.times <= t + SECONDS + n) for n, t in enumerate(begun)]
    np.testing.assert_array_equal(~flight.absent, np.logical_or.reduce(on))
    *_, last = lines
    normal = Field.normal().tensor(*flight.trajectory.positions[flight.epochs].T)[:, [0, 2]]
    read = np.stack([last.readings[name] for name in ("xx", "xz")], axis=-1)
    np.testing.assert_allclose((flight.measured - normal)[on[2]], read, rtol=0.0, atol=1e-9)
    speeds = np.linalg.norm(flight.trajectory.velocities, axis=1)
    assert 50.0 < speeds.min() < speeds.max() < 66.0  # the lines are flown with 60 m/s
    steps = np.diff(flight.trajectory.velocities, axis=0) / flight.trajectory.dt
    assert np.linalg.norm(steps, axis=1).max() < 6.0  # 3.6 on a radius of a kilometre
    assert not case.drawn
    assert [case.cluster(run) for run in range(3)] == [0, 1, 2]


def test_no_model_is_the_right_one_of_what_was_measured(keys):
    """And the page says that readings are measured."""
    case = small_case(keys)
    assert not is_right_model(case)
    assert situation_of(case, 1000.0) == "measured"
    assert gradiometer_conditions(case)[0] == "measured gradients"
    simulated = small_case(keys | {"gradiometer.readings": "simulated"})
    assert is_right_model(simulated)


def test_a_key_is_of_the_content_of_the_files(folder, keys, tmp_path):
    """Copies elsewhere make the same problem, another noise model another one; all are listed."""
    for name in ("lines.csv", "noise.json"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    noise = {"gradiometer.noise_eotvos": None}

    def key(place: Path, change: dict[str, Any] | None = None) -> str:
        files = {
            "trajectory.file": str(place / "lines.csv"),
            "gradiometer.coloured_noise": str(place / "noise.json"),
        }
        case = small_case(keys | noise | files | (change or {}))
        assert {file["name"] for file in input_files([case])} >= {"lines.csv", "noise.json"}
        return result_keys.problem_key(case, 5)

    assert key(folder) == key(tmp_path)
    assert key(folder) != key(folder, {"trajectory.lines": [*LINES[:2]]})
    (tmp_path / "noise.json").write_text((folder / "noise.json").read_text() + "\n")
    assert key(folder) != key(tmp_path)


@pytest.fixture
def gravity(keys, tmp_path):
    """Keys of a gravimeter that reads what a survey has: one more column, one reading missing."""
    rows = Path(keys["trajectory.file"]).read_text().splitlines()
    read = ["disturbance_mgal", *(f"{20.0 + 0.5 * n:.1f}" for n in range(len(rows) - 1))]
    read[9] = ""
    path = tmp_path / "gravity.csv"
    path.write_text("\n".join(",".join(both) for both in zip(rows, read, strict=True)))
    flown = {key: value for key, value in keys.items() if not key.startswith("gradiometer")}
    sensor = {"period_s": 2.0, "noise_mgal": 0.5, "bias_mgal": 3.0, "readings": "measured"}
    return (
        flown
        | {"gradiometer": None, "trajectory.file": str(path)}
        | {f"gravimeter.{key}": value for key, value in sensor.items()}
    )


def test_gravity_reaches_the_problem_as_it_was_measured(gravity):
    """Over a map of nothing, two runs of a line differ by what their INSs make of the reduction.

    As simulated gravity of almost no noise does, to 0.1 µGal; a missing reading is not present.
    """
    measured = small_case(gravity)
    assert situation_of(measured, 1000.0) == "measured" and not is_right_model(measured)
    assert other_conditions([measured]) == "measured gravity every 2 s"
    assert "with its real errors" in map_conditions(measured)
    exact = small_case(
        gravity
        | {
            "gravimeter.readings": "simulated",
            "gravimeter.noise_mgal": 1e-6,
            "truth.gravimeter.bias_mgal": 0.0,
        }
    )
    flight, plain = (prepare(case.of_run(0)) for case in (measured, exact))
    rows = read_lines(gravity["trajectory.file"])["10"]
    read = rows.readings["disturbance"][rows.middle(MIDDLE)][2::2]
    assert np.isnan(read).sum() == 1
    for run in (0, 3):
        found, none = (simulate(f, 5, run)[0] for f in (flight, plain))
        there = ~np.isnan(read)
        np.testing.assert_array_equal(found.present[:, 0], there)
        off = (found.measurements - none.measurements)[there, 0]
        np.testing.assert_allclose(off, read[there], atol=1e-4)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"gravimeter.components": ["east"]}, 'requires components = ["scalar"]'),
        ({"truth.gravimeter.noise_mgal": 1.0}, "already contain their errors"),
        ({"gravimeter.period_s": 1.5}, "but gravimeter.period_s is 1.5"),
    ],
)
def test_gravity_that_cannot_be_read_is_refused_in_a_sentence(gravity, changes, said):
    with pytest.raises(GGBenchError) as raised:
        prepare(small_case(gravity | changes))
    assert said in str(raised.value)


def test_one_line_may_be_flown_whole(keys):
    whole = {key: value for key, value in keys.items() if key != "trajectory.middle_s"}
    flight = prepare(small_case(whole | {"trajectory.lines": ["20.1"]}))
    assert len(flight.times) == SECONDS + 1


def test_a_clock_may_drift_and_lines_that_are_not_flown_may_have_gaps(folder, keys, tmp_path):
    """Times are put at the interval; a line with a gap is refused only where it is flown."""
    rows = [row.split(",") for row in (folder / "lines.csv").read_text().splitlines()]
    at = rows[0].index("time_s")
    for number, row in enumerate(rows[1:]):
        row[at] = str(float(row[at]) + 0.02 * (number // 12 % 3))
    gap = [number for number, row in enumerate(rows) if row[0] == "30"][5]
    path = tmp_path / "drift.csv"
    path.write_text("\n".join(",".join(row) for number, row in enumerate(rows) if number != gap))
    moved = keys | {"trajectory.file": str(path)}
    off, straight = (prepare(small_case(k | {"trajectory.lines": ["10"]})) for k in (moved, keys))
    np.testing.assert_array_equal(off.times, straight.times)
    np.testing.assert_array_equal(off.measured, straight.measured)
    with pytest.raises(GGBenchError, match="line 30 must come every 1 s"):
        prepare(small_case(moved | {"trajectory.lines": ["30"]}))


def test_a_packed_file_is_read_as_it_is(folder, tmp_path):
    import gzip

    packed = tmp_path / "lines.csv.gz"
    packed.write_bytes(gzip.compress((folder / "lines.csv").read_bytes()))
    one, other = read_lines(str(folder / "lines.csv")), read_lines(str(packed))
    assert [*one] == [*other] == [*LINES]
    np.testing.assert_array_equal(one["30"].readings["xz"], other["30"].readings["xz"])
    packed.write_bytes(packed.read_bytes()[:-20])
    with pytest.raises(GGBenchError, match="cannot be unpacked"):
        read_lines(str(packed))
