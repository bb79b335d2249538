"""Predictions of a segmenter and their quality: confusion matrix and intersection over union."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from legtool.datasets.steppability.images import SceneImages
from legtool.models.steppability import CLASSES


def confusion_matrix(
    net: nn.Module, data: SceneImages, *, batch: int = 8, device: torch.device | None = None
) -> NDArray[np.int64]:
    """Return the numbers of pixels by true (row) and predicted (column) class, over all frames."""
    return np.sum(
        [confusion(p, t) for p, t in zip(predict(net, data, batch=batch, device=device), data.label, strict=True)],
        axis=0,
    )


def best_offset(
    logits: Iterable[NDArray[np.float32]], truth: Iterable[NDArray[np.uint8]], *, reach: float = 2.0, steps: int = 9
) -> NDArray[np.float32]:
    """Find the offsets (3,) of the class logits with the highest mean IoU on a grid; the first offset is 0.

    Among equally good offsets, the smallest are returned.

    Args:
        logits: (3, h, w) logits of each frame.
        truth: (h, w) labels of each frame, indices into LABELS.
        reach: largest offset in either direction.
        steps: number of grid points for each class.
    """
    values = np.linspace(-reach, reach, steps, dtype=np.float32)
    grid = np.array([(0.0, a, b) for a in values for b in values], dtype=np.float32)
    counts = np.zeros((len(grid), len(CLASSES), len(CLASSES)), dtype=np.int64)
    for scores, label in zip(logits, truth, strict=True):
        known = label > 0
        pixels = scores[:, known]
        for k, offset in enumerate(grid):
            counts[k] += confusion((pixels + offset[:, None]).argmax(axis=0).astype(np.uint8) + 1, label[known])
    mean = [round(float(np.nanmean(iou)), 4) for iou in iou_of(counts)]
    smallest = np.abs(grid).sum(axis=1).tolist()
    return grid[min(range(len(grid)), key=lambda k: (-mean[k], smallest[k]))]


def predict(
    net: nn.Module, data: SceneImages, *, batch: int = 8, device: torch.device | None = None
) -> Iterator[NDArray[np.uint8]]:
    """Yield the predicted labels (h, w) of each frame, indices into LABELS and never unknown."""
    for logits in predict_logits(net, data, batch=batch, device=device):
        yield (logits.argmax(0) + 1).astype(np.uint8)


def predict_logits(
    net: nn.Module, data: SceneImages, *, batch: int = 8, device: torch.device | None = None
) -> Iterator[NDArray[np.float32]]:
    """Yield the logits (3, h, w) of each frame."""
    net.eval()
    device = device or torch.device("cpu")
    for first in range(0, len(data), batch):
        index = np.arange(first, min(first + batch, len(data)))
        with torch.no_grad():
            logits = net(torch.from_numpy(data.metres(index)[:, None]).to(device))
        yield from logits.float().cpu().numpy()


def confusion(predicted: NDArray[np.uint8], truth: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return the numbers of pixels (3, 3) by true (row) and predicted (column) class, without unknown pixels."""
    n = len(CLASSES)
    known = (truth > 0) & (predicted > 0)
    pairs = (truth[known].astype(np.int64) - 1) * n + predicted[known] - 1
    return np.bincount(pairs, minlength=n * n).reshape(n, n)


def iou_of(matrix: NDArray[Any]) -> NDArray[np.float64]:
    """Return the IoU (..., 3) of each class from confusion (..., 3, 3); NaN if it occurs in neither labels."""
    hit = np.diagonal(matrix, axis1=-2, axis2=-1)
    union = matrix.sum(-1) + matrix.sum(-2) - hit
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(union > 0, hit / union, np.nan)
