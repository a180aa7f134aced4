"""Cards: read as written, refused when damaged, compared without false alarms."""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from markdown_it import MarkdownIt
from refusals import refused

from ggbench.score import card as cards
from ggbench.score import cards_compared, page, stored_runs
from ggbench.score.card import Card, CardEstimator, Opponent, Question
from ggbench.score.stored_runs import ScoreError

RUNS = 40
CASES = ("air-narrow", "ship-narrow")


def card(seed: int = 1, factor: float = 1.0, **changes) -> Card:
    """A card of two cases, of errors drawn by a seed and multiplied by a factor."""
    generator = np.random.default_rng(seed)
    questions = []
    for case in CASES:
        errors = factor * np.sqrt(generator.chisquare(3, RUNS))
        other = Opponent(
            label="ekf",
            role="ekf",
            runs=RUNS,
            rms_m=1.7,
            error_ratio=1.0,
            lo=0.9,
            hi=1.1,
            only_scored=0,
            only_other=0,
            verdict="as good",
        )
        questions.append(
            Question(
                case=case,
                title=case,
                runs=RUNS,
                rms_m=1.7,
                success=1.0,
                against=[other],
                errors_m=[cards.rounded(error) for error in errors],
                succeeded=[True] * RUNS,
            )
        )
    values = {
        "format": cards.FORMAT,
        "ggbench": "0",
        "results_version": 1,
        "suite": "ab",
        "seed": 3702,
        "public": True,
        "runs": RUNS,
        "judged": "all",
        "estimator": CardEstimator(label="a.py", name="a", parameters={}, source="cd"),
        "questions": questions,
    }
    return Card(**(values | changes))


def test_a_card_is_read_as_it_was_written(tmp_path):
    cards.write(card(), tmp_path / "card.json")
    assert cards.read(tmp_path / "card.json") == card()
    marked = tmp_path / "marked.json"
    marked.write_bytes(b"\xef\xbb\xbf" + (tmp_path / "card.json").read_bytes())
    assert cards.read(marked) == card()
    schema = json.loads(cards.schema_text())
    assert set(card().model_dump(mode="json")) <= set(schema["properties"])


def test_a_reproduced_card_has_no_differences():
    """Digits beyond the fifth are not compared, nor the folder of the estimator's file."""
    moved = card().estimator.model_copy(update={"label": "elsewhere/a.py"})
    again = card(factor=1.0 + 1e-7, estimator=moved)
    assert cards_compared.differences(card(), again) == []


def leaves(value: object, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Yield the place of every text, number, truth value and null of a JSON document."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, item in items:
            yield from leaves(item, (*path, key))
    else:
        yield path


EDITS = {
    str: lambda text: f"{text}x",
    bool: lambda truth: not truth,
    int: lambda n: n + 1,
    float: lambda x: 1.001 * x,
    type(None): lambda none: 0.5,
}


def test_every_edit_of_a_card_is_found(tmp_path):
    """Of each value of a card, one that is changed alone: refused as no card, or a difference."""
    whole = card().model_dump(mode="json")
    places = [*leaves(whole)]
    assert len(places) > 2 * (2 * RUNS + 20)
    for place in places:
        edited = json.loads(json.dumps(whole))
        holder = functools.reduce(lambda value, key: value[key], place[:-1], edited)
        holder[place[-1]] = EDITS[type(holder[place[-1]])](holder[place[-1]])
        (tmp_path / "card.json").write_text(json.dumps(edited))
        try:
            found = cards_compared.differences(cards.read(tmp_path / "card.json"), card())
        except ScoreError:
            continue
        assert found, place


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"factor": 1.001}, "air-narrow: 40 of 40 runs differ; the first is run 0"),
        ({"suite": "xy"}, "suite was 'ab' and is 'xy'"),
        ({"questions": card().questions[:1]}, "ship-narrow: not flown"),
        (
            {"estimator": CardEstimator(label="a.py", name="a", parameters={}, source="ef")},
            "estimator.source was 'cd' and is 'ef'",
        ),
    ],
)
def test_what_differs_is_said(changes, said):
    found = cards_compared.differences(card(), card(**changes))
    assert any(sentence.startswith(said) for sentence in found)


def test_a_worse_card_is_found():
    """Errors 30 % larger in every run, and control: 30 % smaller is not worse."""
    found = cards_compared.worse(card(), card(factor=1.3))
    assert len(found) == 2
    assert found[0].startswith("air-narrow: errors are 1.3 times as large")
    assert cards_compared.worse(card(), card(factor=0.7)) == []


def test_a_case_that_is_skipped_now_is_worse():
    first, second = card().questions
    skipped = Question(case=second.case, title=second.title, skipped="too long")
    assert cards_compared.worse(card(), card(questions=[first, skipped])) == [
        "ship-narrow: skipped, too long"
    ]


@pytest.mark.long
def test_false_alarms_of_two_cards():
    """Cards of one law are called worse in 5 % of 400 pairs at most: standard error 1.1 %, two."""
    alarms = sum(
        bool(cards_compared.worse(card(seed=2 * k), card(seed=2 * k + 1))) for k in range(400)
    )
    assert alarms / 400 < 0.072


def with_cases(*cases: str, **changes: object) -> Card:
    """A card of other cases."""
    pairs = zip(card().questions, cases, strict=True)
    renamed = [question.model_copy(update={"case": case} | changes) for question, case in pairs]
    return card(questions=renamed)


NO_JSON = "cannot read the card"
NO_CARD = "is no card: .*"
BAD_CARDS: dict[str, tuple[object, str]] = {
    "no file": (None, NO_JSON),
    "an open bracket": ("{", NO_JSON),
    "a list": ("[]", "is no card: the file"),
    "an empty object": ("{}", "is no card: format: field required"),
    "an earlier format": ('{"format": 1}', "has format 1; this version reads 2"),
    "5000 lists": ("[" * 5000, NO_JSON),
    "a format of 5000 digits": (f'{{"format": {"9" * 5000}}}', NO_JSON),
    "half a character": ("\ud800", NO_JSON),
    "a negative number of runs": (
        {"runs": -1},
        f"{NO_CARD}runs: input should be greater than or equal to 1",
    ),
    "a huge number of runs": (
        {"runs": 10**19},
        f"{NO_CARD}runs: input should be less than or equal to 1000000",
    ),
    "errors of other runs": ({"runs": 3}, f"{NO_CARD}errors_m must have one value per run, 3,"),
    "a negative seed": (
        {"seed": -5},
        f"{NO_CARD}seed: input should be greater than or equal to 0",
    ),
    "no questions": (
        {"questions": []},
        f"{NO_CARD}questions: list should have at least 1",
    ),
    "one success": (
        {"questions.0.succeeded": [True]},
        f"{NO_CARD}errors_m and succeeded must have a value for each run",
    ),
    "no opponent": ({"questions.0.against": []}, f"{NO_CARD}against must contain the role ekf"),
    "a case twice": (
        {"questions.0.case": CASES[1]},
        f"{NO_CARD}two questions are of the same case",
    ),
    "an infinite error": ({"questions.0.rms_m": float("inf")}, f"{NO_CARD}rms_m"),
    "a list as parameter": (
        {"estimator.parameters": {"a": [[1]]}},
        rf"{NO_CARD}estimator\.parameters\.a",
    ),
}
"""Texts of a file or changes of a card, and messages."""


@pytest.mark.parametrize("kind", BAD_CARDS)
def test_a_bad_card_is_refused_in_one_sentence(kind, tmp_path):
    content, message = BAD_CARDS[kind]
    path = tmp_path / "card.json"
    if isinstance(content, dict):
        path.write_text(changed_text(content))
    elif isinstance(content, str):
        path.write_bytes(content.encode("utf-8", "surrogatepass"))
    with refused(ScoreError, message):
        cards.read(path)


def changed_text(changes: dict[str, object]) -> str:
    """The card's text with values at dotted places changed."""
    changed = card().model_dump(mode="json")
    for place, value in changes.items():
        *path, last = place.split(".")
        holder = functools.reduce(lambda v, k: v[int(k)] if k.isdigit() else v[k], path, changed)
        holder[last] = value
    return json.dumps(changed)


def test_cards_with_a_case_in_common_are_compared():
    assert cards_compared.worse(with_cases("outliers", CASES[1]), card()) == []


def comparable() -> Card:
    """A card of the suite, seed and version of results of here."""
    here = stored_runs.header()
    return card(
        seed=here["seed"], suite=here["scenario_hash"], results_version=here["results_version"]
    )


def test_a_card_may_be_compared_before_a_score_is_flown():
    old = comparable()
    cards_compared.require_comparable(old, (), None)
    cards_compared.require_comparable(old, CASES[:1], stored_runs.header()["seed"])


BAD_COMPARISONS = {
    "a card of another seed": (
        lambda: cards_compared.worse(card(), card().model_copy(update={"seed": 5})),
        r"different runs \(seed 3702 and 5\)",
    ),
    "cards of other cases": (
        lambda: cards_compared.worse(with_cases("outliers", "map-error"), card()),
        "old card has no results in any case of the new card",
    ),
    "a card that skipped all": (
        lambda: cards_compared.worse(with_cases(*CASES, skipped="too long"), card()),
        "old card has no results in any case of the new card",
    ),
    "a score of another case": (
        lambda: cards_compared.require_comparable(comparable(), ("outliers",), None),
        "none of the requested cases has results in the old card: it has results of air",
    ),
    "a score of another seed": (
        lambda: cards_compared.require_comparable(comparable(), (), 7),
        "different runs .seed 3702 and 7",
    ),
    "a score of another suite": (
        lambda: before_a_score(suite="ab"),
        "different runs .suite ab and",
    ),
    "a score of another version": (
        lambda: before_a_score(results_version=-1),
        "different runs .version of results -1 and",
    ),
}


def before_a_score(**changes: object) -> None:
    old = comparable().model_copy(update=changes)
    cards_compared.require_comparable(old, (), None)


@pytest.mark.parametrize("kind", BAD_COMPARISONS)
def test_cards_that_cannot_be_compared_are_refused_in_one_sentence(kind):
    compare, message = BAD_COMPARISONS[kind]
    with refused(ScoreError, message):
        compare()


def test_a_card_is_no_larger_than_its_limit(monkeypatch, tmp_path):
    """What is read of a file without an end is bounded."""
    monkeypatch.setattr(cards, "MOST_BYTES", 1000)
    cards.write(card(), tmp_path / "card.json")
    for path in (tmp_path / "card.json", Path("/dev/zero")):
        with pytest.raises(ScoreError, match=r"it has more than 0\.001 MB"):
            cards.read(path)


HOSTILE = "a`b\n\n# Heading ![x](http://e) <b>|\x1b[31m"


def test_texts_of_an_estimator_stay_texts_on_a_page(tmp_path):
    """Its label, why it skips, and why runs failed: no heading, image, HTML or cell of a table."""
    told = card().estimator.model_copy(update={"label": HOSTILE})
    first, second = card().questions
    skipped = Question(case=second.case, title=second.title, skipped=HOSTILE)
    shown = Card.model_validate(card(estimator=told, questions=[first, skipped]).model_dump())
    failures = pd.DataFrame(
        [{"case": "air-narrow", "run": 1, "reason": HOSTILE, "command": HOSTILE}]
    )
    for path in page.write(shown, failures, tmp_path):
        text = path.read_text(encoding="utf-8")
        assert "\x1b" not in text
        parser = MarkdownIt("commonmark", {"html": True}).enable("table")
        html = text if path.suffix == ".html" else parser.render(text)
        # The only image is the card's own picture.
        assert html.count("<img") == 1 and "http://e" not in "".join(re.findall("<img[^>]*>", html))
        assert "<b>" not in html
        assert len(re.findall("<h[1-6]", html)) == 3
        assert len(re.findall("<td[ >]", html.split("<tr>")[-1])) == 3
    assert (tmp_path / "card.png").stat().st_size > 5000


def test_failures_of_a_kind_are_one_line(tmp_path):
    """Kinds differ in more than numbers; diverged runs have a reason; long ones are cut."""
    rows = [
        ("air-narrow", k, f"ValueError: epoch {k} has 1e-{k} m", f"again {k}") for k in range(9)
    ]
    rows += [("ship-narrow", 3, "ValueError: epoch 3 has 1.5 m", "again s")]
    rows += [("air-narrow", 11, "", "again d"), ("air-narrow", 12, "x" * 9000, "again x")]
    failures = pd.DataFrame(rows, columns=["case", "run", "reason", "command"])
    first, *others = page.kinds_of_failures(failures)
    assert first == (
        "ValueError: epoch 0 has 1e-0 m",
        "9 of air-narrow, 1 of ship-narrow",
        "again 0",
    )
    diverged, cut = (reason for reason, _, _ in others)
    assert diverged.startswith("diverged: the final error exceeds")
    assert len(cut) == 300 and cut.endswith("…")
    assert page.kinds_of_failures(failures.iloc[:0]) == []
    text = page.write(card(), failures, tmp_path)[0].read_text()
    assert text.count("`again ") == 3


def test_a_card_has_the_name_of_the_estimator(tmp_path):
    """As reports do; the conditions name the file."""
    mine = card().model_copy(
        update={
            "estimator": card().estimator.model_copy(
                update={"label": "a/my_file.py[gain=2]", "name": "mine"}
            )
        }
    )
    for path in page.write(
        mine, pd.DataFrame(columns=["case", "run", "reason", "command"]), tmp_path
    ):
        text = path.read_text(encoding="utf-8")
        assert "Scorecard of" in text and "mine[gain=2]" in text
        assert text.count("a/my_file.py[gain=2]") == 1


@pytest.mark.long
@pytest.mark.parametrize(("width", "stacked"), [(400, True), (1280, False)])
def test_a_card_fits_on_a_telephone(width, stacked, tmp_path, browser):
    """Nothing is cut at 400 pixels: cells of a row stand below each other, behind their heads."""
    rows = [("air-narrow", 1, "ValueError: " + "word " * 40, f"ggbench run suite {'x' * 300}")]
    failures = pd.DataFrame(rows, columns=["case", "run", "reason", "command"])
    written = page.write(card(), failures, tmp_path)[1]
    opened = browser.new_page(viewport={"width": width, "height": 900})
    opened.goto(written.as_uri())
    assert opened.evaluate("document.documentElement.scrollWidth") <= width
    cut = "all => all.filter(e => e.scrollWidth > e.clientWidth + 1).length"
    assert opened.locator("table, td").evaluate_all(cut) == 0
    assert opened.locator("table").count() == 2
    for table in opened.locator("table").all():
        assert table.locator("th").first.is_visible() is not stacked
        cells = [cell.bounding_box() for cell in table.locator("tr").nth(1).locator("td").all()]
        assert (cells[0]["x"] == cells[1]["x"]) is stacked
    head = "e => getComputedStyle(e, '::before').content"
    assert (page.HEAD[1] in opened.locator("td").nth(1).evaluate(head)) is stacked
    opened.close()
