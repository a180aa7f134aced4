"""Files of global gravity models, and messages of bad ones."""

from __future__ import annotations

import gzip
import tarfile
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from ggbench.gravity.gradient_map import MapError
from ggbench.maps.gravity_model import read_model

HEADER = {
    "product_type": "gravity_field",
    "modelname": "TEST",
    "earth_gravity_constant": "0.3986004415D+15",
    "radius": "0.63781363E+07",
    "max_degree": "4",
    "errors": "calibrated",
    "norm": "fully_normalized",
    "tide_system": "tide_free",
}


def rows(degree: int = 4) -> list[list[str]]:
    """Coefficients (n, m) -> C = 1e-6 (n + m/10), S = -C, as Fortran writes them."""
    lines = [["gfc", "0", "0", "1.0D0", "0.0d0", "0.0", "0.0"]]
    for n in range(2, degree + 1):
        for m in range(n + 1):
            c = -4.84e-4 if (n, m) == (2, 0) else 1e-6 * (n + m / 10)
            s = 0.0 if m == 0 else -c
            numbers = [f"{x:.12e}".replace("e", "D") for x in (c, s)]
            lines.append(["gfc", str(n), str(m), *numbers, "1.0E-12", "1.0E-12"])
    return lines


def text(header: dict[str, str | None] | None = None, lines: list[list[str]] | None = None) -> str:
    keys = {k: v for k, v in (HEADER | (header or {})).items() if v is not None}
    head = [f"{key:25s} {value}" for key, value in keys.items()]
    body = [" ".join(words) for words in (rows() if lines is None else lines)]
    return "\n".join(["A model, with words before.", *head, "end_of_head =====", *body, ""])


def test_coefficients_are_read_as_written(tmp_path):
    file = tmp_path / "model.gfc"
    file.write_text(text())
    model = read_model(file)
    assert model.name == "TEST"
    read = model.coefficients
    assert (read.gm, read.radius, read.degree) == (3.986004415e14, 6378136.3, 4)
    assert read.cosine[2, 0] == -4.84e-4
    assert read.cosine[4, 3] == 4.3e-6
    assert read.sine[3, 2] == -3.2e-6
    assert not read.cosine[1].any()
    assert not np.triu(read.cosine, 1).any()
    assert read_model(file, 3).coefficients.degree == 3


def test_a_compressed_file_and_other_orders_of_lines_are_the_same(tmp_path):
    plain, packed = tmp_path / "a.gfc", tmp_path / "a.gfc.gz"
    plain.write_text(text())
    packed.write_bytes(gzip.compress(text(lines=rows()[::-1]).encode()))
    one, other = read_model(plain).coefficients, read_model(packed).coefficients
    np.testing.assert_array_equal(one.cosine, other.cosine)
    np.testing.assert_array_equal(one.sine, other.sine)


def test_orders_that_a_model_does_not_have_are_zero(tmp_path):
    """EGM2008 goes to degree 2190, but to order 2159 only."""
    file = tmp_path / "model.gfc"
    lines = [row for row in rows(40) if int(row[2]) <= 39]
    file.write_text(text({"max_degree": "40"}, lines))
    model = read_model(file).coefficients
    assert model.cosine[40, 40] == 0.0
    assert model.cosine[40, 39] == 43.9e-6


def test_a_potential_without_its_degree_zero_has_the_earths_mass(tmp_path):
    """Files leave it out, or say 0 or 1: it is what the gravity constant is for."""
    file = tmp_path / "model.gfc"
    for first in ([], [["gfc", "0", "0", "0.0", "0.0", "0.0", "0.0"]], rows()[:1]):
        file.write_text(text(lines=[*first, *rows()[1:]]))
        assert read_model(file).coefficients.cosine[0, 0] == 1.0


def test_the_permanent_tide_is_removed(tmp_path):
    """EGM2008 is published both ways: C20 differs by -4.1736e-9 (its README).

    What the Moon and the Sun do to it themselves is 4.4228e-8 of -0.31460 (IERS Conventions 2010,
    eq. 6.14).
    """
    read = {}
    for tide in ("tide_free", "zero_tide", "mean_tide"):
        file = tmp_path / f"{tide}.gfc"
        file.write_text(text({"tide_system": tide}))
        read[tide] = read_model(file).coefficients.cosine[2, 0]
    assert read["zero_tide"] - read["tide_free"] == pytest.approx(4.1736e-9, rel=1e-6)
    direct = 4.4228e-8 * 0.31460
    assert read["mean_tide"] - read["zero_tide"] == pytest.approx(direct, rel=1e-3)


def test_unnormalised_coefficients_are_normalised(tmp_path):
    """By the known ratio: C̄20 = C20/√5, C̄22 = C22 √(12/5)."""
    lines = rows(2)
    file = tmp_path / "model.gfc"
    lines[1][3] = "-1.0826E-03"
    file.write_text(text({"norm": "unnormalized", "max_degree": "2"}, lines))
    model = read_model(file).coefficients
    assert model.cosine[2, 0] == pytest.approx(-1.0826e-3 / np.sqrt(5.0))
    assert model.cosine[2, 2] == pytest.approx(2.2e-6 * np.sqrt(12.0 / 5.0))


def changed(index: int, column: int, word: str) -> list[list[str]]:
    lines = rows()
    lines[index][column] = word
    return lines


@pytest.mark.parametrize("said", ["zero_tide", "zero tide", "Zero-Tide", "zero_tide (IERS 2010)"])
def test_tide_systems_are_spelled_in_many_ways(said, tmp_path):
    """As in ICGEM's own files."""
    file = tmp_path / "model.gfc"
    read = {}
    for tide in (said, said.lower().replace("zero", "mean"), "tide-free", "tide free", "tide_free"):
        file.write_text(text({"tide_system": tide}))
        read[tide] = read_model(file).coefficients.cosine[2, 0]
    assert read["tide-free"] == read["tide free"] == read["tide_free"] == -4.84e-4
    zero, mean = list(read.values())[:2]
    assert zero - read["tide_free"] == pytest.approx(4.1736e-9, rel=1e-6)
    assert mean > zero


PROSE = "radius of the Earth is meant\ntide_system of the loads\nas end_of_head says\n"


def test_prose_before_the_header_is_for_people(tmp_path):
    """Words of it that begin like keys are none."""
    file = tmp_path / "model.gfc"
    file.write_text(PROSE + "begin_of_head ====\n" + text({"tide_system": None}))
    assert read_model(file).coefficients.degree == 4


def test_models_come_packed(tmp_path):
    """In gzip, zip and tar; of several files in an archive, the only .gfc."""
    plain, packed = tmp_path / "a.gfc", tmp_path / "a.gfc.tar.gz"
    plain.write_text(text())
    (tmp_path / "readme.txt").write_text("words")
    with tarfile.open(packed, "w:gz") as tar:
        tar.add(plain, "a.gfc")
        tar.add(tmp_path / "readme.txt", "readme.txt")
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.write(plain, "model/a.txt")
    for path in (packed, tmp_path / "a.zip"):
        assert read_model(path).coefficients.cosine[4, 3] == 4.3e-6


def test_fortran_leaves_out_the_e_of_long_exponents(tmp_path):
    """1.09-101 is 1.09e-101, of C, of S and of their errors."""
    file = tmp_path / "model.gfc"
    lines = rows()
    lines[6][3:] = ["1.09-101", "-2.5-120", "1.0-102", "1.0+100"]
    file.write_text(text(lines=lines))
    read = read_model(file).coefficients
    assert (read.cosine[3, 2], read.sine[3, 2]) == (1.09e-101, -2.5e-120)


def zipped(path: Path, names: list[str], size: int | None = None) -> None:
    """Write a zip archive of models, cut to a size."""
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            archive.writestr(name, text())
    path.write_bytes(path.read_bytes()[:size])


def cut_gzip(path: Path) -> None:
    path.write_bytes(gzip.compress(text().encode())[:-20])


def other_arrays(path: Path) -> None:
    np.savez(path, cs=np.zeros((7, 2)), gm=3.986e14, r=6378e3)


NO_COEFFICIENT = "is not a coefficient"
BAD: dict[str, tuple[str, str]] = {
    "no column of S": (
        text(lines=[["gfc", "2", "0", "-4.84D-4"]]),
        r"line 11, 'gfc 2 0 -4.84D-4', cannot be",
    ),
    "an error for S": (
        text(lines=changed(1, 4, "")),
        "'gfc 2 0' has S = 1e-12, .* is the column S missing",
    ),
    "an empty file": ("", "no line 'end_of_head'"),
    "bytes": ("\x00\x01binary" * 100, "no line 'end_of_head'"),
    "a header alone": (text(lines=[]), "a header, but no coefficients"),
    "an unknown norm": (text({"norm": "odd"}), "norm is 'odd'; allowed: fully_normalized"),
    "a model of topography": (
        text({"product_type": "topography"}),
        "product_type is 'topography'",
    ),
    "an unknown tide": (text({"tide_system": "spring"}), "tide_system is 'spring'"),
    "prose that begins like a key": (
        PROSE + text({"tide_system": None}),
        "tide_system is 'of the loads'; allowed",
    ),
    "no radius": (text({"radius": None}), "header lacks radius"),
    "a word as gravity constant": (
        text({"earth_gravity_constant": "big"}),
        "'big' and must be a number",
    ),
    "the Moon": (text({"earth_gravity_constant": "4.9028D+12"}), "are not the Earth's"),
    "a radius in kilometres": (text({"radius": "6378.1363"}), "are not the Earth's in m"),
    "a huge degree": (text({"max_degree": "1e9"}), "at most 5600 is allowed"),
    "a degree above the stated one": (text({"max_degree": "3"}), "'gfc 4 0 .*degree up to 3"),
    "a degree below the stated one": (
        text({"max_degree": "5"}),
        "ends at order 4, far below degree 5",
    ),
    "a coefficient too few": (
        text(lines=rows()[:5] + rows()[6:]),
        "lacks the coefficient of degree 3 and order 1",
    ),
    "a coefficient twice": (
        text(lines=[*rows(), rows()[4]]),
        "degree 3 and order 0 more than once",
    ),
    "a coefficient of a time": (
        text(lines=changed(3, 0, "gfct")),
        "vary with time .lines gfct.: .*--epoch",
    ),
    "a rate of a coefficient": (
        text(lines=changed(3, 0, "dot")),
        "vary with time .lines dot.: .*--epoch",
    ),
    "an unknown line": (text(lines=changed(3, 0, "gfx")), "begins with 'gfx'"),
    "an order above the degree": (text(lines=changed(3, 2, "7")), NO_COEFFICIENT),
    "a negative degree": (text(lines=changed(3, 1, "-2")), NO_COEFFICIENT),
    "a coefficient that is not a number": (text(lines=changed(3, 3, "nan")), NO_COEFFICIENT),
    "a letter before a number": (
        text(lines=changed(3, 4, "x1.0")),
        r"line 14, 'gfc 2 2 .* x1.0 .*cannot be read",
    ),
    "another flattening": (
        text(lines=changed(1, 3, "1.0E-9")),
        "degree 2 and order 0 must be the Earth's",
    ),
    "half an order": (text(lines=changed(3, 2, "1.5")), "cannot be read"),
    "a line of one word": (text(lines=[*rows(), ["gfc"]]), "cannot be read"),
    "an order too few": (text()[:-80], "ends at order 3, far below degree 4"),
    "a line that is cut": (text()[:-500], "cannot be read"),
}
"""Texts and messages."""
BAD_FILES: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "no file": ("gone.gfc", Path.exists, "No such file"),
    "a gzip file that is cut": ("damaged.gfc.gz", cut_gzip, "cannot be unpacked"),
    "arrays of another shape": ("other.npz", other_arrays, "two columns and"),
    "two models": (
        "b.zip",
        partial(zipped, names=["a.gfc", "b.gfc"]),
        r"archive of 2 files with 2 files \*.gfc; exactly one is allowed",
    ),
    "a zip file that is cut": (
        "a.zip",
        partial(zipped, names=["model/a.txt"], size=-30),
        "a.zip cannot be unpacked",
    ),
}
"""Names of files, their makers, and messages."""


@pytest.mark.parametrize("kind", [*BAD, *BAD_FILES])
def test_a_bad_model_is_refused_in_one_sentence(kind, tmp_path):
    if kind in BAD:
        content, message = BAD[kind]
        path = tmp_path / "model.gfc"
        path.write_text(content)
    else:
        name, make, message = BAD_FILES[kind]
        path = tmp_path / name
        make(path)
    with refused(MapError, message):
        read_model(path)


@pytest.mark.parametrize("degree", [1, 5, 10_000])
def test_a_degree_that_is_not_there_is_refused(tmp_path, degree):
    file = tmp_path / "model.gfc"
    file.write_text(text())
    with refused(MapError, "degrees up to 4"):
        read_model(file, degree)
