"""Page reports/matching_area.md and its tables, from reports/matching_area/tracks.csv."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ggbench.figures.numbers import short
from ggbench.figures.style import save
from ggbench.judging.statistics import wilson
from ggbench.report import page_templates, tables
from ggbench.report.columns import share, significant
from ggbench.results import digest

from . import association as assoc
from . import design, figures, findings
from .findings import Ranking
from .indices import OF_MAPS, completed

FOLDER = "matching_area"
TRACKS = "tracks.csv"
OUTCOMES = {"accuracy": "local accuracy", "fixes": "right fixes"}


@dataclass(frozen=True)
class Found:
    """Findings from a table of tracks, and the tables for CSV files."""

    tracks: pd.DataFrame
    near: Ranking
    weak: Ranking
    tables: dict[str, pd.DataFrame]

    @classmethod
    def of(cls, tracks: pd.DataFrame, samples: int = assoc.SAMPLES) -> Found:
        """Return the findings; ``samples`` is the number of bootstrap samples."""
        tracks = completed(tracks)
        near, weak = findings.accuracy(tracks, samples), findings.right_fixes(tracks, samples)
        rankings = [near.table("accuracy"), weak.table("fixes")]
        written = {
            "indices": pd.concat(rankings, ignore_index=True),
            "false_fixes": findings.false_fixes(tracks),
            "thirds": findings.thirds(tracks, samples),
            "headings": findings.heading_gain(tracks, samples),
            "instruments": findings.instruments(tracks),
        }
        return cls(tracks, near, weak, written)


def write(tracks: pd.DataFrame, output: Path) -> Path:
    """Write ``matching_area.md``, its figure and its tables; return the path of the page."""
    found, folder = Found.of(tracks), output / FOLDER
    save(figures.scatter(found.tracks, found.near), folder / "answer.png")
    for name, table in found.tables.items():
        digest.write_csv(table, folder / f"{name}.csv")
    path = output / f"{FOLDER}.md"
    path.write_text(page(found), encoding="utf-8")
    return path


def page(found: Found) -> str:
    """Return the text of the page."""
    near, tracks = found.near, found.tracks
    ratio = np.percentile(tracks["error_m"] / tracks["bound_m"], [5.0, 95.0])
    judged = found.tables["false_fixes"].query("judged")["predicted_over_found"]
    maps = {index.column for index in OF_MAPS}
    return page_templates.markdown(
        "matching_area.md.j2",
        Path(__file__).parent,
        best=_named(near, near.trusted[:1]),
        best_map=_named(near, [i for i in near.trusted if near.indices[i].column in maps][:1]),
        top=_named(near, [int(np.nanargmax(near.order.value))]),
        perfect=f"{np.mean([*findings.ceilings(tracks).values()]):.2f}",
        ratio=[f"{end:.2f}" for end in ratio],
        kept=int(judged.between(1.0 / findings.FACTOR, findings.FACTOR).sum()),
        judged=len(judged),
        untrusted=_untrusted(found.tables["indices"]),
        indices=_indices(found.tables["indices"]),
        false_fixes=_false_fixes(found.tables["false_fixes"]),
        third=_thirds(found.tables["thirds"]),
        heading_gain=_heading_gain(found.tables["headings"]),
        instruments=_instruments(found.tables["instruments"]),
        wide=_wide(tracks),
        cells=tracks.groupby(["region", "cell"]).ngroups,
        tracks=len(tracks),
        design=design,
        findings=findings,
        weak=design.weak(design.REGIONS[0]),
        weak_noises=[f"{region.weak.noise:g}" for region in design.REGIONS],
    )


def _named(ranking: Ranking, which: list[int]) -> dict[str, str] | None:
    """Return name and correlation of the first index in ``which``; None if it is empty."""
    if not which:
        return None
    order, i = ranking.order, which[0]
    value = _interval(order.value[i], order.low[i], order.high[i])
    return {"name": ranking.indices[i].title, "value": value}


def _interval(value: float, low: float, high: float) -> str:
    return f"{value:.2f} ({low:.2f}–{high:.2f})"


def _indices(indices: pd.DataFrame) -> pd.DataFrame:
    """Return the correlations of the best trusted indices; if none is trusted, of the best ones."""
    mean = indices[indices["region"] == "mean"]
    shown = mean[mean["trusted"]] if mean["trusted"].any() else mean
    best = shown.groupby("index")["spearman"].max().sort_values(ascending=False)
    listed = [_index(mean, index) for index in best.index[: tables.MOST_ROWS]]
    table = pd.DataFrame(listed)
    near = indices[indices["outcome"] == "accuracy"]
    for place, region in enumerate(design.REGIONS, start=2):
        own = near[near["region"] == region.name].set_index("index")["spearman"]
        cells = [f"{own[index]:.2f}" if index in own else "–" for index in table["index"]]
        table.insert(place, f"{OUTCOMES['accuracy']}: {region.title}", cells)
    return table


def _index(mean: pd.DataFrame, index: str) -> dict[str, str]:
    """Return the table row of an index: its means over regions for both outcomes."""
    own = mean[mean["index"] == index].set_index("outcome")
    row = {"index": index}
    for outcome, title in OUTCOMES.items():
        row |= {title: "–", f"{title}: verdict": "–"}
        if outcome in own.index:
            found = own.loc[outcome]
            row[title] = _interval(found.spearman, found.spearman_lo, found.spearman_hi)
            row[f"{title}: verdict"] = found.versus_roughness
    fit = own.index[own["trusted"]]
    return row | {"reliable for": "both" if len(fit) == 2 else "".join(fit) or "none"}


def _untrusted(indices: pd.DataFrame) -> list[str]:
    """Return the indices that are trusted for neither outcome."""
    fit = indices.groupby("index", sort=False)["trusted"].any()
    return [str(index) for index in fit.index[~fit]]


def _false_fixes(compared: pd.DataFrame) -> pd.DataFrame:
    """Return predicted and observed shares of false fixes, one row per bin."""
    return pd.DataFrame(
        {
            "predicted [%]": f"{100 * row.from_share:g}–{100 * row.to_share:g}"
            + (", together" if (row.from_share, row.to_share) == findings.JUDGED else ""),
            "tracks": str(row.tracks),
            "fixes": str(row.fixes),
            "mean prediction [%]": _percent(row.predicted_share),
            "found [%] (95 %)": f"{_percent(row.found_share)} "
            f"({_percent(row.found_share_lo)}–{_percent(row.found_share_hi)})",
            "predicted/found": f"{row.predicted_over_found:.2f}",
        }
        for row in compared.itertuples()
    )


def _percent(value: float) -> str:
    return significant(100.0 * value, 2)


def _thirds(thirds: pd.DataFrame) -> dict[str, str]:
    """Return the median errors on the thirds by roughness."""
    own = thirds[thirds["index"] == "roughness"].set_index("third")["median_error_m"]
    return {name: short(value) for name, value in own.items()}


def _heading_gain(headings: pd.DataFrame) -> str:
    """Return the relative reduction of the error on the heading with the smallest bound."""
    gain = 1.0 - headings.set_index("heading_by")["error_over_mean_heading"]
    return share(gain["bound of the flight"])


def _instruments(instruments: pd.DataFrame) -> dict[str, str]:
    """Return the smallest correlation over regions of six components with each instrument."""
    first = instruments[instruments["first"] == findings.INSTRUMENTS["track_m"]]
    return {str(k): f"{v:.2f}" for k, v in first.groupby("second")["spearman"].min().items()}


def _wide(tracks: pd.DataFrame) -> dict[str, Any]:
    """Return the number of fixes of the wide flights, and the share of accepted, right fixes."""
    fixes, locked = int(tracks["wide_runs"].sum()), int(tracks["wide_locked"].sum())
    return {"fixes": fixes, "right": share(wilson(locked, fixes)[0])}
