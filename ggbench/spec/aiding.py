"""What a scenario file may say of the sensors beside the gradiometer.

``[gnss]``, ``[velocity_log]``, ``[barometer]`` and ``[gravimeter]`` hold for the simulated truth
and for what the estimators are told; ``[truth.gnss]`` and the like change them for the truth alone,
and say what happens to readings that no estimator is told of; ``[model.gnss]`` and the like change
them for the estimators alone. ``[further.<name>]`` has the keys of the table of its kind, which
each class knows (:mod:`.further`).
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from .quantities import (
    GravimeterBias,
    GravimeterNoise,
    HeightBias,
    HeightNoise,
    LogBias,
    Moment,
    Outlier,
    PositionNoise,
    ReadingPeriod,
    Share,
    TimeConstant,
    VelocityNoise,
)
from .tables import Listed, Section

Interval = Annotated[Listed[Moment], Field(min_length=2, max_length=2)]

_HOW_OUTLIERS_COME = ("outlier_share", "outlier_burst_s", "outlier_channels")
"""Keys of outliers that do not say how large they are."""


class Interruptions(Section):
    """Readings that do not come, or are wrong, of any sensor."""

    outlier_share: Share = 0.0
    dropout_share: Share = 0.0
    dropouts_s: Listed[Interval] = ()

    @model_validator(mode="after")
    def _check(self) -> Interruptions:
        keys = [key for key in type(self).model_fields if key.startswith("outlier_")]
        sizes = [key for key in keys if key not in _HOW_OUTLIERS_COME]
        if (self.outlier_share > 0.0) != any(getattr(self, key) > 0.0 for key in sizes):
            raise ValueError(f"outlier_share and {' or '.join(sizes)} go together")
        for start, end in self.dropouts_s:
            if not start < end:
                raise ValueError(
                    f"dropouts_s must be [from, to] with from < to, found [{start:g}, {end:g}]"
                )
        return self


class GnssChange(Section):
    """``[model.gnss]``: what the estimators believe of the GNSS receiver."""

    kind: ClassVar[str] = "gnss"
    position_noise_m: PositionNoise | None = None
    height_noise_m: PositionNoise | None = None
    velocity_noise_mps: VelocityNoise | None = None


class TrueGnss(GnssChange, Interruptions):
    """``[truth.gnss]``: the receiver as it is; outages are ``dropouts_s``."""

    outlier_m: Outlier = 0.0
    outlier_mps: Outlier = 0.0


class GnssSpec(GnssChange):
    """``[gnss]``: position, velocity or both, each with white noise per axis."""

    period_s: ReadingPeriod

    @model_validator(mode="after")
    def _check(self) -> GnssSpec:
        if self.position_noise_m is None and self.velocity_noise_mps is None:
            raise ValueError("give position_noise_m, velocity_noise_mps, or both")
        if self.position_noise_m is None and self.height_noise_m is not None:
            raise ValueError("height_noise_m needs position_noise_m")
        return self


class LogChange(Section):
    """``[model.velocity_log]``: what the estimators believe of the log."""

    kind: ClassVar[str] = "velocity_log"
    noise_mps: VelocityNoise | None = None
    bias_mps: LogBias | None = None
    bias_time_s: TimeConstant | None = None


class TrueLog(LogChange, Interruptions):
    """``[truth.velocity_log]``: the log as it is."""

    outlier_mps: Outlier = 0.0


class LogSpec(LogChange):
    """``[velocity_log]``: a Doppler or electromagnetic log, in axes of the body or of ENU.

    A bias with a time constant is a Gauss–Markov process (a current, for a log through the water);
    without one it is constant.
    """

    period_s: ReadingPeriod
    noise_mps: VelocityNoise
    bias_mps: LogBias = 0.0
    frame: Literal["body", "local-level"] = "body"
    components: Annotated[Listed[Literal["x", "y", "z"]], Field(min_length=1)] = ("x", "y")

    @model_validator(mode="after")
    def _check(self) -> LogSpec:
        if len(set(self.components)) != len(self.components):
            raise ValueError("components names an axis twice")
        return self


class BarometerChange(Section):
    """``[model.barometer]``: what the estimators believe of the height."""

    kind: ClassVar[str] = "barometer"
    noise_m: HeightNoise | None = None
    bias_m: HeightBias | None = None
    bias_time_s: TimeConstant | None = None


class TrueBarometer(BarometerChange, Interruptions):
    """``[truth.barometer]``: the height as it is."""

    outlier_m: Outlier = 0.0


class BarometerSpec(BarometerChange):
    """``[barometer]``: a height, of the air's pressure or of a known sea level."""

    period_s: ReadingPeriod
    noise_m: HeightNoise
    bias_m: HeightBias = 0.0


class GravimeterChange(Section):
    """``[model.gravimeter]``: what the estimators believe of the gravimeter."""

    kind: ClassVar[str] = "gravimeter"
    noise_mgal: GravimeterNoise | None = None
    bias_mgal: GravimeterBias | None = None
    bias_time_s: TimeConstant | None = None


class TrueGravimeter(GravimeterChange, Interruptions):
    """``[truth.gravimeter]``: the gravimeter as it is."""

    outlier_mgal: Outlier = 0.0


class GravimeterSpec(GravimeterChange):
    """``[gravimeter]``: the gravity disturbance, of its size (``scalar``) or as a vector.

    Reduced with the position and velocity that the INS indicates: their errors are in the reading.
    """

    period_s: ReadingPeriod
    noise_mgal: GravimeterNoise
    bias_mgal: GravimeterBias = 0.0
    components: Annotated[Listed[Literal["scalar", "east", "north"]], Field(min_length=1)] = (
        "scalar",
    )

    @model_validator(mode="after")
    def _check(self) -> GravimeterSpec:
        if len(set(self.components)) != len(self.components):
            raise ValueError("components names a component twice")
        return self


AIDING = ("gnss", "velocity_log", "barometer", "gravimeter")
"""The kinds of these sensors, and their tables, in the order of their channels and biases."""
