"""The front page: the suite's matrix in tables that fit, findings, and every scenario."""

from __future__ import annotations

import json

import pytest
from reporting import cases, digest, metrics, pairs

from ggbench.report import library
from ggbench.results import digest as digests


def test_the_front_page_lists_every_scenario_and_the_suite():
    text = library.text([digest("suite", "A suite"), digest("ship", "A ship?")])
    assert "- [suite](suite.md): A suite\n- [ship](ship.md): A ship?" in text
    assert "|`ekf`|5.00 (×1.25)|10.0 (×1.25)|10 ms|" in text
    assert "## Suite" not in library.text([digest("ship")])


def test_the_matrix_is_split_into_tables_that_fit():
    """Ten rows and eight columns at most, estimators with fewer runs apart; nothing is lost."""
    errors = {"ekf": 1.0} | {f"filter-{k}": 2.0 + k for k in range(12)}
    settled = metrics(10, errors, {"filter-3": 5})[lambda table: table["window"] == "settled"]
    tables = library.matrix(digest("suite", metrics=settled, cases=cases(10)))
    assert all(len(table) <= 10 and len(table.columns) <= 8 for table in tables)
    assert sum(table.shape[0] * (table.shape[1] - 1) for table in tables) == 13 * 11
    apart = [table for table in tables if "estimator (5 runs)" in table]
    assert [table["estimator (5 runs)"].tolist() for table in apart] == [["`filter-3`"]] * 2


def test_a_damaged_digest_is_named_and_left_out(tmp_path):
    (tmp_path / "ship" / "data").mkdir(parents=True)
    (tmp_path / "ship" / "data" / "manifest.json").write_text("{")
    found, (remark,) = library.read(tmp_path)
    assert found == [] and "ship/data is damaged" in remark
    with pytest.raises(library.ReportError, match="holds no report with its data"):
        library.write(tmp_path)


def test_texts_stay_texts(tmp_path):
    """A case named 10 or null is no number and no gap, once written and read."""
    named = cases().assign(case=["10", "null"], recommended=["", "ekf"])
    for name, table in (("metrics", metrics()), ("cases", named), ("pairs", pairs())):
        digests.write_csv(table, tmp_path / f"{name}.csv")
    manifest = dict.fromkeys((*digests._KEPT, "title"), "")
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    found = digests.read(tmp_path)
    assert found.cases["case"].tolist() == ["10", "null"]
    assert found.cases["recommended"].tolist() == ["", "ekf"]
    assert found.metrics["consistency"].tolist()[:2] == ["", ""]
