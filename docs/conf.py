"""Configuration of the site: ``make docs`` builds it into ``site/`` without a network, warnings as errors."""

from __future__ import annotations

import inspect
import re
import sys
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import reference  # noqa: E402  # beside this file

project = "legtool"
author = "legtool developers"
copyright = "legtool developers, Apache-2.0"
version = release = version_of("legtool")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
exclude_patterns = ["images"]
#: A docstring or annotation names a class as its module does: where two modules have one of a name, no link is made.
suppress_warnings = ["ref.python"]
html_theme = "furo"
html_title = f"legtool {release}"
html_static_path = ["static"]
html_css_files = ["legtool.css"]
html_extra_path = ["bundle.schema.json"]
html_show_sourcelink = False
pygments_style, pygments_dark_style = "default", "github-dark"

# Diagrams and listings are text: nothing is coloured that does not say what it is.
highlight_language = "text"
# What an option of a command is called differs from what a page says around it: no fancy dashes or quotes.
smartquotes = False

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
# Names that a package only passes on are described where they are made.
autodoc_default_options = {"members": True, "show-inheritance": True, "ignore-module-all": True}
autodoc_type_aliases = {name: name for name in ("Array", "Array32", "ArrayLike", "Depth", "LabelImage")}
napoleon_google_docstring, napoleon_numpy_docstring = True, False
napoleon_use_ivar = True

#: With ``-t quick`` the pages are written by hand and from the commands alone: the API takes most of the time.
reference.write(HERE / "generated", api=not tags.has("quick"))  # type: ignore[name-defined]  # noqa: F821  # by Sphinx


def setup(app: Any) -> None:
    """Docstrings write |x| for the size of x, which reStructuredText would take for a name to fill in.

    What is said of a constant may hold a colon, before which Napoleon would see a type but for the empty line.
    """

    def escape(_app: Any, what: str, _name: str, _object: Any, _options: Any, lines: list[str]) -> None:
        if what in ("attribute", "data", "property"):
            lines.insert(0, "")
        lines[:] = [re.sub(r"(?<!\\)\|", r"\|", line) for line in lines]

    def skip(_app: Any, _what: str, _name: str, value: Any, _skipped: bool, _options: Any) -> bool | None:
        """What libraries put into our classes is described by them."""
        ours = not inspect.isroutine(value) or str(getattr(value, "__module__", "legtool")).startswith("legtool")
        return None if ours else True

    app.connect("autodoc-skip-member", skip)
    app.connect("autodoc-process-docstring", escape, priority=400)  # before Napoleon
