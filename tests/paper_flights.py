"""Flights of the paper, each prepared once."""

from __future__ import annotations

import functools

from ggbench.simulation.error_free_flight import Flight, prepare
from ggbench.spec import scenario


@functools.cache
def flight(name: str) -> Flight:
    """The flight of a case of the paper, made once."""
    return prepare(scenario.load("wang2013").case(name))
