"""Rosters: named sets of estimators, from ``scenarios/rosters.toml``."""

from __future__ import annotations

import importlib.resources
import tomllib
from collections.abc import Iterable, Mapping
from functools import cache

FILE = "rosters.toml"


@cache
def rosters() -> Mapping[str, tuple[str, ...]]:
    """Return the estimators of each roster, by name of the roster."""
    file = importlib.resources.files("ggbench.scenarios") / FILE
    table = tomllib.loads(file.read_text(encoding="utf-8"))
    return {name: tuple(texts) for name, texts in table.items()}


def expanded(texts: Iterable[str]) -> tuple[str, ...]:
    """Return a list of estimators with rosters ``@NAME`` expanded, without duplicates.

    ``-TEXT`` removes the estimator TEXT, which must be listed before this entry.

    Raises
    ------
    ValueError
        If a roster does not exist, or an estimator to remove is not listed before.
    """
    listed: dict[str, None] = {}
    for text in texts:
        if text.startswith("@"):
            if text[1:] not in rosters():
                allowed = ", ".join(f"@{name}" for name in rosters())
                raise ValueError(f"there is no roster '{text}'; rosters: {allowed}")
            listed |= dict.fromkeys(rosters()[text[1:]])
        elif text.startswith("-"):
            if text[1:] not in listed:
                raise ValueError(f"'{text}' removes an estimator that is not listed before it")
            del listed[text[1:]]
        else:
            listed[text] = None
    return tuple(listed)
