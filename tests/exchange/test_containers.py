"""Arrays and texts in files of every format, and messages of bad files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from ggbench.errors import GGBenchError
from ggbench.exchange import containers

CONTENT = {
    "numbers": np.arange(24.0).reshape(2, 3, 4) / 7.0,
    "one": np.array([0.1]),
    "none": np.zeros((0, 0, 0, 3)),
    "extremes": np.array([1e-300, -1e300, np.nan, np.inf]),
    "words": "two lines; the second\nhas 1 µrad",
}


@pytest.mark.parametrize("suffix", containers.SUFFIXES)
def test_arrays_and_texts_survive(suffix, tmp_path):
    """With the same bits; of MATLAB's arrays only axes of length one may differ."""
    path = tmp_path / f"file{suffix}"
    containers.write(path, CONTENT, {"numbers": "sevenths"})
    found = containers.read(path)
    assert set(found) == set(CONTENT)
    for name, value in CONTENT.items():
        if isinstance(value, str):
            assert found[name] == value
        else:
            np.testing.assert_array_equal(containers.shaped(found[name], value.shape), value)


@pytest.mark.parametrize("suffix", containers.SUFFIXES)
def test_mutated_files_give_a_sentence_or_arrays(suffix, tmp_path):
    """Of one byte each, at fixed random places; the long test has a thousand."""
    mutate(suffix, tmp_path, 30)


@pytest.mark.long
@pytest.mark.parametrize("suffix", [".mat", ".txt"])
def test_a_thousand_mutated_files_give_a_sentence_or_arrays(suffix, tmp_path):
    mutate(suffix, tmp_path, 1000)


def mutate(suffix: str, folder: Path, count: int) -> None:
    path = folder / f"file{suffix}"
    containers.write(path, CONTENT, {})
    whole, rng = path.read_bytes(), np.random.default_rng(5)
    refused = 0
    for _ in range(count):
        damaged = bytearray(whole)
        damaged[rng.integers(len(whole))] = rng.integers(256)
        path.write_bytes(damaged[: rng.integers(1, len(whole) + 1)])
        try:
            containers.read(path)
        except GGBenchError as error:
            assert len(str(error)) < 1000 and "\n" not in str(error)
            refused += 1
    assert refused


def complex_numbers(path: Path) -> None:
    containers.write(path, {"z": np.array([1j])}, {})


def matlab_7_3(path: Path) -> None:
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    path.write_bytes(head.ljust(512, b"\0") + b"\x89HDF\r\n\x1a\n".ljust(512, b"\0"))


SHAPE = r"the shape of a is damaged"
BAD = {
    "no file": ("file.nc", None, r"cannot read .*file\.nc"),
    "complex numbers": (
        "file.mat",
        complex_numbers,
        "z contains complex numbers, not real numbers",
    ),
    "MATLAB 7.3": ("estimates.mat", matlab_7_3, r"MATLAB 7\.3: save it with the option '-v7'"),
    "words": ("file.txt", "hello\n", "must be 'text NAME' or 'array NAME"),
    "a number too few": ("file.txt", "array a 1 3\n1 2\n", "a ends after 2 of 3 numbers"),
    "a number too many": (
        "file.txt",
        "array a 1 2\n1 2 3\n",
        "a has more numbers than its shape, 2",
    ),
    "a shape of two numbers": ("file.txt", "array a 2 2\n1 2\n", SHAPE),
    "a word for a number": (
        "file.txt",
        "array a 1 1\nx\n",
        "a contains 'x', which is not a number",
    ),
    "a huge shape": ("file.txt", "array a 1 99999999999\n1\n", SHAPE),
    "a name that begins with a digit": (
        "file.txt",
        "text 9a\nx\n",
        "'9a' is not a valid name of an array",
    ),
}
"""Names of files, their texts or makers, and messages."""


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_file_is_refused_in_one_sentence(kind, tmp_path):
    name, content, message = BAD[kind]
    if isinstance(content, str):
        (tmp_path / name).write_text(content)
    elif content:
        content(tmp_path / name)
    with refused(GGBenchError, message):
        containers.read(tmp_path / name)


def test_another_suffix_is_not_written(tmp_path):
    message = r"must end with \.nc, \.mat, \.txt"
    with refused(GGBenchError, message):
        containers.write(tmp_path / "file.csv", CONTENT, {})
