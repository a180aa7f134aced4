"""Report of a recorded flight: tracks and residuals as CSV, pages and figures."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..figures import errors, flights
from ..figures.numbers import counted, short, span
from ..figures.style import Drawing, save
from ..files.writing import reason_of, written_together
from ..judging.judgement import epochs_outside
from ..problem import Estimate, Problem
from ..recorded import columns as files
from ..recorded.corrected import (
    AgainstReference,
    Residuals,
    against,
    corrected,
    corrected_samples,
    residual_columns,
    residuals,
)
from ..recorded.flight import RecordedFlight
from ..recorded.track_files import gpx_text, kml_text
from ..sensors.aiding import corrected_positions, position_error
from ..spec.flight import FlightError
from ..spec.named_sensors import sensors_of, table_of
from . import libraries, page_templates
from .tables import code, markdown, plain

WINDOW_TITLES = {
    "whole": "whole flight",
    "settled": "settled window",
    "last20": "end of the flight",
}
"""Titles of the windows of a table."""


REPORT = "report.md"
PAGE = "report.html"


def folder_of(label: str) -> str:
    """Return the name of the folder for an estimator's files."""
    return re.sub(r"[^\w.,=\[\]-]+", "_", label).strip("_.") or "estimator"


def of_the_reference(flight: RecordedFlight) -> str:
    """Return a remark if the reference is also the record of a sensor; else return "".

    Estimators use this record. Therefore differences from the reference do not show accuracy.
    """
    sensor = flight.reference_is_of
    if not sensor:
        return ""
    return (
        f"the reference is the record of [{table_of(sensor)}], which the estimators use: "
        "differences from it show consistency, not accuracy"
    )


def write(
    flight: RecordedFlight,
    estimates: Mapping[str, Estimate],
    families: Mapping[str, str],
    output: Path,
) -> Path:
    """Write the report of a recorded flight, all files together or none.

    Each estimator has a folder for its files (:func:`folder_of`). ``corrected.csv``,
    ``corrected.gpx`` and ``corrected.kml`` have the corrected track at the epochs.
    ``full_rate.csv`` has this track at the INS samples. ``residuals.csv`` has the residuals. The
    pages are ``report.md`` with figures, and ``report.html`` as a single file.

    Parameters
    ----------
    flight : recorded flight.
    estimates : estimates by label of the estimator, at least one.
    families : family of each estimator by label.
    output : folder to write into.

    Returns
    -------
    Path of ``report.md``.

    Raises
    ------
    EstimateError, FlightError, FigureError
        If an estimate belongs to another problem, or a file cannot be written.
    """
    try:
        with written_together(output) as place:
            _write(flight, estimates, families, place)
    except OSError as error:
        raise FlightError(f"cannot write to {output}: {reason_of(error)}") from None
    return output / REPORT


def _write(
    flight: RecordedFlight,
    estimates: Mapping[str, Estimate],
    families: Mapping[str, str],
    output: Path,
) -> None:
    """Write the files of a report one after the other."""
    problem, start = flight.problem, flight.start
    residuals_of = {label: residuals(problem, estimate) for label, estimate in estimates.items()}
    tracks = {label: corrected(problem, estimated, start) for label, estimated in estimates.items()}
    judged = {
        label: against(problem, estimated, flight.reference, flight.spec.windows)
        for label, estimated in estimates.items()
        if flight.reference is not None
    }
    for label, differences in residuals_of.items():
        folder = output / folder_of(label)
        files.write(folder / "corrected.csv", tracks[label])
        every = corrected_samples(
            problem, estimates[label], flight.sample_times, flight.indicated, start
        )
        files.write(folder / "full_rate.csv", every)
        files.write_text(folder / "corrected.gpx", gpx_text(tracks[label], label))
        files.write_text(folder / "corrected.kml", kml_text(tracks[label], label))
        files.write(folder / "residuals.csv", residual_columns(problem, differences, start))
    title = plain(flight.spec.title or flight.path.stem)
    text = "\n\n".join(
        [
            f"# {title}",
            *([flight.spec.description.strip()] if flight.spec.description.strip() else []),
            _what_there_is(flight),
            _estimators(problem, estimates, residuals_of),
            *_errors(flight, judged),
            _figures(flight, estimates, families, residuals_of, judged, output),
            "`corrected` is the track at the epochs, as CSV, GPX and KML. Heights of GPX and KML "
            "are above sea level. `full_rate.csv` is the track at the samples of the INS; the "
            "estimated errors are interpolated linearly between epochs. Times in the files are on "
            "the clock of the INS. Times in the figures count from the first sample of the INS. "
            "`residuals.csv` lists for each channel the measurement that the estimators process, "
            "its prediction, the whitened residual, and whether a measurement exists. GNSS "
            "positions are relative to the INS, and filtered gradients are whitened.",
            *made_of(flight.inputs()),
        ]
    )
    files.write_text(output / REPORT, text + "\n")
    files.write_text(output / PAGE, _page(text, title, output))


def _page(text: str, title: str, output: Path) -> str:
    """Return a report as an HTML page with embedded figures."""
    parser = libraries.package("markdown_it").MarkdownIt("commonmark", {"html": False})
    # The parser refuses images of the scheme data: they are filled in afterwards.
    body = parser.enable("table").render(text)

    def embedded(match: re.Match[str]) -> str:
        image = base64.b64encode((output / match[1]).read_bytes()).decode()
        return f'src="data:image/png;base64,{image}"'

    body = re.sub(r'src="(figures/[\w.-]+\.png)"', embedded, body)
    page = page_templates.environment(html=True).get_template("flight.html.j2")
    return page.render(title=title, body=body)


def summary(flight: RecordedFlight, estimates: Mapping[str, Estimate]) -> list[str]:
    """Return a sentence for each estimator: uncertainty, residuals, errors against a reference."""
    sentences = []
    for label, estimate in estimates.items():
        parts = []
        if estimate.cov is not None:
            last = float(np.sqrt(np.diag(estimate.cov[-1])[:3].sum()))
            parts.append(f"final position σ {short(last)} m")
        differences = residuals(flight.problem, estimate)
        rms = float(np.sqrt(np.nanmean(differences.whitened**2)))
        parts.append(f"RMS of whitened residuals {short(rms)}")
        if flight.reference is not None:
            judged = against(flight.problem, estimate, flight.reference, flight.spec.windows)
            parts += [
                f"RMS position error {short(metrics['position_mrse_m'])} m against the reference "
                f"({WINDOW_TITLES[name]})"
                for name, metrics in judged.windows.items()
            ]
        sentences.append(f"{label}: {', '.join(parts)}")
    return sentences


def _what_there_is(flight: RecordedFlight) -> str:
    """Return a sentence on the flight and a table of its measurements, as markdown."""
    problem, spec = flight.problem, flight.spec
    kind = "INS solution" if spec.ins else "inertial measurements, mechanised by ggbench"
    assert problem.map is not None  # a recorded flight has one, be it the normal field's
    has_map = "with a map" if np.isfinite(problem.map.lower).all() else "without a map"
    rows = []
    for sensor, own in _sensors(problem).items():
        there = problem.present[:, own]
        epochs = np.flatnonzero(there.any(axis=1))
        table = sensors_of(spec)[sensor]
        rows.append(
            [
                sensor.replace("_", " "),
                ", ".join(problem.channels[j].name for j in own),
                str(len(epochs)),
                span(*(f"{problem.times[at]:g}" for at in epochs[[0, -1]])),
                table.file,
            ]
        )
    head = ["sensor", "channels", "measurements", "from, to [s]", "file"]
    return (
        f"{code(flight.path.name)}: {kind}, {has_map}. The record starts at {flight.start:.10g} s "
        f"on the INS clock. It has {counted(problem.epochs, 'epoch')} in {problem.times[-1]:g} s."
        "\n\n"
        + markdown(head, rows)
        + "".join(f"\n\n{plain(remark)}." for remark in flight.remarks)
    )


def _sensors(problem: Problem) -> dict[str, list[int]]:
    """Return the channel indices of each sensor, by name of the sensor."""
    channels: dict[str, list[int]] = {}
    for j, channel in enumerate(problem.channels):
        channels.setdefault(channel.sensor, []).append(j)
    return channels


def _estimators(
    problem: Problem, estimates: Mapping[str, Estimate], residuals_of: Mapping[str, Residuals]
) -> str:
    """Return a markdown table with the reported σ, mean NIS and residuals of each estimator."""
    rows = []
    for label, estimate in estimates.items():
        own = residuals_of[label]
        sigma = ["", ""]
        if estimate.cov is not None:
            last = np.diag(estimate.cov[-1])
            sigma = [short(float(np.sqrt(last[part].sum()))) for part in _PARTS]
        counts = problem.present.sum(axis=1)
        nis = ""
        if own.innovations:
            mean, expected = np.nanmean(own.nis), counts[counts > 0].mean()
            nis = f"{short(float(mean))} ({short(float(expected))})"
        outside = int(np.count_nonzero(epochs_outside(problem, estimate.mean)))
        rows.append(
            [
                code(label),
                estimate.causality,
                *sigma,
                nis,
                short(float(np.sqrt(np.nanmean(own.whitened**2)))),
                str(outside) if estimate.causality != "none" else "",
            ]
        )
    head = [
        "estimator",
        "causality",
        "final position σ [m]",
        "final velocity σ [m/s]",
        "mean NIS (expected)",
        "RMS of whitened residuals",
        "epochs outside the map",
    ]
    return (
        markdown(head, rows)
        + "\n\nFor a consistent filter the mean NIS is about the mean number of measured channels. "
        "Its residuals are whitened innovations with an RMS of about 1. For other estimators, "
        "residuals are those of the estimate, divided by the noise. Their RMS is below 1 for a "
        "smoother, because its estimates use the measurement."
    )


_PARTS = (slice(0, 3), slice(3, 6))


def _errors(flight: RecordedFlight, judged: Mapping[str, AgainstReference]) -> list[str]:
    """Return the markdown section on errors against the reference; empty without a reference."""
    if not judged:
        return []
    some = next(iter(judged.values()))
    names, rows = list(some.windows), []
    for label, judgement in judged.items():
        cells = []
        for name in names:
            metrics = judgement.windows[name]
            velocity = metrics["velocity_mrse_mps"]
            cells += [
                f"{short(metrics['position_mrse_m'])} ({short(metrics['horizontal_mrse_m'])})",
                "" if np.isnan(velocity) else short(velocity),
                "" if np.isnan(metrics["nees_mean"]) else short(metrics["nees_mean"]),
            ]
        rows.append([code(label), *cells])
    head = ["estimator"]
    for name in names:
        head += [f"{WINDOW_TITLES[name]}: position [m]", "velocity [m/s]", "NEES"]
    what = "position and velocity" if some.states == 6 else "the position"
    assert flight.spec.reference is not None
    remark = of_the_reference(flight)
    return [
        "## Against the reference",
        markdown(head, rows),
        f"RMS spherical errors against {code(flight.spec.reference.file)} at {len(some.times)} of "
        f"{flight.problem.epochs} epochs. Brackets contain the horizontal position error. "
        f"The NEES uses {what}. It is {some.states} if the estimate is consistent and the "
        "reference is exact. Errors of the reference increase errors and NEES."
        + (f" Caution: {remark}." if remark else ""),
    ]


def _figures(
    flight: RecordedFlight,
    estimates: Mapping[str, Estimate],
    families: Mapping[str, str],
    residuals_of: Mapping[str, Residuals],
    judged: Mapping[str, AgainstReference],
    output: Path,
) -> str:
    """Draw the figures; return the section that shows them."""
    problem = flight.problem
    lines: list[str] = ["## Figures"]

    def show(name: str, figure: Drawing, caption: str) -> None:
        save(figure, output / "figures" / name)
        lines.append(f"![{caption}](figures/{name})\n\n*{caption}*")

    caption = "Horizontal tracks relative to the start of the INS, and heights."
    show("track.png", _tracks(flight, estimates, families), caption)
    claimed = {
        label: np.sqrt(np.diagonal(estimated.cov, axis1=1, axis2=2)[:, :6])
        for label, estimated in estimates.items()
        if estimated.cov is not None
    }
    if claimed:
        figure = flights.deviations(problem.times, claimed, families)
        show("deviations.png", figure, "Spherical standard deviations of the estimates.")
    aided = [label for label, estimated in estimates.items() if estimated.causality != "none"]
    label = next((name for name in aided if residuals_of[name].innovations), next(iter(estimates)))
    figure = flights.whitened(problem.times, _by_sensor(problem, residuals_of[label]), label)
    kind = (
        "Whitened innovations"
        if residuals_of[label].innovations
        else "Residuals in units of the noise"
    )
    show("residuals.png", figure, f"{kind} of {code(label)}; the band is ±2σ.")
    if judged:
        label = aided[0] if aided else next(iter(judged))
        judgement = judged[label]
        pure = None
        if flight.reference is not None:
            covered = np.isin(problem.times, judgement.times)
            pure = flight.reference.error_state[covered, :6]
        figure = errors.component_errors(
            times=judgement.times,
            aided=np.hstack([judgement.components, judgement.sigmas]),
            ins=pure,
            first=0,
            unit="m",
            label=label,
            families=families,
        )
        show("errors.png", figure, f"Position errors of {code(label)} against the reference.")
    return "\n\n".join(lines)


def _tracks(
    flight: RecordedFlight, estimates: Mapping[str, Estimate], families: Mapping[str, str]
) -> Drawing:
    problem = flight.problem
    assert problem.track is not None  # a recorded flight has one
    indicated = problem.track.positions
    tracks = {
        label: _local(corrected_positions(indicated, estimate.mean[:, :3]), indicated[0])
        for label, estimate in estimates.items()
        if estimate.causality != "none"
    }
    reference = None
    if flight.reference is not None:
        true = corrected_positions(indicated, flight.reference.error_state[:, :3])
        reference = _local(true, indicated[0])
    ins = _local(indicated, indicated[0])
    return flights.ground_track(problem.times, ins, tracks, reference, families)


def _local(positions: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Return east and north [km] from an origin, and height [m], of positions (K, 3).

    Positions and origin (3,) are latitude, longitude [rad] and height [m].
    """
    local = position_error(positions, np.broadcast_to(origin, positions.shape)) * [1e-3, 1e-3, 1.0]
    local[:, 2] = positions[:, 2]
    return np.asarray(local)


def _by_sensor(problem: Problem, differences: Residuals) -> list[tuple[str, list[str], np.ndarray]]:
    out = []
    for sensor, channels in _sensors(problem).items():
        own = [j for j in channels if problem.present[:, j].any()]
        names = [problem.channels[j].name.removeprefix("gradient ") for j in own]
        out.append((sensor.replace("_", " "), names, differences.whitened[:, own]))
    return out


def made_of(inputs: Sequence[Mapping[str, str]]) -> list[str]:
    """Return a line with the names of the input files and the first digits of their SHA-256.

    Each input has ``role``, ``name`` and ``sha256``, as in :func:`.result_keys.input_files`.
    Without inputs there is no line.
    """
    named = [f"{i['role']} {code(i['name'])} {i['sha256'][:16]}" for i in inputs]
    line = f"- data, each with the first 16 digits of its SHA-256: {'; '.join(named)}"
    return [line] if named else []
