"""Writes the key tables of ``docs/scenario_files.md`` from the specification objects.

``make keys`` runs it after a change of the specification; a test holds the page to it. Each table
stands between ``<!-- keys: TABLE -->`` and ``<!-- end of keys -->``, the list of all tables between
``<!-- tables -->`` and ``<!-- end of tables -->``.
"""

from __future__ import annotations

import re
from pathlib import Path

from ggbench.cli.key_tables import REQUIRED, Key, KeyTable, tables

PAGE = Path(__file__).parents[1] / "scenario_files.md"
_INHERITED = "as in ["


def filled_in(text: str) -> str:
    """Return the page with its tables as the specification has them now.

    Raises
    ------
    KeyError
        If the page asks for a table that there is not.
    """
    text = re.sub(
        r"(<!-- keys: (\S+) -->\n).*?(<!-- end of keys -->)",
        lambda found: f"{found[1]}{markdown(tables()[found[2]])}{found[3]}",
        text,
        flags=re.DOTALL,
    )
    return re.sub(
        r"(<!-- tables -->\n).*?(<!-- end of tables -->)",
        lambda found: f"{found[1]}{_overview()}{found[2]}",
        text,
        flags=re.DOTALL,
    )


def markdown(table: KeyTable) -> str:
    """Return the keys of a table as a table of markdown, with what it only takes over below."""
    own = [key for key in table.keys if not key.default.startswith(_INHERITED)]
    inherited = [key for key in table.keys if key not in own]
    parts = [_rows(own)] if own else []
    if table.recorded:
        if own:
            parts.append("In the file of a recorded flight also:\n")
        parts.append(_rows(table.recorded))
    if inherited:
        names = ", ".join(f"`{key.name}`" for key in inherited)
        parts.append(f"It may also change these, each {inherited[0].default}: {names}.\n")
    return "\n" + "\n".join(parts) + "\n"


def _rows(keys: list[Key] | tuple[Key, ...]) -> str:
    lines = ["| key | unit | values | default | meaning |", "|---|---|---|---|---|"]
    for key in keys:
        values = key.kind
        if key.allowed:
            values = key.allowed if "list" not in values else f"{values}, each {key.allowed}"
            values += f"; usual: {key.usual}" if key.usual else ""
        default = "—" if key.default == REQUIRED else _code(key.default)
        cells = [f"`{key.name}`", key.unit, _code(values), default, key.meaning]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _code(text: str) -> str:
    """Return a text with what stands in quotation marks or brackets set as code."""
    return text if "`" in text else re.sub(r'("[^"]*"|\[.*\])', r"`\1`", text)


def _overview() -> str:
    lines = ["| table | what it is for |", "|---|---|"]
    lines += [f"| `{table.heading}` | {table.about} |" for table in tables().values()]
    return "\n" + "\n".join(lines) + "\n\n"


if __name__ == "__main__":
    PAGE.write_text(filled_in(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
