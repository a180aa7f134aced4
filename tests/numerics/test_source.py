"""Maps and compiled code are known by the source that made them."""

from __future__ import annotations

import ast
import importlib
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from test_rooms import imported, room_of

import ggbench
from ggbench.numerics import source
from ggbench.numerics.source import COMPILED_ROOMS, MAP_ROOMS, module_hash, rooms_hash

PACKAGE = Path(ggbench.__file__).parent
NUMBERS = int | float | complex | tuple | list | dict | np.ndarray


@pytest.fixture
def copy(tmp_path, monkeypatch) -> Path:
    """The package's source elsewhere, which is hashed there, anew each time."""
    folder = tmp_path / "ggbench"
    shutil.copytree(PACKAGE, folder, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(source, "PACKAGE", folder)
    return folder


def hash_of(*rooms: str) -> str:
    return rooms_hash.__wrapped__(*rooms)


def changes(copy: Path, *rooms: str) -> set[str]:
    """Modules of which a change changes the hash."""
    before, found = hash_of(*rooms), set()
    for file in sorted(copy.rglob("*.py")):
        text = file.read_bytes()
        file.write_bytes(text + b"another = 1\n")
        if hash_of(*rooms) != before:
            found.add(file.relative_to(copy).as_posix())
        file.write_bytes(text)
    assert hash_of(*rooms) == before
    return found


def modules(*rooms: str) -> set[str]:
    """Modules of rooms, of all if none is named."""
    files = {path.relative_to(PACKAGE) for path in PACKAGE.rglob("*.py")}
    return {file.as_posix() for file in files if not rooms or file.parts[0] in rooms}


@pytest.mark.long
@pytest.mark.parametrize("rooms", [COMPILED_ROOMS, MAP_ROOMS])
def test_every_module_of_a_room_counts(copy, rooms):
    assert changes(copy, *rooms) == modules(*rooms)


def test_compiled_code_is_in_rooms_that_are_hashed():
    """No module elsewhere is compiled, or holds a number that compiled code could take from it."""
    compiles = re.compile(r"^@(njit|compiled|inlined|copied|interpreted)|numba\.njit", re.MULTILINE)
    found = {
        name.split("/")[0] for name in modules() if compiles.search((PACKAGE / name).read_text())
    }
    assert found == set(COMPILED_ROOMS)


def as_python_reads(file: Path, place: Path | None = None) -> set[Path]:
    """What a module imports from the package, as Python reads it; ``place``: where it stands."""
    found = set()
    place = place or file
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            assert not any(name.name.startswith("ggbench") for name in node.names), file
        elif isinstance(node, ast.ImportFrom):
            assert node.level or not (node.module or "").startswith("ggbench"), file
            base = place.parents[node.level - 1].joinpath(*(node.module or "").split("."))
            for name in node.names if node.level else ():
                places = base / f"{name.name}.py", base / name.name / "__init__.py"
                places += base.with_suffix(".py"), base / "__init__.py"
                here = [path for path in places if path.is_file()]
                assert here or place != file, (file, name.name)
                found.update(here[:1])
    return found


def known_to(module: str) -> set[str]:
    """Modules of the package that a module is made with: what it imports, and what they do."""
    found: set[Path] = set()
    ahead = {PACKAGE / module}
    while ahead:
        found |= ahead
        ahead = set().union(*map(as_python_reads, ahead)) - found
    return {file.relative_to(PACKAGE).as_posix() for file in found}


def test_a_map_is_known_by_every_room_that_its_making_imports():
    """Held against the imports: a room that is left out of the hash would leave stale maps."""
    made_with = known_to("maps/recipe.py")
    assert {"gravity/ellipsoid.py", "gravity/parker.py", "numerics/source.py"} <= made_with
    rooms = {Path(file).parts[0] for file in made_with}
    # They refuse files or give their bytes, and change no number.
    reading = {"errors.py", "files"}
    assert rooms - reading == set(MAP_ROOMS)


def test_compiled_code_takes_its_numbers_from_rooms_that_are_hashed():
    """What compiled rooms import from elsewhere is nothing that is compiled into them."""
    taken = {
        (file, name)
        for file in modules(*COMPILED_ROOMS)
        for _, name in imported(PACKAGE / file, Path(file).parent.parts)
        if room_of(name) not in COMPILED_ROOMS
    }
    assert any(room_of(name) == "problem" for _, name in taken)
    for file, name in taken:
        module, _, thing = name.rpartition(".")
        loaded = importlib.import_module(f"ggbench.{module}".rstrip("."))
        assert not isinstance(getattr(loaded, thing), NUMBERS), (file, name)


def test_a_new_module_counts_and_a_renamed_one(copy):
    """Within rooms that are hashed."""
    before = hash_of(*MAP_ROOMS)
    (copy / "maps" / "new.py").write_text("")
    added = hash_of(*MAP_ROOMS)
    (copy / "maps" / "new.py").rename(copy / "maps" / "other.py")
    renamed = hash_of(*MAP_ROOMS)
    (copy / "maps" / "other.py").rename(copy / "judging" / "other.py")
    assert len({before, added, renamed}) == 3
    assert hash_of(*MAP_ROOMS) == before


@pytest.mark.long
def test_what_a_module_imports_is_found(copy):
    """As Python finds it: in a function, of many lines, under another name, beside a comment."""
    files = [PACKAGE / name for name in modules()]
    assert {file: set(source.directly_imported(file)) for file in files} == {
        file: as_python_reads(file) for file in files
    }
    odd = copy / "ins" / "odd.py"
    odd.write_text(
        "def f():\n    from ..gravity import (  # noqa: it (comes) late\n"
        "        ellipsoid as e,\n        field,\n    )\n"
        "from .. import a_name_of_the_package_itself\n"
    )
    assert copy / "__init__.py" in source.directly_imported(odd)
    assert set(source.directly_imported(odd)) == as_python_reads(odd) != set()


def test_compiled_code_is_known_by_all_that_it_is_made_of(copy, monkeypatch):
    """Whatever a module imports, directly or not, changes its hash, and nothing else does."""
    monkeypatch.setattr(source, "VECTORS", copy / "numerics" / "vectors.py")
    file = copy / "ins" / "strapdown.py"
    before, found = module_hash(file), set()
    for other in sorted(copy.rglob("*.py")):
        text = other.read_bytes()
        other.write_bytes(text + b"another = 1\n")
        if module_hash(file) != before:
            found.add(other.relative_to(copy).as_posix())
        other.write_bytes(text)
    assert {"ins/strapdown.py", "gravity/ellipsoid.py", "numerics/vectors.py"} <= found
    assert not {name.split("/")[0] for name in found} & {"sensors", "engines", "campaign"}
    # A formula may be compiled for vectors without its module knowing them.
    alone = copy / "ins" / "alone.py"
    alone.write_text("one = 1.0\n")
    before, vectors = module_hash(alone), copy / "numerics" / "vectors.py"
    vectors.write_bytes(vectors.read_bytes() + b"another = 1\n")
    assert module_hash(alone) != before


def test_a_users_own_code_is_known_by_itself_and_by_all_that_is_compiled_here(copy, monkeypatch):
    monkeypatch.setattr(source, "rooms_hash", hash_of)  # the source changes under this process
    mine, theirs = copy.parent / "mine.py", copy / "gravity" / "ellipsoid.py"
    mine.write_text("one = 1\n")
    hashes = {module_hash(mine)}
    mine.write_text("one = 2\n")
    hashes.add(module_hash(mine))
    theirs.write_bytes(theirs.read_bytes() + b"another = 1\n")
    hashes.add(module_hash(mine))
    assert len(hashes) == 3
