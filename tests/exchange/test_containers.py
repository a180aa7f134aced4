"""Arrays and texts survive every format; damaged files are refused in a sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

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


def test_other_suffixes_and_missing_files_are_refused(tmp_path):
    with pytest.raises(GGBenchError, match=r"must end with \.nc, \.mat, \.txt"):
        containers.write(tmp_path / "file.csv", CONTENT, {})
    with pytest.raises(GGBenchError, match=r"cannot read .*file\.nc"):
        containers.read(tmp_path / "file.nc")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("hello\n", r"must be 'text NAME' or 'array NAME"),
        ("array a 1 3\n1 2\n", r"a ends after 2 of 3 numbers"),
        ("array a 1 2\n1 2 3\n", r"a has more numbers than its shape, 2"),
        ("array a 2 2\n1 2\n", r"the shape of a is damaged"),
        ("array a 1 1\nx\n", r"a contains 'x', which is not a number"),
        ("array a 1 99999999999\n1\n", r"the shape of a is damaged"),
        ("text 9a\nx\n", r"'9a' is not a valid name of an array"),
    ],
)
def test_damaged_text_is_named(text, sentence, tmp_path):
    (tmp_path / "file.txt").write_text(text)
    with pytest.raises(GGBenchError, match=sentence):
        containers.read(tmp_path / "file.txt")


def test_complex_numbers_are_refused(tmp_path):
    containers.write(tmp_path / "file.mat", {"z": np.array([1j])}, {})
    with pytest.raises(GGBenchError, match="z contains complex numbers, not real numbers"):
        containers.read(tmp_path / "file.mat")


def test_a_file_of_matlab_7_3_is_named(tmp_path):
    path = tmp_path / "estimates.mat"
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    path.write_bytes(head.ljust(512, b"\0") + b"\x89HDF\r\n\x1a\n".ljust(512, b"\0"))
    with pytest.raises(GGBenchError, match=r"MATLAB 7\.3: save it with the option '-v7'"):
        containers.read(path)
