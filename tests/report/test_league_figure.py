"""The figure of the league shows each estimator's success and error in each scenario."""

from __future__ import annotations

import math

import numpy as np
import pytest
from leagues import EKF, INS, league_of
from summaries import SAME, records

from ggbench.report.league import standing
from ggbench.report.league_figure import draw, number


def test_success_is_the_colour_and_the_error_the_number():
    """Rows are estimators, columns scenarios; – where it did not run; a line before smoothers."""
    lost = records("tercom", 4.0 * SAME)
    for record in lost[:15]:
        record["diverged"] = True
    late = records("gauss-newton", SAME, "batch")
    held = league_of(a=[[INS, EKF, lost, late]], b=[[INS, EKF]])
    shown = [standing(label, held.cases) for label in ("ekf", "tercom", "gauss-newton")]
    figure = draw(shown, ["a", "b"])
    axis, bar = figure.axes
    (image,) = axis.get_images()
    shares = np.ma.filled(image.get_array(), np.nan)
    assert shares == pytest.approx(
        np.array([[1.0, 1.0], [0.75, np.nan], [1.0, np.nan]]), nan_ok=True
    )
    assert image.get_clim() == (0.0, 1.0)
    texts = {text.get_position(): text.get_text() for text in axis.texts}
    assert texts == {
        (column, row): number(s.ratio[name]) if name in s.ratio else "–"
        for row, s in enumerate(shown)
        for column, name in enumerate(("a", "b"))
    }
    assert [text.get_text() for text in axis.get_xticklabels()] == ["a", "b"]
    assert [t.get_text() for t in axis.get_yticklabels()] == ["ekf", "tercom", "gauss-newton"]
    assert [line.get_ydata()[0] for line in axis.get_lines()] == [1.5]
    assert bar.get_ylabel() == "share of success"


@pytest.mark.parametrize(
    ("value", "text"), [(math.nan, "–"), (math.inf, "∞"), (1.23456, "1.23"), (999.6, "1000")]
)
def test_numbers_have_three_digits_or_a_sign(value, text):
    assert number(value) == text
