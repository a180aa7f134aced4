"""Results for reports, with short names of estimators."""

from __future__ import annotations

import shlex
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from ..estimator_spec import EstimatorSpec, shown_names
from ..figures.line_styles import is_own
from ..judging.standing import standing
from ..results import digest
from ..results.folder import Results, as_argument
from . import league, models_over_time, published, survey_lines

_LABELS = ("estimator", "first", "second", "recommended", "best", "best_smoother")
"""Columns of tables that name estimators."""


def _spec_of(label: str) -> EstimatorSpec | str:
    """Return the spec of an estimator, or a label of another form unchanged.

    Specs are equal whatever the order of their parameters.
    """
    try:
        return EstimatorSpec.parse(label)
    except ValueError:
        return label


class Reported(Results):
    """A results folder whose tables use the short names of estimators.

    The short name of an estimator from a file is the ``name`` of its class with the parameters, for
    example ``mine[gain=2]`` for ``a/file.py[gain=2]``. Estimators that would share a short name
    keep their labels. The command of :meth:`rerun` uses labels, because it needs the path of the
    file.
    """

    @cached_property
    def shown(self) -> dict[str, str]:
        """Short name of each estimator, by label."""
        metrics = super().metrics()
        names = dict(zip(metrics["estimator"], metrics["name"], strict=True))
        return {label: label for label in super().labels} | shown_names(names)

    @property
    def labels(self) -> list[str]:
        """Short names of the estimators, in the order of the user's command."""
        return [self.shown[label] for label in super().labels]

    @property
    def families(self) -> dict[str, str]:
        """Family of each estimator, by short name."""
        return {self.shown[label]: family for label, family in super().families.items()}

    @property
    def own(self) -> list[str]:
        """Short names of the user's own estimators, in the order of the user's command."""
        families = self.families
        return [label for label in self.labels if is_own(label, families)]

    @property
    def seeking(self) -> dict[str, str]:
        """Identifiers in an estimator's source that give access to the truth, by short name."""
        return {self.shown[label]: names for label, names in super().seeking.items()}

    def series(self, case: str, estimator: str) -> np.ndarray:
        """Return the time series (runs, K', 4) of the estimator with a short name.

        The columns and the K' epochs are those of :meth:`.Results.series`.
        """
        labels = {name: label for label, name in self.shown.items()}
        return super().series(case, labels.get(estimator, estimator))

    def runs(self) -> pd.DataFrame:
        """Return the table of runs, with short names."""
        return self._named(super().runs())

    def metrics(self) -> pd.DataFrame:
        """Return a table with a row for each case, estimator and window, with short names."""
        return self._named(super().metrics())

    def pairs(self) -> pd.DataFrame:
        """Return the table of pairwise comparisons, with short names."""
        return self._named(super().pairs())

    def cases(self) -> pd.DataFrame:
        """Return a table with a row for each case: set-up, bounds, verdicts with short names."""
        return self._named(super().cases())

    def failures(self) -> pd.DataFrame:
        """Return the table of failed runs, with short names."""
        return self._named(super().failures())

    @cached_property
    def by_line(self) -> pd.DataFrame:
        """Table of errors by survey line."""
        return survey_lines.by_line(self, self.runs())

    def further_tables(self) -> dict[str, pd.DataFrame]:
        """Return all non-empty tables except metrics, cases and pairs, by name.

        The order is that of a page: errors first, counters last.
        """
        tables = {
            "errors": league.errors(self.metrics(), self.cases()),
            "studies": self._named(self.studies()),
            "standing": standing(self.metrics(), self.cases()),
            "claims": published.claimed(self),
            "gravity_claims": published.gravity_claims(self),
            "fixes": self._named(self.fix_metrics()),
            "lines": self.by_line.copy(),
            "models": self._named(self._models()),
            "remarks": self._remarks(),
            "failures": self.failures(),
            "counters": self._named(self.counters()),
        }
        return {name: table for name, table in tables.items() if len(table)}

    def write_data(self, folder: Path) -> None:
        """Write the digest and the tables of :meth:`further_tables` into a folder."""
        digest.write(self, folder)
        for name, table in self.further_tables().items():
            digest.write_csv(table, folder / f"{name}.csv")

    def rerun(self) -> str:
        """Return the command that repeats the campaign.

        The command states the seed only if it differs from the scenario's own seed.
        """
        m = self.manifest
        left_out = m.get("left_out", {})
        flags = ""
        flown, omitted = (list(map(_spec_of, labels)) for labels in (m["estimators"], left_out))
        own = map(_spec_of, self.scenario.campaign.estimators)
        if flown != [spec for spec in own if spec in flown or spec not in omitted]:
            flags += "".join(f" -e {shlex.quote(label)}" for label in m["estimators"])
        if m["cases"] != [case.name for case in self.whole_scenario.cases]:
            flags += "".join(f" -c {shlex.quote(name)}" for name in m["cases"])
        flags += " --assumptions" if m["assumptions"] else ""
        seed = "" if m["seed"] == self.scenario.campaign.seed else f" --seed {m['seed']}"
        return f"ggbench run {as_argument(m['argument'])} -n {m['runs']}{seed}{flags}"

    def _models(self) -> pd.DataFrame:
        """Return the models with the largest weights of multiple-model estimators, over time."""
        parts = [
            models_over_time.over_time(infos).assign(case=case, estimator=estimator)
            for (case, estimator), infos in self.infos.items()
        ]
        rows = [part for part in parts if len(part)]
        keys = ["case", "estimator", "time_s", "models"]
        return pd.concat(rows, ignore_index=True)[keys] if rows else pd.DataFrame()

    def _remarks(self) -> pd.DataFrame:
        """Return the number of runs with each remark, by case and estimator."""
        runs = self.runs()
        own = runs[(runs["assumption"] == "") & (runs["remark"] != "")]
        counted = own.groupby(["case", "estimator", "remark"], sort=False)["run"].count()
        return counted.rename("runs").reset_index()

    def _named(self, table: pd.DataFrame) -> pd.DataFrame:
        """Replace labels of estimators in a table by their short names; return the table."""
        changed = {label: name for label, name in self.shown.items() if label != name}
        for key in set(_LABELS) & set(table) if changed else ():
            table[key] = table[key].map(lambda cell: changed.get(cell, cell))
        return table
