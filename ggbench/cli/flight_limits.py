"""Checks of flights for ``ggbench validate`` and ``run``: extremes, and margins inside maps.

A map is built from a recipe, which also contains the limits of the map. Therefore these checks
build a map only if it is draped over the ground, or if the scenario adds errors to it. No run is
simulated, with one exception: if a flight may leave its map or exceeds a limit, run 0 is simulated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from ..campaign.campaign import case_named
from ..campaign.flights import first_problem
from ..display.compiling import fields_of, tell_maps
from ..judging.field_scale import correlation_m
from ..maps import recipe
from ..recorded.motion import angles_of
from ..sensors.gradiometer.instrument import COMPONENTS
from ..simulation.field_source import beside, is_file, make_field, map_recipe, map_version
from ..simulation.formulation import require_short_delays
from ..simulation.ins_error import InsError, inertial_alone, ins_error
from ..simulation.instruments import faults, spinning_disks
from ..simulation.sensor_suite import SensorSuite
from ..simulation.suites import suite_of_case
from ..simulation.true_motion import trajectory_of
from ..spec.case import CaseSpec
from ..spec.limits import FASTEST_MPS, HIGHEST_M, LOWEST_M
from ..spec.scenario import Scenario
from ..spec.sensors import FieldSpec
from ..spec.trajectory import TrajectorySpec, file_versions
from ..trajectory.truth import Trajectory
from .map_margins import Bounds, Margin, Shortfall, margin_of, shortfalls


@dataclass(frozen=True)
class FlightExtremes:
    """Extremes of a flight.

    Attributes
    ----------
    vehicle : ``aircraft`` or ``ship``.
    track : whether the flight follows a track of positions.
    duration : duration [s].
    length : distance over ground [m].
    speeds : lowest and highest speed [m/s].
    heights : lowest and highest height above the ellipsoid [m].
    bank, bank_time : largest absolute bank angle [rad], and the first time at which it occurs [s].
    pitch : largest absolute pitch angle [rad].
    across, vertical : largest absolute lateral and vertical acceleration [m/s²].
    remark : remark on the conversion of heights; may be empty.
    """

    vehicle: str
    track: bool
    duration: float
    length: float
    speeds: tuple[float, float]
    heights: tuple[float, float]
    bank: float
    bank_time: float
    pitch: float
    across: float
    vertical: float
    remark: str = ""


@dataclass(frozen=True)
class Examined:
    """Examination of a case that can be flown.

    Attributes
    ----------
    study : assumption (group of cases) of the case; "" for a case without an assumption.
    case : the case.
    flown : extremes of the flight of the case.
    margin : margin inside the true map or inside the assumed map, the smaller of the two; None
        without a map.
    readings : number of measurements of each sensor, by name.
    ins : error of the INS without aiding.
    narrow : margins inside the assumed map that are too narrow for the INS error.
    """

    study: str
    case: CaseSpec
    flown: FlightExtremes
    margin: Margin | None
    readings: dict[str, int]
    ins: InsError
    narrow: tuple[Shortfall, ...]

    @property
    def inside(self) -> bool:
        """Whether the flight stays inside all maps."""
        return self.margin is None or self.margin.least >= 0.0

    @cached_property
    def correlation_m(self) -> float:
        """Correlation length of the field along the track [m], computed on demand.

        The length is NaN if the case has no gradiometer or no map. It is also NaN if the flight
        leaves a map, or if the true map is not built yet.
        """
        return _correlation(self.case) if self.inside else math.nan

    @property
    def name(self) -> str:
        """Name of the case; ``STUDY/CASE`` for a case in the study of an assumption."""
        return f"{self.study}/{self.case.name}" if self.study else self.case.name


def examined(scenario: Scenario) -> Iterator[Examined]:
    """Examine every case of a scenario and of its assumptions.

    Raise CampaignError, as :func:`.campaign.check` does, if a map cannot be built, a flight leaves
    a map, or the model of a sensor cannot be computed.
    """
    for study, case in scenario.every_case():
        with case_named(scenario, study, case):
            examination = _examined(study, case)
            if not _clear(examination):
                tell_maps(fields_of([case]))
                first_problem(case, 0)
        yield examination


def _examined(study: str, case: CaseSpec) -> Examined:
    if case.trajectory.files():
        case.check_duration()
    fields = [case.side(name).field for name in ("truth", "model")]
    bounds = [_bounds(field, map_version(field)) for field in fields]
    for name in ("truth", "model"):
        suite_of_case(case, name)
    faults(case.truth.gradiometer)
    spinning_disks(case)
    trajectory = _trajectory(case)
    samples = len(trajectory.times) - 1
    readings = {sensor: samples // stride for sensor, stride in case.strides.items()}
    if case.gradiometer is not None:
        altimeter = math.inf if case.altimeter is None else case.altimeter.time_constant_s
        require_short_delays(suite_of_case(case, "model"), altimeter, readings["gradiometer"])
    margins = [margin_of(trajectory, each) for each in bounds if each.finite]
    nearest = min(margins, key=lambda m: m.least, default=None)
    error, assumed = ins_error_of(case), bounds[1]
    narrow = shortfalls(case, trajectory, assumed, error) if assumed.finite else ()
    return Examined(
        study=study,
        case=case,
        flown=flown_of(case),
        margin=nearest,
        readings=readings,
        ins=error,
        narrow=narrow,
    )


def _correlation(case: CaseSpec) -> float:
    """Return the field's correlation length along the track [m].

    It is NaN without a gradiometer or a map, or if the map is not built yet.
    """
    spec = case.side("truth").field
    if case.gradiometer is None or spec.source == "normal":
        return math.nan
    if not (is_file(spec.source) or recipe.cached_path(recipe.checked(map_recipe(spec))).exists()):
        return math.nan
    read = _trajectory(case).positions[:: case.strides["gradiometer"]]
    field = beside(make_field(spec), float(read[0, 1]))
    return correlation_m(read, field.tensor(*read.T)[:, COMPONENTS.index("zz")])


def _clear(examination: Examined) -> bool:
    """Return whether the extremes and margins of a flight are within the limits."""
    (lowest, highest), (_, fastest) = examination.flown.heights, examination.flown.speeds
    possible = lowest >= LOWEST_M and highest <= HIGHEST_M and fastest <= FASTEST_MPS
    return possible and examination.inside


@lru_cache(maxsize=64)
def _bounds(spec: FieldSpec, version: tuple[int, int]) -> Bounds:
    """Return the limits of a map; ``version`` is from :func:`.map_version`.

    The limits of a map that is not built are those in its recipe; its nodes extend at least as far.
    """
    if spec.source == "normal" or is_file(spec.source) or spec.error is not None or spec.drape:
        # Errors ask for the nodes of the right map, and only a draped map has its base.
        if spec.error is not None or spec.drape:
            tell_maps([spec])
        field = make_field(spec)
        return Bounds(field.lower, field.upper, field.step, field)
    made_recipe = recipe.checked(map_recipe(spec))
    degrees = [
        [made_recipe.south_deg, made_recipe.west_deg],
        [made_recipe.north_deg, made_recipe.east_deg],
    ]
    lower, upper = np.radians(degrees)
    lowest, highest = made_recipe.min_height_m, made_recipe.max_height_m
    nodes = np.repeat(math.radians(made_recipe.spacing_arcmin / 60.0), 2)
    step = np.append(nodes, made_recipe.height_spacing_m)
    return Bounds(np.append(lower, lowest), np.append(upper, highest), step)


def _trajectory(case: CaseSpec) -> Trajectory:
    return _trajectory_once(case.trajectory, case.imu.period_s, file_versions(case.trajectory))


@lru_cache(maxsize=8)
def _trajectory_once(spec: TrajectorySpec, dt: float, versions: tuple[object, ...]) -> Trajectory:
    """Return the trajectory of a table, cached by the versions of the table's input files."""
    return trajectory_of(spec, dt)


def ins_error_of(case: CaseSpec) -> InsError:
    """Return the error of the unaided INS of a case, with the true IMU errors."""
    alone = inertial_alone(suite_of_case(case, "truth"))
    return _ins_error_once(
        alone, case.trajectory, case.imu.period_s, file_versions(case.trajectory)
    )


@lru_cache(maxsize=64)
def _ins_error_once(
    suite: SensorSuite, spec: TrajectorySpec, dt: float, versions: tuple[object, ...]
) -> InsError:
    return ins_error(suite, _trajectory_once(spec, dt, versions))


def flown_of(case: CaseSpec) -> FlightExtremes:
    """Return the extremes of a case's flight.

    Raise TrajectoryError if the flight is impossible, or a file is invalid.
    """
    spec, trajectory = case.trajectory, _trajectory(case)
    velocities, heights = trajectory.velocities, trajectory.positions[:, 2]
    level, speeds = np.hypot(*velocities[:, :2].T), np.linalg.norm(velocities, axis=1)
    accelerations = np.diff(velocities, axis=0) / trajectory.dt
    east, north, _ = (0.5 * (velocities[1:] + velocities[:-1])).T
    across = (north * accelerations[:, 0] - east * accelerations[:, 1]) / np.maximum(
        np.hypot(east, north), 1.0
    )
    _, pitch, bank = np.abs(angles_of(trajectory.attitudes)).T
    return FlightExtremes(
        vehicle=spec.vehicle,
        track=spec.file is not None,
        duration=float(trajectory.times[-1]),
        length=float(0.5 * (level[1:] + level[:-1]).sum() * trajectory.dt),
        speeds=(float(speeds.min()), float(speeds.max())),
        heights=(float(heights.min()), float(heights.max())),
        bank=float(bank.max()),
        bank_time=float(trajectory.times[bank.argmax()]),
        pitch=float(pitch.max()),
        across=float(np.abs(across).max()),
        vertical=float(np.abs(accelerations[:, 2]).max()),
        remark=spec.track().remark if spec.file is not None else "",
    )
