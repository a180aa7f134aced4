"""Logs of receivers as people have them: NMEA, CSRS-PPP, NovAtel, KML of phones."""

from __future__ import annotations

import functools
import operator

import numpy as np
import pytest
from receiver_tracks import (
    COUNT,
    DAMAGES,
    HEIGHTS,
    LATITUDES,
    LONGITUDES,
    POINTS,
    RANGES,
    SENTENCES,
    csrs,
    gpx,
    iso,
    kml,
    multitrack,
    novatel,
    with_cells,
)

from ggbench.trajectory.track_formats import rows_of


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


@pytest.mark.parametrize("damage", DAMAGES)
def test_one_damaged_sentence_is_left_out_and_counted(damage):
    lines = [*SENTENCES]
    lines[5] = DAMAGES[damage](lines[5])
    rows = rows_of("\n".join(lines).encode())
    assert is_the_flight(rows, np.arange(COUNT) != 5)
    assert "left out: 1 damaged (first: line 6, " in rows.remark
    assert "checksum" in rows.remark and "('" not in rows.remark


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


@pytest.mark.parametrize("kind", ["INSPVAA", "BESTPOSA"])
def test_ascii_logs_of_novatel(kind):
    """Others between them are passed over, and those without a solution counted."""
    rows = novatel(kind)
    rows.insert(3, RANGES)
    assert is_the_flight(rows_of("\n".join(rows).encode()))
    rows[0] = rows[0].replace("INS_SOLUTION_GOOD", "INS_ALIGNING").replace("SOL_COMP", "INSUFF")
    found = rows_of("\n".join(rows).encode())
    assert is_the_flight(found, slice(1, None)) and f"1 of its logs {kind}" in found.remark


def test_a_track_inherits_the_mode_of_its_multitrack():
    expected = rows_of(kml().encode())
    for text in (multitrack(), multitrack("", "<altitudeMode>absolute</altitudeMode>")):
        found = rows_of(text.encode())
        for key, values in expected.columns.items():
            np.testing.assert_array_equal(found.columns[key], values)


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


@pytest.mark.parametrize(("stated", "is_doubtful"), [("0.0", True), ("44.0", False)])
def test_geoid_heights_far_from_those_of_a_model_are_remarked_on(stated, is_doubtful):
    rows = rows_of(with_cells(",46.5,M,", f",{stated},M,"))
    assert ("those of EGM2008 47 m" in rows.remark) is is_doubtful
    text = gpx().replace(f"<geoidheight>{46.5}", f"<geoidheight>{stated}")
    assert ("those of EGM2008 47 m" in rows_of(text.encode()).remark) is is_doubtful
