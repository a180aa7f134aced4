"""Estimators of other packages: same answers, same contract, and a sentence without the extra."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from command import invoke
from problems import block_of_runs, estimator

from ggbench import estimation
from ggbench.campaign import registry
from ggbench.errors import GGBenchError

BATCH = "factor-graph[mode=batch]"
REFERENCES = {"ekf": "ekf", "ukf": "ukf", "ckf": None, "smoother": None, "batch": BATCH}
"""Estimator of this project with the same algorithm, by the end of a name."""
OTHER_POINTS = ("bayesfilter-ukf",)
"""Estimators whose sigma points are others than those of ``ukf``."""
NAMES = list(registry.framework_points())
EKFS = [name for name in NAMES if name.endswith("-ekf")]


def test_every_framework_has_an_entry():
    packages = {name.rpartition("-")[0] for name in NAMES}
    assert packages == {"bayesfilter", "cuthbert", "dynamax", "kalbee", "pyceres", "stonesoup"}
    assert not set(NAMES) & set(registry.estimator_points())


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_answers_are_those_of_the_same_algorithm(name):
    """Means and deviations, to a millionth of the prior's deviations; readings are missing, too."""
    reference = REFERENCES[name.rpartition("-")[2]]
    if reference is None or name in OTHER_POINTS:
        pytest.skip("no estimator with the same algorithm")
    for scenario, case in (("wang2013", "0.01E-1Hz"), ("outliers", "dropouts")):
        block = block_of_runs(scenario, case, 0, 1)
        if reference == BATCH:  # the work of a dense solver grows with the cube of the epochs
            block = block.part(0, 150, block.prior_mean, block.prior_cov)
        problem = block.problem(0)
        sigma = np.sqrt(np.diag(problem.prior_cov))
        found, expected = (
            estimation.estimate(estimator(label), problem, np.random.default_rng(0))
            for label in (name, reference)
        )
        limit = 1e-4 if reference == BATCH else 1e-6  # where searches end
        np.testing.assert_allclose(found.mean / sigma, expected.mean / sigma, atol=limit)
        deviations = [np.sqrt(np.diagonal(e.cov, axis1=1, axis2=2)) for e in (found, expected)]
        np.testing.assert_allclose(deviations[0] / sigma, deviations[1] / sigma, atol=limit)


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_the_contract_is_kept(name, tmp_path):
    done = invoke(["check", name], tmp_path)
    assert done.returncode == 0, done.stdout
    assert "9 of 9 checks passed" in done.stdout


@pytest.mark.parametrize("name", EKFS)
def test_a_missing_package_is_named_with_its_extra(name, monkeypatch):
    package = name.removesuffix("-ekf")
    for module in [m for m in sys.modules if m.split(".")[-1] == package and "adapters" in m]:
        monkeypatch.delitem(sys.modules, module)
    for module in [m for m in sys.modules if m.split(".")[0] == package]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(GGBenchError, match=rf"pip install 'ggbench\[{package}\]'"):
        registry.choose(name)


def test_the_list_names_them(tmp_path):
    """Without loading any of them."""
    shown = " ".join(invoke(["list"], tmp_path).stdout.split())
    assert all(name in shown for name in NAMES)
