"""Estimators that cost much get fewer runs where the scenario says so."""

from __future__ import annotations

import pytest
from campaigns import plan, ran, small
from problems import SMALL

from ggbench.errors import GGBenchError

COSTLY = SMALL.replace(
    "[campaign]", '[campaign]\nfewer_runs = { "ekf[iterations=2]" = 2 }'
).replace("estimators = [", 'estimators = ["ekf[iterations=2]", ')
LABELS = ("ins", "ekf", "ekf[iterations=2]")


def test_an_estimator_gets_its_first_runs_and_the_others_all(tmp_path):
    """They are the same flights; comparisons are of those that both have; a remark says it."""
    scenario = small(tmp_path, COSTLY)
    results = ran(tmp_path, labels=LABELS, runs=4, scenario=scenario)
    found = results.runs().groupby(["case", "estimator"])["run"].apply(list)
    for case in results.manifest["cases"]:
        assert found[case, "ekf"] == found[case, "ins"] == [0, 1, 2, 3]
        assert found[case, "ekf[iterations=2]"] == [0, 1]
    table = results.paired()
    few = (table["first"] == LABELS[2]) | (table["second"] == LABELS[2])
    assert set(table.loc[few, "runs"]) == {2}
    assert set(table.loc[~few, "runs"]) == {4}
    results.store.close()
    store, remarks = plan(tmp_path, "out", LABELS, runs=4, scenario=scenario).open()
    store.close()
    (remark,) = [r for r in remarks if "fewer_runs" in r]
    assert remark.startswith("ekf[iterations=2] gets the first 2 of 4 runs")


def test_few_runs_are_not_made_fewer_and_nothing_is_missing(tmp_path):
    scenario = small(tmp_path, COSTLY)
    work = plan(tmp_path, "out", LABELS, runs=1, scenario=scenario)
    store, remarks = work.open()
    assert not [r for r in remarks if "fewer_runs" in r]
    assert work.missing(store) == 3 * len(scenario.cases)
    store.close()
    ran(tmp_path, labels=LABELS, runs=4, scenario=scenario).store.close()
    again = plan(tmp_path, "out", LABELS, runs=4, scenario=scenario)
    assert again.missing(again.open()[0]) == 0


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        ("{ ukf = 2 }", "names 'ukf', which is not among the estimators: ins, ekf"),
        ("{ ekf = 0 }", "fewer_runs of 'ekf' must be a number of runs"),
        ("{ ekf = true }", "found True"),
        ("{ ekf = 2.5 }", "found 2.5"),
        ("3", "must be a table, found 3"),
    ],
)
def test_what_means_nothing_is_refused(tmp_path, said, reason):
    with pytest.raises(GGBenchError, match=reason):
        small(tmp_path, SMALL.replace("[campaign]", f"[campaign]\nfewer_runs = {said}"))
