"""Scores: the same estimator is as good as itself, a wrong one is found, runs are equal."""

from __future__ import annotations

import functools
import tempfile
import textwrap
from pathlib import Path

import numpy as np
import pytest
from thinning import thinned

from ggbench.judging.verdicts import UnequalRunsError
from ggbench.score import scoring, stored_runs
from ggbench.score.card import Card, Question
from ggbench.score.stored_runs import ScoreError

RUNS = 20
CASES = ("air-narrow", "outliers")


@functools.cache
def card_of(label: str, cases: tuple[str, ...] = CASES, seed: int | None = None) -> Card:
    with tempfile.TemporaryDirectory() as folder:
        found = scoring.score(label, Path(folder) / "out", RUNS, seed, cases=cases, jobs=0)
    assert found.card is not None
    return found.card


def question(card: Card, case: str) -> Question:
    return next(q for q in card.questions if q.case == case)


@functools.cache
def stored() -> stored_runs.StoredRuns:
    return stored_runs.read()


@thinned("label", ["ekf", "gaussian-sum"])
def test_a_stored_run_is_found_again(label):
    """Every error is that of the shipped runs, to their seven digits."""
    card = card_of(label)
    for case in CASES:
        runs = stored().runs
        own = runs[(runs["case"] == case) & (runs["estimator"] == label) & (runs["run"] < RUNS)]
        errors = np.sqrt(own.sort_values("run")["settled_position_ms"].to_numpy())
        np.testing.assert_allclose(question(card, case).errors_m, errors, rtol=1e-5)


def test_the_ekf_is_as_good_as_itself():
    for asked in card_of("ekf").questions:
        against = {other.role: other for other in asked.against}
        assert against["ekf"].verdict == "as good"
        assert against["ekf"].error_ratio == pytest.approx(1.0, abs=1e-6)


@pytest.mark.long
def test_a_variance_nine_times_too_small_is_found():
    """The filter is worse and overconfident; too few of its runs are false fixes to be unsafe."""
    asked = question(card_of("ekf[noise_scale=0.333]"), "air-narrow")
    assert asked.consistency == "overconfident"
    assert {other.verdict for other in asked.against} == {"worse"}


@pytest.mark.long
def test_a_variance_nine_times_too_large_is_found(tmp_path):
    """With all public runs of one case the filter is worse, and conservative."""
    found = scoring.score("ekf[noise_scale=3]", tmp_path / "out", cases=("air-narrow",), jobs=0)
    assert found.card is not None
    asked = found.card.questions[0]
    assert asked.consistency == "conservative"
    assert {other.verdict for other in asked.against} == {"worse"}


@pytest.mark.long
def test_with_a_new_seed_the_opponents_fly_too():
    """Another seed gives other runs, equal for both; the card says so."""
    card = card_of("ekf[noise_scale=0.333]", ("air-narrow",), 5)
    assert (card.public, card.seed) == (False, 5)
    asked, public = card.questions[0], question(card_of("ekf[noise_scale=0.333]"), "air-narrow")
    assert asked.errors_m != public.errors_m
    assert {other.runs for other in asked.against} == {RUNS}
    assert asked.against[0].verdict == "worse"


MAP_ERROR = """
    import dataclasses

    import numpy as np

    from ggbench.estimators.ekf import ExtendedKalmanFilter
    from ggbench.problem import Estimator

    @dataclasses.dataclass(frozen=True)
    class Informed(Estimator):
        \"\"\"EKF that knows the map error: 5 E, shared by 50 measurements.\"\"\"

        name = "informed"
        causality = "filter"

        def estimate(self, problem, rng):
            noise = problem.noise_cov + 50 * 5.0**2 * np.eye(len(problem.noise_cov))
            return ExtendedKalmanFilter().estimate(
                dataclasses.replace(problem, noise_cov=noise), rng
            )
"""


@pytest.mark.long
def test_an_estimator_that_is_given_the_map_error_is_better(tmp_path):
    """A filter that adds the map's error to its noise beats the EKF that does not."""
    file = tmp_path / "informed.py"
    file.write_text(textwrap.dedent(MAP_ERROR))
    asked = card_of(str(file), ("map-error",)).questions[0]
    assert asked.against[0].label == "ekf"
    assert asked.against[0].verdict == "better"


SHY = """
    import dataclasses

    from ggbench.problem import Estimator

    @dataclasses.dataclass(frozen=True)
    class Shy(Estimator):
        \"\"\"Takes no case with all six channels, and fails in the others.\"\"\"

        name = "shy"
        causality = "filter"

        def skip(self, problem):
            return "six channels are too many" if problem.noise_cov.shape[0] == 6 else ""

        def estimate(self, problem, rng):
            raise ArithmeticError("no estimate")
"""


def test_cases_that_are_skipped_and_runs_that_fail_are_named(tmp_path):
    """A case that it cannot take has the reason; a failed run has the command that repeats it."""
    file = tmp_path / "shy.py"
    file.write_text(textwrap.dedent(SHY))
    found = scoring.score(
        str(file), tmp_path / "out", 4, cases=("air-narrow", "one-channel"), jobs=0
    )
    assert found.card is not None
    wide, narrow = found.card.questions
    assert (wide.skipped, wide.runs) == ("six channels are too many", 0)
    assert (narrow.failed, narrow.runs, narrow.rms_m) == (4, 4, None)
    assert len(found.failures) == 4
    command = found.failures["command"].iloc[0]
    assert command.startswith("ggbench run suite --case one-channel -e ")
    assert command.endswith("--seed 3702 --run 0")
    with pytest.raises(ScoreError, match="skips all cases: six channels"):
        scoring.score(str(file), tmp_path / "none", 4, cases=("air-narrow",), jobs=0)


def test_a_skip_that_raises_is_a_reason(tmp_path):
    """Of one short line, however long its text is."""
    file = tmp_path / "raising.py"
    raising = 'return "six channels are too many" if problem.noise_cov.shape[0] == 6 else ""'
    assert raising in SHY
    file.write_text(textwrap.dedent(SHY).replace(raising, 'raise KeyError("a" * 9000)'))
    with pytest.raises(ScoreError, match="skips all cases: its skip raises KeyError") as refused:
        scoring.score(str(file), tmp_path / "out", 4, cases=("air-narrow",), jobs=0)
    assert len(str(refused.value)) < 500


def test_unequal_runs_are_refused(monkeypatch, tmp_path):
    """Control: stored runs of which one is missing are never compared."""
    whole = stored()
    fewer = whole.runs[(whole.runs["run"] != 3) | (whole.runs["case"] != "air-narrow")]
    monkeypatch.setattr(scoring, "read", lambda: stored_runs.StoredRuns(whole.header, fewer))
    with pytest.raises(UnequalRunsError, match="air-narrow compares unequal runs"):
        scoring.score("ekf", tmp_path / "out", 5, cases=("air-narrow",), jobs=0)


def test_runs_of_another_suite_are_refused(monkeypatch, tmp_path):
    header = dict(stored().header) | {"scenario_hash": "0" * 64}
    other = stored_runs.StoredRuns(header, stored().runs)
    monkeypatch.setattr(scoring, "read", lambda: other)
    with pytest.raises(ScoreError, match="another suite or results version"):
        scoring.score("ekf", tmp_path / "out", 5, jobs=0)


@pytest.mark.long
def test_odd_runs_alone_are_judged(tmp_path):
    found = scoring.score("ekf", tmp_path / "out", 6, None, "odd", ("air-narrow",), jobs=0)
    assert found.card is not None
    asked = found.card.questions[0]
    assert (asked.runs, asked.against[0].runs, len(asked.errors_m)) == (3, 3, 6)
    expected = np.sqrt(np.mean(np.square(asked.errors_m[1::2])))
    assert asked.rms_m == pytest.approx(expected, rel=1e-5)
