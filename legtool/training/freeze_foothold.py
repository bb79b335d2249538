"""Freeze foothold runs to ONNX, let out only if ONNX Runtime answers as the trained network does."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from legtool.datasets.foothold_run import FootholdRun, load_foothold_run
from legtool.datasets.store import replacing, sha256
from legtool.errors import OutputError
from legtool.models.foothold import Dense, DenseCounts
from legtool_runtime.foothold.features import FEATURES
from legtool_runtime.foothold.networks import FILES, foothold_interface
from legtool_runtime.foothold.settings import SIZE, hip_heights

#: Inputs that frozen and trained network are compared on, and by how much of an output's size they may differ.
SAMPLES, TOLERANCE = 16, 1e-3
_OPSET = 18


def freeze_foothold(run: Path, directory: Path) -> dict[str, Any]:
    """Write a run's network into a directory: ``vfa.onnx`` or ``vpa.onnx``; of a dense one, one file for each task.

    Inputs are ``heights`` (n, 1, 33, 33) and ``vector`` (n, 26) of :mod:`legtool_runtime.foothold.features`; the output
    is (n, 1090) logits or (n, 33, 33) probabilities for footholds, (n, 30) weights or (n, 31) counts for poses.

    Args:
        run: of ``train vfa`` or ``train vpa``.
        directory: exists.

    Returns:
        what a bundle says of the line: files, interface, criteria, training, validation, and the largest difference on
        random inputs, relative to the output's largest value.

    Raises:
        DatasetError: not such a run, or without a finished epoch.
        OutputError: it cannot be written, or a frozen network differs from the trained one.
    """
    loaded = load_foothold_run(run)
    files, worst = [], 0.0
    for name, net in frozen_networks(loaded).items():
        path = directory / FILES[name]
        with replacing(path) as temporary:
            write_onnx(net, temporary)
            difference = compare(net, temporary)
        if not difference <= TOLERANCE:
            path.unlink()
            raise OutputError(
                f"{run}: not exported: the frozen network differs by {difference:.1e} of its largest output, "
                f"expected at most {TOLERANCE:.0e}"
            )
        worst = max(worst, difference)
        files.append({"name": path.name, "bytes": path.stat().st_size, "sha256": sha256(path)})
    description = loaded.description
    return {
        "files": files,
        **foothold_interface(),
        "robot": description["robot"],
        "criteria": description["criteria"],
        "settings": description["settings"],
        "data": {**description["data"], "data_hash": description["data_hash"]},
        "validation": description["best"],
        "provenance": description["provenance"],
        "agreement": {"samples": SAMPLES, "largest_difference": worst},
    }


def frozen_networks(run: FootholdRun) -> dict[str, nn.Module]:
    """The networks to be frozen, by the runtime's names for their files."""
    if isinstance(run.net, Dense):
        return {"vfa_dense": run.net, "vpa_dense": DenseCounts(run.net, hip_heights(run.robot)).eval()}
    return {run.task: run.net}


def write_onnx(net: nn.Module, path: Path) -> None:
    """Write a network as an ONNX model for any number of samples, weights inside."""
    heights, vector = random_inputs(3)
    batch = torch.export.Dim("batch", min=1, max=4096)
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            net,
            (heights, vector),
            input_names=["heights", "vector"],
            opset_version=_OPSET,
            dynamo=True,
            dynamic_shapes=({0: batch}, {0: batch}),
        )
        assert program is not None
        program.save(path, external_data=False)


def random_inputs(count: int, *, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Heights (n, 1, 33, 33) with steps and unknown cells, and vectors (n, 26) of usual sizes."""
    rng = np.random.default_rng(seed)
    ramp = np.linspace(-1, 1, SIZE)
    heights = np.floor(rng.normal(size=(count, 1, 1, 1)) * 3 * ramp[:, None]) * 0.1 + rng.normal(
        scale=0.01, size=(count, 1, SIZE, SIZE)
    )
    heights[rng.random(heights.shape) < 0.01] = np.nan
    vector = rng.normal(size=(count, len(FEATURES))) * [size for _, size in FEATURES]
    vector[:, 0] = 0.55
    return torch.tensor(heights, dtype=torch.float32), torch.tensor(vector, dtype=torch.float32)


def compare(net: nn.Module, path: Path) -> float:
    """Largest difference of the frozen network's outputs, as a share of the largest output."""
    import onnxruntime

    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    heights, vector = random_inputs(SAMPLES, seed=1)
    (frozen,) = session.run(None, {"heights": heights.numpy(), "vector": vector.numpy()})
    with torch.no_grad():
        trained = net(heights, vector).numpy()
    return float(np.abs(frozen - trained).max() / max(np.abs(trained).max(), 1e-6))
