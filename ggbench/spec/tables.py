"""What the tables of a scenario file are made of: the base of all models, and kinds of numbers."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Noise = Annotated[float, Field(ge=1e-9, le=1e9)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Latitude = Annotated[float, Field(ge=-89.0, le=89.0, allow_inf_nan=False)]
Longitude = Annotated[float, Field(ge=-180.0, le=360.0, allow_inf_nan=False)]


class Section(BaseModel):
    """Base of all tables of a scenario file: strict types, no unknown keys."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)
