"""Freeze a run of the steppability line to ONNX, and compare what was frozen with what was trained."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from legtool.configs.export import ExportSettings
from legtool.errors import OutputError
from legtool.models.steppability import SegmenterNet
from legtool.models.steppability_run import SteppabilityRun, load_steppability_run
from legtool.sim.sensors.depth_camera import mount
from legtool.training.freeze import Line, carried_results
from legtool.training.onnx_model import to_onnx
from legtool_runtime.bundle import Bundle
from legtool_runtime.onnx_session import OnnxSession
from legtool_runtime.perception.steppability import Sensor, steppability_interface

MODEL = "steppability.onnx"
INPUT, OUTPUTS = "depth", ("label", "logits")
#: Number of images on which frozen and trained network are compared, and the accepted difference of their logits.
IMAGES, TOLERANCE = 4, 1e-3


def freeze_steppability(path: Path, settings: ExportSettings) -> Line:
    """Freeze a segmenter to ``steppability.onnx``.

    Its input ``depth`` (1, 1, h, w) float32 is prepared depth [m]; 0, NaN and infinite mean no return. Its outputs are
    ``label`` (1, h, w) uint8 of LABELS, unknown where there is no return, and ``logits`` (1, 3, h, w).

    Args:
        path: a run of ``train steppability``.
        settings: which results to include.

    Raises:
        DatasetError: the path is not such a run, or no epoch is finished.
        OutputError: the results to include are of other data or cannot be read.
    """
    run = load_steppability_run(path)
    description = run.description
    robot, camera = run.robot, run.camera
    example = torch.ones(1, 1, camera.height, camera.width)
    content = to_onnx(SegmenterNet(run.net).eval(), {INPUT: example}, outputs=OUTPUTS)
    sensor = Sensor(robot.camera.camera(), mount(robot.camera), robot.standing_height)

    def compare(bundle: Bundle) -> dict[str, float]:
        return {"logits of the network as trained, on random images": _compare(run, content, bundle)}

    return Line(
        name="steppability",
        run=path,
        robot=robot.geometry(),
        instant=None,
        files={MODEL: content},
        description={
            **steppability_interface(),
            "input": {"name": INPUT, "shape": [1, 1, camera.height, camera.width], "unit": "m"},
            "outputs": list(OUTPUTS),
            "preparation": description["preparation"],
            "sensor": sensor.to_dict(),
            "swing_height_max": robot.swing_height_max,
            "metrics": {},
            "provenance": {
                "settings": description["settings"],
                "data": {**description["data"], "path": Path(description["data"]["path"]).name},
                "data_hash": description["data_hash"],
                "validation": description["best"],
                **description["provenance"],
            },
            **carried_results(path, "steppability.", description["data_hash"], settings.results),
        },
        compare=compare,
        tolerance=TOLERANCE,
        compared={"images": IMAGES},
    )


def random_images(run: SteppabilityRun, *, seed: int = 0) -> NDArray[np.float32]:
    """Return depth (n, 1, h, w) [m] of tilted planes with jumps, noise, and pixels without return of every kind."""
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


def _compare(run: SteppabilityRun, content: bytes, bundle: Bundle) -> float:
    """Largest difference of the logits; infinite where a label differs that is not a near tie, or in the runtime."""
    session = OnnxSession(content, what="the frozen segmenter", error=OutputError)
    segmenter = SegmenterNet(run.net).eval()
    largest = 0.0
    for image in random_images(run):
        frozen_label, frozen_logits = session.run({INPUT: image[None]}, OUTPUTS)
        with torch.no_grad():
            label, logits = (out.numpy() for out in segmenter(torch.from_numpy(image[None])))
        largest = max(largest, float(np.abs(frozen_logits - logits).max()))
        top = np.sort(logits, axis=1)
        clear = top[:, -1] - top[:, -2] > TOLERANCE
        if not np.array_equal(frozen_label == 0, label == 0) or (frozen_label != label)[clear].any():
            return np.inf
        # The runtime, asked for the prepared image alone, must give the labels of the model it holds.
        if not np.array_equal(bundle.steppability.predict(image[0]), frozen_label[0]):
            return np.inf
    return largest
