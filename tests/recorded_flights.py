"""Recorded flights for tests: simulated runs as they are recorded, and changes of their files."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from small_cases import blank_map, small_flight

from ggbench.maps.recipe import write
from ggbench.recorded import columns as files
from ggbench.recorded.motion import ATTITUDE, POSITION, angles_of, velocity_columns
from ggbench.recorded.recording import toml, write_record
from ggbench.simulation.error_free_flight import Flight
from ggbench.simulation.runs import record

SEED, RUN = 3, 4

GNSS_ONLY = {
    "gradiometer": None,
    "gnss.period_s": 1.0,
    "gnss.position_noise_m": 3.0,
    "gnss.velocity_noise_mps": 0.05,
}
"""Changes of the small scenario that leave a receiver on board, and nothing else."""


def recorded(folder: Path, flight: Flight | dict[str, Any]) -> Path:
    """Write run :data:`RUN` of a flight, or of the small one with changes; return its file."""
    flown = small_flight(flight) if isinstance(flight, dict) else flight
    return write_record(flown, SEED, RUN, folder)


def edit(path: Path, changes: dict[str, Any]) -> Path:
    """Change dotted keys of a flight's file; None takes a key away."""
    document = tomllib.loads(path.read_text(encoding="utf-8"))
    for key, value in changes.items():
        *tables, last = key.split(".")
        table = document
        for name in tables:
            table = table.setdefault(name, {})
        if value is None:
            table.pop(last, None)
        else:
            table[last] = value
    path.write_text("".join(toml(document)), encoding="utf-8")
    return path


def table_of(path: Path) -> pd.DataFrame:
    """The numbers of a CSV file, to the last bit; NaN where it is empty."""
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    rows = [[float(cell or "nan") for cell in line.split(",")] for line in lines[1:]]
    return pd.DataFrame(rows, columns=lines[0].split(","))


def edit_rows(path: Path, change: Callable[[pd.DataFrame], pd.DataFrame | None]) -> None:
    """Change the table of a CSV file, in place or by what is returned."""
    table = table_of(path)
    found = change(table)
    (table if found is None else found).to_csv(path, index=False)


def as_solution(path: Path, flight: Flight, frame: str = "ENU") -> Path:
    """Turn a recorded flight of increments into one of the solution of its INS."""
    found = record(flight, SEED, RUN)
    from ggbench.ins.strapdown import navigate  # as the INS on board would have done it

    start = found.initial
    positions, velocities, attitudes = navigate(
        start[:3],
        start[3:6],
        start[6:].reshape(3, 3),
        found.increments[:, :3],
        found.increments[:, 3:],
        flight.trajectory.dt,
    )
    write_solution(
        path.parent / "ins.csv", flight.trajectory.times, positions, velocities, attitudes, frame
    )
    return edit(path, {"imu_record": None, "ins": {"file": "ins.csv", "frame": frame}})


def write_solution(
    path: Path,
    times: np.ndarray,
    positions: np.ndarray,
    velocities: np.ndarray,
    attitudes: np.ndarray,
    frame: str = "ENU",
) -> None:
    """Write the solution of an INS."""
    moved = velocities if frame == "ENU" else velocities[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    values = np.hstack(
        [
            np.degrees(positions[:, :2]),
            positions[:, 2:],
            moved,
            np.degrees(angles_of(attitudes)),
        ]
    )
    names = (*POSITION, *velocity_columns(frame), *ATTITUDE)
    files.write(path, {"time_s": times} | dict(zip(names, values.T, strict=True)))


def written_logs(folder: Path) -> Path:
    """Logs of one flight: of increments, of a solution, and with a gradiometer."""
    flown = small_flight(GNSS_ONLY)
    recorded(folder / "increments", flown)
    as_solution(recorded(folder / "solution", flown), flown)
    stern = {key.replace("gnss.", "sensor.stern."): value for key, value in GNSS_ONLY.items()}
    recorded(folder / "sensor", GNSS_ONLY | stern | {"sensor.stern.kind": "gnss"})
    recorded(folder / "gradiometer", {})
    recorded(folder / "filtered", {"gradiometer.filter": "butterworth"})
    recorded(folder / "altimeter", GNSS_ONLY | {"altimeter.noise_m_per_sqrt_hz": 1.0})
    write(folder / "map.nc", blank_map())
    return folder


def with_times(change):
    return lambda table: table.assign(time_s=change(table.time_s.to_numpy().copy()))


def with_cells(row, **values):
    def change(table: pd.DataFrame) -> pd.DataFrame:
        for name, value in values.items():
            table.loc[row, name] = value
        return table

    return change


def with_zeros(rows, value=0.0):
    def change(table: pd.DataFrame) -> pd.DataFrame:
        table.loc[rows, [name for name in table if name.startswith("gradient_")]] = value
        return table

    return change


def without_rows(first, last):
    return lambda table: table.drop(index=range(first, last))
