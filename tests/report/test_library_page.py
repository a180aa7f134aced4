"""The front page: findings, the league of the suite, and every scenario."""

from __future__ import annotations

import json
import re

import pytest
from reporting import cases, digest, metrics, pairs

from ggbench.report import library
from ggbench.results import digest as digests


def test_the_front_page_lists_every_scenario_and_the_suite():
    """With the figure of the league, if it is there, and the standing of the filters."""
    text = library.text([digest("suite", "A suite"), digest("ship", "A ship?")])
    assert "- [suite](suite.md): A suite\n- [ship](ship.md): A ship?" in text
    assert "![League of the estimators](suite/answer.png)" in text
    assert "|`ekf`|2|2|1.2|1.2|10 ms|10 ms|" in text
    assert "suite/answer.png" not in library.text([digest("suite")], has_league=False)
    assert "## Suite" not in library.text([digest("ship")])


def test_pages_of_an_earlier_version_are_marked():
    ship, suite = digest("ship", "A ship?"), digest("suite", "A suite")
    assert "Results before version" not in library.text([ship, suite])
    suite.manifest["results_version"] = ship.manifest["results_version"] + 1
    text = library.text([ship, suite])
    assert "A ship? \\*\n- [suite](suite.md): A suite\n" in text
    assert "\\* Results before version" in text


def test_pages_of_other_measurements_are_listed_with_their_answer(tmp_path):
    """The first sentence alone, whose numbers have points, and no page of a scenario."""
    answer = "**Answer.** A run takes 0.4 ms with `ekf`. Others take longer."
    for name, body in {"ship": answer, "speed": answer, "definitions": "- **bound**"}.items():
        (tmp_path / f"{name}.md").write_text(f"# Title\n\n{body}\n")
    digests = [digest("ship", "A ship?")]
    found = library.studies(tmp_path, digests)
    assert found == {"speed": "A run takes 0.4 ms with `ekf`."}
    text = library.text(digests, studies=found)
    assert "- [speed](speed.md): A run takes 0.4 ms with `ekf`.\n" in text
    assert "## Other measurements" not in library.text(digests)


def test_the_front_page_has_one_table_of_ten_rows():
    """Whatever the roster; filters recommended most often come first, then the nearest ones."""
    errors = {"ekf": 1.0} | {f"filter-{k}": 2.0 + k for k in range(12)}
    settled = metrics(10, errors)[lambda table: table["window"] == "settled"]
    suite = digest("suite", metrics=settled, cases=cases(10, best="ekf"))
    assert library.ranking(suite)["estimator"].tolist() == [
        "`ekf`",
        *(f"`filter-{k}`" for k in range(9)),
    ]
    text = library.text([suite])
    assert len(re.findall(r"^\|---", text, re.MULTILINE)) == 1


def test_a_damaged_digest_is_named_and_left_out(tmp_path):
    (tmp_path / "ship" / "data").mkdir(parents=True)
    (tmp_path / "ship" / "data" / "manifest.json").write_text("{")
    found, (remark,) = library.read(tmp_path)
    assert found == [] and "ship/data is damaged" in remark
    with pytest.raises(library.ReportError, match="contains no report with data"):
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
