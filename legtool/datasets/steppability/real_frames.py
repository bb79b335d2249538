"""Depth frames of a real sensor: 16-bit PNGs in millimetres, and one JSON file with the camera's intrinsics."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from legtool.errors import DatasetError
from legtool_runtime.perception.camera import Camera, as_metres


class RealFrame(NamedTuple):
    """One frame: its file's name, depth (h, w) float32 [m] with NaN without return, and the camera."""

    name: str
    depth: NDArray[np.float32]
    camera: Camera


def read_real_frames(path: Path) -> list[RealFrame]:
    """All frames of a directory, by name.

    The JSON holds ``width``, ``height`` and ``intrinsic_matrix``, nine numbers column by column, as Open3D writes it.

    Raises:
        DatasetError: no frames, no intrinsics, or a PNG that is not 16-bit grey.
        PerceptionError: intrinsics that do not fit, or an image without any return.
    """
    files = sorted(path.glob("*.png"))
    described = sorted(path.glob("*.json"))
    if not files or len(described) != 1:
        raise DatasetError(f"{path}: {len(files)} PNG and {len(described)} JSON files, expected frames and one JSON")
    try:
        values = json.loads(described[0].read_text())
        matrix = [float(x) for x in values["intrinsic_matrix"]]
        camera = Camera(int(values["width"]), int(values["height"]), matrix[0], matrix[4], matrix[6], matrix[7])
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise DatasetError(f"{described[0]}: expected width, height and intrinsic_matrix (9 numbers)") from error
    frames = []
    for file in files:
        image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        if image is None or image.dtype != np.uint16 or image.ndim != 2:
            raise DatasetError(f"{file}: expected a 16-bit grey PNG in millimetres")
        frames.append(RealFrame(file.name, as_metres(image, camera), camera))
    return frames
