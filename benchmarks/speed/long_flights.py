"""The time and memory of an epoch over the length of a flight, and over the number of states.

``python -m speed.long_flights EPOCHS STATES LABEL...`` simulates and estimates a block of runs of a
flight of that length and prints one line of JSON. The flight circles over the map of the other
sections, its height damped by an altimeter: nothing else bounds an INS for hours.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ggbench.report.tables import markdown

from . import environments

EPOCHS = (200, 2000, 20_000)


def _on_board(gradiometer: bool, logs: int, barometer: bool) -> dict[str, Any]:
    """Return changes that give the gradiometer biases, and take named sensors with some."""
    found: dict[str, Any] = {"gradiometer.bias_eotvos": 0.1} if gradiometer else {}
    of_log = {"kind": "velocity_log", "period_s": 10.0, "noise_mps": 0.1, "bias_mps": 0.2,
              "bias_time_s": 300.0}  # fmt: skip
    for n in range(logs):
        found |= {f"sensor.log_{n}.{key}": value for key, value in of_log.items()}
    if barometer:
        found |= {"barometer.period_s": 10.0, "barometer.noise_m": 3.0, "barometer.bias_m": 5.0}
    return found


SENSORS = {
    15: _on_board(False, 0, False),
    18: _on_board(False, 1, True),
    21: _on_board(True, 0, False),
    24: _on_board(True, 1, True),
    30: _on_board(True, 4, True),
}
"""What is on board besides, by the number of states that it leads to."""
SHORTEST = 2
"""Which of the lengths other numbers of states are measured at, counted from the shortest."""
WARM = 50
"""Epochs of a flight that is solved before, so that all is compiled."""
RUNS = 8
"""Runs of the block: those that go through the kernels together."""
MICRO = 1e6


def case(epochs: int, states: int) -> Any:
    """Return the case of a flight of so many epochs, a second each, and so many states."""
    from ggbench.spec import scenario

    from .export import CASE, SCENARIO

    document = tomllib.loads(scenario.load(SCENARIO).source)
    for name in ("notes", "assumption", "claim", "comparison"):
        document.pop(name, None)
    document["case"] = [item for item in document["case"] if item["name"] == CASE]
    circles = {"duration_s": float(epochs), "turn_rate_deg_per_s": 1.0}
    document["trajectory"]["segment"] = [circles]
    damped = {"altimeter.noise_m_per_sqrt_hz": 1.0, "altimeter.time_constant_s": 100.0}
    for name, value in (damped | SENSORS[states]).items():
        *tables, last = name.split(".")
        table = document
        for part in tables:
            table = table.setdefault(part, {})
        table[last] = value
    document["windows"]["settled_from_s"] = 0.5 * epochs
    return scenario.parse(document, SCENARIO, SCENARIO).cases[0]


def point(epochs: int, states: int, labels: Sequence[str], seconds: float) -> dict[str, Any]:
    """Return the processor seconds a run and epoch that each step takes, of the best of a few.

    And the bytes a run and epoch by which the process has grown at its peak.
    """
    from ggbench.campaign.registry import choose
    from ggbench.simulation.error_free_flight import prepare
    from ggbench.simulation.runs import simulate_block

    from .worker import peak_memory

    flight = prepare(case(epochs, states))
    if flight.model.dimension != states:
        raise ValueError(f"there are {flight.model.dimension} states instead of {states}")

    def best(work: Callable[[], Any]) -> tuple[float, Any]:
        found, result, spent = [], work(), 0.0
        while spent < seconds or len(found) < 3:
            start = time.process_time()
            result = work()
            found.append(time.process_time() - start)
            spent += found[-1]
        return min(found) / (RUNS * len(flight.times)), result

    engines: dict[str, Any] = {label: choose(label).estimator for label in labels}
    short = simulate_block(prepare(case(WARM, states)), 1, range(RUNS))[0]
    for engine in engines.values():  # compiled, and in memory
        engine.estimate_block(short)
    before = peak_memory()
    parts: dict[str, float] = {}
    rounds: dict[str, float] = {}
    parts["simulation"], (block, _) = best(lambda: simulate_block(flight, 1, range(RUNS)))
    for label, engine in engines.items():
        parts[label], estimate = best(lambda engine=engine: engine.estimate_block(block))
        if "iterations" in estimate.info:
            rounds[label] = float(np.mean(estimate.info["iterations"]))
    return {
        "epochs": epochs,
        "states": states,
        "parts": parts,
        "iterations": rounds,
        "bytes": (peak_memory() - before) / (RUNS * len(flight.times)),
    }


def measure(labels: Sequence[str], seconds: float) -> list[dict[str, Any]]:
    """Return :func:`point` of each length and number of states, each in a process of its own."""
    wanted = [(epochs, min(SENSORS)) for epochs in EPOCHS]
    wanted += [(EPOCHS[SHORTEST - 1], states) for states in SENSORS if states > min(SENSORS)]
    points = []
    for epochs, states in wanted:
        print(f"{epochs} epochs, {states} states", file=sys.stderr)
        command = [sys.executable, "-m", "speed.long_flights", str(epochs), str(states),
                   str(seconds), *labels]  # fmt: skip
        done = subprocess.run(
            command, env=environments.variables(), stdout=subprocess.PIPE, text=True, check=True
        )
        points.append(json.loads(done.stdout.splitlines()[-1]))
    return points


def section(points: list[dict[str, Any]]) -> str:
    """Return the report's section of what :func:`measure` found."""
    labels = list(points[0]["parts"])
    titles = [label if label == "simulation" else f"`{label}`" for label in labels]
    rows = [
        [
            str(item["epochs"]),
            str(item["states"]),
            *(_time(item, label) for label in labels),
            f"{item['bytes'] / 1e3:.1f}",
        ]
        for item in points
    ]
    shortest, longest = points[0], points[len(EPOCHS) - 1]
    ratios = "; ".join(
        f"{title} {longest['parts'][label] / shortest['parts'][label]:.2f}"
        for title, label in zip(titles, labels, strict=True)
    )
    return (
        "Microseconds of processor time an epoch and run, and kilobytes an epoch and run by which "
        "the process grew, of the case `0.01E-1Hz` flown in circles with an altimeter, its "
        f"readings filtered and whitened as there: {RUNS} runs in one block on one thread. An "
        "epoch of the longest flight costs so many times what one of the shortest does: "
        f"{ratios}. Nothing is done more often an epoch but iterations, whose number is in "
        "brackets; what a short flight keeps in the caches, a long one fetches from memory, in "
        "pages that are new to the process. More states are biases of the gradiometer (6), of "
        "velocity logs (2 each) and of a barometer.\n\n"
        + markdown(["epochs", "states", *titles, "memory [kB]"], rows)
    )


def _time(item: dict[str, Any], label: str) -> str:
    found = f"{MICRO * item['parts'][label]:.2f}"
    iterations = item["iterations"].get(label)
    return found if iterations is None else f"{found} ({iterations:.1f})"


if __name__ == "__main__":
    print(json.dumps(point(int(sys.argv[1]), int(sys.argv[2]), sys.argv[4:], float(sys.argv[3]))))
