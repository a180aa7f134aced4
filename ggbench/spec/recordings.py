"""Tables of recorded files."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from . import quantities as q
from .columns import ColumnNames
from .tables import Section

FileName = Annotated[str, Field(min_length=1)]
Frame = Literal["ENU", "NED"]


class Recording(Section):
    """A table with a recorded file."""

    file: FileName
    """Path of the record, relative to the file of the flight."""
    clock_offset_s: q.TimeShift = 0.0
    """Offset added to the times of the file, to give the clock of the INS."""
    columns: ColumnNames | None = None
    """Column names of the file, `{ time_s = "stamp [us]" }`; or `euroc`, `px4` or `ros`."""


class ReadingsRecording(Recording):
    """A recorded file of measurements."""

    outside: Literal["refuse", "drop"] = "refuse"
    """Treatment of measurements before the first sample of the INS or after the last."""
