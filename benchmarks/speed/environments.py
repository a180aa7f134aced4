"""The environments of the rivals: this one, and optional ones made on demand in build/speed/."""

from __future__ import annotations

import hashlib
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

BENCHMARKS = Path(__file__).resolve().parent.parent
OPTIONAL = ("stonesoup", "dynamax")

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMEXPR_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    # JAX takes the size of its thread pools from these, however many processors there are.
    "NPROC": "1",
    "PJRT_NPROC": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}


class EnvironmentFailed(Exception):
    """An optional environment cannot be made; the text says why."""


def variables() -> dict[str, str]:
    """Return the environment variables of every process that is timed."""
    path = os.pathsep.join(filter(None, [str(BENCHMARKS), os.environ.get("PYTHONPATH", "")]))
    return {**os.environ, **ONE_THREAD, "PYTHONPATH": path}


def existing(name: str, folder: Path) -> str | None:
    """Return the interpreter of an optional environment, or None if it is not made or outdated."""
    home = folder / name
    made = home / ".made"
    if made.exists() and made.read_text() == _stamp(name):
        return str(home / "bin" / "python")
    return None


def _stamp(name: str) -> str:
    return hashlib.sha256(_requirements(name).read_bytes() + sys.version.encode()).hexdigest()


def _requirements(name: str) -> Path:
    return BENCHMARKS / "speed" / f"{name}.txt"


def python_of(name: str, folder: Path) -> str:
    """Return the interpreter of an environment, made if it is not there yet.

    Parameters
    ----------
    name : ``""`` for the benchmark's own, or one of :data:`OPTIONAL`.
    folder : where the optional ones are made.

    Raises
    ------
    EnvironmentFailed
        If it cannot be made: no network, no wheels for this Python, no space.
    """
    if not name:
        return sys.executable
    found = existing(name, folder)
    if found:
        return found
    home = folder / name
    python = home / "bin" / "python"
    print(f"making the environment {home}", file=sys.stderr)
    shutil.rmtree(home, ignore_errors=True)
    bare = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    for command in (
        [sys.executable, "-m", "venv", str(home)],
        [
            str(python),
            *shlex.split("-m pip install --quiet --disable-pip-version-check -r"),
            str(_requirements(name)),
        ],
    ):
        try:
            done = subprocess.run(command, env=bare, capture_output=True, text=True, check=False)
        except OSError as error:
            raise EnvironmentFailed(f"its environment cannot be made: {error}") from error
        if done.returncode:
            errors = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
            reason = (errors or done.stderr.strip().splitlines() or ["no message"])[-1]
            raise EnvironmentFailed(f"its environment cannot be made: {reason}")
    (home / ".made").write_text(_stamp(name))
    return str(python)
