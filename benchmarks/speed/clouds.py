"""Bootstrap particle filters of three packages: the same answer within the Monte Carlo error.

Particle filters draw random numbers, and no two give the same ones. What must be the same is what
their means scatter about: over :data:`SEEDS` seeds on one problem, mean for mean and state for
state, those of two packages may differ by what their scatter explains (Welch's t), and so may a
package's from the exact answer (Student's t). The largest of all K n numbers is held to the
quantile that Bonferroni's inequality gives for all of them together, however they correlate: an
implementation that is right fails one comparison in 1 / :data:`FALSE_ALARMS` at most, as far as
means over seeds are normal, and has two on each problem. Seeds are fixed, so that one version
always gets one verdict.

Two problems: a linear one, of which the Kalman filter knows the answer, and the first epochs of a
flight, of 15 states with noise of rank nine, of which an EKF knows it to what is left of the cloud.
Later the flight's cloud is depleted (``estimators/particle.py`` says why), and there is no answer.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from ggbench.campaign.registry import choose
from ggbench.contract.references import kalman, noisy_problem
from ggbench.problem import Problem

from . import export, problem_file, rounds
from .problem_file import Arrays, Linear
from .rounds import Entry, Measured

SIZES = (1000, 10_000)
"""Numbers N of particles."""
SEEDS = 32
FALSE_ALARMS = 1e-4
"""Share of comparisons that an implementation fails although it is right, at most."""
RUN, EPOCHS = 3, 20
"""Which run of the flight, the first of which no reading leaves less than a third of a thousand
particles effective, and how much of it."""
LIBRARIES = {"particles": "particles", "stonesoup": "Stone Soup"}
PROBLEMS = {"linear": "linear, 3 states", "flight": "flight, 15 states"}


def linear() -> Problem:
    """Return the linear problem: 3 states, 40 epochs of 2 readings, noise of full rank."""
    return noisy_problem(0)


def linear_arrays(problem: Problem, runs: int) -> Linear:
    """Return a linear problem as arrays, the same for each of some seeds."""
    design = [problem.model.jacobian(k, problem.prior_mean) for k in range(problem.epochs)]
    return Linear(
        times=problem.times,
        measurements=_repeated(problem.measurements, runs),
        noise_cov=problem.noise_cov,
        transition=_repeated(problem.transition, runs),
        process_cov=_repeated(problem.process_cov, runs),
        noise_roots=_repeated(export.noise_roots(problem), runs),
        prior_mean=problem.prior_mean,
        prior_cov=problem.prior_cov,
        design=_repeated(np.stack(design), runs),
    )


def flight_arrays(runs: int, epochs: int = EPOCHS) -> Arrays:
    """Return the first epochs of a run of the benchmark's flight, the same for each seed."""
    whole = export.arrays([RUN])
    each_epoch = {
        name: getattr(whole, name)[:epochs] for name in ("times", "reading_times", "gains")
    }
    each_run = {
        name: _repeated(getattr(whole, name)[0, :epochs], runs)
        for name in (
            "measurements", "transition", "process_cov", "noise_roots", "references", "rows",
            "offsets",
        )
    }  # fmt: skip
    return whole._replace(**each_epoch, **each_run)


def _repeated(array: np.ndarray, runs: int) -> np.ndarray:
    return np.broadcast_to(array, (runs, *array.shape))


def flight_answer() -> tuple[np.ndarray, np.ndarray]:
    """Return means and covariances of the EKF in the flight's first epochs."""
    (problem,) = export.problems([RUN])
    found = choose("ekf").estimator.estimate(problem, np.random.default_rng(0))
    assert found.cov is not None
    return found.mean[:EPOCHS], found.cov[:EPOCHS]


def allowed(seeds: int, count: int) -> float:
    """Return the largest |t| of ``count`` numbers that an implementation may have."""
    return float(stats.t.isf(0.5 * FALSE_ALARMS / count, seeds - 1))


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Return the largest |t| of two sets of means (S, K, n): of the difference of their averages.

    Welch's; its degrees of freedom are taken as the fewest that they can be, S − 1.
    """
    error = np.sqrt((one.var(axis=0, ddof=1) + other.var(axis=0, ddof=1)) / len(one))
    return float(np.abs((one.mean(axis=0) - other.mean(axis=0)) / error).max())


def off(means: np.ndarray, answer: np.ndarray) -> float:
    """Return the largest |t| of means (S, K, n) against the exact answer (K, n)."""
    error = means.std(axis=0, ddof=1) / np.sqrt(len(means))
    return float(np.abs((means.mean(axis=0) - answer) / error).max())


class Agreement:
    """The judge of the implementations on one problem, and what it found: ``rows``."""

    def __init__(self, name: str, mean: np.ndarray, cov: np.ndarray) -> None:
        self.name, self.mean = name, mean
        self.sigma = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
        self.rows: list[dict[str, Any]] = []

    def __call__(self, entry: Entry, means: np.ndarray, expected: np.ndarray) -> tuple[float, str]:
        """Judge means (S, K, n) by the answer and by the reference's."""
        limit = allowed(len(means), self.mean.size)
        from_answer = off(means, self.mean)
        relation = ""
        if means is expected:
            relation = "reference"
        elif (np.abs(means - expected) <= 1e-6 * self.sigma).all():
            relation = "the same numbers"
        from_reference = 0.0 if relation else apart(means, expected)
        distance = float(np.sqrt((((means - self.mean) / self.sigma) ** 2).mean()))
        self.rows.append(
            {"problem": self.name, "key": entry.key, "title": entry.title,
             "particles": int(entry.family), "distance": distance, "off": from_answer,
             "apart": from_reference, "relation": relation, "allowed": limit}
        )  # fmt: skip
        for what, found in (("the exact ones", from_answer), ("ggbench's", from_reference)):
            if not found <= limit:
                return from_reference, (
                    f"its means over {len(means)} seeds are {found:.1f} standard errors from "
                    f"{what} ({PROBLEMS[self.name]}), {limit:.1f} are allowed"
                )
        return from_reference, ""


def entries(name: str) -> list[Entry]:
    """Return what is measured on a problem; with each number of particles a reference first."""
    found = []
    for size in SIZES:
        family = str(size)
        found.append(Entry(f"bootstrap:NumpyH:{size}", "ggbench `particle`, NumPy h", family))
        if name == "flight":
            title = "ggbench `particle`, compiled h"
            found.append(Entry(f"bootstrap:CompiledH:{size}", title, family))
        for library, title in LIBRARIES.items():
            key = f"{library}:Bootstrap:{size}"
            found.append(Entry(key, f"{title}, NumPy h", family, library))
    return found


def measure(folder: Path, turns: int, seconds: float) -> dict[str, Any]:
    """Compare all implementations on both problems, and time those that agree on the flight.

    Returns
    -------
    Raw numbers: the ``entries`` timed or refused, and the rows of their ``agreement``.
    """
    problem, rows = linear(), []
    mean, cov, _, _ = kalman(problem)
    refused: dict[str, Measured] = {}
    found: list[Measured] = []
    for name, arrays, answer in (
        ("linear", linear_arrays(problem, SEEDS), (mean, cov)),
        ("flight", flight_arrays(SEEDS), flight_answer()),
    ):
        file = folder / f"clouds_{name}.npz"
        problem_file.save(file, arrays)
        judge = Agreement(name, *answer)
        asked = [entry for entry in entries(name) if entry.key not in refused]
        found = rounds.measure(
            asked, file, folder, judge, turns if name == "flight" else 0, seconds
        )
        rows += judge.rows
        refused |= {item.entry.key: item for item in found if item.refusal}
    found += [item for item in refused.values() if item not in found]
    return {
        "entries": [asdict(item) for item in found],
        "agreement": rows,
        "seeds": SEEDS,
        "false_alarms": FALSE_ALARMS,
        "run": RUN,
        "epochs": EPOCHS,
    }
