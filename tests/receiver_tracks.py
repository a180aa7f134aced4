"""The track of one flight in the formats of receivers and planners."""

from __future__ import annotations

import datetime
import functools
import operator

import numpy as np

START = datetime.datetime(2024, 2, 29, 23, 59, 52, tzinfo=datetime.UTC)
"""Eight seconds before midnight, and before a month's end."""
COUNT = 20
LATITUDES = 48.0 + 1e-3 * np.arange(COUNT)
LONGITUDES = 11.5 + 1e-3 * np.arange(COUNT)
HEIGHTS = 800.0 + np.arange(COUNT)  # above the ellipsoid
GEOID = 46.5
TIMES = [START + datetime.timedelta(seconds=n) for n in range(COUNT)]
POINTS = list(zip(TIMES, LATITUDES, LONGITUDES, HEIGHTS, strict=True))


def iso(time: datetime.datetime) -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%SZ")


def gpx(geoid: bool = True, time: bool = True) -> str:
    points = "".join(
        f'<trkpt lat="{lat:.6f}" lon="{lon:.6f}"><ele>{h - GEOID:.3f}</ele>'
        + (f"<time>{iso(t)}</time>" if time else "")
        + (f"<geoidheight>{GEOID}</geoidheight>" if geoid else "")
        + "</trkpt>"
        for t, lat, lon, h in POINTS
    )
    return (
        '<?xml version="1.0"?>\n<gpx xmlns="http://www.topografix.com/GPX/1/1" version="1.1" '
        f'creator="test"><trk><trkseg>{points}</trkseg></trk></gpx>'
    )


def kml(mode: str = "absolute") -> str:
    whens = "".join(f"<when>{iso(t)}</when>" for t in TIMES)
    places = "".join(f"<gx:coord>{o:.6f} {a:.6f} {h:.3f}</gx:coord>" for _, a, o, h in POINTS)
    return (
        '<?xml version="1.0"?>\n<kml xmlns="http://www.opengis.net/kml/2.2" '
        'xmlns:gx="http://www.google.com/kml/ext/2.2"><Placemark><gx:Track>'
        f"<altitudeMode>{mode}</altitudeMode>{whens}{places}</gx:Track></Placemark></kml>"
    )


def kml_points() -> str:
    marks = "".join(
        f"<Placemark><TimeStamp><when>{iso(t)}</when></TimeStamp><Point><altitudeMode>absolute"
        f"</altitudeMode><coordinates>{o:.6f},{a:.6f},{h:.3f}</coordinates></Point></Placemark>"
        for t, a, o, h in POINTS
    )
    return f'<kml xmlns="http://www.opengis.net/kml/2.2"><Document>{marks}</Document></kml>'


def nmea_line(body: str) -> str:
    return f"${body}*{functools.reduce(operator.xor, body.encode()):02X}"


def nmea() -> str:
    lines = ["$GPTXT,01,01,02,a receiver*4B"]
    for t, lat, lon, h in POINTS:
        place = f"{48:02}{60 * (lat - 48):09.6f},N,{11:03}{60 * (lon - 11):09.6f},E"
        lines.append(
            nmea_line(f"GPGGA,{t:%H%M%S}.00,{place},1,08,0.9,{h - GEOID:.3f},M,{GEOID},M,,")
        )
    return "\r\n".join([*lines, nmea_line("GPGGA,,,,,,0,,,,,,,,"), "$GPGGA,0000"])


def pos(weeks: bool = False, separator: str = " ") -> str:
    head = "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float)\n"
    names = ("%  GPST", "latitude(deg)", "longitude(deg)", "height(m)", "Q")
    head += separator.join(names) + "\n"
    rows = []
    for n, (t, lat, lon, h) in enumerate(POINTS):
        time = f"2303{separator}{345592 + n}.000" if weeks else f"{t:%Y/%m/%d %H:%M:%S}.000"
        rows.append(separator.join([time, f"{lat:.9f}", f"{lon:.9f}", f"{h:.4f}", "1"]))
    return head + "\n".join(rows) + "\n"


def sexagesimal(value):
    degrees = int(abs(value))
    minutes = int((abs(value) - degrees) * 60.0)
    seconds = ((abs(value) - degrees) * 60.0 - minutes) * 60.0
    return f"{'-' if value < 0 else ''}{degrees} {minutes} {seconds:.5f}"


def csrs(backwards=False, sign=1.0):
    names = "DIR FRAME STN DAYofYEAR YEAR-MM-DD HR:MN:SS.SS NSV GDOP LATDD LATMN LATSS "
    names += "LONDD LONMN LONSS HGT(m) UTMZONE"
    rows = [
        f"FWD ITRF(IGS20) airb 060.1 {t:%Y-%m-%d} {t:%H:%M:%S}.00 9 2.1 {sexagesimal(lat)} "
        f"{sexagesimal(sign * (lon - 11.0))} {h:.4f} 32"
        for t, lat, lon, h in POINTS
    ]
    head = ["HDR GRP CANADIAN GEODETIC SURVEY", "HDR ORB IGS FINAL", names]
    return "\n".join([*head, *(rows[::-1] if backwards else rows)])


def novatel(kind):
    rows = []
    for n, (_, lat, lon, h) in enumerate(POINTS):
        head = f"#{kind},COM1,0,31.0,FINESTEERING,2303,{345592 + n}.000,02040000,5615,1541;"
        if kind == "INSPVAA":
            body = (
                f"2303,{345592 + n}.000,{lat:.9f},{lon:.9f},{h:.4f},0,0,0,0,0,90,INS_SOLUTION_GOOD"
            )
        else:
            body = f"SOL_COMPUTED,SINGLE,{lat:.9f},{lon:.9f},{h - GEOID:.4f},{GEOID},WGS84,1,1,1"
        rows.append(f"{head}{body}*af719fd9")
    return rows


EXACT = {
    "GPX": gpx(),
    "NMEA": nmea(),
    "RTKLIB": pos(),
    "RTKLIB, weeks": pos(weeks=True),
    "RTKLIB, commas": pos(separator=","),
}
"""Files that say how high the geoid is, or have heights above the ellipsoid."""


PLACES = ("46.12", "8.15"), ("46.25", "8.2"), ("46.27", "8.35")
GPX_ROUTE = (
    '<?xml version="1.0"?>\n<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1">\n<rte>\n'
    + "".join(f'<rtept lat="{lat}" lon="{lon}"></rtept>\n' for lat, lon in PLACES)
    + "</rte>\n</gpx>\n"
)
KML_LINE = (
    '<kml xmlns="http://www.opengis.net/kml/2.2"><Placemark><LineString><coordinates>\n'
    + "\n".join(f"{lon},{lat},900" for lat, lon in PLACES)
    + "\n</coordinates></LineString></Placemark></kml>\n"
)
CSV_PLACES = "latitude_deg,longitude_deg\n" + "".join(f"{lat},{lon}\n" for lat, lon in PLACES)

SECONDS = np.arange(COUNT) + 1.7e9
FILES = {
    "GPSLogger": (
        "time,lat,lon,elevation,accuracy",
        SECONDS,
        (1.0, 1.0, 1.0),
        {"height_m": "elevation"},
    ),
    "OpenSky": (
        "time,lat,lon,geoaltitude,heading_unknown",
        SECONDS,
        (1.0, 1.0, 1.0),
        {"height_m": "geoaltitude"},
    ),
    "ULog": ("timestamp,lat,lon,alt_ellipsoid,fix", SECONDS * 1e6, (1e7, 1e7, 1e3), "px4"),
    "ULog, newer": (
        "timestamp,latitude_deg,longitude_deg,altitude_ellipsoid_m,fix",
        SECONDS * 1e6,
        (1.0, 1.0, 1.0),
        "px4",
    ),
    "AirData": (
        "time(millisecond),latitude,longitude,height_above_takeoff(feet),altitude(feet)",
        SECONDS * 1e3,
        (1.0, 1.0, 1.0 / 0.3048),
        {"height_m": "height_above_takeoff"},
    ),
    "rostopic": (
        "%time,field.latitude,field.longitude,field.altitude,field.header.seq",
        SECONDS * 1e9,
        (1.0, 1.0, 1.0),
        "ros",
    ),
    "radians": (
        "t,phi,lambda,h,n",
        SECONDS,
        (np.pi / 180.0, np.pi / 180.0, 1.0),
        {"latitude_deg": "phi [rad]", "longitude_deg": "lambda [rad]"},
    ),
}


def written(name):
    head, times, factors, _ = FILES[name]
    rows = np.column_stack(
        [times, LATITUDES * factors[0], LONGITUDES * factors[1], HEIGHTS * factors[2], SECONDS]
    )
    return "\n".join([head, *(",".join(f"{v:.12g}" for v in row) for row in rows)]).encode()


def csv_text(names, scale=1.0):
    """The flight with other names of its columns."""
    rows = np.column_stack([SECONDS, LATITUDES, LONGITUDES, scale * HEIGHTS])
    return "\n".join([names, *(",".join(f"{v:.12g}" for v in row) for row in rows)]).encode()


SENTENCES = [line for line in nmea().split("\r\n") if "GGA,2" in line or "GGA,0" in line][:COUNT]
DAMAGES = {
    "cut": lambda s: s[:40],
    "another time": lambda s: s.replace("GGA,2", "GGA,1"),
    "a part lost": lambda s: s[:30] + s[35:],
    "another sentence begins": lambda s: s[:20] + "$GPTXT,01",
}
"""Damages of a sentence of NMEA."""


def of_quality(quality):
    """Sentences of NMEA, all with a quality, without their checksums."""
    return "\n".join(s.replace(",1,08,", f",{quality},08,") for s in SENTENCES).replace("*", "\n")


def with_namespaces(count):
    declared = "".join(f' xmlns:n{n}="http://example.org/{n}"' for n in range(count))
    return gpx().replace("<gpx", f"<gpx{declared}", 1)


RANGES = "#RANGECMPA,COM1,0,1,FINE,1,2,3,4,5;1,2*00000000"
"""A log of NovAtel without a position."""


def multitrack(mode="<altitudeMode>absolute</altitudeMode>", own=""):
    """Two tracks of one flight, as My Tracks and OpenTracks write them."""

    def part(points):
        return (
            f"<gx:Track>{own}"
            + "".join(
                f"<when>{iso(t)}</when><gx:coord>{o:.6f} {a:.6f} {h:.3f}</gx:coord>"
                for t, a, o, h in points
            )
            + "</gx:Track>"
        )

    return (
        '<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2">'
        f"<Placemark><gx:MultiTrack>{mode}<gx:interpolate>1</gx:interpolate>{part(POINTS[:9])}"
        f"<gx:Track/>{part(POINTS[9:])}</gx:MultiTrack></Placemark></kml>"
    )


def with_cells(old, new):
    """The log with another text in each fix, and with right checksums."""
    lines = [line.partition("*")[0].lstrip("$") for line in nmea().split("\r\n") if ",M,46" in line]
    return "\r\n".join(nmea_line(line.replace(old, new)) for line in lines).encode()
