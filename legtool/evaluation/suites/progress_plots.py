"""How far walks through the worlds of a family came, over time (QuadPiPS, Fig. 14)."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from legtool.evaluation.report.drawing import RED, draw

Record = Mapping[str, Any]

#: Colours of planners, in the order of their rows.
_COLOURS = (
    "#1f5fa8", "#c4511c", "#2b7d4f", "#7c3f8c", "#6b7280", "#0f9ba8", "#b8860b", "#d14a8b", "#5a3d1e", "#8fae2b",
)  # fmt: skip


def progress_section(world: str, records: Mapping[tuple[str, str], Sequence[Record]]) -> list[dict[str, Any]]:
    """The section of a page for one world; none where nothing is known of the progress.

    Args:
        world: its name.
        records: world and planner to the records of their trials.
    """
    rows = {row: [r for r in found if r.get("progress")] for (name, row), found in records.items() if name == world}
    rows = {row: found for row, found in rows.items() if found}
    if not rows:
        return []
    return [
        {
            "title": f"{world}: progress",
            "text": "Share of the way from start to goal that each trial has covered by a time; a cross ends a trial "
            "that did not reach the goal. QuadPiPS' Fig. 14.",
            "figure": draw(functools.partial(_paint, rows=rows), 7.2, 2.6),
        }
    ]


def _paint(figure: Figure, *, rows: Mapping[str, Sequence[Record]]) -> None:
    ax = figure.subplots()
    for number, (row, found) in enumerate(rows.items()):
        colour = _COLOURS[number % len(_COLOURS)]
        for k, record in enumerate(found):
            times, shares = np.array(record["progress"]).T
            ax.plot(times, 100.0 * shares, color=colour, linewidth=0.8, label=row if k == 0 else None)
            if not record["success"]:
                ax.plot(times[-1], 100.0 * shares[-1], "x", color=RED, markersize=6)
    ax.set_ylim(-3.0, 103.0)
    ax.set_xlabel("time [s]")
    ax.set_ylabel("progress [%]")
    ax.legend(frameon=False, fontsize=8)
