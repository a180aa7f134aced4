"""Environments of the compared packages: this one, and optional ones in build/speed/."""

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
    # JAX takes the sizes of its thread pools from these, for any number of processors.
    "NPROC": "1",
    "PJRT_NPROC": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}


class EnvironmentFailed(Exception):
    """An optional environment cannot be created; the message states the reason."""


def variables() -> dict[str, str]:
    """Return the environment variables of all timed processes."""
    path = os.pathsep.join(filter(None, [str(BENCHMARKS), os.environ.get("PYTHONPATH", "")]))
    return {**os.environ, **ONE_THREAD, "PYTHONPATH": path}


def existing(name: str, folder: Path) -> str | None:
    """Return the interpreter of an optional environment; None if it is missing or outdated."""
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
    """Return the interpreter of an environment; create the environment if necessary.

    Parameters
    ----------
    name : ``""`` for the present environment, or a name in :data:`OPTIONAL`.
    folder : parent folder of the optional environments.

    Raises
    ------
    EnvironmentFailed
        If the environment cannot be created: no network, no wheels for this Python, no space.
    """
    if not name:
        return sys.executable
    found = existing(name, folder)
    if found:
        return found
    home = folder / name
    python = home / "bin" / "python"
    print(f"creating the environment {home}", file=sys.stderr)
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
            raise EnvironmentFailed(f"its environment cannot be created: {error}") from error
        if done.returncode:
            errors = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
            reason = (errors or done.stderr.strip().splitlines() or ["no message"])[-1]
            raise EnvironmentFailed(f"its environment cannot be created: {reason}")
    (home / ".made").write_text(_stamp(name))
    return str(python)
