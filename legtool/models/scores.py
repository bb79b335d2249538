"""What a segmenter says of frames, and how right it is: predictions, confusion, intersection over union."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from legtool.datasets.scene_images import SceneImages
from legtool.models.steppability import CLASSES


def confusion_matrix(
    net: nn.Module, data: SceneImages, *, batch: int = 8, device: torch.device | None = None
) -> NDArray[np.int64]:
    """Pixels by true (row) and predicted (column) class, over all frames."""
    return np.sum(
        [confusion(p, t) for p, t in zip(predict(net, data, batch=batch, device=device), data.label, strict=True)],
        axis=0,
    )


def predict(
    net: nn.Module, data: SceneImages, *, batch: int = 8, device: torch.device | None = None
) -> Iterator[NDArray[np.uint8]]:
    """The predicted label (h, w), of LABELS and never unknown, of each frame in turn."""
    net.eval()
    device = device or torch.device("cpu")
    for first in range(0, len(data), batch):
        index = np.arange(first, min(first + batch, len(data)))
        with torch.no_grad():
            logits = net(torch.from_numpy(data.metres(index)[:, None]).to(device))
        yield from (logits.argmax(1).cpu().numpy() + 1).astype(np.uint8)


def confusion(predicted: NDArray[np.uint8], truth: NDArray[np.uint8]) -> NDArray[np.int64]:
    """(3, 3) pixels by true (row) and predicted (column) class; where either is unknown they are left out."""
    n = len(CLASSES)
    known = (truth > 0) & (predicted > 0)
    pairs = (truth[known].astype(np.int64) - 1) * n + predicted[known] - 1
    return np.bincount(pairs, minlength=n * n).reshape(n, n)


def iou_of(matrix: NDArray[Any]) -> NDArray[np.float64]:
    """(..., 3) intersection over union of each class of confusion (..., 3, 3); NaN where it neither is nor was said."""
    hit = np.diagonal(matrix, axis1=-2, axis2=-1)
    union = matrix.sum(-1) + matrix.sum(-2) - hit
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(union > 0, hit / union, np.nan)
