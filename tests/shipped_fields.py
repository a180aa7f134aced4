"""The field of a source of the package, at any places."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ggbench.maps.netcdf import Nodes
from ggbench.maps.parts import summed
from ggbench.maps.shipped import SOURCES, ShippedSource
from ggbench.maps.shipped_parts import PartOptions, ShippedGeoid, ShippedTerrain


def disturbing_field(
    source: str | ShippedSource,
    latitude: ArrayLike,
    longitude: ArrayLike,
    height: ArrayLike,
    **options: Any,
) -> tuple[np.ndarray, np.ndarray]:
    """Return tensor [E] and gravity disturbance [m/s²] on latitude x longitude x height.

    Axes in rad and m; options are fields of :class:`PartOptions`.
    """
    shipped = SOURCES[source] if isinstance(source, str) else source
    nodes = Nodes(np.degrees(latitude), np.degrees(longitude), np.asarray(height, dtype=float))
    layers = summed(shipped.loaded(PartOptions(**options)), nodes)
    tensors, disturbances = zip(*layers, strict=True)
    return np.stack(tensors, axis=2), np.stack(disturbances, axis=2)


REGIONS = {name: s.parts[1] for name, s in SOURCES.items() if isinstance(s.parts[-1], ShippedGeoid)}
"""Geoids of the shipped regions."""
TERRAINS = {name for name, s in SOURCES.items() if isinstance(s.parts[0], ShippedTerrain)}
