"""Scoring of an estimator: runs of the suite, and comparison with stored runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from ..campaign import campaign, running
from ..campaign.flights import first_problem
from ..campaign.registry import Choice, choose
from ..campaign.result_keys import RESULTS_VERSION
from ..campaign.texts import refusal
from ..judging.pairs import PairedRuns, compared, judged, kind
from ..judging.statistics import EQUIVALENT
from ..judging.summary import succeeded
from ..judging.verdicts import require_equal_runs
from ..results.folder import Results
from ..spec import scenario
from ..spec.scenario import Scenario
from . import card as cards
from .card import Card, CardEstimator, Judged, Opponent, Question, Role, rounded
from .stored_runs import REFERENCE, SUITE, ScoreError, StoredRuns, read

QUICK_RUNS = 20
"""Number of runs of a case in a quick score: one for each realisation of the map error."""
_HALVES: Mapping[Judged, tuple[int, ...]] = {"all": (0, 1), "even": (0,), "odd": (1,)}
_OWN = "(scored)"
_NUMBERS = (
    "rms_m",
    "rms_lo",
    "rms_hi",
    "bound_m",
    "efficiency",
    "success",
    "nees",
    "coverage",
)
"""Numbers of a question that are columns of the table of metrics."""


@dataclass(frozen=True)
class Score:
    """Result of :func:`score`; ``card`` is None if the campaign was interrupted.

    ``failures`` is a table of runs that failed or diverged: case, run, reason, and the command that
    repeats the run.
    """

    card: Card | None
    failures: pd.DataFrame


def score(
    estimator: str,
    folder: Path,
    runs: int | None = None,
    seed: int | None = None,
    judged_runs: Judged = "all",
    cases: Sequence[str] = (),
    jobs: int | None = None,
    progress: Callable[[running.CampaignProgress], None] = lambda step: None,
) -> Score:
    """Run an estimator on the suite and return the score.

    The estimator is compared with opponents: the EKF, and the recommended or best estimator of each
    case. Raise GGBenchError if the estimator or a case does not exist, the estimator refuses all
    cases, or the stored runs come from another suite or results version.

    Parameters
    ----------
    estimator : text of the estimator, ``NAME[parameter=value,...]``.
    folder : results folder; runs that it contains are not repeated.
    runs : number of runs of each case, by default as many as are stored with the suite.
    seed : seed of the runs, by default the public seed. With it, stored runs of the
        opponents are used; with another seed, they are run too.
    judged_runs : runs to evaluate: all, or those with odd or even index.
    cases : names of the cases to run, by default all.
    jobs : number of worker processes, by default one for each processor.
    progress : function that is called at every step.
    """
    stored, suite = read(), scenario.load(SUITE)
    _require_version(stored, suite)
    suite = suite.select(cases) if cases else suite
    header = stored.header
    public = seed is None or seed == header["seed"]
    count = int(header["runs"]) if runs is None else runs
    if public and count > header["runs"]:
        raise ScoreError(
            f"{count} runs requested, but only {header['runs']} of each case are stored"
        )
    choice = choose(estimator)
    used_seed = int(header["seed"]) if seed is None else seed
    skipped = _skipped(choice, suite, used_seed)
    chosen_cases = [case.name for case in suite.cases if case.name not in skipped]
    if not chosen_cases:
        raise ScoreError(f"{choice.label} skips all cases: {next(iter(skipped.values()))}")
    opponents = _opponents(stored, kind(choice.estimator.causality))
    labels = [choice.label]
    if not public:
        labels += [other for name in chosen_cases for other in opponents[name].values()]
    work = campaign.planned(
        suite, folder, [*dict.fromkeys(labels)], runs=count, seed=used_seed, cases=chosen_cases
    )
    interrupted = False
    try:
        results = running.fly(work, jobs, progress=progress)
    except running.InterruptedCampaign as stop:
        results, interrupted = stop.results, True
    flown = results.runs()
    flown = flown[(flown["run"] < count) & flown["case"].isin(chosen_cases)]
    own = flown[flown["estimator"] == choice.label]
    unfinished = own[(own["status"] != "ok") | own["diverged"]]
    failures = unfinished[["case", "run", "reason", "command"]].reset_index(drop=True)
    if interrupted:
        return Score(None, failures)
    others = stored.runs if public else flown
    others = others[others["run"] < count]
    matches = {
        name: _Match(
            own=own[own["case"] == name],
            others=others[others["case"] == name],
            opponents=opponents[name],
            half=_HALVES[judged_runs],
        )
        for name in chosen_cases
    }
    questions = _questions(suite, results, matches, skipped)
    content = choice.content
    return Score(
        Card(
            format=cards.FORMAT,
            ggbench=results.manifest["ggbench"],
            results_version=RESULTS_VERSION,
            suite=suite.content_hash,
            seed=used_seed,
            public=public,
            runs=count,
            judged=judged_runs,
            estimator=CardEstimator(
                label=choice.label,
                name=choice.estimator.name,
                parameters=content["parameters"],
                source=content["source"],
                seeks=content.get("seeks", []),
            ),
            questions=questions,
        ),
        failures,
    )


def _require_version(stored: StoredRuns, suite: Scenario) -> None:
    """Raise ScoreError unless the stored runs have the installed suite and version of results."""
    header = stored.header
    installed = suite.content_hash, RESULTS_VERSION
    if (header["scenario_hash"], header["results_version"]) != installed:
        raise ScoreError(
            "the stored runs come from another suite or results version; renew them with 'make "
            "suite'"
        )


def _skipped(choice: Choice, suite: Scenario, seed: int) -> dict[str, str]:
    """Return the reasons why an estimator refuses cases, by case."""
    return {
        case.name: reason
        for case in suite.cases
        if (reason := refusal(choice.estimator, first_problem(case, seed)))
    }


def _opponents(stored: StoredRuns, side: str) -> dict[str, dict[Role, str]]:
    """Return the estimators to compare with, by case and role."""
    opponents: dict[str, dict[Role, str]] = {}
    for case, rivals in stored.header["recommended"].items():
        rival = rivals[side]
        opponents[case] = {"ekf": REFERENCE}
        if rival["label"]:
            opponents[case]["recommended" if rival["recommended"] else "best"] = rival["label"]
    return opponents


@dataclass(frozen=True)
class _Match:
    """Runs of the scored estimator and of all others in a case, and the opponents.

    Attributes
    ----------
    own, others : tables of runs.
    opponents : label by role.
    half : remainders modulo 2 of the indices of judged runs.
    """

    own: pd.DataFrame
    others: pd.DataFrame
    opponents: Mapping[Role, str]
    half: tuple[int, ...]

    def chosen(self, label: str | None = None) -> pd.DataFrame:
        """Return the judged runs of an opponent; None stands for the scored estimator."""
        runs = self.own if label is None else self.others[self.others["estimator"] == label]
        return runs[(runs["run"] % 2).isin(self.half)]


def _questions(
    suite: Scenario, results: Results, matches: Mapping[str, _Match], skipped: Mapping[str, str]
) -> list[Question]:
    """Return the questions with verdicts; Holm's procedure covers all comparisons together."""
    pairs: list[dict[str, Any]] = []
    for name, match in matches.items():
        own = match.chosen()
        for label in dict.fromkeys(match.opponents.values()):
            theirs = match.chosen(label)
            require_equal_runs(pd.concat([own.assign(estimator=_OWN), theirs]))
            pairs.append(
                {"case": name, "label": label} | compared(PairedRuns.of(own), PairedRuns.of(theirs))
            )
    pairs_judged = {(pair["case"], pair["label"]): pair for pair in judged(pairs)}
    judged_runs = pd.concat([match.chosen() for match in matches.values()])
    metrics = results.metrics_of(judged_runs)
    settled = metrics[metrics["window"] == "settled"].set_index("case")
    questions = []
    for case in suite.cases:
        if case.name in skipped:
            questions.append(Question(case=case.name, title=case.title, skipped=skipped[case.name]))
            continue
        match = matches[case.name]
        row, own = settled.loc[case.name], match.own.sort_values("run")
        numbers: dict[str, Any] = {key: rounded(row[key]) for key in _NUMBERS}
        questions.append(
            Question(
                case=case.name,
                title=case.title,
                runs=int(row["runs"]),
                failed=int(row["failed"]),
                diverged=int(row["diverged"]),
                lost=int(row["lost"]),
                consistency=row["consistency"] if isinstance(row["consistency"], str) else "",
                against=[
                    _opponent(role, match.chosen(label), pairs_judged[case.name, label])
                    for role, label in match.opponents.items()
                ],
                errors_m=[rounded(math.sqrt(square)) for square in own["settled_position_ms"]],
                succeeded=succeeded(own).tolist(),
                **numbers,
            )
        )
    return questions


def _opponent(role: Role, runs: pd.DataFrame, pair: Mapping[str, Any]) -> Opponent:
    finished = runs.loc[runs["status"] == "ok", "settled_position_ms"]
    return Opponent(
        label=pair["label"],
        role=role,
        runs=pair["runs"],
        rms_m=rounded(math.sqrt(finished.mean())) if len(finished) else None,
        error_ratio=rounded(pair["error_ratio"]),
        lo=rounded(pair["lo"]),
        hi=rounded(pair["hi"]),
        only_scored=pair["first_only"],
        only_other=pair["second_only"],
        verdict="as good" if pair["verdict"] == EQUIVALENT else pair["verdict"],
    )
