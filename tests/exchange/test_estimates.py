"""Problems go out and estimates come back: the same table, and a sentence for every fault."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from problems import SMALL, estimator
from thinning import thinned

import ggbench as gg
from ggbench.api import exchange
from ggbench.block import ProblemBlock
from ggbench.campaign import flights
from ggbench.errors import GGBenchError
from ggbench.exchange import containers, estimate_files, problem_files

RUNS = 3


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder with the small scenario, its exported base case, and the estimates of ``ekf``."""
    here = tmp_path_factory.mktemp("exchange")
    (here / "small.toml").write_text(SMALL)
    gg.export(here / "small.toml", here, cases=["base"], runs=RUNS)
    containers.write(here / "ekf.mat", estimates(here), {})
    return here


def block_of(folder: Path, runs: int = RUNS) -> ProblemBlock:
    loaded = gg.load(folder / "small.toml")
    return flights.simulated(loaded.case("base"), loaded.campaign.seed, range(runs)).block


def estimates(folder: Path, label: str = "ekf", **changes: object) -> dict[str, object]:
    """What a client writes, here of an estimator of the package."""
    problem = containers.read(folder / "base.mat")
    found = estimator(label).estimate_block(block_of(folder))
    return {
        "problem": problem["problem"],
        "times": problem["times"],
        "mean": found.mean,
        "cov": found.cov,
        "causality": found.causality,
        "estimator": "ours",
    } | changes


def refused(folder: Path, path: Path, **changes: object) -> str:
    held = {k: v for k, v in estimates(folder, **changes).items() if v is not None}
    containers.write(path, held, {})
    with pytest.raises(GGBenchError) as error:
        estimate_files.read(path)
    return str(error.value)


def test_estimates_of_a_file_have_the_metrics_of_their_filter(folder, tmp_path):
    judged = gg.judge_estimates(folder / "ekf.mat", output=tmp_path / "judged", jobs=0)
    flown = gg.run(
        folder / "small.toml", "ekf", RUNS, cases=["base"], output=tmp_path / "flown", jobs=0
    )
    names = ["settled_position_ms", "settled_velocity_ms", "settled_nees", "settled_nis"]
    np.testing.assert_allclose(judged.runs()[names], flown.runs()[names], rtol=1e-9)
    assert set(judged.runs()["estimator"]) == {str(folder / "ekf.mat")}


def test_position_and_velocity_are_enough(folder, tmp_path):
    """The innovations of such estimates are unknown, all else is that of the whole states."""
    whole = estimates(folder)
    part = {"mean": whole["mean"][:, :, :6], "cov": whole["cov"][:, :, :6, :6]}
    containers.write(tmp_path / "part.mat", whole | part, {})
    judged = gg.judge_estimates(tmp_path / "part.mat", output=tmp_path / "out", jobs=0).runs()
    flown = gg.judge_estimates(folder / "ekf.mat", output=tmp_path / "all", jobs=0).runs()
    names = ["settled_position_ms", "settled_velocity_ms", "settled_nees"]
    np.testing.assert_allclose(judged[names], flown[names], rtol=1e-9)
    assert judged["settled_nis"].isna().all()


@pytest.mark.parametrize("suffix", containers.SUFFIXES)
def test_the_file_states_its_equation(suffix, folder, tmp_path):
    """H and H of the check states follow from the arrays of the file alone, in NumPy."""
    block = block_of(folder)
    problem_files.write(tmp_path / f"p{suffix}", block, "x")
    p = containers.read(tmp_path / f"p{suffix}")
    for i in range(0, problem_files.CHECKS, 10):
        r, k = (int(p[name].ravel()[i]) for name in ("check_runs", "check_epochs"))
        x = p["check_states"][i]
        model = block.problem(r).model
        np.testing.assert_allclose(p["check_h"][i], model.predict(k, x), rtol=1e-12)
        np.testing.assert_allclose(p["check_jacobian"][i], model.jacobian(k, x), rtol=1e-12)


def test_a_file_holds_no_truth(folder):
    """Of the true position errors no run has any, at any epoch.

    The vertical velocity of the INS in level flight is its error, for whoever knows that.
    """
    loaded = gg.load(folder / "small.toml")
    simulated = flights.simulated(loaded.case("base"), loaded.campaign.seed, range(RUNS))
    with simulated.truth.looked_at() as truth:
        numbers = np.unique(np.array(truth)[:, :, :3])
    held = containers.read(folder / "base.mat")
    arrays = [v.ravel() for name, v in held.items() if isinstance(v, np.ndarray)]
    assert not np.isin(numbers[numbers != 0.0], np.concatenate(arrays)).any()


def test_every_declared_variable_is_there_with_its_axes(folder):
    held = containers.read(folder / "base.mat")
    assert list(held) == [v.name for v in problem_files.VARIABLES]
    block = block_of(folder)
    lengths = {"R": RUNS, "K": block.epochs, "n": block.dimension, "m": block.measurements.shape[2]}
    for v in problem_files.VARIABLES:
        axes = v.axes.split()
        if isinstance(held[v.name], np.ndarray) and set(axes) <= set(lengths):
            assert containers.shaped(held[v.name], tuple(lengths[a] for a in axes)) is not None


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"mean": None}, "mean is missing and must be an array, 3 × 20 × 15"),
        ({"mean": np.zeros((3, 20, 14))}, "mean has the shape 3 × 20 × 14 and must have"),
        ({"mean": np.zeros((15, 20, 3))}, "its axes are in a different order"),
        ({"mean": "north"}, "mean is a text and must be an array"),
        ({"times": np.arange(20.0)}, "must be 1 s, as in the problem's file"),
        ({"frame": "NED"}, "frame is 'NED' and must be 'ENU'"),
        ({"units": "km"}, "units is 'km' and must be 'SI'"),
        ({"causality": "smoother"}, "causality is 'smoother' and must be one of"),
        ({"causality": None}, "causality is missing and must be a text"),
        ({"causality": "fixed-lag"}, "lag is missing"),
        ({"lag": np.array(3.0)}, "lag requires causality fixed-lag"),
        ({"seconds": -np.ones(3)}, "seconds must not be below zero"),
        ({"estimator": "x" * 70}, "must be a printable name"),
        ({"sigma": np.zeros(3)}, "contains sigma, which is not allowed in estimates"),
        ({"problem": "{}"}, "problem must be copied unchanged from the problem's file"),
    ],
)
def test_faults_are_named(changes, sentence, folder, tmp_path):
    assert sentence in refused(folder, tmp_path / "bad.mat", **changes)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda cov: -cov, "must be above 0"),
        (lambda cov: cov + np.triu(cov[0, 0], 1), "is not symmetric at epoch 0"),
        (lambda cov: indefinite(cov), "is not positive definite at epoch 4"),
        (
            lambda cov: np.where(np.arange(3).reshape(3, 1, 1, 1) == 2, np.nan, cov),
            "must be finite",
        ),
    ],
)
def test_covariances_that_are_none_are_named(change, sentence, folder, tmp_path):
    cov = np.array(estimates(folder)["cov"])
    assert sentence in refused(folder, tmp_path / "bad.mat", cov=change(cov))


def indefinite(cov: np.ndarray) -> np.ndarray:
    changed = cov.copy()
    sigma = np.sqrt(np.diag(changed[1, 4]))
    changed[1, 4, 0, 1] = changed[1, 4, 1, 0] = 1.01 * sigma[0] * sigma[1]
    return changed


def test_a_filter_that_uses_later_readings_is_refused(folder, tmp_path):
    """A smoother that says it is a filter; the filter itself passes."""
    gg.export(folder / "small.toml", tmp_path, cases=["base"], runs=RUNS, until_s=12.0)
    problem = containers.read(tmp_path / "base.mat")
    block = block_of(folder).until(12)
    for label, batch in (("ekf", False), ("factor-graph[mode=batch]", True)):
        whole = estimates(folder, label, causality="filter")
        found = estimator(label).estimate_block(block)
        cut = (
            whole
            | {"mean": found.mean, "cov": found.cov}
            | {name: problem[name] for name in ("times", "problem")}
        )
        containers.write(tmp_path / "whole.mat", whole, {})
        containers.write(tmp_path / "cut.mat", cut, {})
        if not batch:
            exchange.judge_estimates(
                tmp_path / "whole.mat", cut=tmp_path / "cut.mat", output=tmp_path / "out", jobs=0
            )
            continue
        with pytest.raises(
            GGBenchError, match="use later measurements: without the measurements after 12 s"
        ):
            exchange.judge_estimates(tmp_path / "whole.mat", cut=tmp_path / "cut.mat")


def test_estimates_of_two_seeds_are_refused(folder, tmp_path):
    """A folder may have several files, but all of one scenario and one seed."""
    problem = json.loads(str(estimates(folder)["problem"]))
    for seed, name in ((problem["seed"], "a.mat"), (problem["seed"] + 1, "b.mat")):
        changed = json.dumps(problem | {"seed": seed})
        containers.write(tmp_path / name, estimates(folder, problem=changed), {})
    with pytest.raises(GGBenchError, match="must have the same scenario and the same seed"):
        gg.judge_estimates(tmp_path)


@thinned(
    ("change", "words"),
    [
        (lambda mean: -mean, "with opposite sign"),
        (lambda mean: ned(mean), "as north, east, down"),
        (lambda mean: 1e-3 * mean, "in km and km/s"),
        (lambda mean: mean, ""),
    ],
)
def test_another_sign_frame_or_unit_is_seen(change, words, folder, tmp_path):
    """By the truth, where the file does not say it; a filter that errs honestly is not accused."""
    whole, loaded = estimates(folder), gg.load(folder / "small.toml")
    simulated = flights.simulated(loaded.case("base"), loaded.campaign.seed, range(RUNS))
    with simulated.truth.looked_at() as truth:
        mean = 1.1 * np.array(truth)
    mean[:, :, :6] = change(mean[:, :, :6])
    containers.write(tmp_path / "odd.mat", whole | {"mean": mean}, {})
    results = gg.judge_estimates(tmp_path / "odd.mat", output=tmp_path / "out", jobs=0)
    sentences = exchange.misreadings(tmp_path / "odd.mat", results)
    assert len(sentences) == bool(words) and words in "".join(sentences)


def ned(mean: np.ndarray) -> np.ndarray:
    return mean[:, :, [1, 0, 2, 4, 3, 5]] * np.array([1, 1, -1, 1, 1, -1])


def test_estimates_of_a_changed_scenario_are_refused(folder, tmp_path):
    changed = SMALL.replace("position_m = ", "position_m = 1")
    assert changed != SMALL
    (tmp_path / "small.toml").write_text(changed)
    with pytest.raises(GGBenchError, match="differs from the problem of"):
        gg.judge_estimates(folder / "ekf.mat", scenario=tmp_path / "small.toml")


def test_a_run_that_is_not_in_the_file_fails_with_the_reason(folder, tmp_path):
    results = gg.run(
        folder / "small.toml",
        str(folder / "ekf.mat"),
        RUNS + 1,
        cases=["base"],
        output=tmp_path / "out",
        jobs=0,
    )
    (reason,) = results.failures()["reason"]
    assert "has no run with these measurements: it has case base" in reason


def test_fingerprints_tell_runs_apart(folder):
    prints = problem_files.fingerprints(block_of(folder).measurements)
    assert len(set(prints)) == RUNS
    held = json.loads(str(containers.read(folder / "base.mat")["problem"]))
    assert held["fingerprints"] == prints
