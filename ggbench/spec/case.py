"""Tables of a case.

The name of a key contains the unit. A rule on several keys is checked in the table that contains
all of them.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, Any, Literal

from pydantic import (
    Field,
    PrivateAttr,
    ValidationError,
    model_validator,
)

from ..trajectory.manoeuvres import TrajectoryError
from . import quantities as q
from .aiding import KINDS, AidingSpec, GnssSpec, GravimeterSpec
from .draws import DrawSpec, drawn_track
from .gradiometer import GradiometerSpec
from .merging import changed, laid_over
from .named_sensors import (
    NO_SENSORS,
    NamedSensors,
    WithSensors,
    not_on_board,
    sensors_of,
    table_of,
)
from .sensors import (
    AltimeterSpec,
    FieldSpec,
    ImuSpec,
    InitialErrorSpec,
    MapErrorChange,
    MapErrorSpec,
    ModelSpec,
    Side,
    TruthSpec,
)
from .tables import Section, Title, nested
from .trajectory import TrajectorySpec
from .validation_messages import ScenarioError, validate

CaseName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=60)]
_MAP_ERROR_DEFAULTS = MapErrorSpec().model_dump()
_FIRST_REGULARIZATION = 1e-6
"""The whitening_regularization of cases that name none, for their identity."""
MOST_SAMPLES = 2_000_000
"""Most IMU samples of a flight (about 2 GB of intermediate matrices at a million)."""


class WindowsSpec(Section):
    """``[windows]``: windows over which errors are averaged, and the required final error."""

    settled_from_s: q.Moment
    """Start of the settled window, which lasts to the end of the flight."""
    last_s: q.Duration
    """Length of the last window, at the end of the flight."""
    required_m: q.PositionTarget | None = None
    """Largest 3-D position error at the end of a successful run.

    Without it: three times the RMS bound of a filter over the last window. A run has *converged* at
    the first epoch from which the error stays below this value. A *false fix* is a run that ends
    with a larger error, although its reported 95 % radius is smaller than this value.
    """


class ReferenceSpec(Section):
    """``case.reference``: published errors of a case, which reports compare with the results."""

    position_mrse_m: q.PositionTarget
    """Published root-mean-square position error."""
    velocity_mrse_mps: q.VelocityTarget
    """Published root-mean-square velocity error."""


def require_sensors(tables: Any, mapless: bool) -> None:
    """Raise ValueError if there is no sensor, or if there is a gravimeter but no map.

    ``tables`` has the tables of the sensors as attributes. If ``mapless`` is True, there is no map.
    """
    if not sensors_of(tables):
        raise ValueError(
            f"no sensor is on board: give at least one of gradiometer, {', '.join(KINDS)}, sensor"
        )
    for name, spec in tables.sensor.items():
        if mapless and isinstance(spec, GravimeterSpec):
            raise ValueError(
                f'{table_of(name)} needs a map: source = "normal" has no gravity disturbance'
            )


def _changed(key: str, table: Any, change: Any) -> Any:
    """Return a table of a case with the changes of truth or model.

    ``key`` is the dotted key of the changes in the scenario file.

    Raises
    ------
    ValueError
        If the changes break a rule, or change a table that the case does not have.
    """
    if table is None:
        if change.model_dump(exclude_defaults=True):
            raise not_on_board(key)
        return None
    if change is None:
        return table
    if isinstance(table, GnssSpec):
        for noise in ("position_noise_m", "velocity_noise_mps"):
            if getattr(table, noise) is None and getattr(change, noise) is not None:
                raise ValueError(f"{key}.{noise} requires channels that the receiver does not have")
    try:
        return changed(table, change)
    except ValidationError as error:
        flaw = error.errors()[0]
        message = flaw.get("ctx", {}).get("error", flaw["msg"])
        raise ValueError(f"{key}: {message}") from None


class CaseSpec(WithSensors):
    """``[[case]]``: a case to compare; its keys replace the keys of the tables of the file.

    An object of this class contains all tables of the file, with the changes of the case.
    """

    name: CaseName
    """Letters, digits, `.`, `_`, `-`."""
    title: Title
    """Title in tables and figures."""
    trajectory: TrajectorySpec
    imu: ImuSpec
    initial_error: InitialErrorSpec
    field: FieldSpec
    windows: WindowsSpec
    draw: DrawSpec = DrawSpec()
    gradiometer: GradiometerSpec | None = None
    sensor: NamedSensors[AidingSpec] = NO_SENSORS
    altimeter: AltimeterSpec | None = None
    truth: TruthSpec = TruthSpec()
    model: ModelSpec = ModelSpec()
    reference: ReferenceSpec | None = None
    _seed: int = PrivateAttr(default=1)

    @model_validator(mode="after")
    def _check(self) -> CaseSpec:
        for name in ("truth", "model"):
            self.side(name)  # raises if what it changes breaks a rule
        felt = self.side("truth").field
        require_sensors(self, felt.source == "normal")
        constant = any(self.truth.field.constant_disturbance_mgal)
        if felt.gravity_disturbance and felt.source == "normal" and not constant:
            raise ValueError(
                'gravity_disturbance needs a map: source = "normal" has no disturbance'
            )
        if constant and not felt.gravity_disturbance:
            raise ValueError(
                "truth.field.constant_disturbance_mgal requires field.gravity_disturbance = true"
            )
        if self.model.field.compensate:
            if not felt.gravity_disturbance:
                raise ValueError(
                    "model.field.compensate adds the gravity disturbance in the INS, but the "
                    "accelerometers measure none: set field.gravity_disturbance = true"
                )
            if self.side("model").field.source == "normal":
                raise ValueError(
                    'model.field.compensate needs a map: source = "normal" has no gravity '
                    "disturbance"
                )
        if self.model.field.standard_error:
            self._require_components()
        if self.model.disturbance is not None:
            if self.model.disturbance.integrate_gradients and not felt.gravity_disturbance:
                raise ValueError(
                    "model.disturbance.integrate_gradients adds a gravity disturbance in the "
                    "INS, but the accelerometers measure none: set field.gravity_disturbance = "
                    "true"
                )
            self.model.disturbance.require_integrable(
                self.side("model").gradiometer, self.model.field.compensate
            )
        true, assumed = self.side("truth").gradiometer, self.side("model").gradiometer
        if true is not None and assumed is not None:
            self.truth.gradiometer.require_possible(true)
            assumed.require_tractable()
        for name, period in self.periods.items():
            steps = period / self.imu.period_s
            if abs(steps - round(steps)) > 1e-6 or round(steps) < 1:
                raise ValueError(
                    f"{table_of(name)}.period_s ({period:g} s) must be a whole multiple of "
                    f"imu.period_s ({self.imu.period_s:g} s)"
                )
        if self.altimeter is not None:
            self.altimeter.require_slower_than(self.imu.period_s)
        if self.draw.tracks > 1 and self.trajectory.file is not None:
            raise ValueError("draw.tracks needs segments: a track from a file cannot be moved")
        if self.draw.maps > 1 and len(self.trajectory.drawn_lines) > 1:
            raise ValueError("draw.maps and several trajectory.lines exclude each other")
        for name in self.measured_sensors():
            if not self.trajectory.lines:
                raise ValueError(
                    f'{table_of(name)}.readings = "measured" needs survey lines: give '
                    "trajectory.file and trajectory.lines"
                )
            if name in self.truth.sensor:
                raise ValueError(
                    f"truth.{table_of(name)}: measured readings already contain their "
                    "errors: remove its keys"
                )
        if self.draw.maps > 1 and not self.map_errors():
            raise ValueError(
                "draw.maps needs a map error: give [field.error], [truth.field.error] or "
                "[model.field.error]"
            )
        # A track may be gone when a results folder is read; simulation.prepare checks its duration.
        if not self.trajectory.files():
            self.check_duration()
        return self

    def _require_components(self) -> None:
        """Raise ValueError if a map's standard error cannot be assigned to the channels.

        It requires a map, a local-level gradiometer and white noise.
        """
        key, model = "model.field.standard_error", self.side("model")
        if model.field.source == "normal":
            raise ValueError(f'{key} needs a map: source = "normal" has no error')
        if model.gradiometer is None or model.gradiometer.instrument != "local-level":
            raise ValueError(
                f"{key} applies to components east, north and up: it needs "
                'gradiometer.instrument = "local-level"'
            )
        if model.gradiometer.coloured_noise is not None:
            raise ValueError(
                f"{key} requires white noise: coloured noise from held-back lines already "
                "includes the errors of the map"
            )

    def __repr__(self) -> str:
        return f"CaseSpec({self.name}: {self.title!r})"

    __str__ = __repr__

    def changed(self, key: str, value: Any) -> CaseSpec:
        """Return a copy of the case in which one key has a new value.

        An example is ``case.changed("gradiometer.noise_eotvos", 1.0)``. If the key is that of a
        table, the value may be a mapping, which is merged into the table. The copy must satisfy the
        rules of scenario files.

        Parameters
        ----------
        key : str
            Dotted key as in ``[[case]]``.
        value : object
            New value.

        Raises
        ------
        ScenarioError
            If the key does not exist, or the case would break a rule.
        """
        whole = laid_over(self.model_dump(warnings=False), nested(key, value))
        case = validate(CaseSpec, whole, f"case '{self.name}' with {key} = {value!r}")
        return case.with_seed(self._seed)

    def __eq__(self, other: object) -> bool:
        """Compare the tables: the seed of the campaign is no part of a case."""
        if not isinstance(other, CaseSpec):
            return NotImplemented
        fields = type(self).model_fields
        return all(getattr(self, name) == getattr(other, name) for name in fields)

    @property
    def seed(self) -> int:
        """Seed of the scenario's campaigns; 1 for a case without a scenario."""
        return self._seed

    def with_seed(self, seed: int) -> CaseSpec:
        """Set the seed of the scenario's campaigns, and return this case itself."""
        self._seed = seed
        return self

    def model_copy(
        self, *, update: Mapping[str, Any] | None = None, deep: bool = False
    ) -> CaseSpec:
        """Return a copy in which some tables are replaced, without validation.

        Raises
        ------
        ScenarioError
            If a key of ``update`` is not a top-level key of a case. For dotted keys use
            :meth:`changed`.
        """
        for key in update or {}:
            if key not in type(self).model_fields:
                raise ScenarioError(
                    f"'{key}' is not a table of a case; to change one key, use "
                    "case.changed('table.key', value)"
                )
        return super().model_copy(update=update, deep=deep)

    @property
    def periods(self) -> dict[str, float]:
        """Measurement interval [s] of each sensor, by name."""
        return {name: spec.period_s for name, spec in sensors_of(self).items()}

    @property
    def strides(self) -> dict[str, int]:
        """Measurement interval of each sensor as a number of IMU samples."""
        return {name: round(time / self.imu.period_s) for name, time in self.periods.items()}

    @property
    def tick_s(self) -> float:
        """Tick: greatest common divisor of all measurement intervals [s]."""
        return math.gcd(*self.strides.values()) * self.imu.period_s

    def check_duration(self) -> None:
        """Raise TrajectoryError (a ValueError) if the flight is too short or too long."""
        duration = self.trajectory.duration_s
        period = min(self.periods.values())
        if duration < 2.0 * period:
            raise TrajectoryError(
                f"the flight lasts {duration:g} s, too short for two measurements {period:g} s "
                "apart"
            )
        if self.windows.last_s > duration * (1.0 + 1e-9):
            raise TrajectoryError(
                f"windows.last_s is {self.windows.last_s:g} s and must not be longer than the "
                f"flight, {duration:g} s"
            )
        samples = duration / self.imu.period_s
        if samples > MOST_SAMPLES:
            raise TrajectoryError(
                f"the flight of {duration:g} s has {samples:.3g} samples of {self.imu.period_s:g} "
                f"s; at most {MOST_SAMPLES} are allowed"
            )
        last = max(time * math.floor(duration / time + 1e-9) for time in self.periods.values())
        if self.windows.settled_from_s > last:
            raise TrajectoryError(
                f"windows.settled_from_s is {self.windows.settled_from_s:g} s and must not lie "
                f"beyond the last reading, at {last:g} s"
            )

    def measured_sensors(self) -> list[str]:
        """Return the names of sensors with measured data."""
        tables = sensors_of(self).items()
        return [name for name, spec in tables if getattr(spec, "readings", "") == "measured"]

    def map_errors(self) -> dict[str, MapErrorSpec | MapErrorChange]:
        """Return the tables of map errors that the case states, by side.

        The side is ``truth`` for ``[truth.field.error]`` and ``model`` for ``[model.field.error]``.
        It is "" for ``[field.error]``, which applies to both.
        """
        fields: dict[str, Any] = {
            "": self.field,
            "truth": self.truth.field,
            "model": self.model.field,
        }
        errors = {side: field.error for side, field in fields.items()}
        return {side: error for side, error in errors.items() if error is not None}

    @property
    def drawn(self) -> bool:
        """Whether runs have different tracks, survey lines or map errors."""
        return max(self.draw.tracks, self.draw.maps, len(self.trajectory.drawn_lines)) > 1

    def cluster(self, run: int) -> int:
        """Return the index of the cluster of a run.

        Runs with equal indices form a cluster. If the case draws several map errors, the index is
        that of the run's map error. Otherwise it is that of its track or survey line. If these do
        not differ between runs either, it is the index of the run.
        """
        shared = max(self.draw.maps, self.draw.tracks, len(self.trajectory.drawn_lines))
        if self.draw.maps > 1:
            shared = self.draw.maps
        return run % shared if shared > 1 else run

    def of_run(self, run: int) -> CaseSpec:
        """Return the case with the track, survey line and map errors of a run."""
        return _of_run(self, run) if self.drawn else self

    def side(self, name: Literal["truth", "model"]) -> Side:
        """Return the sensors, field and initial errors of the truth or of the model.

        Raises
        ------
        ValueError
            If the changes of this side break a rule; the message states the table.
        """
        changes = getattr(self, name)
        tables: dict[str, Any] = {
            key: _changed(f"{name}.{key}", getattr(self, key), getattr(changes, key))
            for key in Side._fields
            if key != "sensor"
        }
        for key in changes.sensor:
            if key not in self.sensor:
                raise not_on_board(f"{name}.{table_of(key)}")
        tables["sensor"] = NamedSensors(
            {
                key: _changed(f"{name}.{table_of(key)}", table, changes.sensor.get(key))
                for key, table in self.sensor.items()
            }
        )
        return Side(**tables)

    @property
    def content_hash(self) -> str:
        """SHA-256 of all keys that affect results: all except name, title and reference."""
        # Without defaults, so that a key that is new in a later version changes nothing.
        content = self.model_dump(exclude={"name", "title", "reference"}, exclude_defaults=True)
        # Without [field.error] a side's key that has its default value changes nothing.
        for side, error in self.map_errors().items() if self.field.error is None else ():
            stated = error.model_dump(exclude_none=True).items()
            content[side]["field"]["error"] = {
                key: value for key, value in stated if value != _MAP_ERROR_DEFAULTS[key]
            }
        # A default that was another in an earlier version is named where it has an effect.
        if self.gradiometer is not None:
            content["gradiometer"].pop("whitening_regularization", None)
            regularization = self.gradiometer.whitening_regularization
            if self.gradiometer.filter != "none" and regularization != _FIRST_REGULARIZATION:
                content["gradiometer"]["whitening_regularization"] = regularization
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


@lru_cache(maxsize=4096)
def _of_run(case: CaseSpec, run: int) -> CaseSpec:
    """Return a case with the track and the map errors of a run."""
    change: dict[str, Any] = {
        "draw": DrawSpec(name=case.draw.name),
        "trajectory": drawn_track(case.trajectory, case.draw, run),
    }
    errors: Mapping[str, Any] = case.map_errors() if case.draw.maps > 1 else {}
    for side, error in errors.items():
        if error.seed is None and "" in errors:
            continue  # the side has the seed of [field.error]
        first = _MAP_ERROR_DEFAULTS["seed"] if error.seed is None else error.seed
        seeded = error.model_copy(update={"seed": first + run % case.draw.maps})
        tables = getattr(case, side) if side else case
        field = tables.field.model_copy(update={"error": seeded})
        change[side or "field"] = tables.model_copy(update={"field": field}) if side else field
    return case.model_copy(update=change)
