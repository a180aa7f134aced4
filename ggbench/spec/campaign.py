"""Table of campaign defaults: estimators, number of runs, seed."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from . import quantities as q
from .limits import MOST_RUNS, MOST_SEED
from .rosters import expanded
from .tables import Listed, Section


class CampaignSpec(Section):
    """``[campaign]``: defaults of ``ggbench run``."""

    runs: Annotated[int, Field(ge=1, le=MOST_RUNS)] = 100
    """Runs per case. All estimators, and cases with equal `draw.name`, share the random numbers
    of a run.
    """
    seed: Annotated[int, Field(ge=0, le=MOST_SEED)] = 1
    """Seed of all runs."""
    assumption_runs: Annotated[int, Field(ge=1, le=MOST_RUNS)] = 100
    """Runs per case for the assumptions (`--assumptions`)."""
    assumption_estimator: str = "ekf"
    """Estimator for the assumptions."""
    estimators: Annotated[Listed[str], AfterValidator(expanded), Field(min_length=1)] = (
        "ins",
        "ekf",
    )
    """Estimators, with parameters: `"ekf[iterations=5]"`.

    `"@NAME"` stands for a roster in `rosters.toml`; `"-ekf"` removes an estimator listed before.
    """
    time_limit_s: q.TimeLimit = 600.0
    """Time limit of one run of one estimator."""

    def runs_of(self, study: str, runs: int) -> int:
        """Return the number of runs per case of a study.

        The study "" consists of the cases of the scenario without an assumption. For this study the
        result is ``runs``. If ``study`` is the name of an assumption, the result is the smaller one
        of ``runs`` and the key ``assumption_runs``.
        """
        return min(runs, self.assumption_runs) if study else runs
