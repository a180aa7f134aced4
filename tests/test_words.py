"""Texts for users avoid the words of a list; scenario notes and pages are short."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path

import pytest
from doc_blocks import documents
from findings_by_file import findings_by_file

ROOT = Path(__file__).parent.parent
SCENARIOS = ROOT / "scenarios"
NOTES = sorted(SCENARIOS.glob("*_notes.md"))
TOML = [path for path in sorted(SCENARIOS.glob("*.toml")) if path.stem != "rosters"]
TEMPLATES = [
    *sorted((ROOT / "ggbench" / "report" / "templates").glob("*.j2")),
    *sorted((ROOT / "ggbench" / "cli" / "templates").glob("*.txt")),
    *sorted((ROOT / "benchmarks").rglob("*.j2")),
    *sorted((ROOT / "studies").rglob("*.j2")),
]
DATA = sorted((SCENARIOS / "data").rglob("README.md"))
CHANGELOG = ROOT / "CHANGELOG.md"
MEASURES = ("speed", "frameworks", "matching_area", "recorded_drive")
MEASURED = [ROOT / "reports" / f"{name}.md" for name in MEASURES]
"""Pages of benchmarks and studies."""
SCANNED = [
    *documents(ROOT),
    CHANGELOG,
    ROOT / "CONTRIBUTING.md",
    *NOTES,
    *DATA,
    *TEMPLATES,
    *MEASURED,
]

INSTEAD = {
    r"(?:dis)?honest\w*": "consistent",
    "nobody": "no estimator",
    "anew": "again",
    "beside": "compared with, as well as",
    "told": "modelled, assumed",
    "parted": "separated",
    "what is had": "what is",
    "of who": "for estimators with",
}
"""Words that texts for users avoid, and what they say instead."""
HEADINGS = ["Set-up", "Limits", "Why"], ["Set-up", "Limits"]
"""Headings of the notes of a scenario; reasons are left out where they are obvious."""
_AVOIDED = re.compile(rf"(?<![\w-])(?:{'|'.join(INSTEAD)})(?![\w-])", re.IGNORECASE)
_FENCED = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
_LITERAL = re.compile(r"`[^`\n]*`|\]\([^)]*\)")
"""Code and links: names may contain any word."""
_PARAGRAPH = re.compile(r"\n\s*\n|\n(?=- |\|)")
_SENTENCE_END = re.compile(r"(?<=[.!?])\s+(?=[A-ZΓσ`\d])")


def avoided(text: str) -> list[str]:
    """Return the words of the list that a text contains outside of code and links."""
    return _AVOIDED.findall(_LITERAL.sub("", _FENCED.sub("", text)))


def long_sentences(text: str, most: int) -> list[str]:
    """Return the sentences of a text with more words than ``most``."""
    blocks = _PARAGRAPH.split(_FENCED.sub("", text))
    sentences = [part for block in blocks for part in _SENTENCE_END.split(block.strip())]
    return [sentence for sentence in sentences if len(sentence.split()) > most]


def sections(notes: str) -> dict[str, str]:
    """Return the text of each section by its heading."""
    parts = re.split(r"^## (.*)\n", notes, flags=re.MULTILINE)
    assert parts[0] == "", "notes begin with a heading"
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def unfit_notes(notes: str) -> list[str]:
    """Return the reasons for which the notes of a scenario are too long or of another form."""
    found = sections(notes)
    reasons = [] if list(found) in HEADINGS else [f"headings: {list(found)}"]
    reasons += [f"long: {sentence}" for sentence in long_sentences(notes, 30)]
    sizes = {"Set-up": 80, "Why": 80}
    reasons += [
        f"{name}: over {most} words"
        for name, most in sizes.items()
        if len(found.get(name, "").split()) > most
    ]
    if len(notes.split()) > 200:
        reasons.append("over 200 words")
    if len(re.findall(r"^- ", found.get("Limits", ""), re.MULTILINE)) > 3:
        reasons.append("Limits: over three")
    return reasons


def unfit_page(text: str) -> list[str]:
    """Return the reasons for which a page of measurements is too long or of another form."""
    reasons = [f"long: {sentence}" for sentence in long_sentences(text, 25)]
    answer = re.search(r"^\*\*Answer\.\*\* (.*)$", text, re.MULTILINE)
    if answer is None or len(answer[1].split()) > 60:
        reasons.append("no answer of at most 60 words")
    if len(text.split()) > 450:
        reasons.append("over 450 words")
    if len(re.findall(r"^!\[", text, re.MULTILINE)) != 1:
        reasons.append("not one figure")
    return reasons


@pytest.mark.parametrize("path", SCANNED, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_text_avoids_the_words_of_the_list(path: Path) -> None:
    assert avoided(path.read_text(encoding="utf-8")) == [], INSTEAD


@pytest.mark.parametrize("path", NOTES, ids=lambda path: path.stem)
def test_notes_of_a_scenario_are_short(path: Path) -> None:
    assert unfit_notes(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("path", TOML, ids=lambda path: path.stem)
def test_titles_and_descriptions_are_short(path: Path) -> None:
    """Titles of cases: at most eight words, numbers left out."""
    document = tomllib.loads(path.read_text(encoding="utf-8"))
    changes = [*document.get("case", []), *document.get("assumption", [])]
    titles = [change["title"] for change in changes]
    claims = [claim["title"] for key in ("claim", "comparison") for claim in document.get(key, [])]
    assert avoided("\n".join([document["title"], document["description"], *titles, *claims])) == []
    assert len(document["title"].split()) <= 12
    assert len(document["description"].split()) <= 60
    assert [title for title in titles if len(re.sub(r"[\d.]+ ", "", title).split()) > 8] == []
    assert len(set(titles)) == len(titles)


@pytest.mark.parametrize("path", MEASURED, ids=lambda path: path.stem)
def test_a_page_of_measurements_is_one_page(path: Path) -> None:
    assert unfit_page(path.read_text(encoding="utf-8")) == []


def test_the_changelog_is_short() -> None:
    assert len(CHANGELOG.read_text(encoding="utf-8").split()) <= 3000


def test_the_checks_find_what_they_look_for() -> None:
    """Negative controls: a planted word, sentence, heading and bullet are found."""
    text = "Nobody is honest. Closest is `lost`, [told](anew.md) so.\n```sh\nlost\n```\n"
    assert avoided(text) == ["Nobody", "honest", "told"]
    assert avoided("Untold, losing, 5E-told-50E, besides, partly.") == []
    assert long_sentences("One two three. Four five.\n\n- Six\n- Seven eight nine.", 2) == [
        "One two three.",
        "- Seven eight nine.",
    ]
    page = "**Answer.** Yes.\n\n![a](b.png)\n"
    assert unfit_page(page) == []
    assert unfit_page(page.replace("Yes", 61 * "yes ")) != []
    assert unfit_page(page + 450 * "Word. ") == ["over 450 words"]
    assert unfit_page(page + "\n![c](d.png)\n") == ["not one figure"]
    fit = "## Set-up\n\nA flight.\n\n## Limits\n\n- One.\n"
    assert unfit_notes(fit) == []
    assert unfit_notes(fit.replace("Limits", "Bounds")) != []
    assert unfit_notes(fit + "- Two.\n- Three.\n- Four.\n") == ["Limits: over three"]
    assert unfit_notes(fit.replace("A flight.", "A flight. " * 41)) == ["Set-up: over 80 words"]
    assert unfit_notes(fit + "\n## Why\n\n" + 31 * "so " + "\n")[0].startswith("long: so")


def docstrings(source: str) -> str:
    """Return the docstrings of a file, those of attributes among them."""
    found = []
    for node in ast.walk(ast.parse(source)):
        body = getattr(node, "body", None)
        for child in body if isinstance(body, list) else []:
            if isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant):
                found.append(str(child.value.value))
    return "\n\n".join(found)


@pytest.mark.parametrize("room", ["ggbench", "estimators", "scenarios"])
def test_docstrings_avoid_the_words(room):
    files = sorted((ROOT / room).rglob("*.py"))
    assert files
    assert findings_by_file(files, lambda source: avoided(docstrings(source))) == {}


def test_a_docstring_with_such_a_word_is_found():
    """A negative control: of a module, a function and an attribute; names in code are not."""
    source = '"""Made anew."""\n\nlost = 1\n"""Nobody."""\n\ndef f(told):\n    """Told `lost`."""\n'
    assert avoided(docstrings(source)) == ["anew", "Nobody", "Told"]


EVERYDAY = {
    "found",
    "told",
    "said",
    "taken",
    "here",
    "begun",
    "given",
    "made",
    "kept",
    "held",
    "asked",
    "wanted",
    "seen",
    "gone",
}
"""Local names that say nothing of a variable's content."""
COMPILED = {"compiled", "copied", "inlined"}
"""Decorators of compiled functions, whose names are not checked: each edit compiles anew."""
KERNELS = ("engines", "ins", "numerics", "sensors")
"""Rooms whose modules are compiled, neither."""
PAGES = {"findings.py"}
"""Texts of a page about one study, neither."""


def everyday_names(source: str) -> list[str]:
    """Return the local variables and arguments of a file with names of the list."""
    return [
        f"{name}, line {node.lineno}"
        for function in ast.walk(ast.parse(source))
        if isinstance(function, ast.FunctionDef)
        and COMPILED.isdisjoint(ast.unparse(decorator) for decorator in function.decorator_list)
        for node in ast.walk(function)
        for name in [node.arg if isinstance(node, ast.arg) else getattr(node, "id", "")]
        if name in EVERYDAY
        and (isinstance(node, ast.arg) or isinstance(getattr(node, "ctx", None), ast.Store))
    ]


@pytest.mark.long
def test_local_names_are_nouns_of_the_field():
    """A variable is an innovation, a residual or candidates, and not what was found."""
    package = ROOT / "ggbench"
    files = [
        path
        for path in sorted(package.rglob("*.py"))
        if path.relative_to(package).parts[0] not in KERNELS and path.name not in PAGES
    ]
    assert len(files) > 200
    assert findings_by_file(files, everyday_names) == {}


def test_an_everyday_name_is_found():
    """A negative control: arguments and variables count; attributes, uses, kernels do not."""
    source = (
        "class A:\n    kept: int\n\n\ndef f(told, mean):\n    for found in mean:\n"
        "        mean.found = found\n    return [said for said in told], lambda here: mean\n"
        "\n\n@compiled\ndef k(kept):\n    return kept\n"
    )
    assert everyday_names(source) == [
        "told, line 5",
        "found, line 6",
        "said, line 8",
        "here, line 8",
    ]


MODULES = [
    path for room in ("ggbench", "estimators") for path in sorted((ROOT / room).rglob("*.py"))
]
_CLAUSE = re.compile(r"\b(?:what|who|how|which|whether|where|whose|nobody)\b", re.IGNORECASE)


def riddles(source: str) -> list[str]:
    """Return the first line of a module's docstring if it is missing or no noun phrase."""
    lines = (ast.get_docstring(ast.parse(source)) or "").splitlines()
    first = lines[0] if lines else ""
    return [] if first.endswith(".") and not _CLAUSE.search(first) else [first or "no docstring"]


def test_the_first_line_of_a_module_is_a_noun_phrase():
    assert findings_by_file(MODULES, riddles) == {}


def test_a_first_line_with_a_clause_is_found():
    assert riddles('"""What a run leaves."""') == ["What a run leaves."]
    assert riddles('"""A filter: which is which."""') == ["A filter: which is which."]
    assert riddles("x = 1") == ["no docstring"]
    assert riddles('"""Gaussian-sum filter, compiled."""') == []
