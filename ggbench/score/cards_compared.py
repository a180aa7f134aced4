"""Comparison of two cards: differences, and significant regressions."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from pathlib import PurePath
from typing import Any

import numpy as np

from ..campaign.result_keys import RESULTS_VERSION
from ..judging.pairs import PairedRuns, compared, judged
from ..judging.statistics import WORSE
from ..spec import scenario
from ..spec.case import CaseSpec
from .card import Card, Question
from .stored_runs import SUITE, ScoreError, header

TOLERANCE = 2e-5
"""Largest relative difference of reproduced numbers; the numbers of a card have six digits."""


def differences(old: Card, new: Card) -> list[str]:
    """Return the differences between two cards of the same runs, each as a sentence.

    All values except the folder of the estimator's file are compared. The relative tolerance of
    numbers is :data:`TOLERANCE`. Summary numbers of a case are compared only if the runs of the
    case agree. A reproduced card has no differences.
    """
    sentences = [*_unlike(_conditions(old), _conditions(new))]
    questions = {question.case: question for question in new.questions}
    for before in old.questions:
        after = questions.pop(before.case, None)
        if after is None:
            sentences.append(f"{before.case}: not flown")
        else:
            sentences += [f"{before.case}: {change}" for change in _changed(before, after)]
    return [*sentences, *(f"{case}: not in the old card" for case in questions)]


def _conditions(card: Card) -> dict[str, Any]:
    """Return all values of a card except its questions; the estimator's folder is removed."""
    stated = card.model_dump(exclude={"questions"})
    path, bracket, parameters = card.estimator.label.partition("[")
    stated["estimator"]["label"] = PurePath(path).name + bracket + parameters
    return stated


def _unlike(old: Any, new: Any, place: str = "") -> Iterator[str]:
    """Yield a sentence for each difference between two values of a card."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in dict.fromkeys((*old, *new)):
            yield from _unlike(old.get(key), new.get(key), f"{place}.{key}".lstrip("."))
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for number, pair in enumerate(zip(old, new, strict=True)):
            yield from _unlike(*pair, f"{place}[{number}]")
    elif not _equal(old, new):
        yield f"{place} was {_shown(old)} and is {_shown(new)}"


def _equal(old: Any, new: Any) -> bool:
    if type(old) is type(new) is float:
        return math.isclose(old, new, rel_tol=TOLERANCE)
    return bool(old == new)


def _shown(value: Any) -> str:
    return f"{len(value)} items" if isinstance(value, list) else repr(value)


def _changed(before: Question, after: Question) -> Iterator[str]:
    old, new = (np.array(q.errors_m, dtype=float) for q in (before, after))
    if len(old) == len(new):
        apart = ~np.isclose(old, new, rtol=TOLERANCE, atol=0.0, equal_nan=True)
        if apart.any():
            first = int(np.argmax(apart))
            yield (
                f"{apart.sum()} of {len(old)} runs differ; the first is run {first}, with "
                f"{old[first]:g} m before and {new[first]:g} m now"
            )
            return
        if before.succeeded != after.succeeded:
            yield "other runs succeed"
            return
    yield from _unlike(before.model_dump(), after.model_dump())


def require_comparable(old: Card, cases: Collection[str], seed: int | None) -> None:
    """Raise ScoreError if a new score could not be compared with an old card.

    Parameters
    ----------
    old : old card.
    cases : names of the cases of the new score; empty: all.
    seed : seed of the new score; None: the public seed.
    """
    suite = scenario.load(SUITE)
    public = int(header()["seed"])
    _require_same_runs(
        (old.seed, old.suite, old.results_version),
        (public if seed is None else seed, suite.content_hash, RESULTS_VERSION),
    )
    flown = [question.case for question in old.questions if not question.skipped]
    if not set(flown) & set(cases or (case.name for case in suite.cases)):
        raise ScoreError(
            "none of the requested cases has results in the old card: "
            + (f"it has results of {', '.join(flown)}" if flown else "its estimator skipped all")
        )


def _require_same_runs(old: tuple[int, str, int], new: tuple[int, str, int]) -> None:
    """Raise ScoreError unless seed, suite and version of results are the same."""
    names = ("seed", "suite", "version of results")
    for name, one, other in zip(names, old, new, strict=True):
        if one != other:
            raise ScoreError(
                f"the cards have different runs ({name} {one} and {other}): score the old "
                "estimator again"
            )


def worse(old: Card, new: Card) -> list[str]:
    """Return the cases in which a new card is significantly worse, each as a sentence.

    Cases that the estimator newly skips are returned too. Only common runs are compared. The
    p-values are adjusted by Holm's procedure over the card. Therefore at most 5% of the comparisons
    of equal estimators report a regression. Raise ScoreError if the cards differ in seed, suite or
    version of results, or have no case in common.
    """
    _require_same_runs(
        (old.seed, old.suite, old.results_version), (new.seed, new.suite, new.results_version)
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
    if not pairs and not skipped:
        raise ScoreError("the old card has no results in any case of the new card")
    sentences = [
        f"{pair['case']}: errors are {pair['error_ratio']:.3g} times as large; "
        f"{pair['second_only']} runs no longer succeed, {pair['first_only']} newly succeed"
        for pair in judged(pairs)
        if pair["verdict"] == WORSE
    ]
    return sentences + skipped


def _flown(question: Question, spec: CaseSpec) -> PairedRuns:
    runs = np.arange(len(question.errors_m))
    draws = np.array([spec.cluster(int(run)) for run in runs])
    squares = np.square(np.array(question.errors_m, dtype=float))
    return PairedRuns(runs, draws, squares, np.array(question.succeeded, bool))
