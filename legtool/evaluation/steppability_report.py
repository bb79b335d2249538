"""The steppability line's page: curves, tables, confusion, the worst frames, and real frames with their prediction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from legtool.configs.steppability import SteppabilityEvalSettings
from legtool.configs.world_parts import SHAPES
from legtool.datasets.steppability.contact_sheet import depth_colours
from legtool.datasets.steppability.real_frames import read_real_frames
from legtool.datasets.steppability.scenes import LABEL_COLOURS
from legtool.evaluation.report.drawing import draw
from legtool.evaluation.report.page import cell, metric_cell, origin, write_page
from legtool.evaluation.report.results import Metric
from legtool.evaluation.segmentation_scores import SegmentedFrames, segment_real, slice_names, worst_frames
from legtool.models.steppability import CLASSES
from legtool.models.steppability_run import SteppabilityRun
from legtool.verdict import Verdict
from legtool_runtime.perception.depth import fill_holes, fit_camera

_COLOURS = dict(zip(CLASSES, ("#3caa46", "#c9a400", "#d73232"), strict=True))
Image = NDArray[np.uint8]


def write_steppability_report(
    path: Path,
    metrics: Mapping[str, Metric],
    measured: SegmentedFrames,
    run: SteppabilityRun,
    provenance: Mapping[str, Any],
    settings: SteppabilityEvalSettings,
    verdict: Verdict,
) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        metrics: as written to ``results.json``.
        measured: the predictions behind them.
        run: that was measured.
        provenance: as written to ``results.json``.
        settings: what to show.
        verdict: that the page begins with.

    Raises:
        OutputError: it cannot be written.
        DatasetError: real frames that cannot be read.
    """
    worst = worst_frames(measured, settings.worst)
    sections: list[dict[str, Any]] = [
        verdict.section(),
        {
            "title": "IoU by class",
            "text": "Intersection over union (IoU; mIoU: its mean over classes) on noisy depth, pixels without return "
            "left out, with 95 % bootstrap intervals over scenes. Boundary: within "
            f"{settings.boundary} pixels of another label.",
            "table": _iou_table(metrics, ["", "boundary.", "interior."], ["all", "boundary", "interior"]),
        },
        {
            "title": "Loss and IoU while training",
            "text": "Training loss, and IoU on the validation scenes (the paper's Fig. 8).",
            "figure": training_curves(run.description["history"]),
        },
        {
            "title": "Confusion",
            "text": "Share of the pixels of each true class (row) that were said to be of each class (column).",
            "table": _confusion_table(metrics),
        },
        {
            "title": "By range",
            "table": _iou_table(
                metrics,
                [f"{name}." for name in slice_names(settings) if name.startswith("range.")],
                [name.removeprefix("range.").replace("_", "–") for name in slice_names(settings) if "range." in name],
            ),
        },
        {
            "title": "By class of shape",
            "text": "Share of the pixels of each class of shape that were labelled rightly.",
            "table": _shape_table(metrics),
        },
        {
            "title": "Worst frames",
            "text": "The lowest mean IoU, one frame of each scene: depth, truth, prediction.",
            "figure": sheet(
                [_row(measured, n) for n in worst],
                [
                    f"scene {measured.images.scene[n]} frame {measured.images.frame[n]}: "
                    f"mIoU {measured.frame_iou[n]:.2f}"
                    for n in worst
                ],
            ),
        },
    ]
    if settings.real_frames is not None:
        sections.append(_real(run, Path(settings.real_frames)))
    facts = [
        ("frames", f"{len(measured.images)} in {len(measured.counts)} scenes, {provenance['split']}"),
        ("run", f"{provenance['run']}, best epoch {run.description['best']['epoch']}"),
        *origin(provenance),
    ]
    write_page(path, f"Steppability of {provenance['robot']}", facts, sections)


def training_curves(history: Sequence[Mapping[str, Any]]) -> str:
    """Loss and IoU over epochs, as SVG."""
    epochs = [entry["epoch"] for entry in history]

    def paint(figure: Figure) -> None:
        left, right = figure.subplots(1, 2)
        left.plot(epochs, [entry["loss"] for entry in history], marker=".", color="#1f5fa8")
        left.set(title="training loss", xlabel="epoch", ylim=(0, None))
        for c, name in enumerate(CLASSES):
            right.plot(epochs, [entry["iou"][c] for entry in history], marker=".", color=_COLOURS[name], label=name)
        right.plot(epochs, [entry["miou"] for entry in history], marker=".", color="#111827", label="mean")
        right.set(title="validation IoU", xlabel="epoch", ylim=(0, 1))
        right.legend(frameon=False, loc="lower right")

    return draw(paint, 8.6, 3.0)


def sheet(rows: Sequence[Image], titles: Sequence[str]) -> str:
    """Rows of pictures with titles, as SVG."""
    if not rows:
        return ""

    def paint(figure: Figure) -> None:
        for ax, row, title in zip(np.atleast_1d(figure.subplots(len(rows), 1)), rows, titles, strict=True):
            ax.imshow(row, interpolation="nearest")
            ax.set_title(title, loc="left")
            ax.set_axis_off()

    height = sum(8.4 * row.shape[0] / row.shape[1] + 0.3 for row in rows)
    return draw(paint, 8.6, height)


def real_pictures(run: SteppabilityRun, path: Path) -> list[tuple[str, Image]]:
    """Name and picture, depth beside prediction over depth, of the real frames of a directory.

    They are brought to the camera that the segmenter knows, and their small holes filled; what was not in that
    camera's view stays black.
    """
    pictures = []
    for frame in read_real_frames(path):
        depth = fill_holes(fit_camera(frame.depth, frame.camera, run.camera))
        label = segment_real(run, depth)
        shaded = depth_colours(depth)
        mixed = (0.35 * shaded.mean(axis=2, keepdims=True) + 0.65 * LABEL_COLOURS[label]).astype(np.uint8)
        mixed[label == 0] = 0
        pictures.append((frame.name, _small(np.concatenate([shaded, mixed], axis=1))))
    return pictures


def _real(run: SteppabilityRun, path: Path) -> dict[str, Any]:
    pictures = real_pictures(run, path)
    return {
        "title": "Real frames",
        "text": "Depth of a real sensor, which nobody labelled, and what the segmenter says of it: green steppable, "
        "yellow passable, red non-passable. Its camera is mounted otherwise than the simulated one.",
        "figure": sheet([picture for _, picture in pictures], [name for name, _ in pictures]),
    }


def _row(measured: SegmentedFrames, n: int) -> Image:
    depth = measured.images.metres(n)
    depth[depth == 0] = np.nan
    known = measured.images.label[n] > 0
    said = np.where(known, measured.predicted[n], 0)
    parts = [depth_colours(depth), LABEL_COLOURS[measured.images.label[n]], LABEL_COLOURS[said]]
    return _small(np.concatenate(parts, axis=1))


def _small(picture: Image) -> Image:
    """At most 720 pixels wide, so that the page stays light."""
    width = min(720, picture.shape[1])
    size = (width, round(picture.shape[0] * width / picture.shape[1]))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _iou_table(metrics: Mapping[str, Metric], prefixes: Sequence[str], names: Sequence[str]) -> dict[str, Any]:
    columns = ["miou", *(f"iou.{name}" for name in CLASSES), "accuracy"]
    rows = [
        {"name": name, "cells": [metric_cell(metrics.get(f"steppability.{prefix}{column}")) for column in columns]}
        for prefix, name in zip(prefixes, names, strict=True)
    ]
    return {"head": ["pixels", "mean IoU", *CLASSES, "accuracy"], "rows": rows}


def _confusion_table(metrics: Mapping[str, Metric]) -> dict[str, Any]:
    rows = [
        {"name": true, "cells": [metric_cell(metrics.get(f"steppability.confusion.{true}.{said}")) for said in CLASSES]}
        for true in CLASSES
    ]
    return {"head": ["is / was said to be", *CLASSES], "rows": rows}


def _shape_table(metrics: Mapping[str, Metric]) -> dict[str, Any]:
    found = {shape: metrics.get(f"steppability.shape.{shape}.accuracy") for shape in SHAPES}
    rows = [
        {"name": shape, "cells": [metric_cell(entry), cell(f"{entry['n']:,}")]}
        for shape, entry in found.items()
        if entry is not None
    ]
    return {"head": ["shape", "accuracy", "pixels"], "rows": rows}
