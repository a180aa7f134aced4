"""A simulated run that is recorded and read back is the same problem, with the same estimates."""

from __future__ import annotations

import math
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from paper_flights import flight
from recorded_flights import GNSS_ONLY, RUN, SEED, as_solution, edit, edit_rows, recorded, table_of
from small_cases import GRAVIMETER, ON_BOARD, SEVERAL, rough_map, small_flight
from thinning import thinned

import ggbench as gg
from ggbench.recorded.flight import read_flight
from ggbench.recorded.inertial import RATES
from ggbench.simulation.runs import simulate

LABELS = ("ekf", "ekf", "factor-graph[mode=batch]", "closed-loop[interval_s=5]")
SAME = 1e-9
"""In units of the prior's deviations: a receiver's degrees say where it is to 1e-9 m.

The graph's optimiser stops at a tolerance of its own, and a last digit may cost it an iteration: of
ten runs of the flight with everything one differs by 1e-8.
"""
EVERYTHING = (
    ON_BOARD
    | GRAVIMETER
    | {
        "gradiometer.instrument": "strapdown",
        "gradiometer.bias_eotvos": 0.5,
        "gradiometer.mounting_sigma_arcmin": 1.0,
        "truth.gnss.dropouts_s": [[5.0, 9.0]],
        "truth.barometer.dropout_share": 0.2,
        "truth.gradiometer.dropout_share": 0.2,
        "truth.velocity_log.outlier_share": 0.1,
        "truth.velocity_log.outlier_mps": 3.0,
        "model.gnss.position_noise_m": 6.0,
    }
)
NAMED = (
    ON_BOARD
    | GRAVIMETER
    | SEVERAL
    | {
        "sensor.vector.kind": "gravimeter",
        "sensor.vector.period_s": 1.0,
        "sensor.vector.noise_mgal": 2.0,
        "sensor.vector.components": ["east", "north"],
        "truth.gnss.dropouts_s": [[5.0, 9.0]],
        "truth.sensor.stern.dropout_share": 0.3,
        "model.sensor.stern.position_noise_m": 2.5,
        "sensor.stern.lever_arm_m": [1.0, -30.0, 5.0],
        "sensor.stern.lever_arm_sigma_m": 1.0,
        "sensor.bow_2.lever_arm_sigma_m": 0.5,
        "gnss.position_bias_m": 2.0,
    }
)
DAMPED = {
    "altimeter.noise_m_per_sqrt_hz": 1.0,
    "imu.gyro_bias_time_s": 100.0,
    "field.gravity_disturbance": True,
    "model.field.compensate": True,
}
DISTURBED = {
    "field.gravity_disturbance": True,
    "model.disturbance.horizontal_mgal": 20.0,
    "model.disturbance.distance_km": 5.0,
    "initial_error.heading_arcmin": 3.0,
    "altimeter.noise_m_per_sqrt_hz": 1.0,
}
INTEGRATED = {
    "field.gravity_disturbance": True,
    "model.disturbance.horizontal_mgal": 20.0,
    "model.disturbance.integrate_gradients": True,
    "gradiometer.instrument": "local-level",
    "truth.gradiometer.dropout_share": 0.2,
}
LATE = {"gradiometer.latency_s": 2.5, "gradiometer.instrument": "strapdown"}
DELAYED = {
    "gradiometer.instrument": "strapdown",
    "gradiometer.filter": "butterworth",
    "gradiometer.filter_cutoff_hz": 0.2,
    "gradiometer.filter_treatment": "delayed",
}
UNFED = ("wang2013", "integrated", "delayed", "late")
"""Flights whose gradients depend on the track before, so that nothing can be fed back."""


def difference(problem: gg.Problem, one: gg.Estimate, other: gg.Estimate) -> float:
    """The largest difference of means and covariances, in units of the prior's deviations."""
    sigma = np.sqrt(np.diag(problem.prior_cov))
    return max(
        float(np.max(np.abs(one.mean - other.mean) / sigma)),
        float(np.max(np.abs(one.cov - other.cov) / np.outer(sigma, sigma))),
    )


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> dict[str, str]:
    return {"field.source": rough_map(tmp_path_factory.mktemp("map") / "rough.nc")}


@thinned(
    "name",
    (*UNFED, "everything", "named", "damped", "disturbed", "GNSS"),
)
def test_estimates_from_the_log_are_those_of_the_campaign(name, tmp_path, source):
    """A filtered platform, a strapdown one with six sensors, outages and biases, ..."""
    flown = {
        "wang2013": lambda: flight("0.01E-1Hz"),
        "everything": lambda: small_flight(source | EVERYTHING),
        "named": lambda: small_flight(source | NAMED),
        "damped": lambda: small_flight(source | DAMPED),
        "disturbed": lambda: small_flight(source | DISTURBED),
        "integrated": lambda: small_flight(source | INTEGRATED),
        "delayed": lambda: small_flight(source | DELAYED),
        "late": lambda: small_flight(source | LATE),
        "GNSS": lambda: small_flight(GNSS_ONLY),
    }[name]()
    problem, truth = simulate(flown, SEED, RUN)
    found, reference = gg.read_flight(recorded(tmp_path / "log", flown))
    assert found.channels == problem.channels
    np.testing.assert_array_equal(found.times, problem.times)
    np.testing.assert_array_equal(found.present, problem.present)
    np.testing.assert_array_equal(found.noise_cov, problem.noise_cov)
    if name == "everything":
        # Readings that dropped out are there as missing ones, of the gradiometer and of others.
        read = found.present[found.times % 1.0 == 0.0]
        assert not read[:, 0].all() and not read[:, 6].all() and read[:, 0].any()
    for label in LABELS:
        refused = gg.estimator(label).skip(problem)
        assert gg.estimator(label).skip(found) == refused
        if refused:
            assert label.startswith("closed-loop") and name in UNFED
            continue
        from_log, simulated = gg.estimate(found, label), gg.estimate(problem, label)
        assert difference(problem, from_log, simulated) < SAME
        windows = flown.case.windows
        one = gg.judge(found, from_log, reference, windows)
        other = gg.judge(problem, simulated, truth, windows)
        assert one.windows["settled"] == pytest.approx(
            other.windows["settled"], rel=1e-6, nan_ok=True
        )


@pytest.mark.long
def test_the_command_gives_them_too(tmp_path, source):
    """By way of files alone: record, estimate, and what is written is the corrected track."""
    (tmp_path / "everything.toml").write_text(_scenario(source | EVERYTHING), encoding="utf-8")
    command = str(Path(sys.executable).parent / "ggbench")
    for arguments in (
        [
            "record",
            "everything.toml",
            "--case",
            "base",
            "--run",
            str(RUN),
            "-s",
            str(SEED),
            "-o",
            "log",
        ],
        ["estimate", "log/flight.toml", "-e", "ekf", "-e", "factor-graph[mode=batch]", "-o", "out"],
    ):
        done = subprocess.run(
            [command, *arguments], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stderr) == (0, "")
    problem, _ = simulate(small_flight(source | EVERYTHING), SEED, RUN)
    for label in ("ekf", "factor-graph[mode=batch]"):
        wanted = gg.corrected(problem, gg.estimate(problem, label))
        written = table_of(tmp_path / "out" / label / "corrected.csv")
        assert list(written) == list(wanted)
        places = ["latitude_deg", "longitude_deg"]
        np.testing.assert_allclose(written[places], wanted[places], rtol=0.0, atol=1e-13)
        others = [name for name in wanted if name not in places]
        np.testing.assert_allclose(written[others], wanted[others], rtol=1e-9, atol=1e-9)
    report = (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    for file in ("track", "deviations", "residuals", "errors"):
        assert f"figures/{file}.png" in report
        assert (tmp_path / "out" / "figures" / f"{file}.png").stat().st_size > 10_000


def _scenario(changes: dict) -> str:
    """The text of the small scenario with dotted keys changed."""
    import tomllib

    from problems import SMALL

    from ggbench.recorded.recording import toml

    document = tomllib.loads(SMALL)
    cases = document.pop("case")[:1]
    for key, value in changes.items():
        *tables, last = key.split(".")
        table = document
        for name in tables:
            table = table.setdefault(name, {})
        table[last] = value
    case = f'\n[[case]]\nname = "{cases[0]["name"]}"\ntitle = "{cases[0]["title"]}"\n'
    return "".join(toml(document)) + case


def test_a_solution_says_what_its_increments_do(tmp_path, source):
    """The inverse of the mechanization finds what was felt: the difference is rounding."""
    flown = small_flight(source | EVERYTHING)
    path = recorded(tmp_path / "log", flown)
    of_increments, _ = gg.read_flight(path)
    of_solution, _ = gg.read_flight(as_solution(path, flown))
    assert of_solution.replay is None  # it is not mechanised here: there is nothing to feed back to
    for label in LABELS[:3]:
        one, other = gg.estimate(of_increments, label), gg.estimate(of_solution, label)
        assert difference(of_increments, one, other) < 1e-7


def test_ned_is_enu(tmp_path):
    """The same velocities in the other frame, of the INS, the receiver and the reference."""
    flown = small_flight(GNSS_ONLY)
    problems = []
    for frame in ("ENU", "NED"):
        path = as_solution(recorded(tmp_path / frame, flown), flown, frame)
        if frame == "NED":
            for name in ("gnss", "reference"):
                edit(path, {f"{name}.frame": "NED"})
                edit_rows(path.parent / f"{name}.csv", _to_ned)
        problems.append(gg.read_flight(path))
    (enu, true), (ned, also_true) = problems
    np.testing.assert_array_equal(enu.measurements, ned.measurements)
    np.testing.assert_array_equal(enu.transition, ned.transition)
    np.testing.assert_array_equal(true.error_state[:, :9], also_true.error_state[:, :9])


def _to_ned(table: pd.DataFrame) -> pd.DataFrame:
    table["velocity_down_mps"] = -table.pop("velocity_up_mps")
    return table


@pytest.mark.parametrize("axes", ["forward-right-down", "forward-left-up"])
def test_body_axes_are_those_that_are_named(tmp_path, axes):
    """Increments about other axes of the body are the same motion."""
    flown = small_flight(GNSS_ONLY)
    path = recorded(tmp_path / "log", flown)
    before, _ = gg.read_flight(path)
    sign = {"forward-right-down": (1, 1, -1), "forward-left-up": (1, -1, 1)}[axes]

    def turned(table: pd.DataFrame) -> None:
        for kind in ("delta_angle_{}_rad", "delta_velocity_{}_mps"):
            right, forward, up = (table[kind.format(axis)].copy() for axis in "xyz")
            for axis, values, s in zip("xyz", (forward, right, up), sign, strict=True):
                table[kind.format(axis)] = s * values

    edit_rows(path.parent / "imu.csv", turned)
    after, _ = gg.read_flight(edit(path, {"imu_record.axes": axes}))
    np.testing.assert_array_equal(after.track.positions, before.track.positions)
    np.testing.assert_array_equal(after.transition, before.transition)


def test_another_clock_changes_nothing(tmp_path):
    """Times of a week of GPS, and files whose clocks are off by what the tables say."""
    flown = small_flight(GNSS_ONLY)
    path = recorded(tmp_path / "log", flown)
    before = read_flight(path)
    for name, offset in (("imu", 4.0e5), ("gnss", 4.0e5 - 18.0), ("reference", 4.0e5)):
        edit_rows(path.parent / f"{name}.csv", lambda t, by=offset: t.assign(time_s=t.time_s + by))
    after = read_flight(edit(path, {"gnss.clock_offset_s": 18.0}))
    assert after.start == pytest.approx(4.0e5, abs=1e-9)
    np.testing.assert_array_equal(after.problem.times, before.problem.times)
    np.testing.assert_array_equal(after.problem.measurements, before.problem.measurements)
    np.testing.assert_array_equal(
        after.reference.error_state[:, :9], before.reference.error_state[:, :9]
    )


def test_rates_at_odd_times_lead_where_increments_do(tmp_path):
    """Rates whose times shake are summed up and taken at the samples."""
    flown = small_flight(GNSS_ONLY)
    path = recorded(tmp_path / "log", flown)
    before, _ = gg.read_flight(path)
    dt, rng = flown.trajectory.dt, np.random.default_rng(1)

    def as_rates(table: pd.DataFrame) -> pd.DataFrame:
        names = list(table)[1:]
        edges = np.concatenate([[0.0], table.time_s])
        summed = np.vstack([np.zeros(6), np.cumsum(table[names].to_numpy(), axis=0)])
        # Rates, a hundred in each interval, constant within it.
        times = np.linspace(0.0, edges[-1], 100 * len(table) + 1)
        inner = times[1:-1] + rng.uniform(-0.2, 0.2, len(times) - 2) * (times[1] - times[0])
        times = np.concatenate([times[:1], inner, times[-1:]])
        which = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, len(table) - 1)
        rates = np.diff(summed, axis=0)[which] / dt
        return pd.DataFrame(np.column_stack([times, rates]), columns=["time_s", *RATES])

    edit_rows(path.parent / "imu.csv", as_rates)
    # The table is of a hundredth of the period; the mechanization keeps its own.
    edit(path, {"imu.period_s": dt / 100.0})
    after, _ = gg.read_flight(path)
    off = after.track.positions[-1] - before.track.positions[-1]
    assert np.abs(off * [6.4e6, 5.3e6, 1.0]).max() < 0.05


def test_rates_that_change_are_straight_lines_between_their_rows(tmp_path):
    """A force that grows by 0.02 m/s³: the velocities of exact increments, to 1e-9 m/s.

    Rates held to the next row, or from the one before, would be 0.01 m/s off.
    """
    found = {}
    for kind in ("increments", "rates"):
        path = recorded(tmp_path / kind, GNSS_ONLY)
        table = table_of(path.parent / "imu.csv")
        dt = table.time_s[0]
        first, slope = table.to_numpy()[0, 1:] / dt, np.array([0.0, 0.0, 0.0, 0.02, -0.02, 0.0])
        times = np.concatenate([[0.0], table.time_s])
        summed = np.outer(times, first) + 0.5 * np.outer(times**2, slope)
        values, names = np.column_stack([times[1:], np.diff(summed, axis=0)]), list(table)
        if kind == "rates":
            rates = first + np.outer(times, slope)
            values, names = np.column_stack([times, rates]), ["time_s", *RATES]
        edit_rows(path.parent / "imu.csv", lambda _, v=values, n=names: pd.DataFrame(v, columns=n))
        found[kind] = gg.read_flight(path)[0].track.velocities
    assert np.ptp(found["rates"], axis=0).max() > 1.0
    np.testing.assert_allclose(found["rates"], found["increments"], rtol=0.0, atol=1e-9)


def test_netcdf_is_taken_as_csv_is(tmp_path):
    """Variables of the same names; what is masked is missing."""
    netCDF4 = pytest.importorskip("netCDF4")
    flown = small_flight(GNSS_ONLY | {"truth.gnss.dropouts_s": [[5.0, 9.0]]})
    path = recorded(tmp_path / "log", flown)
    before, _ = gg.read_flight(path)
    table = table_of(path.parent / "gnss.csv")
    with netCDF4.Dataset(path.parent / "gnss.nc", "w") as file:
        file.createDimension("time", len(table))
        for name in table:
            variable = file.createVariable(name, "f8", ("time",), fill_value=-999.0)
            variable[:] = np.ma.masked_invalid(table[name].to_numpy())
    after, _ = gg.read_flight(edit(path, {"gnss.file": "gnss.nc"}))
    assert not before.present.all()
    np.testing.assert_array_equal(after.measurements, before.measurements)
    np.testing.assert_array_equal(after.present, before.present)


def test_no_truth_is_in_the_file_of_a_flight(tmp_path, source):
    """What the truth has beyond the model is not recorded, but for the reference."""
    changes = source | EVERYTHING | {"truth.imu.gyro_scale_factor_ppm": 123.0}
    path = recorded(tmp_path / "log", changes)
    text = path.read_text(encoding="utf-8")
    for told in ("truth", "outlier", "dropout", "scale_factor", "123.0"):
        assert told not in text
    assert "position_noise_m = 6.0" in text


def test_longitudes_of_a_record_may_be_counted_in_another_turn(tmp_path):
    """The start in another one than the map, the receiver and the reference: the same problem."""
    path = recorded(
        tmp_path / "flight", ON_BOARD | {"field.source": rough_map(tmp_path / "map.nc")}
    )
    expected = read_flight(path)
    start = tomllib.loads(path.read_text())["imu_record"]["start"]["longitude_rad"]
    edit(path, {"imu_record.start.longitude_rad": start - math.tau})
    turned = read_flight(path)
    assert turned.problem.track.positions[0, 1] < -math.pi
    np.testing.assert_allclose(
        turned.problem.measurements, expected.problem.measurements, atol=1e-5
    )
    np.testing.assert_allclose(
        turned.reference.error_state, expected.reference.error_state, atol=1e-5
    )
    np.testing.assert_allclose(
        *(f.problem.model.predict(3, np.zeros(f.problem.dimension)) for f in (turned, expected)),
        atol=1e-5,
    )
