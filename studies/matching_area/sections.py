"""The sections of the report and their tables."""

from __future__ import annotations

import numpy as np
import pandas as pd

from ggbench.report.tables import markdown

from . import association as assoc
from . import design, findings, words
from .findings import Ranking
from .indices import NEAR, OF_MAPS
from .words import TITLES, value


def flown(table: pd.DataFrame) -> str:
    """Return what cells, tracks and flights there are."""
    cells = words.listed(
        [
            f"{part['cell'].nunique()} cells ({TITLES[str(region)]})"
            for region, part in table.groupby("region", sort=False)
        ]
    )
    near, wide, weak = design.NEAR, design.WIDE, design.weak(design.REGIONS[0])
    instruments = words.listed(
        [f"{words.instrument(region.weak)} ({region.title})" for region in design.REGIONS]
    )
    return (
        f"{cells}, {design.CELL_DEG:g}° wide, on an even grid, none beside another; straight and "
        f"level tracks of {design.TRACK_M / 1e3:g} km in {design.DURATION_S:g} s through each "
        "centre on four headings. The inertial system is of navigation grade; velocity is known to "
        "0.1 m/s, height to 20 m; the gradiometer keeps a local level. Three kinds of flights:\n\n"
        f"- **near**: position known to {near.sigma_m:g} m (σ per axis), "
        f"{words.instrument(near.instrument)} every {near.period_s:g} s, {near.runs} runs of the "
        "filter `ekf`. The outcome is the horizontal error: the root mean square over the runs and "
        "the second half of the track.\n"
        f"- **wide**: position known to {wide.sigma_m / 1e3:g} km, "
        f"{words.instrument(wide.instrument)} every {wide.period_s:g} s, {wide.runs} runs of "
        "`tercom`: one search over all readings of the track.\n"
        f"- **weak**: the same {weak.runs} times from {weak.sigma_m / 1e3:g} km with so little "
        f"instrument that fixes fail, for wide flights have too few false fixes: {instruments}. "
        "This noise was set by the shares predicted, after a pilot of six cells.\n\n"
        f"A fix is right if it is off by at most r₀ = {design.RIGHT_M / 1e3:g} km, and a lock if "
        "`tercom` accepts it, too. Near flights draw the same random numbers on all tracks, so "
        "that tracks are compared and not draws; the others do not, so that shares are of "
        "independent runs."
    )


def accuracy(near: Ranking, headings: assoc.Spread) -> str:
    """Return how indices order the tracks by the filter's error."""
    rows = []
    for i, index in enumerate(near.indices):
        base = index.column == "roughness"
        rows.append(
            [
                index.title,
                value(near.order, i),
                *(f"{own[0][i]:.2f}" for own in near.order.regions.values()),
                "" if base else value(near.partial, i),
                "" if base else value(near.ahead, i, signed=True),
                "" if base else near.beyond(i),
                "0" if np.isnan(headings.value[i]) else value(headings, i),
                "yes" if i in near.trusted else "no",
            ]
        )
    head = [
        "index", "Spearman", *(TITLES[region] for region in near.order.regions),
        "roughness held", "less roughness's", "distinguishable", "over headings", "trusted",
    ]  # fmt: skip
    return (
        "Spearman's correlation of each index, turned so that more is taken for better, with the "
        "smallness of the error: the mean of the two regions with its 95 % interval over cells, "
        "and each region's own. *Roughness held*: the partial correlation. *Less roughness's*: "
        "the difference of the two correlations, paired, and whether it is *distinguishable* from "
        "zero by Holm's test over all indices at 5 %. *Over headings*: the correlation of "
        "logarithms, less their means over a cell; what knows no heading has 0.\n\n"
        + markdown(head, rows)
    )


def choices(table: pd.DataFrame, samples: int) -> str:
    """Return the error on the thirds of some indices, and on the headings that they choose."""
    rows = []
    for column in ("roughness", "index", "track_m", "bound_m"):
        (index,) = (index for index in NEAR if index.column == column)
        if np.isfinite(table[column]).all():
            found = findings.thirds(table, index, samples)
            cells = [words.with_interval(*third, ".0f") for third in zip(*found, strict=True)]
            rows.append([index.title, *cells, f"{found[0][0] / found[0][2]:.2f}"])
    chosen = findings.heading_gain(table, samples)
    gains = [[name, words.with_interval(*gain)] for name, gain in chosen.items()]
    return (
        "Median error [m] on the tracks of each third of an index (thirds of each region, put "
        "together), with intervals over cells.\n\n"
        + markdown(["index", "unsuitable", "fair", "good", "unsuitable / good"], rows)
        + "\n\nWhere the cell is given, a heading can be chosen: the error on the heading that an "
        "index has for the best, over the mean of the four (geometric means, and intervals over "
        "cells).\n\n" + markdown(["heading by", "error / mean of the headings"], gains)
    )


def ceilings(table: pd.DataFrame, perfect: dict[str, float]) -> str:
    """Return what no index can exceed, and what a regression makes of them all."""
    found = {
        "a perfect index": perfect,
        "regression on what a map says": findings.crossed(table, OF_MAPS),
        "regression on all indices": findings.crossed(table, NEAR),
    }
    rows = [[name, *(f"{own[region]:.2f}" for region in perfect)] for name, own in found.items()]
    return (
        "A perfect index would still be off by the noise of the runs, which is seen where their "
        "halves differ. A regression of the error's logarithm has its weights from one region and "
        "is judged in the other, whose errors it has not seen.\n\n"
        + markdown(["Spearman with the error", *(TITLES[region] for region in perfect)], rows)
    )


def locking(table: pd.DataFrame, weak: Ranking, areas: assoc.Spread) -> str:
    """Return how indices order the tracks by right fixes and by locks."""
    good, runs = findings.locks(table), int(table["weak_runs"].sum())
    counts = []
    for region in weak.order.regions:
        own = good[table["region"] == region]
        counts.append(f"{own.sum()} of {len(own)} tracks ({TITLES[region]})")
    rows = []
    for i, index in enumerate(weak.indices):
        base = index.column == "roughness"
        rows.append(
            [
                index.title,
                value(weak.order, i),
                "" if base else value(weak.ahead, i, signed=True),
                "" if base else weak.beyond(i),
                value(areas, i),
                "yes" if i in weak.trusted else "no",
            ]
        )
    basins = int((table["weak_union"] > table["weak_spill"]).sum())
    accepted, false = (words.percent(table[f"weak_{x}"].sum() / runs) for x in ("locked", "false"))
    return (
        f"Of {runs} fixes of weak flights {accepted} were accepted and right, {false} accepted and "
        f"wrong, the others refused. In 95 % of the runs, which is all of so few, "
        f"{words.listed(counts)} lock on. *Spearman*: with the share of best places that are "
        "right, whether accepted or not. *AUC*: the area under the ROC curve for locking on in at "
        "least 95 % of the runs, the mean of the regions. Fisher's information and ambiguity are "
        "those of the instrument and the prior that were flown. Of the tracks, other basins have "
        f"the larger part in what is predicted on {basins}, on the others it is the spill: there "
        "the least ambiguity says how sharp the right place is, as the CRLB does.\n\n"
        + markdown(
            ["index", "Spearman", "less roughness's", "distinguishable", "AUC", "trusted"], rows
        )
    )


def false_fixes(compared: list[findings.Compared]) -> str:
    """Return predicted shares of false fixes beside those that were found."""
    rows = [
        [
            row.title, str(row.tracks), str(row.fixes), words.percent(row.predicted),
            words.share((row.observed, row.low, row.high)),
            f"{row.ratio:.2f}" if np.isfinite(row.ratio) else "",
        ]
        for row in compared
    ]  # fmt: skip
    inside = [row for row in compared if row.judged]
    kept = [row for row in inside if 1.0 / findings.FACTOR <= row.ratio <= findings.FACTOR]
    return (
        "Between 2 and 50 % the prediction is within a factor of "
        f"{findings.FACTOR:g} of what was found in {len(kept)} of {len(inside)} bins. Predicted "
        "is the union bound over the basins of A(d) beyond r₀, prior included, and the spill: "
        "fixes in the right basin that are yet off by more than r₀. Found is the share of best "
        "places beyond r₀ on weak flights, one search each over all readings, whether `tercom` "
        "accepts it or not; with Wilson's interval.\n\n"
        + markdown(
            ["predicted", "tracks", "fixes", "mean prediction", "found", "predicted / found"], rows
        )
    )


def instruments(table: pd.DataFrame) -> str:
    """Return how alike instruments rank the cells."""
    rows = [
        [
            TITLES[row.region], f"{row.first}, {row.second}", f"{row.spearman:.2f}",
            words.percent(row.shared), f"{row.best} of {row.cells}",
        ]
        for row in findings.instruments(table).itertuples()
    ]  # fmt: skip
    head = ["region", "instruments", "Spearman", "best thirds in common", "best cell of the first"]
    return (
        "Does the ranking of the cells change with the instrument? Of each cell the CRLB along its "
        "tracks, root mean square over the headings, for six components or Γ_UU alone (1 E) and a "
        "gravimeter (1 mGal, free of the motion's accelerations): of the map alone, nothing is "
        "flown here. *Best cell of the first*: its rank by the second.\n\n" + markdown(head, rows)
    )


def limits() -> str:
    """Return how the numbers were made, and where they end."""
    return "\n".join(
        f"- {sentence}"
        for sentence in (
            "Regions are never pooled, so that neither latitude nor height makes a correlation. "
            f"Intervals are percentiles of {assoc.SAMPLES} bootstrap samples of cells, drawn "
            "within each region, each with all of its tracks; all indices are resampled alike.",
            "An index is *trusted* if by Holm's test at 5 % its correlation is not zero, if all of "
            f"its interval lies above {findings.TRUSTED:g}, and if in each region its interval "
            "lies above zero. This was laid down before the results of the study were seen.",
            "Principal components, over the cells of a region, find what varies, not what predicts "
            "an error: nothing in them has seen one. The literature's five statistics, of Γ_UU at "
            "the height of the flight on nodes a kilometre apart.",
            "EGM2008 knows nothing shorter than 18 km: a fractal dimension there measures how it "
            "is interpolated.",
            f"Where the readings say less than the prior's {design.NEAR.sigma_m:g} m, all errors "
            "are nearly the prior's, and no index can tell tracks apart that differ in nothing.",
            "Map and truth are the same. An area with a bad map scores as high as one with a good "
            "one: the uncertainty of the map has to be weighed beside any of these indices.",
            "One kind of track: straight, level, of one length. With turns headings matter less.",
        )
    )
