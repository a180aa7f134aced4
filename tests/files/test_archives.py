"""Damaged archives: whatever a library raises, every reader answers with a sentence."""

from __future__ import annotations

import gzip
import io
import pickle
import struct
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from random_harmonics import write_gfc
from refusals import refused

from ggbench.errors import GGBenchError
from ggbench.files import archives
from ggbench.gravity.terrain_files import read_terrain
from ggbench.maps import survey_files
from ggbench.maps.gravity_grid import read_grid
from ggbench.maps.gravity_model import read_model
from ggbench.trajectory import survey_lines

AXIS = np.arange(20) / 10.0
GRID = np.add.outer(AXIS, AXIS)
FIELDS = {
    # Name: place of the file's entry, offset within it, form, value.
    "version 10.6": (b"PK\x01\x02", 6, "<H", 106),
    "encrypted": (b"PK\x01\x02", 8, "<H", 1),
    "patched": (b"PK\x01\x02", 8, "<H", 0x20),
    "strong encryption": (b"PK\x01\x02", 8, "<H", 0x41),
    "method 99": (b"PK\x01\x02", 10, "<H", 99),
    "bzip2": (b"PK\x01\x02", 10, "<H", zipfile.ZIP_BZIP2),
    "LZMA": (b"PK\x01\x02", 10, "<H", zipfile.ZIP_LZMA),
    "checksum": (b"PK\x01\x02", 16, "<L", 1),
    "packed size 0": (b"PK\x01\x02", 20, "<L", 0),
    "packed size 3 GB": (b"PK\x01\x02", 20, "<L", 3_000_000_000),
    "size 1": (b"PK\x01\x02", 24, "<L", 1),
    "size 3 GB": (b"PK\x01\x02", 24, "<L", 3_000_000_000),
    "size of zip64": (b"PK\x01\x02", 24, "<L", 0xFFFFFFFF),
    "long name": (b"PK\x01\x02", 28, "<H", 0xFFFF),
    "long extra field": (b"PK\x01\x02", 30, "<H", 0xFFFF),
    "entry far off": (b"PK\x01\x02", 42, "<L", 0xFFFFFFF0),
    "entry off by one": (b"PK\x01\x02", 42, "<L", 1),
    "signature of the entry": (b"PK\x03\x04", 2, "<H", 0),
    "encrypted entry": (b"PK\x03\x04", 6, "<H", 1),
    "long name of the entry": (b"PK\x03\x04", 26, "<H", 0xFFFF),
    "packed bytes": (b"PK\x03\x04", 60, "<Q", 0xFFFFFFFFFFFFFFFF),
    "directory far off": (b"PK\x05\x06", 16, "<L", 0xFFFFFFF0),
    "directory of 3 GB": (b"PK\x05\x06", 12, "<L", 3_000_000_000),
    "signature of the end": (b"PK\x05\x06", 2, "<H", 0),
}
"""Fields of a zip archive (APPNOTE.TXT 4.3) with values that damage it."""


def npz(**arrays: np.ndarray | float) -> bytes:
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    return content.getvalue()


def zipped(name: str, content: bytes, method: int = zipfile.ZIP_DEFLATED) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", method) as archive:
        archive.writestr(name, content)
    return packed.getvalue()


def patched(content: bytes, field: str) -> bytes:
    """Return an archive with a field of its first file changed."""
    mark, offset, form, value = FIELDS[field]
    changed = bytearray(content)
    struct.pack_into(form, changed, content.index(mark) + offset, value)
    return bytes(changed)


def coefficients(folder: Path) -> bytes:
    write_gfc(folder / "plain.gfc", 12)
    return (folder / "plain.gfc").read_bytes()


def model_arrays() -> bytes:
    """Return degrees 0 to 2 of an Earth."""
    pairs = np.zeros((6, 2))
    pairs[0, 0], pairs[3, 0] = 1.0, -4.8416e-4
    return npz(cs=pairs, gm=3.986004415e14, r=6378136.3)


ZIPS: dict[str, tuple[Callable[[Path], bytes], Callable[[Path], object]]] = {
    "dem.npz": (lambda _: npz(lat=45.0 + AXIS, lon=7.0 + AXIS, z=GRID), read_terrain),
    "geoid.npz": (
        lambda _: npz(lat0=45.0, lon0=7.0, step=0.1, N_1e4m=1e4 * GRID),
        lambda path: read_grid(path, "geoid"),
    ),
    "model.npz": (lambda _: model_arrays(), read_model),
    "model.gfc.zip": (lambda folder: zipped("a.gfc", coefficients(folder)), read_model),
}


class Refused(GGBenchError):
    """An archive cannot be used."""


def is_refused(read: Callable[[Path], object], path: Path, whole: bytes) -> bool:
    """Return whether a file is refused, by a short sentence with its name; else it reads equal."""
    try:
        found = pickle.dumps(read(path))
    except GGBenchError as error:
        assert path.name in str(error) and len(str(error)) < 500
        return True
    assert found == whole
    return False


@pytest.mark.parametrize("name", ZIPS)
def test_damaged_fields_of_a_zip_are_sentences(name, tmp_path):
    """Fields with a copy elsewhere in the archive may not matter."""
    make, read = ZIPS[name]
    content, path = make(tmp_path), tmp_path / name
    path.write_bytes(content)
    whole, refused = pickle.dumps(read(path)), set()
    for field in FIELDS:
        path.write_bytes(patched(content, field))
        if is_refused(read, path, whole):
            refused.add(field)
    assert len(refused) > 16
    assert {"version 10.6", "encrypted", "method 99", "checksum", "directory far off"} <= refused


@pytest.mark.long
@pytest.mark.parametrize("name", ZIPS)
def test_a_zip_with_any_byte_changed_is_refused_or_read_equal(name, tmp_path):
    """Each byte of the headers of the first file, of its directory entry and of the end."""
    make, read = ZIPS[name]
    content, path = make(tmp_path), tmp_path / name
    path.write_bytes(content)
    whole, refused = pickle.dumps(read(path)), 0
    places = {
        content.index(mark) + offset
        for mark, size in ((b"PK\x03\x04", 50), (b"PK\x01\x02", 60), (b"PK\x05\x06", 22))
        for offset in range(size)
    }
    for place in sorted(places):
        for value in (0x00, 0x63, 0xFF):
            changed = bytearray(content)
            changed[place] = value
            path.write_bytes(changed)
            refused += is_refused(read, path, whole)
    assert refused > 100


TEXTS: dict[str, Callable[[Path], object]] = {
    "a.csv.gz": survey_files.read_lines,
    "lines.csv.gz": lambda path: survey_lines.read_lines(str(path)),
    "a.gfc.gz": read_model,
}


@pytest.mark.parametrize("name", TEXTS)
@pytest.mark.parametrize(
    ("place", "value"), [(2, 99), (3, 0xFF), (20, 0xFF), (-8, 0xFF), (-1, 0x7F), (None, 0)]
)
def test_damaged_fields_of_a_gzip_are_sentences(name, place, value, tmp_path):
    """Method, flags, data, checksum, size, and a file that is cut."""
    content = bytearray(gzip.compress(bytes(range(200)) * 50))
    if place is None:
        del content[-20:]
    else:
        content[place] = value
    (tmp_path / name).write_bytes(content)
    with pytest.raises(GGBenchError, match="cannot be unpacked: "):
        TEXTS[name](tmp_path / name)


def tarred(content: bytes, **fields: object) -> bytes:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as archive:
        member = tarfile.TarInfo("a.gfc")
        member.size = len(content)
        for field, value in fields.items():
            setattr(member, field, value)
        archive.addfile(member, io.BytesIO(content))
    return packed.getvalue()


SPARSE = {"GNU.sparse.major": "1", "GNU.sparse.minor": "0", "GNU.sparse.realsize": str(10**13)}


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda text: tarred(text)[:700], "cannot be unpacked"),
        (lambda text: tarred(text)[:130] + b"x" + tarred(text)[131:], "cannot be unpacked"),
        (lambda text: tarred(text, type=tarfile.LNKTYPE), "archive of 0 files"),
        (lambda text: tarred(text, pax_headers={"size": "-1"}), "cannot be unpacked"),
        (lambda text: tarred(text, pax_headers={"size": "nine"}), "no line 'end_of_head'"),
        (
            lambda text: tarred(b"0\n".ljust(512, b"\0") + text, pax_headers=SPARSE),
            "unpacks to more than",
        ),
    ],
    ids=["cut", "checksum", "link", "size below 0", "size no number", "sparse file of 10 TB"],
)
def test_damaged_fields_of_a_tar_are_sentences(damage, reason, tmp_path):
    """Control: the whole archive is read."""
    text = coefficients(tmp_path)
    (tmp_path / "a.tar").write_bytes(tarred(text))
    read_model(tmp_path / "a.tar")
    (tmp_path / "a.tar").write_bytes(damage(text))
    with pytest.raises(GGBenchError, match=reason):
        read_model(tmp_path / "a.tar")


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_methods_without_a_limit_of_memory_are_refused(method, tmp_path):
    """A file that states 100 bytes and unpacks to 2 MB; control: deflate is taken."""
    content = bytearray(zipped("a.gfc", bytes(2_000_000), method))
    struct.pack_into("<L", content, content.index(b"PK\x01\x02") + 24, 100)
    (tmp_path / "a.gfc.zip").write_bytes(content)
    with pytest.raises(GGBenchError, match=rf"method is {method}; only 8 \(deflate\) and 0 \(un"):
        read_model(tmp_path / "a.gfc.zip")
    (tmp_path / "a.gfc.zip").write_bytes(zipped("a.gfc", coefficients(tmp_path)))
    read_model(tmp_path / "a.gfc.zip")


def npy(header: str, data: bytes = b"", version: bytes = b"\x01\x00") -> bytes:
    head = header.encode().ljust(117) + b"\n"
    return b"\x93NUMPY" + version + struct.pack("<H", len(head)) + head + data


def header(descr: str, shape: str) -> str:
    return f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}"


def z(member: bytes) -> bytes:
    return zipped("z.npy", member)


def test_an_array_is_read_by_its_header():
    found = archives.read_arrays(z(npy(header("<f8", "(2,)"), bytes(16))), Refused, "It")
    assert found["z"].tolist() == [0.0, 0.0]


NO_ARRAYS = "It cannot be unpacked: "
BAD_ARRAYS = {
    "a huge array": (z(npy(header("<f8", "(2, 10000000000000)"), bytes(16))), NO_ARRAYS),
    "a negative size": (z(npy(header("<f8", "(-3,)"), bytes(16))), NO_ARRAYS),
    "an array that is cut": (z(npy(header("<f8", "(4,)"), bytes(16))), NO_ARRAYS),
    "an array of objects": (z(npy(header("|O", "(1,)"), bytes(16))), NO_ARRAYS),
    "an unknown type": (z(npy(header("<f99", "(1,)"), bytes(16))), NO_ARRAYS),
    "a header of 90 brackets": (z(npy("{'descr': " + "(" * 90)), NO_ARRAYS),
    "an unknown version": (z(npy("{}", version=b"\x09\x00")), NO_ARRAYS),
    "a header that is cut": (z(npy("{'descr': '<f8'}")[:9]), NO_ARRAYS),
    "text for an array": (z(b"text"), NO_ARRAYS),
    "an array too few": (npz(a=1.0), "It lacks the array b; it holds a", ["a", "b"]),
    "a text file": (zipped("readme.txt", b"text"), r"readme\.txt is no array"),
    "a folder": (Path(__file__).parent, "It cannot be unpacked: .*directory"),
}
"""Archives, messages, and the names of arrays that are needed."""


@pytest.mark.parametrize("kind", BAD_ARRAYS)
def test_bad_arrays_are_refused_in_one_sentence(kind):
    content, message, *names = BAD_ARRAYS[kind]
    with refused(Refused, message):
        archives.read_arrays(content, Refused, "It", *names)
