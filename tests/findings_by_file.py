"""Findings of a check of source files, by file."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

ROOT = Path(__file__).parents[1]


def findings_by_file(
    files: Iterable[Path], check: Callable[[str], Iterable[str]]
) -> dict[str, list[str]]:
    """Return the findings of a check of each file's text, without the files that have none."""
    findings = {
        str(path.relative_to(ROOT)): list(check(path.read_text(encoding="utf-8"))) for path in files
    }
    return {name: found for name, found in findings.items() if found}
