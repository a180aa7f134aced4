"""CONTRIBUTING.md: its table of rooms is that of the tests, and its rules have tests."""

from __future__ import annotations

import re
from pathlib import Path

from test_rooms import FLOORS

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


def rows(text: str, head: str) -> list[list[str]]:
    """Return the cells of a table below its head, whose first cell is ``head``."""
    table = re.search(rf"^\| {head} \|.*\n\|[-|]+\n((?:\|.*\n)+)", text, re.MULTILINE)
    assert table is not None, head
    return [
        [cell.strip() for cell in row.strip().strip("|").split(" | ")]
        for row in table[1].splitlines()
    ]


def rooms(text: str) -> list[tuple[str, ...]]:
    """Return the rooms of the table, floor by floor."""
    return [
        tuple(re.findall(r"`(\w+)`", names)) for names, _ in rows(text, "rooms, lowest layer first")
    ]


def without_tests(text: str) -> list[str]:
    """Return the rules that name no test, or one that does not exist."""
    missing = []
    for rule, held_by in rows(text, "rule"):
        named = re.findall(r"`([^`]+)`", held_by)
        folder, places = ROOT, []
        for name in named:
            path = folder / name if "/" not in name and folder != ROOT else ROOT / name
            folder = path.parent
            places.append(name.startswith("make ") or path.exists())
        if not places or not all(places):
            missing.append(rule)
    return missing


def test_the_table_of_rooms_is_that_of_the_tests():
    """Floors in the same order, and no room twice."""
    assert [set(floor) for floor in rooms(TEXT)] == [set(floor) for floor in FLOORS]
    every = [room for floor in FLOORS for room in floor]
    assert len(every) == len(set(every)) <= 33


def test_every_rule_has_a_test():
    assert without_tests(TEXT) == []


def test_a_rule_without_a_test_and_a_missing_room_are_found():
    """Negative controls."""
    assert without_tests(TEXT.replace("tests/test_rooms.py", "tests/test_doors.py"))
    assert without_tests(TEXT.replace("`make lint typecheck`", "reviewers")) == ["Style, types."]
    assert rooms(TEXT.replace("`matchability`", "matching")) != rooms(TEXT)
