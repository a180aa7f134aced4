"""Every process runs the same machine code: of one source, compiled once, of nobody else."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = (
    """
import math
from ggbench.numerics.kernels import compiled

@compiled
def long(x):
    y = {factor} * x
"""
    + "    y += math.sin(y) + x\n" * 40
    + """
    return y

@compiled
def calling(x):
    return long(x) + long(x + 1.0) + long(x + 2.0)

@compiled
def with_constants():
    return long(1) + long(2)

@compiled
def turning(x, again):
    return x if again == 0 else 1.0 * turning(0.5 * x, again - 1)
"""
)
"""A function too long to become part of the one that calls it."""
COUNTED = """
import sys
sys.path.insert(0, {folder!r})
from numba.core import event
compiled = []
class Listener(event.Listener):
    def on_start(self, event):
        compiled.append(event.data["dispatcher"].py_func.__name__)
    def on_end(self, event):
        pass
event.register("numba:compile", Listener())
import functions
{calls}
print(*compiled)
"""


class Place:
    """A folder with a module of kernels, and a cache of its own."""

    def __init__(self, folder: Path, factor: float) -> None:
        self.folder, self.cache = folder, folder / "cache"
        folder.mkdir()
        (folder / "functions.py").write_text(SOURCE.format(factor=factor))

    def start(self, *calls: str) -> subprocess.Popen:
        """Start a process that prints what calls give, then the names of what it compiled."""
        environment = os.environ | {"GGBENCH_CACHE_DIR": str(self.cache)}
        environment.pop("NUMBA_CACHE_DIR", None)
        calls = "\n".join(f"print(repr(functions.{call}))" for call in calls)
        return subprocess.Popen(
            [sys.executable, "-P", "-c", COUNTED.format(folder=str(self.folder), calls=calls)],
            env=environment, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    def run(self, *calls: str) -> list[str]:
        return printed(self.start(*calls))

    def compiled_from(self) -> Path:
        """The folder of what is compiled from the module."""
        (folder,) = (self.cache / "numba").glob("ggbench.user.functions-*")
        return folder


def printed(process: subprocess.Popen) -> list[str]:
    output, _ = process.communicate()
    assert process.returncode == 0
    return output.splitlines()


@pytest.mark.long
def test_a_function_is_compiled_by_one_process(tmp_path):
    """Three processes at a time: each function is compiled once for each type, none is mistaken."""
    place = Place(tmp_path / "here", 1.0)
    calls = (["calling(1.0)"], ["calling(1.0)"], ["long(3)", "long(1.0)"])
    outputs = [printed(process) for process in [place.start(*call) for call in calls]]
    names = " ".join(output[-1] for output in outputs).split()
    assert sorted(names) == ["calling", "long", "long"]
    again = place.run("calling(1.0)", "long(3)", "long(1.0)")
    assert again == [outputs[0][0], *outputs[2][:2], ""]
    assert outputs[1][0] == outputs[0][0]


def test_nothing_is_compiled_for_a_constant(tmp_path):
    """Two constants of a type are two numbers of it."""
    place = Place(tmp_path / "here", 1.0)
    assert sorted(place.run("with_constants()")[-1].split()) == ["long", "with_constants"]


def test_a_function_may_need_itself_for_other_arguments(tmp_path):
    """It is locked once by its process, which does not wait for itself."""
    place = Place(tmp_path / "here", 1.0)
    assert place.run("turning(8, 2)") == ["2.0", "turning turning"]


@pytest.mark.long
def test_code_is_not_exchanged_for_another_processes(tmp_path):
    """A function keeps the code of those that it calls, whatever else is loaded before.

    What stands for code that was optimised in another context is code of another formula.
    """
    here, there = Place(tmp_path / "here", 1.0), Place(tmp_path / "there", 2.0)
    first, right, _ = here.run("long(1.0)", "calling(1.0)")
    other, _ = there.run("long(1.0)")
    for file in there.compiled_from().glob("functions.long-*.nbc"):
        shutil.copy(file, here.compiled_from())
    assert here.run("long(1.0)", "calling(1.0)") == [other, right, ""]
    assert other != first


@pytest.mark.long
def test_damaged_code_is_compiled_anew(tmp_path):
    place = Place(tmp_path / "here", 1.0)
    right, _ = place.run("calling(1.0)")
    for file in place.compiled_from().glob("functions.calling-*.nb[ic]"):
        file.write_bytes(file.read_bytes()[:100])
    assert place.run("calling(1.0)") == [right, "calling"]


@pytest.mark.long
def test_without_a_folder_it_is_compiled_each_time(tmp_path):
    place = Place(tmp_path / "here", 1.0)
    place.cache.write_text("no folder")
    first = place.run("calling(1.0)")
    assert place.run("calling(1.0)") == first
    assert first[1] == "calling long"
