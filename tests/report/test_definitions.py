"""The page of definitions says what the code does."""

from __future__ import annotations

from ggbench.report import definitions


def test_the_definitions_are_those_of_the_code(tmp_path, monkeypatch):
    """Every threshold on the page is that of the rule it describes."""
    definitions.write(tmp_path)
    before = (tmp_path / "definitions.md").read_text()
    changed = {
        "LEAST_COVERAGE": (0.61, "is 61 % or more"), "MOST_FALSE": (0.07, "in 7 % of the runs"),
        "MOST_FAILED": (0.03, "at most 3 %"), "UNCERTAIN": (1.37, "at most 37 %"),
        "EQUIVALENCE_RATIO": (1.21, "within 21 %"), "FEWEST": (33, "over 33 runs"),
        "BOUNDS": (7.0, "within 7 bounds"), "INS_FRACTION": (0.23, "23 % of the INS's error"),
    }  # fmt: skip
    for name, (value, _) in changed.items():
        monkeypatch.setattr(definitions, name, value)
    definitions.write(tmp_path)
    text = " ".join((tmp_path / "definitions.md").read_text().split())
    for _, words in changed.values():
        assert words in text and words not in " ".join(before.split())
    assert "{" not in before and before.startswith("# Definitions\n")
