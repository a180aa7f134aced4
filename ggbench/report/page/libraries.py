"""What the page needs of other packages: the extra ``page``, and what of it goes into the file."""

from __future__ import annotations

import base64
import hashlib
import importlib
import io
from functools import cache
from pathlib import Path
from typing import Any

from ...errors import GGBenchError

_COLOURS = 128
"""Of an embedded picture: drawings lose nothing that the eye would see, and two thirds in size."""


class PageError(GGBenchError):
    """A page cannot be made."""


def package(name: str) -> Any:
    """Return a package of the extra ``page``.

    Raises
    ------
    PageError
        If it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise PageError(
            f"a page needs the package {name} ({error}): pip install 'ggbench[page]'"
        ) from None


def require() -> None:
    """Raise :class:`PageError` unless all that a page needs is installed."""
    for name in ("itables", "jinja2", "markdown_it", "vl_convert"):
        package(name)


@cache
def vega() -> str:
    """Return the script of Vega, Vega-Lite and Vega-Embed, which sets ``window.vegaEmbed``."""
    bundle = package("vl_convert").javascript_bundle("window.vegaEmbed = vegaEmbed;")
    return _within_html(f"(() => {{{bundle}}})();")


@cache
def datatables() -> tuple[str, str]:
    """Return the module of DataTables, its default export, and its style sheet."""
    folder = Path(package("itables").__file__).parent / "html"
    script = (folder / "dt_bundle.js").read_text(encoding="utf-8")
    style = (folder / "dt_bundle.css").read_text(encoding="utf-8")
    return _within_html(script), style


def _within_html(script: str) -> str:
    """Return a script that cannot end the element in which it stands."""
    return script.replace("</script", "<\\/script").replace("<!--", "<\\!--")


def script_hash(script: str) -> str:
    """Return by what a content security policy knows a script."""
    digest = hashlib.sha256(script.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"


def picture(path: Path) -> str:
    """Return a picture as the address that holds it (``data:``), of few colours to be small."""
    from PIL import Image

    content = io.BytesIO()
    with Image.open(path) as image:
        image.convert("RGB").quantize(_COLOURS).save(content, "png", optimize=True)
    return "data:image/png;base64," + base64.b64encode(content.getvalue()).decode()
