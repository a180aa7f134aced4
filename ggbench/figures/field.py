"""Figures of a case's field: map with track, gradient along the track."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .style import Drawing, styled, subplots


@styled()
def field_map(arrays: Mapping[str, np.ndarray]) -> Drawing:
    """Draw the map of the disturbing vertical gradient at flight height, and the track.

    ``arrays`` has the gradient ``map_vertical`` (n_lat, n_lon) [E], the coordinates of its nodes
    ``map_latitude`` and ``map_longitude`` [rad], and the ``track`` (K, 3) [rad, rad, m].
    """
    figure, axis = subplots(figsize=(7.0, 4.4))
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
    axis.annotate(
        "start", (track[0, 1], track[0, 0]), (-4, 6), textcoords="offset points", ha="right"
    )
    axis.set(xlabel="longitude [° E]", ylabel="latitude [° N]")
    axis.set_aspect(1.0 / np.cos(np.radians(latitude.mean())))
    axis.ticklabel_format(useOffset=False)
    axis.grid(False)
    figure.colorbar(mesh, label="disturbing Γ_UU [E]", shrink=0.8)
    return figure


@styled()
def gradient_along_track(arrays: Mapping[str, np.ndarray], title: str) -> Drawing:
    """Draw the vertical gradient along the track: true, with noise, and low-pass filtered.

    ``arrays`` has the ``gradient_times`` (K,) [s], and the gradients (K,) [E] ``vertical`` (true)
    and ``noisy``. With a low-pass filter it also has ``filtered`` (filtered with noise) and
    ``filtered_true`` (filtered without noise).
    """
    times, true = arrays["gradient_times"], arrays["vertical"]
    filtered = arrays.get("filtered")
    ratios = (3, 2) if filtered is None else (3, 2, 2)
    figure, axes = subplots(
        len(ratios),
        1,
        figsize=(7.0, 1.6 + 0.69 * sum(ratios)),
        sharex=True,
        height_ratios=ratios,
    )
    top, bottom = axes[0], axes[-1]
    dots = {"color": "tab:orange", "marker": ".", "ls": "", "ms": 3}
    top.plot(times, arrays["noisy"], **dots, label="noisy")
    before = "noise" if filtered is None else "noise before the filter"
    bottom.plot(times, arrays["noisy"] - true, **dots, label=before)
    if filtered is not None:
        middle, passed = axes[1], arrays["filtered_true"]
        top.plot(times, filtered, color="tab:blue", lw=1.2, label="filtered")
        middle.plot(
            times, passed - true, color="tab:blue", lw=1.2, label="delay error of the filter"
        )
        bottom.plot(
            times, filtered - passed, color="tab:blue", lw=1.2, label="noise after the filter"
        )
        middle.set_ylabel("difference [E]")
        middle.legend()
    top.plot(times, true, "k--", lw=0.8, label="true")
    top.set(title=title, ylabel="Γ_UU [E]")
    bottom.set(xlabel="time [s]", ylabel="noise [E]")
    top.legend()
    bottom.margins(y=0.25)
    bottom.legend(ncols=2)
    return figure
