"""Freeze a run of the foothold line to ONNX, and compare what was frozen with what was trained."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from legtool.configs.export import ExportSettings
from legtool.errors import OutputError
from legtool.models.foothold import Dense, DenseCounts
from legtool.models.foothold_run import FootholdRun, load_foothold_run
from legtool.training.freeze import Line, carried_results
from legtool.training.onnx_model import to_onnx
from legtool_runtime.bundle import Bundle
from legtool_runtime.foothold.features import COARSE_INPUT, FEATURES, HIPS, NEARNESS, Kind
from legtool_runtime.foothold.networks import foothold_interface
from legtool_runtime.foothold.settings import SIZE, hip_heights
from legtool_runtime.onnx_session import OnnxSession

#: Number of inputs on which frozen and trained network are compared, and the accepted share of the largest output.
SAMPLES, TOLERANCE = 16, 1e-3


def freeze_foothold(path: Path, settings: ExportSettings) -> list[Line]:
    """Freeze a network to ``vfa.onnx`` or ``vpa.onnx``, or to both if it is the dense one, which serves both tasks.

    Inputs are those of :class:`legtool_runtime.foothold.features.Inputs`; the output is (n, 1090) logits or
    (n, 33, 33) probabilities for footholds, (n, 30) weights or (n, 31) counts for poses.

    Args:
        path: a run of ``train vfa`` or ``train vpa``.
        settings: which results to include.

    Raises:
        DatasetError: the path is not such a run, or no epoch is finished.
        OutputError: the results to include are of other data or cannot be read.
    """
    run = load_foothold_run(path)
    if isinstance(run.net, Dense):
        counts = DenseCounts(run.net, hip_heights(run.robot)).eval()
        return [_line(run, "vfa", run.net, settings), _line(run, "vpa", counts, settings)]
    return [_line(run, run.task, run.net, settings)]


def _line(run: FootholdRun, task: str, net: nn.Module, settings: ExportSettings) -> Line:
    content = to_onnx(net, random_inputs(3, run.kind), outputs=["out"], batched=True)
    description = run.description
    return Line(
        name=task,
        run=run.path,
        robot=run.robot,
        instant=None,
        files={f"{task}.onnx": content},
        description={
            **foothold_interface(),
            "network": run.network,
            "criteria": description["criteria"],
            "metrics": {},
            "provenance": {
                "settings": description["settings"],
                "data": {
                    **description["data"],
                    "paths": [Path(name).name for name in description["data"]["paths"]],
                },
                "data_hash": description["data_hash"],
                "validation": description["best"],
                **description["provenance"],
            },
            **carried_results(run.path, f"{task}.{run.network}.", description["data_hash"], settings.results),
        },
        compare=_comparison(net, task, content, run.kind),
        tolerance=TOLERANCE,
        compared={"inputs": SAMPLES},
    )


def _comparison(net: nn.Module, task: str, content: bytes, kind: Kind) -> Callable[[Bundle], dict[str, float]]:
    """Return a function for the largest difference of the outputs, as a share of the largest output."""

    def compare(bundle: Bundle) -> dict[str, float]:
        session = OnnxSession(content, what=f"the frozen network for {task}", error=OutputError)
        inputs = random_inputs(SAMPLES, kind, seed=1)
        (frozen,) = session.run({name: values.numpy() for name, values in inputs.items()})
        with torch.no_grad():
            trained: Any = net(*inputs.values()).numpy()
        difference = float(np.abs(frozen - trained).max() / max(np.abs(trained).max(), 1e-6))
        getattr(bundle, task).warm_up()
        return {"the network as trained, on random inputs, as a share of its largest output": difference}

    return compare


def random_inputs(count: int, kind: Kind, *, seed: int = 0) -> dict[str, torch.Tensor]:
    """Heights with steps and unknown cells, vectors of usual sizes, and coarse checks; see :func:`freeze_foothold`."""
    rng = np.random.default_rng(seed)
    ramp = np.linspace(-1, 1, SIZE)
    heights = np.floor(rng.normal(size=(count, 1, 1, 1)) * 3 * ramp[:, None]) * 0.1 + rng.normal(
        scale=0.01, size=(count, 1, SIZE, SIZE)
    )
    heights[rng.random(heights.shape) < 0.01] = np.nan
    vector = rng.normal(size=(count, len(FEATURES))) * [size for _, size in FEATURES]
    vector[:, 0] = 0.55
    inputs = {"heights": heights, "vector": vector}
    if kind == "vfa":
        inputs[COARSE_INPUT] = np.where(rng.random((count, SIZE, SIZE)) < 0.5, NEARNESS, 0.0)
    elif kind == "vpa":
        inputs[COARSE_INPUT] = np.floor(rng.uniform(0, 400, (count, 2, HIPS)))
    return {name: torch.tensor(values, dtype=torch.float32) for name, values in inputs.items()}
