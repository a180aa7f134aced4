"""Matching suitability of map cells: statistics, Fisher information, ambiguity, index."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..gravity.ellipsoid import metres_per_radian
from ..gravity.field import Field
from ..gravity.gradient_map import MapError
from ..gravity.meridians import Area
from . import information as info
from . import statistics as stats
from .components import Components, grades, principal_components

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

HEADINGS = (0.0, 45.0, 90.0, 135.0)
"""Headings of the tracks through a cell [deg]; opposite headings give the same results."""
REACH = 3.0
"""Largest displacement in the search for a position, in standard deviations of the prior."""
_STEPS = 20
"""Number of offsets from the centre of the search grid to its border."""
_MOST_CELLS = 20_000
_MOST_NODES = 1000
"""Largest number of nodes along a side of a cell."""
ABOVE_BASE = " above the base surface"
_ROUNDING = 1e-6


class Bounds(NamedTuple):
    """Bounds of the area that is divided into cells [deg]; None: limits of the map."""

    south: float | None = None
    north: float | None = None
    west: float | None = None
    east: float | None = None


class Cell(NamedTuple):
    """Bounds [deg] of a cell into which the area of a map is divided."""

    south: float
    north: float
    west: float
    east: float

    @property
    def centre(self) -> tuple[float, float]:
        """Latitude and longitude of the centre [deg]."""
        return 0.5 * (self.south + self.north), 0.5 * (self.west + self.east)


@dataclass(frozen=True)
class Design:
    """Cells, instrument and tracks of a score; None: the default of an attribute.

    Attributes
    ----------
    height_m : height of the flights above the ellipsoid [m], or above the base surface of a draped
        map; by default the height of the map's lowest nodes.
    cell_deg : side of a cell [deg].
    instrument : instrument that measures the field.
    spacing_m : distance between the nodes at which the field is evaluated for the statistics; by
        default a fiftieth of the shortest side of all cells.
    per_km2 : number of measurements per square kilometre, for the Fisher information.
    track_m : length of straight tracks through the centre of a cell; by default the shortest side
        of all cells.
    readings : number of measurements on a track, including its ends.
    sigma_m : standard deviation of the position prior, per axis.
    right_m : r₀, largest error of a correct fix; by default half of ``sigma_m``.
    """

    height_m: float | None = None
    cell_deg: float = 0.5
    instrument: info.Instrument = dataclasses.field(default_factory=info.Instrument)
    spacing_m: float | None = None
    per_km2: float = 1.0
    track_m: float | None = None
    readings: int = 51
    sigma_m: float = 5000.0
    right_m: float | None = None

    def __post_init__(self) -> None:
        for what, value, unit in (
            ("side of a cell", self.cell_deg, "°"),
            ("spacing", self.spacing_m, " m"),
            ("number of measurements per km²", self.per_km2, ""),
            ("track", self.track_m, " m"),
            ("deviation of the position", self.sigma_m, " m"),
            ("largest error of a correct fix", self.right_m, " m"),
        ):
            if value is not None and not 0.0 < value < math.inf:
                raise MapError(f"the {what} is {value:g}{unit} and must be positive and finite")
        if not 2 <= self.readings <= 10_000:
            raise MapError(f"a track must have 2 to 10000 measurements, found {self.readings}")
        if self.height_m is not None and not math.isfinite(self.height_m):
            raise MapError(f"the height is {self.height_m:g} m and must be finite")
        if self.right >= self.reach:
            raise MapError(
                f"the largest error of a correct fix, {self.right:g} m, must be below the search "
                f"radius of {self.reach:g} m (three standard deviations)"
            )

    @property
    def reach(self) -> float:
        """Largest displacement in the search for a position [m]."""
        return REACH * self.sigma_m

    @property
    def right(self) -> float:
        """Largest error r₀ of a correct fix [m]."""
        return 0.5 * self.sigma_m if self.right_m is None else self.right_m


@dataclass(frozen=True)
class Scored:
    """Scores of the cells of a map.

    Attributes
    ----------
    design : complete design, without None.
    table : one row for each cell; see :func:`score`.
    components : principal components that define the index; None with too few cells.
    draped : whether the map is draped.
    """

    design: Design
    table: pd.DataFrame
    components: Components | None
    draped: bool = False

    @property
    def height(self) -> str:
        """Description of the height of the flights."""
        above = ABOVE_BASE if self.draped else ""
        return f"{self.design.height_m:g} m{above}"


def score(
    field: Field, design: Design, bounds: Bounds | None = None, name: str = "the map"
) -> Scored:
    """Score all cells that lie, together with their surroundings, within a map.

    Heights in a draped map count from the base surface, and tracks follow this surface.

    Parameters
    ----------
    field : field of the map.
    design : cells, instrument and tracks.
    bounds : area of the cells.
    name : name of the map, for messages.

    Returns
    -------
    Scores whose ``table`` has these columns:

    ``south_deg``, ``north_deg``, ``west_deg``, ``east_deg``
        the cell;
    ``deviation``, ``span``, ``slope_deviation``, ``roughness``, ``entropy``, ``correlation_m``
        statistics of Γ_UU, or for a gravimeter of the gravity disturbance;
        :class:`~.statistics.Statistics` defines them and their units;
    ``fractal_dimension``
        fractal dimension of the same quantity on 64 × 64 nodes;
    ``information_m``, ``isotropy``
        √tr J⁻¹ and λ_min/λ_max of J. J is the Fisher information of the measurements in a square
        kilometre, averaged over the cell;
    ``track_m``, ``best_track_m``, ``best_heading_deg``
        √tr J⁻¹ of the measurements along a track: root mean square over all headings, smallest
        value, and heading of the smallest value;
    ``ambiguity``, ``ambiguity_heading_deg``
        smallest ambiguity A_min (:func:`~.information.least`) over all headings, and the heading
        with this ambiguity;
    ``false_fix``
        predicted share of false fixes: the union bound :func:`~.information.false_fix_bound` plus
        the probability :func:`~.information.spill`, at most 1, averaged over the headings;
    ``index``, ``grade``
        index and grade from principal components. If there are too few cells, the index is NaN and
        the grade is "".

    Raises
    ------
    MapError
        If the map does not contain the height of the tracks, or a cell with its surroundings; if
        there are too many cells; if a cell has too few or too many nodes.
    """
    import pandas as pd  # not at the top: it loads slowly

    cells, design = cells_of(field, design, bounds or Bounds(), name)
    draped, field = field.is_draped, field.flattened()
    table = pd.DataFrame([score_cell(field, cell, design) for cell in cells])
    components = principal_components({key: table[key].to_numpy() for key in table})
    if components is None:
        table["index"], table["grade"] = math.nan, ""
    else:
        table["index"], table["grade"] = components.index, grades(components.index)
    return Scored(design, table, components, draped)


def cells_of(field: Field, design: Design, bounds: Bounds, name: str) -> tuple[list[Cell], Design]:
    """Return the cells of a map, row by row from the south, and the design with its defaults.

    A margin along the border of the map contains no cells. Its width is the largest displacement of
    a track, plus the length by which a track extends beyond its cell on one side.

    Raises
    ------
    MapError
        Under the same conditions as in :func:`score`.
    """
    if not field.has_map:
        raise MapError("the normal field has no map to score")
    above = ABOVE_BASE if field.is_draped else ""
    return cells_between(field.lower, field.upper, design, bounds, name, above)


def cells_between(
    lower: Array, upper: Array, design: Design, bounds: Bounds, name: str, above: str = ""
) -> tuple[list[Cell], Design]:
    """Return the results of :func:`cells_of` for a map that is given by two of its nodes.

    ``lower`` and ``upper`` (3,) are the first and the last node of the map [rad, rad, m]. ``above``
    is appended to heights in messages, for example " above the base surface".

    Raises MapError if the height or the cells are not within the map.
    """
    height = float(lower[2]) if design.height_m is None else design.height_m
    if not lower[2] - _ROUNDING <= height <= upper[2] + _ROUNDING:
        heights = f"{lower[2]:g} to {upper[2]:g} m{above}"
        raise MapError(f"the height {height:g} m is outside {name}, which has {heights}")
    farthest = max(abs(lower[0]), abs(upper[0]))
    metres = np.array(metres_per_radian(np.array([farthest, 0.0, height])))
    side = math.radians(design.cell_deg) * float(metres.min())
    design = _completed(dataclasses.replace(design, height_m=height), side)
    jutting = max(0.0, 0.5 * ((design.track_m or 0.0) - side))
    margin = (design.reach + jutting) / metres
    low, high = np.degrees(lower[:2] + margin), np.degrees(upper[:2] - margin)
    area = Area(*bounds).about(0.5 * float(low[1] + high[1]))
    for axis, (start, end) in enumerate((area[:2], area[2:])):
        low[axis] = low[axis] if start is None else max(low[axis], start)
        high[axis] = high[axis] if end is None else min(high[axis], end)
    size = design.cell_deg
    counts = np.floor((high - low) / size + _ROUNDING).astype(int)
    if counts.min() < 1:
        across = (upper[:2] - lower[:2]) * metres / 1e3
        raise MapError(
            f"no cell of {size:g}° with a margin of {(design.reach + jutting) / 1e3:.3g} km fits "
            f"into {name} ({across[0]:.3g} km by {across[1]:.3g} km): give a smaller --cell-deg, "
            "--sigma-km or --track-km. The margin is three standard deviations of the position, "
            "plus the part of the track beyond the cell"
        )
    if counts.prod() > _MOST_CELLS:
        raise MapError(
            f"{name} contains {counts[0]} by {counts[1]} cells of {size:g}°; at most "
            f"{_MOST_CELLS} are allowed: give larger cells, or bounds"
        )
    south, west = 0.5 * (low + high - counts * size)
    return [
        Cell(
            float(south + i * size),
            float(south + (i + 1) * size),
            float(west + j * size),
            float(west + (j + 1) * size),
        )
        for i in range(counts[0])
        for j in range(counts[1])
    ], design


def _completed(design: Design, side: float) -> Design:
    """Return the design with defaults in place of None; its height must be set.

    ``side`` is the shortest side of all cells [m]. Raise MapError if a cell has too few or too many
    nodes.
    """
    spacing = side / 50.0 if design.spacing_m is None else design.spacing_m
    if not stats.FEWEST_NODES - 1 <= side / spacing <= _MOST_NODES:
        raise MapError(
            f"a cell of {design.cell_deg:g}° is {side / 1e3:.3g} km wide; with nodes "
            f"{spacing:g} m apart it does not have {stats.FEWEST_NODES} to {_MOST_NODES} nodes "
            "along a side"
        )
    track = side if design.track_m is None else design.track_m
    return dataclasses.replace(design, spacing_m=spacing, track_m=track, right_m=design.right)


def score_cell(field: Field, cell: Cell, design: Design) -> dict[str, float]:
    """Return the scores of one cell, without index and grade; ``design`` must be complete."""
    assert design.spacing_m is not None
    assert design.height_m is not None
    nodes, east_m, north_m = _nodes(cell, design.height_m, design.spacing_m)
    instrument = design.instrument
    scalar = _scalar(field, instrument, nodes)
    row: dict[str, float] = {f"{name}_deg": bound for name, bound in cell._asdict().items()}
    row |= stats.statistics(scalar, east_m, north_m)._asdict()
    square = _nodes(cell, design.height_m, None)[0]
    row["fractal_dimension"] = stats.fractal_dimension(_scalar(field, instrument, square))
    flat = nodes.reshape(-1, 3)
    per_reading = info.information(instrument.jacobians(field, flat)) / len(flat)
    row["information_m"] = info.accuracy(design.per_km2 * per_reading)
    row["isotropy"] = info.isotropy(per_reading)
    return row | _along_tracks(field, cell, design)


def _along_tracks(field: Field, cell: Cell, design: Design) -> dict[str, float]:
    grid = info.offsets(design.reach, design.reach / _STEPS)
    accuracies, least, false = [], [], []
    for _, track in tracks(cell, design):
        information = info.information(design.instrument.jacobians(field, track))
        accuracies.append(info.accuracy(information))
        ambiguities = info.ambiguity(field, design.instrument, track, grid)
        least.append(info.least(ambiguities, grid, design.right, design.reach))
        false.append(
            info.false_fix_bound(ambiguities, grid, design.right, design.reach, design.sigma_m)
            + info.spill(information, design.right, design.sigma_m)
        )
    best, doubted = int(np.argmin(accuracies)), int(np.argmin(least))
    return {
        "track_m": math.sqrt(float(np.mean(np.square(accuracies)))),
        "best_track_m": accuracies[best],
        "best_heading_deg": HEADINGS[best],
        "ambiguity": least[doubted],
        "ambiguity_heading_deg": HEADINGS[doubted],
        "false_fix": min(1.0, float(np.mean(false))),
    }


def tracks(cell: Cell, design: Design) -> Iterator[tuple[float, Array]]:
    """Yield heading [deg] and positions (N, 3) [rad, rad, m] of straight tracks.

    The tracks pass through the centre of the cell.
    """
    assert design.track_m is not None
    assert design.height_m is not None
    along = np.linspace(-0.5, 0.5, design.readings)[:, np.newaxis] * design.track_m
    centre = np.array([*np.radians(cell.centre), design.height_m])
    for heading in HEADINGS:
        turned = math.radians(heading)
        yield heading, info.moved(centre, along * (math.sin(turned), math.cos(turned)))


def _nodes(cell: Cell, height: float, spacing: float | None) -> tuple[Array, float, float]:
    """Return positions (m, n, 3) [rad, rad, m] of nodes in a cell, and their spacings [m].

    The spacings to the east and to the north are close to ``spacing`` [m]. If this is None, each
    side has 64 nodes.
    """
    centre = np.array([*np.radians(cell.centre), height])
    axes, steps = [], []
    for low, high, metres in zip(cell[::2], cell[1::2], metres_per_radian(centre), strict=True):
        side = math.radians(high - low) * metres
        count = stats.FRACTAL_NODES if spacing is None else round(side / spacing) + 1
        axes.append(np.radians(np.linspace(low, high, count)))
        steps.append(side / (count - 1))
    latitude, longitude = np.meshgrid(*axes, indexing="ij")
    positions = np.stack([latitude, longitude, np.full(latitude.shape, height)], axis=-1)
    return positions, steps[1], steps[0]


def _scalar(field: Field, instrument: info.Instrument, nodes: Array) -> Array:
    """Return the scalar field (m, n) for the statistics, without the normal field.

    It is Γ_UU [E], or for a gravimeter −δg_U [mGal].
    """
    axes = np.moveaxis(nodes, -1, 0)
    if instrument.kind == "gravity":
        return np.asarray(-info.MGAL * field.gravity_disturbance(*axes)[..., 2])
    return field.vertical_disturbance(*axes)
