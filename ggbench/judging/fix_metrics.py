"""Metrics of matchers' position fixes: right, false and rejected fixes, errors, consistency.

A fix is *right* if the horizontal error at the epoch of the fix is below the case's required error.
A fix is *false* if it is accepted and not right. Fixes of one flight may share measurements and
errors. Therefore the shares of right and false fixes count runs, each by its first accepted fix.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..problem import Fixes
from .convergence import median_interval
from .run_errors import real_array
from .statistics import mean_band, wilson

if TYPE_CHECKING:
    import pandas as pd

HORIZONTAL = 2
"""Dimensions in which fixes are judged: east and north."""
ROWS = ("time_s", "error_m", "nees", "statistic", "accepted")
"""Columns of each fix."""
COLUMNS = (
    "fixes",
    "accepted",
    "false",
    "right_share",
    "right_lo",
    "right_hi",
    "false_share",
    "false_lo",
    "false_hi",
    "none_share",
    "none_lo",
    "none_hi",
    "right_time_median_s",
    "right_time_lo",
    "right_time_hi",
    "cep50_m",
    "cep95_m",
    "nees",
    "nees_lo",
    "nees_hi",
)
"""Metrics of the fixes of an estimator on a case, see :func:`metrics`."""


def checked(fixes: Fixes, epochs: int) -> Fixes:
    """Validate the fixes of a flight with ``epochs`` epochs, and return them as plain arrays.

    Raises
    ------
    ValueError
        If the fixes violate :class:`.Fixes`, are not finite, or a covariance is not positive
        definite.
    """
    if not isinstance(fixes, Fixes):
        raise ValueError(f"the estimate's fixes must be Fixes, not {type(fixes).__name__}")
    count = np.size(fixes.epoch)
    epoch = real_array("fixes.epoch", fixes.epoch, (count,))
    if (np.diff(epoch) <= 0).any() or ((epoch < 0) | (epoch >= epochs) | (epoch % 1 != 0)).any():
        raise ValueError(f"the estimate's fixes.epoch must increase from 0 to {epochs - 1} at most")
    size = np.shape(fixes.mean)[-1] if np.ndim(fixes.mean) == 2 else 0
    if size not in (HORIZONTAL, 3):
        raise ValueError("the estimate's fixes.mean must have two or three dimensions per fix")
    mean = real_array("fixes.mean", fixes.mean, (count, size))
    cov = real_array("fixes.cov", fixes.cov, (count, size, size))
    statistic = real_array("fixes.statistic", fixes.statistic, (count,))
    accepted = real_array("fixes.accepted", fixes.accepted, (count,)).astype(bool)
    for name, values in (("mean", mean), ("cov", cov)):
        if not np.isfinite(values).all():
            raise ValueError(f"the estimate's fixes.{name} is not finite")
    if np.isnan(statistic).any():
        raise ValueError("the estimate's fixes.statistic is NaN")
    if count and np.linalg.eigvalsh(cov).min() <= 0.0:
        raise ValueError("the estimate's fixes.cov is not positive definite")
    return Fixes(epoch.astype(int), mean, cov, accepted, statistic)


def judge(fixes: Fixes, error_state: np.ndarray, times: np.ndarray) -> list[dict[str, Any]]:
    """Return a row with the columns :data:`ROWS` for each fix of a run, for storage.

    A row has the time [s], the horizontal error [m] and the NEES of the two horizontal errors. It
    also has the statistic of the acceptance test, and whether the fix was accepted. The NEES is
    infinite if the covariance is too small to invert. An infinite statistic is replaced by the
    largest float.

    Parameters
    ----------
    fixes : fixes from :func:`checked`.
    error_state : (K, n) true INS error.
    times : (K,) epochs [s].
    """
    off = error_state[fixes.epoch, :HORIZONTAL] - fixes.mean[:, :HORIZONTAL]
    cov = fixes.cov[:, :HORIZONTAL, :HORIZONTAL]
    nees = np.einsum("fi,fi->f", off, np.linalg.solve(cov, off[..., np.newaxis])[..., 0])
    nees = np.where(nees >= 0.0, nees, np.inf)
    arrays = (
        times[fixes.epoch],
        np.linalg.norm(off, axis=1),
        nees,
        np.nan_to_num(fixes.statistic),
        fixes.accepted,
    )
    columns = (values.tolist() for values in arrays)
    return [dict(zip(ROWS, values, strict=True)) for values in zip(*columns, strict=True)]


def metrics(fixes: pd.DataFrame, runs: int, right_m: float) -> dict[str, float]:
    """Return the metrics of :data:`COLUMNS` over the fixes of an estimator on a case.

    - The numbers of attempted, accepted and false fixes;
    - three shares of *runs* with Wilson's 95 % intervals: first accepted fix right, first accepted
      fix false, no accepted fix;
    - the median time [s] of the first right fix over the runs with a right fix, with a 95 %
      interval;
    - the radii [m] that contain 50 and 95 % of the errors of accepted fixes;
    - the mean NEES of the accepted fixes, and its 95 % band for a consistent estimator. The
      expected NEES is 2. For the band each run with an accepted fix is one sample.

    Parameters
    ----------
    fixes : table with the columns ``run`` and :data:`ROWS`.
    runs : number of all runs, including failed ones and those without attempts.
    right_m : horizontal error [m] below which a fix is right.
    """
    accepted = fixes[fixes["accepted"]]
    right = accepted["error_m"] < right_m
    first = accepted.drop_duplicates("run")
    hits = int((first["error_m"] < right_m).sum())
    misses = len(first) - hits
    when = accepted[right].drop_duplicates("run")["time_s"]
    radii = (math.nan, math.nan)
    if len(accepted):
        radii = tuple(np.quantile(accepted["error_m"], [0.5, 0.95]).tolist())
    values = (
        len(fixes),
        len(accepted),
        int((~right).sum()),
        *wilson(hits, runs),
        *wilson(misses, runs),
        *wilson(runs - len(first), runs),
        *median_interval(when.to_numpy()),
        *radii,
        float(accepted["nees"].mean()),
        *mean_band(len(first), HORIZONTAL),
    )
    return dict(zip(COLUMNS, values, strict=True))
