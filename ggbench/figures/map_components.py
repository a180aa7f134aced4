"""Figure of a map: the six components of the gradient tensor at one height."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from ..maps.netcdf import TENSOR, Nodes
from .style import Drawing, styled, subplots

_MOST_PIXELS = 600  # per axis: more cannot be seen


@styled()
def map_components(nodes: Nodes, tensor: Any, height: str, source: str) -> Drawing:
    """Draw the gradient tensor (n_lat, n_lon, 6) [E]; ``height`` and ``source`` are texts."""
    lat, lon = nodes.latitude_deg, nodes.longitude_deg
    stride = max(1, math.ceil(max(lat.size, lon.size) / _MOST_PIXELS))
    half = 0.5 * (lat[1] - lat[0]), 0.5 * (lon[1] - lon[0])
    extent = (lon[0] - half[1], lon[-1] + half[1], lat[0] - half[0], lat[-1] + half[0])
    stretch = 1.0 / math.cos(math.radians(0.5 * (lat[0] + lat[-1])))
    shape = (extent[3] - extent[2]) * stretch / (extent[1] - extent[0])
    size = (10.0, min(14.0, max(4.0, 1.6 + 4.2 * shape)))
    figure, axes = subplots(2, 3, figsize=size, sharex=True, sharey=True)
    for index, (axis, name) in enumerate(zip(axes.flat, TENSOR, strict=True)):
        values = tensor[::stride, ::stride, index]
        limit = float(np.percentile(np.abs(values), 99.5)) or 1.0
        image = axis.imshow(
            values,
            origin="lower",
            extent=extent,
            aspect=stretch,
            cmap="RdBu_r",
            vmin=-limit,
            vmax=limit,
            interpolation="nearest",
        )
        axis.grid(visible=False)
        axis.ticklabel_format(useOffset=False)
        axis.set_title(f"Γ_{name.upper()}")
        figure.colorbar(image, ax=axis, shrink=0.85, label="[E]", extend="both")
    for axis in axes[-1]:
        axis.set_xlabel("longitude [°]")
        axis.xaxis.set_major_locator(MaxNLocator(4))
    for axis in axes[:, 0]:
        axis.set_ylabel("latitude [°]")
    title = f"Disturbing gradient at {height}"
    figure.suptitle(f"{title}: {source}" if source else title, fontsize=9, wrap=True)
    return figure
