"""Programs in other languages are estimators like any other, and fail like any other."""

from __future__ import annotations

import shutil
import stat
import subprocess
from pathlib import Path

import numpy as np
import pytest
from command import invoke
from problems import SMALL
from thinning import thinned

import ggbench as gg

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
NAMES = ["settled_position_ms", "settled_velocity_ms", "whole_nees"]


def program(folder: Path, text: str) -> str:
    """Write an executable shell script and return the text that names it."""
    path = folder / "filter.sh"
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return f"exec:{path}"


@pytest.fixture
def small(tmp_path) -> Path:
    (tmp_path / "small.toml").write_text(SMALL)
    return tmp_path


def flown(folder: Path, *labels: str, **options: object) -> gg.Results:
    return gg.run(
        folder / "small.toml", labels, 2, cases=["base"], output=folder / "out", **options
    )


def reason_of(folder: Path, text: str, **options: object) -> str:
    return flown(folder, program(folder, text), "ins", **options).failures()["reason"].iloc[0]


@thinned(
    ("text", "sentence"),
    [
        ("echo no licence >&2; exit 3", "ended with exit code 3: no licence"),
        ("kill -SEGV $$", "ended with signal 11"),
        ("exit 0", "ended without writing the file of estimates"),
        ("echo nonsense > $2", "estimates.mat is damaged"),
        ("cp $1 $2", "contains channels, which is not allowed in estimates"),
    ],
)
def test_a_program_that_fails_is_a_record_with_its_reason(text, sentence, small):
    assert sentence in reason_of(small, text, jobs=0)


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("sleep 60 & sleep 60", "time limit"),
        ("yes | head -c 200000000; exit 1", "ended with exit code 1: y"),
        ("for i in 1 2 3 4 5 6 7 8; do sleep 60 & done; exit 2", "ended with exit code 2"),
    ],
)
def test_a_program_that_hangs_floods_or_forks_costs_its_own_runs(text, sentence, small):
    reason = reason_of(small, text, jobs=1, time_limit=10.0)
    assert sentence in reason and len(reason) < 5000


@pytest.mark.parametrize(
    ("label", "sentence"),
    [
        ("exec:./nobody", "program nobody not found"),
        ("exec:small.toml", "cannot be executed; set its x bit"),
    ],
)
def test_a_program_that_cannot_be_started_is_named(label, sentence, small):
    done = invoke(["run", "small.toml", "-n", "1", "-e", label], small)
    assert done.returncode == 2 and sentence in done.stderr


def as_ekf(folder: Path, label: str) -> None:
    """Assert that a program's runs are those of ``ekf`` to 1e-8 m, and that it keeps the contract.

    Squares of errors are compared, so that 1e-8 is relative.
    """
    table = flown(folder, label, "ekf", jobs=0).runs()
    assert (table["status"] == "ok").all()
    own, ekf = (table[table["estimator"] == name][NAMES] for name in (label, "ekf"))
    np.testing.assert_allclose(own, ekf, rtol=1e-8)
    done = invoke(["check", label], folder)
    assert done.returncode == 0 and "9 of 9 checks passed" in done.stdout


@pytest.mark.long
@pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler")
def test_the_cpp_example_is_the_ekf(small):
    command = ["g++", "-std=c++17", "-O2", "-Wall", "-Wextra", "-Werror", "-o", small / "ekf"]
    subprocess.run([*command, EXAMPLES / "cpp" / "ekf.cpp"], check=True)
    as_ekf(small, f"exec:{small / 'ekf'}[format=txt]")


@pytest.mark.long
@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="no Octave")
def test_the_octave_example_is_the_ekf(small):
    as_ekf(small, f"exec:{EXAMPLES / 'octave' / 'ekf.sh'}")
