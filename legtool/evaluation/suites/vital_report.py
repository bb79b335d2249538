"""The page of ViTAL's comparison: what body poses leave the legs to choose from, and how the robot walked."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from legtool.evaluation.report.drawing import GREY, draw
from legtool.evaluation.report.page import cell, origin, write_page
from legtool.evaluation.report.results import Metric
from legtool.evaluation.suites.vital_trace import Trace
from legtool.verdict import Verdict

_NAMES = {
    "vpa": ("VPA", "#1f5fa8"),
    "tbr": ("TBR", "#c4511c"),
    "vpa_single": ("VPA, one horizon", "#2b7d4f"),
    "vpa_integral": ("integral cost", "#1f5fa8"),
    "vpa_integral_single": ("integral cost, one horizon", "#7c3f8c"),
    "vpa_sum": ("sum cost", "#b4232f"),
}
_TITLES = {
    "stairs": "Stairs, rise 10 cm, go 25 cm, 0.2 m/s",
    "stairs_go28": "Stairs, rise 10 cm, go 28 cm, 0.25 m/s",
    "stairs_03": "Stairs, 0.3 m/s",
    "stairs_04": "Stairs, 0.4 m/s",
    "stairs_05": "Stairs, 0.5 m/s",
    "stairs_075": "Stairs, 0.75 m/s, the faster robot",
    "gapped_stairs": "Gapped stairs, 0.4 m/s",
    "rough": "Rough ground, 0.2 m/s",
    "stairs_sideways": "Low stairs sideways, 0.2 m/s",
    "stairs_yawing": "Stairs while turning by 46°, 0.2 m/s",
}
_LEGS = ("#111827", "#6b7280", "#111827", "#6b7280")


def write_vital_report(
    path: Path,
    metrics: Mapping[str, Metric],
    traces: Mapping[str, Mapping[str, Trace]],
    provenance: Mapping[str, Any],
    verdict: Verdict,
) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        metrics: as written to ``results.json``.
        traces: walk to strategy to its trace.
        provenance: as written to ``results.json``.
        verdict: that the page begins with.

    Raises:
        OutputError: it cannot be written.
    """
    sections = [verdict.section(), _safe_table(metrics, traces), _steps_table(metrics, traces)]
    studied = {name: found for name, found in traces.items() if "vpa_single" in found}
    if studied:
        sections.append(_studies_table(metrics, studied))
    for name, found in traces.items():
        sections.append(
            {
                "title": _title(name),
                "text": "Safe footholds of the worst leg at each place of the trunk, its height, its pitch or roll, "
                "by VPA (vision-based pose adaptation) and by TBR (terrain-based body reference), as in the paper's "
                "Figs. 9 to 11.",
                "figure": draw(functools.partial(_walk, traces=found), 7.2, 4.6),
            }
        )
        if all(trace.frames for trace in found.values()):
            sections.append(
                {
                    "title": f"{_title(name)}: filmstrip",
                    "text": "From the side, across the walk: trunk and links as MuJoCo has them, left legs black, "
                    "right legs grey.",
                    "figure": draw(functools.partial(_filmstrip, traces=found), 7.6, 3.6),
                }
            )
    for name, found in studied.items():
        sections += [
            {
                "title": f"One horizon or two: {_title(name).lower()}",
                "text": "Safe footholds of the worst leg, and by how much height and pitch change per metre, by the "
                "paper's cost of squared integrals (Fig. 12).",
                "figure": draw(functools.partial(_horizons, traces=found), 7.2, 4.6),
            },
            {
                "title": f"Integral, sum or robust cost: {_title(name).lower()}",
                "text": "Safe footholds, mean of the legs, between hips 2.5 cm lower and 2.5 cm higher than planned "
                "(areas), and the difference between both, mean of the legs (lines; equation 27, Fig. 13).",
                "figure": draw(functools.partial(_envelopes, traces=found), 7.2, 3.8),
            },
        ]
    facts = [
        ("robot", str(provenance["settings"]["robot"])),
        ("robot at 0.75 m/s", str(provenance["settings"]["fast_robot"])),
        *origin(provenance, hashed=None),
    ]
    write_page(path, "Body poses for safe footholds", facts, sections)


def _title(name: str) -> str:
    return _TITLES.get(name, name.replace("_", " ").capitalize())


def _safe_table(metrics: Mapping[str, Metric], traces: Mapping[str, Mapping[str, Trace]]) -> dict[str, Any]:
    rows = []
    for name in traces:
        least = {s: metrics[f"{name}.{s}.min_safe"]["value"] for s in ("vpa", "tbr")}
        cells = []
        for s in ("vpa", "tbr"):
            none = 100 * metrics[f"{name}.{s}.without_safe"]["value"]
            other = least["tbr" if s == "vpa" else "vpa"]
            cells.append(cell(f"{least[s]:.0f}", f"none on {none:.1f} % of the way", best=least[s] > other))
        cells += [cell(f"{metrics[f'{name}.{s}.mean_safe']['value']:.0f}") for s in ("vpa", "tbr")]
        rows.append({"name": _title(name), "cells": cells})
    return {
        "title": "Safe footholds along the way",
        "text": "Exact criteria, every 2 cm, below each hip at its height, out of 1089 cells. Least: of the worst leg "
        "at the worst place; mean: over all legs and places. Both strategies change the pose within the same limits.",
        "table": {"head": ["walk", "VPA least", "TBR least", "VPA mean", "TBR mean"], "rows": rows},
    }


def _steps_table(metrics: Mapping[str, Metric], traces: Mapping[str, Mapping[str, Trace]]) -> dict[str, Any]:
    rows = []
    for name in traces:
        cells = [cell(str(traces[name]["vpa"].steps))]
        for what in ("collisions", "workspace_violations", "blind"):
            for s in ("vpa", "tbr"):
                entry = metrics[f"{name}.{s}.{what}"]
                interval = "" if entry["ci95"] is None else "{:.0f}–{:.0f} %".format(*(100 * x for x in entry["ci95"]))
                cells.append(cell(str(round(entry["value"] * entry["n"])), interval))
        for s in ("vpa", "tbr"):
            excess = metrics[f"{name}.{s}.joint_excess_rad"]["value"]
            if excess > 0:
                cells[3 if s == "vpa" else 4]["note"] = f"≤ {excess:.2f} rad"
        rows.append({"name": _title(name), "cells": cells})
    return {
        "title": "Steps that MuJoCo saw go wrong",
        "text": "The path walked at a trot to the exact selection's footholds, MuJoCo's own geometry at every 10 ms. "
        "Steps on which trunk, thigh, shank or swinging foot met the terrain; on which a foot could not follow or a "
        "joint left its limits, with the farthest; and for which no safe foothold was found and the nominal one was "
        "taken. 95 % Wilson intervals. The criteria know no attitude, so that a pitched trunk uses up joint range.",
        "table": {
            "head": ["walk", "steps", "collided VPA", "TBR", "workspace VPA", "TBR", "none VPA", "TBR"],
            "rows": rows,
        },
    }  # fmt: skip


def _studies_table(metrics: Mapping[str, Metric], traces: Mapping[str, Any]) -> dict[str, Any]:
    measures = (
        ("min_safe", 1, 0),
        ("mean_safe", 1, 0),
        ("height_variation", 100, 1),
        ("pitch_variation_rad_m", 180 / np.pi, 1),
        ("margin_error", 1, 1),
    )
    rows = []
    for name, found in traces.items():
        for s in (s for s in found if s != "tbr"):
            label = "VPA, two horizons, robust cost" if s == "vpa" else _NAMES[s][0]
            values = [f"{k * metrics[f'{name}.{s}.{what}']['value']:.{digits}f}" for what, k, digits in measures]
            rows.append({"name": f"{_title(name)}: {label}", "cells": [cell(value) for value in values]})
    return {
        "title": "Horizons and costs",
        "text": "Variations are mean absolute changes per metre travelled (equation 26); the last column is the change "
        "of safe footholds between hips 2.5 cm lower and higher (equation 27).",
        "table": {
            "head": ["", "least safe", "mean safe", "height [cm/m]", "pitch [°/m]", "over the margin"],
            "rows": rows,
        },
    }


def _walk(figure: Figure, traces: Mapping[str, Trace]) -> None:
    axes = figure.subplots(3, 1, sharex=True)
    # Sideways the trunk rolls where it pitches forwards.
    rolls = np.abs(traces["vpa"].pose[:, 1]).max() > np.abs(traces["vpa"].pose[:, 2]).max()
    for s in ("vpa", "tbr"):
        trace, (label, colour) = traces[s], _NAMES[s]
        axes[0].plot(trace.x, trace.safe.min(axis=1), color=colour, label=label, lw=1.3)
        axes[1].plot(trace.x, trace.pose[:, 0], color=colour, lw=1.3)
        axes[2].plot(trace.x, np.rad2deg(trace.pose[:, 1 if rolls else 2]), color=colour, lw=1.3)
    axes[0].axhline(0, color=GREY, lw=0.8)
    _label(axes, "safe footholds,\nworst leg", "height [m]", "roll [°]" if rolls else "pitch [°]\n+ nose down")


def _horizons(figure: Figure, traces: Mapping[str, Trace]) -> None:
    axes = figure.subplots(3, 1, sharex=True)
    for s, label in (("vpa_integral_single", "one horizon"), ("vpa_integral", "two horizons")):
        trace, colour = traces[s], _NAMES[s][1]
        axes[0].plot(trace.x, trace.safe.min(axis=1), color=colour, label=label, lw=1.2)
        rate = np.abs(np.diff(trace.pose, axis=0) / np.diff(trace.x)[:, None])
        axes[1].plot(trace.x[1:], 100 * rate[:, 0], color=colour, lw=1.0)
        axes[2].plot(trace.x[1:], np.rad2deg(rate[:, 2]), color=colour, lw=1.0)
    _label(axes, "safe footholds,\nworst leg", "height\n[cm/m]", "pitch\n[°/m]")


def _envelopes(figure: Figure, traces: Mapping[str, Trace]) -> None:
    axes = figure.subplots(2, 1, sharex=True)
    for s, label in (("vpa_sum", "sum cost"), ("vpa_integral", "integral cost"), ("vpa", "robust cost")):
        trace, colour = traces[s], "#2b7d4f" if s == "vpa" else _NAMES[s][1]
        low, high = trace.around.mean(axis=1).T
        axes[0].fill_between(trace.x, low, high, color=colour, alpha=0.35, lw=0.6, label=label)
        axes[1].plot(trace.x, np.abs(trace.around[..., 1] - trace.around[..., 0]).mean(axis=1), color=colour, lw=1.2)
    _label(axes, "safe footholds", "difference")


def _label(axes: Sequence[Axes], *names: str) -> None:
    for ax, name in zip(axes, names, strict=True):
        ax.set_ylabel(name)
        ax.margins(x=0.01)
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, fontsize=8)
    axes[-1].set_xlabel("position of the trunk [m]")


def _filmstrip(figure: Figure, traces: Mapping[str, Trace]) -> None:
    names = ("vpa", "tbr")
    panels = figure.subplots(2, len(traces["vpa"].frames), squeeze=False)
    for row, s in zip(panels, names, strict=True):
        at, ground = traces[s].ground
        for ax, frame in zip(row, traces[s].frames, strict=True):
            middle, low = float(frame.trunk[:, 0].mean()), float(frame.legs[..., 2].min()) - 0.12
            ax.fill_between(at, low, np.maximum(ground, low), step="mid", color="#d6d3d1", lw=0)
            for leg in (1, 3, 0, 2):
                ax.plot(frame.legs[leg, :, 0], frame.legs[leg, :, 2], color=_LEGS[leg], lw=1.3, solid_capstyle="round")
                ax.plot(*frame.legs[leg, 3, [0, 2]], "o", color=_LEGS[leg], ms=2.5)
            ax.plot(frame.trunk[:, 0], frame.trunk[:, 2], color=_NAMES[s][1], lw=3.5, solid_capstyle="round")
            around = frame.legs[[0, 1, 3, 2, 0], 0]
            ax.plot(around[:, 0], around[:, 2], color=_NAMES[s][1], lw=2.0, solid_capstyle="round")
            ax.set_aspect("equal")
            ax.set_xlim(middle - 0.75, middle + 0.75)
            ax.set_ylim(low, low + 1.15)
            ax.grid(False)
            ax.tick_params(labelsize=7, labelleft=ax is row[0])
            if s == "vpa":
                ax.set_title(f"trunk at {middle:.1f} m")
        row[0].set_ylabel(f"{_NAMES[s][0]}\n[m]")
