"""What every estimator owes, whatever it is: registered ones in every mode, and one's own.

The demands are those of ``ggbench check``, here on more problems.

``GGBENCH_TEST_ESTIMATOR='my.py;my.py[size=3]' pytest tests/test_contract.py`` tests others, too.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paper_flights import flight
from problems import (
    CASES,
    SEED,
    changed,
    conditioned,
    deviation,
    each_label,
    estimated,
    estimator,
    graded,
    is_slow,
    labels,
    linear_problem,
    noisy_problem,
    rng,
    simulated,
    smoothed,
)
from thinning import thinned

from ggbench.campaign import registry, result_keys, runner
from ggbench.contract import demands
from ggbench.contract.references import gappy, linear_sensor_problem, with_sensor_model
from ggbench.contract.within import arrays_within
from ggbench.numerics.records import fields_of
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
each_kind = pytest.mark.parametrize(
    "real",
    [pytest.param(False, id="linear", marks=pytest.mark.long), pytest.param(True, id="real")],
)


def kept(demand: Callable[..., Any], label: str, *arguments: Any) -> Any:
    """Ask a demand of an estimator, unless it has a reason not to take the problem."""
    try:
        return demand(estimator(label), *arguments)
    except demands.Refused as reason:
        assert "compiled engine" not in str(reason)  # all problems here have the package's model
        pytest.skip(str(reason))


def to_rounding(estimator: Any, problem: Any) -> None:
    """Demand more than the contract of the package's own estimators: no remark but on rounding."""
    assert "exact to" not in demands.as_exact(estimator, problem)


def skip_unless_exact(label: str) -> None:
    """Skip a test of exactness for estimators that are exact in a limit only."""
    if not estimator(label).exact_if_linear_gaussian:
        pytest.skip(f"{label} is not exact: statistics are asked of it instead")


def test_the_two_ways_to_the_exact_answer_agree():
    """The reference is right: Kalman with Rauch-Tung-Striebel is the conditioned joint Gaussian.

    Without this, an estimator and the reference could share a mistake.
    """
    problem = linear_problem(seed=0, epochs=20)
    for ahead in (0, 3, 10, problem.epochs):
        difference = deviation(*smoothed(problem, ahead), *conditioned(problem, ahead))
        assert max(difference) < 1e-11


@pytest.mark.parametrize(
    "problem",
    [linear_problem(0), linear_problem(1, 40, 1), gappy(linear_problem(3)), noisy_problem(0)],
    ids=["two channels", "one channel", "gaps", "three states"],
)
def test_a_map_of_constant_slopes_makes_the_packages_model_linear(problem):
    """The h and H are those of the linear model to rounding, up to 30 deviations of the prior."""
    model, plain = with_sensor_model(problem).model, problem.model
    sigma = np.sqrt(np.diag(problem.prior_cov))
    states = 30.0 * sigma * np.random.default_rng(0).uniform(-1.0, 1.0, (7, len(sigma)))
    for k in range(problem.epochs):
        h, expected = model.predict(k, states), plain.predict(k, states)
        np.testing.assert_allclose(h, expected, rtol=0.0, atol=2e-12)
        rows, expected = model.jacobian(k, states) * sigma, plain.jacobian(k, states) * sigma
        np.testing.assert_allclose(rows, expected, rtol=0.0, atol=1e-13)


@thinned("seed", range(3))
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
    kept(to_rounding, label, linear_sensor_problem(seed, epochs, m))


@each_estimator
def test_exact_with_noise_that_is_singular_among_noisy_states(label):
    """Process noise may be singular along a mixture of states, not just in single ones (1e-9)."""
    skip_unless_exact(label)
    generator = np.random.default_rng(5)
    problem = linear_sensor_problem(seed=5)
    roots = np.zeros((problem.epochs, 5, 2))
    roots[:, :3] = 0.2 * generator.normal(size=(problem.epochs, 3, 2))
    roots *= np.sqrt(np.diag(problem.prior_cov))[:, None]
    kept(to_rounding, label, changed(problem, process_cov=roots @ roots.transpose(0, 2, 1)))


@each_estimator
def test_exact_with_noise_that_differs_from_epoch_to_epoch(label):
    """A reading counts for as much as the noise that is told for its own epoch (1e-9)."""
    skip_unless_exact(label)
    kept(to_rounding, label, graded(linear_sensor_problem(seed=6)))


@each_estimator
def test_exact_where_readings_are_missing(label):
    """A channel that delivers nothing, and an epoch without any reading, change nothing (1e-9)."""
    skip_unless_exact(label)
    kept(to_rounding, label, with_sensor_model(gappy(linear_problem(seed=3))))


@pytest.mark.parametrize(
    "label",
    [
        pytest.param(text, marks=pytest.mark.long)
        if is_slow(text) or text == "point-mass"
        else text
        for text in labels()
    ],
)
def test_near_the_exact_answer_where_noise_keeps_the_states_apart(label):
    """What is not exact is near the exact answer on a linear problem whose noise has full rank.

    The mean over 40 epochs within 0.3 posterior deviations rms of the Kalman filter's, deviations
    within 30 %: a thousand particles that are resampled at half of their number have ESS of some
    hundreds, so an error of 0.06, and fail less than once in a million seeds. Seeds are fixed.
    """
    if estimator(label).exact_if_linear_gaussian:
        pytest.skip(f"{label} is exact, and held to that above")
    if label in BIASED:
        pytest.skip(f"{label} is wrong by its definition")
    kept(demands.near_exact, label, with_sensor_model(noisy_problem(seed=0)))


def every_case() -> Iterator[Any]:
    """Every estimator on every case of the paper; modes and most cases are left to the long tests.

    Of cases one behind the low-pass and one without stay, of modes the second of these, and of what
    has a cloud of particles.
    """
    for label, case in itertools.product(labels(), CASES):
        quick = CASES[2:3] if "[" in label or "particle" in label else CASES[1:3]
        slow = is_slow(label) or case not in quick
        yield pytest.param(label, case, marks=pytest.mark.long if slow else ())


@pytest.mark.parametrize(("label", "case"), list(every_case()))
def test_answer_has_the_declared_form_and_a_real_covariance(label, case):
    """Shapes and causality are those declared; every P is symmetric and positive definite.

    Definiteness is asked of the correlation matrix, so that no unit hides a negative eigenvalue.
    """
    demands.real_covariance(first_answer(case, label))


@each_estimator
def test_same_seed_same_answer_bit_for_bit(label):
    """An estimate is a function of the problem and the generator alone."""
    case = "0.01E-0.2Hz"
    kept(demands.repeatable, label, simulated(case)[0], first_answer(case, label))


def first_answer(case: str, label: str) -> Estimate:
    """An estimator's answer to run 0 of a case, whose form is what it declares."""
    problem, _ = simulated(case)
    if reason := estimator(label).skip(problem):
        pytest.skip(reason)
    found = estimated(case, label)
    demands.declared(found, estimator(label), problem)
    return found


@each_kind
@each_estimator
def test_inputs_are_left_as_they_were(label, real):
    """The same problem goes to every estimator: none may change a byte of it, or of the model."""
    problem = simulated("0.01E-0.2Hz")[0] if real else linear_sensor_problem(seed=1)
    assert len(arrays_within(problem)) > len(ARRAYS)  # the model's arrays are among them
    kept(demands.inputs_kept, label, problem)


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


@each_kind
@each_estimator
def test_no_estimate_depends_on_measurements_after_its_declared_reach(label, real):
    """A filter sees up to each epoch, a fixed lag up to the lag beyond, a smoother all.

    Measurements after an epoch are changed by ten deviations: estimates whose reach ends before
    are the same to 1e-12 σ, the first that can see them is not, or a later one if it makes fixes.
    Without aiding none changes.
    """
    problem = simulated("0.01E-0.2Hz")[0] if real else linear_sensor_problem(seed=2)
    kept(demands.causal, label, problem, not real)


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


@thinned("case", CASES)
def test_a_campaign_gives_what_a_notebook_gives(case, tmp_path):
    """The problem in a campaign is that of ``simulate``: same types, same attributes, same bits."""
    (_, given, _), (usual, _) = spied(case, tmp_path), simulated(case, 1)
    for one, other in ((given, usual), (given.model, usual.model)):
        assert type(one) is type(other)
        assert public(one) == public(other)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(given, name), getattr(usual, name), strict=True)
    assert given.layout == usual.layout
    for one, other in zip(numbers_of(given.model), numbers_of(usual.model), strict=True):
        np.testing.assert_array_equal(one, other, strict=True)
    # An engine that takes the model's arrays is within an estimator's reach in both.
    compiled = estimator("ekf")
    one, other = (compiled.estimate(problem, rng()) for problem in (given, usual))
    np.testing.assert_array_equal(one.mean, other.mean)


def numbers_of(model: SensorModel) -> list[object]:
    """All arrays of a model."""
    *own, gravity = fields_of(model.arrays)
    return [*own, *fields_of(gravity)]


def public(item: object) -> list[str]:
    """The names of an object's attributes that are for everyone."""
    return [name for name in dir(item) if not name.startswith("_")]


@thinned("case", CASES)
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
    problem = two_readings()
    assert problem.measurements.shape == (2, 1)
    kept(demands.answer, label, problem)


@functools.cache
def two_readings() -> Problem:
    case = scenario.load("wang2013").case("0.01E-0.2Hz").model_dump()
    case["gradiometer"]["components"] = ["zz"]
    case["trajectory"]["segment"][0]["duration_s"] = 10.0
    case["windows"] = {"settled_from_s": 5.0, "last_s": 5.0}
    made = prepare(CaseSpec.model_validate(case))
    return simulate(made, SEED, 0)[0]
