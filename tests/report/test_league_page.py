"""The front page of the reports: its figures follow the data, and its gaps are explained."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from leagues import EKF, INS, digest_of, dishonest, entry, league_of, page, renamed
from summaries import RUNS, SAME, records

from ggbench.figures.numbers import short
from ggbench.report import advice_section, league, league_page
from ggbench.report.league import Entry, League
from ggbench.report.scenario_report import ReportError
from ggbench.report.situations import SITUATIONS

MEDIAN = float(np.median(np.sqrt(SAME)))
SMOOTHER = records("gauss-newton", 0.25 * SAME, "batch", seconds=0.04)


@pytest.fixture(autouse=True)
def no_figures(monkeypatch) -> None:
    monkeypatch.setattr(league_page, "save", lambda figure, path: None)


def section(text: str, title: str) -> str:
    return text.partition(f"## {title}\n")[2].partition("\n## ")[0]


def table(text: str) -> tuple[list[str], list[list[str]]]:
    """Heading and rows of cells of the first table of a text."""
    block = re.search(r"(^\|.*\n?)+", text, re.MULTILINE)[0]
    head, _, *rows = [[c.strip() for c in line[1:-1].split("|")] for line in block.splitlines()]
    return head, rows


def advised(text: str, situation: str = "Narrow prior") -> dict[str, str]:
    """The row of a situation in the page's first table, by its heading."""
    head, rows = table(text)
    (row,) = (row for row in rows if situation in row[0])
    return dict(zip(head, row, strict=True))


def short_of(text: str, situation: str = "Narrow prior") -> str:
    """What is said of those that are not as good in a situation."""
    found = re.findall(rf"^- \*\*{situation}.*$", section(text, "Why not another"), re.MULTILINE)
    (line,) = found
    return line


def test_the_advice_is_told_with_its_figures(tmp_path):
    """The choice, its success, distance from the bound and time; who else is, and who is not."""
    held = league_of(
        s=[[INS, EKF, records("slow", SAME, seconds=0.1), records("poor", 9.0 * SAME)]]
    )
    text = page(held, tmp_path)
    assert list(advised(text).values())[1:] == [
        "1 in 1 scenario", "**`ekf`**", "100 %", "100 %", "100 % [94 %, 100 %] of 60",
        short(MEDIAN), "10.0", "`slow` (10.0)",
    ]  # fmt: skip
    assert short_of(text).endswith(
        f"`poor` (as good in 0 %; success 100 %, {short(3.0 * MEDIAN)} × the bound)."
    )
    assert "`slow`" not in short_of(text) and "`ekf`" not in short_of(text)


def test_where_all_are_good_nobody_falls_short(tmp_path):
    text = page(league_of(s=[[INS, EKF]]), tmp_path)
    assert short_of(text).endswith("s: nobody falls short of it.")
    assert list(advised(text).values())[-1] == ""


def test_where_nobody_is_good_everywhere_that_is_said(tmp_path):
    """Two that are best in one scenario each: none is advised; the first is not listed twice."""
    poor = 9.0 * SAME
    held = league_of(
        a=[[INS, EKF, records("ukf", poor)]], b=[[INS, records("ekf", poor), records("ukf", SAME)]]
    )
    text = page(held, tmp_path)
    row = list(advised(text).values())
    assert row[1] == "2 in 2 scenarios"
    assert re.fullmatch("none; most often `(ekf|ukf)`", row[2])
    assert (row[3], row[-1]) == ("50 %", "")
    told = row[2] + short_of(text)
    assert (told.count("`ekf`"), told.count("`ukf`")) == (1, 1)
    assert re.search(
        r"\(most often `(ekf|ukf)`, 50 %: 10.0 ms a run, [\d.]+ × the bound, success in 100 %", text
    )


def test_where_nobody_is_good_in_half_nobody_is_named(tmp_path):
    """Who leads with a third does so by chance, and its figures would be taken for advice."""
    poor = 9.0 * SAME
    names = ("ekf", "ukf", "gaussian-sum")
    held = league_of(
        **{f"s{n}": [[INS, *(records(k, SAME if k == best else poor) for k in names)]]
           for n, best in enumerate(names)}
    )  # fmt: skip
    text = page(held, tmp_path)
    row = list(advised(text).values())
    assert row[2] == "none; nor in half of them" and set(row[3:]) == {""}
    assert "in all of 3 cases, nor in half of them" in text


def test_runs_that_are_too_few_are_told(tmp_path, monkeypatch):
    """Beside the share in which an estimator is good, of it that which nobody can tell."""
    held = league_of(s=[[INS, EKF, records("ukf", SAME, seconds=0.001)]])
    assert advised(page(held, tmp_path))["good in"] == "100 %"
    monkeypatch.setattr(league.Flown, "open", lambda flown, label: label == "ukf")
    row = advised(page(held, tmp_path))
    assert row["use"] == "**`ukf`**"
    assert row["good in"] == "100 % (in 100 % too few runs to tell)"


def test_the_league_begins_with_all_causal_ones_of_the_roster(tmp_path):
    """The share of the common cases in which each is good, and its time; no smoother."""
    text = page(league_of(s=[[INS, EKF, records("tercom", 9.0 * SAME), SMOOTHER]]), tmp_path)
    line = section(text, "The league").strip().splitlines()[0]
    assert line.startswith("Over the 1 case that the whole roster ran")
    assert line.endswith("`ekf` in 100 % (10.0 ms a run), `tercom` in 0 % (10.0 ms a run).")


def test_the_page_tells_of_aiding_that_gains_nothing(tmp_path):
    """The INS alone, and in which cases."""
    text = page(league_of(a=[[records("ins", SAME, "none"), EKF]]), tmp_path)
    row = list(advised(text, "Aiding gains nothing").values())
    assert row[1:] == ["1 in 1 scenario", "`ins`: no causal estimator beats it", *[""] * 6]
    assert short_of(text, "Aiding gains nothing").endswith("beats the INS in a/c0.")
    assert table(section(text, "The scenarios"))[1][0][3] == "`ekf`; gains nothing"


def test_the_page_follows_the_data(tmp_path):
    """Of fifteen runs more that are lost the text changes, where it speaks of that estimator."""
    ins = records("ins", 1e4 * SAME, "none", locked=0.0)
    whole, lost = (records("ekf", SAME, locked=1.0) for _ in range(2))
    for record in lost[:15]:
        record["diverged"] = True
    one, other = (page(league_of(s=[[ins, group]]), tmp_path) for group in (whole, lost))
    assert (advised(one)["success"], advised(other)["success"]) == ("100 %", "75 %")
    for text, share, cell in ((one, "100 %", ""), (other, "75 %", " (75 %)")):
        head, rows = table(section(text, "The league"))
        assert rows[0][head.index("success")] == share
        cells = dict(zip(*(lambda h, r: (h, r[0]))(*table(section(text, "Scenario by scenario"))),
                         strict=True))  # fmt: skip
        assert cells["`ekf`"].endswith(cell) and ("%" in cells["`ekf`"]) == bool(cell)
    assert table(section(other, "The league"))[1][0][7] == "25 %"  # lost


def test_what_the_answer_after_the_fact_is_worth(tmp_path):
    """The smoother's error beside that of the best causal one, run by run, and its cost."""
    text = page(league_of(s=[[INS, EKF, SMOOTHER]]), tmp_path)
    assert (
        "**If the answer may wait**: the error of `gauss-newton` (batch, 4.00 × the time of `ekf`) "
        "over that of the best causal estimator, run by run. Narrow prior (σ/ℓ below 0.2): 0.500."
    ) in text
    assert "If the answer may wait" not in page(league_of(s=[[INS, EKF]]), tmp_path)


def test_the_league_has_a_place_for_causal_ones_alone(tmp_path):
    """Cells without a figure are those of ranks, of what is not causal."""
    text = page(league_of(s=[[INS, EKF, records("tercom", 4.0 * SAME), SMOOTHER]]), tmp_path)
    head, rows = table(section(text, "The league"))
    assert [row[:2] for row in rows] == [
        ["1", "`ekf`"], ["2", "`tercom`"], ["", "`ins`"], ["", "*smoothers*"],
        ["", "`gauss-newton`"],
    ]  # fmt: skip
    for row in rows:
        empty = {title for title, cell in zip(head, row, strict=True) if not cell}
        if row[1] not in ("*smoothers*",):
            ranks = {"", "as good as the best, honest", "too few runs to tell"}
            assert empty == (set() if row[0] else ranks)


def test_no_gap_is_without_its_reason(tmp_path):
    """Every – of the table of scenarios is an estimator that is named below, with the reason."""
    roster = [renamed(EKF, label) for label in league.STANDARD]
    held = League(
        [
            entry("whole", [INS, *roster]),
            entry("some", [INS, *roster[:4]], left_out={"tercom": "no map"}),
        ]
    )
    text = page(held, tmp_path)
    head, rows = table(section(text, "Scenario by scenario"))
    gaps = {
        (re.match(r"\[(.*)\]", row[0])[1], title)
        for row in rows
        for title, cell in zip(head, row, strict=True)
        if cell in ("", "–")
    }
    assert gaps == {("some", f"`{label}`") for label in league.STANDARD[4:]}
    (told,) = re.findall(r"^- \[some\]\(some.md\): .*$", text, re.MULTILINE)
    reasons = dict(reversed(part.rsplit(" (", 1)) for part in told.split(": ", 1)[1].split("; "))
    assert reasons["no map)"] == "`tercom`"
    assert set(reasons) == {"no map)", "the scenario does not ask for it)"}
    for _, title in gaps:
        assert title in told
    assert "The whole roster ran in every scenario" not in text


def test_without_a_common_case_nobody_is_ranked(tmp_path):
    """The page says so, and each scenario has its figures all the same."""
    text = page(league_of(a=[[INS, EKF]], b=[[INS, records("tercom", SAME)]]), tmp_path)
    assert "nobody is ranked" in section(text, "The league")
    head, rows = table(section(text, "Scenario by scenario"))
    assert head == ["scenario", "`ekf`", "`tercom`"]
    assert [row[1:] for row in rows] == [[short(MEDIAN), "–"], ["–", short(MEDIAN)]]


def test_others_are_listed_and_not_ranked(tmp_path):
    """What two scenarios ran beyond the roster, with – where a smoother is beside no best one."""
    mine, late = records("mine", SAME), records("late", SAME, "batch")
    alone = records("alone", SAME)
    text = page(league_of(a=[[INS, EKF, mine, late, alone]], b=[[INS, EKF, mine, late]]), tmp_path)
    found = section(text, "Scenario by scenario").split("| beyond the roster")[1]
    cells = {row[0]: row for row in table("| beyond the roster" + found)[1]}
    assert set(cells) == {"`mine`", "`late`"}
    assert cells["`mine`"][1:4] == ["2", "2", "100 %"]
    assert cells["`late`"][3] == "–"


def test_scenarios_are_listed_with_ins_best_and_bound(tmp_path):
    """Geometric means over the cases of medians: of the INS, of the best, and of its bound."""
    text = page(league_of(a=[[INS, EKF], [INS, records("ukf", 16.0 * SAME)], [INS, EKF]]), tmp_path)
    (row,) = table(section(text, "The scenarios"))[1]
    assert row[:4] == [
        "[A short flight over the normal field](a.md)",
        "For tests of everything that is not physics.", "3", "`ekf` (2), `ukf` (1)",
    ]  # fmt: skip
    wanted = (100.0 * MEDIAN, 4.0 ** (1.0 / 3.0) * MEDIAN, 1.0)
    assert [float(cell) for cell in row[4:]] == pytest.approx(wanted, rel=0.01)


def test_how_it_was_made_names_runs_versions_and_what_is_left_out(tmp_path):
    """Fewer runs, two versions of results, the remarks; assumptions if they were run."""
    fewer = digest_of("b", [INS, EKF], results_version=2, assumptions=True,
                      done={"ins": RUNS, "ekf": 40})  # fmt: skip
    found = league.entry_of(fewer)
    assert isinstance(found, Entry)
    text = page(League([entry("a", [INS, EKF]), found]), tmp_path, "c is left out")
    making = section(text, "How this was made")
    rows = {row[0]: row for row in table(making)[1]}
    assert rows["a"] == ["a", "60", "7", "2026-01-02", "1.0", "1", "0123456789abcdef", ""]
    assert (rows["b"][5], rows["b"][7]) == ("2", "`ekf` 40")
    assert "2 different versions of results" in making and "- c is left out" in making
    assert "ggbench run --all --assumptions -o results" in making


def test_links_are_quoted_and_lead_to_reports(tmp_path):
    """A name with a blank is a link all the same; all others are of the page's own folder."""
    text = page(league_of(**{"my own": [[INS, EKF]]}), tmp_path)
    links = set(re.findall(r"\]\(([^)]+)\)", text))
    assert links == {"my%20own.md", "definitions.md", "#rules", "README/league.png"}


def test_of_nothing_there_is_no_page(tmp_path):
    """A sentence, with the reasons."""
    with pytest.raises(ReportError, match="no scenario is finished that could be reported"):
        league_page.write(tmp_path)
    damaged = tmp_path / "s" / "data"
    damaged.mkdir(parents=True)
    (damaged / "manifest.json").write_text("{")
    with pytest.raises(ReportError, match=r"reported; .*data is damaged"):
        league_page.write(tmp_path)
    assert not Path(tmp_path / "README.md").exists()


@pytest.mark.parametrize(
    ("text", "first"),
    [
        ("One. Two.", "One."),
        ("As Wang et al. Did it over 3.5 km. Then.", "As Wang et al. Did it over 3.5 km."),
        ("Which of them? All.", "Which of them?"),
        ("no end", "no end"),
        ("a\nline. B", "a line."),
    ],
)
def test_the_first_sentence(text, first):
    assert league_page.first_sentence(text) == first


@pytest.mark.parametrize(
    ("share", "text"), [(0.0, "0 %"), (0.004, "0.4 %"), (0.25, "25 %"), (0.996, "99.6 %")]
)
def test_shares_are_in_percent(share, text):
    """Those near none and all with a digit behind the point."""
    assert league_page.percent(share) == text


def test_the_answer_has_a_line_for_each_group_of_situations(tmp_path):
    """What to use, its cost, how near and how sure; where nothing is good, in how many cases."""
    liar = dishonest(records("liar", SAME))
    held = league_of(
        good=[[INS, EKF]], idle=[[records("ins", SAME, "none"), EKF]], lied=[[INS, liar]]
    )
    moved = [dataclasses.replace(f, situation="map") for f in held.cases if f.scenario == "lied"]
    held.cases = [*(f for f in held.cases if f.scenario != "lied"), *moved]
    lines = [line for line in page(held, tmp_path).splitlines() if line.startswith("- **")][:3]
    assert lines == [
        f"- **The model is right.** Narrow prior (σ/ℓ below 0.2): **`ekf`**, 10.0 ms a run, "
        f"{short(MEDIAN)} × the bound, success in 100 % [94 %, 100 %] where it is least.",
        "- **The map is wrong.** Error of the map not told, or told as white noise: no estimator "
        "is honest and good in 1 case; the best of each case leaves "
        "0.0100 of the INS's error; in 1 of them nobody is honest.",
        "- **Aiding gains nothing.** No causal estimator beats the INS in 1 case of `idle`.",
    ]
    told = [key for situations in advice_section._LINES.values() for key in situations]
    assert sorted(told) == sorted(SITUATIONS)
