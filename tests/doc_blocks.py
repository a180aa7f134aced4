"""The code blocks of a document, and what becomes of each when the document is tried.

A comment in front of a block says what is special about it:

``<!-- file: NAME -->``  it is the content of a file; later blocks use it
``<!-- output -->``      it is printed by the block before it
``<!-- flight -->``      it is the file of a recorded flight
``<!-- not run: REASON -->``

``<!-- long from here -->`` on a line of its own: commands and Python from there on take long.
Shell and Python blocks are run in the order of the page, in one folder and one namespace. TOML is a
part of a scenario, laid over a complete one.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ggbench.spec import flight, scenario

_BLOCK = re.compile(
    r"(?:^<!-- (?P<said>[^\n]*?) -->\n)?^```(?P<language>[^\n]*)\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
_LONG = "<!-- long from here -->"
LANGUAGES = {"sh", "python", "toml", "text"}
SAID = ("file: ", "not run: ", "output", "flight")


@dataclass(frozen=True)
class Block:
    """A code block.

    Attributes
    ----------
    language : as its fence says. text : its content.
    said : what the comment in front of it says.
    long : whether it stands where blocks take long.
    line : of the document.
    """

    language: str
    text: str
    said: str
    long: bool
    line: int

    @property
    def runs(self) -> bool:
        """Whether it is a command or Python that is run."""
        return self.language in ("sh", "python") and not self.said

    @property
    def reason(self) -> str:
        """Why it is not run; "" if it is."""
        return self.said.removeprefix("not run: ") if self.said.startswith("not run: ") else ""


def blocks(document: Path) -> list[Block]:
    """Return the code blocks of a document, without those that lay out the site."""
    text = document.read_text(encoding="utf-8")
    long_from = text.find(_LONG) if _LONG in text else len(text)
    return [
        Block(
            found["language"],
            found["text"],
            _said(found["said"]),
            found.start() >= long_from,
            text.count("\n", 0, found.start("language")) + 1,
        )
        for found in _BLOCK.finditer(text)
        if not found["language"].startswith("{")
    ]


def _said(comment: str | None) -> str:
    return comment if comment and comment.startswith(SAID) else ""


class Session:
    """A document that is tried in a folder."""

    def __init__(self, folder: Path, base: dict[str, Any]) -> None:
        self.folder, self.base = folder, base
        self.names: dict[str, Any] = {"__name__": "page"}
        self.output = ""

    def take(self, block: Block) -> None:
        """Do what a block asks for.

        Raises
        ------
        AssertionError
            If a command fails, or something else is printed.
        Exception
            Whatever Python, a scenario or a file raises.
        """
        if block.said.startswith("file: "):
            file = self.folder / block.said.removeprefix("file: ")
            file.write_text(block.text, encoding="utf-8")
        elif block.said == "output":
            assert block.text in self.output, f"printed was\n{self.output}"
        elif block.language == "toml":
            self._validate(block)
        elif block.language == "sh":
            self._run(block.text)
        elif block.language == "python":
            said = io.StringIO()
            with contextlib.chdir(self.folder), contextlib.redirect_stdout(said):
                exec(compile(block.text, f"line {block.line}", "exec"), self.names)
            self.output = said.getvalue()

    def _run(self, commands: str) -> None:
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", commands],
            cwd=self.folder,
            capture_output=True,
            text=True,
            env=os.environ | {"PATH": path, "COLUMNS": "80"},
            check=False,
        )
        assert done.returncode == 0, f"{commands}\nended with\n{done.stdout}{done.stderr}"
        assert "Traceback" not in done.stderr
        self.output = done.stdout

    def _validate(self, block: Block) -> None:
        part = tomllib.loads(block.text)
        if block.said == "flight":
            (self.folder / "said.toml").write_text(block.text, encoding="utf-8")
            flight.load(self.folder / "said.toml")
            return
        with contextlib.chdir(self.folder):
            scenario.parse(laid_over(self.base, part), "part", f"line {block.line}")


def laid_over(base: dict[str, Any], part: dict[str, Any]) -> dict[str, Any]:
    """Return a scenario with the tables of a part in place of its own.

    Segments of a flight replace segments, and leave its start.
    """
    whole = base | part
    if "segment" in part.get("trajectory", {}):
        whole["trajectory"] = base["trajectory"] | part["trajectory"]
    return whole


def documents(root: Path) -> Iterator[Path]:
    """Yield what is written for users by hand: the front page, and the pages of ``docs``."""
    yield root / "README.md"
    for path in sorted((root / "docs").rglob("*.md")):
        if "generated" not in path.parts:
            yield path
