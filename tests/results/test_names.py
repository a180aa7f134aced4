"""Names of estimators in tables: without the engine, wherever that leaves them apart."""

from __future__ import annotations

import numpy as np
import pytest
from campaigns import ran

from ggbench.results.folder import Results
from ggbench.results.names import shown_names


@pytest.mark.parametrize(
    ("label", "name"),
    [
        ("ins", "ins"),
        ("ekf[engine=numba]", "ekf"),
        ("ekf[engine=numba,loss=huber]", "ekf[loss=huber]"),
        ("ekf[iterations=5,engine=numba,loss=huber]", "ekf[iterations=5,loss=huber]"),
        ("factor-graph[mode=batch,engine=gtsam]", "factor-graph[mode=batch]"),
        ("mine.py[my_engine=2]", "mine.py[my_engine=2]"),
    ],
)
def test_a_name_is_the_label_without_the_engine(label, name):
    assert shown_names([label]) == {label: name}


def test_two_engines_of_one_estimator_keep_their_labels():
    labels = ["ekf", "ekf[engine=numba]", "ukf[engine=numba]"]
    assert list(shown_names(labels).values()) == ["ekf", "ekf[engine=numba]", "ukf"]


def test_results_have_short_names_and_commands_whole_labels(tmp_path):
    """Asked for by either; what repeats a run has the engine that it had."""
    label = "ekf[engine=numba]"
    results: Results = ran(tmp_path, labels=("ins", label), runs=2)
    assert results.labels == ["ins", "ekf"]
    assert set(results.summary()["label"]) == {"ins", "ekf"}
    assert results.estimators["ekf"]["parameters"]["engine"] == "numba"
    case = results.manifest["cases"][0]
    np.testing.assert_array_equal(results.series(case, label), results.series(case, "ekf"))
    assert len(results.series(case, "ekf")) == 2
    commands = results.runs().set_index("estimator").loc["ekf", "command"]
    assert all("-e 'ekf[engine=numba]' " in command for command in commands)
