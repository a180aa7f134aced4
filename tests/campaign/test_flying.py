"""A campaign is flown by one function: results, tables, and what becomes of missing runs."""

from __future__ import annotations

import pytest
from campaigns import plan

from ggbench.campaign import running
from ggbench.results.folder import Results


def stopped(error: BaseException | None):
    """Return a stand-in for :func:`running.execute` that stores nothing."""

    def execute(results, store, progress):
        results.close()
        if error is not None:
            raise error

    return execute


@pytest.mark.parametrize(
    ("error", "expected"),
    [(None, running.MissingRunsError), (KeyboardInterrupt(), running.InterruptedCampaign)],
)
def test_a_campaign_without_results_can_be_continued(error, expected, tmp_path, monkeypatch):
    """Its tables are there, its folder is closed, and the same call flies what is missing."""
    with monkeypatch.context() as patch:
        patch.setattr(running, "execute", stopped(error))
        with pytest.raises(expected) as raised:
            running.fly(plan(tmp_path, "out", ("ins",)), jobs=0)
    assert raised.value.results.metrics().empty
    assert (tmp_path / "out" / "metrics.csv").exists()
    if error is None:
        assert "gave no result; the same command resumes" in str(raised.value)
    steps = []
    results = running.fly(plan(tmp_path, "out", ("ins",)), jobs=0, progress=steps.append)
    assert steps[0].total == steps[-1].done == len(results.runs())
    assert len(Results(tmp_path / "out").metrics()) == len(results.metrics()) > 0
