"""Reader of scenario files (TOML), with validation and the provenance of values.

A scenario file describes one flight, its instruments and the prior. *Cases* are changes to compare,
optionally with published numbers. *Assumptions* are changes, too. A report shows their influence on
the results. A *sweep* is a grid of changes of every case. A value is written plainly, or with its
source as ``{ value = 33.5, provenance = "paper: Table 1" }``.
"""

from __future__ import annotations

import hashlib
import importlib.resources
import itertools
import json
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from html import escape
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, TypeVar

from ..trajectory.terrain_following import terrain_path as shipped_or_own
from . import rosters
from . import sweep as sweep
from .axes import MOST_POINTS, SweepSpec
from .campaign import CampaignSpec
from .case import CaseSpec
from .claims import ClaimSpec, ComparisonSpec
from .limits import SCENARIO_NAME
from .merging import laid_over
from .sweep import Sweep
from .toml_files import read_text, read_toml, strip_provenance
from .validation_messages import ScenarioError as ScenarioError
from .validation_messages import suggest, validate

C = TypeVar("C", ClaimSpec, ComparisonSpec)
_MOST_NAMED = 20
"""Most cases that a message lists."""


@dataclass(frozen=True)
class Assumption:
    """A change of the scenario that is applied to every case with published numbers."""

    name: str
    title: str
    cases: tuple[CaseSpec, ...]


@dataclass(frozen=True)
class Scenario:
    """A validated scenario file.

    Attributes
    ----------
    name, title, description : name (the stem of the file's name), title and description.
    cases : cases in the order of the file; with a sweep, the points of the grid.
    assumptions : assumptions with their cases.
    campaign : defaults of campaigns.
    provenance : source of each value, by dotted key.
    content_hash : SHA-256 of the parsed content of the file, without ``[campaign]``.
    source : text of the file.
    notes : markdown text that a report appends. The key ``notes`` of the scenario file names the
        file with this text. Without this key the text is empty.
    sweep : grid of the cases, if any.
    claims : published claims other than errors of position and velocity.
    comparisons : published claims about two estimators, without a number.
    argument : name or path from which the scenario was loaded; "" if it was made in Python.
    """

    name: str
    title: str
    description: str
    cases: tuple[CaseSpec, ...]
    assumptions: tuple[Assumption, ...]
    campaign: CampaignSpec
    provenance: Mapping[str, str] = field(hash=False)
    content_hash: str
    source: str
    notes: str
    sweep: Sweep | None = None
    claims: tuple[ClaimSpec, ...] = ()
    comparisons: tuple[ComparisonSpec, ...] = ()
    argument: str = field(default="", compare=False)

    def __repr__(self) -> str:
        cases = "1 case" if len(self.cases) == 1 else f"{len(self.cases)} cases"
        return f"Scenario({self.name}: {self.title!r}, {cases})"

    def _repr_html_(self) -> str:
        cells = ((escape(case.name), escape(case.title)) for case in self.cases[:_MOST_NAMED])
        rows = "".join(f"<tr><td>{name}</td><td>{title}</td></tr>" for name, title in cells)
        return f"<p>{escape(repr(self))}</p><table>{rows}</table>"

    @cached_property
    def _named(self) -> dict[str, CaseSpec]:
        return {case.name: case for case in self.cases}

    def case(self, name: str) -> CaseSpec:
        """Return the case that has the name ``name``; cases of assumptions are not searched.

        Raises
        ------
        ScenarioError
            If the case does not exist; the message lists the cases.
        """
        if name not in self._named:
            raise self._no_case(name, list(self._named))
        return self._named[name]

    def every_case(self) -> Iterator[tuple[str, CaseSpec]]:
        """Yield (study, case) for the cases, then for the cases of the assumptions.

        The study is the name of an assumption, or "" for the cases themselves.
        """
        for case in self.cases:
            yield "", case
        for study in self.assumptions:
            for case in study.cases:
                yield study.name, case

    def find(self, name: str) -> tuple[str, CaseSpec]:
        """Return (study, case) for a name ``CASE`` or ``STUDY/CASE``.

        The study is the name of an assumption, or "" for the cases themselves. Raise ScenarioError
        if the name does not exist; the message lists all names.
        """
        cases = {
            f"{study}/{case.name}" if study else case.name: (study, case)
            for study, case in self.every_case()
        }
        if name not in cases:
            raise self._no_case(name, list(cases))
        return cases[name]

    def _no_case(self, name: str, names: list[str]) -> ScenarioError:
        more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
        return ScenarioError(
            f"{self.name} has no case '{name}'{suggest(str(name), names)}; its cases: "
            f"{', '.join(names[:_MOST_NAMED])}{more}"
        )

    def select(self, names: Sequence[str]) -> Scenario:
        """Return the scenario with only the named cases, in the order of the scenario.

        Raises
        ------
        ScenarioError
            If a name does not exist.
        """
        whole = replace(self, assumptions=())
        chosen = {whole.find(name)[1].name for name in names}
        return replace(self, cases=tuple(case for case in self.cases if case.name in chosen))


def shipped() -> list[str]:
    """Return the names of the scenarios shipped with the package."""
    folder = importlib.resources.files("ggbench.scenarios")
    files = (f.name for f in folder.iterdir() if f.name.endswith(".toml"))
    return sorted(name.removesuffix(".toml") for name in files if name != rosters.FILE)


def load(name_or_path: str | Path) -> Scenario:
    """Read a scenario, given by the name of a shipped scenario or by a path.

    Raises
    ------
    ScenarioError
        If the scenario is invalid; the message states the file, the key, the value and the allowed
        values.
    """
    named = str(name_or_path)
    path = Path(named)
    if named not in shipped():
        if path.suffix == ".toml" or path.exists():
            if not re.match(SCENARIO_NAME, path.stem):
                raise ScenarioError(
                    f"{path}: cannot be the name of a scenario; rename the file to one without "
                    "backslash and without a dot before '.toml'"
                )
            return replace(_read(path, path.stem, str(path)), argument=named)
        raise ScenarioError(
            f"there is no scenario '{named}'{suggest(named, shipped())}; "
            f"shipped scenarios: {', '.join(shipped())}; or give the path of a .toml file"
        )
    file = importlib.resources.files("ggbench.scenarios") / f"{named}.toml"
    return replace(_read(file, named, file.name), argument=named)


def from_text(source: str, name: str, notes: str) -> Scenario:
    """Return the scenario of a text, such as the copy of a scenario file in a results folder.

    The key ``notes`` of the text is ignored. The argument ``notes`` is the markdown text that a
    report appends.
    """
    origin = f"scenario.toml of {name}"
    document = read_toml(source, origin)
    document.pop("notes", None)
    return parse(document, name, origin, source, notes)


def as_written(scenario: Scenario) -> Scenario:
    """Return the scenario with all cases of its file, including cases that are not selected.

    Raises
    ------
    ScenarioError
        If the scenario was changed after reading, so that its text no longer describes it.
    """
    whole = from_text(scenario.source, scenario.name, scenario.notes)
    changed = [case.name for case in scenario.cases if case not in whole.cases]
    if changed:
        raise ScenarioError(
            f"case {changed[0]} of {scenario.name} differs from the scenario's file: write the "
            "change into a file, or use the changed case with simulate, estimate and judge"
        )
    if replace(scenario, cases=whole.cases) != whole:
        raise ScenarioError(
            f"the scenario {scenario.name} differs from its file: write the change into a file"
        )
    return replace(whole, argument=scenario.argument)


def checked(case: CaseSpec) -> CaseSpec:
    """Validate a case by the rules of scenario files, and return it.

    The case may have been changed in Python.

    Raises
    ------
    ScenarioError
        If the case breaks a rule, as in :func:`load`.
    """
    valid = validate(CaseSpec, case.model_dump(warnings=False), f"case '{case.name}'")
    return valid.with_seed(case.seed)


def _read(file: Traversable, name: str, origin: str) -> Scenario:
    """Read and validate a scenario file; ``origin`` names it in messages."""
    source = read_text(file, origin)
    document = read_toml(source, origin)
    notes_name = document.pop("notes", None)
    notes = ""
    if notes_name is not None:
        if not isinstance(notes_name, str) or Path(notes_name).name != notes_name:
            raise ScenarioError(f"{origin}: notes must name a file next to the scenario")
        folder = importlib.resources.files("ggbench.scenarios")
        beside = file.parent if isinstance(file, Path) else folder
        notes = read_text(beside / notes_name, f"{origin}: notes {notes_name}")
    return parse(document, name, origin, source, notes)


def parse(
    document: dict[str, Any], name: str, origin: str, source: str = "", notes: str = ""
) -> Scenario:
    """Validate the content of a scenario file and return the scenario.

    ``origin`` names the file in messages. Raise ScenarioError if the content breaks a rule.
    """
    provenance: dict[str, str] = {}
    document = strip_provenance(document, "", provenance, origin)
    # Who flies a scenario, and how often, is no part of it.
    content = {key: value for key, value in document.items() if key != "campaign"}
    content_hash = hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode())
    title = _take_text(document, "title", origin)
    description = _take_text(document, "description", origin)
    campaign = validate(CampaignSpec, document.pop("campaign", {}), f"{origin}: campaign")
    claimed = document.pop("claim", [])
    compared = document.pop("comparison", [])
    grid = document.pop("sweep", None)
    changes = _take_changes(document, "case", origin)
    studies = _take_changes(document, "assumption", origin)
    count = len(changes) * (1 + len(studies))
    if count > MOST_POINTS:
        repeated = f" × (1 + {len(studies)} assumptions) = {count}" if studies else ""
        raise ScenarioError(
            f"{origin}: has {len(changes)} cases{repeated}; at most {MOST_POINTS} are allowed"
        )
    laid_out = None
    if grid is not None:
        if studies:
            raise ScenarioError(
                f"{origin}: [[assumption]] cannot be given with [sweep]; make it an axis of the "
                "sweep, or a scenario of its own"
            )
        cases, laid_out = _spread(document, changes, grid, origin)
    elif changes:
        cases = tuple(_resolve(document, change, f"{origin}: case", {}) for change in changes)
    else:
        raise ScenarioError(f"{origin}: has no [[case]]; a scenario needs at least one")
    assumptions = tuple(_study(document, study, changes, origin) for study in studies)
    _check_unique("case", [case.name for case in cases], origin)
    _check_unique("assumption", [study.name for study in assumptions], origin)
    for case in itertools.chain(cases, *(study.cases for study in assumptions)):
        case.with_seed(campaign.seed)
    return Scenario(
        name=name,
        title=title,
        description=description,
        cases=cases,
        assumptions=assumptions,
        campaign=campaign,
        provenance=provenance,
        content_hash=content_hash.hexdigest(),
        source=source,
        notes=notes,
        sweep=laid_out,
        claims=_claims(ClaimSpec, "claim", claimed, cases, origin),
        comparisons=_comparisons(compared, cases, campaign, origin),
    )


def _claims(
    kind: type[C], key: str, tables: Any, cases: Sequence[CaseSpec], origin: str
) -> tuple[C, ...]:
    """Return the claims of a file; raise ScenarioError if the case of a claim does not exist."""
    if not isinstance(tables, list):
        raise ScenarioError(f"{origin}: {key} must be written as [[{key}]] tables")
    claims = []
    names = [case.name for case in cases]
    for number, table in enumerate(tables):
        claim = validate(kind, table, f"{origin}: {key}[{number}]")
        if claim.case not in names:
            raise ScenarioError(
                f"{origin}: {key}[{number}]: there is no case '{claim.case}'"
                f"{suggest(claim.case, names)}"
            )
        claims.append(claim)
    return tuple(claims)


def _comparisons(
    tables: Any, cases: Sequence[CaseSpec], campaign: CampaignSpec, origin: str
) -> tuple[ComparisonSpec, ...]:
    """Return the comparisons of a file.

    Raise ScenarioError if the campaign does not run one of the estimators, or a case does not
    exist.
    """
    comparisons = _claims(ComparisonSpec, "comparison", tables, cases, origin)
    run = list(campaign.estimators)
    for number, comparison in enumerate(comparisons):
        for value in comparison.values:
            for label in comparison.labels(value):
                if label not in run:
                    raise ScenarioError(
                        f"{origin}: comparison[{number}]: the campaign has no estimator '{label}'"
                        f"{suggest(label, run)}"
                    )
    return comparisons


def _check_unique(kind: str, names: list[str], origin: str) -> None:
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise ScenarioError(f"{origin}: {kind} '{twice[0]}' is defined twice")


def _spread(
    base: dict[str, Any], changes: list[dict[str, Any]], grid: Any, origin: str
) -> tuple[tuple[CaseSpec, ...], Sweep]:
    """Return the cases of a sweep, and its grid.

    The grid varies every case of the file. Without cases it varies the tables ``base``.
    """
    spec = validate(SweepSpec, grid, f"{origin}: sweep")
    titles, bases = {}, {}
    for number, change in enumerate(changes):
        label = f"{origin}: case[{number}]"
        # The published numbers of a case are not those of what the sweep makes of it.
        rest = {key: value for key, value in change.items() if key != "reference"}
        title, name = (_take_text(rest, key, label) for key in ("title", "name"))
        if name in bases:
            raise ScenarioError(f"{origin}: case '{name}' is defined twice")
        titles[name], bases[name] = title, rest
    points = math.prod(len(axis.values) for axis in spec.axis) * max(len(bases), 1)
    if points > MOST_POINTS:
        raise ScenarioError(
            f"{origin}: sweep: has {points} grid points; at most {MOST_POINTS} are allowed"
        )
    laid_out, cells = sweep.lay_out(spec, titles)
    cases = []
    for cell in cells:
        point = reduce(laid_over, cell.changes, laid_over(base, bases.get(cell.base, {})))
        named = point | {"name": cell.name, "title": cell.title}
        cases.append(_case(named, f"{origin}: sweep at {cell.title}"))
    return tuple(cases), laid_out


def _study(
    base: dict[str, Any], study: dict[str, Any], cases: list[dict[str, Any]], origin: str
) -> Assumption:
    """Return an assumption applied to every case that has published numbers."""
    name, title = study.get("name"), study.get("title")
    label = f"{origin}: assumption '{name}'"
    if not (isinstance(name, str) and isinstance(title, str) and name and title):
        raise ScenarioError(f"{label}: needs a name and a title")
    change = {key: value for key, value in study.items() if key not in ("name", "title")}
    studied = [case for case in cases if "reference" in case]
    return Assumption(
        name, title, tuple(_resolve(base, case, f"{label}, case", change) for case in studied)
    )


def _take_text(document: dict[str, Any], key: str, origin: str) -> str:
    text = document.pop(key, None)
    if not isinstance(text, str) or not text.strip():
        raise ScenarioError(f"{origin}: needs a text '{key}'")
    return text.strip()


def _take_changes(document: dict[str, Any], key: str, origin: str) -> list[dict[str, Any]]:
    changes = document.pop(key, [])
    if not isinstance(changes, list) or not all(isinstance(c, dict) for c in changes):
        raise ScenarioError(f"{origin}: '{key}' must be written as [[{key}]] tables")
    return changes


def _resolve(
    base: dict[str, Any], change: dict[str, Any], label: str, study: dict[str, Any]
) -> CaseSpec:
    case = laid_over(laid_over(base, change), study)
    return _case(case, f"{label} '{change.get('name', '?')}'")


def _case(tables: dict[str, Any], label: str) -> CaseSpec:
    flight = tables.get("trajectory")
    if isinstance(flight, Mapping) and isinstance(track := flight.get("file"), str) and track:
        # Tracks are found as terrains are: among the shipped data, or where their path says.
        tables = tables | {"trajectory": {**flight, "file": str(shipped_or_own(track))}}
    return validate(CaseSpec, tables, label)
