"""What every estimator owes, whatever it is: registered ones in every mode, and one's own.

``GGBENCH_TEST_ESTIMATOR='my.py;my.py[size=3]' pytest tests/test_contract.py`` tests others, too.
"""

from __future__ import annotations

import dataclasses
import functools
import gc
import inspect
import itertools
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import flight
from problems import (
    CASES,
    SEED,
    SLOW,
    changed,
    conditioned,
    deviation,
    each_label,
    estimated,
    estimator,
    exact,
    graded,
    labels,
    linear_problem,
    noisy_problem,
    rng,
    simulated,
    smoothed,
)

from ggbench.campaign import registry, result_keys, runner
from ggbench.problem import Estimate, Estimator, Problem
from ggbench.sensors.model import SensorModel
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.runs import simulate
from ggbench.spec import scenario
from ggbench.spec.case import CaseSpec

BIASED = ("unscented-particle[weights=likelihood]",)
"""Wrong by their definition, which ``test_unscented_particle.py`` shows: not asked to be near."""
ARRAYS = [field.name for field in dataclasses.fields(Problem)]
ARRAYS = [name for name in ARRAYS if isinstance(getattr(linear_problem(0), name), np.ndarray)]
each_estimator = pytest.mark.parametrize("label", each_label())


def solve(label: str, problem: Problem, gaussian: bool = False) -> Estimate:
    """Estimate, unless the estimator has a reason not to.

    ``gaussian`` sets the threshold of a robust loss to infinity, where it must be least squares.
    """
    solver = estimator(label)
    if gaussian and vars(solver).get("loss", "none") != "none":
        solver = dataclasses.replace(solver, threshold=np.inf)
    reason = solver.skip(problem)
    if reason:
        pytest.skip(reason)
    return solver.estimate(problem, rng())


def skip_if_refused(label: str, problem: Problem) -> None:
    """Skip a test if the estimator has a reason not to take the problem."""
    if reason := estimator(label).skip(problem):
        pytest.skip(reason)


def skip_unless_exact(label: str) -> None:
    """Skip a test of exactness for estimators that are exact in a limit only."""
    if not estimator(label).exact:
        pytest.skip(f"{label} is not exact: statistics are asked of it instead")


def test_the_two_ways_to_the_exact_answer_agree():
    """The reference is right: Kalman with Rauch-Tung-Striebel is the conditioned joint Gaussian.

    Without this, an estimator and the reference could share a mistake.
    """
    problem = linear_problem(seed=0)
    for ahead in (0, 3, 20, problem.epochs):
        difference = deviation(*smoothed(problem, ahead), *conditioned(problem, ahead))
        assert max(difference) < 1e-11


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("epochs", "m"), [(40, 2), (40, 1), (2, 1), (1, 2), (1, 1)])
@each_estimator
def test_exact_on_a_linear_gaussian_problem(label, epochs, m, seed):
    """On a linear-Gaussian problem the answer is the exact one for the estimator's causality.

    A filter equals Joseph's Kalman filter, a smoother Rauch-Tung-Striebel, a fixed-lag smoother
    the same on each window, no aiding the propagated prior: mean and covariance to 1e-9 of the
    posterior's deviations, with constant states, singular process noise, states from 1e-8 to 1e3,
    a scalar measurement and a single epoch. A robust loss is tested in the limit in which it is
    least squares; an estimator that says it is not exact is asked for statistics, below.
    """
    skip_unless_exact(label)
    problem = linear_problem(seed, epochs, m)
    estimate = solve(label, problem, gaussian=True)
    assert max(deviation(estimate.mean, estimate.cov, *exact(problem, estimate))) < 1e-9


@each_estimator
def test_exact_with_noise_that_is_singular_among_noisy_states(label):
    """Process noise may be singular along a mixture of states, not just in single ones (1e-9)."""
    skip_unless_exact(label)
    generator = np.random.default_rng(5)
    problem = linear_problem(seed=5)
    roots = np.zeros((problem.epochs, 5, 2))
    roots[:, :3] = 0.2 * generator.normal(size=(problem.epochs, 3, 2))
    roots *= np.sqrt(np.diag(problem.prior_cov))[:, None]
    problem = changed(problem, process_cov=roots @ roots.transpose(0, 2, 1))
    estimate = solve(label, problem, gaussian=True)
    assert max(deviation(estimate.mean, estimate.cov, *exact(problem, estimate))) < 1e-9


@each_estimator
def test_exact_with_noise_that_differs_from_epoch_to_epoch(label):
    """A reading counts for as much as the noise that is told for its own epoch (1e-9)."""
    skip_unless_exact(label)
    problem = graded(linear_problem(seed=6))
    estimate = solve(label, problem, gaussian=True)
    assert max(deviation(estimate.mean, estimate.cov, *exact(problem, estimate))) < 1e-9


@pytest.mark.parametrize(
    "label",
    [
        pytest.param(text, marks=pytest.mark.long) if text in (*SLOW, "point-mass") else text
        for text in labels()
    ],
)
def test_near_the_exact_answer_where_noise_keeps_the_states_apart(label):
    """What is not exact is near the exact answer on a linear problem whose noise has full rank.

    The mean over 40 epochs within 0.3 posterior deviations rms of the Kalman filter's, deviations
    within 30 %: a thousand particles that are resampled at half of their number have ESS of some
    hundreds, so an error of 0.06, and fail less than once in a million seeds. Seeds are fixed.
    """
    if estimator(label).exact:
        pytest.skip(f"{label} is exact, and held to that above")
    if label in BIASED:
        pytest.skip(f"{label} is wrong by its definition")
    problem = noisy_problem(seed=0)
    estimate = solve(label, problem)
    if estimate.fixes is not None:
        pytest.skip(f"{label} tells only what its fixes tell")
    mean, cov = exact(problem, estimate)
    variance = np.diagonal(cov, axis1=1, axis2=2)
    assert np.sqrt(np.mean((estimate.mean - mean) ** 2 / variance)) < 0.3
    ratio = np.diagonal(estimate.cov, axis1=1, axis2=2) / variance
    assert np.abs(np.sqrt(np.mean(ratio, axis=0)) - 1.0).max() < 0.3


def every_case() -> Iterator[Any]:
    """Every estimator on every case of the paper; modes and most cases are left to the long tests.

    Of cases one behind the low-pass and one without stay, of modes the second of these.
    """
    for label, case in itertools.product(labels(), CASES):
        quick = CASES[2:3] if "[" in label else CASES[1:3]
        slow = label in SLOW or case not in quick
        yield pytest.param(label, case, marks=pytest.mark.long if slow else ())


@pytest.mark.parametrize(("label", "case"), list(every_case()))
def test_answer_has_the_declared_form_and_a_real_covariance(label, case):
    """Shapes and causality are those declared; every P is symmetric and positive definite.

    Definiteness is asked of the correlation matrix, so that no unit hides a negative eigenvalue.
    """
    problem, _ = simulated(case)
    skip_if_refused(label, problem)
    estimate = estimated(case, label)
    epochs, n = problem.epochs, problem.dimension
    assert estimate.causality == estimator(label).causality
    assert (estimate.lag is not None) == (estimate.causality == "fixed-lag")
    if estimate.lag is not None:
        assert estimate.lag == vars(estimator(label))["lag"]
    assert estimate.mean.shape == (epochs, n)
    assert np.isfinite(estimate.mean).all()
    if estimate.cov is None:
        return
    assert estimate.cov.shape == (epochs, n, n)
    sigma = np.sqrt(np.diagonal(estimate.cov, axis1=1, axis2=2))
    assert (sigma > 0.0).all()
    correlation = estimate.cov / (sigma[:, :, None] * sigma[:, None, :])
    assert np.abs(correlation - correlation.transpose(0, 2, 1)).max() < 1e-12
    assert np.linalg.eigvalsh(correlation).min() > 0.0


@each_estimator
def test_same_seed_same_answer_bit_for_bit(label):
    """An estimate is a function of the problem and the generator alone."""
    case = "0.01E-0.2Hz"
    skip_if_refused(label, simulated(case)[0])
    first = estimated(case, label)
    again = estimator(label).estimate(simulated(case)[0], rng())
    assert first.mean.tobytes() == again.mean.tobytes()
    assert (first.cov is None) == (again.cov is None)
    if first.cov is not None:
        assert first.cov.tobytes() == again.cov.tobytes()


@pytest.mark.parametrize("real", [False, True], ids=["linear", "real"])
@each_estimator
def test_inputs_are_left_as_they_were(label, real):
    """The same problem goes to every estimator: none may change a byte of it, or of the model."""
    problem = simulated("0.01E-0.2Hz")[0] if real else linear_problem(seed=1)
    before = {id(a): a.tobytes() for a in arrays_within(problem)}
    assert len(before) > len(ARRAYS)  # the model's arrays are among them
    solve(label, problem)
    assert {id(a): a.tobytes() for a in arrays_within(problem)} == before


@pytest.mark.parametrize("name", ARRAYS)
def test_writing_to_a_problem_is_an_exception(name):
    """An estimator that writes to its input is told so, and the attribute cannot be replaced."""
    problem, _ = simulated("0.01E-0.2Hz")
    array = getattr(problem, name)
    with pytest.raises(ValueError, match="read-only"):
        array[...] = 0.0
    with pytest.raises(ValueError, match="read-only"):
        array += 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(problem, name, array)


@pytest.mark.parametrize("real", [False, True], ids=["linear", "real"])
@each_estimator
def test_no_estimate_depends_on_measurements_after_its_declared_reach(label, real):
    """A filter sees up to each epoch, a fixed lag up to the lag beyond, a smoother all.

    Measurements after an epoch are changed by ten deviations: estimates whose reach ends before
    are the same to 1e-12 σ, the first that can see them is not, or a later one if it makes fixes.
    Without aiding none changes.
    """
    problem = simulated("0.01E-0.2Hz")[0] if real else linear_problem(seed=2)
    last_same = problem.epochs // 2
    measurements = problem.measurements.copy()
    measurements[last_same + 1 :] += 10.0 * np.sqrt(np.diag(problem.noise_cov))
    first = solve(label, problem)
    second = solve(label, changed(problem, measurements=measurements))
    sigma = np.sqrt(np.diag(problem.prior_cov))
    moved = (np.abs(second.mean - first.mean) / sigma).max(axis=1)
    if first.causality == "none":
        assert moved.max() == 0.0
        return
    if first.causality == "batch":
        if first.cov is not None:  # a path of cells stays in its cell, and is less sure of it
            changes = np.diagonal(second.cov - first.cov, axis1=1, axis2=2)
            moved = np.maximum(moved, (np.abs(changes) / sigma**2).max(axis=1))
        assert moved[: last_same + 1].min() > 1e-6
        return
    reach = first.lag if first.causality == "fixed-lag" else 0.0
    blind = problem.times + reach < problem.times[last_same + 1]
    assert blind.any()
    assert moved[blind].max() < 1e-12
    if first.fixes is None:
        assert moved[~blind][0] > 1e-6
    else:  # a matcher waits for its window, and may refuse what it finds: its fixes have seen them
        before, after = (fixes_of(answer, last_same) for answer in (first, second))
        assert np.array_equal(before[0], after[0])
        assert moved.max() > 1e-6 or not np.array_equal(before[1], after[1])
    if first.cov is not None and not real:
        assert np.array_equal(first.cov[blind], second.cov[blind])


def fixes_of(answer: Estimate, last: int) -> tuple[np.ndarray, np.ndarray]:
    """Epoch, place and statistic of the fixes up to an epoch, and of those behind it."""
    fixes = answer.fixes
    rows = np.column_stack([fixes.epoch, fixes.mean, fixes.statistic])
    return rows[fixes.epoch <= last], rows[fixes.epoch > last]


def inner(item: object) -> Iterator[object]:
    """Yield what an object holds: attributes, elements, closures, owners of memory; not code."""
    if isinstance(item, np.ndarray):
        yield item.base
        if item.dtype == object:
            yield from item.ravel()
    elif isinstance(item, types.FunctionType):
        yield from (cell.cell_contents for cell in item.__closure__ or ())
        yield item.__defaults__
        yield item.__kwdefaults__
    elif not isinstance(item, type | types.ModuleType):
        yield from gc.get_referents(item)
        yield from getattr(item, "__dict__", {}).values()
        for cls in type(item).__mro__:
            for slot in getattr(cls, "__slots__", ()):
                yield getattr(item, slot, None)


def arrays_within(*roots: object) -> list[np.ndarray]:
    """All arrays that can be reached from objects, however deep."""
    seen: dict[int, object] = {}
    waiting = list(roots)
    while waiting:
        item = waiting.pop()
        if id(item) not in seen:
            seen[id(item)] = item  # kept, so that its identity is not used again
            waiting.extend(inner(item))
    return [item for item in seen.values() if isinstance(item, np.ndarray)]


def leaks(roots: list[object], case: str, run: int) -> list[str]:
    """What of the truth can be reached from objects, as sentences; empty if nothing can.

    Sought are the very numbers of the truth anywhere, its memory, and arrays over the epochs or
    over the INS samples with a column nearer to the truth than a thousandth of the INS's error. But
    for the velocities and attitudes that the INS indicates: in level flight to the east, as this
    one is, what it indicates to the north and of its tilt is its error.
    """
    made, (problem, truth) = flight(case), simulated(case, run)
    told = [array for root in roots if isinstance(root, Problem) for array in told_by(root)]
    told += told_by(problem)
    track = made.trajectory
    # Latitude, height and velocity hardly change on this flight: their numbers prove nothing.
    numbers = np.concatenate(
        [truth.error_state.ravel(), track.positions[1:, 1], made.noise_free.ravel()]
    )
    error = np.sqrt(np.mean(truth.error_state**2, axis=0))
    to_radians = np.array([1.0, 1.0, 6.4e6]) / 6.4e6
    near = [
        (truth.error_state[:, :9], 1e-3 * error[:9]),
        (track.positions[made.epochs], 1e-3 * error[[1, 0, 2]] * to_radians),
        (track.velocities[made.epochs], 1e-3 * error[3:6]),
        (track.positions, 1e-3 * error[[1, 0, 2]] * to_radians),
        (track.velocities, 1e-3 * error[3:6]),
    ]
    found = []
    for array in arrays_within(*roots):
        if array.dtype.kind != "f" or any(np.may_share_memory(array, known) for known in told):
            continue
        if np.isin(array, numbers).any():
            found.append(f"an array {array.shape} holds numbers of the truth")
        for secret, tolerance in near:
            if np.may_share_memory(array, secret):
                found.append(f"an array {array.shape} shares the memory of the truth")
            if array.ndim and len(array) == len(secret):
                telling = secret.std(axis=0) > 30.0 * tolerance  # zeros and constants tell nothing
                for column in array.reshape(len(array), -1).T:
                    distance = np.abs(column[:, None] - secret)
                    if ((distance < tolerance).all(axis=0) & telling).any():
                        found.append(f"a column of an array {array.shape} is nearly the truth")
    return found


def told_by(problem: Problem) -> list[np.ndarray]:
    """The velocities and attitudes that a problem's INS indicates."""
    return [] if problem.track is None else [problem.track.velocities, problem.track.attitudes]


SPY = """
from dataclasses import dataclass
import numpy as np
from ggbench.problem import Estimate, Estimator

SEEN = []

@dataclass(frozen=True)
class Spy(Estimator):
    name = "spy"
    causality = "filter"

    def estimate(self, problem, rng):
        SEEN.append((self, problem, rng))
        return Estimate(np.zeros((problem.epochs, problem.dimension)), None, "filter")
"""


def spied(case: str, tmp_path: Path) -> tuple[Estimator, Problem, np.random.Generator]:
    """What a worker gives an estimator in run 1 of a case: itself, the problem, a generator."""
    file = tmp_path / "spy.py"
    file.write_text(SPY)
    spec = scenario.load("wang2013").case(case)
    key = result_keys.run_key(spec, registry.choose(str(file)).content, SEED)
    list(runner.run_task(runner.Task(spec, "", (1,), SEED, ((str(file), key),))))
    return inspect.getmodule(type(estimator(str(file)))).SEEN[-1]


@pytest.mark.parametrize("case", CASES)
def test_a_campaign_gives_what_a_notebook_gives(case, tmp_path):
    """The problem in a campaign is that of ``simulate``: same types, same attributes, same bits."""
    (_, given, _), (usual, _) = spied(case, tmp_path), simulated(case, 1)
    for one, other in ((given, usual), (given.model, usual.model)):
        assert type(one) is type(other)
        assert public(one) == public(other)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(given, name), getattr(usual, name), strict=True)
    assert given.layout == usual.layout
    assert given.model.arrays._fields == usual.model.arrays._fields
    for one, other in zip(numbers_of(given.model), numbers_of(usual.model), strict=True):
        np.testing.assert_array_equal(one, other, strict=True)
    # An engine that takes the model's arrays is within an estimator's reach in both.
    compiled = estimator("ekf[engine=numba]")
    one, other = (compiled.estimate(problem, rng()) for problem in (given, usual))
    np.testing.assert_array_equal(one.mean, other.mean)


def numbers_of(model: SensorModel) -> list[object]:
    """All arrays of a model."""
    *own, aiding = model.arrays
    *others, gravity = aiding
    return [*own, *others, *gravity]


def public(item: object) -> list[str]:
    """The names of an object's attributes that are for everyone."""
    return [name for name in dir(item) if not name.startswith("_")]


@pytest.mark.parametrize("case", CASES)
def test_truth_cannot_be_reached_from_what_an_estimator_is_given(case, tmp_path):
    """From its problem, its generator and itself an estimator can walk to nothing of the truth.

    As handed over by a campaign's worker. The walk goes through attributes, containers, closures
    and owners of memory, not through code: a program that inspects the interpreter it runs in
    (modules, stack) cannot be kept from anything in one process.
    """
    spy, problem, generator = spied(case, tmp_path)
    assert leaks([spy, problem, generator], case, 1) == []
    # Nor can the generator be wound back to those of the simulation.
    entropy = generator.bit_generator.seed_seq.entropy
    assert entropy not in (SEED, [SEED, 1])
    ours = np.random.SeedSequence([SEED, 1])
    states = [np.random.PCG64(s).state for s in (ours, *ours.spawn(8))]
    assert generator.bit_generator.state not in states


@pytest.mark.parametrize("way", ["attribute", "closure", "partial", "view", "copy", "noisy copy"])
def test_the_search_for_truth_finds_it_where_it_is_hidden(way):
    """The search above is not blind: truth hidden in a model is found in every way of hiding."""
    case = "0.01E-0.2Hz"
    problem, truth = simulated(case, 1)
    track = flight(case).trajectory

    class Model:
        predict: Callable

    model = Model()
    model.inner = {"nested": [problem.model]}
    assert leaks([changed(problem, model=model)], case, 1) == []
    secret = truth.error_state
    if way == "attribute":
        model.inner["nested"].append(truth)
    elif way == "closure":
        model.predict = lambda k, x: secret[k]
    elif way == "partial":
        model.predict = functools.partial(np.add, secret)
    elif way == "view":
        model.origin = track.positions[:1, :1]  # its base is the whole track
    elif way == "copy":
        model.part = secret[3:5, 1].copy()
    else:
        model.track = track.positions[flight(case).epochs] * (1.0 + 1e-13)
    assert leaks([changed(problem, model=model)], case, 1)


@pytest.mark.parametrize("case", CASES)
def test_model_takes_any_leading_axes(case):
    """The h of many states at once is h of each: sigma points, particles and grids are one call."""
    problem, _ = simulated(case)
    generator = np.random.default_rng(3)
    m, n = problem.measurements.shape[1], problem.dimension
    for k in (0, problem.epochs // 2, problem.epochs - 1):
        for axes in ((), (1,), (7,), (2, 3), (2, 1, 3), (0,)):
            x = generator.normal(size=(*axes, n)) * np.sqrt(np.diag(problem.prior_cov))
            together = problem.model.predict(k, x)
            assert together.shape == (*axes, m)
            for index in np.ndindex(*axes):
                assert np.array_equal(together[index], problem.model.predict(k, x[index]))
            strided = np.repeat(x, 2, axis=-1)[..., ::2]
            assert np.array_equal(problem.model.predict(k, strided), together)
        assert problem.model.jacobian(k, np.zeros(n)).shape == (m, n)


@each_estimator
def test_takes_a_single_component_and_few_epochs_of_the_real_field(label):
    """One gradient component (m = 1) and a flight of two readings are problems like any other."""
    case = scenario.load("wang2013").case("0.01E-0.2Hz").model_dump()
    case["gradiometer"]["components"] = ["zz"]
    case["trajectory"]["segment"][0]["duration_s"] = 10.0
    case["windows"] = {"settled_from_s": 5.0, "last_s": 5.0}
    made = prepare(CaseSpec.model_validate(case))
    problem, _ = simulate(made, SEED, 0)
    assert problem.measurements.shape == (2, 1)
    estimate = solve(label, problem)
    assert estimate.mean.shape == (2, 15)
    assert np.isfinite(estimate.mean).all()
