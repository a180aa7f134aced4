"""The Python interface: the same as the command, and every mistake ends with a sentence."""

from __future__ import annotations

import ast
import dataclasses
import gc
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from campaigns import assert_equal, small
from command import invoke
from matplotlib.figure import Figure
from problems import SMALL
from small_cases import blank_map, rough_map

import ggbench as gg
from ggbench.campaign import compile_ahead, registry
from ggbench.judging.planned import bound_of
from ggbench.judging.run_errors import WINDOWS
from ggbench.results.store import DETAILED_RUN
from ggbench.spec import scenario as scenarios
from ggbench.spec import written

LABELS = ["ins", "ekf"]
LAZY = '''
from dataclasses import dataclass
import numpy as np
from ggbench.problem import Estimate, Estimator

@dataclass(frozen=True)
class Lazy(Estimator):
    """Says that nothing is wrong; refuses, or returns something else, if it is told to."""

    inflation: float = 1.0
    refuses: bool = False
    returns_text: bool = False
    name = "lazy"
    causality = "none"

    def skip(self, problem):
        return "it is too lazy" if self.refuses else None

    def estimate(self, problem, rng):
        if self.returns_text:
            return "all is well"
        cov = np.tile(self.inflation * problem.prior_cov, (problem.epochs, 1, 1))
        return Estimate(np.zeros((problem.epochs, problem.dimension)), cov, "none")
'''


@pytest.fixture
def scenario(tmp_path) -> gg.Scenario:
    return small(tmp_path)


@pytest.fixture
def lazy(tmp_path) -> str:
    (tmp_path / "lazy.py").write_text(LAZY)
    return str(tmp_path / "lazy.py")


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> gg.Results:
    """Two runs over a rough map, in this process."""
    folder = tmp_path_factory.mktemp("api")
    text = SMALL.replace('source = "normal"', f'source = "{rough_map(folder / "map.nc")}"')
    return gg.run(small(folder, text), LABELS, runs=2, jobs=0)


def test_public_names():
    """Each name exists, is listed, and is told to type checkers; another one is an error."""
    tree = ast.parse(Path(gg.__file__).read_text(encoding="utf-8"))
    told = {
        alias.asname
        for node in ast.walk(tree)
        if isinstance(node, ast.If)
        for statement in node.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }
    assert told | {"__version__"} == set(dir(gg))
    assert all(getattr(gg, name) for name in dir(gg))
    with pytest.raises(AttributeError, match="no attribute 'fly'"):
        gg.fly  # noqa: B018
    maps = {"MapRecipe", "build", "load_or_build", "read", "write"}
    assert maps <= set(dir(gg.maps)) and all(getattr(gg.maps, name) for name in maps)


def test_a_run_is_the_commands(tmp_path):
    """The same seed gives the same bits in a folder, by the command and by a call."""
    loaded = small(tmp_path)
    arguments = ["run", "small.toml", "-n", "2", "-s", "3", "-j", "0", "-o", "out"]
    assert invoke([*arguments, "-e", "ins", "-e", "ekf"], tmp_path).returncode == 0
    called = gg.run(loaded, LABELS, runs=2, seed=3, jobs=0, output=tmp_path / "called")
    assert_equal(gg.Results(tmp_path / "out"), called)
    assert (tmp_path / "called" / "metrics.csv").exists()


def test_one_run_is_the_campaigns(scenario):
    """A problem that is simulated, estimated and judged by hand has the record of its run."""
    results = gg.run(scenario, ["ekf"], runs=2, seed=3, jobs=0, cases="noisy")
    row = results.runs().set_index("run").loc[1]
    case = scenario.case("noisy")
    problem, truth = gg.simulate(case, seed=3, run=1)
    judged = gg.judge(problem, gg.estimate(problem, "ekf"), truth, case.windows)
    assert judged.final_position_error_m == row["final_position_error_m"]
    assert judged.position_mrse_m == row["whole_position_ms"] ** 0.5
    for window in WINDOWS:
        metrics = judged.windows[window]
        assert metrics["velocity_mrse_mps"] == row[f"{window}_velocity_ms"] ** 0.5
        assert metrics["nees_mean"] == row[f"{window}_nees"]
        assert metrics["nis_mean"] == row[f"{window}_nis"]


def test_what_is_shown_takes_one_line(scenario, results):
    """Each object says in a line what it is."""
    problem, truth = gg.simulate(scenario.case("base"))
    estimate = gg.estimate(problem, gg.estimator("ekf"))
    assert repr(problem) == (
        "Problem(20 epochs of 6 channels from 1.0 to 20.0 s, 15 states, SensorModel)"
    )
    assert repr(estimate) == "Estimate(mean (20, 15), cov (20, 15, 15), filter)"
    assert repr(truth) == "Truth(20 epochs of 15 states)"
    assert repr(results).startswith("Results(small: base, noisy; ins, ekf; runs 0 to 1; in ")
    assert str(scenario.case("base")) == repr(scenario.case("base"))
    assert len(str(scenario.case("base"))) < 100
    assert repr(scenario) == "Scenario(small: 'A short flight over the normal field', 2 cases)"
    assert repr(gg.judge(problem, estimate, truth)).startswith("Judgement(20 epochs: position ")


def test_tables_are_the_callers_own(results):
    """What somebody does to a table changes nothing of the results."""
    before = results.runs(), results.metrics()
    for table in (results.runs(), results.metrics()):
        table["case"] = "mine"
    assert results.runs().equals(before[0])
    assert results.metrics().equals(before[1])
    assert len(before[0]) == 2 * 2 * 2
    assert results.failures().empty
    assert set(results.pairs()["first"]) | set(results.pairs()["second"]) == set(LABELS)


@pytest.mark.long
def test_figures(results, tmp_path):
    """Each is a Matplotlib figure that can be written; the lines show what is stored."""
    figures = [
        results.plot_error_over_time("noisy"),
        results.plot_errors(),
        results.plot_errors("base", "ins", "velocity"),
        results.plot_field(),
        results.plot_track_gradient(case="noisy"),
    ]
    for number, figure in enumerate(figures):
        assert isinstance(figure, Figure)
        if number in (0, 3):  # lines, and a map
            figure.savefig(tmp_path / f"{number}.png", dpi=30)
    lines = {line.get_label(): line for line in figures[0].axes[0].lines}
    series = results.series("noisy", "ekf")[:, :, 0]
    assert np.allclose(lines["ekf"].get_ydata(), np.sqrt(np.mean(series**2, axis=0)))
    assert {"INS", "ekf"} <= set(lines)
    assert any(name.startswith("bound") for name in lines)
    detail = results.detail("base", "ekf", DETAILED_RUN)
    shown = figures[1].axes[1].lines[0].get_ydata()
    assert np.array_equal(shown, detail[:, 0])


def test_a_figure_that_cannot_be_drawn(results, scenario, lazy):
    """An unknown case, estimator or quantity, a failed run, a field without a map: a sentence."""
    with pytest.raises(gg.GGBenchError, match=r"no case 'bas' \(did you mean 'base'"):
        results.plot_field("bas")
    with pytest.raises(gg.GGBenchError, match="holds no estimator 'ukf'; it holds ins, ekf"):
        results.plot_errors("base", "ukf")
    with pytest.raises(gg.GGBenchError, match="must be one of position, velocity"):
        results.plot_errors(quantity="attitude")
    failed = gg.run(scenario, f"{lazy}[returns_text=true]", runs=1, jobs=0, cases="base")
    assert "must return Estimate, not str" in failed.failures()["reason"][0]
    with pytest.raises(gg.GGBenchError, match="in case base, run 0: this run failed"):
        failed.plot_errors()
    with pytest.raises(gg.GGBenchError, match="case base uses the normal field"):
        failed.plot_field()


def test_results_without_an_output_go_with_their_object(scenario):
    """A temporary folder lives as long as its results, and no longer."""
    results = gg.run(scenario, "ins", runs=1, jobs=0)
    folder = results.folder
    assert (folder / "metrics.csv").exists()
    assert len(gg.Results(folder).runs()) == 2
    del results
    gc.collect()
    assert not folder.exists()


def test_an_interrupt_keeps_what_has_finished(scenario, tmp_path):
    """The same call goes on, and runs nothing again."""
    told: list[tuple[int, int]] = []

    def stop(done: int, total: int) -> None:
        told.append((done, total))
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        gg.run(scenario, "filterpy-ekf", runs=3, jobs=0, output=tmp_path / "out", progress=stop)
    assert told == [(0, 6), (1, 6), (2, 6)]
    held = gg.Results(str(tmp_path / "out"))
    assert len(held.runs()) == 2
    gg.run(
        scenario,
        "filterpy-ekf",
        runs=3,
        jobs=0,
        output=str(tmp_path / "out"),
        progress=lambda done, total: told.append((done, total)),
    )
    assert told[3:] == [(0, 4), (1, 4), (2, 4), (3, 4), (4, 4)]


def test_progress_is_shown_where_somebody_looks(scenario, monkeypatch, capsys):
    """On the standard error output, in a terminal or on demand; a script's output stays its own."""

    def shown(**options: bool) -> str:
        gg.run(scenario, "ins", runs=2, jobs=0, **options)
        out, errors = capsys.readouterr()
        assert not out
        return errors

    assert shown() == shown(progress=False) == ""
    assert "4 runs to do" in shown(progress=True) and "4 of 4 runs" in shown(progress=True)
    monkeypatch.setenv("FORCE_COLOR", "1")  # by which rich takes the output for a terminal
    assert "4 of 4 runs" in shown()
    assert shown(progress=False) == ""


@pytest.mark.long
def test_a_first_use_compiles_ahead(scenario, monkeypatch):
    """In a process of its own, which ends with the call; there is none when nothing is new."""
    helpers, start = [], compile_ahead._started

    def started() -> subprocess.Popen[str]:
        helpers.append(start())
        return helpers[-1]

    monkeypatch.setattr(compile_ahead, "_started", started)
    for first in (["First use."], []):
        helpers.clear()
        monkeypatch.setattr("ggbench.api.running.first_use", lambda *_, first=first: first)
        gg.run(scenario, "ins", runs=1, jobs=2)
        assert len(helpers) == len(first)
        assert all(process.returncode is not None for process in helpers)


def test_progress_in_a_notebook_needs_no_widgets(scenario, monkeypatch, recwarn):
    """Without ipywidgets lines are printed, and nothing warns of them."""
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    gg.run(scenario, "ins", runs=1, jobs=0)
    assert not [w for w in recwarn if "ipywidgets" in str(w.message)]


def test_what_is_built_is_said(scenario, monkeypatch, capsys):
    """A map that is not in the cache, and code that is not compiled yet."""
    monkeypatch.setattr("ggbench.api.running.first_use", lambda *_: ["First use."])
    monkeypatch.setattr("ggbench.api.showing.maps_to_build", lambda fields: ["Building a map."])
    gg.run(scenario, "ins", runs=1, jobs=0, progress=True)
    assert "First use.\nBuilding a map.\n" in capsys.readouterr().err


def test_a_folder_is_free_when_a_run_has_ended(scenario, tmp_path):
    """A second call adds to the folder of the first one's results, which stay what they are."""
    first = gg.run(scenario, "ins", runs=1, jobs=0, output=tmp_path / "out")
    second = gg.run(scenario, ["ins", "ekf"], runs=2, jobs=0, output=tmp_path / "out")
    assert (len(first.runs()), len(second.runs())) == (2, 8)
    assert first.plot_error_over_time() is not None


def test_an_estimator_itself(scenario, lazy):
    """An instance is run under the text that makes it; of a file of one's own, too."""
    merwe = gg.estimator("ukf[points=merwe]")
    own = dataclasses.replace(gg.estimator(lazy), inflation=0.1 + 0.2)
    results = gg.run(scenario, [merwe, own], runs=1, jobs=0, cases=["base"])
    assert results.labels == ["ukf[points=merwe]", f"{lazy}[inflation={0.1 + 0.2}]"]
    assert all(registry.choose(label).estimator in (merwe, own) for label in results.labels)


def test_an_estimator_that_no_worker_could_find(scenario, lazy, tmp_path):
    """A class of a notebook, a file that has changed since: refused, and what to do instead."""

    @dataclass(frozen=True)
    class Own(gg.Estimator):
        name = "own"
        causality = "none"

        def estimate(self, problem, rng):
            cov = np.tile(problem.prior_cov, (problem.epochs, 1, 1))
            return gg.Estimate(np.zeros((problem.epochs, problem.dimension)), cov, "none")

    with pytest.raises(gg.GGBenchError, match="put it into a file and give its path"):
        gg.run(scenario, [Own()])
    problem, truth = gg.simulate(scenario.case("base"))
    assert gg.judge(problem, gg.estimate(problem, Own()), truth).position_mrse_m > 0.0
    old = gg.estimator(lazy)
    (tmp_path / "lazy.py").write_text(LAZY + "\nCHANGED = True\n")
    with pytest.raises(gg.GGBenchError, match="its file has changed"):
        gg.run(scenario, old)


def test_an_estimator_that_cannot_take_a_problem(scenario, lazy):
    """One problem is refused with the reason; in a campaign the others are run."""
    problem, _ = gg.simulate(scenario.case("base"))
    with pytest.raises(gg.GGBenchError, match="lazy refuses this problem: it is too lazy"):
        gg.estimate(problem, f"{lazy}[refuses=true]")
    with pytest.raises(gg.GGBenchError, match="must return an Estimate, not an object of type str"):
        gg.estimate(problem, f"{lazy}[returns_text=true]")
    with pytest.warns(UserWarning, match="is left out: it is too lazy") as told:
        results = gg.run(scenario, ["ins", f"{lazy}[refuses=true]"], runs=1, jobs=0)
    assert told[0].filename == __file__
    assert set(results.runs()["estimator"]) == {"ins"}


def test_a_scenario_that_was_changed(scenario):
    """Some of its cases can be run, and a changed one simulated if it keeps the rules.

    Other cases than the file's would be stored as what they are not, and are refused.
    """
    part = gg.run(scenario.select(["noisy"]), "ins", runs=1, jobs=0)
    assert part.manifest["cases"] == ["noisy"]
    case = scenario.case("base")
    quiet = case.model_copy(
        update={"gradiometer": case.gradiometer.model_copy(update={"noise_eotvos": 1e-3})}
    )
    with pytest.raises(gg.GGBenchError, match="case base of small differs from the scenario's"):
        gg.run(dataclasses.replace(scenario, cases=(quiet,)), "ins")
    with pytest.raises(gg.GGBenchError, match="differs from its file"):
        gg.run(dataclasses.replace(scenario, title="Another"), "ins")
    problem, _ = gg.simulate(quiet)
    assert np.allclose(np.sqrt(np.diag(problem.noise_cov)), 1e-3, rtol=0.5)
    wrong = case.model_copy(
        update={"gradiometer": case.gradiometer.model_copy(update={"noise_eotvos": -1.0})}
    )
    with pytest.raises(gg.GGBenchError, match=r"gradiometer.noise_eotvos is -1.0 and must"):
        gg.simulate(wrong)


BAD_CALLS = {
    "unknown scenario": (lambda s: gg.load("wang2012"), "did you mean 'wang2013'"),
    "scenario that is a number": (lambda s: gg.load(2013), "must be a name or a path, not an obj"),
    "unknown scenario to run": (lambda s: gg.run("wang2012"), "did you mean 'wang2013'"),
    "unknown case": (lambda s: s.case("bas"), "no case 'bas' .did you mean 'base'"),
    "unknown case to run": (lambda s: gg.run(s, cases=["x"]), "no case 'x'"),
    "case by its name": (lambda s: gg.simulate("base"), "base"),
    "number as a case": (lambda s: gg.simulate(1), "must be scenario.case.name. or a scenario"),
    "no headings": (lambda s: gg.plan(s, headings=0), "headings is 0 and must lie between"),
    "unknown estimator to check": (lambda s: gg.check("ekff"), "did you mean 'ekf'"),
    "negative seed": (lambda s: gg.simulate(s.case("base"), -1), "seed is -1 and must lie between"),
    "seed with a fraction": (lambda s: gg.run(s, seed=1.5), "seed is 1.5 and must be a whole"),
    "negative run": (lambda s: gg.simulate(s.case("base"), 1, -1), "run is -1 and must lie betwe"),
    "no runs": (lambda s: gg.run(s, runs=0), "runs is 0 and must lie between 1 and 1000000"),
    "too many runs": (lambda s: gg.run(s, runs=10**7), "runs is 10000000 and must lie between"),
    "negative jobs": (lambda s: gg.run(s, jobs=-1), "jobs is -1 and must lie between 0"),
    "jobs and a cluster": (lambda s: gg.run(s, jobs=1, cluster="x"), "give either jobs"),
    "address": (lambda s: gg.run(s, cluster="x"), "'x' is no address of a Dask scheduler"),
    "no time": (lambda s: gg.run(s, time_limit=0.0), "time_limit is 0.0 s and must be above 0"),
    "endless time": (lambda s: gg.run(s, time_limit=float("nan")), "time_limit is nan s and"),
    "time in words": (lambda s: gg.run(s, time_limit="long"), "time_limit is 'long' and must be a"),
    "unknown estimator": (lambda s: gg.estimator("ekff"), "did you mean 'ekf'"),
    "unknown estimator to run": (lambda s: gg.run(s, ["ekff"]), "did you mean 'ekf'"),
    "estimator that is a class": (lambda s: gg.estimator(gg.Estimator), "must be a text, not"),
    "estimators in a set": (lambda s: gg.run(s, {"ekf"}), "must be a list of texts or estimators"),
    "estimators of a number": (lambda s: gg.run(s, [1]), "must be a list of texts or estimators"),
    "cases of a number": (lambda s: gg.run(s, cases=[1]), "cases must be a list of texts, and is"),
    "truth as a problem": (lambda s: gg.estimate(None, "ekf"), "must be a Problem, not"),
    "nothing stored": (lambda s: gg.Results("nowhere"), "nowhere holds no results"),
    "map by another name": (lambda s: gg.maps.write("m.map", blank_map()), "must be named .*nc"),
    "no map": (lambda s: gg.maps.read("gone.nc"), "cannot read the map gone.nc"),
    "map below a file": (lambda s: gg.maps.write(f"{__file__}/m.nc", blank_map()), "cannot write"),
}


SLOW_CALLS = {"unknown estimator to check"}
"""Calls that start a process."""


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.long) if n in SLOW_CALLS else n for n in BAD_CALLS],
)
def test_a_bad_call_ends_with_a_sentence(name, scenario, tmp_path, monkeypatch):
    """Nothing is run and nothing is left; the sentence says what was wrong."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    call, sentence = BAD_CALLS[name]
    with pytest.raises(gg.GGBenchError, match=sentence) as told:
        call(scenario)
    assert "\n" not in str(told.value)
    assert [path.name for path in tmp_path.iterdir()] == ["small.toml"]


def test_a_folder_of_someone_else(scenario, tmp_path):
    """A folder with other files is left alone, and so is one of another scenario."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("")
    with pytest.raises(gg.GGBenchError, match="is not empty and holds no results"):
        gg.run(scenario, "ins", runs=1, jobs=0, output=tmp_path / "mine")
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["thesis.tex"]
    gg.run(scenario, "ins", runs=1, jobs=0, output=tmp_path / "out")
    (tmp_path / "other.toml").write_text(SMALL)
    with pytest.raises(gg.GGBenchError, match="results of the scenario small, not of other"):
        gg.run(tmp_path / "other.toml", "ins", runs=1, jobs=0, output=tmp_path / "out")


def test_a_map_is_read_as_it_was_written(tmp_path):
    """The file keeps every number of a map in memory."""
    made = blank_map(count=6)
    made.tensor[:] = np.random.default_rng(1).standard_normal(made.tensor.shape)
    made.tensor[..., 5] = -made.tensor[..., 0] - made.tensor[..., 3]  # a field has no trace
    gg.maps.write(str(tmp_path / "map.nc"), made)
    found = gg.maps.read(str(tmp_path / "map.nc"))
    assert np.array_equal(found.tensor, made.tensor)
    assert found.latitude0 == pytest.approx(made.latitude0, abs=1e-15)


def test_a_case_that_was_changed_is_run(tmp_path):
    """``case.changed`` gives a case that run takes, alone or with others, with equal results."""
    case = small(tmp_path).cases[1]
    better = case.changed("gradiometer.noise_eotvos", 0.1 * case.gradiometer.noise_eotvos)
    results = gg.run([case, better.changed("name", "better")], "ekf", 4, jobs=0)
    rms = results.summary().set_index("case")["rms_m"]
    assert list(rms.index) == [case.name, "better"]
    alone = gg.run(case, "ekf", 4, jobs=0).summary()["rms_m"].iloc[0]
    assert alone == pytest.approx(rms[case.name], rel=1e-9)


def test_a_sweep_has_a_case_for_each_combination(tmp_path):
    case = small(tmp_path).cases[0]
    values = {"gradiometer.noise_eotvos": [0.01, 1.0], "initial_error.position_m": [1.0, 5.0]}
    results = gg.sweep(case, values, ["ins", "ekf"], 2, jobs=0)
    titles = [found.title for found in results.scenario.cases]
    assert titles == [
        f"noise_eotvos {noise}, position_m {prior}" for noise in (0.01, 1.0) for prior in (1.0, 5.0)
    ]
    assert len(results.summary()) == 8
    assert list(results.summary()["title"].unique()) == titles
    figure = results.plot_sweep()
    assert [axes.get_title() for axes in figure.axes[:2]] == ["position_m 1", "position_m 5"]
    assert figure.axes[0].get_xlabel() == figure.axes[1].get_xlabel() == "gradiometer.noise_eotvos"
    curves = {tuple(line.get_xdata()): line.get_ydata() for line in figure.axes[0].lines}
    errors = results.metrics().query("window == 'settled' and estimator == 'ekf'")
    drawn = [line.get_ydata().tolist() for line in figure.axes[0].lines]
    assert errors["rms_m"].iloc[[0, 2]].tolist() in drawn and (0.01, 1.0) in curves
    other = results.plot_sweep("initial_error.position_m")
    assert other.axes[0].get_title() == "noise_eotvos 0.01"
    with pytest.raises(gg.GGBenchError, match=r"no sweep of imu\.period_s: it varies gradio"):
        results.plot_sweep("imu.period_s")
    single = gg.run(case, "ekf", 2, jobs=0)
    with pytest.raises(gg.GGBenchError, match="no numeric key varies"):
        single.plot_sweep()


def test_a_scenario_stands_for_its_first_case(scenario, tmp_path):
    """By its path, too."""
    for given in (scenario, scenario.cases[0], tmp_path / "small.toml"):
        problem, _ = gg.simulate(given, seed=2, run=1)
        np.testing.assert_array_equal(
            problem.measurements, gg.simulate(scenario.case("base"), seed=2, run=1)[0].measurements
        )


def test_bound_and_tracks_are_those_of_the_commands(scenario):
    """The bound that the table of tracks has for the flight as it is, and the best comes first."""
    bounds, tracks = gg.bound(scenario), gg.plan(scenario, headings=3, starts=2, step_km=0.1)
    problem, _ = gg.simulate(scenario)
    np.testing.assert_array_equal(bounds["time_s"], problem.times)
    assert (bounds["position_smoothed_m"] <= bounds["position_m"] * (1.0 + 1e-9)).all()
    assert len(tracks) == 13 and tracks["bound_m"].is_monotonic_increasing
    (own,) = gg.plan(scenario, headings=1)["bound_m"]
    assert own == pytest.approx(bound_of(scenario.cases[0]))


@pytest.mark.long
def test_an_estimator_is_checked_and_scored_from_python(tmp_path):
    """Twice: a module of the package must not take the place of a function."""
    for _ in range(2):
        checks = gg.check("ins")
        assert set(checks["verdict"]) <= {"passed", "refused"} and len(checks) == 9
        scored = gg.scorecard("ekf", runs=2, cases="air-narrow", output=tmp_path / "card", jobs=0)
        assert scored.card.estimator.label == "ekf"


@pytest.mark.long
def test_advice_from_python_is_that_of_the_command(scenario, tmp_path):
    found = gg.advise(scenario, runs=2, output=tmp_path / "advice", jobs=0)
    assert found.bound_m == pytest.approx(bound_of(scenario.cases[0]))
    assert {"ins", "ekf"} <= set(found.results.metrics()["estimator"])


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda case: gg.run([], "ekf"), "at least one case"),
        (lambda case: gg.run([1], "ekf"), "cases must be a list of cases"),
        (lambda case: gg.run([case, case], "ekf"), "defined twice"),
        (lambda case: gg.sweep(case, {}, "ekf", 2), "at least one key"),
        (lambda case: gg.sweep(case, {"a.b": [1]}, "ekf", 2), "unknown key 'a'"),
        (lambda case: case.changed("gradiometer.noise", 1.0), "unknown key 'gradiometer.noise'"),
        (lambda case: case.model_copy(update={"gradiometer.noise_eotvos": 1.0}), "case.changed"),
    ],
)
def test_bad_cases_are_refused_in_a_sentence(call, said, tmp_path):
    with pytest.raises(gg.GGBenchError, match=said):
        call(small(tmp_path).cases[0])


def test_every_shipped_case_is_read_as_it_is_written():
    """A scenario made of cases in Python has the same cases."""
    for name in scenarios.shipped()[::3]:
        cases = gg.load(name).cases[:5]
        assert written.of_cases(cases).cases == cases


def test_what_a_notebook_shows(tmp_path):
    """Reprs fit a line, tables are HTML, a judgement is drawn and is a table."""
    scenario = small(tmp_path)
    case = scenario.cases[0]
    problem, truth = gg.simulate(case)
    estimate = gg.estimate(problem, "ekf")
    judged = gg.judge(problem, estimate, truth)
    for shown in (scenario, case, problem, truth, estimate, judged):
        assert "\n" not in repr(shown) and len(repr(shown)) < 160
    assert "<table>" in scenario._repr_html_()
    table = judged.to_frame()
    np.testing.assert_array_equal(table["east_m"], judged.components[:, 0])
    assert len(table) == problem.epochs
    assert len(judged.plot().axes) == 6
