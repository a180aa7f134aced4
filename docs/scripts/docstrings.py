"""Conversion of the package's docstrings for Sphinx.

The docstrings follow numpydoc with one exception. The text after the colon describes a parameter in
words, because the signature contains the type. numpydoc and napoleon would treat the words as a
type.
"""

from __future__ import annotations

import pkgutil
import sys
from collections.abc import Iterator
from functools import cache, reduce
from typing import Any

from docutils.nodes import Element
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

import ggbench

_ENTRIES = ("Parameters", "Attributes")
_ERRORS = ("Raises", "Warns")
_TEXTS = ("Returns", "Yields")


def setup(app: Sphinx) -> None:
    """Connect the functions of this module to events of Sphinx."""
    app.connect("autodoc-process-docstring", _process)
    app.connect("missing-reference", _known)


def _process(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    lines[:] = in_sphinx_words(lines)


def in_sphinx_words(lines: list[str]) -> list[str]:
    """Return a docstring with sections as fields, and entries as items of a list."""
    found: list[str] = []
    section = ""
    for number, line in enumerate(lines):
        ahead = lines[number + 1] if number + 1 < len(lines) else ""
        if line in _ENTRIES + _ERRORS + _TEXTS and ahead.startswith("---"):
            section = line
            found += ["", f":{section}:", ""]
        elif not section:
            found.append(line)
        elif line.startswith("---") or not line:
            found.append("")
        else:
            found += [f"    {text}" for text in _entries(section, line)]
    return [*found, ""]


def _entries(section: str, line: str) -> Iterator[str]:
    """Yield the list item that a line of a section starts, or a line that continues an item."""
    if section in _TEXTS or line.startswith(" "):
        yield line[4:] if section in _TEXTS and line.startswith("    ") else f"  {line.strip()}"
    elif section in _ERRORS:
        names, _, words = line.partition(" : ")
        yield f"* {', '.join(f':exc:`{name}`' for name in names.split(', '))} – {words}"
    else:
        names, _, words = line.partition(" : ")
        bold = ", ".join(f"**{name}**" for name in names.split(", "))
        yield f"* {bold} – {words}" if words else f"* {line}"


def _known(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, content: Element
) -> Element | None:
    """Return a link to the documented object with a name; without a link, the name itself.

    Docstrings use the names in the namespace of their module, and the site does not document all
    objects. If the package has no object with the name, the result is None. The name stays
    unresolved, which is an error.
    """
    if node.get("refdomain") != "py":
        return None
    domain = env.get_domain("py")
    target = node["reftarget"].lstrip(".")
    last = target.rpartition(".")[2]
    names = [name for name in domain.objects if name.rpartition(".")[2] == last]
    names = [name for name in names if name in (target, f"ggbench.{last}")] or names
    if len(names) == 1:
        return domain.resolve_xref(
            env,
            fromdocname=node["refdoc"],
            builder=app.builder,
            type="obj",
            target=names[0],
            node=node,
            contnode=content,
        )
    return content if any(_has(module, target) for module in _modules()) else None


@cache
def _modules() -> tuple[Any, ...]:
    """Import the modules of the package, and return all that are loaded."""
    rooms = pkgutil.walk_packages(ggbench.__path__, "ggbench.")
    for module in rooms:
        if not module.name.startswith(("ggbench.estimators", "ggbench.scenarios")):
            __import__(module.name)
    return tuple(sys.modules[name] for name in sorted(sys.modules) if name.startswith("ggbench"))


def _has(module: Any, name: str) -> bool:
    """Return whether a module contains an object with a dotted name, relative or absolute."""
    path = name.removeprefix(f"{module.__name__}.").split(".")
    try:
        reduce(getattr, path, module)
    except AttributeError:
        return False
    return True
