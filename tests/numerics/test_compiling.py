"""Compiled code on disk: made once, found by its source, with the same bits in every process."""

from __future__ import annotations

import ast
import gc
import linecache
import os
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numba.core.errors import TypingError
from packaging.requirements import Requirement

import ggbench
import ggbench.estimators
from ggbench.numerics.kernels import compiled

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
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )

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
    """Three processes at a time: once for each type and use; none is mistaken for another."""
    place = Place(tmp_path / "here", 1.0)
    calls = (["calling(1.0)"], ["calling(1.0)"], ["long(3)", "long(1.0)"])
    outputs = [printed(process) for process in [place.start(*call) for call in calls]]
    names = " ".join(output[-1] for output in outputs).split()
    assert sorted(names) == ["calling", "long", "long", "long"]
    again = place.run("calling(1.0)", "long(3)", "long(1.0)")
    assert again == [outputs[0][0], *outputs[2][:2], ""]
    assert outputs[1][0] == outputs[0][0]


@compiled
def square(x: float) -> float:
    return x * x


@compiled
def fourth(x: float) -> float:
    return square(square(x))


def test_code_that_kernels_call_has_no_entry_for_python():
    """Python's call compiles another code, with the same result."""
    assert fourth(3.0) == 81.0
    called = len(square.signatures)  # none if the code of the other was found on disk
    assert square(3.0) == 9.0
    assert len(square.signatures) == called + 1
    assert square(4.0) == 16.0
    assert len(square.signatures) == called + 1


@pytest.mark.parametrize("collecting", [True, False])
def test_garbage_is_collected_again_after_the_compiler(collecting):
    """Also after an error; and not where it was not before."""

    @compiled
    def wrong(x: float) -> float:
        return x.nothing

    before = gc.isenabled()
    (gc.enable if collecting else gc.disable)()
    try:
        with pytest.raises(TypingError, match="nothing"):
            wrong(1.0)
        assert gc.isenabled() == collecting
    finally:
        (gc.enable if before else gc.disable)()


@pytest.mark.long
def test_nothing_is_compiled_for_a_constant(tmp_path):
    """Two constants of a type are two numbers of it."""
    place = Place(tmp_path / "here", 1.0)
    assert sorted(place.run("with_constants()")[-1].split()) == ["long", "with_constants"]


@pytest.mark.long
def test_a_function_may_need_itself_for_other_arguments(tmp_path):
    """It is locked once by its process, which does not wait for itself."""
    place = Place(tmp_path / "here", 1.0)
    assert place.run("turning(8, 2)") == ["2.0", "turning turning"]


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


IN_ORDER = """
import hashlib, sys
from ggbench.campaign.registry import choose
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.runs import simulate_block
from ggbench.spec import scenario

flight = prepare(scenario.load("wang2013").case("0.01E-1Hz"))
block, _ = simulate_block(flight, 1, range(9))
found = {"simulation": block.measurements}
for label in sys.argv[1:]:
    found[label] = choose(label).estimator.estimate_block(block).mean
again, _ = simulate_block(flight, 1, range(9))
assert (again.measurements == block.measurements).all()
for label in sorted(found):
    print(label, hashlib.sha256(found[label].tobytes()).hexdigest())
"""


@pytest.mark.long
def test_bits_do_not_depend_on_the_order_of_calls():
    """Each library has its own copy of a function; which copy a process links does not matter."""
    labels = ["ekf", "ukf", "ekf[iterations=5]"]
    processes = [
        subprocess.Popen(
            [sys.executable, "-P", "-c", IN_ORDER, *order], stdout=subprocess.PIPE, text=True
        )
        for order in (labels, labels[::-1], labels[1:] + labels[:1])
    ]
    first, *others = [printed(process) for process in processes]
    assert len(first) == 4
    assert others == [first, first]


CELL = """
import numpy as np
from ggbench.numerics.kernels import compiled
from ggbench.numerics.records import record

@record
class Line:
    slope: float
    offsets: np.ndarray

@compiled
def height(line, x):
    return line.slope * x + line.offsets[0]

@compiled
def total(line, x):
    return height(line, x) + height(line, 2.0 * x)
"""


@pytest.mark.parametrize("name", ["<string>", "<ipython-input-1-0a1b>", "/none/ipykernel_1/2.py"])
def test_a_notebook_may_define_kernels_and_records(name, monkeypatch):
    """A cell has no file: its lines are in linecache. Of exec not even these are anywhere."""
    monkeypatch.setitem(sys.modules, "cell", ModuleType("cell"))
    for slope in ("line.slope * x", "3.0 * line.slope * x"):  # the cell is changed, and run again
        source = CELL.replace("line.slope * x", slope)
        if name != "<string>":
            lines = source.splitlines(keepends=True)
            monkeypatch.setitem(linecache.cache, name, (len(source), None, lines, name))
        cell = {"__name__": "cell"}
        exec(compile(source, name, "exec"), cell)
        line = cell["Line"](2.0, np.ones(1))
        factor = 3.0 if "3.0" in slope else 1.0
        assert cell["total"](line, 5.0) == 2.0 + factor * 30.0


def test_the_installed_numba_is_one_that_was_tested():
    """Code is kept on disk by a class of numba that may change with any of its releases."""
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    texts = project["dependencies"]
    (limits,) = (Requirement(text).specifier for text in texts if text.startswith("numba"))
    assert any(limit.operator == "<" for limit in limits), "numba needs an upper limit"
    assert limits.contains(version("numba"), prereleases=True), (
        f"numba {version('numba')} is installed, and ggbench was tested with numba{limits}: "
        "run tests/numerics with it, then change the limit in pyproject.toml"
    )


def private_names(text: str) -> list[str]:
    """Underscore names of numba and llvmlite, and settings that let the compiler round anew."""
    found, bound = [], set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            module = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for alias in node.names:
                path = ".".join([*module, alias.name]).split(".")
                if path[0] in ("numba", "llvmlite") and not getattr(node, "level", 0):
                    bound.add(alias.asname or (path[-1] if module else path[0]))
                    found += [part for part in path if part.startswith("_")]
        elif isinstance(node, ast.keyword) and node.arg in ("fastmath", "flags"):
            found.append(node.arg)
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Attribute) and node.attr.startswith("_"):
            root = node.value
            while isinstance(root, ast.Attribute):
                root = root.value
            if isinstance(root, ast.Name) and root.id in bound:
                found.append(node.attr)
    return found


def test_no_private_name_of_the_compiler_is_used():
    """Nor a setting with which bits would depend on where the compiler inlines a function."""
    folders = Path(ggbench.__file__).parent, Path(ggbench.estimators.__path__[0])
    found = {}
    for file in (file for folder in folders for file in folder.rglob("*.py")):
        text = file.read_text()
        if any(word in text for word in ("numba", "llvmlite", "flags")):
            found[file.name] = private_names(text)
    assert len(found) > 10
    assert not any(found.values()), found


@pytest.mark.parametrize(
    "text",
    [
        "from numba.core.caching import _CacheLocator",
        "import numba._devicearray",
        "def f():\n    from numba.core import caching as c\n    class A(c._Cache): ...",
        "import numba.core.caching\nnumba.core.caching.Cache._impl_class = 1",
        "from llvmlite import ir\nir._utils",
        "njit(fastmath=True)",
        "builder.fadd(a, b, flags=('contract',))",
    ],
)
def test_a_private_name_would_be_found(text):
    assert len(private_names(text)) == 1
    assert private_names("from numba import njit\nfrom ._numba import _own\nself._line") == []
