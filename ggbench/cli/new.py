"""``ggbench new``: commented templates of a scenario or an estimator."""

from __future__ import annotations

import contextlib
import itertools
import keyword
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from ..files.writing import reason_of
from .draped_flight import NewFileError, draped_flight, quoted
from .vehicles import VEHICLES, clearance_of, imu_table

if TYPE_CHECKING:
    from ..maps.netcdf import Nodes

_TEMPLATES = Path(__file__).parent / "templates"
"""Folder of templates; they are text files, because they are no modules of this package."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
_LONGEST = 60
_FLIGHT_S = 130.0
"""Duration of a flight over a user's map [s]."""
_CLEARANCE_M = 200.0
_NOISE_EOTVOS = 0.1
_BANK_DEG = 25.0
_ABOVE_MAP_M = 20.0
"""Margin [m] of a terrain-following flight above the lowest layer: three σ of a barometer."""
_BAROMETER = """[barometer]    # without it the INS's height drifts out of the map
period_s = 1.0
noise_m = 3.0
bias_m = 5.0
"""
_TAKEN = {"Estimate", "Estimator", "Problem", "Template"}
"""Names that the template of an estimator already uses."""
_SHIPPED = "An aircraft with a gravity gradiometer over the Qinling mountains"
_SMOOTHING = "smoothing time, for the noise of a receiver; 0: no smoothing"


_folder = click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path(),
    help="Output folder [the current one].",
)


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
def new() -> None:
    """Create a scenario or an estimator from a template."""


_FILE = click.Path(path_type=Path, exists=True, dir_okay=False)


@new.command()
@click.argument("name")
@click.option(
    "--track", type=_FILE, help="Track to fly: CSV, GPX, KML, NMEA 0183 or RTKLIB's .pos."
)
@click.option("--map", "own_map", type=_FILE, help="Map to fly over: a netCDF file.")
@click.option(
    "--terrain",
    type=_FILE,
    help=(
        "Elevation model. With --map the flight follows it; with --track the height above it is "
        "checked."
    ),
)
@click.option(
    "--clearance",
    type=click.FloatRange(0.0, 1e5, min_open=True),
    metavar="M",
    help="Minimum height above the terrain [200]; lower tracks are refused.",
)
@click.option(
    "--waypoints",
    type=_FILE,
    help="Waypoints to fly through: a GPX, KML or CSV file; requires --map.",
)
@click.option(
    "--vehicle",
    type=click.Choice(["aircraft", "helicopter", "drone", "ship"]),
    help=(
        "Sets the usual speed, inertial sensors and gradiometer of a vehicle, with --map or "
        "--track."
    ),
)
@click.option(
    "--speed",
    type=click.FloatRange(0.1, 1000.0),
    metavar="M/S",
    help="Speed of the flight, with --map [that of the vehicle, less in tight turns].",
)
@_folder
def scenario(
    name: str,
    track: Path | None,
    own_map: Path | None,
    terrain: Path | None,
    clearance: float | None,
    waypoints: Path | None,
    vehicle: str | None,
    speed: float | None,
    output: Path,
) -> None:
    """Write NAME.toml, a commented scenario.

    The default is a flight over a shipped map. With --map the flight crosses the middle of the map.
    The flight height is then a third of the way from the lowest to the highest layer of the map.
    With --terrain the flight follows the ground within the map. With --waypoints the turns limit
    the speed. A --speed above the limit is refused.
    """
    if waypoints is not None and (own_map is None or track is not None or terrain is not None):
        raise click.UsageError("--waypoints requires --map and excludes --track and --terrain")
    if terrain is not None and own_map is None and track is None:
        raise click.UsageError("--terrain requires --map or --track")
    if clearance is not None and terrain is None:
        raise click.UsageError("--clearance requires --terrain")
    if vehicle is not None and own_map is None and track is None:
        raise click.UsageError("--vehicle requires --map or --track")
    if speed is not None and (own_map is None or track is not None):
        raise click.UsageError(
            "--speed requires --map and excludes --track, which has its own speed"
        )
    if vehicle == "ship" and terrain is not None:
        raise click.UsageError("a ship cannot follow terrain: remove --vehicle ship or --terrain")
    pace = Pace(speed, vehicle)
    tables, remark = {}, ""
    if track is not None:
        tables["trajectory"] = f"file = {quoted(track)}\nsmoothing_s = 10.0    # {_SMOOTHING}\n"
    if own_map is not None:
        tables["field"] = f"source = {quoted(own_map)}\n"
        if waypoints is not None:
            tables["trajectory"] = _flight_through(waypoints, own_map, pace)
        elif track is None:
            flown_at = clearance or _CLEARANCE_M
            tables["trajectory"] = _flight_over(own_map, terrain, flown_at, pace)
        if terrain is not None or waypoints is not None:
            tables["field"] += f"\n{_BAROMETER}"
    if track is not None and terrain is not None:
        remark = clearance_of(track, terrain, _attributes_of(own_map), clearance)
    noise = _NOISE_EOTVOS
    if vehicle is not None:
        tables["imu"] = imu_table(vehicle)
        noise = VEHICLES[vehicle].noise_eotvos
        if vehicle == "ship":
            tables["trajectory"] = f'vehicle = "ship"\n{tables["trajectory"]}'
    flown = "My own flight" if tables else _SHIPPED
    path = _begun(
        ".toml",
        name,
        output,
        tables,
        TITLE=_titled(name),
        DESCRIPTION=flown,
        NOISE=f"{noise:g}",
        BETTER=f"{0.1 * noise:g}",
    )
    name_shown = path.as_posix()
    if track is not None and own_map is None:
        click.echo(
            "Note: the scenario uses a shipped map of the Qinling mountains. Build a map of the "
            "area under the track with 'ggbench map build', and give it with --map."
        )
    if remark:
        click.echo(f"{remark}.")
    click.echo(f"Wrote {name_shown}. Look at its flights: ggbench validate {name_shown}")
    click.echo(f"Run it: ggbench run {name_shown} -n 10")


@new.command()
@click.argument("name")
@_folder
def estimator(name: str, output: Path) -> None:
    """Write NAME.py, a commented extended Kalman filter."""
    called = "".join(part[:1].upper() + part[1:] for part in re.split("[-_]+", name))
    if keyword.iskeyword(called) or called in _TAKEN:
        raise NewFileError(
            f"'{name}' is not allowed as a name: {called} is a Python keyword or a class that the "
            "template uses; choose another name"
        )
    path = _begun(".py", name, output, Template=called, TITLE=_titled(name))
    name_shown = path.as_posix()
    click.echo(f"Wrote {name_shown}. Check it: ggbench check {name_shown}")
    click.echo(f"Compare it with another: ggbench run wang2013 -n 3 -e {name_shown} -e ekf")


class Pace(NamedTuple):
    """Requested speed [m/s], and the vehicle, whose speed is used by default."""

    speed: float | None
    vehicle: str | None

    def at_most(self, allowed: float, usual: float, why: str) -> float:
        """Return the speed of a flight [m/s], which is at most ``allowed``.

        Parameters
        ----------
        allowed : largest possible speed of the flight [m/s].
        usual : default speed without a vehicle [m/s].
        why : reason for the limit in words, for the message.

        Raises
        ------
        NewFileError
            If the requested speed exceeds ``allowed``.
        """
        if self.speed is not None:
            if self.speed > allowed:
                raise NewFileError(
                    f"{self.speed:g} m/s is too fast: {why}, and the limit is {allowed:.3g} m/s"
                )
            return self.speed
        return min(usual if self.vehicle is None else VEHICLES[self.vehicle].speed_mps, allowed)


def _attributes_of(own_map: Path | None) -> Mapping[str, str]:
    """Return the attributes of a map; the mapping is empty without a map."""
    from ..maps import netcdf_reader  # not at the top: --help loads no numbers

    return {} if own_map is None else netcdf_reader.read_layers(own_map)[1]


def _flight_over(own_map: Path, terrain: Path | None, clearance: float, pace: Pace) -> str:
    """Return the table of a straight flight to the east in the middle of a map.

    With a terrain, the flight follows the ground, with a margin of three barometer σ above the
    lowest layer. A draped map needs a terrain and has the flight of :func:`.draped_flight`.

    Raise MapError if the file is no map. Raise NewFileError if the requested speed is too high, or
    no such flight is inside a draped map.
    """
    import numpy as np  # not at the top: --help loads no numbers

    from ..gravity.ellipsoid import metres_per_radian
    from ..maps import netcdf_reader

    nodes, attributes, _ = netcdf_reader.read_layers(own_map)
    if nodes.base_m is not None:
        if terrain is None:
            raise NewFileError(
                f"the layers of {own_map} follow the ground: give the same --terrain for the flight"
            )
        return draped_flight(nodes, attributes, own_map, terrain, clearance, pace.at_most)
    south, north = map(float, nodes.latitude_deg[[0, -1]])
    west, east = map(float, nodes.longitude_deg[[0, -1]])
    lowest = float(nodes.height_m[0])
    latitude, longitude = 0.5 * (south + north), 0.5 * (west + east)
    metres = metres_per_radian(np.array([math.radians(latitude), 0.0, lowest]))
    per_north, per_east = (math.radians(1.0) * length for length in metres)
    side = min((north - south) * per_north, (east - west) * per_east)
    room = f"a flight of {_FLIGHT_S:g} s may cover at most 0.4 of the map's shorter side"
    usual = 250.0 if terrain is None else 60.0
    speed = pace.at_most(0.4 * side / _FLIGHT_S, usual, room)
    start = longitude - 0.5 * _FLIGHT_S * speed / per_east
    flown = _height_line(_third_way_up(nodes))
    segment = f"duration_s = {_FLIGHT_S:g}     # straight and level\n"
    if terrain is not None:
        flown = "# Without height_m the flight starts just high enough above the terrain.\n"
        segment = (
            f'kind = "terrain-following"\nterrain = {quoted(terrain)}\n'
            f"clearance_m = {clearance:g}    # above the ground, at least\n"
            f"lowest_m = {math.ceil(lowest + _ABOVE_MAP_M)}    # the map begins at {lowest:g} m\n"
            f"duration_s = {_FLIGHT_S:g}\n"
        )
    return (
        f"latitude_deg = {latitude:.5f}\nlongitude_deg = {start:.5f}\n{flown}"
        f"speed_mps = {speed:.3g}\nheading_deg = 90.0    # clockwise from north\n\n"
        f"[[trajectory.segment]]\n{segment}"
    )


def _flight_through(waypoints: Path, own_map: Path, pace: Pace) -> str:
    """Return the table of a level flight through the waypoints of a file, over a map.

    The speed is so low that the radius of turns is at most a quarter of the shortest leg. The usual
    speed is that of an airliner. Raise TrajectoryError if the file has no waypoints. Raise MapError
    if ``own_map`` is no map. Raise NewFileError if the map is draped, or the speed too high.
    """
    import numpy as np  # not at the top: --help loads no numbers

    from ..maps import netcdf_reader
    from ..trajectory.manoeuvres import BANK_GRAVITY
    from ..trajectory.waypoint_files import read_waypoints
    from ..trajectory.waypoints import leg

    places = read_waypoints(waypoints)
    nodes = netcdf_reader.read_layers(own_map)[0]
    if nodes.base_m is not None:
        raise NewFileError(
            f"flights through waypoints are level, but the layers of {own_map} follow the "
            "ground: use --terrain, or a map with level layers"
        )
    height = _third_way_up(nodes)
    legs = [
        leg(np.array([*np.radians(start), height]), *np.radians(there))
        for start, there in itertools.pairwise(places)
    ]
    shortest = min(length for _, length in legs)
    pull = BANK_GRAVITY * math.tan(math.radians(_BANK_DEG))
    allowed = math.sqrt(0.25 * shortest * pull)
    room = (
        f"the radius of a turn at {_BANK_DEG:g}° of bank must be at most a quarter of the "
        "shortest leg"
    )
    speed = pace.at_most(allowed, 250.0, room)
    turn = f"bank_deg = {_BANK_DEG:g}"
    if pace.vehicle == "ship":
        turn = f"radius_m = {0.25 * shortest:.0f}"
    segments = "".join(
        f'\n[[trajectory.segment]]\nkind = "waypoint"\nlatitude_deg = {latitude:.7f}\n'
        f"longitude_deg = {longitude:.7f}\n{turn}\n"
        for latitude, longitude in places[1:]
    )
    return (
        f"latitude_deg = {places[0, 0]:.7f}\nlongitude_deg = {places[0, 1]:.7f}\n"
        f"{_height_line(height)}speed_mps = {speed:.3g}\n"
        f"heading_deg = {math.degrees(legs[0][0]):.4f}    # clockwise from north\n{segments}"
    )


def _third_way_up(nodes: Nodes) -> float:
    lowest, highest = map(float, nodes.height_m[[0, -1]])
    return lowest + (highest - lowest) / 3.0


def _height_line(height: float) -> str:
    return f"height_m = {height:.0f}    # above the ellipsoid, a third of the way up the map\n"


def _titled(name: str) -> str:
    words = re.sub("[-_]+", " ", name).strip()
    return words[:1].upper() + words[1:]


def _begun(
    suffix: str, name: str, folder: Path, tables: Mapping[str, str] | None = None, **words: str
) -> Path:
    """Write the template with a suffix under a name, with replaced words; return the path.

    ``tables`` has new contents of scenario tables. In the template, a table ends at the next line
    that begins with a comment. Raise NewFileError if the name is invalid for a file or a class, or
    if the file exists or cannot be written.
    """
    if not _NAME.fullmatch(name) or len(name) > _LONGEST:
        ending = f"; give the name without {suffix}" if name.endswith(suffix) else ""
        raise NewFileError(
            f"{name!a} is not allowed as a name: give a letter, then letters, digits, - and _, "
            f"at most {_LONGEST}{ending}; -o DIR chooses the folder"
        )
    path = folder / f"{name}{suffix}"
    (template,) = _TEMPLATES.glob(f"*{suffix}.txt")
    text = template.read_text(encoding="utf-8")
    for word, meant in {**words, "NAME": name}.items():
        text = re.sub(rf"\b{word}\b", meant, text)
    for table, content in (tables or {}).items():
        start = text.index(f"[{table}]\n")
        end = text.index("\n# ", start)
        text = f"{text[:start]}[{table}]\n{content}{text[end:]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise NewFileError(f"{path} exists and is not overwritten") from None
    except OSError as error:
        with contextlib.suppress(OSError):
            path.unlink()  # else half of it would be there
        raise NewFileError(f"cannot write {path}: {reason_of(error)}") from None
    return path
