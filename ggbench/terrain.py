"""Terrain."""
from __future__ import annotations
from dataclasses import dataclass
import numpy as np
from .errors import GGBenchError
class TerrainError(GGBenchError):
    """A terrain cannot be read, or gives no field as asked."""
@dataclass(frozen=True, eq=False)
class Terrain:
    south_deg: float
    west_deg: float
    latitude_step_deg: float
    longitude_step_deg: float
    height_m: np.ndarray
    name: str
    @property
    def latitudes_deg(self): return self.south_deg + self.latitude_step_deg*np.arange(self.height_m.shape[0])
    @property
    def longitudes_deg(self): return self.west_deg + self.longitude_step_deg*np.arange(self.height_m.shape[1])
