"""Datasets of labelled scenes: one row per frame, its images as PNG bytes that any viewer opens.

``depth`` is 16-bit, in millimetres, 0 without return; ``label`` green, yellow, red and black; ``shape`` a grey value
for each class; ``colour`` the scene as a person would see it, at half the size.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from legtool.datasets.store import load_manifest, verify
from legtool.errors import DatasetError
from legtool_runtime.perception import LABELS, NON_PASSABLE, PASSABLE, STEPPABLE

KIND = "scenes"
Split = Literal["train", "validation", "test"]
SPLITS: tuple[Split, ...] = ("train", "validation", "test")
#: Share of scenes in each.
SHARES = (0.8, 0.1, 0.1)

SCHEMA = pa.schema(
    [
        ("scene", pa.int32()),
        ("frame", pa.int16()),
        ("split", pa.string()),
        ("placement", pa.string()),
        ("indoor", pa.bool_()),
        ("pose", pa.list_(pa.float64(), 16)),
        ("depth", pa.binary()),
        ("label", pa.binary()),
        ("shape", pa.binary()),
        ("colour", pa.binary()),
    ]
)

#: Red, green, blue of each label.
LABEL_COLOURS = np.array([(0, 0, 0), (60, 170, 70), (235, 200, 40), (215, 50, 50)], dtype=np.uint8)
assert len(LABEL_COLOURS) == len(LABELS)
#: Grey values between one class of shapes and the next.
_GREY_STEP = 25
#: Fast compression: noise does not compress further.
_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)


class SceneFrame(NamedTuple):
    """One frame.

    ``depth`` (h, w) float32 [m], NaN without return; ``label`` (h, w) of LABELS; ``shape`` (h, w) number of the class
    plus one, 0 without return; ``colour`` (h / 2, w / 2, 3) red, green, blue; ``pose`` (4, 4) optical frame to world.
    """

    scene: int
    frame: int
    split: Split
    placement: str
    indoor: bool
    pose: NDArray[np.float64]
    depth: NDArray[np.float32]
    label: NDArray[np.uint8]
    shape: NDArray[np.uint8]
    colour: NDArray[np.uint8]


def split_scenes(scenes: int, seed: int) -> list[Split]:
    """The split of each scene: shares of SHARES, at random; with fewer than three scenes all are for training."""
    tested = max(round(SHARES[2] * scenes), 1) if scenes >= 3 else 0
    validated = max(round(SHARES[1] * scenes), 1) if scenes >= 3 else 0
    order = np.random.default_rng([seed, scenes]).permutation(scenes)
    splits: list[Split] = ["train"] * scenes
    for scene in order[:tested]:
        splits[scene] = "test"
    for scene in order[tested : tested + validated]:
        splits[scene] = "validation"
    return splits


def frames_table(frames: Sequence[SceneFrame]) -> pa.Table:
    """Frames as a table with SCHEMA."""
    rows = [
        {
            **frame._asdict(),
            "pose": frame.pose.ravel().tolist(),
            "depth": encode_depth(frame.depth),
            "label": _encode(LABEL_COLOURS[frame.label][..., ::-1]),
            "shape": _encode(frame.shape * np.uint8(_GREY_STEP)),
            "colour": _encode(frame.colour[..., ::-1]),
        }
        for frame in frames
    ]
    return pa.Table.from_pylist(rows, schema=SCHEMA)


def read_frames(
    path: Path, *, columns: Sequence[str] | None = None, splits: Sequence[Split] = SPLITS
) -> Iterator[dict[str, Any]]:
    """Frames of a dataset one after the other, in bounded memory.

    Args:
        path: the dataset, which must be checked before (:func:`check_scenes`).
        columns: fields of SceneFrame to read and decode, with ``split`` among them; none: all.
        splits: whose frames; the others are not decoded.
    """
    for part in load_manifest(path)["parts"]:
        file = pq.ParquetFile(path / part["name"])
        for batch in file.iter_batches(batch_size=16, columns=None if columns is None else list(columns)):
            for row in batch.to_pylist():
                if row["split"] in splits:
                    yield decode_row(row)


def check_scenes(path: Path) -> dict[str, Any]:
    """The manifest of a finished dataset of scenes, every part's hash verified.

    Raises:
        DatasetError: not a dataset, another kind, unfinished, newer than this legtool, or altered.
    """
    manifest = load_manifest(path)
    if manifest["kind"] != KIND:
        raise DatasetError(f"{path}: holds a {manifest['kind']} dataset, expected one of collect scenes")
    if not manifest.get("complete"):
        raise DatasetError(f"{path}: the dataset is not finished; run its collect command again to carry on")
    verify(path, manifest["parts"], SCHEMA)
    return manifest


def encode_depth(depth: NDArray[np.float32]) -> bytes:
    """16-bit PNG in millimetres of depth [m], NaN as 0."""
    return _encode(np.nan_to_num(depth * np.float32(1000) + np.float32(0.5)).astype(np.uint16))


def decode_depth(data: bytes) -> NDArray[np.float32]:
    """Depth [m] of a 16-bit PNG in millimetres, 0 as NaN.

    Raises:
        DatasetError: not such a PNG.
    """
    image = _decode(data, cv2.IMREAD_UNCHANGED)
    if image.dtype != np.uint16 or image.ndim != 2:
        raise DatasetError(f"depth image: {image.dtype} with {image.ndim} axes, expected a 16-bit grey PNG")
    return np.where(image > 0, image * np.float32(0.001), np.float32(np.nan))


def decode_row(row: dict[str, Any]) -> dict[str, Any]:
    """A row of the table with its images decoded, as far as they were read.

    Raises:
        DatasetError: an image that is not a PNG.
    """
    if "pose" in row:
        row["pose"] = np.array(row["pose"]).reshape(4, 4)
    if "depth" in row:
        row["depth"] = decode_depth(row["depth"])
    if "label" in row:
        # Green and red tell the four label colours apart.
        image = _decode(row["label"], cv2.IMREAD_COLOR)
        green, red = image[..., 1] > 127, image[..., 2] > 127
        row["label"] = np.array([0, STEPPABLE, NON_PASSABLE, PASSABLE], np.uint8)[green + 2 * red.astype(np.uint8)]
    if "shape" in row:
        row["shape"] = _decode(row["shape"], cv2.IMREAD_UNCHANGED) // _GREY_STEP
    if "colour" in row:
        row["colour"] = _decode(row["colour"], cv2.IMREAD_COLOR)[..., ::-1]
    return row


def _encode(image: NDArray[Any]) -> bytes:
    return bytes(cv2.imencode(".png", image, _PNG)[1].data)


def _decode(data: bytes, flags: int) -> NDArray[Any]:
    image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    if image is None:
        raise DatasetError("an image of the dataset is not a PNG; collect the dataset again")
    return np.asarray(image)
