"""Writer of simulated runs as recorded flights; the truth becomes the reference track."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from ..files.writing import reason_of, written_together
from ..sensors.aiding import corrected_positions
from ..sensors.gnss import Gnss
from ..simulation.error_free_flight import Flight
from ..simulation.field_source import is_file
from ..simulation.runs import record as recorded
from ..spec.aiding import GnssSpec
from ..spec.flight import FlightError, FlightSpec, load
from ..spec.named_sensors import sensors_of, table_of
from . import columns as files
from .inertial import DELTAS
from .motion import track_columns
from .readings import column_names

FLIGHT = "flight.toml"
"""Name of the flight file in the folder of its records."""


def write_record(flight: Flight, seed: int, run: int, folder: Path, title: str = "") -> Path:
    """Write a simulated run as a recorded flight; return the path of the flight file.

    The tables of the flight file describe the assumed model. The records contain the data of the
    run's problem. Only ``reference.csv`` contains the truth. Measurements have the form that real
    sensors deliver; for example, a receiver's positions are geodetic. The folder must be empty.

    Raises FlightError if the folder is not empty or cannot be written.
    """
    require_empty(folder)
    try:
        with written_together(folder) as place:
            _write(flight, seed, run, place, title)
    except OSError as error:
        raise FlightError(f"cannot write to {folder}: {reason_of(error)}") from None
    return folder / FLIGHT


def _write(flight: Flight, seed: int, run: int, folder: Path, title: str) -> None:
    """Write the files of a recorded flight one after the other."""
    flown = recorded(flight, seed, run)
    tables = _tables(flight, flown.initial, title)
    # The file comes first: the columns of the records follow from it.
    path = folder / FLIGHT
    files.write_text(path, "".join(toml(tables)))
    spec = load(path)
    times, dt = flight.trajectory.times, flight.trajectory.dt
    increments = {"time_s": times[1:]} | dict(zip(DELTAS, flown.increments.T, strict=True))
    files.write(folder / "imu.csv", increments, f"increments over the {dt:g} s before each time")
    if len(flown.heights):
        middles = 0.5 * (times[1:] + times[:-1])
        files.write(folder / "altimeter.csv", {"time_s": middles, "height_m": flown.heights})
    _write_readings(flight, spec, flown.read, flown.indicated.positions[0], folder)
    reference = track_columns(flight.times, flight.motion_at_epochs)
    files.write(folder / "reference.csv", reference)


def require_empty(folder: Path) -> None:
    """Raise FlightError if a path exists and is not an empty folder."""
    if folder.exists() and not folder.is_dir():
        raise FlightError(f"{folder} is not a folder")
    if folder.exists() and any(folder.iterdir()):
        raise FlightError(f"{folder} contains files; choose a new or empty folder")


def _tables(flight: Flight, initial: np.ndarray, title: str) -> dict[str, Any]:
    """Return the tables of the flight file; ``initial`` is the initial navigation state (15,)."""
    case = flight.case
    side = case.side("model")
    start = {
        "latitude_rad": float(initial[0]),
        "longitude_rad": float(initial[1]),
        "height_m": float(initial[2]),
        **{f"velocity_{axis}_mps": float(v) for axis, v in zip(_ENU, initial[3:6], strict=True)},
        "c_nb": initial[6:].tolist(),
    }
    field = _content(side.field) | {"compensate": case.model.field.compensate}
    field.pop("gravity_disturbance", None)
    if is_file(side.field.source):
        field["source"] = str(Path(side.field.source).resolve())
    tables: dict[str, Any] = {
        "title": title or case.title,
        "imu_record": {"file": "imu.csv", "axes": "right-forward-up", "start": start},
        "imu": _content(side.imu),
        "initial_error": _content(side.initial_error),
        "field": field,
    }
    if case.model.disturbance is not None:
        tables["disturbance"] = _content(case.model.disturbance)
    if case.altimeter is not None:
        tables["altimeter"] = _content(case.altimeter) | {"file": "altimeter.csv"}
    for name, spec in sensors_of(side).items():
        table = {"file": f"{name}.csv"} | _content(spec)
        table.pop("readings", None)  # they are whole gradients, simulated or measured
        if isinstance(spec, GnssSpec):
            table["frame"] = "ENU"
        if table_of(name) == name:
            tables[name] = table
        else:
            tables.setdefault("sensor", {})[name] = {"kind": spec.kind} | table
    tables["reference"] = {"file": "reference.csv", "frame": "ENU"}
    tables["windows"] = _content(case.windows)
    return tables


_ENU = ("east", "north", "up")


def _content(table: BaseModel) -> dict[str, Any]:
    return table.model_dump(exclude_defaults=True, exclude_none=True)


def _write_readings(
    flight: Flight, spec: FlightSpec, read: Any, indicated: np.ndarray, folder: Path
) -> None:
    by_sensor: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    model = flight.model
    if model.gradiometer is not None:
        values = np.where(read.missing[0][:, np.newaxis], np.nan, read.gradients[0])
        by_sensor["gradiometer"] = flight.gradient_epochs, values
    first = 0
    for sensor, at in zip(model.aiding, flight.aiding_epochs, strict=True):
        last = first + len(sensor.channels)
        values = np.where(read.present, read.others, np.nan)[0, at, first:last]
        if isinstance(sensor, Gnss) and sensor.position:
            places = corrected_positions(indicated[at], -values[:, :3])
            places[:, :2] = np.degrees(places[:, :2])
            values[:, :3] = places
        by_sensor[sensor.name] = at, values
        first = last
    for name, (at, values) in by_sensor.items():
        channels = dict(zip(column_names(spec, model, name), values.T, strict=True))
        files.write(folder / f"{name}.csv", {"time_s": flight.times[at]} | channels)


def toml(tables: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Return the lines of TOML text for nested tables: values first, then subtables.

    ``prefix`` precedes the names of subtables; it ends with a dot, or is empty.
    """
    lines, nested = [], []
    for key, value in tables.items():
        if isinstance(value, Mapping):
            nested += [f"\n[{prefix}{key}]\n", *toml(value, f"{prefix}{key}.")]
        else:
            lines.append(f"{key} = {_value(value)}\n")
    return lines + nested


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + "".join(c if c >= " " else f"\\u{ord(c):04x}" for c in escaped) + '"'
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{key} = {_value(item)}' for key, item in value.items())} }}"
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_value, value))}]"
    return repr(value)
