"""Jinja templates of pages, with filters that format numbers."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import jinja2

from ..figures.numbers import counted, span
from . import columns, tables
from .columns import TEMPLATES

PAGE_VERSION = 3
"""Version of the page layout, in the first line of each page."""


def environment(html: bool = False, templates: Path = TEMPLATES) -> jinja2.Environment:
    """Return the Jinja environment of a template folder, with filters that format numbers."""
    templating = jinja2.Environment(
        loader=jinja2.FileSystemLoader(templates),
        autoescape=html,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templating.filters |= {
        "metres": columns.metres,
        "ratio": columns.ratio,
        "efficiency": columns.efficiency,
        "share": columns.share,
        "table": tables.text,
        "code": tables.code,
        "plain": tables.plain,
    }
    templating.globals |= {
        "cell": columns.cell,
        "names": tables.names,
        "counted": counted,
        "span": span,
        "success_shown": tables.SUCCESS_SHOWN,
        "page_version": PAGE_VERSION,
    }
    return templating


def style() -> str:
    """Return the style sheet of HTML pages."""
    return (TEMPLATES / "page.css").read_text(encoding="utf-8")


def html(template: str, **values: Any) -> str:
    """Return an HTML page rendered from a template, with the style sheet as value ``style``."""
    return environment(html=True).get_template(template).render(style=style(), **values)


def markdown(template: str, templates: Path = TEMPLATES, **values: Any) -> str:
    """Return a markdown page rendered from a template, without repeated empty lines."""
    text = environment(templates=templates).get_template(template).render(values)
    return re.sub(r"\n{3,}", "\n\n", text).strip() + "\n"
