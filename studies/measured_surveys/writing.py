"""Tables as compressed text, the same bytes each time."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pandas as pd

DECIMALS = {"time_s": 2, "latitude_deg": 6, "longitude_deg": 6, "height_m": 1}
_USUAL = 2  # 0.01 E, 0.01 mGal, 0.01 m/s


def write(path: Path, table: pd.DataFrame) -> None:
    """Write a table, each number with the decimals that mean something."""
    written = pd.DataFrame(index=table.index)
    for name, values in table.items():
        if values.dtype.kind == "f":
            decimals = DECIMALS.get(str(name), _USUAL)
            values = [f"{value:.{decimals}f}" for value in np.round(values, decimals) + 0.0]
        written[name] = values
    text = written.to_csv(index=False, lineterminator="\n")
    path.write_bytes(gzip.compress(text.encode("ascii"), compresslevel=9, mtime=0))
