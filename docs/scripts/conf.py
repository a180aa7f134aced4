"""Settings of the documentation site: Sphinx, MyST for Markdown and notebooks, and furo.

``make docs`` builds the site. Each build generates the pages below ``docs/generated`` from the
repository (:mod:`site_pages`). Links of any page into ``reports/`` and ``scenarios/data`` lead to
these pages.
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
# The landing page includes these parts.
exclude_patterns = ["generated/findings.md", "generated/thumbnails.md"]

myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 4
nb_execution_mode = "off"  # `make tutorial-check` executes the notebook
nb_merge_streams = True
# Sections of reports may skip heading levels.
suppress_warnings = ["myst.header"]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
# The site shows limited types by name; their module documents the limits.
_LIMITED = ("AtLeastOne", "NonNegative", "Positive", "Share")
autodoc_type_aliases = {name: name for name in (*_LIMITED, "ArrayLike")}

# Names without a page: types of other packages, and limited types.
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
    """Generate pages before Sphinx reads any page, and redirect links to them."""
    site_pages.write()
    docstrings.setup(app)

    def relinked(app: Sphinx, name: str, source: list[str]) -> None:
        page = Path(app.env.doc2path(name))
        if site_pages.GENERATED not in page.parents:
            source[0] = site_pages.relinked(source[0], page, page)

    app.connect("source-read", relinked)
