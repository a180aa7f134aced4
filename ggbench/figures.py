"""The figures of a report, drawn from stored results only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

AXES = ("east", "north", "up")
_INS, _AIDED, _BOUND = "0.55", "tab:blue", "black"

plt.rcParams |= {
    "figure.dpi": 110,
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "svg.hashsalt": "ggbench",
}


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, bbox_inches="tight", metadata={"Software": "ggbench"})
    plt.close(figure)


def gradient_along_track(arrays: Mapping[str, np.ndarray], title: str, path: Path) -> None:
    """Draw the vertical gradient along the track, and what noise and filter do to it."""
    times, true = arrays["times"], arrays["vertical"]
    figure, (top, middle, bottom) = plt.subplots(
        3, 1, figsize=(7.0, 6.4), sharex=True, height_ratios=(3, 2, 2), layout="constrained"
    )
    dots = {"color": "tab:orange", "marker": ".", "ls": "", "ms": 3}
    top.plot(times, arrays["noisy"], **dots, label="noisy")
    bottom.plot(times, arrays["noisy"] - true, **dots, label="noise before the filter")
    if "filtered" in arrays:
        filtered, passed = arrays["filtered"], arrays["filtered_true"]
        top.plot(times, filtered, color="tab:blue", lw=1.2, label="filtered")
        middle.plot(times, passed - true, color="tab:blue", lw=1.2, label="what the filter delays")
        bottom.plot(times, filtered - passed, color="tab:blue", lw=1.2, label="behind the filter")
        middle.legend()
    else:
        middle.set_visible(False)
    top.plot(times, true, "k--", lw=0.8, label="true")
    top.set_title(title)
    top.set_ylabel("Γ$_{UU}$ [E]")
    middle.set_ylabel("difference [E]")
    bottom.set_ylabel("noise [E]")
    bottom.set_xlabel("time [s]")
    top.legend()
    bottom.margins(y=0.25)
    bottom.legend(ncols=2)
    _save(figure, path)


def component_errors(
    times: np.ndarray,
    aided: np.ndarray,
    ins: np.ndarray | None,
    first: int,
    unit: str,
    label: str,
    path: Path,
) -> None:
    """Draw ENU errors of one run: with the pure INS on the left, aided with ±3σ on the right.

    ``aided`` and ``ins`` are (K, 12): six errors and their six standard deviations; ``first`` is
    the first of the three columns shown (0: position, 3: velocity).
    """
    figure, axes = plt.subplots(3, 2, figsize=(8.0, 6.0), sharex=True, layout="constrained")
    for axis in range(3):
        error, sigma = aided[:, first + axis], aided[:, 6 + first + axis]
        left, right = axes[axis]
        if ins is not None:
            left.plot(times, ins[:, first + axis], color=_INS, lw=1.5, label="pure INS")
        left.plot(times, error, color=_AIDED, lw=1.2, label=label)
        left.set_ylabel(f"{AXES[axis]} [{unit}]")
        right.fill_between(times, -3 * sigma, 3 * sigma, color=_AIDED, alpha=0.15, label="±3σ")
        right.plot(times, error, color=_AIDED, lw=1.2, label=label)
        limit = 1.05 * np.percentile(np.maximum(3 * sigma, np.abs(error)), 98)
        right.set_ylim(-limit, limit)
    axes[0, 0].set_title("with the pure INS")
    axes[0, 1].set_title("aided, with its claimed ±3σ")
    axes[0, 0].legend()
    axes[0, 1].legend()
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    _save(figure, path)


def field_map(arrays: Mapping[str, np.ndarray], path: Path) -> None:
    """Draw the disturbing vertical gradient at flight height with the track."""
    figure, axis = plt.subplots(figsize=(7.0, 4.4), layout="constrained")
    longitude, latitude = np.degrees(arrays["map_longitude"]), np.degrees(arrays["map_latitude"])
    values = arrays["map_vertical"]
    limit = np.abs(values).max()
    mesh = axis.pcolormesh(
        longitude, latitude, values, cmap="RdBu_r", vmin=-limit, vmax=limit, rasterized=True
    )
    contours = axis.contour(longitude, latitude, values, 12, colors="k", linewidths=0.3)
    axis.clabel(contours, fontsize=6)
    track = np.degrees(arrays["track"][:, :2])
    axis.plot(track[:, 1], track[:, 0], "k", lw=2.0)
    axis.plot(track[0, 1], track[0, 0], "o", color="k", ms=6, mfc="w")
    axis.annotate("start", (track[0, 1], track[0, 0]), (-4, 6), textcoords="offset points",
                  ha="right")  # fmt: skip
    axis.set_aspect(1.0 / np.cos(np.radians(latitude.mean())))
    axis.set_xlabel("longitude [° E]")
    axis.set_ylabel("latitude [° N]")
    axis.grid(False)
    figure.colorbar(mesh, label="disturbing Γ$_{UU}$ [E]", shrink=0.8)
    _save(figure, path)


def error_over_time(
    panels: Sequence[tuple[str, np.ndarray, Mapping[str, np.ndarray], Mapping[str, np.ndarray]]],
    path: Path,
) -> None:
    """Draw root-mean-square spherical position and velocity errors over runs against the bounds.

    Each panel is (title, times (K,), curves, bounds), both name to (K, 2): position, velocity.
    """
    count = len(panels)
    figure, grid = plt.subplots(
        2, count, figsize=(4.0 * count + 0.6, 6.4), sharex=True, squeeze=False, layout="constrained"
    )
    styles: dict[str, tuple[str, str]] = {}
    for _, _, curves, _ in panels:
        for name in curves:
            if name not in styles:
                colour = _INS if name == "ins" else f"C{len(styles)}"
                styles[name] = (colour, ("-", "--", "-.", ":")[len(styles) % 4])
    for column, (title, times, curves, bounds) in enumerate(panels):
        for row, quantity in enumerate(("position [m]", "velocity [m/s]")):
            axis: Axes = grid[row, column]
            for name, curve in curves.items():
                colour, style = styles[name]
                axis.semilogy(times, curve[:, row], style, color=colour, lw=1.4, label=name)
            for number, (name, bound) in enumerate(bounds.items()):
                axis.semilogy(
                    times, bound[:, row], color=_BOUND, lw=0.9, ls=("-", ":", "--")[number % 3],
                    label=name,
                )  # fmt: skip
            if row == 0:
                axis.set_title(title)
            else:
                axis.set_xlabel("time [s]")
            if column == 0:
                axis.set_ylabel(f"RMS spherical {quantity}")
    handles, names = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4)
    _save(figure, path)
