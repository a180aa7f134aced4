"""Key tables of ``docs/scenario_files.md`` and JSON schemas of files.

``make keys`` runs this program after a change of the specification. A test compares the files with
the specification. A table of keys is between ``<!-- keys: TABLE -->`` and ``<!-- end of keys -->``.
The list of all tables is between ``<!-- tables -->`` and ``<!-- end of tables -->``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from ggbench.cli.keys import REQUIRED, Key, KeyTable, presets_of, tables
from ggbench.score import card
from ggbench.spec.json_schema import schema_text

PAGE = Path(__file__).parents[1] / "scenario_files.md"
SCHEMA = Path(__file__).parents[1] / "scenario.schema.json"
CARD_SCHEMA = Path(__file__).parents[1] / "card.schema.json"


def filled_in(text: str) -> str:
    """Return the page with the present tables.

    Raises KeyError if the page contains a table that does not exist.
    """
    text = re.sub(
        r"(<!-- keys: (\S+) -->\n).*?(<!-- end of keys -->)",
        lambda found: f"{found[1]}{_keys(tables()[found[2]])}{found[3]}",
        text,
        flags=re.DOTALL,
    )
    rows = [(f"`{table.heading}`", table.about) for table in tables().values()]
    overview = _markdown(("table", "purpose"), rows)
    return re.sub(
        r"(<!-- tables -->\n).*?(<!-- end of tables -->)",
        lambda found: f"{found[1]}\n{overview}\n{found[2]}",
        text,
        flags=re.DOTALL,
    )


def _keys(table: KeyTable) -> str:
    """Return the keys of a table in Markdown; keys with inherited defaults are only listed."""
    own = [key for key in table.keys if not key.default.startswith("as in")]
    inherited = [key for key in table.keys if key not in own]
    blocks = [_rows(own)] if own else []
    if presets := presets_of(table.name):
        rows = [(f"`{head}`", *text.split(". Source: ", 1)) for head, text in presets]
        blocks.append(_markdown(("preset", "gives", "source"), rows))
    if table.recorded:
        lead = "In the file of a recorded flight also:\n\n" if own else ""
        blocks.append(lead + _rows(table.recorded))
    if inherited:
        names = ", ".join(f"`{key.name}`" for key in inherited)
        blocks.append(f"It may also change these, each {inherited[0].default}: {names}.\n")
    return "\n" + "\n".join(blocks) + "\n"


def _rows(keys: Iterable[Key]) -> str:
    rows = []
    for key in keys:
        values = key.kind
        if key.allowed:
            values = f"{values}, each {key.allowed}" if "list" in values else key.allowed
            values += f"; usual: {key.usual}" if key.usual else ""
        default = "—" if key.default == REQUIRED else _code(key.default)
        rows.append((f"`{key.name}`", key.unit, _code(values), default, key.meaning))
    return _markdown(("key", "unit", "values", "default", "meaning"), rows)


def _markdown(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [" | ".join(row) for row in (head, *rows)]
    lines.insert(1, "|".join(["---"] * len(head)))
    return "".join(f"|{line}|\n" if line[0] == "-" else f"| {line} |\n" for line in lines)


def _code(text: str) -> str:
    """Return a text with quoted texts and lists as code."""
    return re.sub(r'(\[.*\]|"[^"]*")', r"`\1`", text)


if __name__ == "__main__":
    PAGE.write_text(filled_in(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    SCHEMA.write_text(schema_text(), encoding="utf-8")
    CARD_SCHEMA.write_text(card.schema_text(), encoding="utf-8")
