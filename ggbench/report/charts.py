"""Interactive figures of the HTML page, as Vega-Lite specifications without their data.

The page fills in the data of a case and its own width; the mouse wheel zooms.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.colors import to_hex

from ..figures.line_styles import line_styles
from ..figures.style import BOUND

Spec = dict[str, Any]
_SHAPES = {"-": "circle", "--": "square", "-.": "triangle-up", ":": "diamond"}
"""Shapes of the variants of a name, which share a colour."""
_DASHES = {"-": [1, 0], "--": [6, 3], "-.": [6, 2, 1, 2], ":": [2, 2]}
_LEGEND: Spec = {"title": None, "orient": "bottom", "symbolLimit": 0, "symbolSize": 90,
                 "symbolStrokeWidth": 3}  # fmt: skip
_LOG: Spec = {"type": "log", "nice": False, "padding": 8}


def by_case(labels: Sequence[str], on: Sequence[str]) -> Spec:
    """Return the figure of RMS errors by case: fields ``name, case, rms, lo, hi, success``."""
    x: Spec = {"field": "rms", "type": "quantitative", "scale": _LOG,
               "axis": {"format": "~g"}, "title": "RMS position error [m]"}  # fmt: skip
    y: Spec = {"field": "case", "type": "nominal", "title": None, "sort": None}
    offset = {"field": "name", "sort": list(labels)}
    tip = [_tip("name", "estimator"), _tip("case", "case"), _tip("rms", "RMS [m]", ".3g"),
           _tip("success", "success", ".2p")]  # fmt: skip
    shared = {"x": x, "y": y, "yOffset": offset, "color": _colour(labels)}
    y["axis"] = {"labelExpr": "split(datum.label, '\\n')"}
    return _figure(labels, on, ["x"], [
        {"mark": {"type": "rule", "strokeWidth": 1.3},
         "encoding": shared | {"x": x | {"field": "lo"}, "x2": {"field": "hi"}}},
        {"mark": {"type": "point", "filled": True, "size": 40},
         "encoding": shared | {"shape": _shape(labels), "tooltip": tip}},
    ])  # fmt: skip


def over_time(labels: Sequence[str], on: Sequence[str]) -> Spec:
    """Return the figure of RMS errors over time: fields ``name, time, rms``.

    Bounds are the last labels.
    """
    bounds = [label for label in labels if label.startswith("bound")]
    styles = line_styles([label for label in labels if label not in bounds])
    dashes = [_DASHES[styles[label].ls] for label in styles]
    dashes += [[1 + 3 * number, 2 * number] for number in range(len(bounds))]
    encoding = {
        "x": {"field": "time", "type": "quantitative", "title": "time [s]",
              "scale": {"nice": False, "zero": False}},
        "y": {"field": "rms", "type": "quantitative", "scale": _LOG, "axis": {"format": "~g"},
              "title": "RMS position error [m]"},
        "color": _colour(labels),
        "strokeDash": {"field": "name", "type": "nominal", "legend": _LEGEND,
                       "scale": {"domain": list(labels), "range": dashes}},
        "tooltip": [_tip("name", "estimator"), _tip("time", "time [s]", ".4g"),
                    _tip("rms", "RMS [m]", ".3g")],
    }  # fmt: skip
    mark = {"type": "line", "strokeWidth": 1.5}
    return _figure(labels, [*on, *bounds], ["x", "y"], [{"mark": mark, "encoding": encoding}])


def _figure(
    labels: Sequence[str], on: Sequence[str], zoomed: Sequence[str], layers: list[Spec]
) -> Spec:
    """Return a figure whose estimators are switched in the legend, and whose axes are zoomed."""
    lit = {"name": "lit", "value": [{"name": label} for label in labels if label in set(on)],
           "select": {"type": "point", "fields": ["name"], "toggle": "true", "clear": False},
           "bind": "legend"}  # fmt: skip
    zoom = {"name": "zoom", "select": {"type": "interval", "encodings": list(zoomed)},
            "bind": "scales"}  # fmt: skip
    layers[0]["params"] = [lit, zoom]
    return {
        "width": "container",
        "autosize": {"type": "fit-x", "contains": "padding"},
        "transform": [{"filter": {"param": "lit", "empty": False}},
                      {"filter": "isValid(datum.rms) && datum.rms > 0"}],
        "layer": layers,
        "config": {
            "font": "system-ui, sans-serif",
            "axis": {"labelFontSize": 11, "titleFontSize": 12, "titleFontWeight": "normal"},
            "legend": {"labelFontSize": 11.5, "unselectedOpacity": 0.3},
            "view": {"stroke": "#ccc"},
        },
    }  # fmt: skip


def _colour(labels: Sequence[str]) -> Spec:
    styles = line_styles(label for label in labels if not label.startswith("bound"))
    colours = [to_hex(styles[k].color if k in styles else BOUND) for k in labels]
    return {"field": "name", "type": "nominal", "legend": _LEGEND,
            "scale": {"domain": list(labels), "range": colours}}  # fmt: skip


def _shape(labels: Sequence[str]) -> Spec:
    styles = line_styles(label for label in labels if not label.startswith("bound"))
    shapes = [_SHAPES[styles[k].ls] if k in styles else "cross" for k in labels]
    return {"field": "name", "type": "nominal", "legend": _LEGEND,
            "scale": {"domain": list(labels), "range": shapes}}  # fmt: skip


def _tip(field: str, title: str, form: str = "") -> Spec:
    number = {"type": "quantitative", "format": form} if form else {}
    return {"field": field, "title": title} | number
