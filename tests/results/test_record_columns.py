"""Records: stored and read in one form, and refused by the database where they are none."""

from __future__ import annotations

import math
import sqlite3

import numpy as np
import pytest
from campaigns import failed, finished

from ggbench.judging import fix_metrics
from ggbench.results.columns import BLANK, FIX_COLUMNS, WINDOW_COLUMNS
from ggbench.results.database import Result, StoreError
from ggbench.results.store import Store


@pytest.fixture
def store(tmp_path):
    made = Store(tmp_path / "out", create=True)
    yield made
    made.close()


def same(one: object, other: object) -> bool:
    return one == other or (one != one and other != other)


UNDEFINED = dict.fromkeys(
    (
        "settled_nees",
        "settled_nis",
        "settled_coverage",
        "settled_oracle_position_ms",
        "settled_oracle_velocity_ms",
        "converged_s",
    ),
    math.nan,
)
RECORDS = [
    failed(0, info={"rounds": 7}),
    failed(1, seconds=0.5, traceback="a\nb"),
    finished(2),
    finished(3, cold=True, remark="far \N{EURO SIGN} \0", false_fix=True, seed=2**63 - 1),
    finished(4, **UNDEFINED),
    finished(5, whole_position_ms=math.inf, whole_nees=1.0 / 3.0),
]
"""An estimate without a covariance has no NEES, a flight without measurements no NIS; a run whose
model is wrong has no oracle; one that does not converge has no time; one that diverges ends
anywhere."""


def test_a_record_is_read_as_it_was_handed_over(store):
    """Value by value, with its type, and bit by bit; the table of runs has the same numbers."""
    store.add([Result("k", record) for record in RECORDS])
    found = list(store.records("k", 9))
    table = store.runs({"k"}, 9)
    assert len(found) == len(table) == len(RECORDS)
    for before, after in zip(RECORDS, found, strict=True):
        assert list(after) == list(before) == list(BLANK)
        assert all(same(before[name], after[name]) for name in before)
        assert [type(v) for v in after.values()] == [type(v) for v in before.values()]
    for name in table.columns.drop(["key", "bound", "map_evaluations", "diverged", "false_fix"]):
        assert all(map(same, table[name].tolist(), [record[name] for record in RECORDS])), name
    assert table["map_evaluations"].tolist()[2:] == [20.0] * 4
    assert table["map_evaluations"].isna().tolist() == [True] * 2 + [False] * 4
    assert table["false_fix"].tolist() == [False, False, False, True, False, False]


def test_tables_have_their_types_whatever_they_hold(store):
    """Of no runs, of failed ones alone, of all: truths are truths, and numbers are numbers."""
    store.add([Result("failed", RECORDS[0]), *(Result("all", record) for record in RECORDS)])
    tables = [store.runs(keys, 9) for keys in ({"none"}, {"failed"}, {"all"})]
    assert [len(table) for table in tables] == [0, 1, 6]
    for table in tables:
        kinds = {name: table[name].dtype.kind for name in ("run", "seed", "cold", "diverged")}
        assert kinds == {"run": "i", "seed": "i", "cold": "b", "diverged": "b"}
        numbers = ("seconds", "map_evaluations", "converged_s", *WINDOW_COLUMNS)
        assert {table[name].dtype.kind for name in numbers} == {"f"}


FLAWS = [
    {"run": -1},
    {"run": None},
    {"seed": -1},
    {"seconds": -0.1},
    {"seconds": math.inf},
    {"map_evaluations": -1},
    {"map_evaluations": 2.5},
    {"final_position_error_m": "far"},
    {"causality": "future"},
    {"status": "tired"},
    {"diverged": 2},
    {"required_m": -1.0},
    {"required_m": math.inf},
    {"converged_s": "soon"},
    {"false_fix": None},
    {"bound": None},
    {"whole_bound_position_ms": -1.0},
    {"last20_velocity_ms": math.nan},
    {"name": None},
    {"settled_nis": "none"},
    {"reason": None},
    {"fixes": -1},
]


@pytest.mark.parametrize("flaw", FLAWS, ids=str)
def test_a_record_that_is_none_is_not_stored(flaw, store):
    """Counts and squares are not negative, numbers are no texts, and none is missing."""
    (name,) = flaw
    with pytest.raises(StoreError, match=rf"cannot write to .*: .*\b{name}\b"):
        store.add([Result("k", finished() | flaw)])
    assert list(store.records("k", 1)) == []


@pytest.mark.parametrize("extra", [{"diverged": False}, {"settled_nees": 6.0}, {"fixes": 0}])
def test_a_failed_run_has_no_metrics(extra, store):
    with pytest.raises(StoreError, match=next(iter(extra))):
        store.add([Result("k", failed() | extra)])


@pytest.mark.parametrize(
    "change",
    [
        "records SET whole_nees = 'six'",
        "records SET run = -1",
        "records SET status = NULL",
        "curves SET series = x'0011'",
        "curves SET series = substr(series, 5)",
    ],
)
def test_a_row_that_was_spoilt_is_found(change, store):
    """The database refuses the change; made without its checks, the folder is refused."""
    store.add([Result("k", finished(), np.ones((2, 4)), np.ones((2, 18)))])
    store.close()
    path = store.folder / "records.sqlite"
    with sqlite3.connect(path) as connection, pytest.raises(sqlite3.IntegrityError):
        connection.execute(f"UPDATE {change}")
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA ignore_check_constraints = ON")
        connection.execute(f"UPDATE {change}")
    connection.close()
    refusals = []
    for create in (False, True):
        with pytest.raises(
            StoreError, match=r"records\.sqlite is damaged \(.*\): .*--fresh"
        ) as told:
            Store(store.folder, create)
        refusals.append(told)
    # The refusals are held, and with them all that their frames hold: no lock may be among it.
    Store(store.folder, create=True, fresh=True).close()


def test_a_record_that_is_replaced_takes_its_series_with_it(store):
    """A run that is lost in a second attempt has no series of the first."""
    store.add([Result("k", finished(run), np.ones((2, 4)), np.ones((2, 18))) for run in range(2)])
    store.add([Result("k", failed(1))])
    assert store.series_of("k", 1) is None and store.detail("k", 1) is None
    assert len(store.series("k", 2)) == 1


def test_columns_of_fixes_are_those_that_are_judged():
    names = [column.name for column in FIX_COLUMNS if column.tabled]
    assert names == ["run", *fix_metrics.ROWS]
