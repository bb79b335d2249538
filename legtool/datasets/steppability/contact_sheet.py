"""Datasets of scenes for a person to look at: one picture of many frames, and what they hold in words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from legtool.datasets.files import replacing
from legtool.datasets.steppability.scenes import LABEL_COLOURS, check_scenes, decode_row
from legtool.datasets.store import data_hash, read_part
from legtool_runtime.perception import LABELS

CONTACT_SHEET = "contact_sheet.png"


def describe_scenes(path: Path) -> list[str]:
    """What a finished dataset of scenes holds, in lines for a terminal; draws its contact sheet beside its parts.

    Raises:
        DatasetError: no finished dataset of scenes, or an altered one.
        OutputError: the picture cannot be written.
    """
    manifest = check_scenes(path)
    counts = manifest["counts"]
    pixels = {name: counts[f"pixels_{name}"] for name in LABELS}
    shares = ", ".join(f"{name.replace('_', '-')} {n / sum(pixels.values()):.1%}" for name, n in pixels.items())
    file = path / CONTACT_SHEET
    picture = cv2.imencode(".png", contact_sheet(path)[..., ::-1])[1]
    with replacing(file) as temporary:
        temporary.write_bytes(bytes(picture.data))
    return [
        f"{path}: scenes dataset of {manifest['robot']['name']}",
        f"  {counts['frames']:g} frames of {counts['scenes']:g} scenes in {len(manifest['parts'])} parts, "
        f"seed {manifest['seed']}, commit {manifest['commit']}",
        f"  pixels: {shares}",
        f"  data hash {data_hash(manifest)}, every file's SHA-256 verified",
        f"  look at {file}: colour, depth and labels of first and last frames",
    ]


def contact_sheet(path: Path, *, scenes: int = 6, width: int = 256) -> NDArray[np.uint8]:
    """Frames of a dataset for a person to look at: colour, depth (near blue, far red) and labels side by side.

    Args:
        path: the dataset.
        scenes: how many, evenly over the dataset; of each its first and its last frame.
        width: of one picture [pixel].

    Returns:
        (h, w, 3) red, green, blue.

    Raises:
        DatasetError: no finished dataset of scenes.
    """
    manifest = check_scenes(path)
    total = int(manifest["settings"]["scenes"])
    last = int(manifest["settings"]["frames"]) - 1
    wanted = set(np.linspace(0, total - 1, min(scenes, total)).round().astype(int).tolist())
    rows: dict[int, list[NDArray[np.uint8]]] = {}
    for part in manifest["parts"]:
        table = read_part(path / part["name"], ["scene", "frame"])
        numbers, frames = table["scene"].to_numpy(), table["frame"].to_numpy()
        chosen = np.flatnonzero(np.isin(numbers, list(wanted)) & ((frames == 0) | (frames == last)))
        if len(chosen):
            for row in read_part(path / part["name"]).take(chosen).to_pylist():
                frame = decode_row(row)
                rows.setdefault(frame["scene"], []).append(picture(frame, width))
    blank = np.zeros_like(next(iter(rows.values()))[0])
    return np.concatenate([np.concatenate([*row, blank][:2], axis=1) for row in rows.values()], axis=0)


def picture(frame: dict[str, Any], width: int) -> NDArray[np.uint8]:
    """Colour, depth and label of one frame side by side, each ``width`` wide: red, green, blue."""
    height = round(width * frame["depth"].shape[0] / frame["depth"].shape[1])
    parts = (frame["colour"], depth_colours(frame["depth"]), LABEL_COLOURS[frame["label"]])
    return np.concatenate([cv2.resize(p, (width, height), interpolation=cv2.INTER_NEAREST) for p in parts], axis=1)


def depth_colours(depth: NDArray[np.float32], farthest: float = 6.0) -> NDArray[np.uint8]:
    """Depth as colours, red, green, blue: near blue, ``farthest`` [m] red, no return black."""
    grey = np.clip(np.nan_to_num(depth) / farthest * 255, 0, 255).astype(np.uint8)
    colours = cv2.applyColorMap(grey, cv2.COLORMAP_TURBO)[..., ::-1].copy()
    colours[np.isnan(depth)] = 0
    return colours
