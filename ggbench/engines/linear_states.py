"""Linear states of a measurement model, for Rao–Blackwellised filters."""

from __future__ import annotations

import numpy as np

from ..block import CompiledModel
from ..problem import Problem
from ..sensors.gradiometer.instrument import STRAPDOWN

POSITION = 3
"""The first three states are the position's errors [m]."""


def mixing(problem: Problem) -> str | None:
    """Return a reason if h must not be treated as linear in all states except the position.

    The position states are the first three states. The result is None if h is linear in all other
    states.
    """
    if not isinstance(problem.model, CompiledModel):
        return (
            "linear states can be identified only in the measurement model of ggbench, not in "
            f"{type(problem.model).__name__}"
        )
    arrays = problem.model.arrays
    read = np.flatnonzero(arrays.gain)
    if len(arrays.channels) == 0 or len(read) == 0:
        return None
    if arrays.instrument == STRAPDOWN:
        return "the gradiometer measurements depend nonlinearly on attitude or mounting angles"
    if not np.array_equal(
        arrays.rows[read, :POSITION],
        np.broadcast_to(
            np.eye(POSITION, arrays.rows.shape[-1]), arrays.rows[read, :POSITION].shape
        ),
    ):
        return (
            "a filtered or late gradiometer measures at an earlier position, which depends on "
            "all states"
        )
    return None
