"""The page of a replay: what was predicted and planned on a recorded walk, and what happened."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from legtool.datasets.logs.recording import Recording
from legtool.evaluation.replay.scores import Replayed
from legtool.evaluation.report.drawing import GREY, RED, draw
from legtool.evaluation.report.page import cell, metric_cell, origin, write_page
from legtool.evaluation.report.results import Metric
from legtool.models.motion import Z90

Array = NDArray[np.float64]

_LEFT, _RIGHT, _GREEN = "#1f5fa8", "#c4511c", "#2b7d4f"
_MODELS = (("fdm", "foothold (FDM)", 1e3, "mm"), ("cdm", "CoM (CDM)", 1e3, "mm"), ("cvm", "velocity (CVM)", 1.0, "m/s"))
#: Coverage of a 90 % interval below which predictions are said to be overconfident.
_OVERCONFIDENT = 0.75
#: Points of a line in a drawing, at most.
_POINTS = 2000


def write_replay_report(
    path: Path, metrics: Mapping[str, Metric], replayed: Replayed, recording: Recording, provenance: Mapping[str, Any]
) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        metrics: of :func:`.scores.measure`.
        replayed: what they were measured on.
        recording: the log.
        provenance: as written to ``results.json``.

    Raises:
        OutputError: it cannot be written.
    """
    facts = [
        ("summary", summary(metrics, replayed)),
        ("log", f"{replayed.duration_s:.1f} s, {len(recording)} rows, {replayed.images} depth images"),
        ("steps", ", ".join(f"{name.replace('_', ' ')} {value:g}" for name, value in replayed.counts.items() if value)),
        ("doubtful", "; ".join(replayed.notes)),
        *origin(provenance, "log"),
        ("bundle", str(provenance["bundle"])[:12]),
    ]
    sections = [*_predictions(metrics, replayed), *_plans(metrics, replayed)]
    if len(recording) > 1:
        sections.append({"title": "From above", "text": _ABOVE, "figure": draw(_above(recording, replayed), 7.2, 4.2)})
    write_page(path, f"Replay of {provenance['robot']}", facts, sections)


_ABOVE = (
    "The way of the trunk (grey), and where feet came down, left ones blue and right ones orange; green circles are "
    "where the models expected them one step before, red crosses touchdowns on ground that the map calls unsafe."
)


def summary(metrics: Mapping[str, Metric], replayed: Replayed) -> str:
    """What a reader should know first."""
    said = []
    if "fdm.mae" in metrics:
        held = metrics["fdm.coverage90"]["value"]
        said.append(
            f"Footholds were predicted to {1e3 * metrics['fdm.mae']['value']:.1f} mm one step ahead; "
            f"{100 * held:.0f} % lie in their 90 % intervals"
            + (", so that the models are overconfident on this log." if held < _OVERCONFIDENT else ".")
        )
    else:
        said.append("Nothing was predicted: no regular steps, or no motion line in the bundle.")
    if replayed.answers is None:
        return " ".join([*said, "Nothing was planned: no depth images to make a map of, or no motion line."])
    planned, late = metrics["plans.steps_planned"], metrics["plans.late"]
    said.append(f"{100 * planned['value']:.0f} % of {planned['n']} steps began with a whole plan.")
    if late["value"] > 0.01:
        said.append(f"{100 * late['value']:.0f} % of the plans came late.")
    if (unsafe := metrics["touchdowns.unsafe"])["n"]:
        said.append(f"{100 * unsafe['value']:.1f} % of {unsafe['n']} touchdowns are where the map says unsafe.")
    return " ".join(said)


def _predictions(metrics: Mapping[str, Metric], replayed: Replayed) -> list[dict[str, Any]]:
    if "fdm.mae" not in metrics:
        return []
    rows = [
        {
            "name": f"{label}, {unit}",
            "cells": [
                metric_cell(metrics[f"{name}.mae"], factor, 1 if factor > 1 else 4),
                metric_cell(metrics[f"{name}.coverage90"], 100.0, 0),
                cell(str(metrics[f"{name}.mae"]["n"])),
            ],
        }
        for name, label, factor, unit in _MODELS
    ]
    out: list[dict[str, Any]] = [
        {
            "title": "One step ahead",
            "text": "Mean absolute error in x and y, and how many of the measurements lie in the 90 % intervals that "
            "the models themselves give. 95 % intervals from a bootstrap over blocks of steps.",
            "table": {"head": ["", "error", "in 90 % interval, %", "steps"], "rows": rows},
        }
    ]
    ahead = replayed.ahead
    if ahead is None or not len(ahead.start):
        return out
    steps = range(1, ahead.com.shape[1] + 1)
    rows = [
        {
            "name": f"{k} step{'s' if k > 1 else ''}",
            "cells": [
                metric_cell(metrics[f"ahead.{k}.touchdown.mae"], 1e3, 1),
                metric_cell(metrics[f"ahead.{k}.touchdown.coverage90"], 100.0, 0),
                metric_cell(metrics[f"ahead.{k}.com.mae"], 1e3, 1),
                cell(str(metrics[f"ahead.{k}.com.mae"]["n"])),
            ],
        }
        for k in steps
    ]
    out.append(
        {
            "title": "Several steps ahead",
            "text": "From the state before the first step and the commands that were given, as a planner predicts. "
            "Intervals are those that the planner weighs missteps with. The figure shows errors of footholds: median, "
            "middle half and 90 % of them, and the interval that was expected (dashed).",
            "table": {"head": ["", "foothold, mm", "in 90 % interval, %", "CoM, mm", "sequences"], "rows": rows},
            "figure": draw(_ahead(replayed), 6.0, 2.6),
        }
    )
    return out


def _ahead(replayed: Replayed) -> Any:
    ahead = replayed.ahead
    assert ahead is not None

    def paint(figure: Figure) -> None:
        ax = figure.subplots()
        steps = np.arange(1, ahead.com.shape[1] + 1)
        errors = 1e3 * np.abs(ahead.feet.reshape(len(ahead.start), len(steps), -1)).transpose(1, 0, 2)
        low, first, middle, third, high = np.quantile(
            errors.reshape(len(steps), -1), [0.05, 0.25, 0.5, 0.75, 0.95], axis=1
        )
        ax.fill_between(steps, low, high, color=_LEFT, alpha=0.15, linewidth=0)
        ax.fill_between(steps, first, third, color=_LEFT, alpha=0.3, linewidth=0)
        ax.plot(steps, middle, color=_LEFT, marker="o", markersize=3)
        ax.plot(steps, 1e3 * Z90 * ahead.spread.mean(axis=1), color=GREY, linestyle="--", linewidth=1)
        ax.set_xticks(steps)
        ax.set_xlabel("steps ahead")
        ax.set_ylabel("error of footholds [mm]")
        ax.set_ylim(bottom=0)

    return paint


def _plans(metrics: Mapping[str, Metric], replayed: Replayed) -> list[dict[str, Any]]:
    names = [
        ("plans.steps_planned", "steps that began with a whole plan", 100.0, 1, "%"),
        ("plans.whole", "plans that are whole", 100.0, 1, "%"),
        ("plans.late", "plans later than their deadline", 100.0, 1, "%"),
        ("plans.as_commanded", "ticks at which the plan is what was commanded", 100.0, 1, "%"),
        ("touchdowns.unsafe", "touchdowns where the map says unsafe", 100.0, 1, "%"),
        ("touchdowns.unknown", "touchdowns where the map knows nothing", 100.0, 1, "%"),
        ("plans.median_s", "time of a plan, median", 1e3, 2, "ms"),
        ("plans.p99_s", "time of a plan, 99 %", 1e3, 2, "ms"),
        ("map.median_s", "time of a map, median", 1e3, 2, "ms"),
        ("map.p99_s", "time of a map, 99 %", 1e3, 2, "ms"),
        ("perception.median_s", "time of perception, median", 1e3, 1, "ms"),
        ("labels.age.median_s", "age of labels, median", 1e3, 1, "ms"),
        ("labels.age.p99_s", "age of labels, 99 %", 1e3, 1, "ms"),
        ("regions", "regions in a frame", 1.0, 1, ""),
        ("images", "depth images", 1.0, 0, ""),
        ("images.missed", "depth images that no row came soon after", 1.0, 0, ""),
        ("speed", "speed of the replay, times real time", 1.0, 1, ""),
    ]
    rows = [
        {
            "name": label + (f", {unit}" if unit else ""),
            "cells": [metric_cell(metrics[name], factor, digits), cell(str(metrics[name]["n"]))],
        }
        for name, label, factor, digits, unit in names
        if name in metrics
    ]
    if not replayed.images:
        return []
    ended = "" if replayed.answers is None else ", ".join(f"{n} {how}" for how, n in replayed.answers.plans.items())
    text = "Wilson 95 % intervals below shares."
    return [
        {
            "title": "What was seen and planned",
            "text": f"{text} Plans by how their search ended: {ended}." if ended else text,
            "table": {"head": ["", "", "n"], "rows": rows},
        }
    ]


def _above(recording: Recording, replayed: Replayed) -> Any:
    def paint(figure: Figure) -> None:
        ax = figure.subplots()
        every = max(1, len(recording) // _POINTS)
        ax.plot(*recording.position_world[::every, :2].T, color=GREY, linewidth=0.8)
        ahead = replayed.ahead
        if ahead is not None and len(ahead.start):
            ax.plot(
                *ahead.predicted.reshape(-1, 3)[:, :2].T, "o", markersize=4, markerfacecolor="none", color=_GREEN,
                markeredgewidth=0.6,
            )  # fmt: skip
        places, legs = np.empty((0, 3)), np.empty(0, dtype=int)
        if replayed.touchdowns:
            places = np.array([one.place for one in replayed.touchdowns])
            legs = np.array([one.leg for one in replayed.touchdowns])
        elif ahead is not None:
            places, legs = ahead.actual.reshape(-1, 3), ahead.legs.reshape(-1)
        for colour, side in ((_LEFT, (0, 2)), (_RIGHT, (1, 3))):
            ax.plot(*places[np.isin(legs, side), :2].T, ".", markersize=3, color=colour)
        bad = np.array([one.place for one in replayed.touchdowns if one.said == "unsafe"]).reshape(-1, 3)
        ax.plot(*bad[:, :2].T, "x", color=RED, markersize=6)
        ax.set_aspect("equal", adjustable="datalim")
        ax.set_xlabel("x [m]")
        ax.set_ylabel("y [m]")

    return paint
