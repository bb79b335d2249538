"""Train the steppability segmenter: frames, losses and schedule. The loop is in :mod:`legtool.training.loop`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from legtool.configs.robots import read_seeing_robot
from legtool.configs.steppability import SteppabilityTrainSettings
from legtool.datasets.files import sha256
from legtool.datasets.network_run import STEPPABILITY_KIND, claim_run
from legtool.datasets.steppability.images import SceneImages, load_scene_images
from legtool.datasets.steppability.scenes import check_scenes
from legtool.datasets.store import data_hash
from legtool.errors import DatasetError
from legtool.models.encoders import load_encoder_weights
from legtool.models.scores import best_offset, confusion_matrix, iou_of, predict_logits
from legtool.models.steppability import CLASSES, SteppabilityNet
from legtool.models.steppability_run import build_net
from legtool.provenance import commit, versions
from legtool.training.loop import fit, layout_for, multiplies_bf16
from legtool_runtime.perception.depth import PREPARATION, prepared_camera

#: The label 0 (unknown) after 1 has been subtracted from all labels; neither loss nor IoU counts it.
IGNORED = -1
#: The poly schedule's power, and the share of the steps over which the rate first rises.
POWER, WARM_UP = 0.9, 0.03
#: Number of frames over which the normalisation statistics are computed after an epoch.
STATISTICS = 160


def train_steppability(
    paths: Sequence[Path], settings: SteppabilityTrainSettings, out: Path, *, workers: int = 1
) -> Iterator[str]:
    """Train on one dataset of scenes and write a run.

    Args:
        paths: one dataset of ``collect scenes``.
        settings: network, loss, schedule.
        out: directory of the run; the same command resumes a run that was interrupted.
        workers: number of threads on a CPU.

    Yields:
        What was done, line by line.

    Raises:
        DatasetError: there is not exactly one dataset of this kind, or the encoder weights do not fit.
        OutputError: ``out`` holds something else.
    """
    if len(paths) != 1:
        raise DatasetError(f"{len(paths)} datasets were given, expected one of legtool collect scenes")
    manifest = check_scenes(paths[0])
    robot = read_seeing_robot(manifest["robot"], source=str(paths[0]))
    weights = None if settings.encoder_weights is None else Path(settings.encoder_weights)
    identity = {
        "kind": STEPPABILITY_KIND,
        "robot": robot.to_dict(),
        "settings": settings.to_dict(),
        "preparation": list(PREPARATION),
        "data_hash": data_hash(manifest),
        "encoder_weights": sha256(weights) if weights is not None and weights.is_file() else None,
    }
    origin = {"path": str(paths[0].resolve()), "rows": manifest["rows"], "counts": manifest["counts"]}
    made_by = {"commit": commit(), "versions": versions()}
    with claim_run(out, identity, classes=list(CLASSES), data=origin, provenance=made_by) as run:
        if run["complete"]:
            best = run["best"]
            yield f"{out}: this training is finished; best epoch {best['epoch']}, mIoU {best['miou']:.3f}"
            return
        device = _device(settings)
        torch.set_num_threads(workers)
        training = load_scene_images(paths[0], ["train"])
        validation = load_scene_images(paths[0], ["validation"])
        torch.manual_seed(settings.seed)
        net = build_net(settings.network, robot, prepared_camera(robot.camera.camera()))
        if weights is not None:
            yield f"loaded {load_encoder_weights(net.encoder, weights)} tensors of encoder weights from {weights}"
        net = net.to(device, memory_format=layout_for(net, device))  # type: ignore[call-overload]  # not in torch's stubs
        learner = SegmenterLearner(net, training, validation, settings, device)
        fit(learner, run, out, epochs=settings.epochs, score=lambda entry: float(entry["miou"]))
        best = run["best"]
        shares = ", ".join(f"{name} {x:.3f}" for name, x in zip(CLASSES, best["iou"], strict=True) if x is not None)
        yield (
            f"trained {settings.epochs} epochs on {len(training)} frames ({device.type}); best epoch {best['epoch']}: "
            f"mIoU {best['miou']:.3f} on {len(validation)} validation frames ({shares})"
        )


class SegmenterLearner:
    """The network, its optimiser and its frames; everything random is a function of seed and epoch."""

    def __init__(
        self,
        net: SteppabilityNet,
        data: SceneImages,
        held: SceneImages,
        settings: SteppabilityTrainSettings,
        device: torch.device,
    ) -> None:
        """Set up.

        Args:
            net: on its device.
            data: training frames.
            held: frames of the validation scenes, which decide which epoch is best.
            settings: loss, schedule, augmentation.
            device: of the net.
        """
        self.net: nn.Module = net
        self.offset = net.offset
        self.data, self.held, self.settings, self.device = data, held, settings, device
        self.bf16 = multiplies_bf16(device) if settings.bf16 is None else settings.bf16
        self.steps = max(len(data) // settings.batch, 1)
        decayed = [p for p in net.parameters() if p.ndim > 1]
        rest = [p for p in net.parameters() if p.ndim <= 1]
        self.optimiser: torch.optim.Optimizer = torch.optim.AdamW(
            [{"params": decayed, "weight_decay": settings.weight_decay}, {"params": rest, "weight_decay": 0.0}],
            lr=settings.learning_rate,
            fused=True,
        )
        self.weights = torch.from_numpy(_class_weights(data.label)).to(device)
        self.begin(0)

    def begin(self, epoch: int) -> None:
        """Shuffle."""
        self._epoch = epoch
        self._rng = np.random.default_rng([self.settings.seed, epoch])
        self._order = self._rng.permutation(len(self.data))

    def update(self, step: int) -> float:
        """Take one step on a batch and return its loss."""
        settings = self.settings
        self._schedule(self._epoch * self.steps + step)
        chosen = self._order[step * settings.batch : (step + 1) * settings.batch]
        depth, label = self.data.metres(chosen), self.data.label[chosen]
        if settings.augment:
            depth, label = augment(depth, label, self._rng)
        if self._epoch < settings.coarse_epochs:
            depth, label = depth[:, ::2, ::2], label[:, ::2, ::2]
        x = torch.from_numpy(np.ascontiguousarray(depth[:, None])).to(self.device)
        target = torch.from_numpy(label.astype(np.int64) - 1).to(self.device)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.bf16):
            logits = self.net(x)
        loss = self._loss(logits.float(), target)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self.net.parameters(), 5.0)
        self.optimiser.step()
        return float(loss.detach())

    def measure(self, training_loss: float) -> dict[str, Any]:
        """Return the mean training loss, and the IoU on the held-out frames."""
        self._settle_statistics()
        self._choose_offset()
        iou = iou_of(confusion_matrix(self.net, self.held, batch=self.settings.batch, device=self.device))
        known = [None if np.isnan(x) else float(x) for x in iou]
        return {"loss": training_loss, "miou": float(np.nanmean(iou)), "iou": known}

    @torch.no_grad()
    def _settle_statistics(self) -> None:
        """Take the normalisation's statistics anew, over many whole frames, as the weights are now.

        Those gathered on the way lag behind the weights, are of few scenes, and of coarse images at first.
        """
        layers = [layer for layer in self.net.modules() if isinstance(layer, nn.BatchNorm2d)]
        usual = [layer.momentum for layer in layers]
        for layer in layers:
            layer.reset_running_stats()
            layer.momentum = None  # the mean of all batches
        self.net.train()
        chosen = self._order[:STATISTICS]
        for first in range(0, len(chosen), self.settings.batch):
            depth = self.data.metres(chosen[first : first + self.settings.batch])
            with torch.autocast(self.device.type, torch.bfloat16, enabled=self.bf16):
                self.net(torch.from_numpy(depth[:, None]).to(self.device))
        for layer, momentum in zip(layers, usual, strict=True):
            layer.momentum = momentum

    def _choose_offset(self) -> None:
        """Set the offsets of the logits by every fourth pixel of the frames held out."""
        thin = (slice(None), slice(None, None, 2), slice(None, None, 2))
        self.offset.zero_()
        logits = predict_logits(self.net, self.held, batch=self.settings.batch, device=self.device)
        offset = best_offset((scores[thin] for scores in logits), self.held.label[thin])
        self.offset.copy_(torch.from_numpy(offset))

    def _schedule(self, step: int) -> None:
        total = self.settings.epochs * self.steps
        rising = min(1.0, (step + 1) / max(WARM_UP * total, 1))
        for group in self.optimiser.param_groups:
            group["lr"] = self.settings.learning_rate * rising * (1 - step / total) ** POWER

    def _loss(self, logits: Tensor, target: Tensor) -> Tensor:
        if self.settings.loss == "class_weighted":
            return functional.cross_entropy(logits, target, weight=self.weights, ignore_index=IGNORED)
        each = functional.cross_entropy(logits, target, ignore_index=IGNORED, reduction="none").flatten()
        known = int((target != IGNORED).sum())
        hardest = max(int(self.settings.hard_share * known), 1)
        return torch.topk(each, hardest, sorted=False).values.mean()


def augment(
    depth: NDArray[np.float32], label: NDArray[np.uint8], rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Mirror frames, change their scale slightly, and add noise and voids, frame by frame.

    Args:
        depth: (n, h, w) [m], 0 without return.
        label: (n, h, w) indices into LABELS.
        rng: source of all random draws.

    Returns:
        New depth and labels; the label of a voided pixel is unknown.
    """
    depth, label = depth.copy(), label.copy()
    height, width = depth.shape[1:]
    for n in range(len(depth)):
        if rng.uniform() < 0.5:
            depth[n], label[n] = depth[n, :, ::-1].copy(), label[n, :, ::-1].copy()
        depth[n] *= np.float32(rng.normal(1.0, 0.01))
        noise = rng.standard_normal((height, width), dtype=np.float32)
        depth[n] += np.float32(rng.uniform(0, 0.002)) * depth[n] ** 2 * noise
        for _ in range(int(rng.integers(0, 4))):
            v, u = int(rng.integers(height)), int(rng.integers(width))
            h, w = int(rng.integers(2, 24)), int(rng.integers(2, 24))
            depth[n, v : v + h, u : u + w] = 0
            label[n, v : v + h, u : u + w] = 0
    return depth, label


def _class_weights(label: NDArray[np.uint8]) -> NDArray[np.float32]:
    """The classes' shares to the power of -1/4, mean 1 over pixels: rare classes count more, and not too much.

    A pixel that is of a rare class with probability p is worth calling so, by its IoU, where p is above IoU / 2. The
    usual inverse square root would call it so from p = 0.2 on.
    """
    share = np.bincount(label.ravel(), minlength=len(CLASSES) + 1)[1:] / max(int((label > 0).sum()), 1)
    weight = np.maximum(share, 1e-4) ** -0.25
    return (weight / (weight * share).sum()).astype(np.float32)


def _device(settings: SteppabilityTrainSettings) -> torch.device:
    if settings.device == "cuda" and not torch.cuda.is_available():
        raise DatasetError("device is cuda, but PyTorch finds no GPU; set device=cpu or auto")
    if settings.device == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    return torch.device(settings.device)
