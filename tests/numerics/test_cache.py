"""Compiled code belongs to one source: a changed formula is never served from an old cache."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import ggbench
from ggbench.numerics import cache

PACKAGE = Path(ggbench.__file__).parent
SCRIPT = """
import numpy as np
from ggbench.gravity import ellipsoid
from ggbench.ins import strapdown
print(repr(float(ellipsoid.radii_of_curvature(0.5)[0])))
after, velocity = np.empty(3), np.array([0.0, 1.0, 0.0])
strapdown.advance_position(np.array([0.5, 0.0, 0.0]), velocity, velocity, 1.0, after)
print(repr(1.0 / float(after[0] - 0.5)))
"""


def run(folder: Path, kept: Path) -> list[float]:
    """What two functions give, of which the second one inlines the first, from another file."""
    environment = os.environ | {"PYTHONPATH": str(folder), "GGBENCH_CACHE_DIR": str(kept)}
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-P", "-c", SCRIPT],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return [float(line) for line in done.stdout.splitlines()]


@pytest.mark.long
def test_a_changed_formula_is_compiled_anew(tmp_path):
    """A formula of one module that is compiled into another one's code changes both."""
    copy = tmp_path / "source" / "ggbench"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"), symlinks=False)
    kept = tmp_path / "cache"
    before = run(copy.parent, kept)
    assert run(copy.parent, kept) == before
    ellipsoid = copy / "gravity" / "ellipsoid.py"
    text = ellipsoid.read_text()
    assert "SEMI_MAJOR_AXIS = 6378137.0" in text
    ellipsoid.write_text(
        text.replace("SEMI_MAJOR_AXIS = 6378137.0", "SEMI_MAJOR_AXIS = 2 * 6378137.0")
    )
    after = run(copy.parent, kept)
    assert [round(new / old, 6) for new, old in zip(after, before, strict=True)] == [2.0, 2.0]
    folders = [path.name for path in (kept / "numba").iterdir()]
    assert sum(name.startswith("ggbench.gravity.ellipsoid-") for name in folders) == 2
    assert sum(name.startswith("ggbench.numerics.rotations-") for name in folders) <= 1


def test_folders_of_others_are_left_alone(tmp_path):
    """Only compiled code of a module's former sources is removed, whatever else lies beside it."""
    others = [f"ggbench-results{i}" for i in range(9)] + ["ggbench-numba"]
    others += [f"ggbench.ins.imu-{i:016x}" for i in range(9)]
    former = [f"ggbench.ins-{i:016x}" for i in range(9)]
    for name in [*others, *former]:
        (tmp_path / name).mkdir()
    cache.make_code_folder(tmp_path / f"ggbench.ins-{10:016x}")
    left = {path.name for path in tmp_path.iterdir()}
    assert set(others) <= left
    assert 1 <= len(left & set(former)) < len(former)


def test_the_newest_folders_of_a_module_are_kept(tmp_path):
    """Who goes back to the source of yesterday finds its code; that of last year makes room."""
    former = [tmp_path / f"ggbench.ins-{i:016x}" for i in range(9)]
    for age, folder in enumerate(former):
        folder.mkdir()
        os.utime(folder, (1e9 - age, 1e9 - age))
    cache.make_code_folder(tmp_path / f"ggbench.ins-{10:016x}")
    assert [folder for folder in former if folder.exists()] == former[: cache.MOST_KEPT - 1]
