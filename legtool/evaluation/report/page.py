"""``report.html``: one self-contained page, figures and all, that reads on a phone and prints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2


def render(title: str, facts: Sequence[tuple[str, str]], sections: Sequence[Mapping[str, Any]]) -> str:
    """The page.

    Args:
        title: its heading.
        facts: name and value pairs below the heading.
        sections: each with ``title`` and any of ``text``, ``table`` (``head`` and ``rows``; ``caption``), ``figure``
            (SVG), ``details`` (a list of ``title`` and ``table``).
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("report.html.j2").render(title=title, facts=facts, sections=sections)
