"""Campaign results as tables and figures."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from ..judging.summary import ordered
from ..results import folder
from ..results.folder import ResultsError

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from ..figures.stored import Quantity

_MOST_NAMED = 4
_SUMMARY = ("case", "estimator", "runs", "failed", "rms_m", "efficiency", "success", "consistency")
"""Columns of a short table of metrics."""


class Results(folder.Results):
    """Content of a results folder: tables, and figures of its cases.

    ``runs()``, ``metrics()``, ``pairs()``, ``cases()`` and ``failures()`` return new pandas tables.
    Each ``plot_...()`` returns a Matplotlib figure, which a notebook shows and ``savefig`` writes.
    The default case is the first.

    Parameters
    ----------
    folder : results folder of ``ggbench run``, or ``output`` of :func:`run`.

    Raises
    ------
    StoreError
        If ``folder`` is no results folder, or is damaged.
    """

    def __repr__(self) -> str:
        cases = ", ".join(self.manifest["cases"][:_MOST_NAMED])
        if len(self.manifest["cases"]) > _MOST_NAMED:
            cases = f"{len(self.manifest['cases'])} cases"
        return (
            f"Results({self.manifest['scenario']}: {cases}; {', '.join(self.labels)}; runs 0 to "
            f"{self.run_count - 1}; in {self.folder})"
        )

    def summary(self) -> pd.DataFrame:
        """Return a short table of metrics, with a row for each case and estimator.

        The metrics refer to the settled window, which lasts from ``windows.settled_from_s`` to the
        end of the flight.

        The column ``title`` contains the titles of the cases. A title states the changes of its
        case, for example the values of a sweep.
        """
        metrics = self.metrics()
        table = metrics.loc[metrics["window"] == "settled", list(_SUMMARY)].reset_index(drop=True)
        titles = {case.name: case.title for case in self.scenario.cases}
        table.insert(1, "title", table["case"].map(titles))
        return table

    def _repr_html_(self) -> str:
        return f"<p>{escape(repr(self))}</p>{self.summary().to_html(index=False)}"

    def plot_error_over_time(self, case: str | None = None) -> Figure:
        """Draw the RMS position and velocity errors of all runs, and the bounds, against time.

        Raises
        ------
        ScenarioError
            If the case does not exist.
        """
        from ..figures import stored  # not at the top: tables need no Matplotlib

        name = self._case(case)
        labels = [row["estimator"] for row in ordered(self.metrics(), name)]
        return stored.error_over_time(self, {name: labels})

    def plot_errors(
        self,
        case: str | None = None,
        estimator: str | None = None,
        quantity: Quantity = "position",
    ) -> Figure:
        """Draw the ENU errors of run 0 with the reported ±3σ, and the INS errors if available.

        Parameters
        ----------
        case : name of the case.
        estimator : label in the tables; by default the first estimator other than ``ins``.
        quantity : ``position`` or ``velocity``.

        Raises
        ------
        ScenarioError, ResultsError
            If the case or estimator does not exist, or run 0 has failed.
        """
        from ..figures import stored

        label = estimator
        if label is None:
            label = next((label for label in self.labels if label != "ins"), self.labels[0])
        elif label not in self.labels:
            raise ResultsError(
                f"{self.folder} holds no estimator '{label}'; it holds {', '.join(self.labels)}"
            )
        return stored.component_errors(self, self._case(case), label, quantity)

    def plot_field(self, case: str | None = None) -> Figure:
        """Draw a case's map at flight height, with the track.

        Raises
        ------
        ScenarioError, ResultsError
            If the case does not exist or has no map.
        """
        from ..figures import stored

        return stored.field_map(self, self._case(case))

    def plot_track_gradient(self, case: str | None = None) -> Figure:
        """Draw the vertical gradient along the track: true, measured with noise, and filtered.

        Raises
        ------
        ScenarioError
            If the case does not exist.
        """
        from ..figures import stored

        return stored.track_gradient(self, self._case(case))

    def plot_sweep(self, key: str | None = None) -> Figure:
        """Draw RMS errors, bounds and the INS error against a swept value.

        Parameters
        ----------
        key : dotted key of the abscissa, such as ``gradiometer.noise_eotvos``; by default the first
            key of the sweep. The values of the other keys are drawn in at most three panels.

        Raises
        ------
        ResultsError
            If this key does not vary.
        """
        from ..figures import stored

        return stored.swept(self, key)

    def _case(self, name: str | None) -> str:
        """Return the name of a case that was run; None stands for the first case."""
        return self.scenario.cases[0].name if name is None else self.scenario.case(name).name
