"""Code of users' own files changes no other estimator, whatever it changes in its process."""

from __future__ import annotations

import ctypes
import math
import pickle
import platform
import struct
import time
import zlib
from pathlib import Path

import numpy as np
import pytest
from campaigns import LABELS, plan, ran, records, small
from problems import SMALL

from ggbench import problem
from ggbench.campaign import campaign, registry
from ggbench.campaign.campaign import CampaignError
from ggbench.campaign.messages import GarbledError, Inbox, packed
from ggbench.campaign.texts import refusal
from ggbench.display.timing import Moment, duration
from ggbench.results.database import StoreError
from ggbench.results.store import Store, read_manifest
from ggbench.spec import scenario

FOREIGN = """
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
import numpy as np
from ggbench.problem import Estimate, Estimator


def refuse(*arguments, **options):
    raise ArithmeticError("no such function any more")


@dataclass(frozen=True)
class Foreign(Estimator):
    way: Literal["spoil", "isfinite", "clock", "pickle", "none"] = "none"
    name = "NAME"
    causality = "filter"

    def estimate(self, problem, rng):
        if getattr(np, "spoilt", False) or not np.isfinite(problem.noise_cov).all():
            raise ValueError("NumPy is another one")
        if self.way == "spoil":
            np.spoilt = True
        if self.way == "isfinite":
            np.isfinite = refuse
        if self.way == "clock":
            time.perf_counter = lambda: float("nan")
        if self.way == "pickle":
            import pickle
            pickle.dumps = lambda *arguments, **options: b"junk"
        score = Path("/proc/self/oom_score_adj")
        told = int(score.read_text()) if score.exists() else -1
        mean = np.zeros((problem.epochs, problem.dimension))
        return Estimate(mean, None, "filter", info={"oom_score": told})
"""


REPLACING = (
    FOREIGN.replace("NAME", "replacing")
    + """
    def skip(self, problem):
        if SKIPPING:
            pickle.dumps = refuse


import math
import pickle
import scipy.signal
SKIPPING = False
NUMBER = np.isfinite
"""
)


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("np.isfinite = refuse", "numpy.isfinite"),
        ("time.perf_counter = lambda: 0.0", "time.perf_counter"),
        ("np.linalg.inv, math.sqrt = refuse, refuse", "(numpy.linalg.inv|math.sqrt)"),
        ("import ggbench.problem as p; p.Estimate = Foreign", "ggbench.problem.Estimate"),
        ("import pandas; pandas.DataFrame.median = refuse", "pandas.DataFrame.median"),
        ("import os; os.getpid = refuse", "os.getpid"),
        ("np.isfinite = refuse; raise ValueError('no')", "cannot be imported: ValueError: no"),
        ("", ""),
    ],
)
def test_a_file_that_replaces_functions_when_it_is_imported_is_refused(statement, said, tmp_path):
    """The process that asks has them back; control: a file that only imports is accepted."""
    functions = np.isfinite, time.perf_counter, np.linalg.inv, math.sqrt, problem.Estimate
    file = tmp_path / "replacing.py"
    file.write_text(REPLACING + statement + "\n")
    if said:
        with pytest.raises(registry.EstimatorError, match=said):
            registry.choose(str(file))
    else:
        assert registry.choose(str(file)).estimator.name == "replacing"
    present = np.isfinite, time.perf_counter, np.linalg.inv, math.sqrt, problem.Estimate
    assert all(one is other for one, other in zip(functions, present, strict=True))


def test_what_a_file_sets_for_the_process_when_it_is_imported_is_restored(tmp_path):
    """The working directory and the treatment of floating-point errors."""
    file = tmp_path / "setting.py"
    file.write_text(f"{REPLACING}import os\nos.chdir('/')\nnp.seterr(all='raise')\n")
    before = Path.cwd(), np.geterr()
    assert registry.choose(str(file)).estimator.name == "replacing"
    assert (Path.cwd(), np.geterr()) == before


@pytest.mark.parametrize("reader", ["import", "skip"])
def test_the_rounding_mode_of_the_process_is_restored(reader, tmp_path):
    """Of a file that rounds towards zero when it is imported, or in its skip."""
    zero = 0xC00 if platform.machine() in ("x86_64", "AMD64") else 0xC00000
    rounding = f"import ctypes; assert ctypes.CDLL(None).fesetround({zero}) == 0"
    file = tmp_path / "rounding.py"
    file.write_text(f"{REPLACING}{rounding}\n")
    if reader == "skip":
        text = REPLACING.replace("if SKIPPING:", f"{rounding}\n        if SKIPPING:")
        assert text != REPLACING
        file.write_text(text)
    mode = ctypes.CDLL(None).fegetround()
    estimator = registry.choose(str(file)).estimator
    refusal(estimator, None)
    assert ctypes.CDLL(None).fegetround() == mode


OF_AN_INSTANCE = """
    def __post_init__(self):
        object.__setattr__(self, "skip", self.hidden)

    def hidden(self, problem):
"""


@pytest.mark.parametrize("place", ["class", "instance"])
def test_a_skip_that_replaces_a_function_is_a_refusal(place, tmp_path):
    """The function is put back; control: a skip that replaces nothing refuses nothing."""
    dumps, file, source = pickle.dumps, tmp_path / "skipping.py", REPLACING
    if place == "instance":
        source = source.replace("    def skip(self, problem):\n", OF_AN_INSTANCE)
        assert source != REPLACING
    for text, reason in (("True", "its skip replaces pickle.dumps"), ("False", "")):
        file.write_text(source.replace("SKIPPING = False", f"SKIPPING = {text}"))
        estimator = registry.choose(str(file)).estimator
        assert refusal(estimator, None) == reason
        assert pickle.dumps is dumps


@pytest.fixture
def files(tmp_path, monkeypatch) -> Path:
    """A folder with two estimator files; what they change in this process is restored."""
    for name in ("changer", "victim"):
        (tmp_path / f"{name}.py").write_text(FOREIGN.replace("NAME", name))
    for module, name in ((np, "isfinite"), (time, "perf_counter"), (pickle, "dumps")):
        monkeypatch.setattr(module, name, getattr(module, name))
    monkeypatch.setattr(np, "spoilt", False, raising=False)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_task_has_no_estimators_of_two_files(files):
    """Nor of a file and of the package; each run of each estimator is in a task."""
    work = plan(files, "out", ("changer.py", "ekf", "victim.py[way=clock]", "victim.py", "ins"))
    store, _ = work.open()
    tasks = [*work.tasks(store)]
    store.close()
    assert {task.guests for task in tasks} == {
        frozenset(),
        frozenset({"changer.py"}),
        frozenset({"victim.py"}),
    }
    for task in tasks:
        own = {label for label, _ in task.estimators if label.endswith((".py", "]"))}
        assert not own or len(own) == len(task.estimators)
    assert sum(len(task.runs) * len(task.estimators) for task in tasks) == 5 * 3 * 2


def test_a_failure_after_foreign_code_is_tried_again(files):
    """In one process it may be another file's doing; control: with its process whole, it is not."""
    spoilt = ran(files, labels=("changer.py[way=spoil]", "victim.py"))
    assert "victim.py" in set(spoilt.failures()["estimator"])
    spoilt.store.close()
    np.spoilt = False
    again = ran(files, labels=("victim.py",))
    runs = again.runs()
    assert (runs.loc[runs["estimator"] == "victim.py", "status"] == "ok").all()
    again.store.close()


@pytest.mark.long
def test_foreign_code_changes_no_other_estimator(files):
    """In worker processes: every record of the others is as if the file were not there.

    The clock of a record is the benchmark's own, and a worker is ended before its parent where
    memory runs out.
    """
    alone = ran(files, "alone", LABELS)
    labels = ("changer.py[way=isfinite]", "victim.py", *LABELS)
    mixed = ran(files, "mixed", labels, jobs=1)
    found = {key: record for key, record in records(mixed).items() if key[1] in LABELS}
    assert found == records(alone)
    runs = mixed.runs()
    assert (runs.loc[runs["estimator"] == "victim.py", "status"] == "ok").all()
    told = [r["info"]["oom_score"] for r in mixed.records() if r["estimator"] == "victim.py"]
    assert set(told) <= {800, -1}


@pytest.mark.long
def test_a_process_that_changes_its_messages_has_died(files):
    mixed = ran(files, labels=("changer.py[way=pickle]", "ekf"), jobs=1, runs=1)
    runs = mixed.runs()
    assert (runs.loc[runs["estimator"] == "ekf", "status"] == "ok").all()
    (reason,) = set(mixed.failures()["reason"])
    assert "wrote to the socket for results" in reason


def test_a_message_that_cannot_be_unpickled_is_none():
    """Its length and checksum are right; control: a message as it is sent."""
    assert [*Inbox().take(packed("hello"))] == ["hello"]
    mark = packed("hello")[:4]
    junk = struct.pack("<4sIQ", mark, zlib.crc32(b"junk"), 4) + b"junk"
    with pytest.raises(GarbledError):
        list(Inbox().take(junk))


def test_a_clock_that_an_estimator_changes_times_no_run(files):
    """Times are finite numbers; a clock that is set back is no negative duration."""
    found = ran(files, labels=("changer.py[way=clock]",))
    seconds = found.runs()["seconds"].to_numpy()
    found.store.close()
    assert np.isfinite(seconds).all() and (seconds >= 0.0).all()
    assert duration(-10791.0) == "0 s"
    start = Moment.now()
    assert start._replace(wall=start.wall + 10791.0).since().startswith("0 s, and ")


def test_a_folder_is_asked_again_whose_it_is_once_it_is_locked(tmp_path, monkeypatch):
    """Another campaign finishes in it while the first one prepares: its results stay."""
    other = small(tmp_path, SMALL)
    slow = plan(tmp_path, "out", ("ins",))
    checked = campaign.check

    def finish_another(*arguments):
        monkeypatch.setattr(campaign, "check", checked)
        renamed = tmp_path / "other.toml"
        renamed.write_text(other.source)
        ran(tmp_path, labels=("ins",), scenario=scenario.load(str(renamed))).store.close()
        yield from checked(*arguments)

    monkeypatch.setattr(campaign, "check", finish_another)
    with pytest.raises(StoreError, match="contains results of the scenario other, not of small"):
        slow.open()
    assert read_manifest(tmp_path / "out")["scenario"] == "other"
    Store(tmp_path / "out", create=True).close()  # it is not locked any more


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"runs": 10**9}, "runs is 1000000000 and must be from 1 to 1000000"),
        ({"runs": 0}, "runs is 0"),
        ({"seed": -5}, "seed is -5 and must be from 0"),
    ],
)
def test_bounds_are_checked_before_anything_is_written(asked, said, tmp_path):
    with pytest.raises(CampaignError, match=said):
        plan(tmp_path, "out", ("ins",), **asked)
    assert not (tmp_path / "out").exists()


def test_a_label_with_a_null_character_is_refused():
    with pytest.raises(registry.EstimatorError, match="contains a null character"):
        registry.choose("a\0.py")
