"""The curve of the time of a run over the number of runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ggbench.figures.style import Drawing, save, styled


@styled()
def draw(points: list[dict[str, Any]], path: Path) -> None:
    """Draw simulation, engines and their sum, in wall time a run."""
    figure = Drawing(figsize=(7.0, 3.6))
    axes = figure.subplots()
    runs = [point["runs"] for point in points]
    for name in points[0]["parts"]:
        each = [1e3 * p["parts"][name] / p["threads"] / p["runs"] for p in points]
        axes.plot(runs, each, "o-", ms=3, label=name)
    whole = [1e3 * p["seconds"] / p["runs"] for p in points]
    axes.plot(runs, whole, "ks-", ms=3, label="all together")
    axes.set_xscale("log")
    axes.set_xticks(runs, [str(count) for count in runs])  # powers would be set as mathematics
    axes.set_xticks([], minor=True)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("runs")
    axes.set_ylabel(f"wall time of a run [ms], {points[0]['threads']} threads")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    save(figure, path)
