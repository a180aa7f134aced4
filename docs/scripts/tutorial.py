"""Execution of the tutorial notebook, with renewal or comparison of its outputs.

``make tutorial`` renews the outputs of ``docs/tutorial.ipynb``. ``make tutorial-check`` executes
the notebook and fails if a text, a number or a picture differs from the stored one.
"""

from __future__ import annotations

import argparse
import base64
import io
import os
import re
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import nbformat
import numpy as np
from nbclient import NotebookClient
from nbformat import NotebookNode
from PIL import Image

NOTEBOOK = Path(__file__).parents[1] / "tutorial.ipynb"
LONGEST_CELL_S = 300
PICTURE_BYTES = 60_000
_COLOURS = 64
_RELATIVE = 0.01
"""Largest relative difference of numbers due to another processor or another NumPy."""
_CHANNEL, _PIXELS = 0.25, 0.01
"""Largest difference of a channel in equal pixels, and largest share of unequal pixels."""
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_PICTURE = "image/png"


def executed(notebook: NotebookNode) -> NotebookNode:
    """Return a notebook with new outputs, executed in an empty folder.

    Parameters
    ----------
    notebook : notebook to be executed; it is not changed.

    Raises
    ------
    CellExecutionError, CellTimeoutError
        If a cell fails, or takes longer than :data:`LONGEST_CELL_S`.
    """
    fresh = nbformat.from_dict(notebook)
    # Shell cells call the ggbench of this Python.
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(
            fresh,
            timeout=LONGEST_CELL_S,
            kernel_name="python3",
            record_timing=False,
            resources={"metadata": {"path": folder}},
        )
        client.execute()
    for cell in fresh.cells:
        if cell.cell_type == "code":
            cell.outputs = list(_small(cell.outputs))
    fresh.metadata = notebook.metadata
    return fresh


def _small(outputs: list[NotebookNode]) -> Iterator[NotebookNode]:
    """Yield outputs with joined streams and with pictures of few colours."""
    joined: NotebookNode | None = None
    for output in outputs:
        if output.output_type == "stream":
            if joined is not None and joined.name == output.name:
                joined.text += output.text
                continue
            joined = output
        elif _PICTURE in output.data:
            picture = Image.open(io.BytesIO(base64.b64decode(output.data[_PICTURE])))
            packed = io.BytesIO()
            picture.convert("RGB").quantize(_COLOURS).save(packed, "PNG", optimize=True)
            output.data[_PICTURE] = base64.b64encode(packed.getvalue()).decode("ascii")
        yield output


def differences(kept: NotebookNode, new: NotebookNode) -> list[str]:
    """Return a sentence for each cell whose outputs differ.

    Words must be equal, numbers within 1 %, and pictures in 99 % of their pixels.

    Parameters
    ----------
    kept : notebook with the stored outputs.
    new : the same notebook, executed again.
    """
    return [
        f"{cell.id}: {reason}"
        for cell, other in zip(kept.cells, new.cells, strict=True)
        if cell.cell_type == "code"
        for reason in [_difference(cell.outputs, other.outputs)]
        if reason
    ]


def _difference(kept: list[NotebookNode], new: list[NotebookNode]) -> str:
    """Return the difference of the outputs of one cell, or ""."""
    kinds = [[_kinds(output) for output in outputs] for outputs in (kept, new)]
    if kinds[0] != kinds[1]:
        return f"the outputs are {kinds[1]} instead of {kinds[0]}"
    for output, other in zip(kept, new, strict=True):
        for kind in _kinds(output):
            one, two = _content(output, kind), _content(other, kind)
            if kind == _PICTURE:
                if not _same_picture(one, two):
                    return "the picture has changed"
            elif not _same_text(one, two):
                return f"{kind} is now\n{two}\ninstead of\n{one}"
    return ""


def _kinds(output: NotebookNode) -> tuple[str, ...]:
    """Return the names of an output's contents."""
    return (output.name,) if output.output_type == "stream" else tuple(sorted(output.data))


def _content(output: NotebookNode, kind: str) -> str:
    """Return one content of an output."""
    return output.text if output.output_type == "stream" else output.data[kind]


def _same_text(one: str, two: str) -> bool:
    """Return whether two texts have equal words and, within 1 %, equal numbers."""
    if [part.split() for part in _NUMBER.split(one)] != [
        part.split() for part in _NUMBER.split(two)
    ]:
        return False
    numbers = [np.array(_NUMBER.findall(text), float) for text in (one, two)]
    # The last printed digit of a small number may change.
    return bool(np.allclose(*numbers, rtol=_RELATIVE, atol=0.011))


def _same_picture(one: str, two: str) -> bool:
    """Return whether two pictures have equal sizes and nearly equal pixels."""
    first, second = (
        np.asarray(Image.open(io.BytesIO(base64.b64decode(text))).convert("RGB"), float) / 255.0
        for text in (one, two)
    )
    if first.shape != second.shape:
        return False
    return float(np.mean(np.abs(first - second).max(axis=2) > _CHANNEL)) < _PIXELS


def main() -> None:
    """Execute the notebook, and store or compare its outputs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="store the new outputs")
    write = parser.parse_args().write
    kept = nbformat.read(NOTEBOOK, as_version=4)
    begin = time.perf_counter()
    new = executed(kept)
    print(f"{NOTEBOOK.name} was executed in {time.perf_counter() - begin:.0f} s")
    if write:
        nbformat.write(new, NOTEBOOK)
        return
    changed = differences(kept, new)
    if changed:
        sys.exit("\n".join([*changed, "To store the new outputs: make tutorial"]))


if __name__ == "__main__":
    main()
