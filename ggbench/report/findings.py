"""Findings of the front page: sentences with numbers, each with a threshold.

A finding is a function of a scenario's metrics. It returns a sentence with numbers from the
metrics, or "" if the threshold is not met.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import pandas as pd

from ..figures.numbers import span
from ..judging.consistency import CONSERVATIVE, CONSISTENT, OVERCONFIDENT, UNSAFE
from ..results.digest import Digest
from .columns import duration, metres, share

SUITE, MEASURED = "suite", "vinton2008"
"""Scenarios of the findings: the standard suite, and measured gradients at Vinton Dome."""
BIASES = "vinton2008_biases"
"""Sweep of constant biases that are added to the measurements of MEASURED."""
FOSTERVILLE, EAST_VICTORIA = "fosterville2019", "east_victoria2023"
"""The other measured surveys."""
NARROW = ("air-narrow", "ship-narrow", "drone-narrow")
"""Cases of the suite with a right model and a narrow prior."""
FILTERS = ("ekf", "ukf", "gaussian-sum")
WIDE = (
    "gaussian-sum",
    "gaussian-sum[loss=cauchy]",
    "multiple-model",
    "sitan[bank=auto,sigma_m=300,most=1000]",
    "rao-blackwellised",
)
"""Causal estimators that are made for a wide prior."""
ONE_FILTER = "multiple-model"
TOLD = {
    "outliers": ("outliers-known", "ekf"),
    "wrong-noise": ("wrong-noise-known", "ekf"),
    "map-error": ("map-error-known", "ekf"),
    "gravity": ("gravity-known", "ekf"),
    "prior-1": ("prior-1", "gaussian-sum"),
    "prior-3": ("prior-3", "gaussian-sum"),
}
"""Case and estimator with the right model, by the compared case with a wrong model.

All other cases are compared with the EKF in the same case.
"""


class Metrics:
    """Metrics of a scenario in the settled window, by case and estimator.

    The settled window lasts from ``windows.settled_from_s`` of a case to the end of the flight.
    """

    def __init__(self, table: pd.DataFrame) -> None:
        self._rows = table.set_index(["case", "estimator"])

    def value(self, case: str, estimator: str, column: str) -> float:
        """Return a metric; NaN if the estimator was not run on the case."""
        if (case, estimator) not in self._rows.index:
            return math.nan
        return float(self._rows.loc[(case, estimator), column])

    def cases(self, estimator: str) -> list[str]:
        """Return the cases on which an estimator was run."""
        return [case for case, name in self._rows.index if name == estimator]

    def rms(self, case: str, estimator: str) -> float:
        """Return the RMS position error [m]."""
        return self.value(case, estimator, "rms_m")

    def consistency(self, case: str, estimator: str) -> str:
        """Return the verdict on an estimator's covariances; "" if it was not run on the case."""
        if (case, estimator) not in self._rows.index:
            return ""
        return str(self._rows.loc[(case, estimator), "consistency"])


def measured(of: Metrics) -> str:
    """Return the finding that a filter with measured gradients halves the INS's error.

    The flown lines are left out of the map.
    """
    folds, name = ("fold-1", "fold-2"), "gaussian-sum"
    ins, aided = ([of.rms(fold, estimator) for fold in folds] for estimator in ("ins", name))
    right = all(of.consistency(fold, name) in (CONSISTENT, CONSERVATIVE) for fold in folds)
    if not (all(i >= 2.0 * a for i, a in zip(ins, aided, strict=True)) and right):
        return ""
    errors = [span(*map(metres, both), separator=" and ") for both in (ins, aided)]
    shares = span(*(share(of.value(fold, name, "success")) for fold in folds), separator=" and ")
    return (
        f"Two maps of [Vinton Dome]({MEASURED}.md) each omit some survey lines. On flights "
        f"that repeat these lines, the INS's RMS error is {errors[0]} m. With measured gradients "
        f"the Gaussian sum has {errors[1]} m, is consistent and succeeds in {shares} of the runs."
    )


def measured_biases(of: Metrics) -> str:
    """Return the finding that unmodelled gradient biases of 10 E double the position error.

    The biases are constant and added to measured gradients.
    """
    name = "gaussian-sum"
    cases = ("neglected_bias-1", "neglected_bias-10", "estimated_bias-10")
    small, biased, estimated = (of.rms(case, name) for case in cases)
    if not (biased >= 2.0 * small and estimated < biased):
        return ""
    return (
        f"With a [bias]({BIASES}.md) of 1 E in each measured channel the Gaussian sum's RMS error "
        f"is {metres(small)} m. For 10 E it is {metres(biased)} m, or {metres(estimated)} m with "
        "bias states."
    )


def fosterville(of: Metrics) -> str:
    """Return the finding that measured gradients halve the INS error at Fosterville.

    The survey lines of the map are 200 m apart.
    """
    case, name = "coloured", "gaussian-sum"
    ins, aided = of.rms(case, "ins"), of.rms(case, name)
    if not ins >= 2.0 * aided:
        return ""
    return (
        f"At [Fosterville]({FOSTERVILLE}.md) two measured components reduce the INS's RMS error of "
        f"{metres(ins)} m to {metres(aided)} m; "
        f"{share(of.value(case, name, 'success'))} of the runs succeed."
    )


def east_victoria(of: Metrics) -> str:
    """Return the finding that measured gravity along one line hardly reduces the INS error.

    With one measurement a minute, the EKF's error must be at least 0.6 times the INS error. An EKF
    that assumes white noise in all samples must be overconfident or unsafe.
    """
    case, name = "60s", "ekf"
    ins, aided = of.rms(case, "ins"), of.rms(case, name)
    every = of.consistency("2s", name) in (OVERCONFIDENT, UNSAFE)
    if not (aided >= 0.6 * ins and every):
        return ""
    return (
        f"At [East Victoria]({EAST_VICTORIA}.md) one gravimeter measurement a minute reduces "
        f"the INS's RMS error of {metres(ins)} m to {metres(aided)} m. An EKF that "
        f"uses every sample and assumes white noise has {metres(of.rms('2s', name))} m and is "
        "overconfident."
    )


def narrow_prior(of: Metrics) -> str:
    """Return the finding that the EKF is efficient with a narrow prior and the right model.

    The ratio to the oracle must lie between 0.99 and 1.01.
    """
    ratios = [of.value(case, "ekf", "efficiency") for case in NARROW]
    others = [of.rms(case, name) / of.rms(case, "ekf") for case in NARROW for name in FILTERS]
    if not (all(0.99 <= r <= 1.01 for r in ratios) and all(0.97 <= r <= 1.03 for r in others)):
        return ""
    found = span(f"{min(ratios):.3f}", f"{max(ratios):.3f}")
    apart = max(abs(other - 1.0) for other in others)
    return (
        "With a prior below 0.05 correlation lengths and the right model use the EKF: its RMS "
        f"error is {found} times that of an efficient filter ([oracle](definitions.md)). The "
        f"errors of the UKF and the Gaussian sum are within {apart:.1%} of the EKF's."
    )


def wide_prior(of: Metrics) -> str:
    """Return the finding that the EKF is unsafe if the prior σ is three correlation lengths.

    At least two other filters must succeed in 90% of the runs and be consistent or conservative.
    """
    case = "prior-3"
    good = [
        name
        for name in WIDE
        if of.value(case, name, "success") >= 0.9
        and of.consistency(case, name) in (CONSISTENT, CONSERVATIVE)
    ]
    linear = of.value(case, "ekf", "success")
    if not (len(good) > 1 and linear <= 0.5 and of.consistency(case, "ekf") == UNSAFE):
        return ""
    costs = [
        f"`{name}` ({metres(of.rms(case, name))} m, "
        f"{duration(of.value(case, name, 'seconds_per_run'))})"
        for name in good
    ]
    return (
        f"With a prior of three correlation lengths use one of these (RMS error, time per run): "
        f"{', '.join(costs[:-1])} or {costs[-1]}. The EKF [succeeds](definitions.md) in "
        f"{share(linear)} of the runs and is unsafe (‡)."
    )


def outliers(of: Metrics) -> str:
    """Return the finding that a Cauchy loss halves the EKF's error with 20% outliers."""
    case, robust = "outliers", "ekf[loss=cauchy]"
    plain, loss = of.rms(case, "ekf"), of.rms(case, robust)
    if not plain >= 2.0 * loss:
        return ""
    known = of.rms("outliers-known", "ekf")
    clean = of.rms("air-narrow", robust) / of.rms("air-narrow", "ekf") - 1.0
    return (
        f"With 20% outliers the EKF's RMS error is {metres(plain)} m, with a Cauchy loss "
        f"{metres(loss)} m and with the outliers removed {metres(known)} m. Without outliers the "
        f"loss increases the error by {clean:.1%}."
    )


def wrong_noise(of: Metrics) -> str:
    """Return the finding that the EKF's error grows if it assumes a third of the true noise.

    The RMS error must be at least 1.2 times the RMS error of the EKF with the right noise.
    """
    case, known = "wrong-noise", "wrong-noise-known"
    plain, told, one = of.rms(case, "ekf"), of.rms(known, "ekf"), of.rms(case, ONE_FILTER)
    if not plain >= 1.2 * told:
        return ""
    return (
        f"If the noise is three times the assumed noise, the EKF's RMS error is {metres(plain)} m "
        f"and that of `{ONE_FILTER}` {metres(one)} m. An EKF that assumes the true noise has "
        f"{metres(told)} m."
    )


def map_error(of: Metrics) -> str:
    """Return the finding that an unmodelled map error makes the EKF unsafe.

    The median error must be at least 1.5 times the median error with a modelled map error. With
    the modelled map error the EKF must be consistent or conservative.
    """
    case, known = "map-error", "map-error-known"
    plain, told, one, ins = (
        of.value(*cell, "median_m")
        for cell in ((case, "ekf"), (known, "ekf"), (case, ONE_FILTER), (case, "ins"))
    )
    verdicts = of.consistency(case, "ekf"), of.consistency(known, "ekf")
    right = verdicts[0] == UNSAFE and verdicts[1] in (CONSISTENT, CONSERVATIVE)
    if not (plain >= 1.5 * told and right):
        return ""
    lost = of.value(case, "ekf", "lost")
    return (
        f"With an unmodelled map error of 5 E, correlated over 1 km, the EKF's median error is "
        f"{metres(plain)} m (INS {metres(ins)} m); {lost:.0f} of 200 runs are lost. The EKF with a "
        f"model of the error has {metres(told)} m, `{ONE_FILTER}` {metres(one)} m."
    )


def gravity(of: Metrics) -> str:
    """Return the finding that a neglected gravity disturbance doubles the error of an EKF."""
    plain, known = of.rms("gravity", "ekf"), of.rms("gravity-known", "ekf")
    if not plain >= 2.0 * known:
        return ""
    return (
        f"With a strategic INS that neglects the gravity disturbance the EKF's RMS error is "
        f"{metres(plain)} m, that of `{ONE_FILTER}` {metres(of.rms('gravity', ONE_FILTER))} m. If "
        f"the INS integrates measured gradients, the EKF's error is {metres(known)} m."
    )


def one_filter(of: Metrics) -> str:
    """Return the finding that one filter is consistent in nearly all cases of the suite.

    The filter must be consistent or conservative in at least 90% of the cases. In every case its
    RMS error must be at most 1.5 times that of a filter with the right model.
    """
    cases = of.cases(ONE_FILTER)
    right = [of.consistency(case, ONE_FILTER) in (CONSISTENT, CONSERVATIVE) for case in cases]
    ratios = {
        case: of.rms(case, ONE_FILTER) / of.rms(*TOLD.get(case, (case, "ekf"))) for case in cases
    }
    if not (ratios and sum(right) >= 0.9 * len(cases) and max(ratios.values()) <= 1.5):
        return ""
    worst = max(ratios, key=lambda case: ratios[case])
    return (
        f"`{ONE_FILTER}` is consistent or conservative in {sum(right)} of {len(cases)} cases. Its "
        f"RMS error is at most {ratios[worst]:.2f} times that of a filter with the right model; "
        f"the maximum is in case `{worst}`."
    )


def outage(of: Metrics) -> str:
    """Return the finding that a gradiometer halves the INS error after GNSS has failed."""
    ins, aided = of.rms("gnss-outage", "ins"), of.rms("gnss-outage", "ekf")
    if not ins >= 2.0 * aided:
        return ""
    return (
        f"From 1.5 to 3.5 h after GNSS is jammed, the RMS error of a ship's INS is {metres(ins)} "
        f"m. A gradiometer of 1 E reduces it to {metres(aided)} m."
    )


def weak_field(of: Metrics) -> str:
    """Return the finding that aiding reduces the error by less than a fifth over a weak field."""
    ins, aided = of.rms("weak-field", "ins"), of.rms("weak-field", "ekf")
    if not aided >= 0.8 * ins:
        return ""
    return (
        f"Over the Great Plains a gradiometer of 1 E gains little: {metres(aided)} m instead of "
        f"the INS's {metres(ins)} m."
    )


FINDINGS: tuple[tuple[str, Callable[[Metrics], str]], ...] = (
    (SUITE, narrow_prior),
    (SUITE, wide_prior),
    (SUITE, outliers),
    (SUITE, wrong_noise),
    (SUITE, map_error),
    (SUITE, gravity),
    (SUITE, one_filter),
    (MEASURED, measured),
    (BIASES, measured_biases),
    (FOSTERVILLE, fosterville),
    (EAST_VICTORIA, east_victoria),
    (SUITE, outage),
    (SUITE, weak_field),
)
"""Scenario and function of each finding, in the order of the front page."""


def findings(digests: Sequence[Digest]) -> list[str]:
    """Return the sentences of all findings whose thresholds are met."""
    metrics = {found.manifest["scenario"]: Metrics(found.metrics) for found in digests}
    sentences = [finding(metrics[name]) for name, finding in FINDINGS if name in metrics]
    return [sentence for sentence in sentences if sentence]
