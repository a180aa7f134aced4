"""The report's section on particle filters; every number in it comes from what was measured."""

from __future__ import annotations

from typing import Any

from ggbench.figures.numbers import short
from ggbench.report.tables import markdown

from . import clouds, export
from .rounds import Measured

MEGABYTE = 1e6
BASE = "particles:Bootstrap:"
"""Whose time the others are compared with."""


def section(found: list[Measured], raw: dict[str, Any]) -> str:
    """Return the section of what :func:`.clouds.measure` found.

    Parameters
    ----------
    found : its entries. raw : all that it gave.
    """
    parts = [
        f"The filter of Gordon, Salmond & Smith (1993) over all 15 states on the first "
        f"{raw['epochs']} epochs of run {raw['run']} of `{export.SCENARIO}`, `{export.CASE}`: "
        "systematic resampling below an effective sample size of N/2, process noise of rank nine "
        "by its root, mean and covariance of every epoch before it is resampled. Timed in turn "
        "like the others, one thread each.",
        _times(found, raw["epochs"]),
    ]
    refused = [
        f"* {item.entry.title}, {item.entry.family} particles: {item.refusal}."
        for item in found
        if item.refusal
    ]
    if refused:
        parts.append("Not timed:\n\n" + "\n".join(refused))
    parts += [_agreement_text(raw), _agreement(raw["agreement"]), _notes(raw["epochs"])]
    return "\n\n".join(parts)


def _times(found: list[Measured], epochs: int) -> str:
    base = {item.entry.family: item for item in found if item.entry.key.startswith(BASE)}
    rows = []
    for item in sorted(
        (item for item in found if item.turns),
        key=lambda item: (int(item.entry.family), -item.best),
    ):
        other = base.get(item.entry.family)
        each = item.best / (int(item.entry.family) * epochs)
        rows.append(
            [
                item.entry.family,
                item.entry.title,
                short(1e3 * item.best),
                short(1e3 * item.median),
                short(1e3 * item.processor),
                short(other.best / item.best) if other and other.turns else "",
                f"{1e9 * each:.0f}",
                f"{item.peak / MEGABYTE:.0f}",
                short(item.first_call),
            ]
        )
    head = [
        "particles N", "implementation", "ms/run", "median", "processor time", "times particles",
        "ns a particle and epoch", "memory [MB]", "first call [s]",
    ]  # fmt: skip
    return markdown(head, rows)


def _agreement_text(raw: dict[str, Any]) -> str:
    return (
        "No two of them draw the same random numbers; what must be the same is what their means "
        f"scatter about. Over {raw['seeds']} seeds, for every state and epoch, *from the exact* is "
        "the largest distance of the average from the exact answer (the Kalman filter's; on the "
        "flight, which is nearly linear, an EKF's) in its standard errors (Student's t), *from "
        "ggbench* that between the averages of two implementations (Welch's t). An implementation "
        "with either above *allowed* is not timed. A right one fails one comparison in "
        f"{1.0 / raw['false_alarms']:.0f} at most, by Bonferroni's inequality over all states and "
        "epochs. *Distance* is the root mean square over seeds, epochs and states of "
        "what one seed is off, in standard deviations of the exact posterior: it falls as 1/√N."
    )


def _agreement(found: list[dict[str, Any]]) -> str:
    rows = [
        [
            clouds.PROBLEMS[row["problem"]],
            str(row["particles"]),
            row["title"],
            f"{row['distance']:.3f}",
            f"{row['off']:.1f}",
            row["relation"] or f"{row['apart']:.1f}",
            f"{row['allowed']:.1f}",
        ]
        for row in found
    ]
    head = [
        "problem", "particles N", "implementation", "distance", "from the exact", "from ggbench",
        "allowed",
    ]  # fmt: skip
    return markdown(head, rows)


def _notes(epochs: int) -> str:
    return (
        "* `particles` (Chopin) and Stone Soup are given h of all particles at once in NumPy "
        "(`benchmarks/speed/numpy_model.py`), as `particle` is in the first of its rows: what "
        "differs between these is the filter alone.\n"
        "* The noise of both is drawn by the root of Q that ggbench has: the Gaussians of "
        "`particles` want a covariance of full rank, and Stone Soup would decompose Q at every "
        "epoch.\n"
        "* Both keep logarithms of weights, and resample with NumPy's global generator, which is "
        "seeded for each run. `particles` wants NumPy 1.\n"
        "* `particle` draws its first cloud with exactly the prior's mean and covariance "
        "(second-order exact sampling), the others at random: hence its smaller distance on the "
        "flight, whose noise hardly moves the cloud.\n"
        f"* The flight ends after {epochs} epochs because later the copies that resampling "
        "makes are hardly parted by so little noise: all three are depleted then, and none has the "
        "answer."
    )
