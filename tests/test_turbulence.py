"""The tracks of the scenario ``turbulence``, and the noise that follows from them."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from turbulence import INTENSITIES
from turbulence.vibration import amplitudes, flown, noise

from ggbench.spec import scenario

DATA = Path(__file__).parents[1] / "scenarios" / "data"


def committed(intensity: str) -> Path:
    return DATA / f"turbulence_{intensity}.csv"


@pytest.fixture(scope="module")
def flying() -> ModuleType:
    pytest.importorskip("jsbsim")
    return importlib.import_module("turbulence.flying")


@pytest.mark.parametrize(
    "intensity",
    [
        pytest.param(name, marks=() if name == "severe" else pytest.mark.long)
        for name in INTENSITIES
    ],
)
def test_the_tracks_are_what_jsbsim_flies(intensity: str, flying: ModuleType) -> None:
    kept = np.loadtxt(committed(intensity), delimiter=",", skiprows=1)
    assert committed(intensity).read_text().splitlines()[0] == ",".join(flying.COLUMNS)
    # Fewer than all: processors round differently, and gusts are not chaos but grow old.
    again = flying.track(intensity, 30.0)
    size = np.array([1e-9, 1e-8, 1e-8, 1e-3, 1e-2, 1e-2, 1e-2])
    assert np.all(np.abs(kept[: len(again)] - again) <= size)


@pytest.mark.long
def test_other_gusts_make_another_track(flying: ModuleType) -> None:
    kept = np.loadtxt(committed("light"), delimiter=",", skiprows=1)
    assert np.abs(kept[:301, 3] - flying.track("light", 30.0, seed=1)[:, 3]).max() > 1.0


def test_intensities_are_told_apart() -> None:
    rms = [float(np.sqrt((amplitudes(str(committed(i))) ** 2).mean())) for i in INTENSITIES]
    assert rms[0] < 0.01 * rms[1]
    assert rms[1] < 0.8 * rms[2] < 0.5 * rms[3]


@pytest.mark.long
@pytest.mark.parametrize("intensity", ["moderate", "severe"])
def test_the_noise_of_vibrating_disks_is_that_of_the_track(intensity: str) -> None:
    """The scenario has the figure of the study, to its last digit, with the noise at rest.

    Of 100 disks about each axis, which differ by ten times: the root is known to some 5 %.
    """
    loaded = scenario.load("turbulence")
    at_rest = loaded.case("calm").side("truth").gradiometer
    assert at_rest is not None and at_rest.noise_eotvos is not None
    found = float(np.hypot(at_rest.noise_eotvos, noise(amplitudes(str(committed(intensity))))))
    case = loaded.case(f"{intensity}-vibration")
    told = case.side("truth").gradiometer
    assert told is not None and told.noise_eotvos == round(found, 1)
    assert f"noise of {told.noise_eotvos:g} E" in case.title
    others = ["severe-vibration-known", "severe-all"] if intensity == "severe" else []
    for name in others:
        other = loaded.case(name).side("truth").gradiometer
        assert other is not None and other.noise_eotvos == told.noise_eotvos


@pytest.mark.long
def test_amplitudes_are_those_of_the_spectral_density(tmp_path: Path) -> None:
    """A level flight that heaves with a known density; 24 degrees of freedom at each frequency."""
    rate, duration = 50.0, 300.0
    times = np.arange(0.0, duration, 1.0 / rate)
    rng = np.random.default_rng(8)
    frequency = np.arange(0.2, 6.0, 0.01)
    density = 0.5  # [(m/s²)²/Hz], one-sided
    size = np.sqrt(2.0 * density * 0.01) / (2.0 * np.pi * frequency) ** 2
    phase = rng.uniform(0.0, 2.0 * np.pi, len(frequency))
    heave = (size * np.cos(2.0 * np.pi * frequency * times[:, np.newaxis] + phase)).sum(axis=1)
    columns = [times, 36.3 + 0.0 * times, -84.3 + 5e-4 * times, 1280.0 + heave]
    path = tmp_path / "heaving.csv"
    np.savetxt(
        path,
        np.stack(columns, axis=-1),
        fmt="%.12f",
        delimiter=",",
        comments="",
        header="time_s,latitude_deg,longitude_deg,height_m",
    )
    found = amplitudes(str(path))[:, 2]
    # Three means of some 60 squares of noise: beyond 35 % once in 10⁴.
    assert found == pytest.approx(np.full(3, np.sqrt(2.0 * density)), rel=0.35)


def test_the_data_are_described_as_they_are() -> None:
    """The table of accelerations, rolls and heights."""
    rows = {}
    for line in (DATA / "README.md").read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if cells[0] in INTENSITIES:
            rows[cells[0]] = [float(x) for cell in cells[1:] for x in re.findall(r"[\d.]+", cell)]
    assert set(rows) == set(INTENSITIES)
    for intensity, numbers in rows.items():
        acceleration = flown(str(committed(intensity)))
        track = np.loadtxt(committed(intensity), delimiter=",", skiprows=1)
        found = [
            *np.sqrt((acceleration**2).mean(axis=0)),
            np.abs(acceleration[:, 2]).max(),
            np.abs(track[:, 6]).max(),
            track[:, 3].min(),
            track[:, 3].max(),
        ]
        assert numbers == pytest.approx(found, abs=0.051, rel=0.0005)
