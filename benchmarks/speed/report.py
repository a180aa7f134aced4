"""The report of the speed benchmark: every number in it comes from what was measured."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ggbench.figures.numbers import short
from ggbench.report.tables import markdown

from . import clouds_report, figure, flops, long_flights, roster
from .rounds import Measured

TITLES = {
    "ekf": "extended Kalman filter",
    "ukf": "unscented Kalman filter",
    "batch": "batch smoother",
}
IDIOMATIC = {"ekf": "filterpy:Ekf", "ukf": "filterpy:Ukf", "batch": "gtsam:Batch"}
MANY = 10_000
"""Runs of a study that its first sentence speaks of."""
SHAPE = (15, 6, 200)
"""States, channels and epochs of the problem."""
MEGABYTE = 1e6
LEAST_CORES = 0.95
"""Processor seconds a second below which an implementation had to wait for others."""
LEAST_SHARE = 0.01
"""Share of the time from which a kernel has a row of its own."""


def write(
    found: list[Measured], clouds: list[Measured], raw: dict[str, Any], folder: Path
) -> list[Path]:
    """Write ``speed.md`` and its figure; return the files.

    Parameters
    ----------
    found, clouds : the engines, and the particle filters. raw : all that was measured.
    """
    folder.mkdir(parents=True, exist_ok=True)
    measured = {item.entry.key: item for item in found}
    lines = [
        "# Speed",
        f"**{_answer(measured, raw)}**",
        "Made by `make bench` and never edited by hand. Every implementation solves the same runs "
        "of the scenario `wang2013`, case `0.01E-1Hz`: 15 states, 200 epochs of 6 channels. Each "
        "is a process of its own with one BLAS or XLA thread; all are loaded, compiled and checked "
        f"first and then timed in turn, {raw['rounds']} rounds of at least {raw['seconds']:g} s "
        "each, so that ratios are of one load. Times are the best round's wall time, the median "
        "and the best processor time (of all threads) beside it, in milliseconds a run. Every "
        "implementation returns the means and covariances of all epochs.",
        "## Machine",
        _machine([*found, *clouds], raw),
    ]
    for family, title in TITLES.items():
        lines += [f"## {title[0].upper()}{title[1:]}", _family(family, measured, raw)]
    lines += ["## What is compared", _compared(measured, raw)]
    lines += ["## Floating-point operations", _flops(measured, raw)]
    costs = [roster.Cost(**item) for item in raw["roster"]]
    lines += ["## Every estimator", roster.section(costs)]
    lines += ["## Bootstrap particle filter", clouds_report.section(clouds, raw["clouds"])]
    files = [folder / "speed.md"]
    if "curve" in raw:
        files.append(folder / "speed_runs.png")
        figure.draw(raw["curve"], files[1])
        lines += ["## A campaign", _campaign(raw["campaign"], os.cpu_count())]
        lines += ["## Over the number of runs", _curve(raw["curve"])]
        lines += ["## Long flights", long_flights.section(raw["long_flights"])]
        lines += ["## Where the time goes", _profiles(raw["profiles"])]
        lines += [_parts(raw), *_threads(measured, raw)]
    else:
        lines += [
            "## Over the number of runs",
            f"Not measured, nor where the time of a run goes: {raw['not_streamed']}.",
        ]
    lines += ["## Start-up", _startup(raw["startup"])]
    files[0].write_text("\n\n".join(lines) + "\n")
    return files


def _one_thread(family: str, measured: dict[str, Measured]) -> Measured | None:
    """Return the compiled engine of a family on one thread, if it was timed."""
    for key, item in measured.items():
        if key.startswith("compiled:1:") and item.entry.family == family and item.turns:
            return item
    return None


def _ratio(family: str, item: Measured, measured: dict[str, Measured]) -> float | None:
    base = measured[IDIOMATIC[family]]
    return base.best / item.best if base.turns and item.turns else None


def _answer(measured: dict[str, Measured], raw: dict[str, Any]) -> str:
    """Return how long ten thousand runs take, and how much longer with the frameworks."""
    parts = []
    for family, title in TITLES.items():
        item = _one_thread(family, measured)
        ratio = _ratio(family, item, measured) if item else None
        if item is None or ratio is None:
            continue
        rival = measured[IDIOMATIC[family]].entry.title.split(",")[0]
        parts.append(
            f"{short(MANY * item.best)} s with the {title} ({ratio:.0f} times as fast as the "
            f"{rival})"
        )
    if not parts:
        return "The compiled engines were not timed; see below why."
    answer = f"{MANY} runs of 200 s take one thread {', '.join(parts)}"
    if "campaign" in raw:
        found = raw["campaign"]
        answer += (
            f"; three cases with all three, {found['runs']} runs each, simulated, judged and told, "
            f"take {os.cpu_count()} cores {found['seconds']:.0f} s"
        )
    return f"{answer}."


def _machine(found: list[Measured], raw: dict[str, Any]) -> str:
    machine = raw["machine"]
    versions: dict[str, set[str]] = {}
    for item in found:
        for name, version in item.versions.items():
            versions.setdefault(name, set()).add(version)
    listed = ", ".join(f"{name} {'/'.join(sorted(v))}" for name, v in sorted(versions.items()))
    busy = [item.entry.title for item in found if item.turns and item.cores < LEAST_CORES]
    warning = (
        f" **The machine was busy with other work: {len(busy)} of the implementations had less "
        f"than {LEAST_CORES:g} of a core; take the times as upper bounds.**"
        if busy
        else ""
    )
    return (
        f"{machine['processor']} ({machine['architecture']}), {machine['cores']} cores, "
        f"{machine['system']}; load average before the start {machine['load']:.1f}. {listed}."
        f"{warning}"
    )


def _family(family: str, measured: dict[str, Measured], raw: dict[str, Any]) -> str:
    items = [item for item in measured.values() if item.entry.family == family]
    timed = sorted((item for item in items if item.turns), key=lambda item: -item.best)
    rival = measured[IDIOMATIC[family]].entry.title
    rate = _rate(measured)
    head = [
        "implementation", "ms/run", "median", "processor time", f"times {rival.split(',')[0]}",
        "largest difference", "share of the flop bound", "memory [MB]", "of it in solving",
        "first call [s]",
    ]  # fmt: skip
    rows = []
    for item in timed:
        ratio = _ratio(family, item, measured)
        threads = 2 if item.entry.key.startswith("compiled:2:") else 1
        bound = _operations(family, raw) / (rate * threads) if rate else None
        rows.append(
            [
                item.entry.title,
                short(1e3 * item.best),
                short(1e3 * item.median),
                short(1e3 * item.processor),
                "" if ratio is None else short(ratio),
                "reference" if item.difference == 0.0 else f"{item.difference:.0e}",
                "" if bound is None else _percent(bound / item.best),
                f"{item.peak / MEGABYTE:.0f}",
                f"{(item.peak - item.loaded) / MEGABYTE:.0f}",
                short(item.first_call),
            ]
        )
    text = markdown(head, rows)
    refused = [f"* {item.entry.title}: {item.refusal}." for item in items if item.refusal]
    if refused:
        text += "\n\nNot timed:\n\n" + "\n".join(refused)
    return text


def _percent(share: float) -> str:
    percent = 100.0 * share
    return f"{percent:.0f} %" if percent >= 9.5 else f"{percent:.1g} %"


def _rate(measured: dict[str, Measured]) -> float:
    """Return operations per second of the best round of DGEMM; 0 if it was not measured."""
    item = measured["dgemm:"]
    return flops.Dgemm.operations() / item.best if item.turns else 0.0


def _operations(family: str, raw: dict[str, Any]) -> float:
    if family == "batch":
        return flops.batch(*SHAPE, raw["iterations"])
    return flops.ekf(*SHAPE) if family == "ekf" else flops.ukf(*SHAPE)


def _compared(measured: dict[str, Measured], raw: dict[str, Any]) -> str:
    tolerances = raw["tolerances"]
    text = (
        "The *largest difference* is that of the means from ggbench's own engine on the framework, "
        "over all states and epochs of four runs, in standard deviations of the prior (5 m of "
        f"position). Above {tolerances['ekf']:.0e} (filters) or {tolerances['batch']:.0e} (batch) "
        "an implementation is not timed.\n\n"
        "* The equations are the same everywhere: additive noise, sigma points of the paper with "
        "κ = 3 − n, lower Cholesky factor, points drawn anew after the prediction (as filterpy "
        "2.0, Stone Soup and dynamax all do).\n"
        "* filterpy, gtsam and Stone Soup are given h and H in NumPy and SciPy "
        "(`benchmarks/speed/numpy_model.py`): the map by SciPy's NdBSpline in h and, which is "
        "faster, by matrix products in H; scalars are Python floats. filterpy calls f and h "
        "point by point, Stone Soup sends all sigma points through one call; as the dynamics are "
        "linear, its EKF predicts as a Kalman filter.\n"
        "* dynamax is given h in jax.numpy in double precision and differentiates it itself; of "
        "its results only means and covariances are taken. Readings are scaled to unit noise, "
        "because it adds 1e-9 to the diagonal of what it inverts.\n"
        "* gtsam: one graph, Levenberg–Marquardt that starts as Gauss–Newton, all marginal "
        "covariances; it stops where the error falls by less than 1e-10 of itself, so that its "
        "means agree to what that leaves.\n"
        "* *Memory* is the peak of the whole process, *in solving* what it rose by after loading "
        "packages and problem; *first call* includes compilation, by JAX or from a cache.\n\n"
    )
    rows = []
    for function, title in (
        ("h", "h of one state"), ("h31", "h of 31 sigma points in one call"), ("H", "H"),
    ):  # fmt: skip
        numpy, compiled = (measured[f"calls:{maker}-{function}"] for maker in ("numpy", "compiled"))
        if numpy.turns and compiled.turns:
            rows.append(
                [title, short(1e6 * numpy.best), short(1e6 * compiled.best),
                 short(numpy.best / compiled.best)]
            )  # fmt: skip
    return text + markdown(["a call from Python", "NumPy [µs]", "compiled [µs]", "ratio"], rows)


def _flops(measured: dict[str, Measured], raw: dict[str, Any]) -> str:
    rate = _rate(measured)
    if not rate:
        return f"Not measured: {measured['dgemm:'].refusal}."
    rows = []
    for family, title in TITLES.items():
        operations = _operations(family, raw)
        rows.append([title, short(1e-6 * operations), short(1e3 * operations / rate)])
    return (
        f"The bound is the time in which one thread would do the algorithm's operations in DGEMM: "
        f"{1e-9 * rate:.0f} GFLOP/s here, in a product of {flops.Dgemm.size} × {flops.Dgemm.size} "
        "matrices measured in the same rounds. Dense equations of the textbook with symmetry and "
        "zeros not made use of, h and H not counted (`benchmarks/speed/flops.py` has the formula); "
        f"a batch of {raw['iterations']:.1f} iterations, as gtsam needs. An engine that skips "
        "zeros or does half of a symmetric matrix can come closer to the bound than its own "
        "efficiency.\n\n" + markdown(["a run", "million operations", "bound [ms]"], rows)
    )


def _curve(points: list[dict[str, Any]]) -> str:
    labels = [name for name in points[0]["parts"] if name != "simulation"]
    threads = points[0]["threads"]
    head = ["runs", "wall [s]", "simulation"]
    head += [*(f"`{label}`" for label in labels), "all", "memory [MB]"]
    rows = []
    for point in points:
        each = [1e3 * seconds / threads / point["runs"] for seconds in point["parts"].values()]
        rows.append(
            [f"{point['runs']}", short(point["seconds"]), *map(short, each),
             short(1e3 * point["seconds"] / point["runs"]), f"{point['peak'] / MEGABYTE:.0f}"]
        )  # fmt: skip
    first, last = points[0], points[-1]
    ratio = last["seconds"] / last["runs"] / (first["seconds"] / first["runs"])
    accuracy = ", ".join(f"`{name}` {short(v)} m" for name, v in last["rms_m"].items())
    return (
        "![Time of a run over the number of runs](speed_runs.png)\n\n"
        f"Runs are simulated, estimated by every compiled engine and let go block by block, on "
        f"{threads} threads; a process for each number. Milliseconds of wall time a run. A run of "
        f"the longest stream costs {ratio:.2f} times one of the shortest. Root mean square of the "
        f"position errors of the longest, whole flight: {accuracy}.\n\n" + markdown(head, rows)
    )


def _profiles(profiles: dict[str, dict[str, float]]) -> str:
    parts = [
        "Milliseconds a run, on a block and one thread: every compiled kernel that Python calls, "
        "and of functions in Python (with NumPy and the random numbers) their own lines."
    ]
    for name, spent in profiles.items():
        total = spent["total"]
        kernels = {k: s for k, s in spent.items() if k != "total"}
        shown = {k: s for k, s in kernels.items() if s >= LEAST_SHARE * total}
        rows = [
            [_code(k), short(1e3 * s), _percent(s / total)]
            for k, s in sorted(shown.items(), key=lambda pair: -pair[1])
        ]
        rest = total - sum(shown.values())
        rows.append(["all else", short(1e3 * rest), _percent(rest / total)])
        rows.append(["**total**", short(1e3 * total), ""])
        title = name if name == "simulation" else f"`{name}`"
        parts.append(markdown([title, "ms/run", "share"], rows))
    return "\n\n".join(parts)


def _code(name: str) -> str:
    function, space, remark = name.partition(" ")
    return f"`{function}`{space}{remark}"


def _parts(raw: dict[str, Any]) -> str:
    """Return how an engine's time divides into h and H, and all else."""
    cost, rows = raw["model_cost"], []
    for label, spent in raw["profiles"].items():
        kind = label.partition("[")[0]
        if kind not in ("ekf", "ukf", "factor-graph"):
            continue
        both = cost["h and H"]
        if kind == "ekf":
            title, model = "h and H", both
        elif kind == "ukf":
            # Beside the evaluated sigma points, h and H at the mean.
            points = raw["map_evaluations"][label] / SHAPE[2] - 1.0
            title = f"h of {points:.1f} points; h and H at the mean"
            model = points / 31.0 * cost["h of 31"] + both
        else:
            times = raw["map_evaluations"][label] / SHAPE[2]
            title, model = f"h and H, {times:.1f} times", times * both
        total = spent["total"]
        rows.append(
            [f"`{label}`", title, short(1e3 * model), short(1e3 * max(total - model, 0.0)),
             _percent(min(model / total, 1.0))]
        )  # fmt: skip
    listed = "; ".join(f"{name} {1e6 * v / SHAPE[2]:.2f} µs" for name, v in cost.items())
    return (
        "Inside the engines: the kernels of h and H timed alone over all epochs, and what is left "
        f"for the algebra of the filter or smoother, by difference. An epoch: {listed}.\n\n"
        + markdown(["engine", "at every epoch", "ms/run", "all else [ms/run]", "share"], rows)
    )


def _threads(measured: dict[str, Measured], raw: dict[str, Any]) -> list[str]:
    """Return two threads beside one: of each engine, and of a stream of runs."""
    rows = []
    for key, one in measured.items():
        two = measured.get(key.replace("compiled:1:", "compiled:2:"))
        if key.startswith("compiled:1:") and two and one.turns and two.turns:
            label = key.removeprefix("compiled:1:")
            rows.append(
                [f"`{label}`", short(1e3 * one.best), short(1e3 * two.best),
                 f"{one.best / two.best:.2f}"]
            )  # fmt: skip
    one = raw["one_thread"]
    two = next((p for p in raw["curve"] if p["runs"] == one["runs"]), None)
    if two is not None:
        rows.append(
            [f"a stream of {one['runs']} runs, simulated and estimated by all three",
             short(1e3 * one["seconds"] / one["runs"]), short(1e3 * two["seconds"] / two["runs"]),
             f"**{one['seconds'] / two['seconds']:.2f}**"]
        )  # fmt: skip
    return [
        "Two threads against one, milliseconds a run: an engine alone on runs that wait in memory, "
        "which two threads have to share, and the whole of a study.",
        markdown(["", "one", "two", "times"], rows),
    ]


def _campaign(found: dict[str, Any], cores: int | None) -> str:
    """Return how long a campaign of the paper's cases took."""
    return (
        f"The paper's three cases with all three estimators at {found['runs']} runs each, "
        f"simulation, judgement, storage and tables included, on {cores} cores: "
        f"**{found['seconds']:.0f} s**.\n\n"
        f"```\n{found['command']}\n```"
    )


def _startup(times: dict[str, dict[str, float]]) -> str:
    rows = [
        [f"`{name}`", short(found["best"]), short(found["median"])] for name, found in times.items()
    ]
    return (
        "Wall time of the whole command, its compiled code and maps being there already. Of a run "
        "on filterpy about 0.3 s is what its import of scipy.stats takes.\n\n"
        + markdown(["command", "best [s]", "median [s]"], rows)
    )
