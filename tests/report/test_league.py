"""The league over the library, and the answer that a report begins with."""

from __future__ import annotations

import math
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from campaigns import plan, ran, small
from command import invoke
from problems import SMALL
from summaries import RUNS, SAME, case, chi, records, tabled

from ggbench.cli.library import Outcome, run_all
from ggbench.judging import ranking
from ggbench.report import league, league_page, opening, situations
from ggbench.report.league import Flown, League
from ggbench.spec import scenario
from ggbench.spec.case import CaseSpec


def told(*groups: list[dict[str, Any]]) -> str:
    return opening.case_answer(case(), *tabled(*groups))


def test_aiding_that_gains_is_said_with_its_figures():
    """The best causal estimator, how much it gains, the bound, and who is worse than it."""
    text = told(
        records("ins", 1e4 * SAME, "none"),
        records("good", 4.0 * SAME),
        records("poor", 36.0 * SAME),
        records("equal", 4.0 * SAME * (1.0 + 1e-12)),
        records("later", SAME, "batch"),
    )
    assert text.startswith("the best causal estimator is `good` with a position MRSE of ")
    assert "50.0 times less than the INS's" in text
    assert "not distinguishable from it: `equal`;" in text
    assert "significantly worse, by their ratio of MRSE: `poor` (× 3.00)" in text
    assert "the bound is 1.00 m" in text and "no run failed or diverged" in text
    assert "later" not in text


def test_a_mean_that_few_runs_make_does_not_hide_what_most_runs_do():
    """A larger error in nearly every run is said, though one lost run makes the mean undecided."""
    errors = 6.0 * SAME
    errors[7] = 1e9
    text = told(
        records("ins", 1e4 * SAME, "none"), records("good", 4.0 * SAME), records("wild", errors)
    )
    assert "significantly more than half of the runs (sign test)" in text
    assert "`wild`" in text.split("sign test")[1]
    assert "not distinguishable" not in text


@pytest.mark.parametrize(
    ("aided", "phrase"),
    [
        (SAME + 0.01 * (chi(3) - chi(4)), "aiding gains nothing over the INS"),
        (1.3 * SAME, "aiding is worse than the INS alone"),
        (np.where(np.arange(RUNS) == 7, 0.01, 1.0) * SAME, "do not decide whether it is"),
    ],
)
def test_aiding_that_gains_nothing_is_said_plainly(aided, phrase):
    """Where an estimator cannot be told from the INS, or is worse, that is the answer."""
    ins = SAME.copy()
    ins[7] = 400.0 if "decide" in phrase else ins[7]
    text = told(records("ins", ins, "none"), records("aided", aided))
    assert phrase in text
    assert "paired over 60 runs: difference of squared error" in text


def test_lost_runs_are_said_and_losers_are_not_best():
    """An estimator that failed in many runs is not the best for the runs that it finished."""
    summary, pairs = tabled(
        records("fragile", 0.25 * SAME, failed=20),
        records("robust", SAME, diverged=True),
        records("ins", 1e4 * SAME, "none"),
    )
    best = ranking.best_causal(summary[summary["window"] == "settled"].to_dict("records"))
    assert best["label"] == "robust"
    text = opening.case_answer(case(), summary, pairs)
    assert "`robust` 60 diverged" in text and "`fragile` 20 failed" in text
    assert "smaller errors where they finish, but runs lost: `fragile`" in text
    nothing = told(records("fragile", SAME, failed=RUNS))
    assert nothing.startswith("no estimator finished a run")


def test_a_pair_seen_from_its_other_side():
    """A comparison turned round says the opposite, and turned twice is itself."""
    _, pairs = tabled(records("a", SAME), records("b", 4.0 * SAME))
    one, other = (ranking.pair_of(pairs, "c", *names) for names in (("a", "b"), ("b", "a")))
    assert (one["position_verdict"], other["position_verdict"]) == ("better", "worse")
    assert other["position_relative"] == pytest.approx(1.0)
    assert other["position_difference_m2"] == -one["position_difference_m2"] > 0.0
    assert (other["position_lo"], other["position_hi"]) == (
        -one["position_hi"],
        -one["position_lo"],
    )
    assert one["position_win_rate"] + other["position_win_rate"] == 1.0
    assert ranking.pair_of(pairs, "c", "a", "z") is None


def flown(name: str, *groups: list[dict[str, Any]], **changes: Any) -> Flown:
    return league._flown(name, case(**changes), *tabled(*groups))


INS = records("ins", 1e4 * SAME, "none")
EKF = records("ekf", SAME, seconds=0.01)


def test_advice_is_the_cheapest_of_the_best():
    """Of estimators that cannot be told from the best the cheapest; an error of 30 % is not one."""
    held = League(
        [
            league.Entry(
                Path("s"), None, {},
                [flown("s", INS, EKF, records("slow", SAME, seconds=0.1),
                       records("poor", 1.7 * SAME, seconds=0.001))],
            )
        ]
    )  # fmt: skip
    (advice,) = held.advice()
    assert (advice.situation, advice.choice, advice.as_good) == ("plain", "ekf", True)
    assert advice.equal == {"ekf": 1, "slow": 1, "poor": 0}
    scores = {s.label: s.score for s in held.standings}
    assert scores == pytest.approx({"ekf": 1, "slow": 1, "poor": math.sqrt(1.7), "ins": 100})
    costs = {s.label: s.cost for s in held.standings}
    assert costs == pytest.approx({"ekf": 1, "slow": 10, "poor": 0.1, "ins": 1})


def test_who_locks_on_less_often_is_not_advised():
    """Where locks are judged a small error of the mean does not make up for lost runs."""
    case_ = flown(
        "s", INS, records("ekf", 0.5 * SAME, locked=0.5), records("sure", SAME, locked=1.0)
    )
    assert case_.best["label"] == "sure"
    assert not case_.as_good("ekf") and case_.as_good("sure")


def test_failed_runs_count_as_the_ins():
    """What an estimator leaves undone is left to the INS: half failed is half the INS's error."""
    half = flown("s", INS, EKF, records("fragile", SAME, failed=RUNS // 2))
    squares = SAME[: RUNS // 2].mean() / 2.0 + 0.5 * 1e4 * SAME.mean()
    assert half.error("fragile") == pytest.approx(math.sqrt(squares))
    assert half.ratio("fragile") > 50.0
    gone = flown("s", INS, EKF, records("fragile", SAME, failed=RUNS))
    assert gone.error("fragile") == pytest.approx(gone.error("ins"))
    alone = flown("s", records("fragile", SAME, failed=RUNS))
    assert math.isnan(alone.ratio("fragile"))


def test_staying_away_from_hard_scenarios_gains_nothing():
    """Where an estimator was not run it counts as the others of its kind did there."""
    poor = records("poor", 1e12 * SAME)  # an error a million times larger is a number like others
    easy = flown("easy", INS, EKF, records("absent", SAME), poor)
    hard = flown("hard", INS, EKF, records("similar", 9.0 * SAME), poor)
    scores = {s.label: s for s in league.standings([easy, hard])}
    assert scores["ekf"].score == pytest.approx(1.0)
    assert scores["poor"].score == pytest.approx(1e6)
    assert scores["absent"].score == pytest.approx(math.sqrt(3.0))  # the median of 1, 3 and 1e6
    assert (scores["absent"].own, scores["absent"].ran) == (pytest.approx(1.0), 1)
    assert scores["absent"].coverage == 0.5


@pytest.mark.parametrize(
    ("changes", "gained", "situation"),
    [
        ({}, "gains", "plain"),
        ({}, "nothing", "nothing"),
        ({}, "worse", "nothing"),
        ({}, "unproven", "plain"),
        ({"position_m": 1000.0}, "gains", "wide"),
        ({"position_m": 999.0}, "gains", "plain"),
        ({"duration_s": 1800.0}, "gains", "long"),
        ({"duration_s": 1800.0, "position_m": 5e3}, "gains", "wide"),
    ],
)
def test_situations_are_those_of_the_keys(changes, gained, situation):
    """What a case is an example of follows from its keys, and from what aiding gains there."""
    spec = case()
    if position := changes.get("position_m"):
        wide = spec.initial_error.model_copy(update={"position_m": position})
        spec = spec.model_copy(update={"initial_error": wide})
    if duration := changes.get("duration_s"):
        segment = spec.trajectory.segment[0].model_copy(update={"duration_s": duration})
        path = spec.trajectory.model_copy(update={"segment": (segment,)})
        spec = spec.model_copy(update={"trajectory": path})
    assert situations.situation_of(spec, gained) == situation


@pytest.mark.parametrize(
    ("keys", "situation"),
    [
        ({"truth": {"gradiometer": {"outlier_share": 0.1}, "field": {"source": "x"}}}, "readings"),
        ({"truth": {"gnss": {"dropouts_s": [[1.0, 2.0]]}, "imu": {}}}, "outage"),
        ({"truth": {"barometer": {"dropout_share": 0.1}}}, "readings"),
        ({"truth": {"field": {"error": {"resolution_km": 5.0}}}}, "map"),
        ({"model": {"field": {"density_kg_m3": 2600.0}}}, "map"),
        ({"model": {"gradiometer": {"noise_eotvos": 1.0}}}, "model"),
        ({"truth": {"imu": {"gyro_scale_factor_ppm": 9.0}}}, "model"),
        ({"truth": {"imu": {}, "field": {}}}, "plain"),
        ({"model": {"imu": {"gyro_bias_deg_per_h": 0.0}}}, "model"),
        ({"model": {"field": {"land_correction": False}}}, "map"),
    ],
)
def test_what_truth_and_model_disagree_on_makes_a_situation(keys, situation):
    """Outliers before a wrong map, that before any other error; zero and false are changes."""

    class Changed(CaseSpec):
        def model_dump(self, **options: Any) -> dict[str, Any]:
            return super().model_dump(**options) | keys

    assert situations.situation_of(Changed(**dict(case())), "gains") == situation


@pytest.mark.parametrize(
    ("felt", "compensate", "situation"),
    [(False, False, "plain"), (True, False, "gravity"), (True, True, "plain")],
)
@pytest.mark.parametrize("side", ["both", "truth"])
def test_gravity_that_is_felt_and_not_compensated_makes_a_situation(
    side, felt, compensate, situation
):
    """Wherever the file says so; one that the mechanization takes from its map makes none."""
    spec = case()
    changed = {"gravity_disturbance": felt}
    if side == "both":
        spec = spec.model_copy(update={"field": spec.field.model_copy(update=changed)})
    else:
        truth = spec.truth.model_copy(update={"field": spec.truth.field.model_copy(update=changed)})
        spec = spec.model_copy(update={"truth": truth})
    field = spec.model.field.model_copy(update={"compensate": compensate})
    spec = spec.model_copy(update={"model": spec.model.model_copy(update={"field": field})})
    assert situations.situation_of(spec, "gains") == situation


@pytest.mark.parametrize(
    ("text", "first"),
    [
        ("One. Two.", "One."),
        ("As Wang et al. Did it over 3.5 km. Then.", "As Wang et al. Did it over 3.5 km."),
        ("Which of them? All.", "Which of them?"),
        ("no end", "no end"),
        ("a\nline. B", "a line."),
    ],
)
def test_the_first_sentence(text, first):
    assert league_page.first_sentence(text) == first


@pytest.fixture(scope="module")
def library(tmp_path_factory) -> Path:
    """Results folders: one finished, one stopped, one damaged, one of the same scenario again."""
    path = tmp_path_factory.mktemp("library")
    ran(path, "results/small", labels=("ins", "ekf", "factor-graph[mode=batch]")).store.close()
    (path / "other").mkdir()
    (path / "other" / "stopped.toml").write_text(SMALL)
    loaded = scenario.load(str(path / "other" / "stopped.toml"))
    ran(path, "results/stopped", labels=("ekf",), runs=2, scenario=loaded).store.close()
    store, _ = plan(path, "results/stopped", ("ekf",), runs=9, scenario=loaded).open()
    store.close()
    shutil.copytree(path / "results" / "small", path / "results" / "again")
    (path / "study.toml").write_text(SMALL.replace("[campaign]", "[campaign]\nleague = false"))
    study = scenario.load(str(path / "study.toml"))
    ran(path, "results/study", labels=("ekf",), runs=2, scenario=study).store.close()
    (path / "results" / "damaged").mkdir()
    (path / "results" / "damaged" / "manifest.json").write_text("{")
    (path / "results" / "notes.txt").write_text("no results")
    return path


@pytest.mark.long
def test_the_reports_of_a_library(library):
    """Every folder has its report, the front page tells of what is finished and what is not."""
    done = invoke(["report", "--all", "results", "-o", "text"], library)
    assert done.returncode == 1  # one is damaged
    assert "results/damaged/manifest.json is damaged" in done.stdout
    assert "results/again is left out: results/small is of the same scenario" in done.stdout
    assert "results/stopped is left out: it is not finished, of 9 runs 2 are done" in done.stdout
    assert "results/study is left out, as its scenario asks" in done.stdout
    text = (library / "text" / "README.md").read_text()
    assert text.startswith("# Which estimator should I use when, and what does it cost?\n")
    assert "](small.md)" in text and "](stopped.md)" not in text and "](study.md)" not in text
    for name in ("small.md", "stopped.md", "study.md", "README/league.png"):
        assert (library / "text" / name).stat().st_size > 2000
    links = re.findall(r"\]\(([^)#]+)\)", text)
    assert [link for link in links if not (library / "text" / link).exists()] == []


@pytest.mark.long
def test_reports_are_the_same_when_they_are_made_again(library):
    """Byte for byte, figures too: what a change of a report shows is a change of its results."""
    for folder in ("one", "other"):
        assert invoke(["report", "--all", "results", "-o", folder], library).returncode == 1
    names = [path.relative_to(library / "one") for path in (library / "one").rglob("*.*")]
    assert {Path("README.md"), Path("README/league.png"), Path("small.md")} <= set(names)
    for name in names:
        assert (library / "one" / name).read_bytes() == (library / "other" / name).read_bytes()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["report", "--all", "nowhere"], "cannot read nowhere: No such file"),
        (["report", "--all", "other"], "other holds no results folders"),
        (["report"], "name a results FOLDER, or --all"),
        (["run"], "name a SCENARIO, or --all"),
        (["run", "--all", "wang2013"], "--all runs all cases of all scenarios"),
        (["run", "--all", "-c", "base"], "--all runs all cases of all scenarios"),
        (["run", "--all", "--run", "1"], "--all runs all cases of all scenarios"),
        (["run", "--all", "-e", "ekff"], "did you mean 'ekf'"),
    ],
)
def test_what_cannot_be_asked_of_a_library(library, arguments, words):
    """Exit code 2 and a sentence, before anything is run or written."""
    done = invoke(arguments, library)
    assert (done.returncode, "Traceback" in done.stderr) == (2, False)
    assert words in done.stderr
    assert not (library / "reports").exists()


def test_the_whole_library_runs(library, monkeypatch):
    """Every shipped scenario into its own folder, resumed; one that fails stops no other."""
    text = SMALL.replace("[campaign]", "[campaign]\nruns = 2") if "[campaign]" in SMALL else SMALL
    good, bad = small(library, text), small(library, SMALL.replace('"ekf"]', '"ekff"]'))
    scenarios = {"a": bad, "b": good, "c": good}
    monkeypatch.setattr(scenario, "shipped", lambda: list(scenarios))
    monkeypatch.setattr(scenario, "load", lambda name: scenarios[name])
    run = ["run", "--all", "-n", "1", "-j", "0", "-o", "lib"]
    done = invoke(run, library)
    assert done.returncode == 1, done.stderr
    assert "a failed: there is no estimator 'ekff'" in done.stdout
    assert "1 scenarios failed: a." in done.stdout
    for name in ("b", "c"):
        assert len(pd.read_parquet(library / "lib" / name / "runs.parquet")) == 2 * 2
    assert not (library / "lib" / "a").exists()
    again = invoke([*run, "-e", "ins"], library)
    assert again.returncode == 0 and "runs to do" in again.stdout  # the first one's
    assert again.stdout.count("runs to do") == 1


def test_an_interrupt_ends_the_library():
    """After Ctrl-C no further scenario begins; what else a scenario may raise is an outcome."""
    begun = []

    def run_one(name: str) -> Outcome:
        begun.append(name)
        if name == "broken":
            raise ZeroDivisionError("its own")
        return Outcome(name, interrupted=name == "stopped")

    from rich.console import Console

    outcomes = run_all(["broken", "stopped", "never"], run_one, Console(quiet=True))
    assert begun == ["broken", "stopped"]
    assert outcomes[0].error == "ZeroDivisionError: its own" and outcomes[1].interrupted
