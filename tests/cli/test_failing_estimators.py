"""What ``ggbench run`` says of estimators of a file: their names, and that all runs failed."""

from __future__ import annotations

import pytest
from command import invoke
from problems import SMALL

from ggbench.estimator_spec import shown_names
from ggbench.figures.numbers import span

SOURCE = """
from dataclasses import dataclass
import numpy as np
from ggbench.problem import Estimate, Estimator


@dataclass(frozen=True)
class Mine(Estimator):
    fails: str = "never"
    name = "mine"
    causality = "filter"

    def estimate(self, problem, rng):
        if self.fails == "always" or self.fails == "odd" and rng.random() < 0.5:
            raise ValueError("as asked")
        return Estimate(np.zeros((problem.epochs, problem.dimension)), None, "filter")
"""


@pytest.mark.parametrize(
    ("fails", "code"), [("always", 1), ("odd", 0), ("never", 0)], ids=lambda value: str(value)
)
def test_an_estimator_whose_runs_all_fail_is_named_with_exit_code_1(fails, code, tmp_path):
    """Though another one finished; some failures are none of its own."""
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "my_file.py").write_text(SOURCE)
    label = f"my_file.py[fails={fails}]" if fails != "never" else "my_file.py"
    done = invoke(
        ["run", "small.toml", "-n", "8", "-j", "0", "-c", "base", "-e", "ins", "-e", label],
        tmp_path,
        columns=160,
    )
    assert done.returncode == code, done.stderr
    assert (f"All runs of {label} failed." in done.stdout) == bool(code)
    assert ("failed: 'ggbench show" in done.stdout) == (fails != "never")
    assert label.replace("my_file.py", "mine") in done.stdout


def test_an_estimator_of_a_file_has_its_own_name_on_the_screen(tmp_path):
    """In progress, tables and the view of a run; commands keep the file."""
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "my_file.py").write_text(SOURCE)
    run = ["run", "small.toml", "-n", "2", "-j", "0", "-c", "base", "-e", "my_file.py[fails=odd]"]
    done = invoke([*run, "-e", "my_file.py", "-e", "ins", "-o", "out"], tmp_path, columns=160)
    assert done.returncode == 0, done.stderr
    (last,) = [line for line in done.stdout.splitlines() if "4 of 6" in line or "6 of 6" in line]
    assert ", mine " in last and "my_file.py " not in last
    shown = invoke(["show", "out", "--run", "0"], tmp_path, columns=160).stdout
    rows = [
        line.split()[0] for line in shown.splitlines() if line.startswith((" mine", " my_file"))
    ]
    assert rows.count("mine") == 2
    assert all("ggbench run" in line for line in shown.splitlines() if "my_file.py" in line)


def test_estimators_of_one_name_are_told_apart_by_their_files():
    """Registered ones keep their labels; parameters stay with the name."""
    assert shown_names({"a/b.py[gain=2]": "mine", "ekf": "ekf", "c.py": "other"}) == {
        "a/b.py[gain=2]": "mine[gain=2]",
        "ekf": "ekf",
        "c.py": "other",
    }
    assert shown_names({"a.py": "mine", "b.py": "mine", "b.py[gain=2]": "mine"}) == {
        "a.py": "a.py",
        "b.py": "b.py",
        "b.py[gain=2]": "mine[gain=2]",
    }


def test_an_interval_of_equal_ends_is_one_number():
    """As the answer of a report, its findings and the tables of a terminal show it."""
    assert span("0.84", "0.84") == "0.84"
    assert span("0.83", "0.84") == "0.83 to 0.84"
