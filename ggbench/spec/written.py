"""Writer of scenario files from cases in Python."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from .case import CaseSpec
from .scenario import Scenario, from_text


def of_cases(
    cases: Sequence[CaseSpec], title: str = "Cases made in Python", name: str = "python"
) -> Scenario:
    """Return a scenario that consists of some cases.

    The result equals the scenario that is read from the text of :func:`text_of`.

    Parameters
    ----------
    cases : cases with different names.
    title : title of the scenario.
    name : name of the scenario.

    Raises
    ------
    ScenarioError
        If two cases have the same name, or a case breaks a rule.
    """
    return from_text(text_of(cases, title), name, "")


def text_of(cases: Sequence[CaseSpec], title: str) -> str:
    """Return the text of a scenario file with these cases."""
    lines = [f"title = {_value(title)}", f"description = {_value(title + '.')}"]
    for case in cases:
        lines += ["", "[[case]]"]
        content = case.model_dump(exclude_none=True, warnings=False)
        lines += [f"{key} = {_value(value)}" for key, value in content.items()]
    return "\n".join(lines) + "\n"


def _value(value: Any) -> str:
    """Return a value as TOML text, with inline tables."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        pairs = ", ".join(f"{_value(str(key))} = {_value(item)}" for key, item in value.items())
        return f"{{ {pairs} }}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"[{', '.join(map(_value, value))}]"
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)
