"""Findings: sentences of the front page, each with its metrics and a threshold.

A finding is a function of the metrics of a scenario. It returns its sentence, or nothing where its
threshold is not met.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import pandas as pd

from ..figures.numbers import span
from ..judging.consistency import CONSERVATIVE, CONSISTENT, OVERCONFIDENT, UNSAFE
from ..results.digest import Digest
from .columns import metres, share

SUITE, MEASURED = "suite", "vinton2008"
"""Scenarios of findings: the cases of the first one are the columns of the matrix."""
NARROW = ("air-narrow", "ship-narrow", "drone-narrow")
"""Cases of the suite with a right model and a narrow prior."""
FILTERS = ("ekf", "ekf[iterations=5]", "ukf", "factor-graph")


class Metrics:
    """Metrics of a scenario's settled window by case and estimator."""

    def __init__(self, table: pd.DataFrame) -> None:
        self._rows = table.set_index(["case", "estimator"])

    @property
    def older(self) -> bool:
        """Whether the table is of version 0.2.0, whose ``efficiency`` is over the bound."""
        return "oracle_ratio" in self._rows.columns

    def value(self, case: str, estimator: str, column: str) -> float:
        """Return a metric, NaN where it was not flown."""
        if (case, estimator) not in self._rows.index:
            return math.nan
        return float(self._rows.loc[(case, estimator), column])

    def rms(self, case: str, estimator: str) -> float:
        """Return the RMS position error [m]."""
        return self.value(case, estimator, "rms_m")

    def consistency(self, case: str, estimator: str) -> str:
        """Return the verdict on an estimator's covariances, "" where it was not flown."""
        if (case, estimator) not in self._rows.index:
            return ""
        return str(self._rows.loc[(case, estimator), "consistency"])


def measured(of: Metrics) -> str:
    """Measured gradients divide the INS's error by three or more; white noise is overconfident."""
    coloured, white, smoother = "0.3km", "white", "gauss-newton"
    ins, aided = of.rms(coloured, "ins"), of.rms(coloured, smoother)
    consistent = of.consistency(coloured, smoother) in (CONSISTENT, CONSERVATIVE)
    overconfident = of.consistency(white, smoother) in (OVERCONFIDENT, UNSAFE)
    nees = of.value(white, smoother, "nees")
    if not (ins >= 3.0 * aided and consistent and overconfident):
        return ""
    return (
        f"Measured gradients over the Vinton Dome reduce the INS's {metres(ins)} m to "
        f"{metres(aided)} m by a batch smoother, with a map of other days. It is consistent with "
        f"coloured noise; with white noise its NEES is {nees:.0f} of 6."
    )


def narrow_prior(of: Metrics) -> str:
    """With the right model and a narrow prior the EKF is efficient; limits 0.97 and 1.03."""
    ratios = [of.value(case, "ekf", "efficiency") for case in NARROW]
    if of.older:
        return ""
    others = [of.rms(case, name) / of.rms(case, "ekf") for case in NARROW for name in FILTERS]
    if not (all(0.97 <= r <= 1.03 for r in ratios) and all(0.97 <= r <= 1.03 for r in others)):
        return ""
    found = span(f"{min(ratios):.2f}", f"{max(ratios):.2f}")
    return (
        f"With a narrow prior and the right model use the EKF: its RMS error is {found} "
        f"× oracle. The UKF and the factor graph agree with it within 3%."
    )


def wide_prior(of: Metrics) -> str:
    """With a prior of three correlation lengths the EKF is unsafe; a particle filter is not."""
    case, particles = "prior-3", "rao-blackwellised"
    linear, sampled = (of.value(case, name, "success") for name in ("ekf", particles))
    right = of.consistency(case, particles) in (CONSISTENT, CONSERVATIVE)
    if not (linear <= 0.5 and sampled >= 0.9 and right and of.consistency(case, "ekf") == UNSAFE):
        return ""
    return (
        "With a prior of three correlation lengths the Rao-Blackwellised particle filter succeeds "
        f"in {share(sampled)} of the runs, with {metres(of.rms(case, particles))} m. The EKF "
        f"succeeds in {share(linear)}, and its covariance does not show it."
    )


def outliers(of: Metrics) -> str:
    """With 20% outliers the Cauchy loss reduces the EKF's error by half or more."""
    case, robust = "outliers", "ekf[loss=cauchy]"
    plain, loss = of.rms(case, "ekf"), of.rms(case, robust)
    if not plain >= 2.0 * loss:
        return ""
    clean = of.rms("air-narrow", robust) / of.rms("air-narrow", "ekf") - 1.0
    return (
        f"With 20% outliers the EKF's RMS error is {metres(plain)} m, with a Cauchy loss "
        f"{metres(loss)} m. Without outliers the loss costs {share(clean)}."
    )


def map_error(of: Metrics) -> str:
    """A map error that is not modelled at least doubles the error; modelled it is consistent."""
    bound = of.value("map-error", "ekf", "bound_m")
    plain, modelled = of.rms("map-error", "ekf"), of.rms("map-error-modelled", "ekf")
    verdicts = of.consistency("map-error", "ekf"), of.consistency("map-error-modelled", "ekf")
    known = verdicts[0] == UNSAFE and verdicts[1] in (CONSISTENT, CONSERVATIVE)
    if not (plain >= 2.0 * modelled and known):
        return ""
    return (
        f"A map error of 5 E over 1 km, not modelled, leaves the EKF {metres(plain)} m, where a "
        f"right map allows {metres(bound)} m. Modelled as walking biases: {metres(modelled)} m, "
        "consistent."
    )


def gravity(of: Metrics) -> str:
    """Gravity that a strategic INS does not know costs the EKF a factor of two or more."""
    plain, bound = of.rms("gravity", "ekf"), of.value("gravity", "ekf", "bound_m")
    if not plain >= 2.0 * bound:
        return ""
    return (
        f"Gravity unknown to a strategic INS leaves the EKF {metres(plain)} m where "
        f"{metres(bound)} m are possible, overconfident."
    )


def outage(of: Metrics) -> str:
    """After GNSS fails the gradiometer reduces the INS's error by half or more."""
    ins, aided = of.rms("gnss-outage", "ins"), of.rms("gnss-outage", "ekf")
    if not ins >= 2.0 * aided:
        return ""
    return (
        f"From 1.5 to 3.5 h after GNSS is jammed, a ship's RMS error is {metres(ins)} m. A "
        f"gradiometer of 1 E reduces it to {metres(aided)} m."
    )


def weak_field(of: Metrics) -> str:
    """Over a weak field aiding gains less than a fifth."""
    ins, aided = of.rms("weak-field", "ins"), of.rms("weak-field", "ekf")
    if not aided >= 0.8 * ins:
        return ""
    return (
        f"Over the Great Plains a gradiometer of 1 E gains little: {metres(aided)} m for the "
        f"INS's {metres(ins)} m."
    )


FINDINGS: tuple[tuple[str, Callable[[Metrics], str]], ...] = (
    (MEASURED, measured),
    (SUITE, narrow_prior),
    (SUITE, wide_prior),
    (SUITE, outliers),
    (SUITE, map_error),
    (SUITE, gravity),
    (SUITE, outage),
    (SUITE, weak_field),
)
"""Scenario and function of each finding, in the order of the front page."""


def findings(digests: Sequence[Digest]) -> list[str]:
    """Return the findings that the metrics of their scenarios support."""
    metrics = {found.manifest["scenario"]: Metrics(found.metrics) for found in digests}
    sentences = [finding(metrics[name]) for name, finding in FINDINGS if name in metrics]
    return [sentence for sentence in sentences if sentence]
