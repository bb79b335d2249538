"""Freeze a steppability run to ONNX, let out only if ONNX Runtime answers as the trained network does."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from legtool.datasets.steppability_run import SteppabilityRun, load_run
from legtool.datasets.store import replacing, sha256
from legtool.errors import OutputError
from legtool.models.steppability import Segmenter
from legtool_runtime.perception import LABELS

MODEL = "steppability.onnx"
INPUT, OUTPUTS = "depth", ("label", "logits")
#: Images that the frozen and the trained network are compared on, and how far their logits may differ.
IMAGES, TOLERANCE = 4, 1e-3
_OPSET = 18


def freeze_steppability(run: Path, directory: Path) -> dict[str, Any]:
    """Write ``steppability.onnx`` into a directory.

    Its input ``depth`` (1, 1, h, w) float32 is prepared depth [m]; 0, NaN and infinite mean no return. Its outputs are
    ``label`` (1, h, w) uint8 of LABELS, unknown where there is no return, and ``logits`` (1, 3, h, w).

    Args:
        run: of ``train steppability``.
        directory: exists.

    Returns:
        what a bundle says of the line: file, input, outputs, labels, camera of the prepared image, preparation steps,
        training settings, data, validation metrics, and the largest difference on random images.

    Raises:
        DatasetError: not such a run, or without a finished epoch.
        OutputError: it cannot be written, or the frozen network differs from the trained one.
    """
    loaded = load_run(run)
    camera = loaded.camera
    path = directory / MODEL
    with replacing(path) as temporary:
        write_onnx(loaded, temporary)
        difference = _compare(loaded, temporary)
    if not difference <= TOLERANCE:
        path.unlink()
        raise OutputError(
            f"{run}: not exported: the frozen network's logits differ by {difference:.1e}, "
            f"expected at most {TOLERANCE:.0e}"
        )
    description = loaded.description
    return {
        "file": {"name": MODEL, "bytes": path.stat().st_size, "sha256": sha256(path)},
        "input": {"name": INPUT, "shape": [1, 1, camera.height, camera.width], "unit": "m"},
        "outputs": list(OUTPUTS),
        "labels": list(LABELS),
        "camera": {key: getattr(camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy")},
        "preparation": description["preparation"],
        "swing_height_max": loaded.robot.swing_height_max,
        "settings": description["settings"],
        "data": {**description["data"], "data_hash": description["data_hash"]},
        "validation": description["best"],
        "provenance": description["provenance"],
        "agreement": {"images": IMAGES, "largest_difference": difference},
    }


def write_onnx(run: SteppabilityRun, path: Path) -> None:
    """Write the run's network, normalisation and all, as an ONNX model of one image, weights inside."""
    segmenter = Segmenter(run.net).eval()
    example = torch.ones(1, 1, run.camera.height, run.camera.width)
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            segmenter, (example,), input_names=[INPUT], output_names=list(OUTPUTS), opset_version=_OPSET, dynamo=True
        )
        assert program is not None
        program.save(path, external_data=False)


def random_images(run: SteppabilityRun, *, seed: int = 0) -> NDArray[np.float32]:
    """(n, 1, h, w) depth [m] of tilted planes with jumps, noise, and pixels without return of every kind."""
    rng = np.random.default_rng(seed)
    shape = (run.camera.height, run.camera.width)
    v, u = np.meshgrid(*(np.linspace(-1, 1, side) for side in shape), indexing="ij")
    images = []
    for _ in range(IMAGES):
        inverse = 0.6 + rng.normal(0, 0.2) * u + rng.normal(0.3, 0.2) * v + 0.3 * (u * rng.normal() + v > 0.3)
        depth = (1 / np.clip(inverse, 0.15, 4)).astype(np.float32) + rng.normal(0, 0.01, shape).astype(np.float32)
        for value in (0.0, np.nan, np.inf):
            depth[rng.uniform(size=shape) < 0.02] = value
        images.append(depth[None])
    return np.stack(images)


def _compare(run: SteppabilityRun, path: Path) -> float:
    """Largest difference of the logits; infinite where a label differs that is not a near tie."""
    import onnxruntime

    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    segmenter = Segmenter(run.net).eval()
    largest = 0.0
    for image in random_images(run):
        frozen_label, frozen_logits = session.run(list(OUTPUTS), {INPUT: image[None]})
        with torch.no_grad():
            label, logits = (out.numpy() for out in segmenter(torch.from_numpy(image[None])))
        largest = max(largest, float(np.abs(frozen_logits - logits).max()))
        top = np.sort(logits, axis=1)
        clear = top[:, -1] - top[:, -2] > TOLERANCE
        if not np.array_equal(frozen_label == 0, label == 0) or (frozen_label != label)[clear].any():
            return np.inf
    return largest
