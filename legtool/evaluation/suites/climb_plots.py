"""Drawings of walks with planned poses: poses held, safe footholds left, and how both go with the speed."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from legtool.evaluation.report.drawing import GREY, RED, draw

Array = NDArray[np.float64]
Record = Mapping[str, Any]

#: Colours of planners; others are drawn grey.
_COLOURS = {
    "vital": "#1f5fa8",
    "tbr": "#c4511c",
    "vital_single": "#2b7d4f",
    "vital_sum": "#b4232f",
    "vital_integral": "#7c3f8c",
}
_SPEEDS = ("#93c5fd", "#3b82f6", "#1d4ed8", "#111827", "#6b7280")


def climb_sections(records: Mapping[tuple[str, str], Sequence[Record]]) -> list[dict[str, Any]]:
    """Sections of a page, for all worlds that were walked with planned poses.

    Args:
        records: world and planner to the records of their trials.
    """
    worlds = dict.fromkeys(world for (world, _), found in records.items() if any(r.get("postures") for r in found))
    sections: list[dict[str, Any]] = []
    for world in worlds:
        rows = {row: found for (name, row), found in records.items() if name == world and found[0].get("postures")}
        sections += [
            {
                "title": f"{world}: poses",
                "text": "Height and pitch of the first trial of each planner: as planned (dashed), as filtered for the "
                "body (thin), and as measured (thick). ViTAL's Fig. 5.",
                "figure": draw(functools.partial(_poses, rows=rows), 7.2, 4.0),
            },
            {
                "title": f"{world}: safe footholds and errors",
                "text": "Safe footholds of the worst leg at the true pose, and how far height and pitch are off the "
                "planner's pose, in all trials; a cross ends a trial that did not reach the goal. ViTAL's Figs. 9 "
                "to 11.",
                "figure": draw(functools.partial(_safe, rows=rows), 7.2, 5.0),
            },
        ]
    fast = [world for world in worlds if world.startswith("stairs_0") and (world, "vital") in records]
    if len(fast) > 1:
        found = {world: records[world, "vital"] for world in fast}
        sections.append(
            {
                "title": "Stairs at several speeds",
                "text": "Changes of the planned height and pitch per metre, and errors of both against the planner's "
                "pose, of the first trial at each speed. ViTAL's Fig. 8.",
                "figure": draw(functools.partial(_speeds, found=found), 7.2, 6.0),
            }
        )
    return sections


class _Walk:
    """A trial's postures as arrays: ``along`` (n,) [m], ``true``, ``planned``, ``filtered`` (n, 2) height [m] and
    pitch [rad], ``safe`` (n,)."""

    def __init__(self, record: Record) -> None:
        rows = record["postures"]
        places = np.array([row[1] for row in rows], dtype=np.float64)
        self.along = places[:, 0]
        self.true = np.column_stack([places[:, 2], [row[2][1] for row in rows]])
        self.planned, self.filtered = (np.array([[row[k][0], row[k][2]] for row in rows]) for k in (3, 4))
        self.safe = np.array([row[5] for row in rows])
        self.success = bool(record["success"])


def _walks(found: Sequence[Record]) -> list[_Walk]:
    return [_Walk(record) for record in found if record.get("postures")]


def _poses(figure: Figure, rows: Mapping[str, Sequence[Record]]) -> None:
    axes = figure.subplots(2, 1, sharex=True)
    for row, found in rows.items():
        walk, colour = _Walk(found[0]), _COLOURS.get(row, GREY)
        for k, factor in ((0, 1.0), (1, 180.0 / np.pi)):
            axes[k].plot(walk.along, factor * walk.planned[:, k], color=colour, lw=0.9, ls="--")
            axes[k].plot(walk.along, factor * walk.filtered[:, k], color=colour, lw=0.7)
            axes[k].plot(walk.along, factor * walk.true[:, k], color=colour, lw=1.6, label=row, alpha=0.8)
    _label(axes, "height [m]", "pitch [°]\n+ nose down")


def _safe(figure: Figure, rows: Mapping[str, Sequence[Record]]) -> None:
    axes = figure.subplots(3, 1, sharex=True)
    for row, found in rows.items():
        colour = _COLOURS.get(row, GREY)
        for n, walk in enumerate(_walks(found)):
            error = walk.true - walk.planned
            label = row if n == 0 else None
            axes[0].plot(walk.along, walk.safe, color=colour, lw=0.9, label=label, alpha=0.7)
            axes[1].plot(walk.along, 100.0 * error[:, 0], color=colour, lw=0.7, alpha=0.7)
            axes[2].plot(walk.along, np.degrees(error[:, 1]), color=colour, lw=0.7, alpha=0.7)
            if not walk.success:
                axes[0].plot(walk.along[-1], walk.safe[-1], "x", color=RED, ms=7, mew=2)
    axes[0].axhline(0, color=GREY, lw=0.8)
    axes[1].set_ylim(-12, 12)
    axes[2].set_ylim(-12, 12)
    _label(axes, "safe footholds,\nworst leg", "height off\nthe plan [cm]", "pitch off\nthe plan [°]")


def _speeds(figure: Figure, found: Mapping[str, Sequence[Record]]) -> None:
    axes = figure.subplots(4, 1, sharex=True)
    for colour, (world, records) in zip(_SPEEDS, found.items(), strict=False):
        walk = _Walk(records[0])
        step = np.maximum(np.diff(walk.along), 1e-3)
        change = np.diff(walk.planned, axis=0) / step[:, None]
        error = np.abs(walk.true - walk.planned)
        for k, factor in ((0, 100.0), (1, 180.0 / np.pi)):
            axes[k].plot(walk.along[1:], factor * change[:, k], color=colour, lw=0.9, label=world if k == 0 else None)
            axes[2 + k].plot(walk.along, factor * error[:, k], color=colour, lw=0.9)
    axes[0].set_ylim(-200, 200)
    axes[1].set_ylim(-300, 300)
    _label(axes, "Δheight\n[cm/m]", "Δpitch\n[°/m]", "height\nerror [cm]", "pitch\nerror [°]")


def _label(axes: Sequence[Axes], *names: str) -> None:
    for ax, name in zip(axes, names, strict=True):
        ax.set_ylabel(name)
        ax.margins(x=0.01)
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, frameon=False, fontsize=8)
    axes[-1].set_xlabel("position of the trunk [m]")
