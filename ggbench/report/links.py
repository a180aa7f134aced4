"""Relative links of a text that is written into several folders."""

from __future__ import annotations

import re
from collections.abc import Set
from pathlib import Path
from urllib.parse import unquote

_LINK = re.compile(r"`[^`]*`|!?\[(?P<text>[^\]]*)\]\((?P<target>[^)\s]*)[^)]*\)")
"""A link or a picture of markdown; or code, in which nothing is a link."""
_ABSOLUTE = re.compile(r"[a-zA-Z][\w+.-]*:")


def without_dead(text: str, folder: Path, coming: Set[str] = frozenset()) -> str:
    """Return markdown with the text alone of relative links that lead nowhere from a folder.

    Notes of shipped scenarios link to pages next to ``reports/`` and to other reports. A report
    that is written elsewhere has neither. Files of the folder that are still ``coming`` count.
    """

    def kept(match: re.Match[str]) -> str:
        target = match["target"]
        if target is None or _ABSOLUTE.match(target):
            return match[0]
        path = unquote(target.partition("#")[0])
        return match[0] if path in coming or (folder / path).exists() else str(match["text"])

    return _LINK.sub(kept, text)
