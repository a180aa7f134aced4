"""The figures of a page, as specifications of Vega-Lite: estimators are switched in the legend.

A figure has two panels and one legend. What is drawn comes as it is from the summary and the stored
series, by the functions that draw a report's own figures.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.colors import to_hex

from ...figures.line_styles import line_styles
from ...figures.locking import Series
from ...figures.style import BOUND

Spec = dict[str, Any]
MOST_VALUES = 120_000
"""Numbers in a figure over time at most: of longer series fewer epochs are drawn."""
_WIDTH = 800
_DASHES = {"-": [1, 0], "--": [6, 3], "-.": [6, 2, 1, 2], ":": [2, 2]}
_LOGARITHMIC = {"type": "log", "nice": False, "padding": 12}
_BOUND_LINES = ("-", ":", "--")
HINT = "Click a name in the legend to switch it off or on; with Shift held, to see it alone."
"""How to use a figure."""


@dataclass(frozen=True)
class Chart:
    """A figure of the page.

    Attributes
    ----------
    name : by which the page knows it.
    spec : of Vega-Lite.
    caption : in plain text.
    """

    name: str
    spec: Spec
    caption: str


@dataclass(frozen=True)
class Places:
    """Where figures over cases stand: a row of a figure for each.

    Attributes
    ----------
    names : of the cases.
    values : (n,) on a continuous axis, None: side by side.
    groups : to which each belongs, of which one at a time is shown; empty: all are.
    title : of the axis.
    scale : "linear" or "log", of values.
    """

    names: Sequence[str]
    values: Sequence[float] | None = None
    groups: Sequence[str] = ()
    title: str = ""
    scale: str = "linear"


def over_cases(
    name: str, places: Places, shares: Mapping[str, Series], ratios: Mapping[str, Series],
    on: Iterable[str], caption: str, spread: bool = True,
) -> Chart:  # fmt: skip
    """Return the figure of success and of error over bound, by case and estimator.

    Parameters
    ----------
    places : of the n cases.
    shares, ratios : estimator to figures (n,) with the ends of what is drawn as a bar.
    on : estimators that are switched on at first.
    spread : whether the ends are the interval of the share and the quartiles of the ratio, or
        nothing but the figure itself.
    """
    groups = places.groups or [""] * len(places.names)
    rows = []
    for label, share in shares.items():
        ratio = ratios[label]
        for k, case in enumerate(places.names):
            if math.isnan(share.value[k]):
                continue
            where = case if places.values is None else places.values[k]
            rows.append({"name": label, "case": case, "group": groups[k], "x": where}
                        | _ended("share", share, k) | _ended("ratio", ratio, k))  # fmt: skip
    continuous = places.values is not None
    across: Spec = {"field": "x", "type": "quantitative" if continuous else "nominal"}
    across["axis"] = {"title": places.title or None, "labelLimit": 180, "grid": continuous}
    across["scale"] = {"type": places.scale, "nice": False, "padding": 12} if continuous else {}
    if not continuous:
        across["sort"] = list(places.names)
        long = max(map(len, places.names)) * len(places.names) > 110
        across["axis"] |= {"labelAngle": -35} if long else {"labelAngle": 0}
    beside = {} if continuous else {"xOffset": {"field": "name", "sort": list(shares)}}
    tip = [_tip("name", "estimator"), _tip("case", "case"), _tip("share", "success", ".1%")]
    if spread:
        tip += [_tip("share_lo", "from", ".1%"), _tip("share_hi", "to", ".1%")]
    tip.append(_tip("ratio", "error / bound", ".3g"))
    if spread:
        quartiles = {"ratio_lo": "lower quartile", "ratio_hi": "upper quartile"}
        tip += [_tip(field, title, ".3g") for field, title in quartiles.items()]

    def panel(field: str, title: str, height: int, log: bool) -> Spec:
        y: Spec = {"field": field, "type": "quantitative", "title": title}
        y |= {"scale": _LOGARITHMIC if log else {"domain": [0, 1]}}
        y["axis"] = {"format": "~g"} if log else {"format": ".0%", "tickCount": 5}
        # Named once, below both panels.
        x = across | {"axis": across["axis"] | ({} if log else {"labels": False, "title": None})}
        bars = {"x": x, "y": y | {"field": f"{field}_lo"}, "y2": {"field": f"{field}_hi"}}
        marks: list[Spec] = [
            {"mark": {"type": "rule", "strokeWidth": 1.2}, "encoding": bars},
            {"mark": {"type": "point", "filled": True, "size": 42, "opacity": 1.0},
             "encoding": {"x": x, "y": y, "tooltip": tip}},
        ]  # fmt: skip
        if continuous:
            marks.append({"mark": {"type": "line", "strokeWidth": 1.3},
                          "encoding": {"x": x, "y": y}})  # fmt: skip
        for layer in marks:
            layer["encoding"] |= beside
        positive = [{"filter": f"datum.{field}_lo > 0 && datum.{field} > 0"}] if log else []
        return {"height": height, "transform": positive, "layer": marks}

    panels = [
        panel("share", "share of success", 150, log=False),
        panel("ratio", "error / bound of those", 260, log=True),
    ]
    choices = {"group": ("at", list(dict.fromkeys(groups)))} if places.groups else {}
    chosen = "datum.group === group" if choices else ""
    dashes = dict.fromkeys(shares, "-")
    return Chart(name, _figure(rows, panels, dashes, on, choices, chosen), caption)


def over_time(
    curves: Mapping[str, tuple[np.ndarray, Mapping[str, np.ndarray], Mapping[str, np.ndarray]]],
    on: Iterable[str], caption: str,
) -> Chart | None:  # fmt: skip
    """Return the figure of errors against time beside the bounds, one case of several at a time.

    Parameters
    ----------
    curves : title of a case to times (K,), errors by estimator and bounds by name, each (K, 2).
    on : estimators that are switched on at first.

    Returns
    -------
    The figure; None if no error is known.
    """
    labels = list(dict.fromkeys(k for _, errors, _ in curves.values() for k in errors))
    bounds = list(dict.fromkeys(k for _, _, found in curves.values() for k in found))
    if not labels:
        return None
    total = sum(2 * len(t) * (len(e) + len(b)) for t, e, b in curves.values())
    step = max(1, math.ceil(total / MOST_VALUES))
    rows = []
    times = []
    for title, (time, errors, found) in curves.items():
        # The last epoch is drawn, whatever the step.
        kept = np.arange(len(time))[::-1][::step][::-1]
        times.append({"case": title, "time": [float(f"{t:.6g}") for t in time[kept]]})
        for label, curve in {**errors, **found}.items():
            position, velocity = ([_drawable(v) for v in column] for column in curve[kept].T)
            rows.append({"name": label, "case": title, "position": position, "velocity": velocity})
    dashes = {label: look.ls for label, look in line_styles(labels).items()}
    dashes |= {b: _BOUND_LINES[k % len(_BOUND_LINES)] for k, b in enumerate(bounds)}
    read = [
        {"lookup": "case", "from": {"data": {"values": times}, "key": "case", "fields": ["time"]}},
        {"flatten": ["time", "position", "velocity"]},
    ]

    def panel(quantity: str, unit: str) -> Spec:
        y = {"field": quantity, "type": "quantitative", "scale": _LOGARITHMIC,
             "axis": {"format": "~g"}, "title": f"spherical {quantity} [{unit}]"}  # fmt: skip
        x = {"field": "time", "type": "quantitative", "title": "time [s]",
             "scale": {"nice": False, "zero": False}}  # fmt: skip
        tip = [_tip("name", "estimator"), _tip("time", "time [s]"),
               _tip(quantity, f"{quantity} [{unit}]", ".3g")]  # fmt: skip
        return {
            "height": 230,
            "transform": [*read, {"filter": f"datum.{quantity} > 0"}],
            "layer": [{"mark": {"type": "line", "strokeWidth": 1.4},
                       "encoding": {"x": x, "y": y, "tooltip": tip}}],
        }  # fmt: skip

    titles = list(curves)
    panels = [panel("position", "m"), panel("velocity", "m/s")]
    choices = {"shown": ("case", titles)}
    every = [*on, *bounds]
    spec = _figure(rows, panels, dashes, every, choices, "datum.case === shown")
    if step > 1:
        caption += f"; one epoch in {step} is drawn"
    return Chart("errors", spec, caption)


def _figure(
    rows: Sequence[Spec], panels: Sequence[Spec], dashes: Mapping[str, str], on: Iterable[str],
    choices: Mapping[str, tuple[str, Sequence[str]]], chosen: str,
) -> Spec:  # fmt: skip
    """Return panels below each other, whose lines are those switched on in the last one's legend.

    Parameters
    ----------
    rows : the data, with ``name``.
    dashes : name to Matplotlib's line, in the legend's order.
    choices : name of a parameter to its title and what may be chosen.
    chosen : which rows that leaves, an expression of Vega's.
    """
    names = list(dashes)
    colours = {label: look.color for label, look in line_styles(names).items()}
    colours |= dict.fromkeys((n for n in names if n.startswith("bound: ")), BOUND)
    scale: Spec = {"domain": names, "range": [to_hex(colours[name]) for name in names]}
    columns = max(1, min(3, _WIDTH // (7 * max(map(len, names)) + 40)))
    legend = {
        "title": None, "orient": "bottom", "columns": columns, "labelLimit": 600, "symbolLimit": 0,
        "symbolType": "stroke", "symbolStrokeWidth": 3, "symbolSize": 200, "columnPadding": 14,
    }  # fmt: skip
    lines: Spec = {"domain": names, "range": [_DASHES[dashes[name]] for name in names]}
    held = set(on)
    switch = {
        "name": "lit",
        "value": [{"name": name} for name in names if name in held] or [{"name": names[0]}],
        # Not cleared by a double click, which is two clicks on a name.
        "select": {"type": "point", "fields": ["name"], "toggle": "!event.shiftKey",
                   "clear": False},
        "bind": "legend",
    }  # fmt: skip
    shown = [{"filter": chosen}] if chosen else []
    for number, panel in enumerate(panels):
        last = number == len(panels) - 1
        panel["width"] = _WIDTH
        panel["transform"] = [
            {"filter": {"param": "lit", "empty": False}}, *shown, *panel["transform"]
        ]  # fmt: skip
        for layer in panel["layer"]:
            shared = {"field": "name", "type": "nominal"}
            layer["encoding"]["color"] = shared | {
                "scale": scale, "legend": legend if last else None
            }  # fmt: skip
            if layer["mark"]["type"] == "line":
                layer["encoding"]["strokeDash"] = shared | {
                    "scale": lines, "legend": legend if last else None
                }  # fmt: skip
    panels[-1]["layer"][0]["params"] = [switch]
    parameters = [
        {"name": key, "value": options[0],
         "bind": {"input": "select", "options": list(options), "name": f"{title} "}}
        for key, (title, options) in choices.items()
    ]  # fmt: skip
    # What is chosen stands in the figure, too: on paper there is no control.
    title = {"text": {"expr": next(iter(choices))}, "anchor": "start"} if choices else ""
    return {
        "title": title,
        "params": parameters,
        "data": {"values": list(rows)},
        "vconcat": list(panels),
        "resolve": {"scale": {"color": "independent", "strokeDash": "independent"}},
        "config": {
            "font": "system-ui, sans-serif",
            "axisLeft": {"minExtent": 44},
            "title": {"fontSize": 13},
            "axis": {"labelFontSize": 11, "titleFontSize": 12, "titleFontWeight": "normal"},
            "legend": {"labelFontSize": 11.5, "unselectedOpacity": 0.25},
            "view": {"stroke": "#ccc"},
        },
    }


def _tip(field: str, title: str, form: str = "") -> Spec:
    if form:
        return {"field": field, "title": title, "type": "quantitative", "format": form}
    return {"field": field, "title": title}


def _ended(key: str, series: Series, k: int) -> Spec:
    ends = {"": series.value, "_lo": series.low, "_hi": series.high}
    return {f"{key}{end}": _digits(values[k]) for end, values in ends.items()}


def _drawable(value: float) -> float | None:
    """Return an error with the digits that a line shows."""
    return float(f"{value:.4g}") if math.isfinite(value) else None


def _digits(value: float) -> float | None:
    """Return a figure as a digest has it, None for none: JSON knows no NaN."""
    return float(f"{value:.6g}") if math.isfinite(value) else None
