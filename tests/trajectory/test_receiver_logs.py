"""Logs of receivers as people have them: NMEA, CSRS-PPP, NovAtel, KML of phones."""

from __future__ import annotations

import functools
import operator

import numpy as np
import pytest
from receiver_tracks import (
    COUNT,
    HEIGHTS,
    LATITUDES,
    LONGITUDES,
    POINTS,
    csrs,
    gpx,
    iso,
    kml,
    nmea,
    nmea_line,
    novatel,
    pos,
)

from ggbench.trajectory.manoeuvres import TrajectoryError
from ggbench.trajectory.track_formats import rows_of

SENTENCES = [line for line in nmea().split("\r\n") if "GGA,2" in line or "GGA,0" in line][:COUNT]


def tag(n):
    block = f"s:r3,c:{1709251192 + n}"
    return f"\\{block}*{functools.reduce(operator.xor, block.encode()):02X}\\"


LOGS = {
    "no checksums": [s.partition("*")[0] for s in SENTENCES],
    "TAG blocks": [tag(n) + s for n, s in enumerate(SENTENCES)],
    "time stamps": [f"2024-02-29 23:59:{n % 60:02d}.123 {s}" for n, s in enumerate(SENTENCES)],
    "brackets": [f"[{1709251192 + n}.5]: {s}" for n, s in enumerate(SENTENCES)],
    "GnssLogger": [
        "# ",
        "# Header Description:",
        "# Version: v3.0.6.4 Platform: 13",
        "#" * 5000,
        *(f"NMEA,{s},{1709251192000 + 1000 * n}" for n, s in enumerate(SENTENCES)),
        "Raw,1,2,3,,,4",
    ],
    "several on a line": ["".join(SENTENCES[n : n + 2]) for n in range(0, COUNT, 2)],
}


def is_the_flight(rows, kept=slice(None)):
    times = np.arange(COUNT)[kept]
    np.testing.assert_allclose(rows.columns["time_s"], times - times[0], atol=1e-6)
    np.testing.assert_allclose(rows.columns["latitude_deg"], LATITUDES[kept], atol=1e-7)
    np.testing.assert_allclose(rows.columns["longitude_deg"], LONGITUDES[kept], atol=1e-7)
    np.testing.assert_allclose(rows.columns["height_m"], HEIGHTS[kept], atol=2e-3)
    return True


@pytest.mark.parametrize("name", LOGS)
def test_sentences_of_nmea_in_logs_of_many_programs(name):
    rows = rows_of("\r\n".join(LOGS[name]).encode())
    assert is_the_flight(rows) and not rows.remark


def test_binary_messages_between_sentences_are_passed_over():
    """As of u-blox receivers, and one that cuts a sentence."""
    message = bytes([0xB5, 0x62, 0x01, 0x07, 0x00, 0xFF, 0x0A, 0x80])
    content = b"".join(s.encode() + b"\r\n" + message for s in SENTENCES)
    assert is_the_flight(rows_of(content))
    cut = content.replace(SENTENCES[5].encode(), SENTENCES[5][:30].encode() + message)
    assert is_the_flight(rows_of(cut), np.arange(COUNT) != 5)


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda s: s[:40], "checksum"),
        (lambda s: s.replace("GGA,2", "GGA,1"), "checksum"),
        (lambda s: s[:30] + s[35:], "checksum"),
        (lambda s: s[:20] + "$GPTXT,01", "checksum"),
    ],
)
def test_one_damaged_sentence_is_left_out_and_counted(damage, reason):
    """A share of more than a tenth is refused."""
    lines = [*SENTENCES]
    lines[5] = damage(lines[5])
    rows = rows_of("\n".join(lines).encode())
    assert is_the_flight(rows, np.arange(COUNT) != 5)
    assert "left out: 1 damaged (first: line 6, " in rows.remark
    assert reason in rows.remark and "('" not in rows.remark
    lines[1:4] = [damage(line) for line in lines[1:4]]
    with pytest.raises(TrajectoryError, match=r"line 2 .* 4 among 20: more than 10%"):
        rows_of("\n".join(lines).encode())


@pytest.mark.parametrize(("quality", "what"), [(6, "estimated"), (7, "manual"), (8, "simulated")])
def test_qualities_that_are_no_fix_are_none(quality, what):
    """With an offset of a degree, which must not show; real-time kinematics is a fix."""
    lines = [s.partition("*")[0] for s in SENTENCES]
    wrong = f",{quality},08,"
    lines[5:8] = [s.replace(",1,08,", wrong).replace("N,011", "N,012") for s in lines[5:8]]
    lines[9] = lines[9].replace(",1,08,", ",4,08,")
    rows = rows_of("\n".join(lines).encode())
    assert is_the_flight(rows, np.r_[0:5, 8:COUNT])
    assert rows.remark == f"GGA sentences left out: 3 {what}"
    with pytest.raises(TrajectoryError, match=rf"no GGA sentence with a fix.* \(only 20 {what}\)"):
        rows_of(
            "\n".join(s.replace(",1,08,", f",{quality},08,") for s in SENTENCES)
            .encode()
            .replace(b"*", b"\n")
        )


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_solution_of_csrs_ppp(backwards, sign):
    """West of Greenwich by less than a degree, where the sign stands before zero, too."""
    rows = rows_of(csrs(backwards, sign).encode())
    np.testing.assert_allclose(rows.columns["time_s"], np.arange(COUNT))
    np.testing.assert_allclose(rows.columns["latitude_deg"], LATITUDES, atol=1e-8)
    np.testing.assert_allclose(rows.columns["longitude_deg"], sign * (LONGITUDES - 11.0), atol=1e-8)
    np.testing.assert_allclose(rows.columns["height_m"], HEIGHTS, atol=1e-3)
    assert not rows.remark
    with pytest.raises(TrajectoryError, match="without the line of column names"):
        rows_of(csrs().replace("HGT(m)", "UP").encode())


@pytest.mark.parametrize("kind", ["INSPVAA", "BESTPOSA"])
def test_ascii_logs_of_novatel(kind):
    """Others between them are passed over, and those without a solution counted."""
    rows = novatel(kind)
    rows.insert(3, "#RANGECMPA,COM1,0,1,FINE,1,2,3,4,5;1,2*00000000")
    assert is_the_flight(rows_of("\n".join(rows).encode()))
    rows[0] = rows[0].replace("INS_SOLUTION_GOOD", "INS_ALIGNING").replace("SOL_COMP", "INSUFF")
    found = rows_of("\n".join(rows).encode())
    assert is_the_flight(found, slice(1, None)) and f"1 of its logs {kind}" in found.remark
    with pytest.raises(TrajectoryError, match="NovAtel log with RANGECMPA; positions are read"):
        rows_of(rows[3].encode())


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


def test_a_track_inherits_the_mode_of_its_multitrack():
    expected = rows_of(kml().encode())
    for text in (multitrack(), multitrack("", "<altitudeMode>absolute</altitudeMode>")):
        found = rows_of(text.encode())
        for key, values in expected.columns.items():
            np.testing.assert_array_equal(found.columns[key], values)
    for bad in (multitrack(""), multitrack(own="<altitudeMode>clampToGround</altitudeMode>")):
        with pytest.raises(TrajectoryError, match="altitudeMode is 'clampToGround'"):
            rows_of(bad.encode())


def test_empty_elements_that_the_standard_allows_are_left_out():
    """A place that is unknown, a time that is, both; of GPX empty segments."""
    rows = kml()
    for n, (t, a, o, h) in enumerate(POINTS[3:6]):
        if n != 1:
            rows = rows.replace(f"<gx:coord>{o:.6f} {a:.6f} {h:.3f}</gx:coord>", "<gx:coord/>")
        if n != 0:
            rows = rows.replace(f"<when>{iso(t)}</when>", "<when></when>")
    found = rows_of(rows.encode())
    np.testing.assert_allclose(found.columns["latitude_deg"], np.delete(LATITUDES, [3, 4, 5]))
    np.testing.assert_allclose(found.columns["time_s"], np.delete(np.arange(COUNT), [3, 4, 5]))
    assert "3 empty positions are left out" in found.remark
    segments = gpx().replace("<trkseg>", "<trkseg></trkseg><trkseg>")
    assert is_the_flight(rows_of(segments.encode()))


def with_cells(old, new):
    """The log with another text in each fix, and with right checksums."""
    lines = [line.partition("*")[0].lstrip("$") for line in nmea().split("\r\n") if ",M,46" in line]
    return "\r\n".join(nmea_line(line.replace(old, new)) for line in lines).encode()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (",E,", ",,", "no N or S, or no E or W"),
        (",N,", ",,", "no N or S, or no E or W"),
        (",46.5,M,", ",152.6,F,", "geoid height is not in metres"),
    ],
)
def test_a_fix_without_direction_or_in_feet_is_none(old, new, said):
    with pytest.raises(TrajectoryError, match=said):
        rows_of(with_cells(old, new))


@pytest.mark.parametrize(("stated", "is_doubtful"), [("0.0", True), ("44.0", False)])
def test_geoid_heights_far_from_those_of_a_model_are_remarked_on(stated, is_doubtful):
    rows = rows_of(with_cells(",46.5,M,", f",{stated},M,"))
    assert ("EGM2008 has 47 m" in rows.remark) is is_doubtful
    text = gpx().replace(f"<geoidheight>{46.5}", f"<geoidheight>{stated}")
    assert ("EGM2008 has 47 m" in rows_of(text.encode()).remark) is is_doubtful


def test_a_solution_in_another_datum_is_refused():
    with pytest.raises(TrajectoryError, match="datum Tokyo; only WGS84"):
        rows_of(pos().replace("WGS84", "Tokyo").encode())
