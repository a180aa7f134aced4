"""External programs as estimators: the program reads a problem file and writes estimates.

The estimator ``exec:PROGRAM`` runs ``PROGRAM PROBLEM ESTIMATES`` once for each block of runs, where
``PROBLEM`` and ``ESTIMATES`` are paths of files.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..block import BlockEstimator, EstimateBlock, ProblemBlock
from ..problem import Causality
from . import PROGRAM, estimate_files, problem_files
from .containers import ExchangeError

_LONGEST_OUTPUT = 2000
_PIECE = 1 << 16
_LAST_WORDS_S = 1.0


@dataclass(frozen=True)
class ExternalProgram(BlockEstimator):
    """An external program as an estimator; :func:`estimator_of` derives a class per program.

    Parameters
    ----------
    format : format of both files: ``mat`` (MATLAB 5), ``nc`` (netCDF-4) or ``txt`` (plain text).
    causes : causality that the program declares in the file of estimates.
    """

    format: Literal["mat", "nc", "txt"] = field(default="mat", kw_only=True)
    causes: Literal["filter", "batch"] = field(default="filter", kw_only=True)

    name = "program"
    path = Path()

    @property
    def causality(self) -> Causality:
        """Causality of the estimates, which the user states as parameter ``causes``."""
        return self.causes

    @property
    def exact_if_linear_gaussian(self) -> bool:
        """False, because programs do not declare exactness."""
        return False

    def estimate_block(
        self, block: ProblemBlock, rngs: Sequence[np.random.Generator] = ()
    ) -> EstimateBlock:
        """Write a problem file, run the program, and read the file of estimates.

        Raises
        ------
        ExchangeError
            If the program cannot be started, or its exit code is not 0. If it writes no estimates
            of this problem, or if their causality differs from ``causes``.
        """
        facts = {
            "scenario": "-",
            "case": "-",
            "seed": 0,
            "key": "-",
            "runs": list(range(block.runs)),
            "states": block.dimension,
            "times": block.times.tolist(),
        }
        with tempfile.TemporaryDirectory(prefix="ggbench-") as folder:
            problem, estimates = (
                Path(folder) / f"{name}.{self.format}" for name in ("problem", "estimates")
            )
            identity = problem_files.identity(facts, block)
            problem_files.write(problem, block, identity)
            self._start(problem, estimates)
            if not estimates.exists():
                raise ExchangeError(
                    f"{self.path} ended without writing the file of estimates, whose path is its "
                    "second argument"
                )
            stored = estimate_files.read(estimates)
        if stored.causality != self.causes:
            raise ExchangeError(
                f"{self.path} wrote estimates of causality '{stored.causality}', but "
                f"'{self.causes}' is declared"
            )
        if not np.array_equal(
            stored.problem["fingerprints"], problem_files.fingerprints(block.measurements)
        ):
            raise ExchangeError(f"{self.path} wrote estimates of another problem")
        mean, cov, nis = stored.mean, stored.cov, None
        if mean.shape[2] < block.dimension:
            pairs = [
                estimate_files.with_prior(block.problem(run), mean[run], cov[run])
                for run in range(block.runs)
            ]
            mean, cov = (np.stack(arrays) for arrays in zip(*pairs, strict=True))
            nis = np.full(mean.shape[:2], np.nan)
        counts = np.zeros(block.runs, dtype=np.int64)
        return EstimateBlock(mean, cov, self.causes, nis=nis, info={"map_evaluations": counts})

    def _start(self, problem: Path, estimates: Path) -> None:
        program = str(self.path if self.path.is_absolute() else Path.cwd() / self.path)
        try:
            process = subprocess.Popen(
                [program, str(problem), str(estimates)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
            )
        except OSError as error:
            raise ExchangeError(f"{self.path} cannot be started: {error.strerror}") from None
        last_output = _LastOutput(process.stdout)
        code = process.wait()
        # Children that it has left may hold its output open: they are not waited for.
        last_output.join(_LAST_WORDS_S)
        if code:
            how = f"exit code {code}" if code > 0 else f"signal {-code}"
            words = last_output.text
            raise ExchangeError(f"{self.path} ended with {how}" + (f": {words}" if words else ""))


class _LastOutput(threading.Thread):
    """Last part of the output of a program, read while the program runs."""

    def __init__(self, stream: Any) -> None:
        super().__init__(daemon=True)
        self._stream, self._kept = stream, b""
        self.start()

    def run(self) -> None:
        """Read the output until the program closes it."""
        with self._stream:
            while piece := self._stream.read1(_PIECE):
                self._kept = (self._kept + piece)[-_LONGEST_OUTPUT:]

    @property
    def text(self) -> str:
        """Last part of the output as text."""
        return self._kept.decode(errors="replace").strip()


def estimator_of(text: str) -> type[ExternalProgram]:
    """Return the class of the estimator for a text ``exec:PROGRAM``.

    Raises
    ------
    ExchangeError
        If the program does not exist or cannot be executed.
    """
    path = Path(text.removeprefix(PROGRAM))
    if not path.is_file():
        raise ExchangeError(f"{text}: program {path} not found")
    if not os.access(path, os.X_OK):
        raise ExchangeError(f"{text}: {path} cannot be executed; set its x bit (chmod +x)")
    space: dict[str, Any] = {"path": path, "name": f"{PROGRAM}{path.name}", "__module__": __name__}
    return dataclass(frozen=True)(type("ExternalProgram", (ExternalProgram,), space))
