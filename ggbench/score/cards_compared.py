"""Comparison of two cards: reproduction, and regressions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..judging.pairs import PairedRuns, compared, judged
from ..judging.statistics import WORSE
from ..spec import scenario
from ..spec.case import CaseSpec
from .card import Card, Question
from .stored_runs import SUITE, ScoreError

TOLERANCE = 1e-5
"""Relative difference of two errors of a run up to which a card is reproduced; cards have six
digits."""


def differences(old: Card, new: Card) -> list[str]:
    """Return in what two cards of the same runs differ, a sentence each; nothing if reproduced.

    Errors may differ by :data:`TOLERANCE`; times are not compared.
    """
    found = []
    for name in ("results_version", "suite", "seed", "runs"):
        if getattr(old, name) != getattr(new, name):
            found.append(f"{name} was {getattr(old, name)} and is {getattr(new, name)}")
    for name in ("source", "parameters"):
        if getattr(old.estimator, name) != getattr(new.estimator, name):
            found.append(f"the estimator's {name} changed")
    questions = {question.case: question for question in new.questions}
    for before in old.questions:
        after = questions.pop(before.case, None)
        if after is None:
            found.append(f"{before.case}: not flown")
        else:
            found += [f"{before.case}: {said}" for said in _changed(before, after)]
    return [*found, *(f"{case}: not in the old card" for case in questions)]


def _changed(before: Question, after: Question) -> Iterator[str]:
    if before.skipped != after.skipped:
        yield f"skipped was '{before.skipped}' and is '{after.skipped}'"
    old, new = (np.array(q.errors_m, dtype=float) for q in (before, after))
    if len(old) != len(new):
        yield f"{len(old)} runs were flown and are {len(new)}"
        return
    apart = ~np.isclose(old, new, rtol=TOLERANCE, atol=0.0, equal_nan=True)
    if apart.any():
        first = int(np.argmax(apart))
        yield (
            f"{apart.sum()} of {len(old)} runs differ, first run {first}: "
            f"{old[first]:g} m was {new[first]:g} m"
        )
    if before.succeeded != after.succeeded:
        yield "other runs succeed"


def worse(old: Card, new: Card) -> list[str]:
    """Return in which questions a new card is surely worse than an old one, a sentence each.

    On the runs that both flew; p-values by Holm over the card, so that of estimators that do not
    differ at most 5% are called worse anywhere. Raise ScoreError if the cards are of other runs.
    """
    if (old.seed, old.suite, old.results_version) != (new.seed, new.suite, new.results_version):
        raise ScoreError(
            "the two cards are of different runs (seed, suite or version of results): score the "
            "old estimator again"
        )
    suite = scenario.load(SUITE)
    before = {question.case: question for question in old.questions if not question.skipped}
    pairs, skipped = [], []
    for question in new.questions:
        other = before.get(question.case)
        if other is None:
            continue
        if question.skipped:
            skipped.append(f"{question.case}: skipped, {question.skipped}")
            continue
        spec = suite.case(question.case)
        flown = _flown(question, spec), _flown(other, spec)
        pairs.append({"case": question.case} | compared(*flown))
    found = [
        f"{pair['case']}: errors are {pair['error_ratio']:.3g} times as large, "
        f"{pair['second_only']} runs succeed no more and {pair['first_only']} newly"
        for pair in judged(pairs)
        if pair["verdict"] == WORSE
    ]
    return found + skipped


def _flown(question: Question, spec: CaseSpec) -> PairedRuns:
    runs = np.arange(len(question.errors_m))
    draws = np.array([spec.cluster(int(run)) for run in runs])
    squares = np.square(np.array(question.errors_m, dtype=float))
    return PairedRuns(runs, draws, squares, np.array(question.succeeded, bool))
