"""The tutorial notebook: its kept outputs, and the comparison that `make tutorial-check` makes."""

from __future__ import annotations

import ast
import base64
import copy
import io
import re
import sys
from pathlib import Path

import nbformat
import pytest
from PIL import Image, ImageDraw
from thinning import thinned

ROOT = Path(__file__).parents[1]
PATH = ROOT / "docs" / "tutorial.ipynb"
PICTURE = "image/png"


@pytest.fixture
def notebook():
    return nbformat.read(PATH, as_version=4)


@pytest.fixture
def tutorial(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "scripts"))
    import tutorial

    yield tutorial
    sys.modules.pop("tutorial", None)


def code(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def outputs(notebook):
    return [output for cell in code(notebook) for output in cell.outputs]


def test_it_is_a_notebook_that_was_executed_in_order(notebook):
    """Of the current format, every cell run once from the top, none with an error."""
    nbformat.validate(notebook)
    assert [cell.execution_count for cell in code(notebook)] == [
        number + 1 for number in range(len(code(notebook)))
    ]
    assert {output.output_type for output in outputs(notebook)} <= {
        "stream",
        "execute_result",
        "display_data",
    }


def test_it_shows_a_flight_estimators_a_sweep_an_own_estimator_and_an_own_map(notebook):
    """Its cells are Python, and call the functions of these steps."""
    source = "\n".join(cell.source for cell in code(notebook))
    steps = (
        "gg.simulate(",
        "gg.judge(",
        ".plot()",
        "gg.sweep(",
        "%%writefile",
        "ggbench map build",
    )
    places = [source.index(step) for step in steps]
    assert places == sorted(places)
    for cell in code(notebook):
        if not cell.source.startswith("%%sh"):
            ast.parse(re.sub(r"^%%.*", "", cell.source))
    assert sum(PICTURE in output.get("data", {}) for output in outputs(notebook)) == 3


def test_its_outputs_are_small_and_name_no_machine(notebook, tutorial):
    """Pictures of at most 60 kB, no paths, no times of a run."""
    assert PATH.stat().st_size < 250_000
    assert [set(cell.metadata) for cell in notebook.cells] == [set()] * len(notebook.cells)
    assert set(notebook.metadata) == {"kernelspec", "language_info"}
    for output in outputs(notebook):
        contents = output.get("data", {"text": output.get("text")})
        for kind, content in contents.items():
            if kind == PICTURE:
                assert len(base64.b64decode(content)) <= tutorial.PICTURE_BYTES
            else:
                assert not re.search(r"(?:^|\s)(?:/\w+/|file:|[A-Z]:\\)|\d\d:\d\d:\d\d", content)


def test_its_links_lead_somewhere(notebook):
    """Pages of the site."""
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            for target in re.findall(r"\]\(([^)#]+)", cell.source):
                assert (PATH.parent / target).exists(), target


def altered(notebook, change):
    """Return a copy whose outputs were changed by a function, and the ids of the changed cells."""
    other = copy.deepcopy(notebook)
    changed = [cell.id for cell in code(other) if change(cell)]
    assert changed
    return other, changed


def number(cell):
    """Change one number of a table by 3 %."""
    for output in cell.outputs:
        text = output.get("data", {}).get("text/plain", "")
        (found, *_) = re.findall(r"\b\d{2,}\.\d\d\b", text) or [None]
        if found:
            output.data["text/plain"] = text.replace(found, f"{1.03 * float(found):.2f}", 1)
            return True
    return False


def word(cell):
    """Change a word of a printed text."""
    for output in cell.outputs:
        if output.output_type == "stream" and "position" in output.text:
            output.text = output.text.replace("position", "velocity", 1)
            return True
    return False


def picture(cell):
    """Paint a black rectangle over a part of a picture."""
    for output in cell.outputs:
        if PICTURE in output.get("data", {}):
            image = Image.open(io.BytesIO(base64.b64decode(output.data[PICTURE]))).convert("RGB")
            width, height = image.size
            box = (width // 5, height // 5, width // 2, height // 2)
            ImageDraw.Draw(image).rectangle(box, fill="black")
            packed = io.BytesIO()
            image.save(packed, "PNG")
            output.data[PICTURE] = base64.b64encode(packed.getvalue()).decode()
            return True
    return False


def output(cell):
    """Remove an output."""
    return bool(cell.outputs and cell.outputs.pop())


@thinned("change", [number, word, picture, output], every=4)
def test_another_output_is_noticed(notebook, tutorial, change):
    """Each changed cell is named; equal notebooks have no difference."""
    other, changed = altered(notebook, change)
    sentences = tutorial.differences(notebook, other)
    assert [sentence.partition(":")[0] for sentence in sentences] == changed
    assert tutorial.differences(notebook, copy.deepcopy(notebook)) == []


def test_last_digits_may_differ(notebook, tutorial):
    """Another processor turns a number by 0.2 %."""

    def rounded(cell):
        for output in cell.outputs:
            if "109.88" in output.get("data", {}).get("text/plain", ""):
                output.data["text/plain"] = output.data["text/plain"].replace("109.88", "109.70")
                return True
        return False

    other, _ = altered(notebook, rounded)
    assert tutorial.differences(notebook, other) == []


def test_it_is_executed_by_continuous_integration():
    """`.ci/run` calls the target that executes and compares."""
    assert " tutorial-check " in (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert re.search(r"^tutorial-check:.*\n\t.*docs/scripts/tutorial\.py$", makefile, re.M)
