"""Files of estimation problems, with the measurement equation in full.

A file contains the problems of many runs. :data:`FORMAT` is the version of the format.
``problem_format.csv`` declares all variables of a file; a table of the documentation is generated
from it.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np

from ..block import ProblemBlock
from ..gravity.ellipsoid import (
    ECCENTRICITY_SQUARED,
    EVEN_ZONALS,
    GM,
    ROTATION_RATE,
    SEMI_MAJOR_AXIS,
)
from ..sensors.gradiometer.instrument import INSTRUMENTS
from ..sensors.model_kernels import linearise
from . import containers

FORMAT = "ggbench problem 1"
CHECKS = 100
"""Number of states at which the file contains h and H."""
_REACH = 0.5
"""Standard deviation of these states about the prior mean [prior σ]."""


@dataclass(frozen=True)
class Variable:
    """A variable of the file (array or text): axes, unit and meaning.

    Axes are numbers or symbols: R runs, K epochs, n states, m channels, g gradiometer channels.
    Further symbols: T is the number of measurements that whitening combines, and b the number of
    columns of the matrix B (``displacement``). C is the number of check states. For each check
    state the file contains the values of the measurement function h and its Jacobian H.
    """

    name: str
    axes: str
    unit: str
    meaning: str


VARIABLES = tuple(
    Variable(**row)
    for row in csv.DictReader(
        resources.files(__package__).joinpath("problem_format.csv").read_text("utf-8").splitlines()
    )
)
"""All variables of a file, in order."""


def identity(facts: Mapping[str, object], block: ProblemBlock) -> str:
    """Return the text that identifies a problem in files of estimates.

    Parameters
    ----------
    facts : scenario, case, seed, key, runs, states and times of the problem, as JSON values.
    block : problems of the runs; :func:`fingerprints` identifies each run.
    """
    return json.dumps({**facts, "fingerprints": fingerprints(block.measurements)})


def fingerprints(measurements: np.ndarray) -> list[float]:
    """Return a fingerprint of each run, computed from the measurements (R, K, m)."""
    weights = 1.0 + np.cos(np.arange(1.0, 1.0 + measurements[0].size)).reshape(
        measurements[0].shape
    )
    return [float(x) for x in np.einsum("rkm,km->r", measurements, weights)]


def content_of(block: ProblemBlock, problem: str) -> dict[str, np.ndarray | str]:
    """Return the arrays and texts of the problem file of a block, by name.

    The names are those of :data:`VARIABLES`. Arrays with values of each run are (R, ...).

    Parameters
    ----------
    block : problems of R runs.
    problem : identity of the problem, from :func:`identity`.
    """
    model, runs, epochs = block.model, block.runs, block.epochs
    channels = block.measurements.shape[2]
    tracks = block.tracks if block.tracks is not None else np.full((runs, epochs, 15), np.nan)
    taps, g = model.lags.shape[1], model.channels.shape[0]
    attitudes = np.zeros((runs, epochs, 3, 3))
    if INSTRUMENTS[model.instrument] == "strapdown":
        attitudes = model.attitudes
    gravity = model.gravity.coefficients
    values: dict[str, np.ndarray | str] = {
        "format": FORMAT,
        "problem": problem,
        "states": "\n".join(
            f"{b.name}; {b.slice.start}; {b.slice.stop - b.slice.start}; {b.unit}"
            for b in block.layout
        ),
        "channels": "\n".join(f"{c.name}; {c.unit}; {c.sensor}" for c in block.channels),
        "instrument": INSTRUMENTS[model.instrument],
        "times": block.times,
        "measurements": block.measurements,
        "present": block.present.astype(float),
        "noise_cov": np.broadcast_to(block.noise_cov, (epochs, channels, channels)),
        "transition": block.transition,
        "process_cov": block.process_cov,
        "prior_mean": block.prior_mean,
        "prior_cov": block.prior_cov,
        "ins_position": tracks[:, :, :3],
        "ins_velocity": tracks[:, :, 3:6],
        "ins_attitude": tracks[:, :, 6:].reshape(runs, epochs, 3, 3),
        "offset": model.offset[:, :epochs],
        "linear": model.linear[:, :epochs],
        "gain": model.gain[:, :epochs],
        "combined": np.broadcast_to(model.combined, (len(model.times), taps, g, 6))[:epochs],
        "lags": np.broadcast_to(model.lags, (len(model.times), taps))[:epochs].astype(float),
        "reading_times": model.times[:epochs],
        "reading_positions": model.references[:, :epochs],
        "reading_attitudes": attitudes[:, :epochs],
        "displacement": model.rows[:, :epochs],
        "weights": model.weights[:, :epochs],
        "map_origin": model.origin,
        "map_step": model.step,
        "map_coefficients": model.coefficients,
        "gravity_origin": model.gravity.origin,
        "gravity_step": model.gravity.step,
        "gravity_coefficients": gravity if gravity.size else np.zeros((0, 0, 0, 3)),
        "ellipsoid": np.array([SEMI_MAJOR_AXIS, ECCENTRICITY_SQUARED, GM, ROTATION_RATE]),
        "zonals": EVEN_ZONALS,
        **_checks(block),
    }
    return {
        v.name: item if isinstance(item := values[v.name], str) else np.array(item, dtype=float)
        for v in VARIABLES
    }


def _checks(block: ProblemBlock) -> dict[str, np.ndarray]:
    """Return random states near the prior mean, with h and H at random epochs of random runs."""
    rng, n = np.random.default_rng(0), block.dimension
    runs = rng.integers(0, block.runs, CHECKS)
    epochs = rng.integers(0, block.epochs, CHECKS)
    sigma = np.sqrt(np.diag(block.prior_cov))
    states = block.prior_mean + _REACH * sigma * rng.standard_normal((CHECKS, n))
    m = block.measurements.shape[2]
    h, jacobian = np.empty((CHECKS, m)), np.empty((CHECKS, m, n))
    for i in range(CHECKS):
        arrays = block.model.of_run(int(runs[i])).as_block()
        linearise(arrays, int(epochs[i]), states[i : i + 1], h[i : i + 1], jacobian[i : i + 1])
    return {
        "check_runs": runs,
        "check_epochs": epochs,
        "check_states": states,
        "check_h": h,
        "check_jacobian": jacobian,
    }


NOTES: Mapping[str, str] = {v.name: f"{v.meaning} [{v.unit}]" for v in VARIABLES if v.unit}
"""Meaning and unit of each array; netCDF and plain text store them."""


def write(path: Path, block: ProblemBlock, problem: str) -> None:
    """Write the problems of a block to a file; the suffix of ``path`` chooses the format.

    Raises
    ------
    ExchangeError
        As in :func:`.containers.write`.
    """
    containers.write(path, content_of(block, problem), NOTES)
