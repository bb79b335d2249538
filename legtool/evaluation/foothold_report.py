"""The foothold line's pages: how well the networks choose, and what body poses leave to choose from."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from legtool.datasets.foothold_run import FootholdRun
from legtool.datasets.store import replacing
from legtool.evaluation.drawing import GREY, draw
from legtool.evaluation.report import render
from legtool.evaluation.results import Metric

_COLOURS = {
    "vpa": "#1f5fa8",
    "tbr": "#c4511c",
    "vpa_single": "#2b7d4f",
    "vpa_integral": "#1f5fa8",
    "vpa_sum": "#b4232f",
}
_MEASURES = ("perfect", "safe", "mean_distance_m")


def write_foothold_report(
    path: Path, metrics: Mapping[str, Metric], run: FootholdRun, provenance: Mapping[str, Any]
) -> None:
    """Write the page of ``eval vfa`` or ``eval vpa``.

    Args:
        path: the HTML file.
        metrics: as written to ``results.json``.
        run: that was measured.
        provenance: as written to ``results.json``.

    Raises:
        OutputError: it cannot be written.
    """
    sections: list[dict[str, Any]] = []
    prefix = f"vfa.{run.network}."
    groups = [key.removesuffix("perfect").removeprefix(prefix) for key in metrics if key.startswith(prefix)]
    groups = [group for group in groups if f"{prefix}{group}perfect" in metrics]
    if groups:
        rows = [
            {
                "name": group.rstrip(".").replace(".", " ").replace("_", " ") or "all samples",
                "cells": [_cell(metrics[f"{prefix}{group}{name}"]) for name in _MEASURES],
            }
            for group in groups
        ]
        sections.append(
            {
                "title": "Foothold selection",
                "text": "Against the exact criteria, on terrain of another seed. Perfect: the same "
                "answer; safe: that, or "
                "another safe cell; distance to the exact foothold over all samples, half a map where only one of both "
                "sees a foothold. 95 % bootstrap intervals over terrains.",
                "table": {"head": ["samples", "perfect", "safe", "mean distance [m]"], "rows": rows},
            }
        )
    names = [name for name in ("ratio", "median_error", "regret") if f"vpa.{run.network}.{name}" in metrics]
    if names:
        cells = [_cell(metrics[f"vpa.{run.network}.{name}"]) for name in names]
        sections.append(
            {
                "title": "Numbers of safe footholds",
                "text": "Ratio of the means over all hip heights (the paper's measure), median "
                "relative error of a sample, "
                "and regret: the share of safe footholds lost by the hip height that the network favours.",
                "table": {
                    "head": ["", *(n.replace("_", " ") for n in names)],
                    "rows": [{"name": "all", "cells": cells}],
                },
            }
        )
    history = run.description["history"]
    sections.append({"title": "Loss while training", "figure": draw(lambda f: _curves(f, history), 5.5, 2.4)})
    facts = [
        ("run", f"{provenance['run']}, {run.network} network, best epoch {run.description['best']['epoch']}"),
        ("data", ", ".join(provenance["data"])),
        ("data hash", str(provenance["data_hash"])[:12]),
        ("seed", str(provenance["seed"])),
        ("commit", str(provenance["commit"] or "installed wheel")[:12]),
    ]
    _write(path, f"Footholds of {run.robot.name}", facts, sections)


def write_vital_report(
    path: Path, metrics: Mapping[str, Metric], traces: Mapping[str, Mapping[str, Any]], provenance: Mapping[str, Any]
) -> None:
    """Write the page of the ViTAL suite.

    Args:
        path: the HTML file.
        metrics: as written to ``results.json``.
        traces: walk to strategy to its trace.
        provenance: as written to ``results.json``.

    Raises:
        OutputError: it cannot be written.
    """
    strategies = list(next(iter(traces.values())))
    rows = [
        {"name": walk.replace("_", " "), "cells": [_cell(metrics[f"{walk}.{s}.min_safe"], 0) for s in strategies]}
        for walk in traces
    ]
    sections: list[dict[str, Any]] = [
        {
            "title": "Least number of safe footholds of the worst leg",
            "text": "Exact criteria, every 2 cm of the way, below each hip at its height. VPA over "
            "two horizons and one, with "
            "the paper's costs of squared integrals and squared sums, and the baseline TBR, whose changes of pose are "
            "limited alike.",
            "table": {"head": ["walk", *(s.replace("_", " ") for s in strategies)], "rows": rows},
        }
    ]
    for walk, found in traces.items():
        sections.append(
            {
                "title": walk.replace("_", " ").capitalize(),
                "text": "Safe footholds of the worst leg, height and pitch of the trunk (Figs. 9 to 11), the variation "
                "of the pitch with one horizon and with two (Fig. 12), and by how much the number of "
                "safe footholds changes "
                "between hips 2.5 cm lower and higher (equation 27, Fig. 13).",
                "figure": draw(functools.partial(_walk, traces=found), 7.2, 7.0),
            }
        )
    facts = [
        ("robot", str(provenance["settings"]["robot"])),
        ("commit", str(provenance["commit"] or "installed wheel")[:12]),
    ]
    _write(path, "Body poses for safe footholds", facts, sections)


def _walk(figure: Figure, traces: Mapping[str, Any]) -> None:
    axes = figure.subplots(5, 1, sharex=True)
    for name in ("vpa", "tbr"):
        trace = traces[name]
        label, colour = name.upper(), _COLOURS[name]
        axes[0].plot(trace.x, trace.safe.min(axis=1), color=colour, label=label, lw=1.2)
        axes[1].plot(trace.x, trace.pose[:, 0], color=colour, lw=1.2)
        axes[2].plot(trace.x, np.rad2deg(trace.pose[:, 2]), color=colour, lw=1.2)
    for name, label in (("vpa", "two horizons"), ("vpa_single", "one horizon")):
        trace = traces[name]
        rate = np.rad2deg(np.abs(np.diff(trace.pose[:, 2]) / np.diff(trace.x)))
        axes[3].plot(trace.x[1:], rate, color=_COLOURS[name], label=label, lw=1.0)
    for name, label in (("vpa_integral", "integral"), ("vpa_sum", "sum")):
        trace = traces[name]
        axes[4].plot(trace.x, trace.margin.mean(axis=1), color=_COLOURS[name], label=label, lw=1.0)
    titles = (
        "safe footholds,\nworst leg",
        "height [m]",
        "pitch [°]\n+ nose down",
        "change of pitch\n[°/m]",
        "change of safe\nfootholds",
    )
    for ax, title in zip(axes, titles, strict=True):
        ax.set_ylabel(title)
    for k in (0, 3, 4):
        axes[k].legend(loc="upper right", fontsize=7, frameon=False)
    axes[0].axhline(0, color=GREY, lw=0.8)
    axes[4].set_xlabel("position of the trunk [m]")


def _curves(figure: Figure, history: Sequence[Mapping[str, Any]]) -> None:
    ax = figure.subplots()
    epochs = [entry["epoch"] for entry in history]
    ax.plot(epochs, [entry["training_loss"] for entry in history], color=GREY, label="training")
    ax.plot(epochs, [entry["loss"] for entry in history], color="#1f5fa8", label="held-out terrain")
    ax.set_xlabel("epoch")
    ax.set_ylabel("loss")
    ax.legend(frameon=False)


def _cell(entry: Metric, digits: int = 3) -> dict[str, Any]:
    note = "–".join(f"{end:.{digits}f}" for end in entry["ci95"] or ())
    return {"value": f"{entry['value']:.{digits}f}", "note": note, "best": False}


def _write(path: Path, title: str, facts: Sequence[tuple[str, str]], sections: Sequence[Mapping[str, Any]]) -> None:
    page = render(title, facts, sections)
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
