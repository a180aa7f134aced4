"""Choosing an estimator: by name or by file, with parameters, and every mistake with a sentence."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from problems import estimator, kalman, linear_problem, rng
from refusals import refused

from ggbench.campaign import registry
from ggbench.campaign.registry import EstimatorError, choose
from ggbench.errors import GGBenchError
from ggbench.parameters import parameters_of
from ggbench.problem import Estimator

OWN = '''
"""A file of one's own, as short as an estimator can be."""

from dataclasses import dataclass

import numpy as np

from ggbench.problem import Estimate, Estimator


@dataclass(frozen=True)
class InformationFilter(Estimator):
    """Kalman filter by information matrices."""

    inflation: float = 1.0

    name = "information"
    causality = "filter"

    def estimate(self, problem, rng):
        x, p = problem.prior_mean, problem.prior_cov
        means, covs = [], []
        for k in range(problem.epochs):
            phi = problem.transition[k]
            x, p = phi @ x, phi @ p @ phi.T + problem.process_cov[k]
            h = problem.model.jacobian(k, x)
            r = self.inflation * problem.noise_cov
            p = np.linalg.inv(np.linalg.inv(p) + h.T @ np.linalg.solve(r, h))
            residual = problem.measurements[k] - problem.model.predict(k, x)
            x = x + p @ h.T @ np.linalg.solve(r, residual)
            means.append(x)
            covs.append(p)
        return Estimate(np.array(means), np.array(covs), self.causality)
'''


@pytest.fixture
def own(tmp_path: Path) -> Path:
    path = tmp_path / "information.py"
    path.write_text(OWN)
    return path


def test_the_estimators_of_the_benchmark_are_registered():
    """The four estimators are found by name through entry points, by anyone's package alike."""
    found = registry.registered()
    assert {"ins", "ekf", "ukf", "factor-graph"} <= set(found)
    for name, cls in found.items():
        assert issubclass(cls, Estimator)
        assert cls.name == name
        assert dataclasses.is_dataclass(cls)
        cls()  # every parameter has a default
        assert (cls.__doc__ or "").strip()


def test_an_entry_point_that_cannot_be_imported_is_named(monkeypatch):
    """Another package's broken estimator is an error that names it, and stops no other one."""
    broken = importlib.metadata.EntryPoint("broken", "no_such_module:Thing", registry.GROUP)
    whole = importlib.metadata.EntryPoint("ins", "ggbench.estimators.ins:InertialOnly", "")
    monkeypatch.setattr(registry, "estimator_points", lambda: {"broken": broken, "ins": whole})
    said = r"'broken' \(no_such_module:Thing\) cannot be imported"
    for look in (lambda: choose("broken"), registry.registered):
        with pytest.raises(EstimatorError, match=said):
            look()
    assert choose("ins").label == "ins"


@pytest.mark.parametrize(
    ("text", "label", "parameters", "values"),
    [
        ("ekf", "ekf", "", {}),
        ("  ekf ", "ekf", "", {}),
        ("ekf[]", "ekf", "", {}),
        ("ukf[points=merwe]", "ukf[points=merwe]", "points=merwe", {"points": "merwe"}),
        (
            "ukf[ points = merwe , alpha=0.25]",
            "ukf[points=merwe,alpha=0.25]",
            "points=merwe,alpha=0.25",
            {"points": "merwe", "alpha": 0.25, "beta": 2.0},
        ),
        ("ukf[kappa=-12]", "ukf[kappa=-12]", "kappa=-12", {"kappa": -12.0, "points": "julier"}),
        (
            "factor-graph[mode=fixed-lag,lag=5,max_iterations=7]",
            "factor-graph[mode=fixed-lag,lag=5,max_iterations=7]",
            "mode=fixed-lag,lag=5,max_iterations=7",
            {"mode": "fixed-lag", "lag": 5.0, "max_iterations": 7},
        ),
    ],
)
def test_parameters_are_read(text, label, parameters, values):
    """NAME[parameter=value,...] sets what it says and leaves the rest; its label is canonical."""
    choice = choose(text)
    assert (choice.label, choice.spec.listed) == (label, parameters)
    for key, value in values.items():
        assert getattr(choice.estimator, key) == value
        assert type(getattr(choice.estimator, key)) is type(value)
    assert choose(choice.label).estimator == choice.estimator


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "'' does not name an estimator; write NAME or NAME"),
        ("[x=1]", "does not name an estimator"),
        ("ekf[", r"'ekf\[' does not name an estimator"),
        ("ekf]x[", "does not name an estimator"),
        ("ukf[points=merwe]]", "does not name an estimator"),
        ("ekff", r"no estimator 'ekff' \(did you mean 'ekf'\?\); known: .*ekf.*ukf.*\.py file"),
        ("zzz", "no estimator 'zzz'; known: "),
        ("ekf[gain=1]", "ekf has no parameter 'gain'; its parameters: iterations, noise_"),
        ("ins[gain=1]", "ins has no parameter 'gain'; its parameters: noise_scale"),
        ("ukf[pionts=merwe]", "ukf has no parameter 'pionts'; its parameters: points, kappa, alph"),
        ("ukf[points]", "ukf: 'points' is not of the form parameter=value"),
        ("ukf[points=gauss]", r"'points' is 'gauss' and must be julier \| merwe"),
        ("ukf[points=]", r"'points' is '' and must be julier \| merwe"),
        ("ukf[kappa=big]", "ukf: parameter 'kappa' is 'big' and must be a number"),
        (
            "factor-graph[max_iterations=2.5]",
            "'max_iterations' is '2.5' and must be a whole number",
        ),
        ("ukf[alpha=1,alpha=2]", "ukf: parameter 'alpha' is given twice"),
    ],
)
def test_a_mistaken_choice_has_its_sentence(text, message):
    """An unknown name, parameter or value is one line that says what is allowed."""
    with refused(EstimatorError, message):
        choose(text)


def test_an_estimator_is_one_file(own):
    """A file with one class is an estimator: chosen by path, with parameters, and right.

    This is the example of how an estimator is added. It equals the Kalman filter.
    """
    choice = choose(str(own))
    problem = linear_problem(seed=6)
    mean, cov, _, _ = kalman(problem)
    estimate = choice.estimator.estimate(problem, rng())
    sigma = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    assert (np.abs(estimate.mean - mean) / sigma).max() < 1e-6
    assert choose(f"{own}[inflation=4]").estimator.inflation == 4.0
    assert choose(f"{own}[inflation=4]").spec.listed == "inflation=4"
    with pytest.raises(EstimatorError, match="has no parameter 'size'; its parameters: inflation"):
        choose(f"{own}[size=4]")


def test_a_file_is_found_by_relative_path(own, monkeypatch):
    """A path is relative to where the command is given."""
    monkeypatch.chdir(own.parent)
    assert choose("information.py").estimator.name == "information"
    monkeypatch.chdir(own.parent.parent)
    assert choose(f"{own.parent.name}/information.py").estimator.name == "information"


def test_files_of_one_name_do_not_collide(own, tmp_path):
    """Two files called alike are two estimators; the same file is imported once."""
    other = tmp_path / "elsewhere" / own.name
    other.parent.mkdir()
    other.write_text(OWN.replace('name = "information"', 'name = "other"'))
    assert choose(str(own)).estimator.name == "information"
    assert choose(str(other)).estimator.name == "other"
    assert type(choose(str(own)).estimator) is type(choose(str(own)).estimator)
    own.write_text(OWN.replace('name = "information"', 'name = "edited"'))
    assert choose(str(own)).estimator.name == "edited"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", r"defines 0 estimators; it must define exactly one class"),
        ("from ggbench.estimators.ekf import ExtendedKalmanFilter\n", "defines 0 estimators"),
        (OWN + OWN.replace("InformationFilter", "Second"), "defines 2 estimators"),
        (OWN.replace('    causality = "filter"\n', ""), "defines 0 estimators.*with causality and"),
        ("def f(:\n", "cannot be imported: SyntaxError: "),
        ("1 / 0\n", "cannot be imported: ZeroDivisionError: division by zero"),
        ("import no_such_module\n", "cannot be imported: ModuleNotFoundError: "),
    ],
    ids=["empty", "imported", "two", "abstract", "syntax", "raises", "imports"],
)
def test_a_file_that_is_no_estimator_has_its_sentence(content, message, tmp_path):
    """What a file lacks is said in one line that names it, and leaves nothing half imported."""
    path = tmp_path / "mine.py"
    path.write_text(content)
    before = set(sys.modules)
    with refused(EstimatorError, rf"^{re.escape(str(path))} {message}") as caught:
        choose(str(path))
    if "imported" in str(caught.value):
        assert not [name for name in set(sys.modules) - before if name.startswith("ggbench_user")]


def test_a_file_that_is_not_there_has_its_sentence(tmp_path):
    """A missing file and a folder are told apart from broken ones."""
    with pytest.raises(EstimatorError, match=r"cannot read estimator file .*gone.py: No such file"):
        choose(str(tmp_path / "gone.py"))
    (tmp_path / "folder.py").mkdir()
    with pytest.raises(EstimatorError, match=r"cannot read estimator file .*: Is a directory"):
        choose(str(tmp_path / "folder.py"))


UNUSABLE = {
    "required parameter": ("    inflation: float = 1.0\n", "    inflation: float\n"),
    "no name": ('    name = "information"\n', ""),
    "unknown causality": ('causality = "filter"', 'causality = "psychic"'),
    "fixed lag without a lag": ('causality = "filter"', 'causality = "fixed-lag"'),
    "a default beyond its limit": (
        "inflation: float = 1.0",
        "inflation: __import__('ggbench.parameters').parameters.Positive = -1.0",
    ),
}


@pytest.mark.parametrize("kind", UNUSABLE)
def test_a_class_that_breaks_the_interface_has_its_sentence(kind, tmp_path):
    """What the interface demands of a class is said when it is chosen, not in mid-run."""
    old, new = UNUSABLE[kind]
    path = tmp_path / "mine.py"
    path.write_text(OWN.replace(old, new))
    with pytest.raises(EstimatorError, match=re.escape(str(path))):
        choose(str(path))


def test_what_a_user_reads_of_a_parameter():
    """Types are shown as choices or plain names, beside their defaults."""
    parameters = parameters_of(type(estimator("ukf[points=merwe]")))
    assert parameters["points"].allowed() == "julier | merwe | cubature"
    assert parameters["alpha"].allowed() == "a finite number, more than 0"
    assert parameters["kappa"].allowed() == "a number"
    assert parameters["alpha"].default == 0.5


@pytest.mark.parametrize("text", ["ukf", "ukf[points=merwe]", "ekf[iterations=3,loss=huber]"])
def test_the_text_of_an_estimator_names_what_is_not_default(text):
    """An instance is named as a user would name it, without its defaults."""
    assert str(registry.spec_of(choose(text).estimator)) == text


def test_a_source_is_the_file_with_what_it_imports_from_beside_it(monkeypatch):
    """Of the losses that estimators share every change counts, for those that have losses."""

    def sources() -> dict[str, str]:
        return {
            name: registry.source_of.__wrapped__(type(choose(name).estimator))
            for name in ("ekf", "ukf", "gauss-newton", "ins")
        }

    before, read = sources(), Path.read_bytes
    monkeypatch.setattr(
        Path,
        "read_bytes",
        lambda path: read(path) + (b"\nCHANGED = True\n" if path.name == "robust.py" else b""),
    )
    after = sources()
    assert {name for name, source in before.items() if after[name] != source} == {
        "ekf",
        "ukf",
        "gauss-newton",
    }


def test_of_two_texts_of_one_content_the_first_is_chosen():
    """A default that is spelt out is no other estimator."""
    texts = ["ukf", "ekf", "ukf[points=julier]", "ukf[points=merwe]"]
    labels = [choice.label for choice in registry.choose_all(texts)]
    assert labels == ["ukf", "ekf", "ukf[points=merwe]"]


def test_a_roster_stands_for_its_estimators():
    """Each once, under its own name; an unknown one is a sentence with those that exist."""
    labels = [choice.label for choice in registry.choose_all(["@core", "ekf"])]
    assert "gaussian-sum" in labels and labels.count("ekf") == 1
    with pytest.raises(EstimatorError, match="no roster '@cores'; rosters: @standard"):
        registry.choose_all(["@cores"])


def test_docstrings_and_comments_of_an_installed_module_do_not_enter_its_hash():
    """A page that is written anew leaves all stored runs valid; a number that changes does not."""
    source = (
        b'"""A filter."""\nA = 1\n"""One."""\n'
        b'def gain(p):\n    """Return it."""\n    return 2.0 * p\n'
    )
    same = b'"""The filter."""\n\nA = 1\n\ndef gain(p):\n    return 2.0 * p  # twice\n'
    other = source.replace(b"2.0", b"2.5")
    assert registry.code_of(source) == registry.code_of(same) != registry.code_of(other)
    assert registry.code_of(b"\x7fELF\x00") == b"\x7fELF\x00"


def test_a_folder_here_does_not_hide_an_installed_estimator(tmp_path, monkeypatch):
    """As the folder of its results; a folder of another name is one of estimates."""
    monkeypatch.chdir(tmp_path)
    for name in ("ekf", "mine"):
        (tmp_path / name).mkdir()
    assert choose("ekf").estimator.name == "ekf"
    with pytest.raises(GGBenchError, match="mine contains no estimates"):
        choose("mine")
