"""Figures of a recorded flight: tracks, standard deviations and residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .line_styles import line_styles
from .style import BOUND, INS, Drawing, plain_numbers, styled, subplots

_MOST_POINTS = 2000
"""Largest number of points of a curve; longer curves are thinned."""


@styled()
def ground_track(
    times: np.ndarray,
    ins: np.ndarray,
    tracks: Mapping[str, np.ndarray],
    reference: np.ndarray | None,
    families: Mapping[str, str],
) -> Drawing:
    """Draw horizontal tracks and heights, relative to the start of the INS track.

    Parameters
    ----------
    times : (K,) epochs [s].
    ins : (K, 3) INS track, ENU [km, km, m].
    tracks : corrected tracks (K, 3) by estimator.
    reference : reference track (K, 3), NaN where unknown; None without a reference.
    families : family of each estimator.
    """
    figure, (plan, height) = subplots(1, 2, figsize=(9.0, 4.4), width_ratios=(3, 2))
    styles = line_styles(families)
    curves = [("INS", ins, {"color": INS, "lw": 1.5})]
    curves += [
        (label, track, {"color": styles[label].color, "ls": styles[label].ls, "lw": 1.2})
        for label, track in tracks.items()
    ]
    if reference is not None:
        curves.append(("reference", reference, {"color": BOUND, "lw": 0.9, "ls": ":"}))
    for label, track, look in curves:
        step = 1 + len(track) // _MOST_POINTS
        some = track[::step]
        plan.plot(some[:, 0], some[:, 1], label=label, **look)
        height.plot(times[::step], some[:, 2], **look)
    plan.plot(ins[0, 0], ins[0, 1], "o", color="k", mfc="w", ms=6)
    plan.set_aspect("equal", adjustable="datalim")
    plan.set(xlabel="east [km]", ylabel="north [km]")
    height.set(xlabel="time since the start [s]", ylabel="height [m]")
    handles, names = plan.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4)
    return figure


@styled()
def deviations(
    times: np.ndarray, claimed: Mapping[str, np.ndarray], families: Mapping[str, str]
) -> Drawing:
    """Draw the reported 3-D standard deviations of position and velocity over time.

    Parameters
    ----------
    times : (K,) epochs [s].
    claimed : (K, 6) reported ENU σ of position [m] and velocity [m/s], by estimator.
    families : family of each estimator.
    """
    figure, axes = subplots(2, 1, figsize=(7.0, 5.0), sharex=True)
    styles = line_styles(families)
    step = 1 + len(times) // _MOST_POINTS
    for row, (first, unit) in enumerate(((0, "position [m]"), (3, "velocity [m/s]"))):
        for label, sigmas in claimed.items():
            size = np.sqrt(np.sum(sigmas[:, first : first + 3] ** 2, axis=1))
            style = styles[label]
            axes[row].semilogy(
                times[::step], size[::step], color=style.color, ls=style.ls, lw=1.4, label=label
            )
        plain_numbers(axes[row])
        axes[row].set_ylabel(f"1σ of {unit}")
    axes[-1].set_xlabel("time since the start [s]")
    axes[0].legend()
    return figure


@styled()
def whitened(
    times: np.ndarray, sensors: Sequence[tuple[str, Sequence[str], np.ndarray]], label: str
) -> Drawing:
    """Draw the whitened residuals of an estimate over time, with a panel for each sensor.

    ``sensors`` has the name, the channel names and the whitened residuals (K, m) of each sensor; a
    missing residual is NaN.
    """
    count = len(sensors)
    figure, axes = subplots(count, 1, figsize=(7.0, 1.2 + 1.8 * count), sharex=True, squeeze=False)
    for axis, (name, channels, values) in zip(axes[:, 0], sensors, strict=True):
        for j, channel in enumerate(channels):
            axis.plot(times, values[:, j], ".", ms=3, color=f"C{j % 10}", label=channel)
        axis.axhspan(-2.0, 2.0, color="k", alpha=0.06, lw=0.0)
        limit = max(4.0, 1.1 * float(np.nanpercentile(np.abs(values), 99.5)))
        axis.set(ylim=(-limit, limit), ylabel=f"{name} [σ]")
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), markerscale=2.0)
    axes[0, 0].set_title(label)
    axes[-1, 0].set_xlabel("time since the start [s]")
    return figure
