"""Cards: read as written, refused when damaged, compared without false alarms."""

from __future__ import annotations

import json

import numpy as np
import pytest

from ggbench.score import card as cards
from ggbench.score import cards_compared
from ggbench.score.card import Card, CardEstimator, Opponent, Question
from ggbench.score.stored_runs import ScoreError

RUNS = 40


def card(seed: int = 1, factor: float = 1.0, **changes) -> Card:
    """A card of two cases, of errors drawn by a seed and multiplied by a factor."""
    generator = np.random.default_rng(seed)
    questions = []
    for case in ("air-narrow", "ship-narrow"):
        errors = factor * np.sqrt(generator.chisquare(3, RUNS))
        other = Opponent(
            label="ekf", role="ekf", runs=RUNS, rms_m=1.7, error_ratio=1.0, lo=0.9, hi=1.1,
            only_scored=0, only_other=0, verdict="as good",
        )  # fmt: skip
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
        "format": 1, "ggbench": "0", "results_version": 1, "suite": "ab", "seed": 3700,
        "public": True, "runs": RUNS, "judged": "all", "seconds_per_run": {"air-narrow": 0.1},
        "estimator": CardEstimator(label="a.py", name="a", parameters={}, source="cd"),
        "questions": questions,
    }  # fmt: skip
    return Card(**(values | changes))


def test_a_card_is_read_as_it_was_written(tmp_path):
    cards.write(card(), tmp_path / "card.json")
    assert cards.read(tmp_path / "card.json") == card()
    schema = json.loads(cards.schema_text())
    assert set(card().model_dump(mode="json")) <= set(schema["properties"])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "cannot read the card"),
        ("{", "cannot read the card"),
        ("[]", "is no card: the file"),
        ("{}", "is no card: format: field required"),
        ('{"format": 2}', "has format 2; this version reads 1"),
        ("\ud800", "cannot read the card"),
    ],
)
def test_a_bad_card_is_refused_in_a_sentence(content, said, tmp_path):
    path = tmp_path / "card.json"
    if content is not None:
        path.write_bytes(content.encode("utf-8", "surrogatepass"))
    with pytest.raises(ScoreError, match=said):
        cards.read(path)


def test_a_reproduced_card_has_no_differences():
    """Times and digits beyond the sixth are not compared."""
    again = card(factor=1.0 + 1e-7, seconds_per_run={"air-narrow": 0.3}, ggbench="1")
    assert cards_compared.differences(card(), again) == []


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"factor": 1.001}, "air-narrow: 40 of 40 runs differ, first run 0"),
        ({"suite": "xy"}, "suite was ab and is xy"),
        ({"questions": card().questions[:1]}, "ship-narrow: not flown"),
        (
            {"estimator": CardEstimator(label="a.py", name="a", parameters={}, source="ef")},
            "the estimator's source changed",
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


def test_cards_of_other_runs_are_not_compared():
    with pytest.raises(ScoreError, match="different runs"):
        cards_compared.worse(card(), card(seed=1).model_copy(update={"seed": 5}))
