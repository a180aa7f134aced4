"""Figures leave Matplotlib as the user has set it, and look the same whatever the user has set."""

from __future__ import annotations

import ast
import os
import pickle
import subprocess
import sys
import tempfile

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from thinning import thinned

from ggbench.figures.field import gradient_along_track
from ggbench.figures.style import FigureError, save

EVERY_MODULE = """
import importlib, pkgutil, ggbench
for module in pkgutil.walk_packages(ggbench.__path__, "ggbench."):
    importlib.import_module(module.name)
assert "ggbench.figures.style" in sys.modules and "ggbench.report.pictures" in sys.modules
"""


def changed_by(code: str) -> set[str]:
    """Names of Matplotlib's settings that a process of its own changes, and pyplot if it loads it.

    The backend is read without having Matplotlib choose one.
    """
    program = (
        "import sys, matplotlib\n"
        "def settings(): return {k: str(v) for k, v in dict.items(matplotlib.rcParams)}\n"
        "before = settings()\n"
        f"{code}\n"
        "after = settings()\n"
        "found = {k for k in before if before[k] != after[k]}\n"
        "print(found | {m for m in sys.modules if m == 'matplotlib.pyplot'} or '{}')\n"
    )
    environment = {k: v for k, v in os.environ.items() if k != "MPLBACKEND"}
    done = subprocess.run(
        [sys.executable, "-P", "-c", program],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
        cwd=tempfile.gettempdir(),
    )
    return set(ast.literal_eval(done.stdout.splitlines()[-1]))


@pytest.mark.long
def test_no_module_changes_matplotlib():
    """To import any module of the package changes no setting and no backend of the user's."""
    assert changed_by(EVERY_MODULE) == set()


@thinned(
    ("code", "found"),
    [
        ("matplotlib.rcParams |= {'font.size': 9}", {"font.size"}),
        ("matplotlib.use('svg')", {"backend"}),
        ("import matplotlib.pyplot", {"matplotlib.pyplot"}),
    ],
)
def test_a_change_of_matplotlib_is_found(code, found):
    """The check above sees what it is to see."""
    assert found <= changed_by(code)


def gradient() -> Figure:
    times = np.arange(1.0, 50.0)
    vertical = np.sin(0.1 * times)
    arrays = {
        "gradient_times": times,
        "vertical": vertical,
        "noisy": vertical + 0.1 * np.cos(9.0 * times),
    }
    return gradient_along_track(arrays, "a price in $ and $")


@pytest.mark.long
def test_the_users_settings_have_no_say(tmp_path):
    """A figure has the same bytes under other settings, at its making and at its drawing."""
    save(gradient(), tmp_path / "plain.png")
    before = dict(matplotlib.rcParams)
    with matplotlib.rc_context({"font.size": 20.0, "axes.facecolor": "black", "xtick.top": True}):
        figure = gradient()
        save(figure, tmp_path / "within.png")
        late = gradient()
    save(late, tmp_path / "later.png")
    plain = (tmp_path / "plain.png").read_bytes()
    assert (tmp_path / "within.png").read_bytes() == plain
    assert (tmp_path / "later.png").read_bytes() == plain
    assert dict(matplotlib.rcParams) == before


@pytest.mark.long
def test_a_notebook_shows_a_figure():
    """A figure is a picture by itself, without pyplot, and can be kept."""
    figure = gradient()
    assert figure._repr_png_().startswith(b"\x89PNG")
    assert pickle.loads(pickle.dumps(figure))._repr_png_() == figure._repr_png_()


def test_a_figure_that_cannot_be_written(tmp_path):
    """Where there can be no file a sentence says so."""
    (tmp_path / "file").write_text("")
    with pytest.raises(FigureError, match=r"cannot write the figure .*x\.png: "):
        save(gradient(), tmp_path / "file" / "x.png")
