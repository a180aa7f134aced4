"""`ggbench bound` as a user meets it: a shipped scenario, a track of one's own, bad input."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
from command import invoke
from matplotlib.image import imread
from problems import SMALL
from small_cases import rough_map, small_case

from ggbench.judging.planned import AXES, planned
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.flight_bounds import flight_bound

TRACK = "time_s,latitude_deg,longitude_deg,height_m\n" + "".join(
    f"{t},{33.5 + 2e-5 * t},{108.0 + 1e-3 * t},10000\n" for t in range(0, 41, 2)
)
OWN = re.sub(
    r"\[trajectory\].*?(?=\[imu\])", '[trajectory]\nfile = "plan.csv"\n\n', SMALL, flags=re.DOTALL
).replace('source = "normal"', 'source = "rough.nc"')


def test_the_table_is_the_bound_of_the_flight(tmp_path):
    (tmp_path / "own.toml").write_text(SMALL, encoding="utf-8")
    command = ["bound", "own.toml", "-o", "out/b.csv", "--figure", "out/b.png"]
    done = invoke(command, tmp_path, columns=120)
    assert done.returncode == 0, done.stderr
    assert "bound of the position and of the velocity" in done.stdout
    table = pd.read_csv(tmp_path / "out" / "b.csv")
    flight = prepare(small_case())
    assert len(table) == len(flight.times)
    variances = np.diagonal(flight_bound(flight).filtering, axis1=1, axis2=2)
    for unit, first in (("m", 0), ("mps", 3)):
        found = table[[f"{axis}_{unit}" for axis in AXES]].to_numpy() ** 2
        np.testing.assert_allclose(found, variances[:, first : first + 3], rtol=1e-6)
    np.testing.assert_allclose(table["position_m"] ** 2, variances[:, :3].sum(axis=1), rtol=1e-6)
    at = np.degrees(flight.motion_at_epochs.positions[:, :2])
    np.testing.assert_allclose(table[["latitude_deg", "longitude_deg"]], at, rtol=1e-7)
    # What is known later never harms, and at the end nothing is.
    assert (table["position_smoothed_m"] <= table["position_m"] * (1.0 + 1e-6)).all()
    assert table["position_smoothed_m"].iloc[-1] == table["position_m"].iloc[-1]
    # Without a rule below: an empty line, then what was written.
    shown = float(done.stdout.splitlines()[-2 - done.stdout.count("Wrote")].split()[4])
    assert shown == pytest.approx(table["position_m"].iloc[-1], rel=1e-2)
    assert imread(tmp_path / "out" / "b.png").shape[1] > 800


def test_less_noise_is_a_smaller_bound():
    better = planned(prepare(small_case({"gradiometer.noise_eotvos": 1e-3})))
    worse = planned(prepare(small_case({"gradiometer.noise_eotvos": 1.0})))
    for name in ("position_m", "velocity_mps"):
        assert better[name].iloc[-1] < worse[name].iloc[-1]


@pytest.mark.long
def test_a_track_and_a_map_of_ones_own(tmp_path):
    """Along the track that the user plans, over the user's map, with any name of a case."""
    rough_map(tmp_path / "rough.nc")
    (tmp_path / "plan.csv").write_text(TRACK, encoding="utf-8")
    (tmp_path / "own.toml").write_text(OWN, encoding="utf-8")
    done = invoke(["bound", "own.toml", "-c", "base", "-o", "b.csv", "--figure", "b.png"], tmp_path)
    assert done.returncode == 0, done.stderr
    table = pd.read_csv(tmp_path / "b.csv")
    np.testing.assert_allclose(table["longitude_deg"], 108.0 + 1e-3 * table["time_s"], atol=1e-6)
    assert imread(tmp_path / "b.png").shape[1] > 800


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["nosuch"], "nosuch"),
        (["wang2013", "-c", "nosuch"], "no case 'nosuch'"),
        (["wang2013", "-o", "b.txt"], "b.txt must be named *.csv"),
        (["wang2013", "--figure", "b.svg"], "b.svg must be named *.png"),
    ],
)
def test_what_cannot_be_planned_is_said_in_a_sentence(tmp_path, words, sentence):
    done = invoke(["bound", *words], tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("ggbench: ")
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.count("\n") == 1
