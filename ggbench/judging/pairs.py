"""Paired comparisons of estimators on common runs."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .statistics import (
    ALPHA,
    BETTER,
    EQUIVALENT,
    UNDECIDED,
    WORSE,
    cluster_means,
    exact_p,
    holm,
    log_ratio,
    runs_to_decide,
)
from .summary import SMOOTHERS, succeeded

if TYPE_CHECKING:
    import pandas as pd

PAIRS = (
    "case",
    "first",
    "second",
    "runs",
    "error_ratio",
    "lo",
    "hi",
    "p",
    "first_only",
    "second_only",
    "success_p",
    "verdict",
)
"""Columns of :func:`pairs`."""
FAMILY = (*PAIRS, "needed_runs")
"""Columns of :func:`family`."""
FEWEST = 20
"""Least number of clusters of common runs for the verdict "equivalent"."""
ERRORS = "settled_position_ms"
"""Column of a table of runs by which estimators are compared."""


def kind(causality: str) -> str:
    """Return the kind of an estimator for comparisons: "smoother" or "causal"."""
    return "smoother" if causality in SMOOTHERS else "causal"


def pairs(runs: pd.DataFrame) -> pd.DataFrame:
    """Compare every two estimators of the same kind in each case.

    Parameters
    ----------
    runs : table of runs with a column ``draw``, the index of the cluster.

    Returns
    -------
    A table with the columns :data:`PAIRS`. ``runs`` is the number of runs that both estimators
    finished. ``error_ratio`` is the geometric mean of first / second error in the settled window,
    with 95 % interval ``lo``, ``hi``. ``first_only`` is the number of runs in which only ``first``
    ends within the required error, and ``second_only`` is the same for ``second``. p-values are
    adjusted by Holm's procedure over all tests of a case. The verdict compares the estimator
    ``first`` with ``second``. It is the earliest entry of this list that applies:

    - "better" or "worse", if ``first`` succeeds significantly more or less often (5 %);
    - "equivalent", if two one-sided tests at 5 % place the ratio within 5 % of 1, with at least
      :data:`FEWEST` clusters;
    - "better" or "worse", if the ratio is significantly below or above 1 (5 %);
    - "undecided".

    If no estimators differ, at most 5 % of the cases have any verdict "better" or "worse".
    """
    import pandas as pd

    rows: list[dict[str, Any]] = []
    for case, group in runs.groupby("case", sort=False):
        kinds: dict[str, dict[str, PairedRuns]] = {}
        for label, own in group.groupby("estimator", sort=False):
            kinds.setdefault(kind(own["causality"].iloc[0]), {})[str(label)] = PairedRuns.of(own)
        rows += judged(
            [
                {"case": case, "first": one, "second": two} | compared(flown[one], flown[two])
                for flown in kinds.values()
                for one, two in itertools.combinations(flown, 2)
            ]
        )
    return pd.DataFrame(rows).reindex(columns=[*PAIRS])


def family(runs: pd.DataFrame, requested: Sequence[tuple[str, str, str]]) -> pd.DataFrame:
    """Compare requested pairs of estimators, as one family of tests.

    The requested pairs are, for example, the claims of a paper. The comparison is that of
    :func:`pairs`, but the p-values are adjusted over the requested pairs only. The result has the
    columns :data:`FAMILY`. For an undecided pair ``needed_runs`` is the number of runs that would
    give a verdict (:func:`.statistics.runs_to_decide`).

    Parameters
    ----------
    runs : table of runs with a column ``draw``, the index of the cluster.
    requested : case, first and second estimator of each pair; all must have runs.
    """
    import pandas as pd

    flown = {
        (str(case), str(label)): PairedRuns.of(own)
        for (case, label), own in runs.groupby(["case", "estimator"], sort=False)
    }
    rows = []
    for case, first, second in requested:
        one, two = flown[case, first], flown[case, second]
        rows.append({"case": case, "first": first, "second": second} | compared(one, two))
    rows_judged = judged(rows)
    for row in rows_judged:
        one, two = (flown[row["case"], row[role]] for role in ("first", "second"))
        one, two = one.among(two.run), two.among(one.run)
        both = (one.squares > 0.0) & (two.squares > 0.0)
        squares = one.squares[both], two.squares[both]
        needed = runs_to_decide(*squares, one.draw[both], 2 * len(requested))
        row["needed_runs"] = needed if row["verdict"] == UNDECIDED else math.nan
    return pd.DataFrame(rows_judged).reindex(columns=[*FAMILY])


class PairedRuns(NamedTuple):
    """Errors of one estimator in the runs of one case, for comparisons.

    Attributes
    ----------
    run : (R,) increasing indices of the runs.
    draw : (R,) index of the cluster of each run.
    squares : (R,) mean squared position error in the settled window [m²]; NaN for failed runs.
    succeeded : (R,) mask of the runs that end within the required error.
    """

    run: np.ndarray
    draw: np.ndarray
    squares: np.ndarray
    succeeded: np.ndarray

    @classmethod
    def of(cls, runs: pd.DataFrame) -> PairedRuns:
        """Return the data of one estimator in one case, from a table of its runs."""
        ordered = runs.sort_values("run")
        run, draw, squares = (ordered[name].to_numpy() for name in ("run", "draw", ERRORS))
        return cls(run, draw, squares, succeeded(ordered))

    def among(self, runs: np.ndarray) -> PairedRuns:
        """Return the data of the runs whose indices are in ``runs`` (N,)."""
        chosen = np.isin(self.run, runs)
        return PairedRuns(*(values[chosen] for values in self))


def compared(first: PairedRuns, second: PairedRuns) -> dict[str, Any]:
    """Compare two estimators on common runs; p-values are not adjusted."""
    one, two = first.among(second.run), second.among(first.run)
    only, other = one.succeeded & ~two.succeeded, two.succeeded & ~one.succeeded
    lead = cluster_means(only.astype(float) - other, one.draw)
    both = (one.squares > 0.0) & (two.squares > 0.0)  # NaN of a run that failed
    ratio = log_ratio(one.squares[both], two.squares[both], one.draw[both])
    return {
        "runs": int(both.sum()),
        "error_ratio": ratio.ratio,
        "lo": ratio.lo,
        "hi": ratio.hi,
        "p": ratio.p,
        "first_only": int(only.sum()),
        "second_only": int(other.sum()),
        # Clusters count once: runs that share a map error succeed or fail together.
        "success_p": exact_p(int((lead > 0.0).sum()), int((lead < 0.0).sum())),
        "_lead": float(lead.sum()),
        "_equivalent": ratio.p_equivalent < ALPHA and len(np.unique(one.draw[both])) >= FEWEST,
    }


def judged(pairs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return comparisons with verdicts and adjusted p-values.

    Holm's procedure adjusts the p-values over all comparisons.
    """
    adjusted = holm([pair[key] for pair in pairs for key in ("success_p", "p")])
    rows = []
    for pair, (success_p, p) in zip(pairs, adjusted.reshape(-1, 2).tolist(), strict=True):
        lead, equivalent = pair["_lead"], pair["_equivalent"]
        row = {key: value for key, value in pair.items() if not key.startswith("_")}
        row |= {"success_p": success_p, "p": p}
        row["verdict"] = UNDECIDED
        if success_p < ALPHA and lead != 0.0:
            row["verdict"] = BETTER if lead > 0.0 else WORSE
        elif equivalent:
            row["verdict"] = EQUIVALENT
        elif p < ALPHA:
            row["verdict"] = BETTER if row["error_ratio"] < 1.0 else WORSE
        rows.append(row)
    return rows


def pair_of(table: pd.DataFrame, case: str, first: str, second: str) -> dict[str, Any] | None:
    """Return the row of a table of pairs that compares ``first`` with ``second``.

    The result is None if the table does not have the pair. If the table has the pair in opposite
    order, the row is inverted.
    """
    chosen = table[table["case"] == case]
    for one, other in ((first, second), (second, first)):
        matching = chosen[(chosen["first"] == one) & (chosen["second"] == other)]
        if len(matching):
            row: dict[str, Any] = matching.iloc[0].to_dict()
            return row if one == first else _swapped(row)
    return None


def _swapped(pair: dict[str, Any]) -> dict[str, Any]:
    """Return a pair as seen from its second estimator."""

    def inverse(value: float) -> float:
        return 1.0 / value if value else math.inf

    return pair | {
        "first": pair["second"],
        "second": pair["first"],
        "error_ratio": inverse(pair["error_ratio"]),
        "lo": inverse(pair["hi"]),
        "hi": inverse(pair["lo"]),
        "first_only": pair["second_only"],
        "second_only": pair["first_only"],
        "verdict": {BETTER: WORSE, WORSE: BETTER}.get(pair["verdict"], pair["verdict"]),
    }
