"""Relative links of a text for several folders."""

from __future__ import annotations

import re
from collections.abc import Set
from pathlib import Path
from urllib.parse import unquote

_LINK = re.compile(r"`[^`]*`|!?\[(?P<text>[^\]]*)\]\((?P<target>[^)\s]*)[^)]*\)")
"""A link or a picture of markdown; or code, in which nothing is a link."""
_ABSOLUTE = re.compile(r"[a-zA-Z][\w+.-]*:")


def without_dead(text: str, folder: Path, coming: Set[str] = frozenset()) -> str:
    """Return markdown in which relative links without a target become plain text.

    Notes of shipped scenarios link to pages next to ``reports/`` and to other reports. Reports in
    other folders have neither. Files that are still ``coming`` count as existing.
    """

    def kept(match: re.Match[str]) -> str:
        target = match["target"]
        if target is None or _ABSOLUTE.match(target):
            return match[0]
        path = unquote(target.partition("#")[0])
        return match[0] if path in coming or (folder / path).exists() else str(match["text"])

    return _LINK.sub(kept, text)
