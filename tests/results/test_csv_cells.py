"""Texts of anyone's in CSV files: no formula, and read back as they were."""

from __future__ import annotations

import io

import pandas as pd
from campaigns import ran, small
from problems import SMALL
from thinning import thinned

from ggbench.results import digest
from ggbench.results.csv_cells import csv_text, restored

TEXTS = ["=1+1", "+1", "-2", "@x", "\tx", "'=1", "''-2", "plain", "'quoted", "a=b", "", "– 3"]


def test_texts_are_no_formulas_and_come_back():
    """Headings too; numbers stay numbers."""
    table = pd.DataFrame({"=name": TEXTS, "number": range(len(TEXTS)), "x": -1.5})
    text = csv_text(table)
    read = pd.read_csv(io.StringIO(text), keep_default_na=False)
    for cell in [*read.columns, *read["'=name"]]:
        assert not str(cell).startswith(("=", "+", "-", "@", "\t", "\r")), cell
    assert restored(read)["'=name"].tolist() == TEXTS
    assert (read["x"] == -1.5).all() and read["number"].tolist() == [*range(len(TEXTS))]


@thinned("begin", ["=", "@", "+", "-"], every=4)
def test_titles_of_a_scenario_are_no_formulas(begin, tmp_path):
    """In no CSV file of a results folder or a digest; the digest has them as they were."""
    title = f"{begin}HYPERLINK(1)"
    text = SMALL.replace('title = "as it is"', f'title = "{title}"')
    results = ran(tmp_path, labels=("ins",), runs=2, scenario=small(tmp_path, text))
    digest.write(results, tmp_path / "data")
    files = [*(tmp_path / "out").glob("*.csv"), *(tmp_path / "data").glob("*.csv")]
    assert len(files) > 4
    for path in files:
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
        for key in set(table) & {"case", "title", "estimator", "command"}:
            assert not table[key].str.match(r"[=+@-]").any(), (path, key)
    held = digest.read(tmp_path / "data")
    assert title in held.cases["title"].tolist()
    results.store.close()
