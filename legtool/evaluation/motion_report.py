"""The motion line's page: formulations side by side, velocity tracking, residuals, coverage, counts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from legtool.evaluation import motion_plots as plots
from legtool.evaluation.held_out import AXES, HeldOut
from legtool.evaluation.report.page import cell, metric_cell, origin, write_page
from legtool.evaluation.report.results import Metric
from legtool.verdict import Verdict

#: Rows of the comparison, in the order of the paper's Table I, and what each is called.
_ROWS = {
    "full": "full",
    "no_history": "without t−1 velocities and references",
    "no_feet": "without feet",
    "poly2": "second-order polynomial",
    "bayesian": "Bayesian",
    "poly2_bayesian": "second-order polynomial, Bayesian",
}
_COUNTS = {
    "steps": "steps used",
    "segments": "unbroken segments",
    "steps_without_history": "steps without a known step before",
    "gaps": "gaps in the log",
    "cut_off": "steps cut off by the ends of a recording",
    "standing_s": "standing [s]",
    "recorded_s": "recorded [s]",
    "command_changes": "commands that changed within a swing",
    "rows": "rows read",
}


def write_motion_report(
    path: Path, metrics: Mapping[str, Metric], held_out: HeldOut, provenance: Mapping[str, Any], verdict: Verdict
) -> None:
    """Write the motion line's page.

    Args:
        path: the HTML file.
        metrics: of ``evaluate_motion``.
        held_out: the predictions behind them.
        provenance: as written to ``results.json``.
        verdict: that the page begins with.

    Raises:
        OutputError: it cannot be written.
    """
    write_page(
        path,
        f"Motion models of {provenance.get('robot', 'the robot')}",
        _facts(held_out, provenance),
        [verdict.section(), *_sections(metrics, held_out, provenance)],
    )


def _facts(held_out: HeldOut, provenance: Mapping[str, Any]) -> list[tuple[str, str]]:
    episodes = len(set(held_out.steps.group.tolist()))
    return [
        ("steps", f"{len(held_out.steps):,} in {episodes} episode{'s' * (episodes != 1)}"),
        ("measured by", held_out.split),
        ("states at", str(provenance.get("instant", "")).replace("_", " ")),
        *origin(provenance),
    ]


def _sections(metrics: Mapping[str, Metric], held_out: HeldOut, provenance: Mapping[str, Any]) -> list[dict[str, Any]]:
    rows = [name for name in _ROWS if name in held_out.means]
    stance = [metrics[f"stance.foot_motion.{axis}.std"]["value"] * 1e3 for axis in "xyz"]
    counts = provenance.get("counts", {})
    sections: list[dict[str, Any]] = [
        {
            "title": "Four formulations side by side",
            "text": "FDM: footstep displacement model; CDM: displacement of the CoM (centre of mass; the trunk's "
            "origin as the robot reports it); CVM: CoM velocity after the step. Root mean square error (RMSE) on x "
            "over steps that were held out, with 95 % bootstrap intervals over blocks; the form of the motion paper's "
            "Table I. FDM pools both swing feet. The first four rows are least "
            f"squares; Bayesian is formulation {held_out.formulation.replace('_', ' ')} with shrinkage and intervals.",
            "table": _errors(metrics, rows, [(model, "x") for model in AXES], "rmse"),
            "details": [
                {"title": "All axes, RMSE", "table": _errors(metrics, rows, _pairs(), "rmse")},
                {"title": "All axes, mean absolute error", "table": _errors(metrics, rows, _pairs(), "mae")},
            ],
        },
        {
            "title": "Velocity tracking",
            "text": "What was commanded and how fast the robot was, at each step of the longest episode (the paper's "
            "Fig. 3). The lag between them is why the models need the step before.",
            "figure": plots.velocity_tracking(held_out),
        },
        {
            "title": "Predicted against measured",
            "text": "Held-out steps, full formulation, canonical swing pair FL+RR (steps of FR+RL mirrored).",
            "figure": plots.predicted_against_measured(held_out),
        },
        {
            "title": "Residuals by command",
            "text": "Residuals on x over the commanded forward velocity: median, quartiles, 5th to 95th percentile. A "
            "median off zero is a bias at that speed.",
            "figure": plots.residuals_by_command(held_out),
        },
        {
            "title": "Residuals by axis",
            "text": "Held-out residuals; the line is the normal distribution that the Bayesian models expect.",
            "figure": plots.residuals_by_axis(held_out),
        },
        {
            "title": "Interval coverage",
            "text": "Share of held-out steps inside the Bayesian models' 90 % intervals; the band is 85–95\u00a0%.",
            "figure": plots.coverage(held_out, metrics),
        },
        {
            "title": "What the steps were cut from",
            "text": f"Stance feet move {stance[0]:.1f}, {stance[1]:.1f}, {stance[2]:.1f} mm (σ of x, y, z) within a "
            "step: the floor under every error above, made of odometry, kinematics and slip.",
            "table": _counts(counts),
        },
    ]
    return [section for section in sections if section.get("table") != {"head": [], "rows": []}]


def _pairs() -> list[tuple[str, str]]:
    return [(model, axis) for model, axes in AXES.items() for axis in axes]


def _errors(
    metrics: Mapping[str, Metric], rows: Sequence[str], columns: Sequence[tuple[str, str]], kind: str
) -> dict[str, Any]:
    """Formulations down, models and axes across; the best of each column marked."""
    body = []
    for which in rows:
        cells = []
        for model, axis in columns:
            scale, _ = plots.scale_of(model, axis)
            entry = metrics[f"{model}.{which}.{axis}.{kind}"]
            best = min(metrics[f"{model}.{name}.{axis}.{kind}"]["value"] for name in rows)
            digits = 4 if model == "cvm" else 2 if axis == "yaw" else 1
            cells.append(metric_cell(entry, scale, digits, best=entry["value"] == best))
        body.append({"name": _ROWS[which], "cells": cells})
    head = [f"{model.upper()} {axis} [{plots.scale_of(model, axis)[1]}]" for model, axis in columns]
    return {"head": ["formulation", *head], "rows": body}


def _counts(counts: Mapping[str, float]) -> dict[str, Any]:
    named = {name: _COUNTS.get(name) or name.replace("stumble_", "stumbles: ").replace("_", " ") for name in counts}
    order = sorted(counts, key=lambda name: list(_COUNTS).index(name) if name in _COUNTS else len(_COUNTS))
    rows = [{"name": named[name], "cells": [cell(f"{counts[name]:,.6g}")]} for name in order]
    return {"head": ["counted", "number"] if rows else [], "rows": rows}
