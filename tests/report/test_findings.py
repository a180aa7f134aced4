"""Findings of the front page: each is printed where its metrics support it, and only there."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from ggbench.report.findings import (
    FILTERS,
    FINDINGS,
    MEASURED,
    NARROW,
    SUITE,
    Metrics,
    findings,
    outage,
)
from ggbench.results import digest
from ggbench.spec import scenario

REPORTS = Path(__file__).parents[2] / "reports"
ROWS = {
    ("0.3km", "ins"): {"rms_m": 400.0},
    ("0.3km", "gauss-newton"): {"rms_m": 60.0, "consistency": "consistent"},
    ("white", "gauss-newton"): {"nees": 17.0, "consistency": "unsafe"},
    **{(case, name): {"rms_m": 70.0, "efficiency": 1.0} for case in NARROW for name in FILTERS},
    ("air-narrow", "ekf[loss=cauchy]"): {"rms_m": 73.0},
    ("prior-3", "ekf"): {"success": 0.05, "consistency": "unsafe"},
    ("prior-3", "rao-blackwellised"): {"success": 1.0, "rms_m": 9.0, "consistency": "consistent"},
    ("outliers", "ekf"): {"rms_m": 800.0},
    ("outliers", "ekf[loss=cauchy]"): {"rms_m": 90.0},
    ("map-error", "ekf"): {"rms_m": 780.0, "bound_m": 15.0, "consistency": "unsafe"},
    ("map-error-modelled", "ekf"): {"rms_m": 75.0, "consistency": "conservative"},
    ("gravity", "ekf"): {"rms_m": 200.0, "bound_m": 80.0, "consistency": "unsafe"},
    ("gnss-outage", "ekf"): {"rms_m": 190.0},
    ("gnss-outage", "ins"): {"rms_m": 1700.0},
    ("weak-field", "ekf"): {"rms_m": 200.0},
    ("weak-field", "ins"): {"rms_m": 230.0},
}
BREAKS = [
    ("measured", ("0.3km", "gauss-newton"), {"rms_m": 200.0}),
    ("measured", ("0.3km", "gauss-newton"), {"consistency": "overconfident"}),
    ("measured", ("white", "gauss-newton"), {"consistency": "consistent"}),
    ("narrow_prior", ("ship-narrow", "ekf"), {"efficiency": 1.2}),
    ("narrow_prior", ("drone-narrow", "ukf"), {"rms_m": 75.0}),
    ("wide_prior", ("prior-3", "ekf"), {"success": 0.6}),
    ("wide_prior", ("prior-3", "rao-blackwellised"), {"success": 0.8}),
    ("wide_prior", ("prior-3", "rao-blackwellised"), {"consistency": "overconfident"}),
    ("wide_prior", ("prior-3", "ekf"), {"consistency": "consistent"}),
    ("outliers", ("outliers", "ekf[loss=cauchy]"), {"rms_m": 500.0}),
    ("map_error", ("map-error", "ekf"), {"rms_m": 100.0}),
    ("map_error", ("map-error-modelled", "ekf"), {"consistency": "overconfident"}),
    ("gravity", ("gravity", "ekf"), {"rms_m": 100.0}),
    ("outage", ("gnss-outage", "ekf"), {"rms_m": 900.0}),
    ("weak_field", ("weak-field", "ekf"), {"rms_m": 100.0}),
]


def metrics(changed: tuple[str, str] | None = None, change: dict | None = None) -> Metrics:
    rows = [
        {"case": case, "estimator": name}
        | row
        | ((change or {}) if (case, name) == changed else {})
        for (case, name), row in ROWS.items()
    ]
    return Metrics(pd.DataFrame(rows))


@pytest.mark.parametrize("finding", [f for _, f in FINDINGS], ids=lambda finding: finding.__name__)
def test_a_finding_is_printed_where_its_metrics_support_it(finding):
    sentence = finding(metrics())
    assert sentence.endswith(".")
    assert all(len(part.split()) <= 30 for part in sentence.split(". "))
    assert finding(Metrics(pd.DataFrame([{"case": "x", "estimator": "y"}]))) == ""


def test_the_times_of_the_outage_are_those_of_the_suite():
    """Its metrics are of the settled window, which begins and ends some time after the jamming."""
    case = scenario.load(SUITE).case("gnss-outage")
    jammed = case.truth.sensor["gnss"].dropouts_s[0][0]
    end = sum(part.duration_s for part in case.trajectory.segment)
    hours = [(time - jammed) / 3600.0 for time in (case.windows.settled_from_s, end)]
    assert outage(metrics()).startswith("From {} to {} h after GNSS is jammed".format(*hours))


@pytest.mark.parametrize(("name", "where", "change"), BREAKS)
def test_a_finding_is_not_printed_where_they_do_not(name, where, change):
    """Planted metrics beyond its threshold silence a finding and no other."""
    planted = metrics(where, change)
    silent = [finding.__name__ for _, finding in FINDINGS if not finding(planted)]
    assert silent == [name]


def test_the_committed_reports_support_the_findings():
    """Five at least are on the front page."""
    folders = [REPORTS / name / digest.FOLDER for name in (SUITE, MEASURED)]
    found = findings([digest.read(folder) for folder in folders if folder.exists()])
    assert len(found) >= 5
    page = (REPORTS / "README.md").read_text()
    assert all(sentence in page for sentence in found)
