"""Check of score cards: repetition of their runs, and comparison of the results."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..campaign import running
from ..campaign.registry import Choice, choose, is_own
from ..errors import GGBenchError, line_of
from ..estimator_spec import EstimatorSpec
from . import card as cards
from . import cards_compared, scoring
from .card import Card
from .stored_runs import ScoreError


@dataclass(frozen=True)
class CheckedCard:
    """A card of a folder, and the result of its check.

    Attributes
    ----------
    path : path of the card file.
    card : card of the repeated runs. It is None if the runs cannot be repeated, or if this card
        differs from the card in the file.
    reasons : reasons why the card is not reproduced, each as a sentence.
    """

    path: Path
    card: Card | None
    reasons: tuple[str, ...] = ()


def files_of(folder: Path) -> list[Path]:
    """Return the JSON files in a folder and its subfolders, without manifests of results folders.

    Raises ScoreError if there are none.
    """
    try:
        files = sorted(
            path
            for path in folder.rglob("*.json")
            if path.is_file() and path.name != "manifest.json"
        )
    except OSError as error:
        raise ScoreError(f"cannot read {folder}: {error.strerror}") from None
    if not files:
        raise ScoreError(f"{folder} holds no cards: 'ggbench score ESTIMATOR' writes card.json")
    return files


def check(
    path: Path,
    allowed: Sequence[Choice],
    flights: Path,
    jobs: int | None = None,
    tell: Callable[[str], None] = lambda text: None,
    progress: Callable[[running.CampaignProgress], None] = lambda step: None,
) -> CheckedCard:
    """Repeat the runs of a card and compare all values.

    Only installed estimators and those in ``allowed`` are run. An estimator file is run only if its
    hash equals the hash in the card. A file that is named in the card, but is not in ``allowed``,
    is never run. Raise KeyboardInterrupt if interrupted.

    Parameters
    ----------
    path : path of the card file.
    allowed : estimators from files and programs that may be run.
    flights : folder for the results folders; stored runs are not repeated.
    jobs, progress : as in :func:`.scoring.score`.
    tell : function that is called with a sentence before the runs.
    """
    try:
        old = cards.read(path)
        label = _named(old, allowed)
        tell(f"{line_of(str(path))}: the check runs the code of {label}.")
        scored = scoring.score(
            estimator=label,
            folder=flights / _folder(old),
            runs=old.runs,
            seed=old.seed,
            judged_runs=old.judged,
            cases=[question.case for question in old.questions],
            jobs=jobs,
            progress=progress,
        )
    except GGBenchError as error:
        return CheckedCard(path, None, (str(error),))
    if scored.card is None:
        raise KeyboardInterrupt
    reasons = tuple(cards_compared.differences(old, scored.card))
    return CheckedCard(path, None if reasons else scored.card, reasons)


def _folder(old: Card) -> str:
    """Return the name of the results folder of an estimator and a seed."""
    name = re.sub(r"\W+", "-", old.estimator.name)[:40].strip("-")
    own = json.dumps([old.estimator.source, old.estimator.parameters, old.seed], sort_keys=True)
    return f"{name}-{hashlib.sha256(own.encode()).hexdigest()[:12]}"


def _named(old: Card, allowed: Sequence[Choice]) -> str:
    """Return the text of a card's estimator; raise ScoreError if it must not be run."""
    label = old.estimator.label
    if not is_own(label):
        return label
    spec_written = EstimatorSpec.parse(label)
    for choice in allowed:
        spec = EstimatorSpec(choice.spec.name, spec_written.parameters)
        if choice.content["source"] == old.estimator.source:
            return choose(str(spec)).label
    if any(Path(choice.spec.name).name == Path(spec_written.name).name for choice in allowed):
        raise ScoreError(f"{label} has changed since the card was written: its hash differs")
    raise ScoreError(
        f"the card is of {label}, which is not installed: give its file with -e to run its code"
    )
