"""Tables that fit a terminal: no name is lost and no number cut, however narrow it is.

Columns that do not fit go into a further block below, with the names before them again. Names go on
in a further line after ``[``, ``,`` and ``/``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Literal

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

Kind = Literal["name", "number", "text"]
_LEAST_TEXT = 24
"""Width to which a column of sentences may be narrowed."""
_MOST_NAMES, _LEAST_NAME = 0.55, 8
"""Share of the width above which names are cut anywhere, and width to which they are at least."""
_EDGES = 2
"""Blanks at both ends of a line together."""
_INDENT = "  "
_PIECES = re.compile(r"[^\[,/]*[\[,/]+|[^\[,/]+")


class FittedTable:
    """A table of names, numbers and sentences, to be printed at any width.

    Parameters
    ----------
    title : printed above it. columns : heading and kind of each; names come first.
    """

    def __init__(self, title: str, columns: Sequence[tuple[str, Kind]]) -> None:
        self._title = title
        self._headings = [heading for heading, _ in columns]
        self._kinds = [kind for _, kind in columns]
        self._names = [n for n, kind in enumerate(self._kinds) if kind == "name"]
        self._rows: list[tuple[Sequence[str], str, bool]] = []

    def add_row(self, *cells: str, style: str = "") -> None:
        """Add a row: names as they are, other cells with rich's markup."""
        assert len(cells) == len(self._headings)
        self._rows.append((cells, style, False))

    def add_section(self) -> None:
        """Have a line drawn below the last row."""
        if self._rows:
            self._rows[-1] = (*self._rows[-1][:2], True)

    def print(self, console: Console) -> None:
        """Print the table."""
        for table in self.fitted(console.width):
            console.print(table)

    def fitted(self, width: int) -> list[Table]:
        """Return the table as blocks of columns, none wider than so many characters."""
        blanks, blocks = 2, self._blocks(width, 2)
        if len(self._blocks(width, 1)) < len(blocks):
            blanks, blocks = 1, self._blocks(width, 1)
        tables = [self._table(block, width, blanks) for block in blocks]
        if self._title:
            tables[0].title = escape(self._title)
        return tables

    def _blocks(self, width: int, blanks: int) -> list[list[int]]:
        """Return the columns of each block but for the names, with so many blanks between them."""
        names = _EDGES - blanks + sum(w + blanks for w in self._least_names(width).values())
        blocks: list[list[int]] = [[]]
        left = width - names
        for column in range(len(self._names), len(self._headings)):
            needed = self._least(column) + blanks
            if needed > left and blocks[-1]:
                blocks.append([])
                left = width - names
            blocks[-1].append(column)
            left -= needed
        return blocks

    def _least(self, column: int) -> int:
        """Return how narrow a column of numbers or sentences may be."""
        plain = [self._headings[column]]
        plain += [Text.from_markup(cells[column]).plain for cells, _, _ in self._rows]
        widest = max(cell_len(line) for text in plain for line in text.splitlines() or [""])
        return min(widest, _LEAST_TEXT) if self._kinds[column] == "text" else widest

    def _least_names(self, width: int) -> dict[int, int]:
        """Return how narrow the columns of names are where it counts."""
        others = (n for n in range(len(self._headings)) if n not in self._names)
        beside = width - _EDGES - max(map(self._least, others), default=0) - 2 * len(self._names)
        least = {
            n: max(
                cell_len(self._headings[n]),
                *(
                    cell_len(piece) + len(_INDENT) * (number > 0)
                    for name in self._named(n)[1:]
                    for number, piece in enumerate(_PIECES.findall(name))
                ),
            )
            for n in self._names
        }
        while sum(least.values()) > min(_MOST_NAMES * width, beside):
            widest = max(least, key=lambda n: least[n])
            if least[widest] <= _LEAST_NAME:
                break
            least[widest] -= 1
        return least

    def _named(self, column: int) -> list[str]:
        return [self._headings[column], *(cells[column] for cells, _, _ in self._rows)]

    def _table(self, block: Sequence[int], width: int, blanks: int) -> Table:
        """Return a block of columns with the names before it."""
        table = Table(
            title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, blanks - 1, 0, 0)
        )
        others = sum(self._least(column) + blanks for column in block)
        room = width - _EDGES + blanks - others - blanks * len(self._names)
        widths = self._shared(room, width)
        for column in self._names:
            heading = wrapped(self._headings[column], widths[column])
            table.add_column(escape(heading), no_wrap=True)
        for column in block:
            number = self._kinds[column] == "number"
            table.add_column(
                escape(self._headings[column]), justify="right" if number else "left",
                no_wrap=number, overflow="fold",
            )  # fmt: skip
        for cells, style, end in self._rows:
            names = [escape(wrapped(cells[n], widths[n])) for n in self._names]
            table.add_row(*names, *(cells[n] for n in block), style=style, end_section=end)
        return table

    def _shared(self, room: int, width: int) -> dict[int, int]:
        """Return the width of each column of names, of what is left for them together."""
        least = self._least_names(width)
        spare = max(room - sum(least.values()), 0)
        widths = {}
        for n in self._names:
            widths[n] = min(max(map(cell_len, self._named(n))), least[n] + spare)
            spare -= max(widths[n] - least[n], 0)
        return widths


def wrapped(name: str, width: int) -> str:
    """Return a name in lines of so many characters, the further ones indented."""
    lines = [""]
    for piece in _PIECES.findall(name):
        if cell_len(lines[-1] + piece) > width and lines[-1].strip():
            lines.append(_INDENT)
        while cell_len(lines[-1] + piece) > width:  # no name is lost, wherever it must be cut
            cut = max(width - cell_len(lines[-1]), 1)
            lines[-1] += piece[:cut]
            piece = piece[cut:]
            lines.append(_INDENT)
        lines[-1] += piece
    return "\n".join(line for line in lines if line.strip())
