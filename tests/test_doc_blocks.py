"""Every code block of the README and of the documentation does what it shows."""

from __future__ import annotations

import ast
import re
import shlex
import tomllib
from pathlib import Path

import click
import pytest
from doc_blocks import LANGUAGES, Session, blocks, documents

from ggbench.cli.main import main

ROOT = Path(__file__).parents[1]
PAGES = [path.relative_to(ROOT).as_posix() for path in documents(ROOT)]
LARGE = ("docs/howto/own_flight.md", "docs/howto/own_sensor.md")
"""Pages whose quick blocks fly, too."""
BASE = next(b for b in blocks(ROOT / "docs" / "scenario_files.md") if b.said.startswith("file: "))


def tried(page: str, folder: Path, long: bool) -> None:
    """Try the blocks of a page; without ``long`` those that are quick."""
    session = Session(folder, tomllib.loads(BASE.text))
    for block in blocks(ROOT / page):
        if block.reason or (block.long and not long and (block.runs or block.said == "output")):
            continue
        try:
            session.take(block)
        except Exception as error:
            pytest.fail(f"{page}:{block.line}: {type(error).__name__}: {error}")


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=pytest.mark.long if page in LARGE else ()) for page in PAGES],
)
def test_quick_blocks_do_what_they_show(page, tmp_path):
    """Files are read, parts of scenarios accepted, short commands run."""
    tried(page, tmp_path, long=False)


@pytest.mark.long
@pytest.mark.parametrize(
    "page", [page for page in PAGES if any(b.long and b.runs for b in blocks(ROOT / page))]
)
def test_whole_pages_do_what_they_show(page, tmp_path):
    """All blocks of a page, one after the other in one folder."""
    tried(page, tmp_path, long=True)


@pytest.mark.parametrize("page", PAGES)
def test_no_block_is_passed_over(page):
    """Each has a language that is tried, or a reason not to be, and Python is Python."""
    for block in blocks(ROOT / page):
        place = f"{page}:{block.line}"
        if block.said.startswith("not run: "):
            assert len(block.reason) > 20, place
            continue
        assert block.language in LANGUAGES, place
        if block.language == "text":
            assert block.said, f"{place}: neither a file nor what something prints"
        if block.language == "python":
            ast.parse(block.text)


def test_as_many_fences_as_blocks():
    """No fence is written in a way that the harness does not see."""
    for page in PAGES:
        text = (ROOT / page).read_text(encoding="utf-8")
        fences = re.findall(r"^\s*(`{3,}|~{3,})", text, re.MULTILINE)
        laid_out = len(re.findall(r"^```\{", text, re.MULTILINE))
        assert len(fences) == 2 * (len(blocks(ROOT / page)) + laid_out), page


@pytest.mark.parametrize("page", PAGES)
def test_every_command_shown_exists(page):
    """Also of blocks that are not run: command and options are those of the program."""
    for block in blocks(ROOT / page):
        if block.language != "sh":
            continue
        for line in block.text.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            if words[:1] == ["ggbench"]:
                understood(words[1:])


def understood(words: list[str]) -> None:
    """Parse a command line as the program would. Raises click's errors."""
    command: click.Command = main
    while isinstance(command, click.Group):
        assert words[0] in command.commands, words
        command, words = command.commands[words[0]], words[1:]
    command.make_parser(click.Context(command)).parse_args(list(words))


def test_a_report_from_an_elevation_model_takes_few_commands():
    """Eight of twelve that are allowed, and none of them names a height above the ellipsoid."""
    shown = [b.text for b in blocks(ROOT / "docs/howto/helicopter.md") if b.language == "sh"]
    lines = "\n".join(shown).splitlines()
    assert sum(line.startswith("ggbench ") for line in lines) <= 12
    assert not any(word in text for text in shown for word in ("lowest", "highest", "height"))


@pytest.mark.long
def test_a_block_that_fails_is_found(tmp_path):
    """The harness itself: of a page with a mistake in each language, each is an error."""
    page = tmp_path / "page.md"
    page.write_text(
        "```sh\nggbench keys nothing_of_the_kind\n```\n```python\n1 / 0\n```\n"
        "```toml\n[imu]\nperiod = 1\n```\n```sh\necho one\n```\n"
        "<!-- output -->\n```text\ntwo\n```\n"
    )
    session = Session(tmp_path, tomllib.loads(BASE.text))
    failed = []
    for block in blocks(page):
        try:
            session.take(block)
        except Exception:
            failed.append(block.line)
    assert failed == [1, 4, 7, 15]
