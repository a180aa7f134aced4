"""The page of frameworks is of its table, which has a row for every adapter."""

from pathlib import Path

import pytest
from frameworks import page
from frameworks.packages import FRAMEWORKS

from ggbench.campaign import registry
from ggbench.errors import GGBenchError

REPORTS = Path(__file__).parents[1] / "reports"


@pytest.fixture(scope="module")
def committed():
    return page.read(REPORTS / page.FOLDER)


def test_the_committed_page_is_of_the_committed_table(committed):
    assert page.page(committed) == (REPORTS / "frameworks.md").read_text(encoding="utf-8")


def test_every_framework_has_a_row(committed):
    """And at least one estimator of each adapter; the page has seven packages or more."""
    assert committed["estimator"].tolist() == [framework.label for framework in FRAMEWORKS]
    packages = {name.rpartition("-")[0] for name in registry.framework_points()}
    assert packages <= {framework.label.rpartition("-")[0] for framework in FRAMEWORKS}
    assert committed["package"].nunique() >= 7


def agree(text: str) -> int:
    """The number of estimators that agree, as the answer says."""
    return int(text.split(" of ")[0].rpartition(" ")[2])


def test_filters_agree_to_a_millionth(committed):
    """But those whose sigma points are others; searches of the batch problem to 1e-4."""
    held = committed.set_index("estimator")["difference [prior σ]"].drop([*page.SEARCHES])
    assert set(held.index[held > page.SAME]) == {"bayesfilter-ukf", "kalbee-ckf"}
    assert held.min() >= 0.0 and page.SAME <= 1e-6 and page.ENDED <= 1e-4


def test_a_demand_that_fails_and_a_difference_are_named(committed):
    """No row of the committed table need fail: two are made to."""
    changed = committed.copy()
    changed.loc[0, "contract"] = "8 of 9: not gaps"
    changed.loc[1, "difference [prior σ]"] = 3e-2
    text = page.page(changed)
    assert f"`{changed.loc[0, 'estimator']}`: 8 of 9: not gaps." in text
    assert f"`{changed.loc[1, 'estimator']}` (3e-02)" in text
    answer = "**Answer.** The estimation framework changes the time, not the accuracy."
    assert f"{answer} {agree(text)} of" in text
    assert agree(text) == agree(page.page(committed)) - 1


def test_a_table_that_is_missing_is_named(tmp_path):
    with pytest.raises(GGBenchError, match="make frameworks writes it"):
        page.read(tmp_path)
