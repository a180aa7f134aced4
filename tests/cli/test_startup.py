"""What a command loads: a package that takes a tenth of a second or more only where it is used."""

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
_LOADED = "\nimport sys; print('loaded:', *sys.modules)"


def loaded_by(*arguments: str) -> set[str]:
    """Return the modules that a process has loaded at the end of a command."""
    return loaded(
        f"from ggbench.cli.main import main; main({list(arguments)}, standalone_mode=False)",
    )


def loaded(code: str) -> set[str]:
    caught = f"try:\n    {code}\nexcept SystemExit as end:\n    assert not end.code"
    output = subprocess.run(
        [sys.executable, "-c", caught + _LOADED], capture_output=True, text=True, check=True
    ).stdout
    return set(output.rpartition("loaded:")[2].split())


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["map", "build", "--help"]])
def test_help_needs_no_numbers(arguments):
    """Help comes at once: it loads neither NumPy nor anything that stands on it."""
    everything = NUMBERS | FIGURES | FILES | TABLES | ESTIMATION
    assert not loaded_by(*arguments) & everything


def test_the_package_itself_needs_no_numbers():
    """Its public names are there to be listed, and are loaded when they are used."""
    everything = NUMBERS | FIGURES | FILES | TABLES | ESTIMATION
    assert not loaded("import ggbench; assert 'run' in dir(ggbench); ggbench.maps") & everything
    assert not loaded("import ggbench; ggbench.run, ggbench.Results") & (FIGURES | ESTIMATION)


def test_a_list_needs_no_filters_and_no_tables():
    """What estimators are is told without filterpy, whose import takes longer than the list."""
    found = loaded_by("list")
    assert "ggbench.estimators.ekf" in found
    assert not found & (FIGURES | FILES | TABLES | STATISTICS | {"filterpy"})


def test_a_run_loads_the_estimator_that_was_asked_for():
    """One run of one filter needs no other estimator's library, no tables and no figures."""
    found = loaded_by("run", "wang2013", "--run", "0", "-c", "0.01E-1Hz-unfiltered", "-e", "ekf")
    assert "filterpy" in found
    assert not found & (FIGURES | FILES | TABLES | {"gtsam", "scipy.signal"})


def test_a_worker_starts_without_what_its_tasks_may_not_need():
    """A campaign starts many workers; what they import before their first task is the least."""
    found = loaded("import ggbench.campaign.runner")
    assert "ggbench.judging.run_errors" in found
    assert "ggbench.judging.summary" not in found
    assert not found & (FIGURES | FILES | TABLES | STATISTICS | ESTIMATION)
