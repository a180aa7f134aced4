"""Advice: halved causes lower the bound, a target's noise reaches it, the best is recommended."""

from __future__ import annotations

import base64
import dataclasses
import html
import io
import math
import re
import time
from unittest.mock import Mock

import pandas as pd
import pytest
from campaigns import small
from command import invoke
from matplotlib.image import imread
from problems import SMALL

from ggbench.judging.judgement import OUTSIDE
from ggbench.judging.planned import bound_of
from ggbench.score import advice, decisions
from ggbench.spec import scenario

KEY = "gradiometer.noise_eotvos"


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp("advice")
    scenario = small(folder)
    case = scenario.cases[0]
    return advice.advise(scenario, case, folder / "out", 2.0 * bound_of(case), 4, jobs=0)


@pytest.mark.long
def test_each_limit_is_the_bound_of_a_halved_cause(found):
    """No cause makes the bound larger when it is halved, and the most important comes first."""
    limits = {limit.cause: limit for limit in found.limits}
    assert {"noise of the gradiometer", "initial uncertainty"} <= set(limits)
    gains = [limit.gain for limit in found.limits]
    assert gains == sorted(gains, reverse=True) and min(gains) > -1e-9
    half = found.case.changed(KEY, 0.5 * found.case.gradiometer.noise_eotvos)
    assert limits["noise of the gradiometer"].bound_m == pytest.approx(bound_of(half))


@pytest.mark.long
def test_the_noise_that_is_found_reaches_the_target(found):
    """To 1% of the bound; and control: a target below any bound is out of reach."""
    target = 2.0 * found.bound_m
    assert found.unit == "E"
    assert bound_of(found.case.changed(KEY, found.noise)) == pytest.approx(target, rel=0.01)
    assert math.isnan(advice.needed(found.case, KEY, 1e-9))


def test_a_number_is_halved_wherever_the_case_states_it(tmp_path):
    """The truth's own noise with the model's: else halving it would change nothing that is true."""
    text = SMALL.replace("[gradiometer]", "[gradiometer]\nbias_eotvos = 2.0", 1)
    case = small(tmp_path, text + "\n[truth.gradiometer]\nnoise_eotvos = 16.0\n").cases[0]
    (half,) = (h for cause, h in advice.halved(case) if cause == "noise of the gradiometer")
    for side in ("truth", "model"):
        before, after = (c.side(side).gradiometer.noise_eotvos for c in (case, half))
        assert after == pytest.approx(0.5 * before)
    assert case.side("truth").gradiometer.noise_eotvos == 16.0
    assert bound_of(half) < bound_of(case)


def test_the_noise_for_a_target_is_that_of_truth_and_model(tmp_path):
    """A target that the case reaches with the model's noise alone is reached by changing both."""
    plain = small(tmp_path, SMALL).cases[0]
    noisy = small(tmp_path, SMALL + "\n[truth.gradiometer]\nnoise_eotvos = 1000.0\n").cases[0]
    target = 1.2 * bound_of(plain)
    assert advice.needed(noisy, KEY, target) == pytest.approx(
        advice.needed(plain, KEY, target), rel=0.01
    )


def test_every_sensor_has_its_limits(tmp_path):
    """Biases, velocities, the altimeter and sensors with names of their own."""
    text = SMALL + (
        "\n[gnss]\nperiod_s = 1.0\nposition_noise_m = 5.0\nvelocity_noise_mps = 0.1\n"
        "[barometer]\nperiod_s = 1.0\nnoise_m = 3.0\nbias_m = 5.0\n"
        '[sensor.bow]\nkind = "velocity_log"\nperiod_s = 1.0\nnoise_mps = 0.1\n'
        "[altimeter]\nnoise_m_per_sqrt_hz = 1.0\ntime_constant_s = 100.0\n"
    )
    case = small(tmp_path, text).cases[0]
    halves = dict(advice.halved(case))
    assert {
        "noise of the GNSS receiver",
        "noise of the barometer",
        "bias of the barometer",
        "noise of the bow",
        "noise of the altimeter",
        "initial uncertainty",
        "errors of the inertial sensors",
    } <= set(halves)
    receiver = halves["noise of the GNSS receiver"].sensor["gnss"]
    assert (receiver.position_noise_m, receiver.velocity_noise_mps) == (2.5, 0.05)
    assert halves["noise of the bow"].sensor["bow"].noise_mps == 0.05


def test_drift_height_and_heading_have_their_limits(tmp_path):
    """Each of them is halved, and halving it lowers the bound."""
    text = SMALL.replace(
        "[gradiometer]", "[gradiometer]\nbias_eotvos = 5.0\ndrift_eotvos_per_sqrt_h = 40.0", 1
    ).replace("[initial_error]", "[initial_error]\nheight_m = 400.0\nheading_arcmin = 200.0", 1)
    case = small(tmp_path, text).cases[0]
    halves = dict(advice.halved(case))
    drift = halves["biases and drift of the gradiometer"].gradiometer
    assert (drift.bias_eotvos, drift.drift_eotvos_per_sqrt_h) == (2.5, 20.0)
    prior = halves["initial uncertainty"].initial_error
    assert (prior.height_m, prior.heading_arcmin) == (200.0, 100.0)
    for key in (
        "gradiometer.drift_eotvos_per_sqrt_h",
        "initial_error.height_m",
        "initial_error.heading_arcmin",
    ):
        assert bound_of(advice.with_value(case, key, lambda number: 0.5 * number)) < bound_of(case)


def test_the_recommended_estimator_was_flown(found):
    label, _ = advice.recommended(found)
    assert label in set(advice.table(found)["estimator"])
    assert {"ins", "ekf"} <= set(advice.table(found)["estimator"])


def test_times_of_a_first_run_decide_nothing(found):
    """The times are those of the suite, to one digit; the EKF's are below the Gaussian sum's."""
    usual = advice.usual_seconds()
    assert 0.0 < usual["ins"] <= usual["ekf"] < usual["gaussian-sum"] < 10.0
    rows = [("gaussian-sum", 1.0, True, 1e-3), ("ekf", 1.0, True, 2.3), ("ins", 9.0, False, 1e-3)]
    assert advice.recommended(flown(found, rows)) == ("ekf", True)


def flown(found, rows):
    """Return an advice with other metrics: estimator, RMS error, whether recommended, time."""
    columns = ["estimator", "rms_m", "recommended", "seconds_per_run"]
    qualified = pd.DataFrame(rows, columns=columns).assign(window="settled")
    batch = qualified["estimator"].str.contains("batch|gauss-newton")
    qualified["causality"] = batch.map({True: "batch", False: "filter"})
    return dataclasses.replace(found, results=Mock(metrics=lambda: qualified))


def test_no_smoother_is_recommended_in_flight(found):
    """Although it is recommended, and its usual time is less than the filter's."""
    usual, smoother = advice.usual_seconds(), "factor-graph[mode=batch]"
    assert usual[smoother] < usual["gaussian-sum"]
    rows = [("gaussian-sum", 2.0, True, 0.1), (smoother, 1.0, True, 0.1)]
    assert advice.recommended(flown(found, rows)) == ("gaussian-sum", True)


def sentences_of(found, **changes):
    """Return the verdicts on results of which all of an estimator's runs, or its metrics, change.

    ``runs`` and ``metrics`` map columns to values of the EKF.
    """
    tables = {"runs": found.results.runs(), "metrics": found.results.metrics()}
    for name, values in changes.items():
        for column, value in values.items():
            tables[name].loc[tables[name]["estimator"] == "ekf", column] = value
    results = Mock(
        runs=lambda: tables["runs"],
        metrics=lambda: tables["metrics"],
        cases=lambda: found.results.cases().assign(width=0.1, correlation_m=1000.0),
    )
    return " ".join(decisions.verdicts(dataclasses.replace(found, results=results)))


def test_an_estimator_that_failed_has_its_reason_in_the_advice(found):
    failed = {"status": "failed", "reason": "OutsideMapError: too low"}
    said = "ekf failed in all runs: OutsideMapError: too low."
    assert said in sentences_of(found, runs=failed)
    assert "failed" not in sentences_of(found)


def test_estimates_that_leave_the_map_are_in_the_advice_with_the_remedy(found):
    assert "Estimates of ekf left the map" in sentences_of(found, runs={"remark": OUTSIDE})
    assert "left the map" not in sentences_of(found, runs={"remark": ""})


def test_an_ekf_is_not_called_efficient_against_its_own_runs(found):
    """Whatever the width of the prior says."""
    said = sentences_of(found, metrics={"efficiency": 1.58})
    assert "In these runs the EKF's error is 1.58 times the oracle's." in said
    assert "In these runs" not in sentences_of(found, metrics={"efficiency": 1.02})


def test_the_command_says_what_to_use_and_what_limits(tmp_path):
    (tmp_path / "own.toml").write_text(SMALL, encoding="utf-8")
    command = ["advise", "own.toml", "-n", "4", "-j", "0", "--target", "1e-9"]
    done = invoke(command, tmp_path, columns=120)
    assert done.returncode == 1, done.stderr
    best = "In flight: no estimator is recommended: 4 runs are fewer than 40; the least bad is"
    both = "Errors of each source are halved in truth and model; the map error is removed."
    for words in (
        best,
        "After landing: ",
        "Error sources that limit",
        both,
        "No gradiometer reaches 1e-09 m",
    ):
        assert words in " ".join(done.stdout.split())


@pytest.mark.parametrize(
    ("target", "said"), [(1.5, "1 track of 2 has"), (3.0, "2 tracks of 2 have")]
)
def test_tracks_are_counted_in_words(target, said):
    tracks = pd.DataFrame({"bound_m": [1.0, 2.0], "reason": "", "present": False})
    assert any(said in text for text in decisions.track_sentences(tracks, target))


@pytest.mark.long
def test_one_command_writes_a_page_for_a_decision(tmp_path):
    """Estimator, accuracy, instrument, where to fly, limits, and map and track as a picture.

    The page says what the command prints.
    """
    (tmp_path / "own.toml").write_text(SMALL, encoding="utf-8")
    command = ["advise", "own.toml", "-n", "4", "-j", "0", "--target", "1e6", "--page", "d.html"]
    done = invoke(command, tmp_path, columns=160)
    assert done.returncode == 0, done.stderr
    assert "Wrote d.html" in done.stdout
    text = html.unescape((tmp_path / "d.html").read_text(encoding="utf-8"))
    loaded = scenario.load(tmp_path / "own.toml")
    assert f"<h1>{loaded.title}: {loaded.cases[0].title}</h1>" in text
    assert loaded.description in text and time.strftime("%Y-") in text
    heads = re.findall("<h2>(.*?)</h2>", text)
    assert heads == ["Estimator and accuracy", "Instrument", "Where to fly", decisions.LIMITS]
    sentences = re.findall("<li>(.*?)</li>", text)
    assert [each.split(":")[0] for each in sentences[:2]] == ["In flight", "After landing"]
    printed = " ".join(done.stdout.split())
    assert all(sentence in printed for sentence in sentences[:4])
    assert "8 tracks of 8 have a bound of at most 1e+06 m." in sentences
    (image,) = re.findall('<img src="data:image/png;base64,(.*?)"', text)
    assert imread(io.BytesIO(base64.b64decode(image)), "png").shape[1] > 400


def test_a_page_that_is_no_html_is_refused_before_anything_is_flown(tmp_path):
    done = invoke(["advise", "wang2013", "--page", "d.pdf"], tmp_path)
    assert done.returncode == 2 and ".html" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["none.toml"], "none.toml"), (["wang2013", "-c", "x"], "has no case 'x'")],
)
def test_bad_input_is_a_sentence(arguments, said, tmp_path):
    done = invoke(["advise", *arguments], tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
