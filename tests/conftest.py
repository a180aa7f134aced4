"""Fixtures of several rooms, and the order of the tests.

The controller of pytest-xdist loads this file, too. Fixtures therefore import their own modules.
"""

from __future__ import annotations

import contextlib
import gc
import os
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from ggbench.simulation.error_free_flight import Flight


def pytest_configure() -> None:
    """Stop the search for cycles during collection, which it lengthens by a third.

    Accept interrupts, which a shell ignores in processes that it starts in the background.
    """
    gc.disable()
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish() -> None:
    """Search for cycles again, but not among modules and tests, which last to the end."""
    gc.freeze()
    gc.enable()


FIRST = "test_accuracy.py"
"""The file that compiles most and lasts longest."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the tests of the rooms from the ground up, but one file at once.

    Processes beside the one that compiles nearly all there is then have work that needs little of
    it; in the order of the alphabet they would wait for it.
    """
    from test_rooms import FLOORS

    rooms = [room for floor in FLOORS for room in floor]

    def place(item: pytest.Item) -> int:
        room = item.path.parent.name
        return -1 if item.path.name == FIRST else rooms.index(room) if room in rooms else len(rooms)

    items.sort(key=place)


@pytest.fixture(scope="session")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of recorded flights, which tests copy and never change."""
    from recorded_flights import written_logs

    return written_logs(tmp_path_factory.mktemp("logs"))


BROWSERS = ("chromium", "chromium-browser", "google-chrome")


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium, as the system has it; ``make browser`` installs it."""
    sync_api = pytest.importorskip("playwright.sync_api")
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        pytest.skip("there is no Chromium on the path; 'make browser' installs it")
    with sync_api.sync_playwright() as playwright:
        # The sandbox asks for rights that a container has not.
        opened = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture(scope="session")
def rough(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The path of a map of 10 E over 3 km."""
    from small_cases import rough_map

    return rough_map(tmp_path_factory.mktemp("map") / "rough.nc")


@pytest.fixture(scope="session")
def rough_gravity(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """A field of 300 E whose gravity, tens of mGal, is felt along a flight."""
    from small_cases import rough_map

    path = rough_map(tmp_path_factory.mktemp("map") / "rough.nc", rms=300.0)
    return {"field": {"source": path, "gravity_disturbance": True}}


@pytest.fixture(scope="session")
def wang() -> Flight:
    """The paper's flight: 200 s to the east over the Qinling map, readings filtered at 1 Hz."""
    from paper_flights import flight

    return flight("0.01E-1Hz")


@pytest.fixture(scope="session")
def wang_unfiltered() -> Flight:
    from paper_flights import flight

    return flight("0.01E-1Hz-unfiltered")


@pytest.fixture
def started() -> Iterator[Callable[..., subprocess.Popen]]:
    """Start commands, none of which outlives the test."""
    processes = []

    def start(cwd: Path, arguments: list[str]) -> subprocess.Popen:
        processes.append(
            subprocess.Popen(
                arguments,
                cwd=cwd,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                start_new_session=True,
            )
        )
        return processes[-1]

    yield start
    for process in processes:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        process.stderr.close()
