"""Links of notes: kept where they lead somewhere, else text alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from ggbench.report.links import without_dead
from ggbench.spec import scenario

REPORTS = Path(__file__).parents[2] / "reports"


def test_links_that_lead_somewhere_are_kept(tmp_path):
    """Also those to a place, to the network, and what is code."""
    (tmp_path / "a b.md").write_text("")
    kept = "[a](a%20b.md), [b](a%20b.md#c), [d](#e), [f](https://g.org/h), `i[0](j.md)`, ![k](.)"
    assert without_dead(kept, tmp_path) == kept


def test_links_that_lead_nowhere_are_text(tmp_path):
    text = '[a](b.md), [c d](../e/f.md#g), ![h](i.png), [j](k.md "l") and `m`.'
    assert without_dead(text, tmp_path) == "a, c d, h, j and `m`."


@pytest.mark.parametrize("name", scenario.shipped())
def test_notes_of_shipped_scenarios_fit_any_folder(name, tmp_path):
    """In reports/ they are as written; in an empty folder they have no link."""
    notes = scenario.load(name).notes
    assert without_dead(notes, REPORTS) == notes
    assert "](" not in without_dead(notes, tmp_path)


def test_a_page_that_is_written_later_counts(tmp_path):
    """Of several pages that are written together."""
    text = "[a](a.md) and [b](b.md)"
    assert without_dead(text, tmp_path, {"a.md"}) == "[a](a.md) and b"
