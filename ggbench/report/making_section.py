"""How a report was made: what to type to get it again, and of what it was made."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence

from ..results.folder import Results, as_argument


def making_section(results: Results) -> str:
    """Return the section as markdown: commands, versions, hashes of the data, the machine."""
    m = results.manifest
    versions = ", ".join(f"{name} {version}" for name, version in m["versions"].items())
    machine = m["machine"]
    labels, cases = tuple(m["estimators"]), m["cases"]
    flags = ""
    left_out = m.get("left_out", {})
    asked = tuple(k for k in results.scenario.campaign.estimators if k not in left_out)
    if labels != asked:
        flags += "".join(f" -e {shlex.quote(label)}" for label in labels)
    if cases != [case.name for case in results.whole_scenario.cases]:
        flags += "".join(f" -c {shlex.quote(name)}" for name in cases)
    flags += " --assumptions" if m["assumptions"] else ""
    memory = results.runs()["peak_memory_mb"].max()
    return "\n".join(
        [
            "Generated, not edited. To get it again:",
            "",
            "```",
            f"ggbench run {as_argument(m['argument'])} -n {m['runs']} --seed {m['seed']}"
            f"{flags} -o {shlex.quote('results/' + m['scenario'])}",
            f"ggbench report {shlex.quote('results/' + m['scenario'])} -o reports",
            "```",
            "",
            f"- ggbench {m['ggbench']}, results version {m['results_version']}, "
            f"scenario {m['scenario_hash'][:16]}, seed {m['seed']}, run on {m['date'][:10]}",
            *made_of(m.get("inputs", [])),
            f"- {versions}",
            f"- {machine['system']} on {machine['architecture']}, "
            f"{machine['processors']} processors; peak memory of a worker {memory:.0f} MB",
        ]
    )


def made_of(inputs: Sequence[Mapping[str, str]]) -> list[str]:
    """Return a line that names the data, and how the SHA-256 of each begins.

    Of each its ``role``, ``name`` and ``sha256``, as :func:`ggbench.campaign.inputs.input_files`
    has them; no line without any.
    """
    named = [f"{i['role']} `{_plain(i['name'])}` {i['sha256'][:16]}" for i in inputs]
    line = f"- data, each with the first 16 digits of its SHA-256: {'; '.join(named)}"
    return [line] if named else []


def _plain(name: str) -> str:
    """Return the name of a file, fit to stand in code."""
    return "".join(c if c.isprintable() and c != "`" else "?" for c in name)
