"""A page of cards: only those that are flown again, and no code that a card names."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from command import invoke

from ggbench.campaign import registry
from ggbench.score import card as cards
from ggbench.score import cards_page, checked, scoring

CASES = ("air-narrow", "one-channel")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder with a card of ``ekf``, one of a file, and edited copies of both."""
    place = tmp_path_factory.mktemp("cards")
    assert invoke(["new", "estimator", "mine"], place).returncode == 0
    (place / "cards").mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        for label, name in (("ekf", "ekf"), ("mine.py", "mine")):
            found = scoring.score(label, place / name, 4, cases=CASES, jobs=0).card
            assert found is not None
            cards.write(found, place / "cards" / f"{name}.json")
    edited = json.loads((place / "cards" / "ekf.json").read_text())
    edited["questions"][0]["rms_m"] *= 0.5
    (place / "cards" / "edited.json").write_text(json.dumps(edited))
    return place


def checks(folder: Path, *estimators: str) -> dict[str, checked.CheckedCard]:
    allowed = registry.choose_all(estimators)
    (folder / "cards" / "manifest.json").write_text("{}")  # which 'ggbench score' writes, too
    paths = checked.files_of(folder / "cards")
    return {p.stem: checked.check(p, allowed, folder / "flights", jobs=0) for p in paths}


@pytest.mark.long
def test_a_card_is_believed_where_it_is_flown_again(folder, monkeypatch):
    """An edited one is refused with what differs; a file's needs to be named, and be the same."""
    monkeypatch.chdir(folder)
    found = checks(folder)
    assert found["ekf"].card is not None and not found["ekf"].reasons
    assert found["edited"].card is None
    assert found["edited"].reasons[0].startswith("air-narrow: rms_m was")
    assert "mine.py, which is not installed: give its file with -e" in found["mine"].reasons[0]
    named = checks(folder, "mine.py")["mine"]
    assert named.card is not None
    (folder / "other").mkdir(exist_ok=True)
    text = (folder / "mine.py").read_text(encoding="utf-8")
    (folder / "other" / "mine.py").write_text(f"{text}\n# changed\n", encoding="utf-8")
    other = checks(folder, "other/mine.py")["mine"]
    assert "mine.py has changed since the card was written" in other.reasons[0]


@pytest.mark.long
def test_the_page_has_the_figures_of_the_new_flights(folder, monkeypatch):
    """Numbers of the reproduced cards alone, as data of sortable tables; reasons of the others."""
    monkeypatch.chdir(folder)
    found = checks(folder, "mine.py")
    rows = cards_page.questions([*found.values()])
    assert sorted(set(rows["estimator"])) == ["ekf", "mine.py"]
    assert len(rows) == 4
    standing = cards_page.standings([*found.values()]).set_index("estimator")
    own = standing.loc["ekf"]
    assert own["as good as the EKF"] + own["undecided against the EKF"] == 2
    cards_page.write([*found.values()], folder / "page.html")
    text = (folder / "page.html").read_text(encoding="utf-8")
    data = json.loads(text.split('id="data">')[1].split("</script>")[0])
    assert set(data["tables"]) == {"standings", "questions"}
    assert data["columns"]["questions"]["form"] == "count"
    assert "2 cards. The runs of each card were repeated" in text
    assert "edited.json" in text and "rms_m was" in text


@pytest.mark.long
def test_the_command_writes_the_page_and_says_what_is_refused(folder):
    done = invoke(["cards", "cards", "-e", "mine.py", "-f", "flights", "-j", "0"], folder)
    assert done.returncode == 1, done.stderr
    assert "ekf.json: the check runs the code of ekf." in done.stdout
    assert "edited.json is not reproduced: air-narrow: rms_m was" in " ".join(done.stdout.split())
    assert "2 cards of 3 reproduced. Wrote cards.html." in done.stdout
    (folder / "good").mkdir(exist_ok=True)
    shutil.copy(folder / "cards" / "ekf.json", folder / "good" / "ekf.json")
    assert invoke(["cards", "good", "-f", "flights", "-j", "0"], folder).returncode == 0


def test_a_folder_without_cards_is_refused(tmp_path):
    """So is a page of another suffix."""
    for arguments, said in (
        (["cards", "."], "holds no cards"),
        (["cards", ".", "-o", "a.txt"], "must be named *.html"),
    ):
        done = invoke(arguments, tmp_path)
        assert (done.returncode, said in done.stderr) == (2, True), done.stderr
