"""The text of a report as HTML: tables that can be sorted, words that are explained, no loose ends.

What is shown is the report's markdown itself, so that no number is computed a second time.
"""

from __future__ import annotations

import html
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from markdown_it import MarkdownIt
from markdown_it.token import Token

from .. import definitions
from ..tables import DEFINITIONS

_PARSER = MarkdownIt("commonmark", {"html": False}).enable("table")
_NUMBER = re.compile(r"[*<≥≤(]*([-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?)(?=$|[\s,*%)×/])")
_MISSING = re.compile(r"$|–|none$")
_LAST = "1e300"
"""By what a cell without a number is sorted: last."""


@dataclass
class Prose:
    """Turns markdown into HTML.

    Parameters
    ----------
    picture : called with the source, the alternative text and the caption (HTML) of an image that
        is a paragraph of its own; returns what stands there.
    estimators : name to the id of what explains it.

    Attributes
    ----------
    contents : id and text of every heading of the second level so far, in HTML.
    """

    picture: Callable[[str, str, str], str]
    estimators: Mapping[str, str] = field(default_factory=dict)
    contents: list[tuple[str, str]] = field(default_factory=list)
    _ids: set[str] = field(default_factory=set)

    def blocks(self, text: str) -> list[str]:
        """Return the blocks of a text as HTML. Nothing in it is HTML already, whoever wrote it."""
        tokens = _PARSER.parse(text)
        parts = []
        place = 0
        while place < len(tokens):
            token = tokens[place]
            end = _closing(tokens, place)
            inside = tokens[place + 1 : end]
            if token.type == "table_open":
                parts.append(self._table(inside))
            elif token.type == "heading_open":
                parts.append(self._heading(token.tag, inside[0]))
            elif (image := _alone(inside)) is not None:
                caption, end = self._caption(image, tokens, end)
                source = str(image.attrs["src"])
                parts.append(self.picture(source, image.content, caption))
            else:
                parts.append(self._rendered(tokens[place : end + 1]))
            place = end + 1
        return parts

    def definitions(self) -> tuple[str, str]:
        """Return the introduction and the list of the definitions, each under its id."""
        intro, entries = "", []
        for paragraph in definitions.text().split("\n\n")[1:]:
            title = re.match(r"\*\*(.*?)\.?\*\*", paragraph)
            shown = _PARSER.renderInline(" ".join(paragraph.split()))
            if title:
                entries.append(f'<p id="{definition_id(title[1])}">{shown}</p>')
            else:
                intro = f"<p>{shown}</p>"
        return intro, "\n".join(entries)

    def _rendered(self, tokens: Sequence[Token]) -> str:
        """Return tokens as HTML, with links that lead somewhere."""
        for token in tokens:
            if token.type == "inline" and token.children:
                token.children = _relinked(token.children)
        return str(_PARSER.renderer.render(tokens, _PARSER.options, {})).strip()

    def _inline(self, token: Token) -> str:
        return self._rendered([token])

    def _heading(self, level: str, inline: Token) -> str:
        shown = self._inline(inline)
        words = re.sub(r"[^\w\- ]", "", inline.content.lower()).strip().replace(" ", "-")
        name, number = words or "section", 1
        while name in self._ids:
            name, number = f"{words}-{number}", number + 1
        self._ids.add(name)
        if level == "h2":
            self.contents.append((name, shown))
        return f'<{level} id="{name}">{shown}</{level}>'

    def _caption(self, image: Token, tokens: Sequence[Token], end: int) -> tuple[str, int]:
        """Return the caption that a report sets behind a picture, and where it ends."""
        following = tokens[end + 1 : end + 4]
        inline = following[1] if len(following) == 3 else None
        if inline is not None and inline.type == "inline" and inline.content.startswith("*"):
            return self._inline(inline), end + 3
        return html.escape(image.content), end

    def _table(self, tokens: Sequence[Token]) -> str:
        """Return a table. Rows between titles within it stay between them, however it is sorted."""
        lines: list[list[Token]] = []
        for token in tokens:
            if token.type == "tr_open":
                lines.append([])
            elif token.type == "inline":
                lines[-1].append(token)
        head, *rows = lines
        blocks = _blocks(rows)
        pinned = [number for number in set(blocks) if number % 2]
        keys = _sort_keys([row for row, block in zip(rows, blocks, strict=True) if not block % 2])
        parts = ["<tr>"]
        if pinned:
            parts.append('<th class="block"></th>')
        parts += [f"<th>{self._explained(cell)}</th>" for cell in head]
        parts.append("</tr></thead><tbody>")
        for row, block in zip(rows, blocks, strict=True):
            parts.append('<tr class="title">' if block % 2 else "<tr>")
            if pinned:
                parts.append(f'<td class="block">{block}</td>')
            for column, cell in enumerate(row):
                key = keys.get(column)
                order = f' data-order="{key(cell.content)}"' if key else ""
                parts.append(f"<td{order}>{self._named(cell)}</td>")
            parts.append("</tr>")
        table = f'<table data-blocks="{len(pinned)}"><thead>{"".join(parts)}</tbody></table>'
        return f'<div class="wide">{table}</div>'

    def _explained(self, cell: Token) -> str:
        """Return a column's head, with the definition of what it says if there is one."""
        shown = self._inline(cell)
        title = definitions.title_of(cell.content)
        if title is None or not shown:
            return shown
        return f'<span class="term" data-term="{definition_id(title)}">{shown}</span>'

    def _named(self, cell: Token) -> str:
        """Return a cell; if it begins with an estimator's name, with what explains that."""
        shown = self._inline(cell)
        name = re.match(r"\**`(.*?)`", cell.content)
        known = self.estimators.get(name[1]) if name else None
        if known is None:
            return shown
        return shown.replace("<code>", f'<code class="term" tabindex="0" data-term="{known}">', 1)


def definition_id(title: str) -> str:
    """Return the id of a definition on the page."""
    return "def-" + re.sub(r"\W+", "-", title.lower())


def _closing(tokens: Sequence[Token], place: int) -> int:
    """Return where the block that begins at a place ends."""
    depth = 0
    for number in range(place, len(tokens)):
        depth += tokens[number].nesting
        if depth == 0:
            return number
    return len(tokens) - 1


def _alone(inside: Sequence[Token]) -> Token | None:
    """Return the image that a paragraph consists of, if it does."""
    if len(inside) != 1 or inside[0].type != "inline":
        return None
    children = inside[0].children or []
    return children[0] if len(children) == 1 and children[0].type == "image" else None


def _relinked(children: Sequence[Token]) -> list[Token]:
    """Return a text without links to files that are not sent with the page, the words kept."""
    kept, dropped = [], False
    for token in children:
        if token.type == "link_open":
            target = str(token.attrs.get("href", ""))
            if target.partition("#")[0] == DEFINITIONS:
                token.attrs["href"] = "#definitions"
            dropped = not re.match(r"https?://|#", str(token.attrs["href"]))
            if dropped:
                continue
        if token.type == "link_close" and dropped:
            dropped = False
            continue
        if token.type == "image":  # within a sentence: its words
            token.type, token.tag = "text", ""
        kept.append(token)
    return kept


def _blocks(rows: Sequence[Sequence[Token]]) -> list[int]:
    """Return the block of each row: odd of titles and references, even of what may be sorted.

    A row is a title or a reference if its first words are emphasised, unless those of all are.
    """
    first = [next((cell.content for cell in row if cell.content), "") for row in rows]
    emphasised = [text.startswith("*") for text in first]
    if all(emphasised):
        return [0] * len(rows)
    blocks, number = [], 0
    for is_title in emphasised:
        number += 1 + number % 2 if is_title else number % 2
        blocks.append(number)
    return blocks


def _sort_keys(rows: Sequence[Sequence[Token]]) -> dict[int, Callable[[str], str]]:
    """Return for each column of numbers what a cell is sorted by: its first number."""
    columns = list(zip(*([cell.content for cell in row] for row in rows), strict=True))
    return {
        number: _sort_key
        for number, cells in enumerate(columns)
        if any(not _MISSING.match(cell) for cell in cells)
        and all(_MISSING.match(cell) or _number(cell) is not None for cell in cells)
    }


def _sort_key(cell: str) -> str:
    value = _number(cell)
    return _LAST if value is None else f"{value:.9g}"


def _number(cell: str) -> float | None:
    """Return the number with which a cell begins, None without."""
    if cell.strip("*").startswith("∞"):
        return math.inf
    found = _NUMBER.match(cell)
    return float(found[1].replace("−", "-")) if found else None
