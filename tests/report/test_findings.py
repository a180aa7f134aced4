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
    ONE_FILTER,
    SUITE,
    WIDE,
    Metrics,
    findings,
    outage,
)
from ggbench.results import digest
from ggbench.spec import scenario

REPORTS = Path(__file__).parents[2] / "reports"
ROWS = {
    ("fold-1", "ins"): {"rms_m": 400.0},
    ("fold-2", "ins"): {"rms_m": 420.0},
    ("fold-1", "gaussian-sum"): {"rms_m": 100.0, "success": 0.7, "consistency": "consistent"},
    ("fold-2", "gaussian-sum"): {"rms_m": 110.0, "success": 0.8, "consistency": "consistent"},
    ("neglected_bias-1", "gaussian-sum"): {"rms_m": 90.0},
    ("neglected_bias-10", "gaussian-sum"): {"rms_m": 270.0},
    ("estimated_bias-10", "gaussian-sum"): {"rms_m": 110.0},
    ("coloured", "ins"): {"rms_m": 450.0},
    ("coloured", "gaussian-sum"): {"rms_m": 100.0, "success": 0.45},
    ("60s", "ins"): {"rms_m": 1400.0},
    ("60s", "ekf"): {"rms_m": 1100.0, "consistency": "consistent"},
    ("2s", "ekf"): {"rms_m": 1500.0, "consistency": "overconfident"},
    **{(case, name): {"rms_m": 70.0, "efficiency": 1.0} for case in NARROW for name in FILTERS},
    **{(case, ONE_FILTER): {"rms_m": 72.0, "consistency": "consistent"} for case in NARROW},
    ("air-narrow", "ekf[loss=cauchy]"): {"rms_m": 73.0},
    ("prior-3", "ekf"): {"success": 0.05, "consistency": "unsafe"},
    **{
        ("prior-3", name): {
            "success": 1.0,
            "rms_m": 70.0,
            "consistency": "consistent",
            "seconds_per_run": 0.1,
        }
        for name in WIDE[:2]
    },
    ("outliers", "ekf"): {"rms_m": 800.0},
    ("outliers", "ekf[loss=cauchy]"): {"rms_m": 90.0},
    ("outliers-known", "ekf"): {"rms_m": 76.0},
    ("wrong-noise", "ekf"): {"rms_m": 180.0},
    ("wrong-noise", ONE_FILTER): {"rms_m": 135.0, "consistency": "consistent"},
    ("wrong-noise-known", "ekf"): {"rms_m": 130.0},
    ("map-error", "ins"): {"median_m": 180.0},
    ("map-error", "ekf"): {"median_m": 60.0, "lost": 110.0, "consistency": "unsafe"},
    ("map-error", ONE_FILTER): {"median_m": 30.0, "rms_m": 90.0, "consistency": "conservative"},
    ("map-error-known", "ekf"): {"rms_m": 75.0, "median_m": 28.0, "consistency": "conservative"},
    ("gravity", "ekf"): {"rms_m": 300.0},
    ("gravity", ONE_FILTER): {"rms_m": 120.0, "consistency": "consistent"},
    ("gravity-known", "ekf"): {"rms_m": 105.0},
    ("gnss-outage", "ekf"): {"rms_m": 190.0},
    ("gnss-outage", "ins"): {"rms_m": 1700.0},
    ("weak-field", "ekf"): {"rms_m": 200.0},
    ("weak-field", "ins"): {"rms_m": 230.0},
}
BREAKS = [
    ("measured", ("fold-1", "gaussian-sum"), {"rms_m": 300.0}),
    ("measured", ("fold-2", "gaussian-sum"), {"consistency": "overconfident"}),
    ("measured_biases", ("neglected_bias-10", "gaussian-sum"), {"rms_m": 150.0}),
    ("measured_biases", ("estimated_bias-10", "gaussian-sum"), {"rms_m": 290.0}),
    ("fosterville", ("coloured", "gaussian-sum"), {"rms_m": 300.0}),
    ("east_victoria", ("60s", "ekf"), {"rms_m": 500.0}),
    ("east_victoria", ("2s", "ekf"), {"consistency": "consistent"}),
    ("narrow_prior", ("ship-narrow", "ekf"), {"efficiency": 1.02}),
    ("narrow_prior", ("drone-narrow", "ukf"), {"rms_m": 75.0}),
    ("wide_prior", ("prior-3", "ekf"), {"success": 0.6}),
    ("wide_prior", ("prior-3", WIDE[0]), {"success": 0.8}),
    ("wide_prior", ("prior-3", WIDE[1]), {"consistency": "overconfident"}),
    ("wide_prior", ("prior-3", "ekf"), {"consistency": "consistent"}),
    ("outliers", ("outliers", "ekf[loss=cauchy]"), {"rms_m": 500.0}),
    ("wrong_noise", ("wrong-noise", "ekf"), {"rms_m": 140.0}),
    ("map_error", ("map-error", "ekf"), {"median_m": 30.0}),
    ("map_error", ("map-error-known", "ekf"), {"consistency": "overconfident"}),
    ("gravity", ("gravity", "ekf"), {"rms_m": 150.0}),
    ("one_filter", ("gravity", ONE_FILTER), {"rms_m": 250.0}),
    ("one_filter", ("ship-narrow", ONE_FILTER), {"consistency": "overconfident"}),
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


def test_the_prior_that_is_called_narrow_is_below_a_twentieth_of_a_correlation_length():
    """The widths of the committed suite; the other cases of one flight are wider."""
    widths = pd.read_csv(REPORTS / SUITE / "data" / "cases.csv").set_index("case")["width"]
    assert (widths[list(NARROW)] < 0.05).all()
    assert (widths[["prior-0.3", "prior-1"]] > 0.05).all()


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
