"""Films as files: MP4 for a player, and a small animated WebP that stands in a page."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from legtool.datasets.files import replacing
from legtool.errors import OutputError

Frame = NDArray[np.uint8]

#: The animation's width [pixel], frames per second, longest duration [s] and quality.
_WIDTH, _RATE_HZ, _LONGEST_S, _QUALITY = 320, 10.0, 12.0, 55


def write_mp4(path: Path, frames: Sequence[Frame], *, rate_hz: float) -> None:
    """Write frames (h, w, 3) red, green, blue as an MP4 film; the first one alone where there are none.

    Raises:
        OutputError: it cannot be written.
    """
    if not frames:
        return
    height, width = frames[0].shape[:2]
    with replacing(path) as temporary:
        # OpenCV tells the container from the file's ending.
        film = temporary.with_suffix(".mp4")
        writer = cv2.VideoWriter(str(film), cv2.VideoWriter.fourcc(*"mp4v"), rate_hz, (width, height))
        if not writer.isOpened():
            raise OutputError(f"{path}: cannot be written as a film")
        for frame in frames:
            writer.write(frame[..., ::-1])
        writer.release()
        film.replace(temporary)


def write_animation(path: Path, frames: Sequence[Frame], *, rate_hz: float) -> None:
    """Write frames as an animated WebP that is small enough for a page; long walks are shown faster.

    Raises:
        OutputError: it cannot be written.
    """
    if not frames:
        return
    duration_s = len(frames) / rate_hz
    count = max(1, round(min(duration_s, _LONGEST_S) * _RATE_HZ))
    chosen = [frames[k] for k in np.linspace(0, len(frames) - 1, count).round().astype(int)]
    height = round(_WIDTH * frames[0].shape[0] / frames[0].shape[1])
    images = [Image.fromarray(cv2.resize(frame, (_WIDTH, height), interpolation=cv2.INTER_AREA)) for frame in chosen]
    buffer = io.BytesIO()
    images[0].save(
        buffer, "WEBP", save_all=True, append_images=images[1:], duration=round(1e3 / _RATE_HZ), loop=0,
        quality=_QUALITY, method=4,
    )  # fmt: skip
    with replacing(path) as temporary:
        temporary.write_bytes(buffer.getvalue())
