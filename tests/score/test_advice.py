"""Advice: halved causes lower the bound, a target's noise reaches it, the best is recommended."""

from __future__ import annotations

import math

import pytest
from campaigns import small
from command import invoke
from problems import SMALL

from ggbench.judging.planned import bound_of
from ggbench.score import advice

KEY = "gradiometer.noise_eotvos"


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp("advice")
    scenario = small(folder)
    case = scenario.cases[0]
    return advice.advise(scenario, case, folder / "out", 2.0 * bound_of(case), 4, jobs=0)


@pytest.mark.long
def test_each_limit_is_the_bound_of_a_halved_cause(found):
    """No cause makes the bound larger when it is halved, and the most important comes first."""
    limits = {limit.cause: limit for limit in found.limits}
    assert {"noise of the gradiometer", "initial uncertainty"} <= set(limits)
    gains = [limit.gain for limit in found.limits]
    assert gains == sorted(gains, reverse=True) and min(gains) > -1e-9
    half = found.case.changed(KEY, 0.5 * found.case.gradiometer.noise_eotvos)
    assert limits["noise of the gradiometer"].bound_m == pytest.approx(bound_of(half))


@pytest.mark.long
def test_the_noise_that_is_found_reaches_the_target(found):
    """To 1% of the bound; and control: a target below any bound is out of reach."""
    target = 2.0 * found.bound_m
    assert found.unit == "E"
    assert bound_of(found.case.changed(KEY, found.noise)) == pytest.approx(target, rel=0.01)
    assert math.isnan(advice.needed(found.case, KEY, 1e-9))


def test_the_recommended_estimator_was_flown(found):
    label, _ = advice.recommended(found)
    assert label in set(advice.table(found)["estimator"])
    assert {"ins", "ekf"} <= set(advice.table(found)["estimator"])


def test_the_command_says_what_to_use_and_what_limits(tmp_path):
    (tmp_path / "own.toml").write_text(SMALL, encoding="utf-8")
    command = ["advise", "own.toml", "-n", "4", "-j", "0", "--target", "1e-9"]
    done = invoke(command, tmp_path, columns=120)
    assert done.returncode == 1, done.stderr
    best = "the least bad is" if "the least bad is" in done.stdout else "Use "
    for words in (best, "What limits", "No gradiometer reaches 1e-09 m here"):
        assert words in done.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["none.toml"], "none.toml"), (["wang2013", "-c", "x"], "has no case 'x'")],
)
def test_bad_input_is_a_sentence(arguments, said, tmp_path):
    done = invoke(["advise", *arguments], tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
