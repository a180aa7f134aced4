"""Settings of the documentation's site: Sphinx, markdown and notebooks by MyST, the theme furo.

``make docs`` builds it. Pages below ``docs/generated`` are made from the repository at each build
(:mod:`site_pages`); links from any page into ``reports/`` and ``scenarios/data`` lead to them.
"""

from __future__ import annotations

import sys
from pathlib import Path

from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parent))

import docstrings
import site_pages

import ggbench

project = "ggbench"
author = "The ggbench authors"
project_copyright = author
version = release = ggbench.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx_design"]
# Parts that the landing page includes.
exclude_patterns = ["generated/findings.md", "generated/thumbnails.md"]

myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 4
nb_execution_mode = "off"  # `make tutorial-check` executes the notebook
nb_merge_streams = True
# Reports begin sections at the depth that suits them.
suppress_warnings = ["myst.header"]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
# Types with limits, by name: what they allow is in their module.
_LIMITED = ("AtLeastOne", "NonNegative", "Positive", "Share")
autodoc_type_aliases = {name: name for name in (*_LIMITED, "ArrayLike")}

# Types of other packages, and names that a docstring uses for what it explains in words.
nitpick_ignore_regex = [
    (
        "py:class",
        r"(np|numpy|pd|pandas|matplotlib|pathlib|collections|typing|pydantic|click|stonesoup|dynamax)\..*",
    ),
    (
        "py:class",
        r"(ndarray|ArrayLike|Generator|DataFrame|Figure|Path|Any)|Callable|Sequence|Mapping",
    ),
    (
        "py:class",
        "|".join(_LIMITED),
    ),
]

html_extra_path = [str(site_pages.EXTRA)]
html_static_path = ["static"]
html_css_files = ["site.css"]
html_theme = "furo"
html_title = f"ggbench {version}"
html_show_sphinx = False
html_copy_source = False


def setup(app: Sphinx) -> None:
    """Have pages generated before any is read, and links led to them."""
    site_pages.write()
    docstrings.setup(app)

    def relinked(app: Sphinx, name: str, source: list[str]) -> None:
        page = Path(app.env.doc2path(name))
        if site_pages.GENERATED not in page.parents:
            source[0] = site_pages.relinked(source[0], page, page)

    app.connect("source-read", relinked)
