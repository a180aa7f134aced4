"""The checks of ``ggbench check`` find what they are there for, and nothing else."""

from __future__ import annotations

import pytest
from thinning import thinned

from ggbench.campaign import registry
from ggbench.contract.catalogue import CHECKS, flight
from ggbench.contract.demands import Broken, Refused

FILTER = """
from dataclasses import dataclass

import numpy as np

from ggbench.problem import Estimate, Estimator


@dataclass(frozen=True)
class Filter(Estimator):
    name = "filter"
    causality = "filter"
    exact_if_linear_gaussian = True

    def estimate(self, problem, rng):
        x, p = problem.prior_mean, problem.prior_cov
        means, covs = [], []
        for k in range(problem.epochs):
            phi = problem.transition[k]
            x, p = phi @ x, phi @ p @ phi.T + problem.process_cov[k]
            h, noise = problem.model.jacobian(k, x), problem.noise_of(k)
            y = problem.measurements[k] - problem.model.predict(k, x)
            gain = np.linalg.solve(h @ p @ h.T + noise, h @ p).T
            x = x + gain @ y
            keep = np.eye(len(x)) - gain @ h
            p = keep @ p @ keep.T + gain @ noise @ gain.T
            p = 0.5 * (p + p.T)
            means.append(x)
            covs.append(p)
        means, covs = np.array(means), np.array(covs)
        return Estimate(means, covs, self.causality)
"""
END = "        return Estimate(means"
SIZE = "        size = np.sqrt(np.diagonal(covs, axis1=1, axis2=2))\n"

BROKEN = {
    "estimate": ("Estimate(means, ", "Estimate(means.T, ", "must have (40, 5)"),
    "covariance": (
        END,
        f"{SIZE}        covs[-1, 0, 1] += 1e-10 * size[-1, 0] * size[-1, 1]\n{END}",
        "the covariance at epoch 39 is not symmetric: largest difference of correlations 1e-10",
    ),
    "repeatable": (
        END,
        f"        means *= 1.0 + 1e-15 * np.random.randint(1, 9, means.shape)\n{END}",
        "gave different values of mean, first at epoch 0",
    ),
    "inputs": (
        END,
        f"        object.__setattr__(problem.model, 'kept', means)\n{END}",
        "replaced arrays of the problem",
    ),
    "causality": (
        END,
        f"{SIZE}        means += 5e-10 * size * np.tanh(0.1 * problem.measurements[-1, 0])\n{END}",
        "later measurements although its causality is 'filter': when measurements after epoch 20",
    ),
    "exact": (
        "exact_if_linear_gaussian = True",
        "exact_if_linear_gaussian = False",
        "on a linear problem: the mean differs by",
    ),
    "noise": ("problem.noise_of(k)", "problem.noise_of(0)", "posterior standard deviations from"),
    "gaps": (
        "            x = x + gain @ y\n",
        "            if not problem.present[k].all():\n                gain = 0.0 * gain\n"
        "            x = x + gain @ y\n",
        "with missing measurements: the mean differs by up to",
    ),
    "short": (
        "means, covs = np.array(means), np.array(covs)",
        "means, covs = np.array(means).squeeze(), np.array(covs).squeeze()",
        "mean has the shape (5,) and must have (1, 5); the number of elements is right",
    ),
}
"""What each check finds: a change of the filter, and a part of what is said of it."""


def made(tmp_path, text):
    file = tmp_path / "filter.py"
    file.write_text(text)
    return registry.choose(str(file)).estimator


def verdicts(estimator):
    found = {}
    for check in CHECKS:
        try:
            check.ask(estimator)
        except (Broken, Refused) as error:
            found[check.name] = f"{type(error).__name__}: {error}"
            if check is CHECKS[0]:  # without an estimate nothing else is asked
                break
    return found


def test_every_check_has_a_broken_filter():
    assert list(BROKEN) == [check.name for check in CHECKS]


def test_a_kalman_filter_passes(tmp_path):
    assert verdicts(made(tmp_path, FILTER)) == {}


@thinned("name", BROKEN, every=2)
def test_the_right_check_fails(tmp_path, name):
    """One mistake, one check that finds it, in words that say which."""
    old, new, said = BROKEN[name]
    assert old in FILTER
    text = FILTER.replace(old, new)
    if (
        name == "exact"
    ):  # of one that is not exact: a gain that takes R for sixteen times what it is
        text = text.replace("h @ p @ h.T + noise", "h @ p @ h.T + 16.0 * noise")
    found = verdicts(made(tmp_path, text))
    assert list(found) == [name]
    assert said in found[name]


@thinned(
    ("old", "new", "name", "said"),
    [
        (
            "Estimate(means, covs, self.causality)",
            "None",
            "estimate",
            "must return an Estimate, not None",
        ),
        (", self.causality)", ", 'batch')", "estimate", "the causality of the estimate is 'batch'"),
        ("Estimate(means, ", "Estimate(means + 0j, ", "estimate", "type complex128"),
        ("Estimate(means, ", "Estimate(means * np.nan, ", "estimate", "not finite at 40 epochs"),
        (END, f"        covs[-1, 2, 2] *= -1.0\n{END}", "covariance", "variance of state 2 at"),
        ('causality = "filter"', 'causality = "batch"', "causality", "declare 'filter'"),
        ('causality = "filter"', 'causality = "none"', "causality", "is 'none', but when m"),
    ],
)
def test_other_mistakes_are_named(tmp_path, old, new, name, said):
    assert old in FILTER
    found = verdicts(made(tmp_path, FILTER.replace(old, new)))
    assert said in found[name]


def test_what_an_estimator_does_not_take_is_not_asked(tmp_path):
    """Of one that refuses all but flights over a map, what can be asked there is asked."""
    taking = "    def skip(self, problem):\n        return None if problem.map else 'no map'\n\n"
    text = FILTER.replace("    def estimate", f"{taking}    def estimate")
    found = verdicts(made(tmp_path, text))
    assert found == dict.fromkeys(("exact", "noise", "gaps", "short"), "Refused: no map")
    text = text.replace("return Estimate(means, ", "return Estimate(0.5 * means[:, ::-1], ")
    text = text.replace("covs, self", "-covs, self")
    assert "on a flight over a map: the variance of" in verdicts(made(tmp_path, text))["covariance"]


def test_the_flight_is_one_over_a_map():
    assert flight().map is not None
    assert (flight().epochs, flight().dimension) == (40, 15)


SIGMA_POINTS = """
from dataclasses import dataclass

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from ggbench.problem import Estimate, Estimator


@dataclass(frozen=True)
class Filter(Estimator):
    name = "filter"
    causality = "filter"
    exact_if_linear_gaussian = True

    def estimate(self, problem, rng):
        n, m = problem.dimension, problem.measurements.shape[1]
        ukf = UnscentedKalmanFilter(
            n, m, 1.0, hx=lambda x, k: problem.model.predict(k, x),
            fx=lambda x, dt, k: problem.transition[k] @ x,
            points=MerweScaledSigmaPoints(n, 1e-3, 2, 0),
        )
        ukf.x, ukf.P = problem.prior_mean, problem.prior_cov
        means, covs = [], []
        for k in range(problem.epochs):
            ukf.Q = problem.process_cov[k]
            ukf.predict(k=k)
            ukf.update(problem.measurements[k], R=problem.noise_of(k), k=k)
            means.append(ukf.x)
            covs.append(0.5 * (ukf.P + ukf.P.T))
        means, covs = np.array(means), np.array(covs)
        return Estimate(means, covs, self.causality)
"""
"""filterpy's own, with the spread of points that its documents advise: their weights are 1e6."""
ASKED_EXACTLY = ("exact", "noise", "gaps", "short")


@pytest.mark.long
def test_one_that_loses_digits_passes_with_a_remark(tmp_path):
    """What rounding explains is no mistake: here 1e-6 of the posterior's deviations."""
    estimator = made(tmp_path, SIGMA_POINTS)
    remarks = {check.name: check.ask(estimator) for check in CHECKS}
    assert [name for name, said in remarks.items() if said] == list(ASKED_EXACTLY)
    assert all("rounding errors are large" in remarks[name] for name in ASKED_EXACTLY)


def test_one_without_covariance_is_asked_for_its_mean_alone(tmp_path):
    """It passes every check; a wrong mean still fails."""
    alone = FILTER.replace("Estimate(means, covs, ", "Estimate(means, None, ")
    remarks = {check.name: check.ask(made(tmp_path, alone)) for check in CHECKS}
    assert all("only the mean is compared" in remarks[name] for name in ASKED_EXACTLY)
    wrong = alone.replace(END, f"        means = 1.001 * means\n{END}")
    (exact,) = [check for check in CHECKS if check.name == "exact"]
    with pytest.raises(Broken, match="correct the estimator"):
        exact.ask(made(tmp_path, wrong))


@pytest.mark.parametrize(("off", "passes"), [(3e-6, True), (3e-5, False)])
def test_a_small_difference_is_a_remark_and_a_larger_one_a_mistake(off, passes, tmp_path):
    text = FILTER.replace(END, f"{SIZE}        means = means + {off:g} * size\n{END}")
    (exact,) = [check for check in CHECKS if check.name == "exact"]
    estimator = made(tmp_path, text)
    if passes:
        assert "from the exact one by 3e-06 posterior standard deviations" in exact.ask(estimator)
    else:
        with pytest.raises(Broken, match="correct the estimator"):
            exact.ask(estimator)


@thinned("text", [FILTER, SIGMA_POINTS])
def test_a_mistake_that_rounding_does_not_explain_fails(tmp_path, text):
    """2e-5 of the posterior's deviations from a filter that rounds well, 5e-5 from the other."""
    size = 2e-5 if text is FILTER else 5e-5
    text = text.replace(END, f"{SIZE}        means += {size} * size\n{END}")
    found = verdicts(made(tmp_path, text))
    assert list(found) == list(ASKED_EXACTLY)
    assert "correct the estimator" in found["exact"]
