"""Conventions of a gradiometer's record are named; outliers differ from contradictions."""

from __future__ import annotations

import numpy as np
import pytest
from recorded_flights import edit, edit_rows, recorded
from small_cases import rough_map
from thinning import thinned

from ggbench.api import problems
from ggbench.campaign import registry
from ggbench.maps.survey_lines import CONVENTIONS, turned
from ggbench.recorded.conventions import gradient_convention, in_words
from ggbench.recorded.corrected import residuals
from ggbench.recorded.flight import read_flight
from ggbench.recorded.suspicion import isolated_outliers, remarks, suspicions
from ggbench.spec.flight import FlightError

COMPONENTS = ("xx", "xy", "xz", "yy", "yz", "zz")
NAMES = [f"gradient_{name}_eotvos" for name in COMPONENTS]
FLIGHT = {"trajectory.segment": [{"duration_s": 60.0}], "windows.settled_from_s": 10.0}


@pytest.fixture
def log(tmp_path):
    """A flight of a minute over a rough map, with a level gradiometer of 0.1 E."""
    changes = FLIGHT | {
        "field": {"source": rough_map(tmp_path / "map.nc")},
        "gradiometer.instrument": "local-level",
        "gradiometer.noise_eotvos": 0.1,
    }
    return recorded(tmp_path / "log", changes)


def spoil(path, turn=CONVENTIONS[0], factor=1.0, change=lambda values: values):
    """Write the readings in another convention."""

    def rewrite(table):
        own = {name: table[column].copy() for name, column in zip(COMPONENTS, NAMES, strict=True)}
        for name, column in zip(COMPONENTS, NAMES, strict=True):
            other, sign = turned(name, turn)
            table[column] = sign * own[other] * factor
        table[NAMES] = change(table[NAMES].to_numpy())

    edit_rows(path.parent / "gradiometer.csv", rewrite)
    return read_flight(path)


@pytest.mark.parametrize("turn", range(len(CONVENTIONS)))
@thinned("factor", [1.0, 1e-9])
def test_axes_and_unit_are_named(turn, factor, log):
    """Each of the eight, in Eötvös and in s⁻²; as a control, nothing is named of ours."""
    found = gradient_convention(spoil(log, CONVENTIONS[turn], factor))
    if turn == 0 and factor == 1.0:
        assert found is None
        return
    assert found.turn == CONVENTIONS[turn] and found.factor == pytest.approx(1.0 / factor)
    assert found.lacks == "" and found.after < 0.1 * found.before
    words = in_words(found, "local-level")
    assert ("s⁻²" in words) == (factor != 1.0) and ("axes" in words) == (turn != 0)
    if turn == 5:
        assert "x north, y east, z down" in words
        assert in_words(found, "platform").startswith("with x and y exchanged and z reversed")


def test_a_record_without_its_mean_is_named(log):
    found = gradient_convention(spoil(log, change=lambda values: values - values.mean(axis=0)))
    assert found.turn == CONVENTIONS[0] and found.lacks in ("its mean", "the normal field")


def normal(log):
    """The normal gradient at the flight, EE, EN, EU, NN, NU, UU, to a thousandth."""
    table = np.loadtxt(log.parent / "reference.csv", delimiter=",", skiprows=1)
    radius = 6.38e6 + table[:, 3].mean()
    return 3.986e14 / radius**3 * 1e9 * np.array([-1.0, 0.0, 0.0, -1.0, 0.0, 2.0])


def test_readings_of_the_disturbing_field_are_named_and_read(log):
    """The problem is then that of whole gradients, to the 1.5e-3 E of a metre of height."""
    from ggbench.recorded.normal_field import normal_readings

    whole = read_flight(log).problem
    level = normal_readings(
        "local-level", whole.track.positions, whole.times, whole.track.attitudes
    )
    np.testing.assert_allclose(level.mean(axis=0), normal(log), atol=30.0)
    found = gradient_convention(spoil(log, change=lambda values: values - level))
    assert found.lacks == "the normal field"
    assert 'readings = "disturbing"' in in_words(found, "local-level")
    path = edit(log, {"gradiometer.readings": "disturbing"})
    after = read_flight(path)
    np.testing.assert_allclose(after.problem.measurements, whole.measurements, atol=1e-6)
    assert gradient_convention(after) is None
    with pytest.raises(FlightError, match='readings = "disturbing" and filter exclude'):
        read_flight(edit(path, {"gradiometer.filter": "butterworth"}))


def outliers(log, share=0.1):
    chosen = np.random.default_rng(5).random(60) < share
    jumps = np.where(chosen[:, np.newaxis], np.random.default_rng(6).normal(0, 300.0, (60, 6)), 0.0)
    return spoil(log, change=lambda values: values + jumps[: len(values)]), int(chosen.sum())


def estimated(flight, label):
    (choice,) = registry.choose_all((label,))
    return {
        label: residuals(flight.problem, problems.estimate(flight.problem, choice.estimator, 0))
    }


def test_outliers_are_told_from_contradictions(log):
    """A plain filter is told to reject them; one that does is right, and only remarked on."""
    assert isolated_outliers(read_flight(log).problem) == 0
    flight, count = outliers(log)
    assert isolated_outliers(flight.problem) == count
    (said,) = suspicions(flight, estimated(flight, "ekf"))
    assert f"ekf: {count} of 60 measurements are outliers" in said
    assert "gate=0.99" in said and "loss=cauchy" in said and "units" not in said
    gated = estimated(flight, "ekf[gate=0.99]")
    assert list(suspicions(flight, gated)) == []
    (remark,) = remarks(flight, gated)
    assert f"{count} of 60 measurements rejected" in remark


def test_a_gate_that_rejects_most_measurements_is_warned_of(log):
    """The filter's own count decides: the outliers are not all that it rejects."""
    flight, count = outliers(log)
    tight = estimated(flight, "ekf[gate=0.001]")
    rejected = {"ekf[gate=0.001]": 60}
    assert list(remarks(flight, tight, rejected)) == []
    said = list(suspicions(flight, tight, rejected))
    assert said[0].startswith("ekf[gate=0.001]: 60 of 60 measurements rejected. Check the gate")
    right = estimated(flight, "ekf[gate=0.99]")
    assert list(suspicions(flight, right, {"ekf[gate=0.99]": count})) == []


def test_contradictions_are_no_outliers(log):
    """Of the wrong axes the old sentence remains, and the axes are named."""
    flight = spoil(log, CONVENTIONS[5])
    first, second = suspicions(flight, estimated(flight, "ekf[gate=0.99]"))
    assert "units" in first and "outliers" not in first
    assert "x north, y east, z down" in second
    right = read_flight(recorded(log.parent.parent / "right", FLIGHT))
    assert list(suspicions(right, estimated(right, "ekf"))) == []
    assert list(remarks(right, estimated(right, "ekf"))) == []
