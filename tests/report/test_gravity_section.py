"""The section on unknown gravity: responses, claims and what can be known, from stored results."""

from __future__ import annotations

import numpy as np
import pytest
from campaigns import ran, small
from problems import SMALL

from ggbench.report import scenario_report
from ggbench.results.folder import Results
from ggbench.spec import scenario
from ggbench.spec.scenario import ScenarioError

CASES = """
[gnss]
period_s = 1.0
velocity_noise_mps = 0.05

[truth.field]
constant_disturbance_mgal = [10.0, 20.0, 30.0]

[model.disturbance]
horizontal_mgal = 40.0

[[case]]
name = "base"
title = "with the states"
"""


def claim(title: str, published: float, **changes: str) -> str:
    keys = {"case": "base", "quantity": "north position"} | changes
    lines = "".join(f'{key} = "{value}"\n' for key, value in keys.items())
    return f'[[claim]]\ntitle = "{title}"\n{lines}published = {published}\nuntil_s = 10.0\n'


def text(claims: str = "") -> str:
    base = SMALL[: SMALL.index("[[case]]")]
    felt = base.replace('source = "normal"', 'source = "normal"\ngravity_disturbance = true')
    return felt + CASES + claims


# δr_N = −½ δg t²: 1 cm after 10 s of 20 mGal.
CLAIMS = claim("as it is", 0.01) + claim("a little more", 0.0124) + claim("far too much", 0.1)


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Results:
    folder = tmp_path_factory.mktemp("gravity")
    return ran(folder, labels=("ins", "ekf"), runs=2, scenario=small(folder, text(CLAIMS)))


@pytest.fixture(scope="module")
def report(results, tmp_path_factory) -> str:
    return scenario_report.write(results.folder, tmp_path_factory.mktemp("report")).read_text()


def test_claims_are_set_beside_the_response_and_judged(report):
    """What the gravity can do until then; beyond a quarter more the claim is not reproducible."""
    rows = [line for line in report.splitlines() if line.startswith("| ") and " m | 0.01 m" in line]
    verdicts = {row.split(" | ")[0][2:]: row.split(" | ")[-1].rstrip(" |") for row in rows}
    assert verdicts == {
        "as it is": "of the size of the response",
        "a little more": "of the size of the response",
        "far too much": "**not reproducible**: 10.0 times what this gravity can do",
    }


def test_what_can_be_known_is_the_bounds(results, report):
    """σ of the states at half time and at the end, and the correlation with tilt."""
    stored = results.arrays("base")["gravity"]
    assert stored[:, :3] == pytest.approx(np.tile([1e-4, 2e-4, 3e-4], (len(stored), 1)))
    end = ", ".join(f"{1e5 * sigma:.3g}" for sigma in stored[-1, 3:6])
    assert "| with the states | 10, 20, 30 | " in report
    assert f" | {end} | {stored[-1, 6]:.2f}, {stored[-1, 7]:.2f} |" in report
    assert (np.abs(stored[:, 6:]) <= 1.0).all()
    for picture in ("response", "knowledge", "gravity-base"):
        assert f"{picture}.png" in report


def test_the_detailed_run_holds_the_error_of_the_gravity(results):
    """And its σ, of a filter within 5 deviations; the INS alone knows the prior's."""
    for label in ("ins", "ekf"):
        detail = results.detail("base", label, 0)
        assert (np.abs(detail[:, 12:15]) < 5.0 * detail[:, 15:18]).all()
    assert results.detail("base", "ins", 0)[-1, 12:15] == pytest.approx([1e-4, 2e-4, 3e-4])
    assert results.detail("base", "ekf", 0)[-1, 15] < 4e-4


def test_a_flight_whose_gravity_is_known_has_no_such_section(tmp_path):
    results = ran(tmp_path, labels=("ins",), runs=1)
    assert "response" not in results.arrays("base")
    assert "does not know" not in scenario_report.write(results.folder, tmp_path / "r").read_text()


@pytest.mark.parametrize(
    ("claims", "said"),
    [
        (claim("x", 1.0, case="bas"), r"claim\[0\]: there is no case 'bas' \(did you mean 'base'"),
        (claim("x", 1.0, quantity="east"), r"claim\[0\]: quantity is 'east' and must be 'east pos"),
        (claim("x", -1.0), r"claim\[0\]: published is -1.0 and must be greater than 0"),
    ],
)
def test_a_claim_that_cannot_be_is_refused_with_a_sentence(claims, said, tmp_path):
    path = tmp_path / "claims.toml"
    path.write_text(text(claims))
    with pytest.raises(ScenarioError, match=said):
        scenario.load(path)


def test_claims_are_tables(tmp_path):
    path = tmp_path / "claims.toml"
    path.write_text('claim = "much"\n' + text())
    with pytest.raises(ScenarioError, match=r"claim must be written as \[\[claim\]\] tables"):
        scenario.load(path)
