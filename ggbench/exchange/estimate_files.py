"""Files of estimates, and an estimator that returns the estimates of such a file."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, get_args

import numpy as np

from ..errors import text_of
from ..problem import Causality, Estimate, Estimator, Problem
from . import containers
from .containers import ExchangeError
from .problem_files import fingerprints

JUDGED = 6
"""Least number of states of estimates: position and velocity errors."""
FRAME, UNITS = "ENU", "SI"
"""Required values of ``frame`` and ``units`` of a file, if present."""
_LONGEST_NAME = 60
_SAME_TIME_S = 1e-6
_ROUNDING = 1e-9
_SAME = 1e-9
"""Largest relative difference of fingerprints of equal runs, simulated on two machines."""
KNOWN = {
    "mean",
    "cov",
    "times",
    "problem",
    "causality",
    "lag",
    "estimator",
    "seconds",
    "frame",
    "units",
}


@dataclass(frozen=True)
class StoredRuns:
    """The content of a file of estimates.

    In shapes, R is the number of runs, K of epochs, and n of states.

    Attributes
    ----------
    mean : (R, K, n) all states, or (R, K, 6) only position and velocity.
    cov : (R, K, n, n) or (R, K, 6, 6) covariances.
    times : (K,) epochs [s].
    problem : identity of the problem file: scenario, case, seed, key, runs, states, times, epochs,
        fingerprints.
    causality, lag : as in :class:`.problem.Estimate`.
    estimator : name of the estimator.
    seconds : (R,) computing time of each run [s]; None if the file does not contain it.
    """

    mean: np.ndarray
    cov: np.ndarray
    times: np.ndarray
    problem: dict[str, Any]
    causality: Causality
    lag: float | None
    estimator: str
    seconds: np.ndarray | None

    def run_of(self, problem: Problem) -> int | None:
        """Return the index of the stored run with the measurements of a problem, or None."""
        if problem.epochs != len(self.times):
            return None
        (fingerprint,) = fingerprints(problem.measurements[np.newaxis])
        stored = np.array(self.problem["fingerprints"])
        nearest = int(np.abs(stored - fingerprint).argmin())
        same = abs(stored[nearest] - fingerprint) <= _SAME * max(abs(fingerprint), 1.0)
        return nearest if same else None

    def __str__(self) -> str:
        about, runs = self.problem, len(self.mean)
        return f"case {about['case']} of {about['scenario']}, {runs} runs of seed {about['seed']}"


def read(path: Path) -> StoredRuns:
    """Return the estimates of a file.

    Raises
    ------
    ExchangeError
        If an array or text is missing or has an unknown name, a shape, frame or unit is wrong, or
        numbers are not finite. If epochs differ from those of the problem, or a covariance is not
        symmetric or not positive definite. The message states the file, the array, the value and
        the allowed values.
    """
    content = containers.read(path)
    if unknown := sorted(set(content) - KNOWN):
        raise ExchangeError(
            f"{path} contains {unknown[0]}, which is not allowed in estimates; allowed are "
            f"{', '.join(sorted(KNOWN))}"
        )
    problem = _problem(path, _text(path, content, "problem"))
    runs = len(problem["fingerprints"])
    for name, meaning in (("frame", FRAME), ("units", UNITS)):
        text = _text(path, content, name, meaning)
        if text.strip() != meaning:
            raise ExchangeError(
                f"{path}: {name} is {text[:40]!a} and must be '{meaning}': errors of the INS in m, "
                "m/s and rad, east, north, up"
            )
    times = _array(path, content, "times", (problem["epochs"],))
    if np.abs(times - problem["times"]).max() > _SAME_TIME_S:
        worst = int(np.abs(times - problem["times"]).argmax())
        raise ExchangeError(
            f"{path}: times[{worst}] is {times[worst]:g} s and must be "
            f"{problem['times'][worst]:g} s, as in the problem's file"
        )
    n = _states(path, content, problem["states"])
    mean = _array(path, content, "mean", (runs, problem["epochs"], n))
    cov = _array(path, content, "cov", (runs, problem["epochs"], n, n))
    for run in range(runs):
        if flaw := _flaw_of(cov[run]):
            raise ExchangeError(f"{path}: cov of run {run} {flaw}")
    causality, lag = _causality(path, content)
    name = _text(path, content, "estimator", path.stem).strip()
    if not name.isprintable() or not 0 < len(name) <= _LONGEST_NAME:
        raise ExchangeError(
            f"{path}: estimator is {name[:80]!a} and must be a printable name of at most "
            f"{_LONGEST_NAME} characters"
        )
    seconds = _array(path, content, "seconds", (runs,)) if "seconds" in content else None
    if seconds is not None and not (seconds >= 0.0).all():
        raise ExchangeError(f"{path}: seconds must not be below zero")
    return StoredRuns(
        mean=mean,
        cov=cov,
        times=times,
        problem=problem,
        causality=causality,
        lag=lag,
        estimator=name,
        seconds=seconds,
    )


def _flaw_of(cov: np.ndarray) -> str:
    """Return the first fault of covariances (K, n, n), or "".

    Symmetry and definiteness are tested on the correlation matrices.
    """
    variances = np.diagonal(cov, axis1=1, axis2=2)
    if (variances <= 0.0).any():
        k, i = (int(x) for x in np.argwhere(variances <= 0.0)[0])
        return f"has the variance {variances[k, i]:g} of state {i} at epoch {k}: it must be above 0"
    scale = 1.0 / np.sqrt(variances)
    correlation = cov * scale[:, :, np.newaxis] * scale[:, np.newaxis, :]
    uneven = np.abs(correlation - correlation.transpose(0, 2, 1)).max(axis=(1, 2))
    if (uneven > _ROUNDING).any():
        return f"is not symmetric at epoch {int((uneven > _ROUNDING).argmax())}"
    least = np.linalg.eigvalsh(correlation)[:, 0]
    judged = np.linalg.eigvalsh(correlation[:, :JUDGED, :JUDGED])[:, 0]
    bad = (least < -_ROUNDING) | (judged <= 0.0)
    if bad.any():
        return f"is not positive definite at epoch {int(bad.argmax())}"
    return ""


def _text(path: Path, content: dict[str, Any], name: str, default: str | None = None) -> str:
    value = content.get(name, default)
    if not isinstance(value, str):
        flaw = "is missing" if value is None else "is an array"
        raise ExchangeError(f"{path}: {name} {flaw} and must be a text")
    return value


def _array(path: Path, content: dict[str, Any], name: str, shape: tuple[int, ...]) -> np.ndarray:
    value = content.get(name)
    expected = " × ".join(map(str, shape))
    if not isinstance(value, np.ndarray):
        flaw = "is missing" if value is None else "is a text"
        raise ExchangeError(f"{path}: {name} {flaw} and must be an array, {expected}")
    array = containers.shaped(value, shape)
    if array is None:
        flaw = " × ".join(map(str, value.shape))
        hint = ""
        if sorted(n for n in value.shape if n > 1) == sorted(n for n in shape if n > 1):
            hint = ": its axes are in a different order"
        raise ExchangeError(f"{path}: {name} has the shape {flaw} and must have {expected}{hint}")
    if not np.isfinite(array).all():
        place = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ExchangeError(f"{path}: {name}{list(place)} is {array[place]:g} and must be finite")
    return array


def _states(path: Path, content: dict[str, Any], n: int) -> int:
    """Return the number of states in the estimates: all n, or only position and velocity."""
    value = content.get("mean")
    last = value.shape[-1] if isinstance(value, np.ndarray) and value.ndim else n
    return JUDGED if last == JUDGED < n else n


def _causality(path: Path, content: dict[str, Any]) -> tuple[Causality, float | None]:
    causality: Any = _text(path, content, "causality").strip()
    if causality not in get_args(Causality):
        raise ExchangeError(
            f"{path}: causality is {causality[:40]!a} and must be one of "
            f"{', '.join(get_args(Causality))}"
        )
    if causality != "fixed-lag":
        if "lag" in content:
            raise ExchangeError(f"{path}: lag requires causality fixed-lag")
        return causality, None
    lag = float(_array(path, content, "lag", ()))
    if not 0.0 < lag < 1e9:
        raise ExchangeError(f"{path}: lag is {lag:g} s and must be above zero")
    return causality, lag


def _problem(path: Path, text: str) -> dict[str, Any]:
    """Return the identity of the problem file from its JSON text."""
    kinds = {
        "scenario": str,
        "case": str,
        "seed": int,
        "states": int,
        "key": str,
        "runs": list,
        "times": list,
        "fingerprints": list,
    }
    try:
        about = json.loads(text)
        flaw = [name for name, kind in kinds.items() if type(about[name]) is not kind]
        numbers = np.array([*about["times"], *about["fingerprints"]], dtype=float)
        if flaw or not np.isfinite(numbers).all() or not about["times"]:
            raise ValueError(flaw or "numbers that are not finite")
        runs = about["runs"]
        if not runs or len(runs) != len(about["fingerprints"]) or about["seed"] < 0:
            raise ValueError("runs")
        if any(type(run) is not int or run < 0 for run in runs):
            raise ValueError("runs")
        if not 1 <= about["states"] <= 1000:
            raise ValueError("states")
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise ExchangeError(
            f"{path}: problem must be copied unchanged from the problem's file: {text_of(error)}"
        ) from None
    about["times"] = np.array(about["times"], dtype=float)
    about["epochs"] = len(about["times"])
    return dict(about)


@lru_cache(maxsize=32)
def _read_once(path: Path, changed: int) -> StoredRuns:
    return read(path)


def stored_runs(path: Path) -> tuple[StoredRuns, ...]:
    """Return the estimates of a file, or of all files of a folder; unchanged files are cached.

    Raises
    ------
    ExchangeError
        As in :func:`read`; also if a folder contains no such file, or if the causality or the lag
        differs between its files.
    """
    try:
        files = [path]
        if path.is_dir():
            files = sorted(f for f in path.iterdir() if f.suffix in containers.SUFFIXES)
        stored = tuple(_read_once(file, file.stat().st_mtime_ns) for file in files)
    except OSError as error:
        raise ExchangeError(f"cannot read {path}: {error.strerror}") from None
    if not stored:
        raise ExchangeError(f"{path} contains no estimates: {', '.join(containers.SUFFIXES)} files")
    for name in ("estimator", "causality", "lag"):
        values = list(dict.fromkeys(getattr(one, name) for one in stored))
        if len(values) > 1 and not (name == "estimator" and path.is_dir()):
            raise ExchangeError(
                f"{path} contains estimates with the {name} {values[0]} and {values[1]}: give "
                "estimates of one estimator"
            )
    return stored


class StoredEstimates(Estimator):
    """An estimator that returns stored estimates; :func:`estimator_of` derives a class per file."""

    path: Path

    @property
    def causality(self) -> Causality:
        """Causality that the file of estimates declares."""
        return stored_runs(self.path)[0].causality

    @property
    def exact_if_linear_gaussian(self) -> bool:
        """False, because files of estimates do not declare exactness."""
        return False

    def conflict(self) -> str | None:
        """Return the reason why a noise scale other than 1 is refused; None if the scale is 1.

        The estimates are already computed, so a noise scale has no effect.
        """
        return None if self.noise_scale == 1.0 else "noise_scale changes no stored estimates"

    def estimate(self, problem: Problem, rng: np.random.Generator) -> Estimate:
        """Return the stored estimate of the run that has the measurements of a problem.

        If the file lacks states, their mean and covariance are those of the propagated prior. In
        this case the estimate has no innovations (``nis`` is NaN).

        Raises
        ------
        ExchangeError
            If no stored run has these measurements.
        """
        places = ((stored, stored.run_of(problem)) for stored in stored_runs(self.path))
        stored, run = next(((h, r) for h, r in places if r is not None), (None, None))
        if stored is None:
            parts = "; ".join(map(str, stored_runs(self.path)))
            raise ExchangeError(f"{self.path} has no run with these measurements: it has {parts}")
        n, states = problem.dimension, stored.mean.shape[2]
        mean, cov, nis = stored.mean[run], stored.cov[run], None
        if states < n:
            mean, cov = with_prior(problem, mean, cov)
            nis = np.full(problem.epochs, math.nan)
        info = {} if stored.seconds is None else {"seconds": float(stored.seconds[run])}
        return Estimate(mean, cov, stored.causality, stored.lag, info, nis)


def with_prior(
    problem: Problem, mean: np.ndarray, cov: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Extend estimates of position and velocity to all states by the propagated prior.

    ``mean`` and ``cov`` are (K, 6) and (K, 6, 6); the results are (K, n) and (K, n, n). The added
    states are uncorrelated with position and velocity.
    """
    epochs, n, states = problem.epochs, problem.dimension, mean.shape[1]
    means, covs = np.empty((epochs, n)), np.zeros((epochs, n, n))
    x, p = problem.prior_mean, problem.prior_cov
    for k in range(epochs):
        x = problem.transition[k] @ x
        p = problem.transition[k] @ p @ problem.transition[k].T + problem.process_cov[k]
        means[k], covs[k, states:, states:] = x, p[states:, states:]
    means[:, :states], covs[:, :states, :states] = mean, cov
    return means, covs


def estimator_of(path: Path) -> type[StoredEstimates]:
    """Return the class of the estimator that returns the estimates of a file.

    Raises
    ------
    ExchangeError
        As in :func:`read`.
    """
    stored = stored_runs(path)[0]
    name = path.name if path.is_dir() else stored.estimator
    space: dict[str, Any] = {"path": path, "name": name, "__module__": __name__}
    if stored.causality == "fixed-lag":
        space |= {"lag": stored.lag, "__annotations__": {"lag": float}}
    return dataclass(frozen=True)(type("StoredEstimates", (StoredEstimates,), space))
