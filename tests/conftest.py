"""What several tests need: the paper's flights, oracles for frames and for the mechanization."""

from __future__ import annotations

import contextlib
import functools
import gc
import os
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles import points

from ggbench.gravity import ellipsoid
from ggbench.numerics import rotations
from ggbench.simulation.error_free_flight import Flight, prepare
from ggbench.spec import scenario


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


# Central difference of sixth order: offsets in steps, and weights per step.
OFFSETS = np.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0])
WEIGHTS = np.array([-1.0, 9.0, -45.0, 45.0, -9.0, 1.0]) / 60.0


def difference(function: Callable[[float], np.ndarray], step: float) -> np.ndarray:
    """Derivative at 0 of a function of one number, exact for polynomials of degree 6."""
    return (
        sum(w * np.asarray(function(o * step)) for o, w in zip(OFFSETS, WEIGHTS, strict=True))
        / step
    )


def local_axes(latitude: float, longitude: float) -> np.ndarray:
    """C_en (3, 3): columns are east, north and up in Earth-fixed axes."""
    up = np.array(
        [
            np.cos(latitude) * np.cos(longitude),
            np.cos(latitude) * np.sin(longitude),
            np.sin(latitude),
        ]
    )
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    return np.stack([east, np.cross(up, east), up], axis=-1)


def ecef(position: np.ndarray) -> np.ndarray:
    """Earth-fixed Cartesian coordinates of (latitude, longitude, height)."""
    latitude, longitude, height = position
    up = local_axes(latitude, longitude)[:, 2]
    a2, b2 = (
        ellipsoid.SEMI_MAJOR_AXIS**2,
        (ellipsoid.SEMI_MAJOR_AXIS * (1.0 - ellipsoid.FLATTENING)) ** 2,
    )
    # The point of the ellipsoid whose normal is ``up``: gradient of x²/a² + y²/a² + z²/b² along it.
    scaled = up * np.array([a2, a2, b2])
    return scaled / np.sqrt(up @ scaled) + height * up


def metres(position: np.ndarray) -> np.ndarray:
    """(3, 3): displacement ENU [m] = metres @ (dL, dλ, dh), from the Cartesian coordinates."""
    columns = [
        difference(lambda d, axis=axis: ecef(position + d * np.eye(3)[axis]), step)
        for axis, step in enumerate((1e-2, 1e-2, 1e3))
    ]
    return local_axes(position[0], position[1]).T @ np.stack(columns, axis=-1)


def square(tensor: np.ndarray) -> np.ndarray:
    """Symmetric (3, 3) matrix of [xx, xy, xz, yy, yz, zz]."""
    return np.asarray(tensor)[np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])]


def third_derivatives(tensor: np.ndarray, derivative: np.ndarray, position: np.ndarray):
    """(3, 3, 3) third derivatives of the potential, in axes that do *not* move with the point.

    ``derivative`` (6, 3) is of the components in moving ENU axes, per metre east, north and up.
    """
    latitude, longitude, _ = position
    to_local = local_axes(latitude, longitude).T
    per_radian = metres(position)
    out = np.empty((3, 3, 3))
    for axis in range(3):
        d_latitude, d_longitude, _ = np.linalg.solve(per_radian, np.eye(3)[axis])
        turn = to_local @ (
            d_latitude * difference(lambda d: local_axes(latitude + d, longitude), 1e-2)
            + d_longitude * difference(lambda d: local_axes(latitude, longitude + d), 1e-2)
        )
        moved = turn @ square(tensor)
        out[:, :, axis] = square(derivative[:, axis]) + moved + moved.T
    return out


def cross_matrix(vector: np.ndarray) -> np.ndarray:
    """[v×]."""
    return np.cross(vector, np.eye(3), axisb=0, axisc=0)


def mechanization_jacobian(
    position: np.ndarray,
    velocity: np.ndarray,
    c_nb: np.ndarray,
    force: np.ndarray,
    rate: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """F (15, 15) in (δL, δλ, δh), δv, φ, ε, ∇ by finite differences of the mechanization's rates.

    The rates at an indicated state minus those at the true state, where indicated = true + error,
    C̃_nb = (I − [φ×]) C_nb and measured = true + bias. ``force`` and ``rate`` are f^b and ω_ib^b.

    Returns the matrix and an upper bound of its rounding error.
    """

    def rates(error: np.ndarray) -> np.ndarray:
        out = np.zeros((3, 3))
        here, moving = position + error[0:3], velocity + error[3:6]
        turn = np.empty((3, 3))
        rotations.rotation_matrix(-error[6:9], turn)
        attitude = turn @ c_nb
        points.position_rate(here, moving, out[0])
        points.velocity_rate(here, moving, attitude @ (force + error[12:15]), out[1])
        points.attitude_rate(here, moving, attitude, rate + error[9:12], out[2])
        # C_nb C̃_nbᵀ = exp([φ×]) = E, so E' = [ω×] E − E [ω̃×], whose skew part is [φ'×].
        skew = cross_matrix(true_rate) @ turn.T - turn.T @ cross_matrix(out[2])
        out[2] = 0.5 * np.array(
            [skew[2, 1] - skew[1, 2], skew[0, 2] - skew[2, 0], skew[1, 0] - skew[0, 1]]
        )
        return out.ravel()

    true_rate = np.zeros(3)
    points.attitude_rate(position, velocity, c_nb, rate, true_rate)
    steps = np.repeat([1e-3, 1.0, 1e-2, 1e-5, 1e-1], 3)
    steps[2] = 1e3
    jacobian = np.zeros((15, 15))
    for column in range(15):
        jacobian[:9, column] = difference(
            lambda d, c=column: rates(d * np.eye(15)[c]), steps[column]
        )
    # Numbers that are added up in a rate: v/R, gravity and specific force, angular rate.
    largest = np.repeat([1e-4, 10.0 + np.linalg.norm(force), 2e-3 + np.linalg.norm(rate)], 3)
    largest[2] = 300.0
    rounding = np.zeros((15, 15))
    rounding[:9] = 8.0 * np.finfo(float).eps * largest[:, None] / steps
    return jacobian, rounding


@functools.cache
def flight(name: str) -> Flight:
    """The flight of a case of the paper, made once."""
    return prepare(scenario.load("wang2013").case(name))


@pytest.fixture(scope="session")
def wang() -> Flight:
    """The paper's flight: 200 s to the east over the Qinling map, readings filtered at 1 Hz."""
    return flight("0.01E-1Hz")


@pytest.fixture(scope="session")
def wang_unfiltered() -> Flight:
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
