"""Filters of Stone Soup and dynamax give the answers of the benchmark's own, and join campaigns."""

from __future__ import annotations

import functools
import importlib
import sys
from dataclasses import replace

import numpy as np
import pytest
from command import invoke
from problems import changed, deviation, estimator, exact, graded, linear_problem, noisy_problem

from ggbench.campaign import registry
from ggbench.contract import demands
from ggbench.contract.references import gappy
from ggbench.results.folder import Results
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.runs import simulate
from ggbench.spec import scenario

STONESOUP = """
from dataclasses import dataclass
from ggbench.adapters.stonesoup import StoneSoupEstimator
from stonesoup.predictor.kalman import KalmanPredictor, UnscentedKalmanPredictor
from stonesoup.smoother.kalman import KalmanSmoother
from stonesoup.updater.kalman import ExtendedKalmanUpdater, UnscentedKalmanUpdater

@dataclass(frozen=True)
class Mine(StoneSoupEstimator):
    name = "mine"
"""
DYNAMAX = """
from dataclasses import dataclass
from ggbench.adapters.dynamax import DynamaxEstimator
from dynamax.nonlinear_gaussian_ssm import (
    UKFHyperParams, extended_kalman_filter, extended_kalman_smoother, unscented_kalman_filter,
)

@dataclass(frozen=True)
class Mine(DynamaxEstimator):
    name = "mine"
"""
FILES = {
    ("stonesoup", "ekf"): f"""{STONESOUP}
    def filter(self, transition, measurement):
        return KalmanPredictor(transition), ExtendedKalmanUpdater(measurement)
""",
    ("stonesoup", "ukf"): f"""{STONESOUP}
    def filter(self, transition, measurement):
        return (
            UnscentedKalmanPredictor(transition, alpha=1.0, beta=0.0),
            UnscentedKalmanUpdater(measurement, alpha=1.0, beta=0.0),
        )
""",
    ("stonesoup", "smoother"): f"""{STONESOUP}
    causality = "batch"
    def filter(self, transition, measurement):
        return KalmanPredictor(transition), ExtendedKalmanUpdater(measurement)
    def smooth(self, track):
        return KalmanSmoother(None).smooth(track)
""",
    ("dynamax", "ekf"): f"""{DYNAMAX}
    def posterior(self, parameters, emissions, inputs):
        return extended_kalman_filter(parameters, emissions, inputs=inputs)
""",
    ("dynamax", "ukf"): f"""{DYNAMAX}
    def posterior(self, parameters, emissions, inputs):
        points = UKFHyperParams(alpha=1.0, beta=0.0, kappa=3.0 - len(parameters.initial_mean))
        return unscented_kalman_filter(parameters, emissions, points, inputs=inputs)
""",
    ("dynamax", "smoother"): f"""{DYNAMAX}
    causality = "batch"
    def posterior(self, parameters, emissions, inputs):
        return extended_kalman_smoother(parameters, emissions, inputs=inputs)
""",
}
"""Files of a user's own; the points of their unscented filters are the paper's, as ours are."""
PARTICLES = """
from dataclasses import dataclass
import numpy as np
from ggbench.adapters.stonesoup import StoneSoupEstimator
from stonesoup.predictor.particle import ParticlePredictor
from stonesoup.resampler.particle import ESSResampler
from stonesoup.types.array import StateVectors
from stonesoup.types.state import ParticleState
from stonesoup.updater.particle import ParticleUpdater

@dataclass(frozen=True)
class Mine(StoneSoupEstimator):
    name = "mine"
    exact_if_linear_gaussian = False
    def start(self, prior, rng):
        points = rng.multivariate_normal(np.ravel(prior.state_vector), prior.covar, 1000)
        weights = np.full(len(points), -np.log(len(points)))
        return ParticleState(
            StateVectors(points.T), log_weight=weights, timestamp=prior.timestamp
        )
    def filter(self, transition, measurement):
        return ParticlePredictor(transition), ParticleUpdater(measurement, ESSResampler())
"""
CASES = {"wang2013": "0.01E-1Hz", "outliers": "dropouts", "nonlinearity": ""}
QUICK = "wang2013"
"""Whose map other tests build, too."""
CLOSE = 1e-6
"""Allowed difference, in deviations: of the prior for means, of the posterior for covariances."""


def mine(tmp_path, text):
    file = tmp_path / "mine.py"
    file.write_text(text)
    return registry.choose(str(file))


@functools.cache
def problem_of(name):
    loaded = scenario.load(name)
    case = loaded.case(CASES[name]) if CASES[name] else loaded.cases[0]
    return simulate(prepare(case), 1, 0)[0]


def slow(library, *rest):
    """JAX compiles for seconds, and other maps than the paper's are built for as long."""
    quick = library == "stonesoup" and not set(rest) & {*CASES} - {QUICK}
    return pytest.param(library, *rest, marks=() if quick else pytest.mark.long)


@pytest.mark.parametrize(
    ("library", "kind", "case"),
    [slow(*key, case) for key in FILES for case in CASES if key[1] in ("ekf", "ukf")],
)
def test_their_filters_find_what_ours_find(tmp_path, library, kind, case):
    """To 1e-6 of the prior's deviations, over maps; the second flight has a gap of a minute."""
    problem = problem_of(case)
    found = mine(tmp_path, FILES[library, kind]).estimator.estimate(problem, demands.generator())
    ours = estimator(kind).estimate(problem, demands.generator())
    assert found.causality == ours.causality
    sigma = np.sqrt(np.diag(problem.prior_cov))
    np.testing.assert_allclose(found.mean / sigma, ours.mean / sigma, rtol=0, atol=CLOSE)
    _, cov = deviation(found.mean, found.cov, ours.mean, ours.cov)
    assert cov < CLOSE
    assert (np.abs(ours.mean) > 1e-3 * sigma).any()
    if case == "outliers":
        assert 0.1 < problem.present.mean() < 0.6


@pytest.mark.parametrize(("library", "kind"), [slow(*key) for key in FILES])
def test_they_are_exact_on_linear_problems(tmp_path, library, kind):
    """To 1e-9, with gaps, noise of each epoch, a prior with a mean, one reading, odd times."""
    theirs = mine(tmp_path, FILES[library, kind]).estimator
    plain = linear_problem(4)
    for problem in (
        plain,
        graded(plain),
        gappy(plain),
        linear_problem(5, 1, 1),
        changed(plain, times=plain.times - 100.0),
    ):
        found = theirs.estimate(problem, demands.generator())
        assert max(deviation(found.mean, found.cov, *exact(problem, found))) < 1e-9


def test_particles_of_stone_soup_draw_from_the_runs_generator(tmp_path):
    """Near the exact answer (fails less than once in a million seeds), and the same twice."""
    theirs = mine(tmp_path, PARTICLES).estimator
    np.random.seed(5)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    demands.near_exact(theirs, noisy_problem(0))
    assert (np.random.get_state()[1] == before).all()  # noqa: NPY002
    first = theirs.estimate(noisy_problem(0), demands.generator())
    np.random.seed(6)  # noqa: NPY002
    demands.repeatable(theirs, noisy_problem(0), first)
    one, other = (theirs.estimate(noisy_problem(0), np.random.default_rng(seed)) for seed in (1, 2))
    assert not np.array_equal(one.mean, other.mean)


@pytest.mark.parametrize("library", ["stonesoup", slow("dynamax")])
def test_results_depend_on_the_adapter_and_the_library(tmp_path, monkeypatch, library):
    """Of an estimator that uses one; of one of the same content that does not, nothing is said."""
    choice = mine(tmp_path, FILES[library, "ekf"])
    content = choice.content
    assert content["libraries"][library] == importlib.metadata.version(library)
    read, uncached = registry.content_of, registry.source_of.__wrapped__
    monkeypatch.setattr(registry, "source_of", uncached)
    # A copy computes its content anew.
    assert replace(choice).content == content
    monkeypatch.setattr(registry, "content_of", lambda name: read(name) + b"another = 1\n")
    assert replace(choice).content["source"] != content["source"]
    assert "libraries" not in registry.choose("ekf").content


@pytest.mark.parametrize(
    ("library", "needed"), [("stonesoup", "stonesoup.base"), ("dynamax", "jax")]
)
def test_a_missing_library_is_said_in_a_sentence(tmp_path, monkeypatch, library, needed):
    monkeypatch.delitem(sys.modules, f"ggbench.adapters.{library}", raising=False)
    monkeypatch.setitem(sys.modules, needed, None)
    with pytest.raises(registry.EstimatorError) as raised:
        mine(tmp_path, f"# {library}\n{FILES[library, 'ekf']}")
    assert f"ggbench.adapters.{library} needs " in str(raised.value)
    assert f"pip install 'ggbench[{library}]'" in str(raised.value)


@pytest.mark.long
def test_a_dynamax_of_other_conventions_is_refused(monkeypatch):
    """Before 1.0.3 a step took the noise of the epoch that it begins at: it would be wrong."""
    monkeypatch.delitem(sys.modules, "ggbench.adapters.dynamax", raising=False)
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "1.0.2")
    with pytest.raises(ImportError, match=r"needs dynamax 1\.0\.3 or newer, not 1\.0\.2"):
        importlib.import_module("ggbench.adapters.dynamax")


@pytest.mark.long
@pytest.mark.parametrize("library", ["stonesoup", "dynamax"])
def test_they_keep_the_contract_and_join_a_campaign(tmp_path, library):
    """As files of a user's own, in worker processes, beside ours: the same errors."""
    (tmp_path / "mine.py").write_text(FILES[library, "ekf"])
    done = invoke(["check", "mine.py"], tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    run = "run wang2013 -n 2 -c 0.01E-1Hz -e ekf -e mine.py -o out -j 1"
    done = invoke(run.split(), tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    summary = Results(tmp_path / "out").metrics()
    theirs, ours = (
        summary.loc[summary["estimator"] == label, ["rms_m", "velocity_rms_mps"]].to_numpy()
        for label in ("mine.py", "ekf")
    )
    assert len(theirs) == 3
    np.testing.assert_allclose(theirs, ours, rtol=1e-6)
