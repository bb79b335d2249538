"""The foothold line's pages: how well the networks choose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from legtool.evaluation.report.drawing import GREY, draw
from legtool.evaluation.report.page import metric_cell, origin, write_page
from legtool.evaluation.report.results import Metric
from legtool.models.foothold_run import FootholdRun
from legtool.verdict import Verdict

#: Measures of foothold selection: name, title, by what it is multiplied, and digits.
_MEASURES = (
    ("perfect", "perfect [%]", 100.0, 1),
    ("safe", "safe [%]", 100.0, 1),
    ("mean_distance_m", "mean distance [mm]", 1000.0, 1),
)


def write_foothold_report(
    path: Path, metrics: Mapping[str, Metric], run: FootholdRun, provenance: Mapping[str, Any], verdict: Verdict
) -> None:
    """Write the page of ``eval vfa`` or ``eval vpa``.

    Args:
        path: the HTML file.
        metrics: as written to ``results.json``.
        run: that was measured.
        provenance: as written to ``results.json``.
        verdict: that the page begins with.

    Raises:
        OutputError: it cannot be written.
    """
    sections = [verdict.section()]
    prefix = f"vfa.{run.network}."
    groups = [key.removesuffix("perfect").removeprefix(prefix) for key in metrics if key.startswith(prefix)]
    groups = [group for group in groups if f"{prefix}{group}perfect" in metrics]
    if groups:
        named = {prefix + group: group.rstrip(".").replace(".", " ").replace("_", " ") for group in groups}
        named |= {prefix: "all samples", "vfa.guess.": "all samples, by the check that the network starts from"}
        rows = [
            {
                "name": title,
                "cells": [metric_cell(metrics[f"{start}{name}"], scale, d) for name, _, scale, d in _MEASURES],
            }
            for start, title in sorted(named.items(), key=lambda item: not item[1].startswith("all samples"))
        ]
        sections.append(
            {
                "title": "Foothold selection",
                "text": "Against the exact criteria, on terrain of another seed. Perfect: the same answer; safe: that, "
                "or another safe cell; distance to the exact foothold over all samples, half a map where only one of "
                "both sees a foothold. 95 % bootstrap intervals over terrains.",
                "table": {"head": ["samples", *(title for _, title, _, _ in _MEASURES)], "rows": rows},
            }
        )
    names = [name for name in ("ratio", "median_error", "regret") if f"vpa.{run.network}.{name}" in metrics]
    if names:
        rows = [
            {"name": title, "cells": [metric_cell(metrics[f"vpa.{network}.{name}"]) for name in names]}
            for network, title in ((run.network, "all samples"), ("guess", "by the check that the network starts from"))
        ]
        sections.append(
            {
                "title": "Numbers of safe footholds",
                "text": "Ratio of the means over all hip heights (the paper's measure), median relative error of a "
                "sample, and regret: the share of safe footholds lost by the hip height that the network favours.",
                "table": {
                    "head": ["", *(n.replace("_", " ") for n in names)],
                    "rows": rows,
                },
            }
        )
    history = run.description["history"]
    sections.append({"title": "Loss while training", "figure": draw(lambda f: _curves(f, history), 5.5, 2.4)})
    facts = [
        ("run", f"{provenance['run']}, {run.network} network, best epoch {run.description['best']['epoch']}"),
        *origin(provenance),
    ]
    write_page(path, f"Footholds of {run.robot.name}", facts, sections)


def _curves(figure: Figure, history: Sequence[Mapping[str, Any]]) -> None:
    ax = figure.subplots()
    epochs = [entry["epoch"] for entry in history]
    ax.plot(epochs, [entry["training_loss"] for entry in history], color=GREY, label="training")
    ax.plot(epochs, [entry["loss"] for entry in history], color="#1f5fa8", label="held-out terrain")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_xlabel("epoch")
    ax.set_ylabel("loss")
    ax.legend(frameon=False)
