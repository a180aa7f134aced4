"""Every two estimators of a case beside each other, run by run."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

from ggbench.judging import statistics
from ggbench.judging.run_errors import WINDOWS
from ggbench.judging.summary import PAIRED_COLUMNS, paired_table


def table_of(position: dict[str, list[float]], case: str = "c") -> pd.DataFrame:
    """A table of runs with given position errors by estimator; NaN failed, None was not run."""
    rows = [
        {"assumption": "", "case": case, "estimator": label, "seed": 1, "run": run}
        | {"status": "failed" if math.isnan(value) else "ok", "diverged": False}
        | {"lock_time_s": math.nan, "false_lock": None}
        | {"final_position_error_m": math.sqrt(value), "final_ins_error_m": math.nan}
        | {f"{window}_position_ms": value for window in WINDOWS}
        | {f"{window}_velocity_ms": value / 100.0 for window in WINDOWS}
        for label, values in position.items()
        for run, value in enumerate(values)
        if value is not None
    ]
    return pd.DataFrame(rows)


def test_estimators_are_set_beside_each_other_run_by_run():
    """Every pair once, in order; a failed run loses, one not run does not count; by hand."""
    nan = math.nan
    table = table_of(
        {
            "z": [1.0, 2.0, 3.0, 4.0, nan, nan, 7.0],
            "a": [2.0, 3.0, 3.0, 2.0, 5.0, nan, None],
            "m": [1.0, 2.0, 3.0, nan, nan, 6.0, 7.0],
        }
    )
    study = table.assign(assumption="other")
    pairs = paired_table(pd.concat([table, study, table_of({"alone": [1.0]}, "d")]), {})
    assert tuple(pairs.columns) == PAIRED_COLUMNS
    assert list(zip(pairs["first"], pairs["second"], pairs["window"], strict=True)) == [
        (*pair, window) for pair in (("z", "a"), ("z", "m"), ("a", "m")) for window in WINDOWS
    ]
    row = pairs.iloc[0]
    assert (row["case"], row["runs"], row["first_only"], row["second_only"]) == ("c", 4, 0, 1)
    assert row["position_difference_m2"] == 0.0
    assert row["position_relative"] == 0.0
    assert row["position_win_rate"] == pytest.approx((2 + 0.5) / 5)  # one tie, one lost by failing
    assert row["velocity_win_rate"] == row["position_win_rate"]
    row = pairs[(pairs["first"] == "z") & (pairs["second"] == "m")].iloc[0]
    assert (row["runs"], row["first_only"], row["second_only"]) == (4, 1, 1)
    assert (row["position_win_rate"], row["position_verdict"]) == (0.5, "not distinguishable")


def test_pairs_without_a_common_run():
    """Where no run finished in both there are counts and no differences; without runs, no rows."""
    failed = table_of({"a": [1.0, 2.0], "b": [math.nan, math.nan]})
    row = paired_table(failed, {}).iloc[0]
    assert (row["runs"], row["first_only"], row["second_only"]) == (0, 2, 0)
    assert math.isnan(row["position_difference_m2"]) and math.isnan(row["velocity_lo"])
    assert (row["position_win_rate"], row["position_verdict"]) == (1.0, "not distinguishable")
    both = table_of({"a": [math.nan], "b": [math.nan]})
    assert math.isnan(paired_table(both, {}).iloc[0]["position_win_rate"])
    assert paired_table(failed[:0], {}).empty


def test_the_verdict_of_a_table_is_that_of_the_pair():
    """A pair of the table has the figures of the same pair alone, in both quantities."""
    generator = np.random.default_rng(2)
    common = generator.chisquare(3, 40)
    table = table_of({label: list(common * generator.chisquare(9, 40)) for label in "abc"})
    for row in paired_table(table, {}).to_dict("records"):
        first, second = (
            table.loc[table["estimator"] == row[key], "whole_velocity_ms"].to_numpy()
            for key in ("first", "second")
        )
        alone = statistics.paired(first, second)
        for key in ("lo", "hi", "relative", "win_rate"):
            assert row[f"velocity_{key}"] == pytest.approx(getattr(alone, key))
        assert row["velocity_difference_m2ps2"] == pytest.approx(alone.difference)
        assert row["velocity_verdict"] == alone.verdict


def test_runs_of_two_seeds_are_not_paired():
    """Run 0 of another seed is another flight."""
    one, other = table_of({"a": [1.0, 2.0]}), table_of({"b": [1.0, 2.0]}).assign(seed=2)
    row = paired_table(pd.concat([one, other]), {}).iloc[0]
    assert (row["runs"], row["first_only"], row["second_only"]) == (0, 0, 0)
