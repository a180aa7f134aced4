"""Consoles for the output of commands."""

from __future__ import annotations

import os

from rich.console import Console

console = Console(highlight=False)
if not console.is_terminal and not os.environ.get("COLUMNS"):
    console.width = 120  # a file or a pipe has no edge at which tables must fold
