"""Runs of the scenario whose prior is wide, made once for all tests of a file."""

from __future__ import annotations

import functools

from ggbench.block import ProblemBlock
from ggbench.simulation.error_free_flight import Flight, prepare
from ggbench.simulation.runs import Truth, simulate_block
from ggbench.spec import scenario


@functools.cache
def wide(case: str) -> Flight:
    """A case of the scenario."""
    return prepare(scenario.load("wide_prior").case(case))


@functools.cache
def lost(case: str, runs: int) -> tuple[ProblemBlock, Truth]:
    """Its first runs, and their truth."""
    return simulate_block(wide(case), 4, range(runs))
