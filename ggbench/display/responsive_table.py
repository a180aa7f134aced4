"""Tables for terminals of any width: long names wrap, numbers never do.

Columns that do not fit are printed in a further table below, with the names repeated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

Kind = Literal["name", "number", "text"]
_NAME_SHARE = 5
"""Ratio of the terminal's width to the least width of a column of names."""
_NARROWEST_TEXT = 24
_EDGES = 2


class ResponsiveTable:
    """A table of names, numbers and sentences for a terminal of any width.

    ``columns`` has the heading and kind of each column; columns of names come first.
    """

    def __init__(self, title: str, columns: Sequence[tuple[str, Kind]]) -> None:
        self._title = title
        self._columns = columns
        self._rows: list[list[str]] = []
        self._styles: list[str] = []
        self._section_ends: set[int] = set()

    def add_row(self, *cells: str, style: str = "") -> None:
        """Add a row; names are plain text, other cells may contain markup of the package rich."""
        pairs = zip(self._columns, cells, strict=True)
        self._rows.append([escape(cell) if kind == "name" else cell for (_, kind), cell in pairs])
        self._styles.append(style)

    def add_section(self) -> None:
        """Draw a line below the row that was added last."""
        self._section_ends.add(len(self._rows) - 1)

    def print(self, console: Console) -> None:
        """Print the table."""
        for table in self.tables(console.width):
            console.print(table)

    def tables(self, width: int) -> list[Table]:
        """Return rich tables of at most this width; each repeats the columns of names."""
        gap = 2
        blocks = self._blocks(width, gap)
        if len(blocks) > len(self._blocks(width, 1)):
            gap = 1
            blocks = self._blocks(width, gap)
        tables = [self._table(block, gap) for block in blocks]
        tables[0].title = escape(self._title) or None
        return tables

    def _blocks(self, width: int, gap: int) -> list[list[int]]:
        """Return the column indices of each table; columns are separated by ``gap`` blanks."""
        narrowest = {"name": width // _NAME_SHARE, "number": width, "text": _NARROWEST_TEXT}
        names: list[int] = []
        blocks: list[list[int]] = []
        room = 0
        for column, (_, kind) in enumerate(self._columns):
            needed = gap + min(self._widest(column), narrowest[kind])
            if kind == "name":
                names.append(column)
                width -= needed
                continue
            if not blocks or needed > room:
                blocks.append([*names])
                room = width - _EDGES + gap
            blocks[-1].append(column)
            room -= needed
        return blocks

    def _widest(self, column: int) -> int:
        texts = [self._columns[column][0]]
        texts += [Text.from_markup(row[column]).plain for row in self._rows]
        return max(cell_len(line) for text in texts for line in text.splitlines() or [""])

    def _table(self, block: Sequence[int], gap: int) -> Table:
        table = Table(
            title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, gap - 1, 0, 0)
        )
        for heading, kind in (self._columns[column] for column in block):
            number = kind == "number"
            table.add_column(
                escape(heading),
                justify="right" if number else "left",
                no_wrap=number,
                overflow="fold",
            )
        for n, (row, style) in enumerate(zip(self._rows, self._styles, strict=True)):
            cells = (row[column] for column in block)
            table.add_row(*cells, style=style, end_section=n in self._section_ends)
        return table
