"""``report.html``: one self-contained page, figures and all, that reads on a phone and prints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2

from legtool.datasets.files import write_text
from legtool.evaluation.report.results import Metric

Cell = dict[str, Any]
Facts = Sequence[tuple[str, str]]


def write_page(path: Path, title: str, facts: Facts, sections: Sequence[Mapping[str, Any]]) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        title: its heading.
        facts: name and value pairs below the heading; those without a value are left out.
        sections: each with ``title`` and any of ``text``, ``table`` (``head`` and ``rows``, of each a ``name`` and
            ``cells`` from :func:`cell`), ``figure`` (SVG), ``details`` (a list of ``title`` and ``table``).

    Raises:
        OutputError: it cannot be written.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    told = [(name, value) for name, value in facts if value]
    write_text(path, environment.get_template("report.html.j2").render(title=title, facts=told, sections=sections))


def cell(value: str, note: str = "", best: bool = False) -> Cell:
    """One cell of a table: its text, small print below it, and whether it stands out."""
    return {"value": value, "note": note, "best": best}


def metric_cell(entry: Metric | None, factor: float = 1.0, digits: int = 3, *, best: bool = False) -> Cell:
    """A metric times ``factor``, its interval below it; a dash where there is no such metric."""
    if entry is None:
        return cell("–")
    interval = "–".join(f"{factor * end:.{digits}f}" for end in entry["ci95"] or ())
    return cell(f"{factor * entry['value']:.{digits}f}", interval, best)


def origin(provenance: Mapping[str, Any], hashed: str | None = "data hash") -> list[tuple[str, str]]:
    """The facts that tell where a page's figures come from: data, hash, seed, commit.

    Args:
        provenance: as written to ``results.json``.
        hashed: what its ``data_hash`` is the hash of, in words; None: it is not shown.
    """
    commit = provenance["commit"]
    return [
        ("data", ", ".join(provenance.get("data", ()))),
        *([] if hashed is None else [(hashed, str(provenance["data_hash"])[:12])]),
        ("seed", str(provenance["seed"])),
        # Twelve digits of a commit are enough to find it; what stands behind all forty says that code was changed.
        ("commit", "installed wheel" if commit is None else str(commit)[:12] + str(commit)[40:]),
    ]
