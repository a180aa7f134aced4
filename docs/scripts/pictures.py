"""Pictures of the concepts in ``docs/pictures``.

``make pictures`` draws all pictures again. The frames and the tracks are drawings that are not to
scale. The errors are errors of simulated runs. The posteriors are computed for a field along a
line.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter1d

import ggbench as gg
from ggbench.figures.style import BOUND, INS, Drawing, legend_below, plain_numbers, save, styled
from ggbench.judging.convergence import claimed_radius

PICTURES = Path(__file__).parents[1] / "pictures"
NORTH, EAST, UP, ESTIMATED, WRONG = "tab:blue", "tab:red", "tab:green", "tab:blue", "tab:red"
_WIDE_CASE, _WIDE_RUNS, _LONG = "1km", 20, 10


@styled()
def frames() -> Drawing:
    """Draw the Earth with the axes of ECEF and of ENU, and the body frame from above."""
    figure = Drawing(figsize=(8.0, 3.9), layout="constrained")
    earth, body = figure.subplots(1, 2)
    for axis in (earth, body):
        axis.set_aspect("equal")
        axis.axis("off")
    earth.add_patch(Ellipse((0, 0), 2.0, 1.9, facecolor="0.95", edgecolor="0.6"))
    equator = np.linspace(0, 2 * np.pi, 200)
    earth.plot(np.cos(equator), -0.28 * np.sin(equator), color="0.75", lw=0.8)
    for name, tip in (("x", (-0.62, -0.66)), ("y", (1.35, -0.12)), ("z", (0.0, 1.35))):
        _arrow(earth, (0.0, 0.0), tip, "0.4", f"{name} of ECEF")
    place = np.array([0.56, 0.48])
    _arrow(earth, place, place + np.array([0.42, 0.12]), EAST, "east")
    _arrow(earth, place, place + np.array([-0.28, 0.42]), NORTH, "north")
    _arrow(earth, place, place + np.array([0.36, 0.46]), UP, "up")
    earth.plot(*place, "o", color="black", ms=4)
    earth.set(xlim=(-1.35, 1.6), ylim=(-1.15, 1.5), title="navigation frame n: east, north, up")
    heading = np.radians(50.0)
    forward, right = (
        np.array([np.sin(heading), np.cos(heading)]),
        np.array([np.cos(heading), -np.sin(heading)]),
    )
    _arrow(body, (0, 0), (0.0, 1.25), NORTH, "north")
    _arrow(body, (0, 0), (1.25, 0.0), EAST, "east")
    hull = np.array(
        [[0.0, 0.55], [0.1, 0.2], [0.5, 0.0], [0.1, 0.0], [0.08, -0.3], [0.2, -0.42], [0.0, -0.38]]
    )
    outline = np.concatenate([hull, hull[::-1] * (-1, 1)])
    body.fill(*(outline @ np.array([right, forward])).T, color="0.85", zorder=0)
    _arrow(body, (0, 0), 1.2 * forward, "black", "forward (y)")
    _arrow(body, (0, 0), 0.95 * right, "black", "right (x)")
    arc = np.linspace(0.0, heading, 50)
    body.plot(0.75 * np.sin(arc), 0.75 * np.cos(arc), color=UP)
    body.annotate(
        "heading,\nclockwise\nfrom north",
        0.75 * np.array([np.sin(0.3), np.cos(0.3)]),
        (-0.85, 0.55),
        color=UP,
        arrowprops={"arrowstyle": "-", "color": UP},
    )
    body.set(xlim=(-1.0, 1.6), ylim=(-1.0, 1.5), title="body frame b from above, z points up")
    return figure


@styled()
def error_state() -> Drawing:
    """Draw the indicated, true and corrected tracks, and the errors of INS and EKF in a run."""
    figure = Drawing(figsize=(8.0, 3.6), layout="constrained")
    plan, errors = figure.subplots(1, 2)
    s = np.linspace(0.0, 1.0, 200)
    truth = np.stack([10.0 * s, 1.2 * np.sin(2.5 * s)])
    drift = np.stack([0.4 * s, 2.6 * s**2])
    plan.plot(*truth, color=BOUND, lw=1.8)
    plan.plot(*(truth + drift), color=INS, lw=1.8)
    at = 160
    _arrow(plan, truth[:, at], (truth + drift)[:, at], WRONG, "")
    plan.annotate(
        "error state δr\nindicated − true", (truth + 0.55 * drift)[:, at], (8.8, 1.6), color=WRONG
    )
    plan.annotate("true", truth[:, 60], (2.3, 0.15))
    plan.annotate(
        "indicated by the INS",
        (truth + drift)[:, 90],
        (0.6, 2.6),
        color="0.4",
        arrowprops={"arrowstyle": "-", "color": INS},
    )
    estimated = truth + drift - drift * (1.0 - 0.12 * np.cos(25.0 * s))
    plan.plot(*estimated, color=ESTIMATED, lw=1.2, ls="--")
    plan.annotate(
        "corrected: indicated − estimate of δr",
        estimated[:, 120],
        (3.2, -0.75),
        color=ESTIMATED,
        arrowprops={"arrowstyle": "-", "color": ESTIMATED},
    )
    plan.set(
        title="view from above, not to scale",
        xticks=[],
        yticks=[],
        ylim=(-1.1, 4.2),
        xlim=(-0.3, 12.6),
    )
    plan.grid(False)
    case = gg.load("wang2013").case("0.01E-1Hz-unfiltered")
    problem, truly = gg.simulate(case, seed=1, run=0)
    for name, colour, word in (("ins", INS, "INS alone"), ("ekf", ESTIMATED, "corrected")):
        judged = gg.judge(problem, gg.estimate(problem, name), truly)
        errors.semilogy(judged.times, judged.position_error, color=colour, label=word)
        if name == "ekf":
            sigma = np.sqrt((judged.sigmas[:, :3] ** 2).sum(axis=1))
            errors.semilogy(judged.times, sigma, color=ESTIMATED, ls=":", label="estimated 1 σ")
    errors.set(
        xlabel="time [s]",
        ylabel="position error [m]",
        title="flight over the Qinling, noise of 0.01 E",
    )
    plain_numbers(errors)
    errors.legend(loc="upper left", bbox_to_anchor=(0.0, 0.85))
    return figure


@styled()
def convergence() -> Drawing:
    """Draw runs with a prior of one kilometre: converged, not converged, and a false fix."""
    scenario = gg.load("wide_prior")
    case = scenario.case(_WIDE_CASE)
    required = case.windows.required_m
    assert required is not None
    found: dict[str, gg.Judgement] = {}
    for run in range(_WIDE_RUNS):
        problem, truth = gg.simulate(case, scenario.campaign.seed, run)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # estimates outside the map
            judged = gg.judge(problem, gg.estimate(problem, "ekf"), truth)
        found.setdefault(_ending(judged, required), judged)
    figure = Drawing(figsize=(8.0, 3.2), layout="constrained")
    for axis, (kind, title) in zip(figure.subplots(1, 3, sharey=True), _KINDS.items(), strict=True):
        judged = found[kind]
        axis.semilogy(judged.times, judged.position_error, color=ESTIMATED, label="error")
        radius = claimed_radius(judged.sigmas[:, :3])
        axis.semilogy(judged.times, radius, color=ESTIMATED, ls=":", label="95 % radius")
        axis.axhline(required, color=WRONG, lw=1.0, label=f"required: {required:g} m")
        plain_numbers(axis)
        outside = np.flatnonzero(judged.position_error > required)
        if kind == "converged":
            axis.axvline(judged.times[outside[-1] + 1], color="0.4", ls="--", lw=1.0)
        axis.set(title=title, xlabel="time [s]")
    figure.axes[0].set_ylabel("position error [m]")
    figure.axes[0].legend(loc="upper right")
    return figure


_KINDS = {"converged": "converged", "none": "not converged", "false": "false fix"}


def _ending(judged: gg.Judgement, required_m: float) -> str:
    """Return the outcome of a run as defined in reports: "converged", "false" or "none".

    The result is "" if the error is within ``required_m`` from an early epoch to the end.
    """
    outside = np.flatnonzero(judged.position_error > required_m)
    if judged.position_error[-1] <= required_m:
        return "converged" if outside.size and outside[-1] > _LONG else ""
    return "false" if claimed_radius(judged.sigmas[:, :3])[-1] <= required_m else "none"


@styled()
def prior_width() -> Drawing:
    """Draw a field along a line, and posteriors of the position for three prior widths."""
    rng = np.random.default_rng(5)
    step = 0.01
    x = np.arange(-20.0, 20.0, step)  # in correlation lengths
    # The correlation of white noise smoothed with s is exp(-x²/4s²): 1/e at the distance 2 s.
    field = gaussian_filter1d(rng.standard_normal(x.size), 0.5 / step)
    field /= field.std()
    noise, true = 0.3, 0.0
    readings = np.arange(12) * 0.25  # distances of the measurements ahead
    figure = Drawing(figsize=(8.0, 4.6), layout="constrained")
    above, below = figure.subplots(2, 3, sharex="col", height_ratios=(1.0, 1.2))
    for top, bottom, width in zip(above, below, (0.2, 1.0, 5.0), strict=True):
        shown = np.abs(x) < 3.2 * width
        at = x[shown]
        top.plot(at, field[shown], color="0.3")
        slope = np.interp(0.0, x, np.gradient(field, x))
        start = np.interp(0.0, x, field)
        straight = start + slope * at
        inside = np.abs(straight) < 3.0
        top.plot(at[inside], straight[inside], color=WRONG, ls="--", lw=1.0)
        top.set(title=f"σ/ℓ = {width:g}", ylim=(-3.2, 3.2))
        prior = np.exp(-0.5 * (at / width) ** 2)
        h = np.array([np.interp(at + r, x, field) for r in readings])
        measured = np.array([np.interp(true + r, x, field) for r in readings])
        measured += noise * rng.standard_normal(readings.size)
        misfit = ((h - measured[:, None]) / noise) ** 2
        for count, colour in ((1, "tab:orange"), (readings.size, ESTIMATED)):
            posterior = prior * np.exp(-0.5 * misfit[:count].sum(axis=0))
            words = "1 measurement" if count == 1 else f"{count} measurements"
            bottom.fill_between(
                at, posterior / posterior.max(), color=colour, alpha=0.5, label=words
            )
        bottom.plot(at, prior, color="0.5", label="prior")
        bottom.axvline(true, color="black", lw=0.8)
        bottom.set(xlabel="position / correlation length ℓ", yticks=[])
    above[0].set_ylabel("field and linearisation")
    below[0].set_ylabel("probability")
    legend_below(figure, dict(zip(*below[2].get_legend_handles_labels()[::-1], strict=True)))
    return figure


def _arrow(axis: Axes, start: ArrayLike, end: ArrayLike, colour: str, word: str) -> None:
    arrow = {"arrowstyle": "-|>", "color": colour, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
    axis.annotate("", end, start, arrowprops=arrow)
    beside = (3, 3) if np.asarray(end)[1] > -0.5 else (6, -10)
    axis.annotate(word, end, xytext=beside, textcoords="offset points", color=colour)


ALL = {
    "frames": frames,
    "error_state": error_state,
    "convergence": convergence,
    "prior_width": prior_width,
}


def draw(folder: Path) -> None:
    """Draw all pictures and save them in a folder."""
    for name, picture in ALL.items():
        save(picture(), folder / f"{name}.png")


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else PICTURES)
