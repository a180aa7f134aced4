"""Removal of dead relative links from markdown."""

from __future__ import annotations

import re
from collections.abc import Set
from pathlib import Path
from urllib.parse import unquote

_LINK = re.compile(r"`[^`]*`|!?\[(?P<text>[^\]]*)\]\((?P<target>[^)\s]*)[^)]*\)")
"""A link or an image in markdown, or a code span, which contains no links."""
_ABSOLUTE = re.compile(r"[a-zA-Z][\w+.-]*:")


def without_dead(text: str, folder: Path, coming: Set[str] = frozenset()) -> str:
    """Replace relative links without a target by plain text.

    Notes of shipped scenarios link to pages next to ``reports/`` and to other reports. If a report
    is written to another folder, these targets do not exist.

    Parameters
    ----------
    text : markdown.
    folder : folder of the page.
    coming : files that will be written later, which count as existing.
    """

    def kept(match: re.Match[str]) -> str:
        target = match["target"]
        if target is None or _ABSOLUTE.match(target):
            return match[0]
        path = unquote(target.partition("#")[0])
        return match[0] if path in coming or (folder / path).exists() else str(match["text"])

    return _LINK.sub(kept, text)
