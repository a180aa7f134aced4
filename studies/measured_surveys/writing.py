"""Files of a shipped survey: table, point masses of the map, noise model."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from ggbench.maps.equivalent_sources import Equations, EquivalentSources, Plane, Settings
from ggbench.maps.survey_error import map_error
from ggbench.maps.survey_fit import FitOptions
from ggbench.maps.survey_lines import Quantity, SurveyLines
from ggbench.maps.survey_noise import noise_of
from ggbench.maps.survey_plan import SurveyInputs, fit_survey, provenance_of

DECIMALS = {"time_s": 2, "latitude_deg": 6, "longitude_deg": 6, "height_m": 1}
_PARALLELS = 4  # number of copies of a profile on each side
_USUAL = 2  # decimals of other columns: 0.01 E, 0.01 mGal


def write(path: Path, table: pd.DataFrame) -> None:
    """Write a table as a compressed CSV file, with the significant decimals of each column."""
    written = pd.DataFrame(index=table.index)
    for name, values in table.items():
        if values.dtype.kind == "f":
            decimals = DECIMALS.get(str(name), _USUAL)
            values = [f"{value:.{decimals}f}" for value in np.round(values, decimals) + 0.0]
        written[name] = values
    text = written.to_csv(index=False, lineterminator="\n")
    path.write_bytes(gzip.compress(text.encode("ascii"), compresslevel=9, mtime=0))


def sources_of_a_profile(lines: SurveyLines, settings: Settings) -> EquivalentSources:
    """Return point masses of passes over one line; their field is constant across the line.

    Masses under the passes alone would have a field that decreases on both sides. The map would
    then reveal the position of the line. The passes are therefore repeated on both sides, at
    distances of ``depth_m``.
    """
    plane = Plane.under(lines)
    east, north, _ = plane.metres(lines)
    along = np.linalg.svd(np.stack([east, north]) - [[east.mean()], [north.mean()]])[0][:, 0]
    north_m, east_m = plane.metres_per_degree
    copies = []
    for number in range(-_PARALLELS, _PARALLELS + 1):
        off = number * settings.depth_m * np.array([-along[1], along[0]])
        copies.append(
            replace(
                lines,
                line=lines.line + len(lines.names) * (number + _PARALLELS),
                longitude_deg=lines.longitude_deg + off[0] / east_m,
                latitude_deg=lines.latitude_deg + off[1] / north_m,
            )
        )
    wide = replace(
        lines,
        names=lines.names * len(copies),
        kinds=lines.kinds * len(copies),
        **{
            name: np.concatenate([getattr(copy, name) for copy in copies])
            for name in ("line", "time_s", "latitude_deg", "longitude_deg", "height_m", "values")
        },
    )
    equations = Equations(wide, settings.depth_m, settings.spacing_m)
    return equations.solved(*equations.of(range(len(wide.names))), settings.damping)


def write_map(
    folder: Path,
    name: str,
    survey: str,
    leave_out: tuple[str, ...],
    fit_options: FitOptions,
    quantity: Quantity,
) -> None:
    """Write the point masses of a survey map, and the noise model of its gradients.

    The lines are read from the shipped file in the folder. A noise model is written only for the
    map with the name of the survey.
    """
    inputs = SurveyInputs(
        folder / f"{survey}.csv.gz",
        {},
        leave_out=leave_out,
        fit_options=fit_options,
        quantity=quantity,
    )
    fit = fit_survey(inputs, print)
    lines, sources = fit.lines, fit.sources
    if quantity == "disturbance":
        sources = sources_of_a_profile(lines, fit.settings)
    error, distance = map_error(fit)
    np.savez_compressed(
        folder / f"{name}_masses.npz",
        plane=np.array([sources.plane.latitude_deg, sources.plane.longitude_deg]),
        places=sources.places.round(1),
        masses=sources.masses.astype(np.float32),
        standard_error=error.round(7),
        error_distance=distance.round(1),
        bounds=np.array(
            [
                lines.latitude_deg.min(),
                lines.latitude_deg.max(),
                lines.longitude_deg.min(),
                lines.longitude_deg.max(),
            ]
        ),
        depth_m=np.array(fit.settings.depth_m),
    )
    if quantity == "disturbance" or name != survey:  # a gravimeter's noise is white
        return
    model, scores = noise_of(fit)
    print({order: round(score, 4) for order, score in scores.items()})
    noise = replace(model, provenance=provenance_of(inputs, fit, model.order))
    noise.write(folder / f"{name}_noise.json")
