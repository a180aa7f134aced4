"""Messages of tracks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from receiver_tracks import (
    DAMAGES,
    RANGES,
    SENTENCES,
    START,
    csrs,
    csv_text,
    gpx,
    iso,
    kml,
    multitrack,
    nmea,
    nmea_line,
    of_quality,
    pos,
    with_cells,
    with_namespaces,
    written,
)
from refusals import refused
from tracks import NAMES, NEAR_ZERO, ROWS, WHIRL, bare_angles, curve, read, table, text, with_row

from ggbench.simulation.true_motion import trajectory_of
from ggbench.trajectory.manoeuvres import TrajectoryError
from ggbench.trajectory.track_formats import rows_of

SECONDS = np.arange(300.0)
ZEROS = 0.0 * SECONDS
STILL = table(np.column_stack([SECONDS, 10.0 + ZEROS, ZEROS, ZEROS]))
FAST = table(np.column_stack([SECONDS, ZEROS, 100.0 + 0.1 * SECONDS, 500.0 + ZEROS])[:20])
AGAINST = {
    "counter-clockwise from east": (
        lambda course: 90.0 - course,
        "measured counter-clockwise from east",
    ),
    "counter-clockwise from north": (
        lambda course: -course,
        "measured counter-clockwise from north",
    ),
    "clockwise from east": (lambda course: course - 90.0, "measured clockwise from east"),
    "at the stern": (lambda course: 180.0 + course, "of the stern"),
    "in radians": (lambda course: np.radians(course), "in radians$"),
    "in radians from east": (
        lambda course: np.radians(90.0 - course),
        "in radians, counter-clockwise from east",
    ),
}


def damaged(damage):
    """Sentences of NMEA, four of them damaged."""
    lines = [*SENTENCES]
    for n in (5, 1, 2, 3):
        lines[n] = DAMAGES[damage](lines[n])
    return "\n".join(lines)


BAD: dict[str, tuple[str | bytes, str] | tuple[str | bytes, str, dict[str, Any]]] = {
    "empty": ("", "is empty; its first line must name the columns, time_s"),
    "blank": ("\n\n", "is empty"),
    "binary": (bytes(range(256)), "is not UTF-8 text"),
    "UTF-16": (text().encode("utf-16"), "is not UTF-8 text"),
    "no names": (text()[len(NAMES) + 1 :], r"line 1 names no column time_s \(found: 0, 33"),
    "names only": (NAMES, "has 0 rows; a track needs at least 5"),
    "four rows": (text(ROWS[:4]), "has 4 rows; a track needs at least 5"),
    "radians by name": (text(names="t,lat_rad,lon_rad,h"), "names no column latitude_deg"),
    "radians by value": (
        text([f"{t},{0.5 + 1e-6 * t:.8f},1.8,100" for t in range(9)], "t,lat,lon,h"),
        "if they are degrees, name the columns latitude_deg",
    ),
    "feet": (text(names="t,lat,lon,altitude_ft"), r"no column height_m \(found: .*altitude_ft\)"),
    "unit in brackets": (
        text(names="t,lat,lon,alt [fl]"),
        r"line 1 .* 'alt' in 'fl'; allowed units .*: m, ",
    ),
    "two units": (
        text(names="t,lat,lon,alt_m [ft]"),
        r"'alt_m' and the unit 'ft' after it contradict",
    ),
    "heading in radians": (
        text([r + ",1.0" for r in ROWS], NAMES + ",heading_rad"),
        "'heading_rad'; .* in degrees",
    ),
    "column twice": (text(names="time,lat,latitude,h"), "latitude_deg twice, 'lat' and 'latitude'"),
    "field missing": (with_row("3,33.003,108.003"), "line 5 has 3 fields, but line 1 names 4"),
    "field too many": (with_row("3,33.003,108.003,3000,1"), "line 5 has 5 fields, but line 1"),
    "line empty": (with_row(""), "line 5 has 0 fields"),
    "cell empty": (with_row("3,,108.003,3000"), "line 5: latitude_deg is empty and must be"),
    "cell of a space": (with_row("3, ,108.003,3000"), "line 5: latitude_deg is empty and must be"),
    "NaN": (with_row("3,33.003,108.003,nan"), "line 5: height_m is 'nan' and must be a number"),
    "infinity": (with_row("3,33.003,108.003,inf"), "line 5: height_m is 'inf'"),
    "word": (with_row("3,33.003,E108,3000"), "line 5: longitude_deg is 'E108'"),
    "truth": (with_row("3,33.003,True,3000"), "line 5: longitude_deg is 'True'"),
    "truths": (text([f"{t},33.0,True,3000" for t in range(9)]), "line 2: longitude_deg is 'True'"),
    "decimal commas": (text().replace(",", ";").replace(".", ","), "line 2: .* a decimal comma"),
    "both commas": (text([r.replace(".", ",") for r in ROWS]), "line 2 has 7 .* a decimal comma"),
    "date": (with_row("2024-05-01T00:00:03Z,33.003,108.003,3000"), "line 5: time_s .* dates as 20"),
    "time twice": (with_row("2,33.003,108.003,3000"), "line 5: time_s is 2 after 2 in the row"),
    "time backwards": (with_row("1,33.003,108.003,3000"), "line 5: time_s is 1 after 2"),
    "week": (
        text([f"{(604790 + t) % 604800}," + row.partition(",")[2] for t, row in enumerate(ROWS)]),
        "line 12: time_s is 0 after 604799 .*seconds of the GPS week restart .* add 604800",
    ),
    "midnight": (
        text([f"{(86390 + t) % 86400}," + row.partition(",")[2] for t, row in enumerate(ROWS)]),
        "line 12: .* seconds of the day restart there: add 86400 from that row on",
    ),
    "names behind a # of a bad row": (
        "#" + with_row("3,33.003,E108,3000"),
        "line 5: longitude_deg is 'E108'",
    ),
    "open quote": (with_row('3,33.003,"108.003,3000'), "line 5: its quotes .*close each"),
    "quoted decimal comma": (with_row('3,"33,003",108.003,3000'), "line 5: .* a decimal comma"),
    "gap": (text(ROWS[:5] + ROWS[12:]), "line 7: comes 8 s after .* at most 5 s .* max_gap_s"),
    "pole": (with_row("3,89.5,108.003,3000"), "line 5: latitude_deg is 89.5 .* -89 and 89"),
    "no latitude": (with_row("3,108.003,33.003,3000"), "line 5: latitude_deg is 108.003"),
    "longitude": (with_row("3,33.003,361,3000"), "line 5: longitude_deg is 361"),
    "orbit": (with_row("3,33.003,108.003,400000"), "line 5: height_m is 400000"),
    "jump": (with_row("3,34.003,108.003,3000"), r"line 5: lies .* at most 10000 m/s are allowed"),
    "small jump": (with_row("3,33.1,108.003,3000"), r"line 5: lies .* at most 10000 m/s are allow"),
    "outlier": (with_row("3,33.004,108.003,3000"), r"line 5: .* acceleration of \d+.* at most 50"),
    "flip": (
        text([f"{r},{200 * (n > 7)}" for n, r in enumerate(ROWS)], NAMES + ",heading"),
        "line 10: heading_deg turns by 160° from the row before",
    ),
    "GPX without times": (gpx(time=False), "track point 1 has no time; every point needs <time>"),
    "GPX without heights": (gpx().replace("ele>", "eel>"), "track point 1 has no height"),
    "GPX of waypoints": (
        '<gpx version="1.1"><wpt lat="1" lon="2"/></gpx>',
        "has waypoints or routes but no track",
    ),
    "GPX without end": (gpx()[:-40], "cannot be read as a GPX file"),
    "GPX, no number": (gpx().replace("48.003", "nan", 1), "as a GPX|not a number"),
    "KML on the ground": (kml("clampToGround"), "altitudeMode is 'clampToGround'; .*'absolute'"),
    "KML of a line": (
        "<kml><Placemark><LineString><coordinates>1,2,3 4,5,6</coordinates></LineString>"
        "</Placemark></kml>",
        "has no times; a track is a gx:Track",
    ),
    "KML, a time less": (kml().replace(f"<when>{iso(START)}</when>", ""), "19 times and 20 pos"),
    "KML, a word": (kml().replace("11.503000", "east"), "position 4 is 'east,48.003"),
    "KML, a bad time": (kml().replace("23:59:55", "25:59:55"), "position 4: its time.* not a n"),
    "KML, a year of none": (kml().replace("<when>2024", "<when>0024", 3), "position 4: comes 6"),
    "zip archive": ("PK\x03\x04", "is a zip archive; unpack it"),
    "NMEA, checksums": (nmea().replace(",08,0.9,", ",09,0.9,"), "of 20 GGA .* line 2 .*checksum"),
    "NMEA without fixes": ("\n".join([nmea_line("GPGGA,1,,,,,0,,,,,,,,")] * 9), "no GGA sentence"),
    "NMEA in feet": (
        "\n".join(nmea_line("GPGGA,000000.00,4800.0,N,01130.0,E,1,8,1,9,F,1,M,,") for _ in "12"),
        "GGA sentences .* on line 1 .* not in metres",
    ),
    "RTKLIB in ECEF": (pos().replace("latitude(deg)", "x-ecef(m)"), "out-solformat = llh"),
    "RTKLIB, short": (pos() + "2024/03/01 00:01:00 48.1", "line 23 is '2024/03/01 00:01:00 48.1'"),
    "RTKLIB, four positions": (
        "\n".join(pos().splitlines()[:6]),
        "has 4 positions; a track needs at",
    ),
    "KML, time backwards": (
        kml().replace("23:59:55", "23:59:50"),
        "position 4: time_s is .* in the row before",
    ),
    "no motion": (STILL, r"never exceeds 1 m/s .* heading_deg.* in seconds"),
    "11 km a second": (FAST, r"1.11\de\+04 m/s; at most 10000 m/s are allowed"),
    "a whirl within one interval": (
        WHIRL,
        r"turns by 30° within one IMU interval at .* 28°",
        {"dt": 0.5},
    ),
    "wide smoothing": (
        text(),
        "smoothing_s is 1001 and must not exceed 1000 ",
        {"smoothing_s": 1001.0},
    ),
    "degrees that could be radians": (
        text([row.replace(",1.6", ",1.5") for row in NEAR_ZERO], "time_s,lat,lon,height_m"),
        "could be radians",
    ),
    **{
        f"heading measured {name}": (
            table(curve(heading), NAMES + ",heading_deg"),
            f"heading_deg differs by .* it seems to be {said}",
        )
        for name, (heading, said) in AGAINST.items()
    },
    "bare yaw, pitch and roll": (
        table(bare_angles(), NAMES + ",yaw,pitch,roll"),
        "all of yaw, pitch and roll could be radians",
    ),
    "bare pitch and roll": (
        table(np.delete(bare_angles(), 4, axis=1), NAMES + ",pitch,roll"),
        "all of pitch and roll could be radians",
    ),
    **{
        f"NMEA, damage: {damage}": (damaged(damage), r"4 of 20 GGA .* line 2 .* at most 10% may")
        for damage in DAMAGES
    },
    **{
        f"NMEA, {what} positions": (
            of_quality(quality),
            rf"no GGA sentence with a fix.* \(only 20 {what}\)",
        )
        for quality, what in ((6, "estimated"), (7, "manual"), (8, "simulated"))
    },
    "NMEA without east or west": (with_cells(",E,", ",,"), "no N or S, or no E or W"),
    "NMEA without north or south": (with_cells(",N,", ",,"), "no N or S, or no E or W"),
    "NMEA with a geoid in feet": (
        with_cells(",46.5,M,", ",152.6,F,"),
        "geoid height is not in metres",
    ),
    "CSRS-PPP without heights": (
        csrs().replace("HGT(m)", "UP"),
        "without the line of column names",
    ),
    "NovAtel without positions": (RANGES, "NovAtel log with RANGECMPA; positions are read"),
    "KML of tracks without a mode": (multitrack(""), "altitudeMode is 'clampToGround'"),
    "KML of tracks on the ground": (
        multitrack(own="<altitudeMode>clampToGround</altitudeMode>"),
        "altitudeMode is 'clampToGround'",
    ),
    "RTKLIB in another datum": (pos().replace("WGS84", "Tokyo"), "datum Tokyo; only WGS84"),
    "GPX with many namespaces": (with_namespaces(20_000), "XML namespaces; at most 100"),
}
"""Files, messages and, where they are not those of a scenario, limits."""


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_track_is_refused_with_its_path(kind, tmp_path):
    """In one sentence that names the file, what was found and what is allowed."""
    content, expected, *limits = BAD[kind]
    options = {"dt": 0.1} | dict(*limits)
    dt = options.pop("dt")
    path = tmp_path / "track.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with refused(TrajectoryError, expected) as caught:
        trajectory_of(read(str(path), **options), dt)
    assert str(caught.value).startswith(f"track {path}: ")


@pytest.mark.parametrize("name", [".", "gone.csv", "gone/track.csv", "/dev/zero"])
def test_what_is_no_file_has_its_sentence(name, tmp_path):
    """A folder and a device are told from a missing file, and not waited for."""
    with pytest.raises(TrajectoryError, match=r"the track .*: (it is not a|No such) file"):
        assert read(str(tmp_path / name)).duration_s


SWAPPED = csv_text("time_s,lon,longitude_deg,height_m")
WEST = csv_text("time_s,latitude_deg,lon_w,height_m")
DEPTH = csv_text("time_s,latitude_deg,longitude_deg,depth")
LOG = written("GPSLogger")
BAD_COLUMNS = {
    "no such column": (LOG, {"height_m": "alti"}, "line 1 names no column 'alti' for height_m"),
    "heights in degrees": (
        LOG,
        {"height_m": "elevation [deg]"},
        "a column 'elevation' in 'deg'; allowed units of height_m",
    ),
    "unknown key": (
        LOG,
        {"hight_m": "elevation"},
        "columns.hight_m is not a column of a track; known: time_s",
    ),
    "unknown program": (LOG, "px5", "columns is 'px5' and must be euroc, px4, ros"),
    "another program": (LOG, "ros", r"names no column '%time \[ns\]' for time_s"),
    "swapped coordinates": (SWAPPED, {"latitude_deg": "lon"}, "columns are swapped"),
    "west longitudes": (WEST, {"longitude_deg": "lon_w"}, "positive west"),
    "depths": (DEPTH, {"height_m": "depth"}, "positive down"),
    "GPX": (
        b"<gpx version='1.1'></gpx>",
        {"height_m": "ele"},
        "is a GPX file, which has no column",
    ),
}
"""Files, names of their columns and messages."""


@pytest.mark.parametrize("kind", BAD_COLUMNS)
def test_a_bad_name_of_a_column_is_refused(kind):
    content, columns, message = BAD_COLUMNS[kind]
    with refused(TrajectoryError, message):
        rows_of(content, columns)
