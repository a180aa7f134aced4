"""Cards: results of an estimator in the suite, as a file to check and compare."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..files import written_whole
from .stored_runs import ScoreError

FORMAT = 1
_DIGITS = 6

Verdict = Literal["better", "as good", "worse", "undecided"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
Judged = Literal["all", "odd", "even"]
Role = Literal["ekf", "recommended", "best"]
Number = float | None
"""A number, or null where there is none."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Opponent(_Part):
    """Comparison with another estimator on equal runs."""

    label: str = Field(description="The other estimator.")
    role: Role = Field(
        description="The EKF; the recommended estimator of the case; or, where none is, its best."
    )
    runs: int = Field(description="Runs that both finished.")
    rms_m: Number = Field(description="Its RMS position error in the settled window [m].")
    error_ratio: Number = Field(
        description="Geometric mean of the scored estimator's error over its error, run by run."
    )
    lo: Number = Field(description="Lower end of the 95% interval of the ratio.")
    hi: Number = Field(description="Upper end of the 95% interval of the ratio.")
    only_scored: int = Field(description="Runs in which the scored estimator alone succeeds.")
    only_other: int = Field(description="Runs in which the other estimator alone succeeds.")
    verdict: Verdict = Field(description="Verdict on the scored estimator, by Holm over the card.")


class Question(_Part):
    """One case of the suite."""

    case: str = Field(description="Name of the case.")
    title: str = Field(description="The question in words.")
    skipped: str = Field(default="", description="Why the estimator cannot take the case.")
    runs: int = Field(default=0, description="Runs that are judged.")
    failed: int = Field(default=0, description="Runs without an estimate.")
    diverged: int = Field(default=0, description="Runs that end beyond ten bounds and the INS.")
    lost: int = Field(default=0, description="Runs that are far off and do not report it.")
    rms_m: Number = Field(default=None, description="RMS position error, settled window [m].")
    rms_lo: Number = Field(default=None, description="Lower end of its 95% interval [m].")
    rms_hi: Number = Field(default=None, description="Upper end of its 95% interval [m].")
    bound_m: Number = Field(default=None, description="Cramér–Rao bound [m].")
    efficiency: Number = Field(
        default=None, description="RMS error over the oracle's, on the same runs."
    )
    success: Number = Field(default=None, description="Share of runs within the required error.")
    nees: Number = Field(
        default=None, description="Mean NEES of position and velocity; 6 is right."
    )
    coverage: Number = Field(default=None, description="Share of epochs in the 95% region.")
    consistency: str = Field(default="", description="Consistent, overconfident, unsafe, ....")
    against: list[Opponent] = Field(default_factory=list)
    errors_m: list[Number] = Field(
        default_factory=list, description="RMS error of each run flown [m], null if it failed."
    )
    succeeded: list[bool] = Field(
        default_factory=list, description="Whether each run ends within the required error."
    )


class CardEstimator(_Part):
    """The scored estimator."""

    label: str = Field(description="Name or file, and parameters that differ from the defaults.")
    name: str = Field(description="Its name.")
    parameters: dict[str, Any] = Field(description="All parameters.")
    source: str = Field(description="SHA-256 of its source file.")
    seeks: list[str] = Field(
        default_factory=list, description="Names in its source by which truth could be found."
    )


class Card(_Part):
    """Result of ``ggbench score``."""

    format: int = Field(description="Version of this format.")
    ggbench: str = Field(description="Version of ggbench.")
    results_version: int = Field(description="Version of the numbers that estimators give.")
    suite: str = Field(description="Hash of the suite's content.")
    seed: int = Field(description="Seed of the runs.")
    public: bool = Field(description="Whether the runs are the public ones, whose seed is known.")
    runs: int = Field(description="Runs flown in each case.")
    judged: Judged = Field(description="Which of them are judged.")
    estimator: CardEstimator
    questions: list[Question]
    seconds_per_run: dict[str, Number] = Field(
        description="Median time of a run by case [s]; depends on the machine, never compared."
    )

    def verdicts(self, role: str) -> dict[str, int]:
        """Return the number of cases by verdict against the EKF ("ekf") or the others ("")."""
        found = [
            other.verdict
            for question in self.questions
            for other in question.against
            if (other.role == "ekf") == (role == "ekf")
        ]
        return {verdict: found.count(verdict) for verdict in VERDICTS}


def rounded(value: float) -> float | None:
    """Return a number with six digits, None for NaN or infinity."""
    return float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None


def schema_text() -> str:
    """Return the JSON Schema of cards."""
    return json.dumps(Card.model_json_schema(), indent=1, ensure_ascii=False) + "\n"


def write(card: Card, path: Path) -> None:
    """Write a card as JSON; raise ScoreError if it cannot be written."""
    with written_whole(path, ScoreError) as temporary:
        text = json.dumps(card.model_dump(mode="json"), indent=1, ensure_ascii=False)
        temporary.write_text(f"{text}\n", encoding="utf-8")


def read(path: Path) -> Card:
    """Read a card; raise ScoreError if it is no card, or of another format."""
    try:
        loaded = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ScoreError(f"cannot read the card {path}: {reason}") from None
    if isinstance(loaded, dict) and loaded.get("format", FORMAT) != FORMAT:
        raise ScoreError(f"{path} has format {loaded['format']}; this version reads {FORMAT}")
    try:
        return Card.model_validate(loaded)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise ScoreError(f"{path} is no card: {where}: {first['msg'].lower()}") from None
