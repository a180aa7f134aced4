"""Damaged inputs of every kind: taken, or refused by a sentence; never another exception.

The readers are those of the commands, which turn ``GGBenchError`` into a sentence and exit code 2.
"""

from __future__ import annotations

import collections
import json
import re
import shutil
import struct
import sys
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import netCDF4
import numpy as np
import pandas as pd
import pytest
import rasterio
from campaigns import COMMAND, finish, ran
from grids import write_grid
from mutations import mutated, mutated_arrays
from problems import SMALL
from random_harmonics import write_gfc
from rasterio.transform import from_origin
from receiver_tracks import (
    CSV_PLACES,
    GPX_ROUTE,
    KML_LINE,
    csrs,
    gpx,
    kml,
    kml_points,
    nmea,
    novatel,
    pos,
)
from recorded_flights import GNSS_ONLY, as_solution, recorded
from small_cases import blank_map, small_flight
from thinning import thinned

from ggbench.errors import GGBenchError
from ggbench.gravity.terrain_files import read_terrain
from ggbench.maps.gravity_grid import read_grid
from ggbench.maps.gravity_model import read_model
from ggbench.maps.recipe import read as read_map
from ggbench.maps.recipe import write
from ggbench.maps.survey_files import read_lines as read_survey
from ggbench.recorded.allan import imu_noise
from ggbench.recorded.flight import read_flight
from ggbench.recorded.inertial import RATES
from ggbench.results.folder import Results
from ggbench.score import card as cards
from ggbench.score import cards_compared, page
from ggbench.simulation.true_motion import trajectory_of
from ggbench.spec import scenario
from ggbench.spec.trajectory import TrajectorySpec
from ggbench.trajectory.waypoint_files import read_waypoints

QUICK, MANY = 30, 1000
SEED = 41
_ROWS = np.arange(20)
_LATITUDES, _LONGITUDES = 45.0 + 0.1 * _ROWS, 7.0 + 0.1 * np.arange(24)
_HEIGHTS = 400.0 + np.add.outer(10.0 * _ROWS, 3.0 * np.arange(24))
_FIELD = 30.0 * np.sin(np.add.outer(0.3 * _ROWS, 0.2 * np.arange(24)))


@dataclass(frozen=True)
class Kind:
    """A kind of input.

    Attributes
    ----------
    name : of the file that is damaged.
    make : writes it, and what belongs to it, into a folder.
    read : reads the file as commands do.
    """

    name: str
    make: Callable[[Path], object]
    read: Callable[[Path], object]


def flown(path: Path) -> object:
    """Read a track and fly it."""
    return trajectory_of(TrajectorySpec(file=str(path), smoothing_s=5.0), 0.5)


def track(path: Path) -> None:
    rows = [
        f"{10 * k},{48.0 + 0.01 * k:.5f},{11.0 + 0.002 * k:.5f},{1000 + k:.1f}" for k in range(40)
    ]
    path.write_text("\n".join(["time_s,latitude_deg,longitude_deg,height_m", *rows, ""]))


def track_of_px4(path: Path) -> None:
    rows = [
        f"{10_000_000 * k},{480_000_000 + 10**5 * k},{110_000_000 + 20_000 * k},{10**6 + 10**3 * k}"
        for k in range(40)
    ]
    path.write_text("\n".join(["timestamp,lat,lon,alt_ellipsoid", *rows, ""]))


def flown_by_px4(path: Path) -> object:
    """Read a track by the names of PX4 and fly it."""
    spec = TrajectorySpec(file=str(path), smoothing_s=5.0, columns="px4")
    return trajectory_of(spec, 0.5)


def track_with_attitude(path: Path) -> None:
    rows = [
        f"{k};{48.0 + 0.001 * k:.6f};{11.0:.6f};{1000 + k:.1f};0.5;{k % 3};-1" for k in range(120)
    ]
    head = "time_s;latitude_deg;longitude_deg;height_m;heading_deg;pitch_deg;roll_deg"
    path.write_text("\n".join([f"# {head}", *rows, ""]))


def raster(path: Path, values: np.ndarray, unit: str) -> None:
    with rasterio.open(
        path, "w", driver="GTiff", count=1, dtype="float32", crs="EPSG:4326", nodata=-9999,
        height=20, width=24, transform=from_origin(7.0, 46.0, 0.1, 0.1),
    ) as dataset:  # fmt: skip
        dataset.write(values.astype(np.float32), 1)
        dataset.units = [unit]


def ascii_grid(path: Path) -> None:
    head = "ncols 24\nnrows 20\nxllcorner 7.0\nyllcorner 45.0\ncellsize 0.1\nnodata_value -9999"
    np.savetxt(path, _HEIGHTS, "%.1f", header=head, comments="")


def surfer_grid(path: Path) -> None:
    head = "DSAA\n24 20\n7.0 9.3\n45.0 46.9\n400 700"
    np.savetxt(path, _HEIGHTS, "%.1f", header=head, comments="")


def gdf(path: Path) -> None:
    head = [
        "generating_institute gfz", "modelname EGM2008", "functional gravity_disturbance",
        "unit mgal", "latitude_parallels 20", "longitude_parallels 24", "gapvalue 9999.0",
        "height_over_ell 0.0 m", "tide_system tide_free", "longitude latitude gravity",
        "end_of_head ==",
    ]  # fmt: skip
    rows = [
        f"{7.0 + 0.1 * j:.1f} {45.0 - 0.1 * i:.1f} {_FIELD[i, j]:.3f}"
        for i in range(20)
        for j in range(24)
    ]
    path.write_text("\n".join([*head, *rows, ""]))


SURVEY = {
    "time_s": "FID", "latitude_deg": "LAT", "longitude_deg": "LONG", "height_m": "HGT",
    "disturbance": "GRAV",
}  # fmt: skip


def survey_rows() -> list[tuple[str, ...]]:
    return [
        (f"{1000 + 10 * (k // 10)}", f"{2 * k}.0", f"{-33.0 + 0.001 * (k % 10):.6f}",
         f"{142.5 + 0.01 * (k // 10):.6f}", "400.00", f"{np.sin(k):.3f}")
        for k in range(40)
    ]  # fmt: skip


def survey_csv(path: Path) -> None:
    rows = [",".join(row) for row in survey_rows()]
    path.write_text("\n".join(["LINE,FID,LAT,LONG,HGT [m],GRAV [mGal]", *rows, ""]))


def survey_xyz(path: Path) -> None:
    out, before = ["/ FID LAT LONG HGT GRAV"], ""
    for line, *row in survey_rows():
        out += [*([f"Line {line}"] if line != before else []), " ".join(row)]
        before = line
    path.write_text("\n".join([*out, ""]))


def survey_gdf2(path: Path) -> None:
    forms = ("LINE:I6", "FID:F8.1", "LAT:F12.6:UNIT=dega", "LONG:F12.6:UNIT=dega",
             "HGT:F9.2:UNIT=m", "GRAV:F9.3:NULL=-999.999,UNIT=mGal,NAME=disturbance")  # fmt: skip
    definitions = [f"DEFN {n} ST=RECD,RT=DATA;{form}" for n, form in enumerate(forms, 1)]
    path.with_suffix(".dfn").write_text("\n".join([*definitions, "DEFN 7 ST=RECD,RT=;END DEFN"]))
    widths = (6, 8, 12, 12, 9, 9)
    rows = ["".join(map(str.rjust, row, widths)) for row in survey_rows()]
    path.with_suffix(".dat").write_text("\n".join([*rows, ""]))


def survey_lines(path: Path) -> object:
    """Read survey lines; of their definitions, the file beside them."""
    data = path.with_suffix(".dat") if path.suffix == ".dfn" else path
    line = {} if path.suffix == ".xyz" else {"line": "LINE"}
    return read_survey(data, SURVEY | line, quantity="disturbance")


def imu_log(path: Path) -> None:
    rng = np.random.default_rng(2)
    values = rng.normal([0.0, 0.0, 0.0, 0.0, 0.0, 9.8], 1e-3, (1100, 6))
    rows = [f"{0.01 * k:.2f},{','.join(f'{v:.6f}' for v in row)}" for k, row in enumerate(values)]
    path.write_text("\n".join([f"time_s,{','.join(RATES)}", *rows, ""]))


def gravity_grid(kind: str) -> Callable[[Path], object]:
    return lambda path: read_grid(path, kind)


def increments(path: Path) -> None:
    recorded(path.parent, small_flight(GNSS_ONLY))


def solution(path: Path) -> None:
    flight = small_flight(GNSS_ONLY)
    as_solution(recorded(path.parent, flight), flight)


def its_flight(path: Path) -> object:
    """Read the flight of which a file is a part."""
    return read_flight(path.parent / "flight.toml")


def resolved(path: Path) -> object:
    """Load a scenario with all of its cases."""
    return [case.strides for case in scenario.load(str(path)).cases]


def scored(path: Path) -> None:
    """Write a card of two cases, with texts, numbers and verdicts."""
    other = {
        "label": "ekf", "role": "ekf", "runs": 4, "rms_m": 1.7, "error_ratio": 0.98, "lo": 0.91,
        "hi": 1.1, "only_scored": 1, "only_other": 0, "verdict": "as good",
    }  # fmt: skip
    question = {
        "title": "Aircraft", "runs": 4, "failed": 1, "rms_m": 1.68, "bound_m": 1.5, "success": 0.75,
        "nees": 6.2, "coverage": 0.94, "consistency": "consistent", "against": [other],
        "errors_m": [1.2, None, 3.25, 0.5], "succeeded": [True, False, True, True],
    }  # fmt: skip
    card = {
        "format": cards.FORMAT, "ggbench": "0.2.0", "results_version": 1, "suite": "ab" * 32,
        "seed": 3702, "public": True, "runs": 4, "judged": "all",
        "estimator": {
            "label": "mine.py[gain=2]", "name": "mine", "parameters": {"gain": 2.0},
            "source": "cd" * 32, "seeks": ["gc"],
        },
        "questions": [{"case": case} | question for case in ("air-narrow", "one-channel")],
    }  # fmt: skip
    path.write_text(json.dumps(card, indent=1))


def its_card(path: Path) -> object:
    """Read a card, compare it with itself and with its neighbour, and write its pages."""
    found = cards.read(path)
    assert cards_compared.differences(found, found) == []
    scored(path.parent / "whole.json")
    whole = cards.read(path.parent / "whole.json")
    cards_compared.differences(found, whole)
    failures = pd.DataFrame(columns=["case", "run", "reason", "command"])
    page.write(found, failures, path.parent)
    return cards_compared.worse(found, whole)


def flown_campaign(path: Path) -> None:
    """Write a results folder, of which the manifest is a file."""
    folder = path.parent
    ran(folder.parent, folder.name, ("ins", "ekf"), runs=2).store.close()


def its_results(path: Path) -> object:
    """Read all tables of the results folder of a manifest, as reports and ``show`` do."""
    results = Results(path.parent)
    try:
        results.metrics(), results.cases(), results.pairs(), results.studies(), results.counters()
        return results.failures(), [*results.records()], results.families, results.seeking
    finally:
        results.store.close()


KINDS = {
    "track": Kind("track.csv", track, flown),
    "track with attitude": Kind("track.csv", track_with_attitude, flown),
    "track, GPX": Kind("track.gpx", lambda path: path.write_text(gpx()), flown),
    "track, KML": Kind("track.kml", lambda path: path.write_text(kml()), flown),
    "track, KML points": Kind("track.kml", lambda path: path.write_text(kml_points()), flown),
    "track, NMEA": Kind("track.nmea", lambda path: path.write_text(nmea()), flown),
    "track, RTKLIB": Kind("track.pos", lambda path: path.write_text(pos()), flown),
    "track, CSRS-PPP": Kind("track.pos", lambda path: path.write_text(csrs()), flown),
    "track, NovAtel": Kind(
        "track.log", lambda path: path.write_text("\n".join(novatel("INSPVAA"))), flown
    ),
    "track, other names": Kind("track.csv", track_of_px4, flown_by_px4),
    "terrain, ESRI": Kind("dem.asc", ascii_grid, read_terrain),
    "terrain, GeoTIFF": Kind("dem.tif", lambda path: raster(path, _HEIGHTS, "m"), read_terrain),
    "terrain, tile": Kind(
        "N46E007.hgt",
        lambda path: path.write_bytes(struct.pack(">480h", *_HEIGHTS.astype(int).ravel())[:800]),
        read_terrain,
    ),
    "terrain, Surfer": Kind("dem.grd", surfer_grid, read_terrain),
    "terrain, netCDF": Kind(
        "dem.nc",
        lambda path: write_grid(path, "z", "m", _HEIGHTS, south=45.0, west=7.0, step=0.1),
        read_terrain,
    ),
    "terrain, NumPy": Kind(
        "dem.npz",
        lambda path: np.savez(path, lat=_LATITUDES, lon=_LONGITUDES, z=_HEIGHTS),
        read_terrain,
    ),
    "gravity, ICGEM": Kind("grid.gdf", gdf, gravity_grid("disturbance")),
    "gravity, GeoTIFF": Kind(
        "grid.tif", lambda path: raster(path, _FIELD, "mGal"), gravity_grid("anomaly")
    ),
    "gravity, netCDF": Kind(
        "grid.nc",
        lambda path: write_grid(path, "dg", "mGal", _FIELD, south=45.0, west=7.0, step=0.1),
        gravity_grid("disturbance"),
    ),
    "geoid, NumPy": Kind(
        "grid.npz",
        lambda path: np.savez(path, lat0=45.0, lon0=7.0, step=0.1, N_1e4m=1e4 * _FIELD),
        gravity_grid("geoid"),
    ),
    "coefficients": Kind("model.gfc", lambda path: write_gfc(path, 12), read_model),
    "flight": Kind("flight.toml", increments, its_flight),
    "flight, increments": Kind("imu.csv", increments, its_flight),
    "flight, receiver": Kind("gnss.csv", increments, its_flight),
    "flight, solution": Kind("ins.csv", solution, its_flight),
    "scenario": Kind("small.toml", lambda path: path.write_text(SMALL), resolved),
    "survey, CSV": Kind("s.csv", survey_csv, survey_lines),
    "survey, XYZ": Kind("s.xyz", survey_xyz, survey_lines),
    "survey, GDF2": Kind("s.dat", survey_gdf2, survey_lines),
    "survey, definitions": Kind("s.dfn", survey_gdf2, survey_lines),
    "IMU log": Kind("imu.csv", imu_log, imu_noise),
    "waypoints, GPX": Kind("way.gpx", lambda path: path.write_text(GPX_ROUTE), read_waypoints),
    "waypoints, KML": Kind("way.kml", lambda path: path.write_text(KML_LINE), read_waypoints),
    "waypoints, CSV": Kind("way.csv", lambda path: path.write_text(CSV_PLACES), read_waypoints),
    "card": Kind("card.json", scored, its_card),
    "manifest": Kind("manifest.json", flown_campaign, its_results),
}  # fmt: skip


def found_in(read: Callable[[], object], refused: collections.Counter[bool]) -> tuple[str, str]:
    """Return place and text of an exception that is no sentence, or "" twice; count refusals."""
    unraisable: list[str] = []
    hook, sys.unraisablehook = sys.unraisablehook, lambda what: unraisable.append(str(what))
    try:
        with warnings.catch_warnings(action="ignore"):
            read()
        refused[False] += 1
    except GGBenchError as error:
        refused[True] += 1
        sentence = str(error).strip()
        if not sentence or len(sentence) > 2000:
            return "no sentence", sentence[:200]
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        last = [*frames[:1], *(frame for frame in frames if "/ggbench/" in frame.filename)][-1]
        return f"{type(error).__name__} at {Path(last.filename).name}:{last.lineno}", str(error)
    finally:
        sys.unraisablehook = hook
    return ("printed traceback", unraisable[0]) if unraisable else ("", "")


def failures(kind: str, folder: Path, count: int) -> dict[str, str]:
    """Return the exceptions of a kind that are no sentences, by their place, with a first seed."""
    what = KINDS[kind]
    original, damaged = folder / "original", folder / "damaged"
    original.mkdir()
    what.make(original / what.name)
    what.read(original / what.name)
    content, found = (original / what.name).read_bytes(), {}
    shutil.copytree(original, damaged)
    refused = collections.Counter[bool]()
    for number in range(count):
        rng = np.random.default_rng([SEED, [*KINDS].index(kind), number])
        path = damaged / what.name
        path.write_bytes(mutated(content, rng))
        place, text = found_in(lambda path=path: what.read(path), refused)
        if place:
            found.setdefault(place, f"{number}: {text}")
    assert refused[True] > 0.2 * count, "damage is hardly ever refused"
    return found


@thinned("kind", KINDS, every=2)
def test_damaged_inputs_are_taken_or_refused_by_a_sentence(kind, tmp_path):
    assert failures(kind, tmp_path, QUICK) == {}


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_many_damaged_inputs_are_taken_or_refused_by_a_sentence(kind, tmp_path):
    assert failures(kind, tmp_path, MANY) == {}


ARRAYS = {
    "terrain.npz": (
        {"lat": _LATITUDES, "lon": _LONGITUDES, "z": _HEIGHTS}, read_terrain
    ),
    "named.npz": (
        {
            "south_deg": 45.0, "west_deg": 7.0, "latitude_step_deg": 0.1, "longitude_step_deg": 0.1,
            "height_m": _HEIGHTS, "name": np.array("a terrain"),
        },
        read_terrain,
    ),
    "cells.npz": (
        {"elevation": _HEIGHTS, "xmin": 7.0, "ymax": 46.0, "dx": 0.1, "dy": 0.1}, read_terrain
    ),
    "geoid.npz": (
        {"lat0": 45.0, "lon0": 7.0, "step": 0.1, "N_1e4m": 1e4 * _FIELD}, gravity_grid("geoid")
    ),
    "terrain.nc": (
        {"lat": _LATITUDES, "lon": _LONGITUDES, "z": _HEIGHTS}, read_terrain
    ),
    "gravity.nc": (
        {"lat": _LATITUDES, "lon": _LONGITUDES, "z": _FIELD},
        gravity_grid("anomaly"),
    ),
    "map.nc": ({}, read_map),
}  # fmt: skip
"""Arrays in files that a flipped byte only makes unreadable, and their readers."""


def write_arrays(path: Path, arrays: dict[str, np.ndarray], attributes: dict[str, object]) -> None:
    """Write arrays as NumPy's archive, or as netCDF: ``lat`` and ``lon`` are its axes."""
    if path.suffix == ".npz":
        np.savez(path, **arrays)
        return
    with netCDF4.Dataset(path, "w") as file:
        for name, values in arrays.items():
            if values.ndim == 1:
                file.createDimension(name, values.size)
        for name, values in arrays.items():
            axes = {values.size: name} if values.ndim == 1 else {20: "lat", 24: "lon"}
            dims = []
            for axis, count in enumerate(values.shape):
                dim = axes.get(count, f"{name}_{axis}")
                if dim not in file.dimensions or file.dimensions[dim].size != count:
                    dim = f"{name}_{axis}"
                    file.createDimension(dim, count)
                dims.append(dim)
            variable = file.createVariable(name, values.dtype, dims)
            variable[...] = values
            if name not in ("lat", "lon"):
                variable.setncatts(attributes)


def failures_of_arrays(name: str, folder: Path, count: int) -> dict[str, str]:
    """Return the exceptions that are no sentences, by their place, with a first seed."""
    (arrays, read), found, written = ARRAYS[name], {}, 0
    arrays = {key: np.asarray(value) for key, value in arrays.items()}
    path = folder / name
    refused = collections.Counter[bool]()
    for number in range(count):
        rng = np.random.default_rng([SEED, [*ARRAYS].index(name), number])
        try:
            if arrays:
                write_arrays(path, *mutated_arrays(arrays, {}, rng))
            else:
                damage_map(path, rng)
        except (TypeError, ValueError, RuntimeError, KeyError, IndexError, OverflowError, OSError):
            continue  # that cannot be written at all
        written += 1
        place, text = found_in(lambda: read(path), refused)
        if place:
            found.setdefault(place, f"{number}: {text}")
    assert written > 0.5 * count
    return found


def damage_map(path: Path, rng: np.random.Generator) -> None:
    """Write a map, and damage a variable or attribute of it."""
    write(path, blank_map(count=8))
    with netCDF4.Dataset(path, "a") as file:
        names = [*file.variables]
        name = names[int(rng.integers(len(names)))]
        arrays, attributes = mutated_arrays({name: file[name][...].data}, {}, rng)
        (new,) = arrays or {""}
        if new != name:
            file.renameVariable(name, new or "gone")
        else:
            file[name][...] = arrays[name]
        (file if rng.random() < 0.5 else file[new or "gone"]).setncatts(attributes)


@pytest.mark.parametrize("name", ARRAYS)
def test_damaged_arrays_are_taken_or_refused_by_a_sentence(name, tmp_path):
    assert failures_of_arrays(name, tmp_path, QUICK) == {}


@pytest.mark.long
@pytest.mark.parametrize("name", ARRAYS)
def test_many_damaged_arrays_are_taken_or_refused_by_a_sentence(name, tmp_path):
    assert failures_of_arrays(name, tmp_path, MANY) == {}


def test_what_is_no_sentence_is_found():
    """Another exception, and a traceback that a library prints; a sentence is none of it."""
    counts = collections.Counter()
    assert found_in(lambda: scenario.load("no_such_scenario"), counts) == ("", "")
    place, text = found_in(lambda: {}["x"], counts)
    assert (place.partition(" at ")[0], text) == ("KeyError", "'x'")

    class Printing:
        def __del__(self) -> None:
            raise ValueError("printed")

    assert found_in(Printing, counts)[0] == "printed traceback"


def map_of(option: str) -> list[str]:
    """Return the options by which a file becomes a small map."""
    bounds = ["--south", "45.6", "--north", "46.2", "--west", "7.6", "--east", "8.4"]
    heights = ["--lowest", "3000", "--highest", "9000", "--height-spacing", "2000"]
    return ["map", "build", *bounds, *heights, "--spacing-arcmin", "5", "-o", "map.nc", option]


COMMANDS = {
    "track": ["validate", "flown.toml"],
    "terrain, ESRI": map_of("--terrain"),
    "terrain, GeoTIFF": map_of("--terrain"),
    "gravity, ICGEM": map_of("--disturbance"),
    "coefficients": map_of("--coefficients"),
    "flight": ["estimate", "-o", "out"],
    "flight, increments": ["estimate", "flight.toml", "-o", "out"],
    "scenario": ["validate"],
}


@pytest.mark.long
@pytest.mark.parametrize("kind", COMMANDS)
def test_the_command_ends_with_a_sentence(kind, tmp_path):
    """In processes of their own, five of each: what they print, and their exit codes."""
    what, command = KINDS[kind], COMMANDS[kind]
    what.make(tmp_path / what.name)
    content = (tmp_path / what.name).read_bytes()
    flown_over = re.sub(
        r"(?s)\[trajectory\].*?\[imu\]", '[trajectory]\nfile = "track.csv"\n[imu]', SMALL
    )
    (tmp_path / "flown.toml").write_text(flown_over)
    if (not command[-1].endswith(".toml") and command[-1] != "out") or kind == "flight":
        command = [*command, what.name]
    for number in range(5):
        rng = np.random.default_rng([SEED, 2, number])
        (tmp_path / what.name).write_bytes(mutated(content, rng))
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        done = finish(tmp_path, [COMMAND, *command])
        assert "Traceback" not in done.stdout + done.stderr
        assert done.returncode in (0, 2), done.stderr
        if done.returncode == 2:
            assert done.stderr.strip().splitlines()[-1].startswith("ggbench: ")
