"""``ggbench score``: a card from a file, checked, reproduced, compared; bad input in a sentence."""

from __future__ import annotations

import json
import shutil

import pytest
from command import invoke

from ggbench.score import stored_runs

CASES = ["-c", "air-narrow", "-c", "one-channel", "-n", "20", "-j", "0"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a filter from the template and its card."""
    place = tmp_path_factory.mktemp("score")
    assert invoke(["new", "estimator", "my_filter"], place).returncode == 0
    done = invoke(["score", "my_filter.py", *CASES], place, columns=160)
    assert (done.returncode, done.stderr) == (0, "")
    (place / "said.txt").write_text(done.stdout, encoding="utf-8")
    return place


@pytest.mark.long
def test_a_filter_from_the_template_gets_its_card(folder):
    """The screen has a row for each question and the verdicts; three files are written."""
    said = (folder / "said.txt").read_text(encoding="utf-8")
    for words in (
        "Aircraft over the Alps, narrow prior",
        "Against the EKF: as good in 2 of 2",
        "my_filter, 20 runs of each case, seed 3702",
    ):
        assert words in said
    written = folder / "results" / "score" / "my_filter-py"
    card = json.loads((written / "card.json").read_text(encoding="utf-8"))
    assert [asked["case"] for asked in card["questions"]] == ["air-narrow", "one-channel"]
    for name in ("card.md", "card.html"):
        text = (written / name).read_text(encoding="utf-8")
        assert "Scorecard of" in text and "as good" in text


@pytest.mark.long
def test_its_card_is_reproduced_and_no_worse(folder):
    """Flown again in another folder; and a card that was changed is not reproduced."""
    card = folder / "results" / "score" / "my_filter-py" / "card.json"
    done = invoke(["score", "my_filter.py", "--check", str(card), "-o", "again", "-j", "0"], folder)
    assert done.returncode == 0, done.stdout
    assert "The check runs the code of my_filter.py." in done.stdout
    assert "The card is reproduced." in done.stdout
    done = invoke(["score", "my_filter.py", "--check", str(card), "-o", str(card.parent)], folder)
    assert done.returncode == 2
    assert "--check repeats: choose another folder with -o" in " ".join(done.stderr.split())
    shutil.copy(card, folder / "older.json")
    same = invoke(["score", "my_filter.py", *CASES, "--against", "older.json"], folder)
    assert same.returncode == 0
    assert "2 questions compared, none significantly worse." in same.stdout
    changed = json.loads(card.read_text(encoding="utf-8"))
    changed["questions"][0]["errors_m"][3] *= 1.01
    (folder / "changed.json").write_text(json.dumps(changed))
    done = invoke(
        ["score", "my_filter.py", "--check", "changed.json", "-o", "again", "-j", "0"], folder
    )
    assert done.returncode == 1
    assert "air-narrow: 1 of 20 runs differ; the first is run 3" in done.stdout
    changed = json.loads(card.read_text(encoding="utf-8"))
    changed["questions"][0]["rms_m"] *= 0.9
    changed["questions"][1]["against"][0]["verdict"] = "better"
    (folder / "changed.json").write_text(json.dumps(changed))
    done = invoke(["score", "my_filter.py", "--check", "changed.json", "-j", "0"], folder)
    assert done.returncode == 1
    assert "air-narrow: rms_m was" in done.stdout
    assert "one-channel: against[0].verdict was 'better' and is" in done.stdout


@pytest.mark.long
def test_a_filter_that_became_worse_is_found(folder):
    """The filter's variance is divided by nine; the exit code is 1."""
    card = folder / "results" / "score" / "my_filter-py" / "card.json"
    shutil.copy(folder / "my_filter.py", folder / "worse.py")
    text = (folder / "worse.py").read_text(encoding="utf-8")
    assert "noise = problem.noise_of(k)" in text
    changed = text.replace("noise = problem.noise_of(k)", "noise = problem.noise_of(k) / 9.0")
    (folder / "worse.py").write_text(changed, encoding="utf-8")
    done = invoke(["score", "worse.py", *CASES, "--against", str(card)], folder)
    assert done.returncode == 1
    assert "Worse than the older card:" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "give an ESTIMATOR"),
        (["ekv"], "ekv"),
        (["missing.py"], "missing.py"),
        (["ekf", "--quick", "-n", "30"], "give either --quick"),
        (["ekf", "-n", "201"], "201 runs requested, but only 200 of each case are stored"),
        (["ekf", "-c", "air"], "has no case 'air'"),
        (["--check", "none.json"], "cannot read the card none.json"),
        (["--check", "none.json", "--quick"], "--check repeats the runs of a card"),
        (["ekf", "--against", "none.json"], "cannot read the card none.json"),
    ],
)
def test_bad_input_is_a_sentence(arguments, said, tmp_path):
    done = invoke(["score", *arguments], tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr


def stated(label: str, case: str = "air-narrow") -> dict[str, object]:
    """A card of one case and two runs."""
    other = {
        "label": "ekf",
        "role": "ekf",
        "runs": 2,
        "rms_m": 1.0,
        "error_ratio": 1.0,
        "lo": 0.9,
        "hi": 1.1,
        "only_scored": 0,
        "only_other": 0,
        "verdict": "as good",
    }
    here = stored_runs.header()
    return {
        "format": 2,
        "ggbench": "0",
        "results_version": here["results_version"],
        "suite": here["scenario_hash"],
        "seed": here["seed"],
        "public": True,
        "runs": 2,
        "judged": "all",
        "estimator": {"label": label, "name": "a", "parameters": {}, "source": "0"},
        "questions": [
            {
                "case": case,
                "title": "",
                "against": [other],
                "errors_m": [1e3, 1e3],
                "succeeded": [True, True],
            }
        ],
    }


@pytest.mark.parametrize(
    "label", ["victim/setup.py", "exec:./victim/run", "a[", "\0.py", "stored.mat"]
)
def test_a_card_runs_no_file_that_it_names(label, tmp_path):
    """Neither a module nor a program; control: the file does something when it is named."""
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "setup.py").write_text("open('ran', 'w').close()")
    (victim / "run").write_text("#!/bin/sh\ntouch ran")
    (victim / "run").chmod(0o755)
    (tmp_path / "card.json").write_text(json.dumps(stated(label)))
    done = invoke(["score", "--check", "card.json", "-j", "0"], tmp_path)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "ran").exists()
    if label.endswith("setup.py"):
        invoke(["score", label, "--check", "card.json", "-j", "0"], tmp_path)
        assert (tmp_path / "ran").exists()


@pytest.mark.long
def test_a_card_of_other_cases_is_no_gate(tmp_path):
    """Exit code 2, before anything is flown; control: a case that is flown is compared."""
    (tmp_path / "card.json").write_text(json.dumps(stated("ekf", "outliers")))
    done = invoke(["score", "ekf", "-c", "air-narrow", "--against", "card.json"], tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert "none of the requested cases has results" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["card.json"]
    arguments = ["-c", "air-narrow", "-n", "2", "-j", "0", "--against", "card.json"]
    (tmp_path / "card.json").write_text(json.dumps(stated("ekf")))
    done = invoke(["score", "ekf", *arguments], tmp_path)
    assert done.returncode == 0, done.stderr
    assert "1 question compared, none significantly worse." in done.stdout


@pytest.mark.parametrize("output", [[], ["-o", "mine"]])
def test_the_card_to_compare_with_is_not_written_over(output, tmp_path):
    """Nothing is flown, whatever way the path is written; the card of another folder is read."""
    written = tmp_path / (output[1] if output else "results/score/ekf")
    written.mkdir(parents=True)
    (written / "card.json").write_text("{}")
    (tmp_path / "link.json").symlink_to(written / "card.json")
    shutil.copy(written / "card.json", tmp_path / "copy.json")
    for before in (written.relative_to(tmp_path) / "card.json", written / "card.json", "link.json"):
        done = invoke(["score", "ekf", "--quick", "--against", str(before), *output], tmp_path)
        assert done.returncode == 2
        assert f"--against {before} is the card that this command overwrites" in done.stderr
        assert "copy it first" in done.stderr and "another folder with -o" in done.stderr
        assert [path.name for path in written.iterdir()] == ["card.json"]
    other = [str(written / "card.json"), "-o", "other"]
    for allowed in (["copy.json", *output], other):
        done = invoke(["score", "ekf", "--quick", "--against", *allowed], tmp_path)
        assert done.returncode == 2
        assert f"{allowed[0]} is no card" in done.stderr
