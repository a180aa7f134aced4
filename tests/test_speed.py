"""Implementations that are compared solve the same problem, and the page is of its tables."""

from pathlib import Path

import numpy as np
import pytest
from speed import export, numpy_model, page, rounds

from ggbench.errors import GGBenchError

RUNS = (0, 7)
REPORTS = Path(__file__).parents[1] / "reports"


@pytest.fixture(scope="module")
def both():
    arrays = export.arrays(RUNS)
    models = [problem.model for problem in export.problems(RUNS)]
    return arrays, [numpy_model.NumpyModel(arrays, r) for r in range(len(RUNS))], models


def states(arrays, spread, count=4, seed=5):
    rng = np.random.default_rng(seed)
    return arrays.prior_mean + spread * arrays.scale * rng.standard_normal((count, 15))


@pytest.mark.parametrize("spread", [0.0, 1.0, 100.0])
def test_the_readings_that_numpy_predicts_are_ggbenchs(both, spread):
    arrays, ours, theirs = both
    for run in range(len(RUNS)):
        for k in (0, 3, 77, 199):
            x = states(arrays, spread, seed=k)
            expected = theirs[run].predict(k, x)
            # The tensor is 3000 E: the rounding of a double is 5e-13 E.
            np.testing.assert_allclose(ours[run].predict_all(k, x), expected, rtol=0, atol=1e-9)
            for one, state in zip(expected, x, strict=True):
                np.testing.assert_allclose(ours[run].predict(k, state), one, rtol=0, atol=1e-9)


@pytest.mark.parametrize("spread", [0.0, 1.0, 100.0])
def test_the_jacobian_in_numpy_is_ggbenchs(both, spread):
    arrays, ours, theirs = both
    for run in range(len(RUNS)):
        for k in (0, 3, 77, 199):
            (x,) = states(arrays, spread, count=1, seed=k)
            expected = theirs[run].jacobian(k, x)
            # In units of the noise for one deviation of the prior.
            unit = arrays.scale / np.sqrt(np.diag(arrays.noise_cov))[:, None]
            scaled = (ours[run].jacobian(k, x) - expected) * unit
            assert np.abs(expected * unit).max() > 0.1
            np.testing.assert_allclose(scaled, 0.0, atol=1e-9)


@pytest.fixture(scope="module")
def committed():
    return page.read(REPORTS / page.FOLDER)


def test_the_committed_page_is_of_the_committed_tables(committed):
    assert page.page(committed) == (REPORTS / "speed.md").read_text(encoding="utf-8")


def test_implementations_that_were_timed_agree(committed):
    """Largest difference in prior deviations: 1e-6 of filters, 1e-4 of batch smoothers."""
    measured = committed["implementations"]
    timed = measured[measured["not_timed_because"].isna()]
    batch = timed["family"] == "batch"
    assert set(measured["family"]) == set(page.LABELS)
    assert timed.loc[~batch, page.DIFFERENCE].max() <= 1e-6
    assert timed.loc[batch, page.DIFFERENCE].max() <= 1e-4


def test_a_page_names_what_was_not_timed_and_is_not_made_without_an_engine(committed):
    def without(name):
        measured, turns = committed["implementations"].copy(), committed["rounds"]
        measured.loc[measured["implementation"] == name, "not_timed_because"] = "no network"
        return committed | {
            "implementations": measured,
            "rounds": turns[turns["implementation"] != name],
        }

    text = page.page(without("Stone Soup"))
    assert "Not timed: Stone Soup (ekf), because no network." in text
    assert "|Stone Soup|" not in text
    with pytest.raises(GGBenchError, match="filterpy or ekf was not timed"):
        page.page(without("filterpy"))
    with pytest.raises(GGBenchError, match="make bench writes it"):
        page.read(REPORTS / "no_such_folder")


@pytest.mark.long
def test_what_gives_another_answer_is_not_timed(both, tmp_path):
    arrays, _, _ = both
    entries = [
        rounds.Entry("ggbench:ekf", "the reference", "ekf"),
        rounds.Entry("ggbench:ekf[iterations=3]", "another filter", "ekf"),
        rounds.Entry("ggbench:no_such_filter", "one that cannot start", "ekf"),
    ]
    found = rounds.measure(
        entries,
        tmp_path / "unused.npz",
        tmp_path,
        arrays.scale,
        {"ekf": 1e-9},
        rounds=1,
        seconds=0.0,
    )
    assert [len(item.turns) for item in found] == [1, 0, 0]
    assert "its means differ by" in found[1].refusal
    assert "no_such_filter" in found[2].refusal
