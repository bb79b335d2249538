"""Count a segmenter's pixels by class, place and range, and what the counts come to, with intervals over scenes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from legtool.configs.steppability import SteppabilityEvalSettings
from legtool.configs.world_parts import SHAPES
from legtool.datasets.steppability.images import SceneImages
from legtool.evaluation.report.intervals import BlockBootstrap
from legtool.evaluation.report.results import Metric, metric
from legtool.models.scores import confusion, iou_of, predict
from legtool.models.steppability import CLASSES
from legtool.models.steppability_run import SteppabilityRun


@dataclass(frozen=True, eq=False)
class SegmentedFrames:
    """Predictions of the test frames, counted.

    Attributes:
        images: the frames.
        predicted: (n, h, w) of LABELS.
        slices: names of the parts of the images that are counted apart: ``all``, ``boundary``, ``shape.cuboid``, ….
        counts: (scenes, slices, 3, 3) pixels by true (row) and predicted (column) class.
        frame_iou: (n,) mean IoU of each frame over the classes that are there.
    """

    images: SceneImages
    predicted: NDArray[np.uint8]
    slices: tuple[str, ...]
    counts: NDArray[np.int64]
    frame_iou: NDArray[np.float64]


def measure(net: torch.nn.Module, images: SceneImages, settings: SteppabilityEvalSettings) -> SegmentedFrames:
    """Predict every frame and count its pixels by slice."""
    slices = slice_names(settings)
    scenes, number = np.unique(images.scene, return_inverse=True)
    counts = np.zeros((len(scenes), len(slices), len(CLASSES), len(CLASSES)), dtype=np.int64)
    predicted = np.empty_like(images.label)
    frame_iou = np.empty(len(images))
    for n, labels in enumerate(predict(net, images)):
        predicted[n] = labels
        truth = images.label[n]
        masks = slice_masks(images.metres(n), truth, images.shape[n], settings)
        for k, mask in enumerate(masks):
            counts[number[n], k] += confusion(labels[mask], truth[mask])
        # Of the classes that are there: a few wrong pixels of another would make a good frame one of the worst.
        whole = confusion(labels, truth)
        frame_iou[n] = _mean(np.where(whole.sum(axis=1) > 0, iou_of(whole), np.nan))
    return SegmentedFrames(images, predicted, slices, counts, frame_iou)


def slice_names(settings: SteppabilityEvalSettings) -> tuple[str, ...]:
    """Names of what is counted apart, in order."""
    edges = settings.ranges_m
    ranges = [f"range.{near:g}_{far:g}m" for near, far in pairwise(edges)]
    return ("all", "boundary", "interior", *ranges, *(f"shape.{shape}" for shape in SHAPES))


def slice_masks(
    depth: NDArray[np.float32], label: NDArray[np.uint8], shape: NDArray[np.uint8], settings: SteppabilityEvalSettings
) -> Iterator[NDArray[np.bool_]]:
    """The pixels (h, w) of each slice, in the order of their names."""
    side = 2 * settings.boundary + 1
    window = np.ones((side, side), np.uint8)
    # Within reach of another label the largest and the smallest label around a pixel differ; unknown is no label.
    high = cv2.dilate(label, window)
    low = cv2.erode(np.where(label == 0, 255, label).astype(np.uint8), window)
    boundary = high != low
    yield np.ones(label.shape, dtype=bool)
    yield boundary
    yield ~boundary
    for near, far in pairwise(settings.ranges_m):
        yield (depth > near) & (depth <= far)
    for number in range(len(SHAPES)):
        yield shape == number + 1


def steppability_metrics(measured: SegmentedFrames, settings: SteppabilityEvalSettings) -> dict[str, Metric]:
    """All metrics, with 95 % intervals from a bootstrap over scenes."""
    scenes = len(measured.counts)
    bootstrap = BlockBootstrap(scenes, samples=settings.bootstrap, seed=settings.seed)
    total = measured.counts.sum(axis=0)
    drawn = bootstrap.totals(measured.counts)
    metrics: dict[str, Metric] = {}

    def add(name: str, value: float, resampled: NDArray[np.float64], held: NDArray[np.int64], n: int) -> None:
        if np.isfinite(value):
            metrics[f"steppability.{name}"] = metric(value, bootstrap.interval(resampled, held), n, "1")

    for k, name in enumerate(measured.slices):
        prefix = "" if name == "all" else f"{name}."
        pixels = int(total[k].sum())
        if not pixels:
            continue
        counts = measured.counts[:, k]
        held = counts.sum(axis=(1, 2))
        add(f"{prefix}accuracy", float(_accuracy(total[k])), _accuracy(drawn[:, k]), held, pixels)
        if name.startswith("shape."):
            continue  # the pixels of one shape know two classes at most: IoU would tell of their shares
        iou, resampled = iou_of(total[k]), iou_of(drawn[:, k])
        add(f"{prefix}miou", float(_mean(iou)), _mean(resampled), held, pixels)
        for c, label in enumerate(CLASSES):
            there = counts[:, c].sum(axis=1) + counts[:, :, c].sum(axis=1)
            add(f"{prefix}iou.{label}", float(iou[c]), resampled[:, c], there, int(total[k, c].sum()))
    truth = measured.counts[:, 0].sum(axis=2)
    for i, true in enumerate(CLASSES):
        n = int(truth[:, i].sum())
        for j, said in enumerate(CLASSES):
            value = float(total[0, i, j] / max(n, 1))
            interval = bootstrap.ratio(measured.counts[:, 0, i, j], truth[:, i])
            metrics[f"steppability.confusion.{true}.{said}"] = metric(value, interval, n, "1")
    metrics["steppability.scenes"] = metric(scenes, None, scenes, "1")
    metrics["steppability.frames"] = metric(len(measured.images), None, len(measured.images), "1")
    return metrics


def worst_frames(measured: SegmentedFrames, count: int) -> NDArray[np.intp]:
    """Frames with the lowest mean IoU, the worst first, at most one of each scene."""
    order = np.argsort(np.nan_to_num(measured.frame_iou, nan=2.0), kind="stable")
    _, first = np.unique(measured.images.scene[order], return_index=True)
    return order[np.sort(first)][:count]


def _mean(iou: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean (...,) over the classes that there are, of IoU (..., 3); NaN where there is none."""
    known = np.isfinite(iou)
    with np.errstate(invalid="ignore"):
        return np.where(known, iou, 0).sum(axis=-1) / known.sum(axis=-1)


def _accuracy(matrix: NDArray[Any]) -> NDArray[np.float64]:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.trace(matrix, axis1=-2, axis2=-1) / matrix.sum(axis=(-2, -1))


def segment_real(run: SteppabilityRun, depth: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Label (h, w), 0 without return, of one prepared image (h, w) [m] of the run's camera."""
    with torch.no_grad():
        logits = run.net(torch.from_numpy(depth[None, None]))
    label = (logits.argmax(1)[0].numpy() + 1).astype(np.uint8)
    label[np.isnan(depth)] = 0
    return label
