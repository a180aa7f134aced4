"""What an estimator remarks of a run: stored so that it can be read again, or refused."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest
from campaigns import plan, ran

from ggbench.campaign import execution, running
from ggbench.campaign.records import remarks
from ggbench.report import render
from ggbench.results.folder import Results
from ggbench.results.store import Result, Store

RECORD = {
    "name": "x", "parameters": "", "causality": "none", "run": 0, "seed": 1, "status": "failed",
    "reason": "none",
}  # fmt: skip


def nested(depth: int) -> dict:
    found: dict = {}
    for _ in range(depth):
        found = {"": found}
    return found


@pytest.mark.parametrize(
    "info",
    [
        {"file": "a\udc80b"},
        {"a\ud83db": [1, {"c": "\udfff"}]},
        {"nul": "a\0b", "escape": "\x1b[31m", "not a number": float("nan")},
        {"large": 10**4000, "infinite": float("inf")},
        *({"deep": nested(depth)} for depth in (150, 190, 195, 196, 197, 198, 199, 200, 205, 900)),
        {"larger": 10**5000},
        {"long": "x" * 200_000},
        nested(100_000),
    ],
    ids=lambda info: str(next(iter(info)))[:9].encode(errors="replace").decode(),
)
def test_remarks_that_are_accepted_can_be_read_again(info, tmp_path):
    """Whatever is in them: they are refused before anything is written, or come back the same."""
    try:
        kept = remarks(info)
    except (ValueError, RecursionError):
        return
    store = Store(tmp_path, create=True)
    store.add([Result("key", RECORD | {"info": kept})])
    (found,) = store.records("key", 1)
    assert found["reason"] == "none"
    assert str(found["info"]) == str(kept)


def test_halves_of_characters_cost_no_run():
    """A remark with the name of a file in other bytes is kept, with what can be said of it."""
    assert remarks({"file": "a\udc80b", "\ud83d": 1}) == {"file": "a?b", "?": 1}
    assert remarks({"smile": "😀", "nul": "\0"}) == {"smile": "😀", "nul": "\0"}


@pytest.fixture
def damaged(tmp_path) -> Path:
    """A folder of nine results of each of two cases, one of which cannot be read."""
    results = ran(tmp_path, labels=("ins", "ekf"), runs=3)
    key = next(cell.key for cell in results.cells if cell.estimator == "ekf")
    results.store.close()
    with sqlite3.connect(tmp_path / "out" / "records.sqlite") as connection:
        changed = connection.execute(
            "UPDATE records SET record = json_set(record, '$.info', json(?)) "
            "WHERE key = ? AND run = 1",
            (r'{"file": "\udc80"}', key),
        )
        assert changed.rowcount == 1
    connection.close()
    return tmp_path / "out"


@pytest.mark.long
def test_a_damaged_record_does_not_hide_the_others(damaged, tmp_path):
    """It is a run that failed, with the reason; tables and report are of all the others."""
    results = Results(damaged)
    table = results.runs()
    bad = table[table["status"] != "ok"]
    assert len(table) == 12
    assert bad[["case", "estimator", "name", "causality", "run"]].to_numpy().tolist() == [
        ["base", "ekf", "ekf", "filter", 1]
    ]
    assert "records.sqlite is damaged: lone" in bad["reason"].iloc[0]
    results.store.close()
    text = render.write(damaged, tmp_path / "reports")[0].read_text()
    assert "1 failed run" in text
    failures = tmp_path / "reports" / "small" / "data" / "failures.csv"
    assert "a record in " in failures.read_text()


def test_the_same_command_replaces_damaged_records(damaged, tmp_path):
    """What cannot be read is run again, and said; nothing else is."""
    work = plan(tmp_path, "out", ("ins", "ekf"), runs=3)
    store, remarks = work.open()
    assert len(remarks) == 1 and "holds 1 records that cannot be read" in remarks[0]
    tasks = work.tasks(store)
    assert tasks.results == 1
    running.execute(execution.in_process(tasks), store, lambda batch: None)
    assert (Results(damaged, store).runs()["status"] == "ok").all()
