"""Fingerprints of every estimator on short flights: a change of numbers is a decision.

``make golden`` writes ``golden.json``.
"""

from __future__ import annotations

import functools
import json
import math
import tempfile
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_cases import rough_map

from ggbench.campaign import registry, result_keys
from ggbench.campaign.flights import case_bounds, flight_of
from ggbench.campaign.runner import Task, run_task
from ggbench.results.database import Result
from ggbench.simulation.runs import simulate
from ggbench.spec import scenario
from ggbench.spec.case import CaseSpec
from ggbench.spec.toml_files import strip_provenance

FOLDER = tempfile.TemporaryDirectory()
GOLDEN = Path(__file__).with_name("golden.json")
TOLERANCE = 5e-6
"""Relative. Rounding, as of another processor, has a search stop a step earlier: 1e-6 at most."""
SEED = 36
CASES = {
    "wang2013/0.01E-1Hz": 20.0,
    "jacksboro_drone/5E": 20.0,
    "outliers/outliers-20pc": 20.0,
    "wide_prior/1km": 20.0,
    "gnss_outage/all": 600.0,
    "ship_strategic/states": 600.0,
}
"""Scenario and case, and how long it flies [s]: over one map of a random field."""
COSTLY = ("factor-graph", "gauss-newton", "gaussian-sum", "viterbi")
"""Estimators that take long to compile, or to run; so do variants."""
VARIANTS = (
    "ekf[iterations=5]",
    "ekf[loss=cauchy]",
    "ekf[gate=0.99]",
    "ekf[noise_memory=10]",
    "ukf[points=merwe,loss=huber]",
    "factor-graph[mode=fixed-lag]",
    "factor-graph[mode=batch]",
)
LABELS = (*registry.registered(), *VARIANTS)
CLOUDS = ("gaussian-particle", "particle", "rao-blackwellised")
"""Estimators that fly with fewer particles than they have by default."""
CLOUDED = ("wide_prior/1km", "jacksboro_drone/5E")
"""Cases that they fly. Elsewhere few particles survive: rounding decides which (of 1 E and less).

Measured: on a second processor `particle` had other numbers on `wang2013/0.01E-1Hz`.
"""
TOO_LARGE = ("gnss_outage/all", "viterbi")
"""Its cells are as small as the fixes of the receiver are sure: too many."""
RENEW = (
    "the numbers of estimators have changed. If they should have, raise RESULTS_VERSION in "
    "ggbench/campaign/result_keys.py, run 'make golden', and fly the library again: 'make library'"
)


@functools.cache
def case_of(name: str) -> CaseSpec:
    """A case of a shipped scenario, cut to its beginning and taken to another place."""
    of, case = name.split("/")
    document = strip_provenance(tomllib.loads(scenario.load(of).source), "", {}, of)
    for key in ("notes", "assumption", "claim", "comparison", "campaign"):
        document.pop(key, None)
    document["case"] = [change for change in document["case"] if change["name"] == case]
    document["field"] = {"source": rough_map(Path(FOLDER.name) / "map.nc")}
    document["field"]["gravity_disturbance"] = True
    track = {key: document["trajectory"][key] for key in ("speed_mps", "heading_deg")}
    track |= {"latitude_deg": 33.5, "longitude_deg": 108.0, "height_m": 1e4}
    track["segment"] = [{"kind": "cruise", "duration_s": CASES[name]}]
    document["trajectory"] = track
    document["windows"] = {"settled_from_s": CASES[name] / 2.0, "last_s": CASES[name] / 4.0}
    return scenario.parse(document, of, of).cases[0]


def fingerprint(name: str, label: str) -> list[float | None] | str:
    """RMS errors of position and velocity, mean NEES and NIS, and the final σ of position.

    Or that an estimator refuses the case, or fails.
    """
    flown = f"{label}[particles=500]" if label in CLOUDS else label
    case, choice = case_of(name), registry.choose(flown)
    left_out = (name, label) == TOO_LARGE or (label in CLOUDS and name not in CLOUDED)
    if left_out or choice.estimator.skip(simulate(flight_of(case), SEED, 0)[0]):
        return "refused"
    key = result_keys.run_key(case, choice.content, SEED)
    task = Task(case, "", (0,), SEED, ((flown, key),))
    (result,) = next(step for step in run_task(task) if not hasattr(step, "label"))
    assert isinstance(result, Result)
    record = result.record
    if record["status"] != "ok":
        return "failed"
    assert result.detail is not None
    sigma = float(np.linalg.norm(result.detail[-1, 6:9]))
    numbers = math.sqrt(record["whole_position_ms"]), math.sqrt(record["whole_velocity_ms"])
    return [
        None if math.isnan(number) else float(f"{number:.12g}")
        for number in (*numbers, record["whole_nees"], record["whole_nis"], sigma)
    ]


def same(one: Any, two: Any) -> bool:
    """Whether two fingerprints agree."""
    if isinstance(one, list) and isinstance(two, list):
        return len(one) == len(two) and all(map(same, one, two))
    if isinstance(one, float) and isinstance(two, float):
        return math.isclose(one, two, rel_tol=TOLERANCE)
    return bool(one == two)


def differences(name: str, wanted: list[str], held: dict[str, Any]) -> dict[str, Any]:
    """Fingerprints that differ from those held: (held, found)."""
    found = {label: fingerprint(name, label) for label in wanted}
    pairs = {label: (held.get(label), number) for label, number in found.items()}
    return {label: pair for label, pair in pairs.items() if not same(*pair)}


def of(costly: bool) -> list[str]:
    return [label for label in LABELS if (label in VARIANTS or label in COSTLY) == costly]


@functools.cache
def golden() -> dict[str, dict[str, Any]]:
    return json.loads(GOLDEN.read_text())


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("costly", [False, pytest.param(True, marks=pytest.mark.long)])
def test_numbers_are_those_of_this_version_of_results(name, costly):
    assert differences(name, of(costly), golden()[name]) == {}, RENEW
    bound = [case_bounds([case_of(name).of_run(0)])[0].final_m]
    assert same(bound, golden()[name]["bound"]), RENEW


def test_every_estimator_has_a_fingerprint_and_no_other():
    assert set(golden()) == set(CASES)
    for name in CASES:
        assert set(golden()[name]) == {"bound", *LABELS}, "run 'make golden'"
        assert isinstance(golden()[name]["ins"], list)


def test_a_change_of_a_hundred_thousandth_is_found():
    """In any number of a fingerprint; rounding is none."""
    name, held = "wang2013/0.01E-1Hz", golden()["wang2013/0.01E-1Hz"]["ins"]
    assert differences(name, ["ins"], {"ins": held}) == {}
    for place, number in enumerate(held):
        if number is not None:
            moved = [*held[:place], number * (1.0 + 1e-5), *held[place + 1 :]]
            assert set(differences(name, ["ins"], {"ins": moved})) == {"ins"}
    assert same([1.0, None], [1.0 + 1e-9, None])
    assert not same([1.0, None], [1.0, 1.0])


def renew() -> None:
    """Write the fingerprints of now."""
    found = {
        name: {"bound": [float(f"{case_bounds([case_of(name).of_run(0)])[0].final_m:.12g}")]}
        | {label: fingerprint(name, label) for label in LABELS}
        for name in CASES
    }
    lines = [
        f" {json.dumps(name)}: {{\n"
        + ",\n".join(f"  {json.dumps(k)}: {json.dumps(v)}" for k, v in held.items())
        + "\n }"
        for name, held in found.items()
    ]
    GOLDEN.write_text("{\n" + ",\n".join(lines) + "\n}\n")


if __name__ == "__main__":
    renew()
