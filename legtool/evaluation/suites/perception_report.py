"""The page of ``eval perception``: figures on exact and noisy depth beside the baseline's, and walks from above."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from legtool.evaluation.report.drawing import GREY, RED, draw
from legtool.evaluation.report.page import Cell, metric_cell, origin, write_page
from legtool.evaluation.report.results import Metric
from legtool.evaluation.suites.perception_walk import DEPTHS, ScoredWalk
from legtool.verdict import Verdict

#: Rows of the table: metric, heading, factor, digits.
_ROWS = (
    ("region_purity", "regions wholly on one planar face [%]", 100.0, 1),
    ("area_purity", "the same by area [%]", 100.0, 1),
    ("overhang", "area over edges [%]", 100.0, 2),
    ("overhang_untrimmed", "before it is trimmed [%]", 100.0, 2),
    ("coverage", "steppable floor covered [%]", 100.0, 1),
    ("coverage_any_range", "the same, of all that was ever in view [%]", 100.0, 1),
    ("height_error", "height error, mean [mm]", 1e3, 2),
    ("normal_error", "normal error, mean [°]", 180 / np.pi, 2),
    ("region_area", "mean area of a region [dm²]", 100.0, 2),
    ("uneven.region_purity", "uneven floors: regions within the tolerance [%]", 100.0, 1),
    ("uneven.height_error", "uneven floors: height error [mm]", 1e3, 2),
    ("assumed.region_purity", "assumed ground: regions on one face [%]", 100.0, 1),
)
_MOTION = (("jitter", "way of a region's middle to the next frame [mm]", 1e3, 1), ("overlap", "overlap [%]", 100.0, 1))
_METHODS = {"warm": "warm start", "cold": "from scratch", "baseline": "baseline"}


def write_perception_report(
    path: Path,
    metrics: Mapping[str, Metric],
    provenance: Mapping[str, Any],
    drawings: Sequence[tuple[str, str]],
    verdict: Verdict,
) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        metrics: as in ``results.json``.
        provenance: as in ``results.json``.
        drawings: title and SVG of each walk that is shown.
        verdict: that the page begins with.

    Raises:
        OutputError: it cannot be written.
    """
    settings = provenance["settings"]
    columns = [("exact depth", ""), ("noisy depth", "noisy."), ("baseline, noisy depth", "noisy.baseline.")]

    def figure(name: str, factor: float, digits: int) -> Cell:
        return metric_cell(metrics.get(f"perception.{name}"), factor, digits)

    rows = [
        {"name": title, "cells": [figure(f"{prefix}{name}", factor, digits) for _, prefix in columns]}
        for name, title, factor, digits in _ROWS
    ]
    motion = [
        {
            "name": f"{title}, {depth} depth",
            "cells": [figure(f"{prefix}{name}_{method}", factor, digits) for method in _METHODS],
        }
        for name, title, factor, digits in _MOTION
        for depth, prefix in zip(DEPTHS, ("", "noisy."), strict=True)
    ]
    sections: list[dict[str, Any]] = [
        verdict.section(),
        {
            "title": "Regions",
            "text": f"A region lies on a face if it is within {1e3 * settings['tolerance']:g} mm of it everywhere, in "
            "height and beyond its rim. Covered: of the steppable ground that lies within the floor image's reach and "
            "was in view there. Normals and heights against the true face below. The baseline cuts planes out of an "
            f"elevation map of {1e3 * settings['baseline_resolution_m']:g} mm, from the same images; its pieces are "
            "whole surfaces, so compare purity by area.",
            "table": {"head": ["", *(title for title, _ in columns)], "rows": rows},
        },
        {
            "title": "From frame to frame",
            "text": "Each region and the one in the next frame that shares most with it, in the world; the robot walks "
            "on, and nothing else moves.",
            "table": {"head": ["", *_METHODS.values()], "rows": motion},
        },
    ]
    sections += [
        {
            "title": title,
            "text": "From above, noisy depth: height in grey, what is no place for a foot dark; regions in green, red "
            "where they do not lie on one face, dashed where ground is assumed. Right: the baseline's planes.",
            "figure": drawing,
        }
        for title, drawing in drawings
    ]
    facts = [
        ("robot", str(provenance["robot"])),
        ("labels", str(provenance["labels"])),
        ("walks", f"{settings['sequences']} of {settings['frames']} frames, each through a scene of its own"),
        ("intervals", "95 %, bootstrap over walks"),
        *origin(provenance, hashed=None),
    ]
    write_page(path, "Perception: planar regions", facts, sections)


def draw_walk(walk: ScoredWalk) -> str:
    """Regions and baseline planes of the last scored noisy frame from above, as SVG."""
    picture, truth = walk.pictures["noisy"], walk.truth
    nx, ny = truth.faces.shape
    x0, y0 = truth.corner
    extent = (y0 + ny * truth.resolution_m, y0, x0, x0 + nx * truth.resolution_m)
    heights = np.where(truth.free, 0.55 + 0.4 * np.clip(truth.heights / 0.6, 0, 1), 0.15)
    step = 2  # the page stays light
    planes = np.full(truth.faces.size, np.nan)
    sizes = np.diff(picture.planes.start)
    planes[picture.planes.cells] = np.repeat(np.arange(len(picture.planes)) * 7 % 10, sizes)
    around = 1.35

    def paint(figure: Figure) -> None:
        left, right = figure.subplots(1, 2)
        for ax, title in ((left, "regions"), (right, "baseline")):
            # Ahead is up, left is left.
            ax.imshow(heights[::step, ::step][::-1, ::-1], cmap="gray", vmin=0, vmax=1, extent=extent)
            ax.plot(picture.robot[1], picture.robot[0], marker="^", color="#1f5fa8", markersize=9)
            ax.set(
                title=title,
                xlim=(picture.robot[1] + around, picture.robot[1] - around),
                ylim=(picture.robot[0] - around, picture.robot[0] + around),
                xlabel="left [m]",
            )
            ax.grid(False)
            ax.set_aspect("equal")
        left.set_ylabel("ahead [m]")
        for outline, pure, assumed in zip(picture.regions, picture.pure, picture.assumed, strict=True):
            colour = "#2e9e44" if pure else RED
            style = {"linestyle": "--", "edgecolor": GREY, "fill": False} if assumed else {"edgecolor": colour}
            left.add_patch(Polygon(outline[:, ::-1], facecolor=f"{colour}55", linewidth=1.0, **style))
        picture_of_planes = planes.reshape(truth.faces.shape)[::step, ::step][::-1, ::-1]
        right.imshow(picture_of_planes, cmap="tab10", vmin=0, vmax=10, alpha=0.7, extent=extent)

    return draw(paint, 8.6, 4.5)
