"""Modules that a command loads: slow packages only where they are used."""

from __future__ import annotations

import subprocess
import sys

import pytest

FIGURES = {"matplotlib"}
FILES = {"netCDF4", "rasterio", "xarray", "h5netcdf"}
TABLES = {"pandas", "pyarrow"}
STATISTICS = {"scipy.stats", "scipy.signal"}
ESTIMATION = {"filterpy", "gtsam"}
NUMBERS = {"numpy", "scipy", "numba", "pydantic"}
HELP = (["--help"], ["run", "--help"], ["map", "build", "--help"])
RUN = "command(['run', 'wang2013', '--run', '0', '-c', '0.01E-1Hz-unfiltered', '-e', 'ekf'])"
STEPS = {
    "help": "\n".join(f"command({arguments})" for arguments in HELP),
    "package": "import ggbench; assert 'run' in dir(ggbench); ggbench.maps",
    "worker": "import ggbench.campaign.runner",
    "list": "command(['list'])",
}
"""Code of one process, step by step: each loads more than the one before."""
LATER = {"run": RUN, "name": "import ggbench; ggbench.run, ggbench.Results"}
"""The same of another process."""
COMMAND = """
import sys
from ggbench.cli.main import main

def command(arguments):
    try:
        main(arguments, standalone_mode=False)
    except SystemExit as end:
        assert not end.code
"""
_LOADED = "\nprint('loaded:', *sys.modules)\n"


def loaded(*steps: str) -> list[set[str]]:
    """Return the modules that a process has loaded after each of some steps."""
    code = COMMAND + _LOADED.join((*steps, ""))
    output = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    lines = [line for line in output.splitlines() if line.startswith("loaded: ")]
    return [set(line.split()) for line in lines]


@pytest.fixture(scope="module")
def after() -> dict[str, set[str]]:
    """What is loaded after each step."""
    return dict(zip(STEPS, loaded(*STEPS.values()), strict=True))


@pytest.fixture(scope="module")
def later() -> dict[str, set[str]]:
    return dict(zip(LATER, loaded(*LATER.values()), strict=True))


@pytest.mark.parametrize("step", ["help", "package"])
def test_help_and_the_package_need_no_numbers(step, after):
    """Help comes at once, and public names are loaded when they are used."""
    assert not after[step] & (NUMBERS | FIGURES | FILES | TABLES | ESTIMATION)


@pytest.mark.long
def test_a_name_of_the_package_loads_only_its_own(later):
    assert not later["name"] & (FIGURES | ESTIMATION)


def test_a_list_needs_no_filters_and_no_tables(after):
    """Estimators are described without filterpy, whose import takes longer than the list."""
    assert "ggbench.estimators.ekf" in after["list"]
    assert not after["list"] & (FIGURES | FILES | TABLES | STATISTICS | {"filterpy"})


@pytest.mark.long
def test_a_run_loads_only_the_estimator_that_was_asked_for(later):
    """One run of one filter needs no framework, no tables and no figures; its map is netCDF."""
    assert "ggbench.estimators.ekf" in later["run"]
    assert not later["run"] & (FIGURES | (FILES - {"netCDF4"}) | TABLES | ESTIMATION)


def test_a_worker_starts_without_what_its_tasks_may_not_need(after):
    """A campaign starts many workers; what they import before their first task is the least."""
    assert "ggbench.judging.run_errors" in after["worker"]
    assert "ggbench.judging.summary" not in after["worker"]
    assert not after["worker"] & (FIGURES | FILES | TABLES | STATISTICS | ESTIMATION)
