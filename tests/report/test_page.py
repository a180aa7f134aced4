"""The page to share: its numbers are the report's, it needs nothing else, and nobody writes it."""

from __future__ import annotations

import base64
import io
import json
import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import vl_convert
from campaigns import ran, small
from command import invoke
from leagues import EKF, INS, league_of
from pages import HOSTILE, Page, tables_of, written
from PIL import Image
from problems import SMALL
from summaries import SAME, records

from ggbench.figures import stored
from ggbench.figures.locking import Series
from ggbench.report import definitions, league_page, scenario_report
from ggbench.report.page import charts, libraries, prose, reports, writing
from ggbench.report.page.charts import Places
from ggbench.report.page.libraries import PageError
from ggbench.results.folder import Results

ROOT = Path(__file__).parents[2]
LABELS = ("ins", "ekf", "factor-graph[mode=batch]")
SWEEP = """
[sweep]
targets_m = [1.0]

[[sweep.axis]]
key = "gradiometer.noise_eotvos"
name = "noise"
label = "noise"
unit = "E"
values = [0.01, 0.1, 1.0]
scale = "log"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Results of the small scenario, its report in ``text`` and its page in ``page``."""
    path = tmp_path_factory.mktemp("page")
    ran(path, labels=LABELS).store.close()
    text = scenario_report.write(path / "out", path / "text")
    reports.write_report(path / "out", path / "page", {"ekf": "The filter of the house."}, text)
    return path


@pytest.fixture(scope="module")
def page(folder) -> Page:
    return Page(folder / "page" / "small.html")


def curve(*values: float) -> Series:
    held = np.array(values)
    return Series(held, held - 0.1, held + 0.1)


def chart_of(label: str, *names: str) -> charts.Chart:
    figures = {label: curve(*([0.5] * len(names)))}
    return charts.over_cases("answer", Places(names), figures, figures, [label], "Words")


def test_the_tables_are_those_of_the_report(folder, page):
    """Cell by cell and word by word; and it begins with the same answer."""
    text = (folder / "text" / "small.md").read_text(encoding="utf-8")
    assert len(page.tables) > 4
    assert page.tables == tables_of(text)
    shown = (folder / "page" / "small.html").read_text(encoding="utf-8")
    answer = re.search(r"<h1.*?</h1>\s*<p><strong>(.*?)</strong></p>", shown, re.S)
    assert re.sub("<.*?>", "", answer[1]) == text.split("\n\n")[1].strip("*").replace("`", "")


def test_the_page_is_one_file_that_asks_for_nothing(folder, page):
    """Whatever a browser fetches is in it; all else is forbidden, scripts of others included."""
    assert [file.name for file in (folder / "page").iterdir()] == ["small.html"]
    assert (folder / "page" / "small.html").stat().st_size < writing.MOST_BYTES
    assert page.loaded
    assert [a for a in page.loaded if not a.strip("'\"").startswith("data:")] == []
    assert page.policy.startswith("default-src 'none'; img-src data:;")
    assert "http" not in page.policy and "script-src 'sha256-" in page.policy
    assert page.scripts == page.policy.count("'sha256-") == 2


def test_the_figures_show_what_is_stored(folder, page):
    """Errors against time and their bounds are those of the report's figure, case by case."""
    results = Results(folder / "out")
    spec = page.charts["chart-errors"]
    drawn = {(row["case"], row["name"]): row for row in spec["data"]["values"]}
    for case in results.scenario.cases:
        times, errors, bounds = stored.errors_over_time(results, case.name, LABELS)
        curves = {label: median for label, (_, median, _) in errors.items()}
        assert curves.keys() == set(LABELS) and bounds
        for name, values in (curves | bounds).items():
            row = drawn.pop((case.title, name))
            found = np.array([row["position"], row["velocity"]]).T
            np.testing.assert_allclose(found, values, rtol=1e-3)
    assert not drawn
    lookup = spec["vconcat"][0]["transform"][2]["from"]["data"]["values"]
    assert {row["case"] for row in lookup} == {case.title for case in results.scenario.cases}
    np.testing.assert_allclose(lookup[0]["time"], times, rtol=1e-5)
    summary = results.summary().set_index(["case", "label", "window"])
    for row in page.charts["chart-answer"]["data"]["values"]:
        held = summary.loc[row["case"], row["name"], "settled"]
        assert row["share"] == held["success_share"] and row["x"] == row["case"]
        assert row["ratio"] == pytest.approx(held["ratio_median"], rel=1e-5)
        assert row["ratio_hi"] == pytest.approx(held["ratio_quartile_hi"], rel=1e-5)
    results.store.close()


def test_figures_are_of_vega_lite(page):
    """Vega-Lite takes them, and knows every estimator by the colour of the report's figures."""
    for spec in page.charts.values():
        assert vl_convert.vegalite_to_vega(spec)["marks"]
    (layer,) = page.charts["chart-errors"]["vconcat"][1]["layer"]
    scale = layer["encoding"]["color"]["scale"]
    colours = dict(zip(scale["domain"], scale["range"], strict=True))
    assert colours["ekf"] == "#0072b2" and colours["bound: filter"] == "#000000"
    assert colours.keys() >= set(LABELS)


def test_words_of_tables_are_explained(page):
    """By a definition of the one page of definitions, or by what an estimator is."""
    assert {"def-success", "def-bound", "def-error", "def-consistency", "def-cost"} <= page.terms
    assert "est-1" in page.terms
    assert page.terms <= page.ids
    text = definitions.text()
    titles = {title.removesuffix(".") for title in re.findall(r"^\*\*(.*?)\*\*", text, re.M)}
    assert set(definitions.TERMS.values()) == titles


@pytest.mark.parametrize(
    ("head", "title"),
    [
        ("error / bound: median", "Error over bound"), ("95 %", "Error over bound"),
        ("position MRSE [m]", "Error"), ("bound [m]", "Bound"), ("NIS (band)", "Consistency"),
        ("failed / diverged", "Success"), ("ms/run", "Cost"), ("time / ekf", "Cost"),
        ("as good as the best, honest", "As good as the best"), ("verdict", "Verdicts"),
        ("causality", "Causality"), ("scenario", None), ("case", None), ("estimator", None),
    ],
)  # fmt: skip
def test_a_head_is_explained_by_its_definition(head, title):
    assert definitions.title_of(head) == title


def test_most_heads_of_the_reports_are_explained():
    """Of the tables of results in the reports of the library, all but names and plain counts."""
    text = (ROOT / "reports" / "outliers.md").read_text(encoding="utf-8")
    results = [rows[0] for rows in tables_of(text) if {"success", "NEES (band)"} & {*rows[0]}]
    heads = {head for found in results for head in found}
    assert {"success", "NEES (band)", "map points"} <= heads
    plain = {"estimator", "case", "runs judged", "tuned: which"}
    assert {head for head in heads if definitions.title_of(head) is None} <= plain


@pytest.mark.parametrize("name", [HOSTILE, "<img src=x onerror=alert(1)>", "a|b`c", "$&\"'<!--"])
def test_names_are_text_whatever_they_say(name, tmp_path):
    """An estimator, a case or a title that looks like HTML stays what it is, and runs nothing."""
    plain = name.replace("`", "").replace("|", "/")
    text = f"# {plain}\n\n**{plain}** wins.\n\n"
    text += f"| estimator | `{plain}` |\n|---|---|\n| `{plain}` | 1 |"
    chart = chart_of(name, name, "other")
    found = written(tmp_path / "page.html", text, chart, **{plain: name})
    assert found.scripts == 2 and found.loaded == [a for a in found.loaded if "data:" in a]
    assert found.tables == [[["estimator", plain], [plain, "1"]]]
    assert found.charts["chart-answer"] == json.loads(json.dumps(chart.spec))
    assert not [i for i in found.ids if "alert" in i and "<" in i]


def test_rows_stay_between_the_titles_of_their_table():
    """A table may be sorted within its blocks; what all rows do is no title."""
    rows = [
        ["*paper*", "1"], ["*bound*", "2"], ["`b`", "3"], ["`a`", "4"], ["", "*late*"], ["`c`", "5"]
    ]  # fmt: skip
    text = "| estimator | n |\n|---|---|\n" + "".join(f"| {a} | {b} |\n" for a, b in rows)
    (table,) = prose.Prose(lambda *_: "").blocks(text)
    assert re.findall(r'<td class="block">(\d+)</td>', table) == ["1", "3", "4", "4", "5", "6"]
    text = "| situation | n |\n|---|---|\n| **one** | 1 |\n| **two** | 2 |\n"
    (table,) = prose.Prose(lambda *_: "").blocks(text)
    assert 'class="block"' not in table


@pytest.mark.parametrize(
    ("cells", "keys"),
    [
        (["1.5 [1.2, 2]", "–", "12", "– (0 %) †"], ["1.5", "1e300", "12", "1e300"]),
        (["**0.9** (97 %) †", "1.2e+03", "∞"], ["0.9", "1200", "inf"]),
        (["100 % [99 %, 100 %]", "99.5 %", ""], ["100", "99.5", "1e300"]),
        (["3.51, 0.215", "0 / 2", "2.71 to 3"], ["3.51", "0", "2.71"]),
        (["0.01E-1Hz", "0.001E-1Hz"], []),
        (["0.1.0", "0.2.0"], []),
        (["120s", "300s"], []),
        (["–", ""], []),
    ],
)
def test_columns_of_numbers_are_sorted_as_numbers(cells, keys):
    """By the first number of a cell, what has none last; names that begin with one are names."""
    text = "| n |\n|---|\n" + "".join(f"| {cell} |\n" for cell in cells)
    (table,) = prose.Prose(lambda *_: "").blocks(text)
    assert re.findall(r'data-order="(.*?)"', table) == keys


def test_links_lead_within_the_page_or_to_the_web():
    """Those to files that do not come with the page are words."""
    text = "[a](definitions.md) [b](wang2013.md) [c](#rules) [d](https://x.org) [e](javascript:f)"
    (shown,) = prose.Prose(lambda *_: "").blocks(text)
    targets = re.findall(r'href="(.*?)"', shown)
    assert targets == ["#definitions", "#rules", "https://x.org"] and " b " in shown


def test_the_page_of_a_sweep_runs_along_its_axis(tmp_path):
    """Its figure has the values of the first axis, on its scale; every case can be chosen."""
    loaded = small(tmp_path, SMALL[: SMALL.index("[[case]]")] + SWEEP)
    ran(tmp_path, labels=("ins", "ekf"), scenario=loaded).store.close()
    found = Page(reports.write_report(tmp_path / "out", tmp_path, {}))
    spec = found.charts["chart-answer"]
    assert [row["x"] for row in spec["data"]["values"]] == [0.01, 0.1, 1.0]
    assert spec["vconcat"][0]["layer"][0]["encoding"]["x"]["scale"]["type"] == "log"
    (choice,) = found.charts["chart-errors"]["params"]
    assert len(choice["bind"]["options"]) == 3
    for spec in found.charts.values():
        assert vl_convert.vegalite_to_vega(spec)["marks"]


def test_long_series_are_thinned(monkeypatch):
    """A page holds so many numbers at most; the last epoch is always drawn, and that is said."""
    times = np.arange(101.0)
    values = np.stack([times + 1.0, times + 2.0], axis=1)
    monkeypatch.setattr(charts, "MOST_VALUES", 150)
    curves = {"c": (times, {"ekf": values}, {"bound: filter": values})}
    chart = charts.over_time(curves, [], "Words")
    assert chart is not None and "one epoch in 3 is drawn" in chart.caption
    (row, _) = chart.spec["data"]["values"]
    assert row["position"][-1] == 101.0 and len(row["position"]) == 34
    assert charts.over_time({"c": (times, {}, {})}, [], "Words") is None


def test_what_has_no_figure_is_not_drawn(tmp_path):
    """JSON knows no NaN: an estimator without a run has no point, one without success no ratio."""
    shares = {"ekf": curve(0.0, math.nan)}
    chart = charts.over_cases(
        "answer", Places(["a", "b"]), shares, {"ekf": curve(math.nan, math.nan)}, [], "Words"
    )
    (row,) = chart.spec["data"]["values"]
    assert row["case"] == "a" and row["ratio"] is None
    assert written(tmp_path / "page.html", "# Title\n\nWords.", chart).charts


def test_the_page_of_the_league(tmp_path, monkeypatch):
    """It has the report's words and tables, and its figure shows success and error by scenario."""
    held = league_of(s=[[INS, EKF, records("poor", 9.0 * SAME)]], t=[[INS, EKF]])
    monkeypatch.setattr(reports, "read_league", lambda output: (held, []))
    text = league_page.LeagueReport(held, tmp_path).text()
    (tmp_path / "README.md").write_text(text, encoding="utf-8")
    found = Page(reports.write_league(tmp_path, {"ekf": "A filter."}))
    assert found.tables == tables_of(text)
    spec = found.charts["chart-league"]
    assert {(row["name"], row["case"]) for row in spec["data"]["values"]} == {
        (standing.label, name) for standing in held.over_all for name in standing.success
    }
    for row in spec["data"]["values"]:
        (standing,) = (s for s in held.over_all if s.label == row["name"])
        assert row["share"] == pytest.approx(standing.success[row["case"]], rel=1e-5)
        assert row["ratio"] == pytest.approx(standing.ratio[row["case"]], rel=1e-5)
    assert "quartile" not in json.dumps(spec)
    assert vl_convert.vegalite_to_vega(spec)["marks"]


def test_a_missing_package_is_a_sentence(folder, tmp_path, monkeypatch):
    """Before anything is written, and with what to install."""
    monkeypatch.setitem(sys.modules, "vl_convert", None)
    with pytest.raises(PageError, match=r"needs the package vl_convert .*'ggbench\[page\]'"):
        reports.write_report(folder / "out", tmp_path, {})
    assert not [*tmp_path.iterdir()]


def test_a_page_that_is_too_large_is_not_written(tmp_path, monkeypatch):
    monkeypatch.setattr(writing, "MOST_BYTES", 1000)
    with pytest.raises(PageError, match=r"page.html would have \d\.\d MB, more than"):
        written(tmp_path / "page.html", "# Title\n\nWords.")
    assert not [*tmp_path.iterdir()]


def test_pictures_beyond_the_page_are_told(folder, tmp_path, monkeypatch):
    """What does not fit is left out, and its caption says so."""
    monkeypatch.setattr(writing, "_MOST_OF_PICTURES", 0)
    text = (folder / "text" / "small.md").read_text(encoding="utf-8")
    path = writing.write(tmp_path / "page.html", text, folder / "text", {}, {})
    shown = path.read_text(encoding="utf-8")
    assert "<figure><img" not in shown
    assert "(a picture of the report that is not on this page)" in shown


def test_a_picture_keeps_what_is_drawn(folder):
    """Of few colours, and yet the same to the eye: they differ by less than a hundredth."""
    file = folder / "text" / "small" / "position_error.png"
    address = libraries.picture(file)
    head, _, coded = address.partition(",")
    content = base64.b64decode(coded)
    assert head == "data:image/png;base64" and len(content) < file.stat().st_size
    before, after = (
        np.asarray(Image.open(source).convert("RGB"), float)
        for source in (file, io.BytesIO(content))
    )
    assert before.shape == after.shape and np.abs(before - after).mean() < 2.5


@pytest.mark.long
def test_the_command_writes_one_file(folder):
    """NAME.html in the results folder, or where it is told to; what is wrong is a sentence."""
    done = invoke(["report", "out", "--html", "-o", "shared"], folder)
    assert (done.returncode, done.stdout, done.stderr) == (0, "Wrote shared/small.html\n", "")
    assert [file.name for file in (folder / "shared").iterdir()] == ["small.html"]
    assert "Extended Kalman filter" in (folder / "shared" / "small.html").read_text()
    (folder / "blocked").write_text("")
    done = invoke(["report", "out", "--html", "-o", "blocked"], folder)
    assert done.returncode == 2 and done.stderr.startswith("ggbench: cannot write blocked/small")
    done = invoke(["report", "nowhere", "--html"], folder)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
