"""The installed `ggbench` command, as a user meets it: a process, its output and its exit code."""

from __future__ import annotations

import functools
import os
import shlex
import signal
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pandas as pd
import pytest
from campaigns import COMMAND, DEADLINE_S, stored
from click.testing import CliRunner
from command import Outcome, invoke
from problems import SMALL

from ggbench.cli.main import main
from ggbench.judging.summary import METRICS

LAGGED = "factor-graph[mode=fixed-lag,lag="
GOOD = {
    "version": ["--version"],
    "help": ["--help"],
    "list": ["list"],
    "validate": ["validate", "small.toml"],
    "validate shipped": ["validate", "wang2013"],
}
PROCESSES = ("unknown scenario", "version")
"""Commands that are run as processes; the others, for their number, inside this one."""
BAD = {
    "unknown scenario": (["run", "wang2012"], "did you mean 'wang2013'"),
    "missing file": (["validate", "gone.toml"], "gone.toml: cannot be read: No such file"),
    "unknown key": (["run", "unknown_key.toml"], "unknown_key.toml: case 'base': unknown key"),
    "unit in a value": (["validate", "unit.toml"], "unit.toml: case 'base': gradiometer.noise_eo"),
    "negative noise": (
        ["run", "negative.toml"],
        "is -0.01 and must lie between 1e-9 and 1e6",
    ),
    "unknown kind of sensor": (
        ["run", "kind.toml"],
        "kind.toml: case 'base': sensor.stern: kind is 'gps'; allowed: \"gnss\"",
    ),
    "cut-off": (["run", "nyquist.toml"], "must lie below the Nyquist frequency"),
    "invalid TOML": (["validate", "invalid.toml"], "invalid.toml: is not valid TOML"),
    "unknown map": (["validate", "map.toml"], "egm2088"),
    "unknown estimator in a file": (["validate", "estimator.toml"], "no estimator 'ekff'"),
    "unknown estimator": (["run", "small.toml", "-e", "ekff"], "did you mean 'ekf'"),
    "unknown parameter": (["run", "small.toml", "-e", "ekf[gain=1]"], "no parameter 'gain'"),
    "wrong value": (["run", "small.toml", "-e", "ukf[points=x]"], "must be julier | merwe"),
    "lag that is no number": (["run", "small.toml", "-n1", "-e", LAGGED + "nan]"], "lag"),
    "endless lag": (["run", "small.toml", "-n1", "-e", LAGGED + "inf]"], "lag"),
    "missing estimator file": (["run", "small.toml", "-e", "gone.py"], "cannot read estimator"),
    "broken estimator file": (["run", "small.toml", "-e", "broken.py"], "broken.py cannot be"),
    "output in the way": (["run", "small.toml", "-n1", "-o", "small.toml"], "cannot use results"),
    "output below a file": (["run", "small.toml", "-n1", "-o", "small.toml/x"], "cannot use"),
    "report of nothing": (["report", "nowhere"], "nowhere holds no results"),
    "report of a file": (["report", "small.toml"], "small.toml holds no results"),
    "unknown case": (["run", "small.toml", "-c", "bas"], "no case 'bas' (did you mean 'base'?)"),
    "unknown case of one run": (["run", "small.toml", "-c", "x", "--run", "1"], "no case 'x'"),
    "no time": (["run", "small.toml", "--time-limit", "0"], "0.0 is not in the range"),
    "cluster and jobs": (
        ["run", "small.toml", "-j", "1", "--cluster", "x"],
        "give either -j or --cluster",
    ),
    "address": (["run", "small.toml", "--cluster", "x"], "'x' is no address of a Dask scheduler"),
    "show nothing": (["show", "nowhere"], "nowhere holds no results"),
    "compare nothing": (["compare", "nowhere", "nowhere"], "nowhere holds no results"),
    "threshold": (["compare", "a", "b", "--threshold", "-1"], "-1.0 is not in the range"),
    "no runs": (["run", "small.toml", "-n", "0"], "0 is not in the range"),
    "runs in words": (["run", "small.toml", "-n", "many"], "'many' is not a valid integer"),
    "unknown option": (["run", "small.toml", "--fast"], "No such option"),
    "unknown command": (["fly"], "No such command"),
}


def call(arguments: list[str], cwd: Path) -> Outcome:
    """Run the installed command to its end, with a terminal's width that is not pytest's."""
    done = subprocess.run(
        [COMMAND, *arguments],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        env=os.environ | {"COLUMNS": "120"},
    )
    return Outcome(done.returncode, done.stdout, done.stderr)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder of one's own, far from the package, with good and bad files."""
    path = tmp_path_factory.mktemp("cli")
    noise = "noise_eotvos = 0.01"
    for name, old, new in (
        ("small", "", ""),
        ("unknown_key", noise, noise + "\nnoise = 1.0"),
        ("unit", noise, 'noise_eotvos = "0.01 E"'),
        ("negative", noise, "noise_eotvos = -0.01"),
        ("nyquist", noise, noise + '\nfilter = "butterworth"\nfilter_cutoff_hz = 0.5'),
        ("kind", "[windows]", '[sensor.stern]\nkind = "gps"\nperiod_s = 1.0\n[windows]'),
        ("invalid", "[windows]", "[windows"),
        ("map", 'source = "normal"', 'source = "egm2088"'),
        ("estimator", '"ekf"]', '"ekff"]'),
    ):
        (path / f"{name}.toml").write_text(SMALL.replace(old, new, 1) if old else SMALL)
    (path / "broken.py").write_text("def f(:\n")
    return path


@pytest.fixture(scope="module")
def outcome(folder):
    """The outcome of a command by its name; the processes are run once, two at a time."""
    commands = GOOD | {name: arguments for name, (arguments, _) in BAD.items()}

    @functools.cache
    def processes() -> dict[str, Outcome]:
        with ThreadPoolExecutor(2) as pool:
            done = pool.map(lambda name: call(commands[name], folder), PROCESSES)
            return dict(zip(PROCESSES, done, strict=True))

    return lambda name: processes()[name] if name in PROCESSES else invoke(commands[name], folder)


@pytest.mark.parametrize("name", GOOD)
def test_commands_that_only_tell(name, outcome):
    """Help, version, list and validate work in any folder and say nothing on stderr."""
    done = outcome(name)
    assert done.returncode == 0
    assert done.stderr == ""
    expected = {
        "version": ["ggbench 0."],
        "help": ["list", "report", "run", "validate"],
        "list": ["wang2013", "ekf", "ukf", "factor-graph", "julier", "fixed-lag", "mode"],
        "validate": ["small.toml is valid", "2 cases"],
        "validate shipped": ["wang2013 is valid", "7 cases"],
    }
    assert [word for word in expected[name] if word not in done.stdout] == []


@pytest.mark.parametrize("name", BAD)
def test_bad_input_ends_with_a_sentence(name, outcome):
    """Exit code 2, one line on stderr that says what is wrong (or click's usage), no traceback."""
    done = outcome(name)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr + done.stdout
    assert BAD[name][1] in done.stderr
    lines = done.stderr.splitlines()
    if lines[0].startswith("Usage: ggbench"):
        assert lines[-1].startswith("Error: ")
    else:
        assert len(lines) == 1
        assert lines[0].startswith("ggbench: ")


def test_run_and_report(folder, tmp_path):
    """A run from another folder ends with the tables, best causal estimator first; then a report.

    The same command again runs nothing anew; another seed keeps the first one's results.
    """
    run = [
        "run",
        str(folder / "small.toml"),
        *shlex.split("-n 2 -j 0 -s 3 -o out -e ins -e factor-graph[mode=batch] -e ekf"),
    ]
    done = invoke(run, tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "12 of 12 runs" in done.stdout
    assert "runs/s, 0 s left; RMS error of base in m: ins " in done.stdout
    assert "'ggbench report out'" in done.stdout
    table = pd.read_csv(tmp_path / "out" / "metrics.csv")
    for case, title in (("base", "as it is"), ("noisy", "with ten times the noise")):
        shown = done.stdout[done.stdout.index(title) :]
        own = table[(table["case"] == case) & (table["window"] == "settled")]
        errors = own.set_index("estimator")["rms_m"][["ins", "ekf"]].sort_values()
        names = [*errors.index, "factor-graph[mode=batch]"]
        places = [shown.index(f"\n {name} ") for name in names]
        assert places == sorted(places)
    assert list(table.columns) == list(METRICS)
    assert len(table) == 2 * 3 * 3
    assert (table["runs"] == 2).all()
    assert (table["failed"] == 0).all()

    again = invoke(run, tmp_path)
    assert again.returncode == 0
    assert "runs to do" not in again.stdout
    other = invoke([*run, "-s", "4"], tmp_path)
    assert "out contains 12 results of another seed" in other.stdout
    assert "12 of 12 runs" in other.stdout
    again = invoke(run, tmp_path)
    assert "runs to do" not in again.stdout

    done = invoke(["report", "out", "-o", "text"], tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    text = (tmp_path / "text" / "small.md").read_text()
    assert "EKF" in text and "bound [m]" in text
    pictures = list((tmp_path / "text" / "small").glob("*.png"))
    assert pictures
    assert [p.name for p in pictures if f"small/{p.name}" not in text] == []

    (tmp_path / "blocked").write_text("")
    done = invoke(["report", "out", "-o", "blocked"], tmp_path)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert done.stderr.startswith("ggbench: cannot write to blocked")


def test_a_failing_estimator_does_not_end_a_run(folder):
    """An estimator of one's own that raises counts as bad and is named; other runs are stored."""
    (folder / "bad.py").write_text(
        "from dataclasses import dataclass\n"
        "from ggbench.problem import Estimator\n"
        "@dataclass(frozen=True)\n"
        "class Bad(Estimator):\n"
        "    name = 'bad'\n"
        "    causality = 'filter'\n"
        "    def estimate(self, problem, rng):\n"
        "        raise ValueError('I give up')\n"
    )
    run = ["run", "small.toml", "-n", "2", "-j", "0", "-e", "bad.py", "-e", "ekf", "-o", "bad"]
    done = invoke(run, folder)
    assert (done.returncode, done.stderr) == (1, "")
    assert "All runs of bad.py failed." in done.stdout
    table = pd.read_csv(folder / "bad" / "metrics.csv").set_index("name")
    assert table["failed"].to_dict() == {"bad": 2, "ekf": 0}

    alone = ["run", "small.toml", "-n", "1", "-j", "0", "-c", "base", "-e", "bad.py", "-o", "lost"]
    done = invoke(alone, folder)
    assert (done.returncode, done.stderr) == (1, ""), "a script must see that nothing came of it"
    for words in ("small: 1 run to do", "small: 1 of 1 run (1 failed)", "1 run failed: 'ggbench"):
        assert words in done.stdout
    assert " 1 runs" not in done.stdout
    told = invoke(["show", "lost"], folder).stdout
    assert "1 result of up to 1 run per case: 1 failed" in told


@pytest.mark.long
@pytest.mark.parametrize(
    ("jobs", "moment"),
    [("1", 1), ("2", 1), ("2", 0)],
)
def test_an_interrupt_leaves_results_that_can_be_reported(jobs, moment, folder, tmp_path):
    """Ctrl-C in the middle: exit code 130, no traceback, and what is finished can be reported.

    The signal goes to all processes of the command, as a terminal sends it: after the first
    records, and (moment 0) while the workers are still starting.
    """
    run = ["run", str(folder / "small.toml"), "-n", "5000", "-j", jobs, "-s", "3", "-o", "out"]
    process = subprocess.Popen(
        [COMMAND, *run],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        deadline = time.monotonic() + DEADLINE_S
        prepared = tmp_path / "out" / "scenario.toml"
        while not prepared.exists() or stored(tmp_path / "out") < 4 * moment:
            assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.05)
        time.sleep(0.5)
        os.killpg(process.pid, signal.SIGINT)
        output, errors = process.communicate(timeout=DEADLINE_S)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    assert process.returncode == 130, errors
    assert "Traceback" not in output + errors
    assert errors == ""
    assert "Interrupted." in output
    count = stored(tmp_path / "out")
    if moment:
        assert count >= 4
        done = invoke(["report", "out"], tmp_path)
        assert (done.returncode, done.stderr) == (0, "")
        assert (tmp_path / "out" / "report" / "small.md").exists()
    else:
        # Nothing may be finished yet: the same command goes on from there.
        done = invoke([*run[:3], "1", *run[4:]], tmp_path)
        assert (done.returncode, done.stderr) == (0, "")
        assert stored(tmp_path / "out") >= 4


@pytest.mark.parametrize(
    "words",
    [
        "new scenario mine --speed nan",
        "map build --lines a.csv --depth nan -o a.nc",
        "map build --terrain a.tif --density inf -o a.nc",
        "map show a.nc --height nan",
        "map score a.nc --noise nan",
    ],
)
def test_options_are_finite_numbers(words, tmp_path, monkeypatch):
    """Ranges of click let nan pass, into scenarios and maps."""
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, words.split())
    assert result.exit_code == 2
    assert "must be a finite number" in result.output
    assert not list(tmp_path.iterdir())
