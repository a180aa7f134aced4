"""What one run is given, how it is judged, and under which key its record is kept."""

from __future__ import annotations

import ast
import importlib.metadata
import sys
from pathlib import Path

import numpy as np
import pytest
from campaigns import ran, records
from small_cases import small_case, small_flight

import ggbench.estimators
from ggbench.campaign import records as recording
from ggbench.campaign import registry, result_keys
from ggbench.results.store import Result
from ggbench.simulation.error_free_flight import Flight
from ggbench.simulation.runs import simulate

DRAWING = """
from dataclasses import dataclass
import numpy as np
from ggbench.problem import Estimate, Estimator


@dataclass(frozen=True)
class Drawing(Estimator):
    way: int = 0
    name = "drawing"
    causality = "filter"

    def estimate(self, problem, rng):
        mean = np.zeros((problem.epochs, problem.dimension))
        return Estimate(mean, None, "filter", info={"drawn": rng.random()})
"""


def test_every_run_of_every_estimator_draws_numbers_of_its_own(tmp_path):
    """Another run, seed, parameter or class draws anew; a run that is repeated draws the same."""
    (tmp_path / "drawing.py").write_text(DRAWING)
    (tmp_path / "other.py").write_text(DRAWING.replace("class Drawing", "class Other"))
    labels = [f"{tmp_path}/{name}" for name in ("drawing.py", "drawing.py[way=1]", "other.py")]

    def drawn(folder: str, seed: int) -> dict[tuple[str, str, int], float]:
        found = records(ran(tmp_path, folder, labels, runs=3, seed=seed, cases=("base",)))
        return {key: record["info"]["drawn"] for key, record in found.items()}

    first, again, other = drawn("a", 5), drawn("b", 5), drawn("c", 6)
    assert first == again
    assert len({*first.values(), *other.values()}) == 2 * len(labels) * 3


def third_party(file: Path) -> set[str]:
    """Top-level modules that a file imports, neither its own nor of the standard library."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            found.add(node.module.partition(".")[0])
    return found - set(sys.stdlib_module_names) - {"ggbench"}


def test_libraries_below_the_estimators_are_in_the_key(monkeypatch):
    """A new version of anything that an estimator computes with is another result."""
    used = {"scipy"}  # below the rooms
    for file in Path(ggbench.estimators.__file__).parent.glob("*.py"):
        used |= third_party(file)
    assert {"numpy", "gtsam", "filterpy", "numba"} <= used
    case, content = small_case(), registry.choose("ins").content

    def key() -> str:
        result_keys.environment.cache_clear()
        return result_keys.run_key(case, content, 1)

    before, installed = key(), importlib.metadata.version
    for package in sorted(used):
        with monkeypatch.context() as patch:
            patch.setattr(
                importlib.metadata,
                "version",
                lambda name, package=package: "0.0" if name == package else installed(name),
            )
            assert key() != before, package
    assert key() == before


def judged(
    flight: Flight, ins: np.ndarray, left: np.ndarray, causality="filter", lag: float | None = None
) -> list[Result]:
    """Results of runs of which the INS is off by ``ins`` [m] and an estimate by ``left`` [m]."""
    runs, epochs, n = len(ins), len(flight.times), 15
    states = np.zeros((runs, epochs, n))
    states[..., 1] = ins[:, None]
    mean = states.copy()
    mean[..., 1] -= left[:, None]
    cov = np.tile(np.eye(n), (runs, epochs, 1, 1))
    made = recording.Estimated(
        mean, cov, np.zeros((runs, epochs)), causality, lag, [{}] * runs, [0] * runs, 0.5
    )
    problem, _ = simulate(flight, 1, 0)
    blanks = [recording.blank(registry.choose("ekf"), run, 1) for run in range(runs)]
    return recording.judged(blanks, "key", flight, states, made, lambda _: problem)


def test_a_run_has_diverged_if_the_ins_alone_ends_nearer():
    """Beyond ten bounds an estimate is lost only if it is beyond the INS of its own run, too."""
    flight = small_flight()
    limit = 10.0 * np.sqrt(np.trace(flight.bound.filtering[-1, :3, :3]))
    ins = np.array([3.0, 3.0, 3.0, 0.0, 0.0]) * limit
    left = np.array([1.1, 2.9, 3.1, 0.9, 1.1]) * limit
    found = [result.record for result in judged(flight, ins, left)]
    assert [record["diverged"] for record in found] == [False, False, True, False, True]
    assert [record["final_ins_error_m"] for record in found] == pytest.approx(ins)
    assert [record["final_position_error_m"] for record in found] == pytest.approx(left)


@pytest.mark.parametrize(
    ("period", "lag", "epochs"),
    [(1.0, 2.0, 2), (1.0, 2.9, 2), (1.0, 0.5, 0), (0.1, 0.3, 3), (0.1, 0.39, 3), (2.0, 3.0, 1)],
)
def test_a_fixed_lag_is_set_beside_what_it_has_seen(period, lag, epochs):
    """The bound of a lag that ends between two epochs is that of the earlier: no later reading."""
    flight = small_flight({"gradiometer.period_s": period})
    (result,) = judged(flight, np.ones(1), np.ones(1), "fixed-lag", lag)
    assert result.record["bound"] == f"fixed-lag-{epochs}"


@pytest.mark.parametrize(
    ("causality", "bound"), [("filter", "filter"), ("none", "filter"), ("batch", "batch")]
)
def test_the_bound_of_a_causality(causality, bound):
    """An estimate is set beside the bound of its causality; the INS beside what aiding gives."""
    (result,) = judged(small_flight(), np.ones(1), np.ones(1), causality)
    assert result.record["bound"] == bound
