"""The rules by which steps to a minimum are taken and end: those of GTSAM's optimizer, compiled.

A difference of two costs has the rounding errors of h. Where a step changes the cost by less than
them, chance would decide whether it is taken, or even begin a search through all dampings. There
the linear problem decides, whose promise is exact, and the search ends.
"""

from __future__ import annotations

from ..numerics.kernels import compiled

FIRST_DAMPING, _MOST_DAMPING, _FACTOR = 1e-12, 1e5, 10.0
LEAST_FELT = 1e-9
"""Damping below which it is left out: a billionth of the prior's information."""
_LEAST_FIDELITY = 1e-3
RELATIVE_DECREASE, ABSOLUTE_DECREASE = 1e-10, 1e-5
"""Decrease of the cost at which the search ends: far above its rounding errors, by which two
engines would else take a different number of steps."""
_ROUNDING = 1e-6
"""Change of the cost that may be due to rounding in h: up to 5e-8 with 0.001 E of noise and
3000 E; less than what ends the search."""
_NOTHING = 1e-13
"""Relative change of the cost that may be due to rounding in the linear problem."""


@compiled
def arrived(cost: float, linear_cost: float) -> bool:
    """Return whether the linear problem promises nothing any more."""
    return abs(cost - linear_cost) <= _NOTHING * cost


@compiled
def decide(
    cost: float, base: float, linear_cost: float, new_cost: float, damping: float
) -> tuple[bool, bool, float]:
    """Return whether a step is taken, whether the search ends, and the next damping.

    Parameters
    ----------
    cost, new_cost : before and after the step.
    base, linear_cost : the same by the linear problem; with a loss its cost is another one.
    damping : of the step.
    """
    promised, gained = base - linear_cost, cost - new_cost
    if abs(promised) <= _ROUNDING and abs(gained) <= _ROUNDING:
        return promised > _NOTHING * base, True, damping
    if promised > 2.2e-16 * base and gained > _LEAST_FIDELITY * promised:
        enough = gained <= max(ABSOLUTE_DECREASE, RELATIVE_DECREASE * cost)
        return True, enough, damping / _FACTOR
    damping *= _FACTOR
    while damping < LEAST_FELT:  # the same step again
        damping *= _FACTOR
    return False, not damping < _MOST_DAMPING, damping


@compiled
def is_last_step(cost: float, linear_cost: float) -> bool:
    """Return whether a whole step from where the search has ended is to be taken, not judged.

    It promises less than what ends a search, so that the search would not have asked for it; with
    it an answer does not depend on which engine's rounding ended the search a step earlier.
    """
    return abs(cost - linear_cost) <= ABSOLUTE_DECREASE
