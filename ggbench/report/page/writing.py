"""Writing a page: the text of a report, its figures to switch, what words mean, in one file."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from ...estimator_spec import EstimatorSpec
from ...files import written_whole
from . import libraries
from .charts import HINT, Chart
from .libraries import PageError
from .prose import Prose

MOST_BYTES = 5_000_000
"""Size of a page at most."""
_MOST_OF_PICTURES = 2_000_000
"""Characters of embedded pictures at most; what comes later is left to the report's folder."""
_ROOM = Path(__file__).parent


def write(
    path: Path, text: str, pictures: Path, charts: Mapping[str, Chart],
    estimators: Mapping[str, str], more: Sequence[Chart] = (),
) -> Path:  # fmt: skip
    """Write the page of a report.

    Parameters
    ----------
    path : of the file.
    text : the report, as markdown.
    pictures : folder to which its addresses of pictures belong.
    charts : address of a picture in the report to the figure that stands in its place.
    more : figures that replace none; they stand behind the answer.
    estimators : name to what is said of each that is named in tables.

    Returns
    -------
    ``path``.

    Raises
    ------
    PageError
        If a package is missing, the file cannot be written or would be larger than
        :data:`MOST_BYTES`.
    """
    content = _page(text, pictures, charts, estimators, more).encode()
    if len(content) > MOST_BYTES:
        raise PageError(
            f"{path} would have {len(content) / 1e6:.1f} MB, more than the {MOST_BYTES / 1e6:g} MB "
            "of a page; report fewer cases or estimators"
        )
    with written_whole(path, PageError) as temporary:
        temporary.write_bytes(content)
    return path


def said_of(
    estimators: Mapping[str, Mapping[str, Any]], described: Mapping[str, str]
) -> dict[str, str]:
    """Return what a page says of estimators: what each is, and its parameters.

    Parameters
    ----------
    estimators : name to what was run, as a manifest has it.
    described : name of an estimator, without parameters, to what it is.
    """
    said = {}
    for label, content in estimators.items():
        words = described.get(EstimatorSpec.parse(label).name, content.get("class", ""))
        settings = ", ".join(f"{key} = {value}" for key, value in content["parameters"].items())
        said[label] = f"{words} Parameters: {settings or 'none'}."
    return said


def _page(
    text: str, pictures: Path, charts: Mapping[str, Chart], estimators: Mapping[str, str],
    more: Sequence[Chart],
) -> str:  # fmt: skip
    shown: list[Chart] = []
    spent = 0

    def picture(source: str, words: str, caption: str) -> str:
        nonlocal spent
        if source in charts:
            shown.append(charts[source])
            return _chart(charts[source])
        content = libraries.picture(pictures / unquote(source))
        spent += len(content)
        if spent > _MOST_OF_PICTURES:
            return f"<p>{caption} <em>(a picture of the report that is not on this page)</em></p>"
        return _figure(f'<img src="{content}" alt="{html.escape(words)}">', caption)

    ids = {name: f"est-{number}" for number, name in enumerate(estimators)}
    prose = Prose(picture, ids)
    blocks = prose.blocks(text)
    sections = [k for k, block in enumerate(blocks) if block.startswith("<h2")] + [len(blocks)] * 2
    # The answer is the paragraph behind the title, or the first section.
    opening, first = (1, sections[1]) if sections[0] == 1 else (2, sections[0])
    added = [_chart(chart) for chart in more]
    introduction, defined = prose.definitions()
    return _rendered(
        title=text.partition("\n")[0].removeprefix("# "),
        opening="\n".join(blocks[:opening]),
        body="\n".join([*blocks[opening:first], *added, *blocks[first:]]),
        contents=[*prose.contents, ("definitions", "Definitions")],
        introduction=introduction,
        definitions=defined,
        estimators=[(ids[name], name, words) for name, words in estimators.items()],
        charts=[*shown, *more],
    )


def _rendered(**parts: Any) -> str:
    jinja2 = libraries.package("jinja2")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    # Text as it is, whatever letters: the file is UTF-8 throughout.
    environment.policies["json.dumps_kwargs"] = {
        "ensure_ascii": False, "separators": (",", ":"), "allow_nan": False,
    }  # fmt: skip
    table_script, table_style = libraries.datatables()
    scripts = libraries.vega(), (_ROOM / "page.js").read_text(encoding="utf-8")
    allowed = " ".join(libraries.script_hash(script) for script in scripts)
    policy = (
        f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
        f"script-src {allowed} 'unsafe-eval' blob:"
    )
    template = environment.from_string((_ROOM / "page.html").read_text(encoding="utf-8"))
    return str(
        template.render(
            parts,
            policy=policy,
            style=(_ROOM / "page.css").read_text(encoding="utf-8"),
            table_style=table_style,
            table_script=table_script,
            chart_script=scripts[0],
            script=scripts[1],
        )
    )


def _chart(chart: Chart) -> str:
    place = f'<div class="choice"></div><div class="chart" data-chart="chart-{chart.name}"></div>'
    return _figure(place, f'{html.escape(chart.caption)}. <span class="hint">{HINT}</span>')


def _figure(inside: str, caption: str) -> str:
    return f"<figure>{inside}<figcaption>{caption}</figcaption></figure>"
