"""Terminals that lack characters: each command ends as elsewhere, with others in their place."""

from __future__ import annotations

import os
import subprocess

import pytest
from campaigns import COMMAND
from click.testing import CliRunner
from thinning import thinned

from ggbench.cli.main import main

WORDS = [
    ["keys", "gradiometer"],
    ["keys", "imu"],
    ["list"],
    ["new", "estimator", "µ∞"],
    ["validate", "gone_∞.toml"],
    ["map", "show", "∞.nc"],
    ["map", "build", "--help"],
    ["∞"],
]


@pytest.mark.long
@pytest.mark.parametrize("encoding", ["latin-1", "cp1252"])
@pytest.mark.parametrize("words", WORDS, ids=" ".join)
def test_what_an_encoding_lacks_is_replaced(words, encoding, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    whole = CliRunner().invoke(main, words)
    done = CliRunner(charset=encoding).invoke(main, words)
    assert isinstance(done.exception, SystemExit | None), repr(done.exception)
    assert done.exit_code == whole.exit_code
    if words != ["list"]:  # the frames of its tables are drawn with other characters
        assert done.output == whole.output.encode(encoding, "replace").decode(encoding)


@pytest.mark.long
@thinned("encoding", ["cp1252", "latin-1"])
def test_a_process_prints_without_a_traceback(encoding):
    """The square root in the unit of a noise is none of their characters."""
    done = subprocess.run(
        [COMMAND, "keys", "gradiometer"],
        capture_output=True,
        check=False,
        env=os.environ | {"PYTHONIOENCODING": encoding},
    )
    assert done.returncode == 0 and not done.stderr
    assert b"E/?Hz" in done.stdout
