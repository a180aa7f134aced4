"""The tracks of the scenario ``turbulence``, and the noise that follows from them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from turbulence.flying import COLUMNS, INTENSITIES, track
from turbulence.vibration import ISOLATION, amplitudes, noise

from ggbench.spec import scenario

DATA = Path(__file__).parents[1] / "scenarios" / "data"


def committed(intensity: str) -> Path:
    return DATA / f"turbulence_{intensity}.csv"


@pytest.mark.parametrize("intensity", INTENSITIES)
def test_the_tracks_are_what_jsbsim_flies(intensity: str) -> None:
    kept = np.loadtxt(committed(intensity), delimiter=",", skiprows=1)
    assert committed(intensity).read_text().splitlines()[0] == ",".join(COLUMNS)
    # Fewer than all: processors round differently, and gusts are not chaos but grow old.
    flown = track(intensity, 30.0)
    size = np.array([1e-9, 1e-8, 1e-8, 1e-3, 1e-2, 1e-2, 1e-2])
    assert np.all(np.abs(kept[: len(flown)] - flown) <= size)


def test_other_gusts_make_another_track() -> None:
    kept = np.loadtxt(committed("light"), delimiter=",", skiprows=1)
    assert np.abs(kept[:301, 3] - track("light", 30.0, seed=1)[:, 3]).max() > 1.0


def test_intensities_are_told_apart() -> None:
    rms = [float(np.sqrt((amplitudes(str(committed(i))) ** 2).mean())) for i in INTENSITIES]
    assert rms[0] < 0.01 * rms[1]
    assert rms[1] < 0.8 * rms[2] < 0.5 * rms[3]


@pytest.mark.parametrize("intensity", ["moderate", "severe"])
def test_the_noise_of_vibrating_disks_is_that_of_the_track(intensity: str) -> None:
    """Of 600 variances; their spread between seeds is 5 % of the root."""
    _, case = scenario.load("turbulence").find(f"{intensity}-vibration")
    told = case.side("truth").gradiometer
    assert told is not None and told.noise_eotvos is not None
    declared = case.side("model").gradiometer
    assert declared is not None and declared.noise_eotvos is not None
    found = np.hypot(declared.noise_eotvos, noise(amplitudes(str(committed(intensity)))))
    assert told.noise_eotvos == pytest.approx(found, rel=0.15)


def test_vibrations_that_are_isolated_better_make_less_noise() -> None:
    size = amplitudes(str(committed("severe")))
    assert noise(0.1 * size, 20) == pytest.approx(0.1 * noise(size, 20), rel=1e-6)
    assert ISOLATION < 1.0
