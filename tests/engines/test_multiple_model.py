"""The multiple-model filter beside NumPy's, and that it finds what has been planted."""

from __future__ import annotations

import dataclasses
import gc
import math
import re
import weakref

import numpy as np
import pytest
from oracles import multiple_model as oracle
from oracles.augmented_problem import augmented
from problems import block_of_runs
from thinning import thinned

import ggbench as gg
from ggbench.block import block_of
from ggbench.campaign.registry import choose
from ggbench.engines import hypothesis_bank, model_hypotheses
from ggbench.engines import multiple_model as engine
from ggbench.engines.cell_screening import screened, screened_with_loss
from ggbench.engines.extended_filter import UpdateOptions, extended_with_evidence
from ggbench.engines.gaussian_sum import CarriedSum, prior_cells, space_for
from ggbench.engines.hypothesis_families import precisions_of
from ggbench.engines.hypothesis_motion import motion_of
from ggbench.engines.model_hypotheses import Hypothesis, heavy_tails, map_error
from ggbench.engines.multiple_model import (
    SearchOptions,
    cell_spacing,
    log_weights,
    mix,
    multiple_model,
)
from ggbench.engines.robust_weights import losses
from ggbench.estimators.multiple_model import MultipleModel

ONE_CELL = SearchOptions(spacing_m=1e9, most=1, iterations=1)
SMOOTH = Hypothesis("map_errors", wander=4.0, length_m=1500.0, constant=7.0)
HYPOTHESES = (
    Hypothesis("as_assumed", prior=4.0),
    Hypothesis("noise", noise=3.0),
    Hypothesis("constants", constant=20.0),
    SMOOTH,
    map_error("map_errors", 2.0, 3000.0),
    Hypothesis("gravity", gravity_mgal=40.0, gravity_km=30.0),
    Hypothesis("gravity", gravity_mgal=40.0, integrated=True),
    heavy_tails("outliers", 1.5),
)


def flight(case: str, runs: int = 2, epochs: int = 40):
    """The first epochs of runs of a case of the suite."""
    return block_of_runs("suite", case, 0, runs).until(epochs)


@pytest.mark.parametrize("case", ["air-narrow", "gravity", "outliers"])
@thinned(("iterations", "limit"), [(1, 1e-6), (2, 1e-4)])
def test_numpy_gives_the_same_answer(case, iterations, limit):
    """Weights, means and covariances in deviations of the prior; of every kind of hypothesis.

    Without a loss the plain update has no search, whose end is decided by rounding.
    """
    block = flight(case)
    bank = HYPOTHESES if iterations > 1 else HYPOTHESES[:-1]
    found = multiple_model(block, bank, ONE_CELL._replace(iterations=iterations))
    sigma = np.sqrt(np.diag(block.prior_cov))
    for run in range(block.runs):
        mean, cov, weights = oracle.mixture(bank, iterations, block.problem(run))
        assert np.abs((found.mean[run] - mean) / sigma).max() < limit
        assert np.abs((found.cov[run] - cov) / np.outer(sigma, sigma)).max() < limit
        for kind, weight in weights.items():
            assert found.info[f"weight_{kind}"][run] == pytest.approx(weight, abs=limit)


def test_a_run_does_not_depend_on_its_neighbours():
    """Alone and among others: the same bits."""
    block = flight("air-narrow")
    both = multiple_model(block, HYPOTHESES[:4], ONE_CELL)
    for run in range(2):
        alone = multiple_model(block_of(block.problem(run)), HYPOTHESES[:4], ONE_CELL)
        np.testing.assert_array_equal(alone.mean[0], both.mean[run])
        np.testing.assert_array_equal(alone.cov[0], both.cov[run])
        assert alone.info["at_40_s"][0] == both.info["at_40_s"][run]


def test_one_hypothesis_is_the_filter_itself():
    """The model as it is, alone: the bits of ``ekf``."""
    block = flight("air-narrow")
    found = multiple_model(block, HYPOTHESES[:1], ONE_CELL)
    plain = choose("ekf").estimator.estimate_block(block)
    np.testing.assert_allclose(found.mean, plain.mean, rtol=1e-12)
    np.testing.assert_allclose(found.cov, plain.cov, rtol=1e-9, atol=1e-30)
    assert found.info["at_40_s"][0] == "as assumed 100 %"


def test_evidence_is_the_density_of_the_readings():
    """Of a linear problem, the normal density of all readings together, of any scaled noise."""
    block = flight("air-narrow", runs=1, epochs=5)
    flat = dataclasses.replace(
        block, prior_cov=1e-12 * block.prior_cov, process_cov=1e-12 * block.process_cov
    )
    problem = flat.problem(0)
    residual = np.array(
        [
            problem.measurements[k] - problem.model.predict(k, problem.prior_mean)
            for k in range(problem.epochs)
        ]
    )
    for noise in (1.0, 3.0):
        scaled, peak = augmented(flat, Hypothesis("noise", noise=noise), motion_of(flat))
        evidence = extended_with_evidence(scaled, UpdateOptions())[1] + peak
        sigma = np.sqrt(np.diag(problem.noise_cov))
        sigma = np.where([c.unit == "E" for c in problem.channels], noise, 1.0) * sigma
        expected = np.sum(
            np.where(problem.present, -0.5 * (residual / sigma) ** 2 - np.log(sigma), 0.0), axis=1
        )
        np.testing.assert_allclose(evidence[0], expected, rtol=1e-6, atol=1e-6)


def _assert_plain(block, hypothesis):
    """Compare the bank of one hypothesis with the plain filter of a problem with dense matrices.

    Rounding decides when the search of a loss ends.
    """
    limit = 1e-9 if hypothesis.loss == "none" else 1e-6
    found = multiple_model(block, [hypothesis], ONE_CELL)
    problem, _ = augmented(block, hypothesis, motion_of(block))
    options = UpdateOptions(
        iterations=1 if hypothesis.loss == "none" else 2,
        loss=hypothesis.loss,
        threshold=hypothesis.threshold,
    )
    dense, _ = extended_with_evidence(problem, options)
    n, sigma = block.dimension, np.sqrt(np.diag(block.prior_cov))
    assert np.abs((found.mean - dense.mean[..., :n]) / sigma).max() < limit
    apart = found.cov - dense.cov[..., :n, :n]
    assert np.abs(apart / np.outer(sigma, sigma)).max() < limit
    if hypothesis.loss == "none":
        np.testing.assert_array_equal(found.info["map_evaluations"], block.epochs)


@thinned(
    ("case", "hypothesis"),
    [
        ("air-narrow", Hypothesis("noise", noise=3.0)),
        ("air-narrow", dataclasses.replace(SMOOTH, rough=True)),
        ("air-narrow", dataclasses.replace(SMOOTH, constant=0.0)),
        ("air-narrow", dataclasses.replace(SMOOTH, gravity_mgal=30.0, gravity_km=40.0, noise=0.7)),
        ("gravity", Hypothesis("gravity", gravity_mgal=60.0, integrated=True, constant=9.0)),
        ("map-error-known", SMOOTH),
        ("one-channel", SMOOTH),
        ("gravimeter", dataclasses.replace(SMOOTH, noise=2.0)),
        ("gaps", heavy_tails("outliers", 2.0).estimate),
        ("gnss-outage", SMOOTH),
    ],
)
def test_a_filter_of_the_bank_is_the_plain_one_of_a_dense_problem(case, hypothesis):
    """The zeros that the bank leaves out change nothing, of any kind of states and sensors."""
    block = flight(case, epochs=30)
    _assert_plain(block, hypothesis)


def test_noise_that_is_correlated_across_sensors_is_scaled_exactly():
    """A factor on some channels then does not scale whole equations; with and without a loss."""
    block = flight("gnss-outage", epochs=20)
    m, channels = block.measurements.shape[2], list(block.channels)
    channels[-1] = dataclasses.replace(channels[-1], unit="mGal")
    noise_cov = block.noise_cov.reshape(-1, m, m)[:1].copy()
    noise_cov[0, -1, -2] = noise_cov[0, -2, -1] = 0.6 * np.sqrt(
        noise_cov[0, -1, -1] * noise_cov[0, -2, -2]
    )
    block = dataclasses.replace(block, channels=tuple(channels), noise_cov=noise_cov)
    bank = (Hypothesis("noise", noise=4.0), heavy_tails("outliers", 2.0).estimate)
    for hypothesis in bank:
        _assert_plain(block, hypothesis)


@pytest.mark.parametrize("noise", [0.25, 1.0, 6.0])
def test_a_sum_of_screened_cells_is_the_whole_one(noise):
    """Also carried in parts: the same bits. The first epoch's evidence counts all cells."""
    block = flight("prior-0.3", runs=1, epochs=12)
    prior = prior_cells(block, 800.0, 1000)
    scaled, _ = augmented(block, Hypothesis("noise", noise=noise), motion_of(block))
    whole = CarriedSum(scaled, prior, space_for(prior), 1, "none", np.inf)
    whole.advance(12)
    (first,) = screened(block, prior, precisions_of(block, [noise]))
    assert 1 <= len(first.prior.weights) < len(prior.weights)
    part = CarriedSum(scaled, first.prior, space_for(first.prior), 1, "none", np.inf)
    for stop in (1, 5, 12):
        part.advance(stop)
    np.testing.assert_array_equal(part.mean, whole.mean)
    np.testing.assert_array_equal(part.cov, whole.cov)
    np.testing.assert_array_equal(part.evidence[0, 1:], whole.evidence[0, 1:])
    assert first.evidence == pytest.approx(whole.evidence[0, 0], abs=1e-9)
    assert part.evidence[0, 0] != whole.evidence[0, 0]  # of the screened cells alone


def test_a_wide_prior_is_searched_until_the_position_is_known():
    """The mixture of sums that run through the whole flight, up to that epoch; then all filters."""
    block = flight("prior-0.3", runs=2, epochs=40)
    bank = (Hypothesis("as_assumed", prior=4.0), Hypothesis("noise", noise=2.0))
    options = SearchOptions(spacing_m=800.0, most=1000, iterations=1)
    found = multiple_model(block, bank, options)
    prior, evidences, estimates = prior_cells(block, 800.0, 1000), [], []
    for hypothesis in bank:
        scaled, peak = augmented(block, hypothesis, motion_of(block))
        alone = scaled.some(0, 1)
        carried = CarriedSum(alone, prior, space_for(prior), 1, "none", np.inf)
        carried.advance(40)
        estimates.append(carried)
        evidences.append(carried.evidence + peak[:1])
    weights = log_weights(np.array(evidences), np.log([[4.0], [1.0]]))
    mean, cov = np.empty((1, 40, block.dimension)), np.empty((1, 40, *block.prior_cov.shape))
    means, covs = (np.array([getattr(e, name) for e in estimates]) for name in ("mean", "cov"))
    mix(weights, means, covs, mean, cov)
    sigma = np.sqrt(np.diag(block.prior_cov))
    assert np.abs((found.mean[0, 0] - mean[0, 0]) / sigma).max() < 1e-9
    assert np.abs((found.cov[0, 0] - cov[0, 0]) / np.outer(sigma, sigma)).max() < 1e-9
    # Both follow one maximum by then.
    assert np.abs((found.mean[0, -1] - mean[0, -1]) / sigma).max() < 0.1
    assert (found.info["map_evaluations"] < sum(e.evaluations[0] for e in estimates)).all()


def test_an_outlier_at_the_start_does_not_end_the_search():
    """The first measurement is an outlier: by itself it fixes the position 7 km off."""
    case = gg.load("unknown_model").case("outliers-wide")
    problem, truth = gg.simulate(case, run=176)
    block = block_of(problem).until(60)
    estimate = MultipleModel().estimate_block(block)
    errors = np.linalg.norm((estimate.mean[0] - truth.error_state[:60])[30:, :3], axis=1)
    assert errors.max() < 300.0
    assert estimate.info["weight_outliers"][0] > 0.99


def test_a_sum_of_cells_screened_with_a_loss_is_the_whole_one():
    """As without a loss; the evaluations of the first epoch are counted."""
    block = flight("prior-0.3", runs=1, epochs=6)
    prior = prior_cells(block, 800.0, 1000)
    rules = 2, "cauchy", 1.5
    whole = CarriedSum(block, prior, space_for(prior), *rules)
    whole.advance(1)
    first, evaluations = screened_with_loss(block, prior, *rules)
    assert evaluations == whole.evaluations[0]
    assert first.evidence == pytest.approx(whole.evidence[0, 0], abs=1e-9)
    whole.advance(6)
    assert 1 <= len(first.prior.weights) < len(prior.weights)
    part = CarriedSum(block, first.prior, space_for(first.prior), *rules)
    part.advance(6)
    np.testing.assert_array_equal(part.mean, whole.mean)
    np.testing.assert_array_equal(part.cov, whole.cov)


def test_hypotheses_without_weight_leave_the_search(monkeypatch):
    """Less is evaluated, and the answer of all of them is kept."""
    block = flight("prior-0.3", runs=1, epochs=40)
    bank = [Hypothesis("noise", noise=factor) for factor in (0.2, 1.0, 5.0)]
    bank.append(heavy_tails("outliers", 1.5))
    # The position is never known to a spacing as narrow as that, nor is the grid as fine.
    options = SearchOptions(spacing_m=1.0, most=300, iterations=1)
    found = multiple_model(block, bank, options)
    monkeypatch.setattr(engine, "NEGLIGIBLE", -math.inf)
    every = multiple_model(block, bank, options)
    sigma = np.sqrt(np.diag(block.prior_cov))
    assert np.abs((found.mean - every.mean) / sigma).max() < 1e-9
    assert np.abs((found.cov - every.cov) / np.outer(sigma, sigma)).max() < 1e-9
    assert found.info["map_evaluations"] < 0.9 * every.info["map_evaluations"]


@pytest.mark.parametrize("case", ["air-narrow", "wrong-noise", "gravity", "biases"])
@pytest.mark.long
def test_dropped_hypotheses_would_not_have_mattered(case):
    """The whole bank gives the answer of NumPy's, which drops none; most are dropped soon."""
    scenario = "suite" if case != "biases" else "unknown_model"
    block = block_of_runs(scenario, case, 0, 1).until(48)
    estimator = MultipleModel(outliers=False)  # rounding decides when the search of a loss ends
    bank = model_hypotheses.applicable(estimator.hypotheses, block)
    found = estimator.estimate_block(block)
    mean, cov, weights = oracle.mixture(bank, 1, block.problem(0))
    sigma = np.sqrt(np.diag(block.prior_cov))
    assert np.abs((found.mean[0] - mean) / sigma).max() < 1e-6
    assert np.abs((found.cov[0] - cov) / np.outer(sigma, sigma)).max() < 1e-6
    for kind, weight in weights.items():
        assert found.info[f"weight_{kind}"][0] == pytest.approx(weight, abs=1e-6)
    filters = sum(1 + (h.estimate is not None) for h in bank)
    assert found.info["map_evaluations"][0] < 0.6 * filters * block.epochs
    assert math.exp(hypothesis_bank.NEGLIGIBLE) < 1e-10


class CountedWaves:
    """A map of waves along meridians; counts its evaluations."""

    lower, upper = np.array([0.7, 0.1, 0.0]), np.array([0.71, 0.11, 1000.0])
    wavelength_m, size, calls = 4000.0, 20.0, 0

    def tensor(self, latitude, longitude, height):
        self.calls += 1
        phase = 2.0 * np.pi * latitude * 6.371e6 / self.wavelength_m
        return self.size * np.sin(phase)[..., np.newaxis] * np.ones(6)

    def over_nodes(self, latitude, longitude, third):
        return latitude, longitude, third


@pytest.mark.parametrize("noise", [0.001, 1.0, 30.0])
def test_the_spacing_follows_from_the_map_and_the_noise(noise):
    """Of waves: 0.3 of the length in which sine changes, or where the bend is a tenth of R."""
    block = flight("air-narrow", runs=1, epochs=1)
    waves, scale = CountedWaves(), 2.0 * np.pi / CountedWaves.wavelength_m
    block = dataclasses.replace(block, map=waves, noise_cov=noise**2 * np.eye(6))
    bend = waves.size * math.sqrt(0.5) * scale**2
    expected = max(0.3 / scale, math.sqrt(0.2 * noise / bend) / 0.6)
    assert cell_spacing(block) == pytest.approx(expected, rel=0.02)
    assert (expected > 0.31 / scale) == (noise == 30.0)


def test_the_roughness_of_a_map_is_computed_once():
    """And is forgotten with the map; of maps without a hash it is computed each time."""

    class Unhashable(CountedWaves):
        __hash__ = None

    block = flight("air-narrow", runs=1, epochs=1)
    waves = CountedWaves()
    spacing = cell_spacing(dataclasses.replace(block, map=waves))
    calls = waves.calls
    assert cell_spacing(dataclasses.replace(block, map=waves)) == spacing
    assert waves.calls == calls
    assert cell_spacing(dataclasses.replace(block, map=Unhashable())) == spacing
    kept = weakref.ref(waves)
    del waves
    gc.collect()
    assert kept() is None


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_a_loss_is_a_density(loss):
    """What its tails take is counted: ∫ exp(−ρ) is that of the normal density by this factor."""
    hypothesis = Hypothesis("outliers", loss=loss, threshold=2.385)
    grid = np.linspace(-2e4, 2e4, 4_000_001)
    total = np.exp(-losses(grid, loss, 2.385)).sum() * (grid[1] - grid[0])
    found = model_hypotheses.spread(hypothesis)
    assert found == pytest.approx(math.log(total / math.sqrt(2.0 * math.pi)), abs=1e-5)


def test_a_smooth_error_has_its_covariance():
    """Of a process carried along the track: Matérn's, at any two epochs."""
    block = flight("air-narrow", runs=1, epochs=30)
    problem, _ = augmented(block, SMOOTH, motion_of(block))
    n = block.dimension
    p = problem.prior_cov
    phi = np.eye(len(p))
    for k in range(30):
        p = problem.transition[0, k] @ p @ problem.transition[0, k].T + problem.process_cov[0, k]
        phi = problem.transition[0, k] @ phi if k > 10 else np.eye(len(p))
        if k == 10:
            start = p
    assert p[n, n] == pytest.approx(SMOOTH.wander**2, rel=1e-9)
    speeds = np.linalg.norm(block.tracks[0, :, 3:6], axis=1)
    way = (speeds * np.diff(block.times, prepend=0.0))[11:].sum() * math.sqrt(3.0) / 1500.0
    expected = SMOOTH.wander**2 * (1.0 + way) * math.exp(-way)
    assert (phi @ start)[n, n] == pytest.approx(expected, rel=1e-9)


def test_weights_are_those_of_bayes_rule():
    """Two hypotheses of given densities; one whose filter fails weighs nothing from there on."""
    evidence = np.log(np.array([[[0.5, 0.1]], [[0.25, 0.3]]]))
    weights = np.exp(log_weights(evidence, np.log([[1.0], [3.0]])))
    np.testing.assert_allclose(weights[:, 0, 0], [0.4, 0.6])
    np.testing.assert_allclose(weights[:, 0, 1], [0.05 / 0.275, 0.225 / 0.275])
    evidence[1, 0, 1] = np.nan
    np.testing.assert_allclose(np.exp(log_weights(evidence, np.zeros((2, 1))))[:, 0, 1], [1.0, 0.0])


@pytest.mark.parametrize(
    ("case", "kind", "words"),
    [
        ("wrong-noise", "noise", r"noise (2.8|3.2) times as assumed"),
        ("outliers", "outliers", "outliers"),
    ],
)
@pytest.mark.long
def test_what_has_been_planted_is_found(case, kind, words):
    """The kind that the truth is of weighs more than any other of another effect, in words."""
    found = MultipleModel().estimate_block(flight(case, runs=2, epochs=120))
    for run in range(2):
        weights = {name: value[run] for name, value in found.info.items() if "weight" in name}
        assert max(weights, key=weights.get) == f"weight_{kind}"
        assert re.search(words, str(found.info["at_120_s"][run]))


def test_hypotheses_have_words_without_exponents():
    """Each of the bank its own."""
    words = [hypothesis.words for hypothesis in MultipleModel().hypotheses]
    assert len(set(words)) == len(words)
    assert not [text for text in words if re.search(r"\de[+-]\d", text)]
    assert "gravity of 150 mGal" in words and "noise 2.3 times as assumed" in words


def test_of_a_problem_without_map_or_track_only_what_it_has_is_doubted():
    """Hypotheses that a block has nothing of are left out."""
    block = dataclasses.replace(flight("air-narrow"), tracks=None)
    taken = model_hypotheses.applicable(HYPOTHESES, block)
    assert {h.kind for h in taken} == {"as_assumed", "noise", "constants", "outliers"}


def test_less_noise_is_no_answer_to_errors_that_are_modelled_too_rough():
    """Where the model has walking biases no noise below the assumed one is doubted."""
    less, more = Hypothesis("noise", noise=0.5), Hypothesis("noise", noise=2.0)
    for case, taken in (("map-error", True), ("map-error-known", False)):
        block = flight(case, runs=1, epochs=3)
        left = model_hypotheses.applicable([less, more], block)
        assert left == ([less, more] if taken else [more])


def test_epochs_that_are_not_filled_yet_are_not_used(monkeypatch):
    """With signalling NaN in new arrays, as memory may hold them, no operation warns of one."""
    block, empty = flight("prior-0.3", runs=1, epochs=12), np.empty
    signalling = np.array([0x7FF0000000000001], dtype=np.uint64).view(float)

    def filled(*arguments, **options):
        array = empty(*arguments, **options)
        if array.dtype == float:
            array.reshape(-1)[:] = signalling
        return array

    monkeypatch.setattr(np, "empty", filled)
    with np.errstate(invalid="raise"):
        found = MultipleModel().estimate_block(block)
    assert np.isfinite(found.mean).all()


@pytest.mark.long
def test_the_search_ends_over_a_rough_map_with_coloured_noise():
    """Along measured lines: the grid is as fine as the noise needs, and all hypotheses begin."""
    block = block_of_runs("vinton2008_biases", "neglected_bias-3", 0, 1)
    found = MultipleModel().estimate_block(block)
    assert found.info["map_evaluations"][0] < 400_000  # 2,142,078 by the straightness alone
    assert found.info["weight_map_errors"][0] > 0.0  # zero where the search did not end
