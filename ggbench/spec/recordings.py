"""Base classes of scenario tables that contain the path of a recording."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from . import quantities as q
from .columns import ColumnNames
from .tables import Section

FileName = Annotated[str, Field(min_length=1)]
Frame = Literal["ENU", "NED"]


class Recording(Section):
    """Base of tables with the path of a record."""

    file: FileName
    """Path of the record, relative to the flight file."""
    clock_offset_s: q.TimeShift = 0.0
    """Offset added to the times of the file to convert them to the INS clock."""
    columns: ColumnNames | None = None
    """Column names of the file, `{ time_s = "stamp [us]" }`; or `euroc`, `px4` or `ros`."""


class ReadingsRecording(Recording):
    """Base of tables with the path of a record of measurements."""

    outside: Literal["refuse", "drop"] = "refuse"
    """Treatment of measurements before the first or after the last INS sample."""
