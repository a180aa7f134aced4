"""The page of definitions says what the code does."""

from __future__ import annotations

from ggbench.report import definitions


def test_the_definitions_are_those_of_the_code(tmp_path, monkeypatch):
    """Every threshold on the page is that of the rule it describes."""
    definitions.write(tmp_path)
    before = (tmp_path / "definitions.md").read_text()
    changed = {
        "LEAST_COVERAGE": (0.61, "surely below 61 %"), "MOST_FALSE": (0.07, "more than 7 %"),
        "MOST_FAILED": (0.03, "at most 3 %"), "UNCERTAIN": (1.37, "at most 37 %"),
        "ALIKE": (1.21, "within 21 %"), "FEWEST": (33, "over 33 runs"),
    }  # fmt: skip
    for name, (value, _) in changed.items():
        monkeypatch.setattr(definitions, name, value)
    definitions.write(tmp_path)
    text = " ".join((tmp_path / "definitions.md").read_text().split())
    for _, words in changed.values():
        assert words in text and words not in " ".join(before.split())
    assert "{" not in before and before.startswith("# Definitions\n")
