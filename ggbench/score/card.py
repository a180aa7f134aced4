"""Score cards: results of an estimator in the suite, as a file to check and compare."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal, Self, get_args

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    NonNegativeInt,
    ValidationError,
    model_validator,
)
from pydantic_core import from_json

from ..errors import line_of, text_of
from ..files.writing import content_of, written_whole
from ..spec.limits import MOST_RUNS, MOST_SEED
from .stored_runs import ScoreError

FORMAT = 2
MOST_BYTES = 64_000_000
"""Largest file of a card."""
_DIGITS = 6
_LONGEST_TEXT = 1000

Verdict = Literal["better", "as good", "worse", "undecided"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
Judged = Literal["all", "odd", "even"]
Role = Literal["ekf", "recommended", "best"]
Number = float | None
"""A number, or null where there is none."""
Error = Annotated[float, Field(ge=0.0)] | None
"""An error [m], or null where there is none."""
Line = Annotated[str, AfterValidator(lambda text: line_of(text, _LONGEST_TEXT))]
"""An untrusted text, converted to one printable line."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Opponent(_Part):
    """Comparison of the scored estimator with another estimator on the same runs."""

    label: Line = Field(description="The other estimator.")
    role: Role = Field(
        description="Role of the other estimator: the EKF, the recommended estimator, or the best "
        "estimator of a case without a recommended estimator."
    )
    runs: NonNegativeInt = Field(description="Runs that both finished.")
    rms_m: Number = Field(description="Its RMS position error in the settled window [m].")
    error_ratio: Number = Field(
        description="Geometric mean over the runs of the ratio of the scored estimator's error to "
        "the other estimator's error."
    )
    lo: Number = Field(description="Lower end of the 95% interval of the ratio.")
    hi: Number = Field(description="Upper end of the 95% interval of the ratio.")
    only_scored: NonNegativeInt = Field(
        description="Runs in which the scored estimator alone succeeds."
    )
    only_other: NonNegativeInt = Field(
        description="Runs in which the other estimator alone succeeds."
    )
    verdict: Verdict = Field(
        description="Verdict on the scored estimator. Holm's procedure covers all comparisons of "
        "the card."
    )


class Question(_Part):
    """Results of the scored estimator in one case of the suite."""

    case: Line = Field(description="Name of the case.")
    title: Line = Field(description="The question in words.")
    skipped: Line = Field(
        default="", description="Reason why the estimator cannot process the case."
    )
    runs: NonNegativeInt = Field(default=0, description="Runs that are judged.")
    failed: NonNegativeInt = Field(default=0, description="Runs without an estimate.")
    diverged: NonNegativeInt = Field(
        default=0,
        description="Runs whose final position error exceeds ten bounds and the INS's error.",
    )
    lost: NonNegativeInt = Field(
        default=0,
        description="Runs that end outside the required error, with a NEES beyond the 99.9% "
        "quantile of χ² over the last window.",
    )
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
    consistency: Line = Field(default="", description="Consistent, overconfident, unsafe, ....")
    against: list[Opponent] = Field(default_factory=list)
    errors_m: list[Error] = Field(
        default_factory=list, description="RMS error of each run flown [m], null if it failed."
    )
    succeeded: list[bool] = Field(
        default_factory=list, description="Whether each run ends within the required error."
    )

    @model_validator(mode="after")
    def _whole(self) -> Self:
        """Raise ValueError if the opponents or the numbers of runs are inconsistent.

        The EKF must be an opponent, each role must be unique, and ``errors_m`` and ``succeeded``
        must have equal lengths.
        """
        roles = [other.role for other in self.against]
        if len(set(roles)) != len(roles) or (not self.skipped and "ekf" not in roles):
            raise ValueError(
                "against must contain the role ekf, unless the case is skipped, and no role twice"
            )
        if len(self.errors_m) != len(self.succeeded):
            raise ValueError("errors_m and succeeded must have a value for each run")
        return self


class CardEstimator(_Part):
    """Identity of the scored estimator."""

    label: Line = Field(description="Name or file, and parameters that differ from the defaults.")
    name: Line = Field(description="Its name.")
    parameters: dict[Line, bool | int | float | Line | None] = Field(description="All parameters.")
    source: Line = Field(description="SHA-256 of its source file.")
    seeks: list[Line] = Field(
        default_factory=list, description="Names in the source that may give access to the truth."
    )


class Card(_Part):
    """Score card: result of ``ggbench score`` for one estimator."""

    format: int = Field(description="Version of this format.")
    ggbench: Line = Field(description="Version of ggbench.")
    results_version: int = Field(
        description="Version of the results. It changes if equal runs give different numbers."
    )
    suite: Line = Field(description="Hash of the suite's content.")
    seed: int = Field(ge=0, le=MOST_SEED, description="Seed of the runs.")
    public: bool = Field(description="Whether the runs are the public ones, whose seed is known.")
    runs: int = Field(ge=1, le=MOST_RUNS, description="Runs flown in each case.")
    judged: Judged = Field(description="Judged runs: all, or those with odd or even index.")
    estimator: CardEstimator
    questions: list[Question] = Field(min_length=1)

    @model_validator(mode="after")
    def _whole(self) -> Self:
        """Raise ValueError unless each case occurs once, with ``runs`` values of ``errors_m``."""
        names = [question.case for question in self.questions]
        if len(set(names)) != len(names):
            raise ValueError("two questions are of the same case; each case is allowed once")
        flown = [len(q.errors_m) for q in self.questions if not q.skipped]
        if any(count != self.runs for count in flown):
            raise ValueError(
                f"errors_m must have one value per run, {self.runs}, in each case that is not "
                "skipped"
            )
        return self

    def verdicts(self, role: str) -> dict[str, int]:
        """Return the number of cases for each verdict on the scored estimator.

        If ``role`` is "ekf", the verdicts of the comparison with the EKF are counted. If it is "",
        the verdicts of the comparisons with all other opponents are counted.
        """
        verdicts = [
            other.verdict
            for question in self.questions
            for other in question.against
            if (other.role == "ekf") == (role == "ekf")
        ]
        return {verdict: verdicts.count(verdict) for verdict in VERDICTS}


def rounded(value: float) -> float | None:
    """Return a number rounded to six significant digits, or None for NaN or infinity."""
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
    """Read a card; raise ScoreError if the file is no card, or has another format version."""
    content = content_of(path, ScoreError, "the card ", MOST_BYTES)
    try:
        loaded = from_json(content.removeprefix(b"\xef\xbb\xbf"))
    except ValueError as error:
        raise ScoreError(f"cannot read the card {path}: {text_of(error)}") from None
    if isinstance(loaded, dict) and loaded.get("format", FORMAT) != FORMAT:
        file_format = line_of(str(loaded["format"]), 40)
        raise ScoreError(f"{path} has format {file_format}; this version reads {FORMAT}")
    try:
        return Card.model_validate(loaded)
    except ValidationError as error:
        first = error.errors()[0]
        where = line_of(".".join(map(str, first["loc"]))) or "the file"
        raise ScoreError(f"{path} is no card: {where}: {line_of(first['msg']).lower()}") from None
