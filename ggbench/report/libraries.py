"""Packages of the pip extra ``page``, and scripts that HTML pages embed."""

from __future__ import annotations

import base64
import hashlib
import importlib
import importlib.util
from functools import cache
from pathlib import Path
from typing import Any

from ..errors import GGBenchError

_PACKAGES = ("itables", "markdown_it")


class PageError(GGBenchError):
    """An HTML page cannot be created."""


def package(name: str) -> Any:
    """Import a package of the pip extra ``page``.

    Raises
    ------
    PageError
        If the package is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise PageError(
            f"a page needs the package {name} ({error}): pip install 'ggbench[page]'"
        ) from None


def installed() -> bool:
    """Return whether the packages of the pip extra ``page`` are installed."""
    return all(importlib.util.find_spec(name) for name in _PACKAGES)


@cache
def datatables() -> tuple[str, str]:
    """Return the source of DataTables: the JavaScript module and the style sheet."""
    folder = Path(package("itables").__file__).parent / "html"
    script = (folder / "dt_bundle.js").read_text(encoding="utf-8")
    style = (folder / "dt_bundle.css").read_text(encoding="utf-8")
    return _within_html(script), style


def _within_html(script: str) -> str:
    """Escape the sequences of a script that would end its HTML element."""
    return script.replace("</script", "<\\/script").replace("<!--", "<\\!--")


def script_hash(script: str) -> str:
    """Return the hash of a script for a content security policy."""
    digest = hashlib.sha256(script.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"
