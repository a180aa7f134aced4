"""The table of models over time: means of planted weights, in words."""

from __future__ import annotations

from pathlib import Path

import pytest
from campaigns import ran, small

from ggbench.cli.run_view import info_text
from ggbench.engines.model_words import weights_of
from ggbench.estimators.multiple_model import MultipleModel
from ggbench.report.models_over_time import over_time
from ggbench.report.reported import Reported


def test_words_with_commas_are_one_model():
    """A hypothesis may have two parts."""
    text = "constant errors of 30 E, map errors of 5 E over 1 km 61 %, as assumed 39 %"
    assert weights_of(text) == {
        "constant errors of 30 E, map errors of 5 E over 1 km": 0.61,
        "as assumed": 0.39,
    }
    assert weights_of("nothing in particular") == {}


def test_weights_are_means_over_the_runs():
    """A run that does not name a model counts with zero; small means are not named."""
    infos = [
        {"at_60_s": "as assumed 70 %, outliers 30 %", "map_evaluations": 3},
        {"at_60_s": "noise 3.2 times as assumed 96 %", "at_120_s": "outliers 8 %"},
        {"at_60_s": 4.0, "elsewhere": "outliers 99 %"},
        {"at_120_s": "nothing in particular"},
    ]
    table = over_time(infos)
    assert table["time_s"].tolist() == [60, 120]
    assert table["models"].tolist() == [
        "noise 3.2 times as assumed 48 %, as assumed 35 %, outliers 15 %",
        "many, none above 5 %",
    ]
    assert over_time([{"iterations": 3}]).empty


def test_every_model_of_the_bank_is_read_back():
    """Its words and its share; and ``ggbench show`` cuts none of three."""
    words = [hypothesis.words for hypothesis in MultipleModel().hypotheses]
    for text in words:
        assert weights_of(f"{text} 48 %, as assumed 7 %")[text] == 0.48 or text == "as assumed"
    longest = sorted(words, key=len)[-3:]
    line = ", ".join(f"{text} 33 %" for text in longest)
    assert line in info_text({"at_60_s": line})


@pytest.mark.long
def test_a_report_has_the_models_of_a_campaign(tmp_path: Path):
    """By the name that the HTML page shows, and as a CSV file; of estimators with such texts."""
    ran(tmp_path, labels=("ins", "ekf"), runs=2, scenario=small(tmp_path)).store.close()
    reported = Reported(tmp_path / "out")
    assert "models" not in reported.further_tables()
    for (_, estimator), infos in reported.infos.items():
        assert len(infos) == 2
        if estimator == "ekf":
            infos[:] = [{"at_60_s": "as assumed 90 %"}, {"at_60_s": "outliers 80 %"}]
    table = reported.further_tables()["models"]
    assert set(table["estimator"]) == {"ekf"} and set(table["time_s"]) == {60}
    assert set(table["models"]) == {"as assumed 45 %, outliers 40 %"}
    reported.write_data(tmp_path / "data")
    assert "as assumed 45 %" in (tmp_path / "data/models.csv").read_text()
