"""Findings over all scenarios, as sentences for the front page."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from ..results.digest import Digest


def findings(digests: Sequence[Digest]) -> list[str]:
    """Return what holds over the cases of all scenarios, a sentence each."""
    tables = [digest.cases for digest in digests]
    cases = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()
    if cases.empty:
        return []
    total, counts = len(cases), cases["gain"].value_counts()
    none = int((cases["consistent"] == 0).sum())
    return [
        f"Aiding reduces the error of the INS in {counts.get('better', 0)} of {total} cases.",
        f"No causal estimator is consistent in {none} of {total} cases.",
        f"An estimator is recommended in {int((cases['recommended'] != '').sum())} of {total} "
        "cases.",
    ]
