"""The frames of a dataset of scenes as the segmenter sees them: prepared as on the robot, and held in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from legtool.datasets.steppability.scenes import Split, read_frames
from legtool.errors import DatasetError
from legtool_runtime.perception import LABELS
from legtool_runtime.perception.depth import FACTOR, PREPARATION, prepare


@dataclass(frozen=True, eq=False)
class SceneImages:
    """Frames of one or more splits.

    Attributes:
        depth: (n, h, w) prepared, [mm], 0 without return.
        label: (n, h, w) of LABELS, unknown where there is no return.
        shape: (n, h, w) number of the class of shape plus one.
        scene: (n,) number of each frame's scene.
        frame: (n,) number in its scene.
    """

    depth: NDArray[np.uint16]
    label: NDArray[np.uint8]
    shape: NDArray[np.uint8]
    scene: NDArray[np.int32]
    frame: NDArray[np.int16]

    def __len__(self) -> int:
        return len(self.depth)

    def metres(self, index: int | NDArray[np.intp]) -> NDArray[np.float32]:
        """Prepared depth of some frames [m], 0 without return."""
        return self.depth[index].astype(np.float32) * np.float32(0.001)


def load_scene_images(path: Path, splits: Sequence[Split], *, steps: Sequence[str] = PREPARATION) -> SceneImages:
    """Decode and prepare the frames of some splits.

    A pixel's label is the commonest of the block that preparation makes it of, and unknown, which neither loss nor IoU
    counts, where the block has none or the prepared image has no return.

    Args:
        path: a dataset of scenes, checked before.
        splits: whose frames.
        steps: of preparation.

    Raises:
        DatasetError: no frame in these splits.
    """
    wanted = list(read_frames(path, columns=["scene", "frame", "split"], splits=splits))
    if not wanted:
        raise DatasetError(f"{path}: no frame for {' and '.join(splits)}; collect at least 3 scenes")
    block = FACTOR ** list(steps).count("decimate")
    images: SceneImages | None = None
    n = 0
    for row in read_frames(path, columns=["split", "depth", "label", "shape"], splits=splits):
        depth = prepare(row["depth"], steps)
        if images is None:
            shape = (len(wanted), *depth.shape)
            images = SceneImages(
                np.empty(shape, np.uint16),
                np.empty(shape, np.uint8),
                np.empty(shape, np.uint8),
                np.array([row["scene"] for row in wanted], np.int32),
                np.array([row["frame"] for row in wanted], np.int16),
            )
        images.depth[n] = np.nan_to_num(depth * np.float32(1000) + np.float32(0.5))
        images.label[n] = np.where(images.depth[n] > 0, commonest(row["label"], block), 0)
        images.shape[n] = row["shape"][::block, ::block][: depth.shape[0], : depth.shape[1]]
        n += 1
    assert images is not None and n == len(wanted)
    return images


def commonest(label: NDArray[np.uint8], block: int) -> NDArray[np.uint8]:
    """The commonest known label of each block × block pixels, of equals the first in LABELS; 0 where none is known."""
    h, w = label.shape[0] // block, label.shape[1] // block
    blocks = label[: h * block, : w * block].reshape(h, block, w, block)
    counts = np.stack([(blocks == k).sum(axis=(1, 3)) for k in range(1, len(LABELS))])
    return np.where(counts.any(axis=0), counts.argmax(axis=0) + 1, 0).astype(np.uint8)
