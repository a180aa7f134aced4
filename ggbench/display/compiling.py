"""Messages about compilation and map building at first use."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..errors import GGBenchError
from ..figures.numbers import counted
from ..numerics.cache import cache_folder, code_folder
from ..numerics.source import PACKAGE

if TYPE_CHECKING:
    from ..spec.case import CaseSpec
    from ..spec.sensors import FieldSpec

_LOOK_EVERY_S = 1.0
_LATELY_S = 30.0
"""Time [s] after the latest compilation for which the number of functions is shown."""


def tell_first_use(module: str, scope: str) -> bool:
    """Print a message if code must be compiled; return whether one was printed.

    Parameters
    ----------
    module : path in the package of a module that the command compiles early. If the cache has no
        folder for this module, code must be compiled.
    scope : expected duration in words, for the message.
    """
    sentences = first_use(module, scope)
    _echo(sentences)
    return bool(sentences)


def first_use(module: str, scope: str) -> list[str]:
    """Return a list with a message if code must be compiled; else return an empty list.

    The parameters are those of :func:`tell_first_use`.
    """
    if code_folder(PACKAGE / module).exists():
        return []
    return [
        f"First use of this version: the code is compiled for this processor, {scope}, and "
        f"stored in {cache_folder()}."
    ]


def fields_of(cases: Iterable[CaseSpec]) -> Iterator[FieldSpec]:
    """Yield the field specs of truth and model for each case."""
    for case in cases:
        yield from (case.side("truth").field, case.side("model").field)


def tell_maps(fields: Iterable[FieldSpec]) -> None:
    """Print a message for each map that must be built because it is not in the cache."""
    _echo(maps_to_build(fields))


def _echo(sentences: Iterable[str]) -> None:
    for sentence in sentences:
        click.echo(sentence)


def maps_to_build(fields: Iterable[FieldSpec]) -> Iterator[str]:
    """Yield a message for each map that must be built because it is not in the cache."""
    from ..maps import recipe
    from ..simulation.field_source import is_file, map_recipe

    recipes = dict.fromkeys(
        map_recipe(field)
        for field in fields
        if field.source != "normal" and not is_file(field.source)
    )
    for each in recipes:
        try:
            each = recipe.checked(each)
        except GGBenchError:  # which is reported where its case is flown
            continue
        if not recipe.cached_path(each).exists():
            yield (
                f"Building a map of {each.source}, {each.south_deg:g}° to "
                f"{each.north_deg:g}° N, {each.west_deg:g}° to {each.east_deg:g}° E. "
                f"It is stored for later runs in {cache_folder()}."
            )


class Compiled:
    """Counter of the functions that this process and its workers have compiled."""

    def __init__(self) -> None:
        self._base = code_folder(PACKAGE / "numerics" / "lanes.py").parent
        self._seen: dict[Path, tuple[int, set[str]]] = {}
        self._count, self._last = 0, ""
        self._looked = self._grew = 0.0
        self._look()
        self._count = 0

    def text(self) -> str:
        """Return the number of compiled functions as text.

        If no further function was compiled in the last 30 s, the text is "".
        """
        now = time.monotonic()
        if now - self._looked > _LOOK_EVERY_S:
            before = self._count
            self._look()
            if self._count > before:
                self._grew = now
        if not self._count or now - self._grew > _LATELY_S:
            return ""
        return f"compiled {counted(self._count, 'function')}, the most recent in {self._last}"

    def _look(self) -> None:
        """Count new compiled functions; folders that have not changed are not read again."""
        self._looked = time.monotonic()
        try:
            folders = [(f, f.stat().st_mtime_ns) for f in self._base.iterdir()]
        except OSError:  # not there yet, or just tidied up
            return
        for folder, written in folders:
            before, files_before = self._seen.get(folder, (0, set()))
            if written == before:
                continue
            files = {file.name for file in folder.glob("*.nbc")}
            self._seen[folder] = written, files
            if files - files_before:
                self._count += len(files - files_before)
                self._last = folder.name.rpartition("-")[0].removeprefix("ggbench.")
