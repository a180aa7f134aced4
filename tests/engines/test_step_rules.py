"""When a step is taken, when a search ends, and how the damping goes on: case by case."""

from __future__ import annotations

import pytest

from ggbench.engines.step_rules import LEAST_FELT, arrived, decide, is_last_step

CASES = {
    # (cost, that of the linear problem, that after the step, damping): (taken, last, damping)
    "as promised": ((100.0, 50.0, 60.0, 1e-3), (True, False, 1e-4)),
    "a little of what was promised": ((100.0, 50.0, 99.9, 1e-3), (True, False, 1e-4)),
    "too little of it": ((100.0, 50.0, 99.96, 1e-3), (False, False, 1e-2)),
    "upwards": ((100.0, 50.0, 110.0, 1e-3), (False, False, 1e-2)),
    "upwards, hardly damped": ((100.0, 50.0, 110.0, 3e-12), (False, False, 3.0 * LEAST_FELT)),
    "to nowhere": ((100.0, 50.0, float("nan"), 1e-3), (False, False, 1e-2)),
    "upwards, as damped as can be": ((100.0, 50.0, 110.0, 1e4), (False, True, 1e5)),
    "upwards, not quite so": ((100.0, 50.0, 110.0, 9e3), (False, False, 9e4)),
    "less than what ends a search": ((1.0, 1.0 - 2e-5, 1.0 - 8e-6, 1e-3), (True, True, 1e-4)),
    "more than that": ((1.0, 1.0 - 2e-5, 1.0 - 1.2e-5, 1e-3), (True, False, 1e-4)),
    "less, of a large cost": ((1e8, 1e8 - 1.0, 1e8 - 0.005, 1e-3), (True, True, 1e-4)),
    "more, of a large cost": ((1e8, 1e8 - 1.0, 1e8 - 0.02, 1e-3), (True, False, 1e-4)),
    "within rounding, but promised": ((1.0, 1.0 - 5e-7, 1.0 + 5e-7, 1e-3), (True, True, 1e-3)),
    "within rounding, not promised": ((1.0, 1.0, 1.0 - 5e-7, 1e-3), (False, True, 1e-3)),
    "promised much, within rounding": ((1.0, 0.5, 1.0 - 5e-7, 1e-3), (False, False, 1e-2)),
    "promised nothing, beyond rounding": ((1.0, 1.0, 1.1, 1e-3), (False, False, 1e-2)),
}


@pytest.mark.parametrize("what", CASES)
def test_a_step_is_decided_upon_by_what_it_promised_and_gained(what):
    given, (taken, last, damping) = CASES[what]
    cost, *others = given
    found = decide(cost, cost, *others)
    assert found[:2] == (taken, last)
    assert found[2] == pytest.approx(damping)


def test_a_promise_is_of_the_linear_problem_which_with_a_loss_has_another_cost():
    """80 that weigh 100: to 95 is a promise of 5, of which 4 are gained, or nothing."""
    assert decide(80.0, 100.0, 95.0, 76.0, 1e-3)[0]
    assert not decide(80.0, 100.0, 95.0, 80.0, 1e-3)[0]


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_ends_are_told_by_the_size_of_what_is_promised_whatever_its_sign(sign):
    """A search has arrived at 1e-13 of its cost; the last step may change it by 1e-5."""
    assert arrived(1e3, 1e3 + sign * 0.5e-10)
    assert not arrived(1e3, 1e3 + sign * 2e-10)
    assert is_last_step(1e3, 1e3 + sign * 0.9e-5)
    assert not is_last_step(1e3, 1e3 + sign * 1.1e-5)
