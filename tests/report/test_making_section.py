"""How reports say of what they were made: the data with their hashes, whatever their names are."""

from __future__ import annotations

import hashlib
import json
import math
import re
from pathlib import Path

import netCDF4
import numpy as np
import pytest
from campaigns import ran, small
from problems import SMALL
from recorded_flights import recorded
from small_cases import rough_map

from ggbench.estimators.ins import InertialOnly
from ggbench.maps import netcdf
from ggbench.maps.recipe import read
from ggbench.recorded.flight import read_flight
from ggbench.report import flight_report, scenario_report
from ggbench.report.making_section import made_of
from ggbench.results import digest

DEM = "ab" * 32


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.fixture
def own_map(tmp_path) -> Path:
    """A map that says of which terrain it was made."""
    path = tmp_path / "own.nc"
    netcdf.write(path, read(rough_map(tmp_path / "map.npz")))
    with netCDF4.Dataset(path, "a") as file:
        file.source_files = json.dumps({"dem.tif": DEM})
    return path


def test_a_report_names_map_terrain_and_track_with_their_hashes(tmp_path, own_map):
    """As sha256sum gives them; of the terrain what the map's file says; the digest has them too."""
    track = tmp_path / "flown.csv"
    rows = [f"{t},33.5,{108.0 + t * math.degrees(250.0 / 5.33e6):.9f},10000.0" for t in range(21)]
    track.write_text("time_s,latitude_deg,longitude_deg,height_m\n" + "\n".join(rows) + "\n")
    text = SMALL.replace('source = "normal"', f'source = "{own_map}"')
    start, end = text.index("[trajectory]"), text.index("[imu]")
    text = f'{text[:start]}[trajectory]\nfile = "{track}"\n\n{text[end:]}'
    results = ran(tmp_path, labels=("ins",), runs=1, scenario=small(tmp_path, text))
    expected = {
        ("map", "own.nc", sha256(own_map)), ("data of the map", "dem.tif", DEM),
        ("track", "flown.csv", sha256(track)),
    }  # fmt: skip
    held = {tuple(item.values()) for item in results.manifest["inputs"]}
    assert held == expected
    results.store.close()
    report = scenario_report.write(results.folder, tmp_path / "reports").read_text()
    for role, name, key in expected:
        assert f"{role} `{name}` {key[:16]}" in report
    kept = digest.read(tmp_path / "reports" / "small" / digest.FOLDER)
    assert kept.manifest["inputs"] == results.manifest["inputs"]


def test_a_map_that_is_built_is_named_by_its_data(tmp_path):
    """The shipped files, each once, though two cases and both sides use them."""
    field = (
        'source = "jacksboro"\nsouth_deg = 36.2\nnorth_deg = 36.3\nwest_deg = -84.4\n'
        "east_deg = -84.2\nlowest_m = 1800.0\nhighest_m = 2600.0\nspacing_arcmin = 0.3\n"
        "height_spacing_m = 200.0"
    )
    text = SMALL.replace('source = "normal"', field)
    for old, new in (("= 33.5", "= 36.25"), ("= 108.0", "= -84.35"), ("= 10000.0", "= 2000.0")):
        text = text.replace(old, new)
    results = ran(tmp_path, labels=("ins",), runs=1, scenario=small(tmp_path, text))
    file = Path(__file__).parents[2] / "scenarios/data/jacksboro_dem_3arcsec.npz"
    assert results.manifest["inputs"] == [
        {"role": "data of the map", "name": file.name, "sha256": sha256(file)}
    ]


def test_the_report_of_a_recorded_flight_names_every_record(tmp_path, own_map):
    """The flight's file, each record, the map; with the hashes of what was read."""
    path = recorded(tmp_path / "log", {"field.source": str(own_map)})
    flight = read_flight(path)
    found = InertialOnly().estimate(flight.problem, np.random.default_rng(0))
    report = flight_report.write(flight, {"ins": found}, tmp_path / "out").read_text()
    files = sorted(p.name for p in (tmp_path / "log").iterdir() if p.suffix in (".csv", ".toml"))
    assert len(files) == 4
    for name in files:
        assert re.search(rf"`{name}` {sha256(path.parent / name)[:16]}", report), name
    assert f"map `own.nc` {sha256(own_map)[:16]}; data of the map `dem.tif` {DEM[:16]}" in report


def test_a_name_of_a_file_cannot_leave_its_code():
    """Whatever characters a file's name has; without data there is no line."""
    (line,) = made_of([{"role": "track", "name": "a`b\n# c.csv", "sha256": DEM}])
    assert line.endswith(f"track `a?b?# c.csv` {DEM[:16]}")
    assert made_of([]) == []
