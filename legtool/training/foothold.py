"""Train the foothold networks: one loop, that carries on where it was killed and ends with the same weights."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from legtool.configs.footholds import FootholdTrainSettings
from legtool.datasets.foothold_run import KINDS
from legtool.datasets.footholds import FootholdData, load_footholds, split_by_terrain
from legtool.datasets.provenance import commit, versions
from legtool.datasets.steppability_run import BEST, LAST, RUN, claim_run, load_tensors, save_tensors
from legtool.datasets.store import data_hash, write_json
from legtool.errors import DatasetError
from legtool.models.foothold import CELLS, Dense, PaperVfa, basis_matrix, build_network
from legtool.progress import progress
from legtool_runtime.foothold.features import FEATURES, encode
from legtool_runtime.foothold.settings import hip_heights
from legtool_runtime.robot import Robot

#: Weight of the counts' error beside that of the safe map, in the dense network's loss.
_COUNTS_WEIGHT = 2.0


@dataclass(frozen=True, eq=False)
class Examples:
    """Encoded samples in memory: each is read and encoded once, whatever the number of epochs.

    Attributes:
        heights: (n, 1, 33, 33) float16, mirrored.
        vector: (n, 26).
        optimal: (n,) class of the optimal foothold in the mirrored map; 1089: none.
        safe: (n, 33, 33) uint8, mirrored.
        counts: (n, 31), -1 where there are none; over hip heights above ``reference``.
        reference: (n,) the map's median, which heights are measured above.
    """

    heights: NDArray[np.float16]
    vector: NDArray[np.float32]
    optimal: NDArray[np.int64]
    safe: NDArray[np.uint8]
    counts: NDArray[np.float32]
    reference: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.vector)


def encode_examples(robot: Robot, data: FootholdData) -> Examples:
    """Encode samples as the networks take them."""
    heights, vector, reference = encode(
        robot,
        heights=data.heights,
        leg=data.leg,
        hip_height=data.hip_height,
        base_twist=data.base_twist,
        gait=data.gait,
        nominal=data.nominal,
        vpa=data.vpa,
    )
    right = data.leg % 2 == 1
    safe = (data.reasons == 0).astype(np.uint8)
    safe[right] = safe[right][:, :, ::-1]
    ix, iy = np.divmod(data.optimal.astype(np.int64), 33)
    optimal = np.where(data.optimal < 0, CELLS, ix * 33 + np.where(right, 32 - iy, iy))
    return Examples(heights.astype(np.float16), vector, optimal, safe, data.counts.astype(np.float32), reference)


def train_foothold(
    task: str, paths: Sequence[Path], settings: FootholdTrainSettings, out: Path, *, workers: int = 1
) -> Iterator[str]:
    """Train one network and write a run.

    Args:
        task: ``vfa`` or ``vpa``; the dense network is the same for both.
        paths: datasets of ``collect footholds``, of one robot.
        settings: network, schedule.
        out: the run's directory; the same command carries on a run that was interrupted there.
        workers: threads.

    Yields:
        what was done, line by line.

    Raises:
        DatasetError: no dataset, one of another kind, or none of the task's samples in it.
        OutputError: ``out`` holds something else.
    """
    torch.set_num_threads(workers)
    data, manifest = load_footholds(paths)
    if settings.network == "paper":
        data = data.take(data.vpa == (1 if task == "vpa" else 0))
    if len(data) == 0:
        raise DatasetError(f"{paths[0]}: holds no samples for {task}; collect with another vpa_share")
    robot = Robot.from_dict(manifest["robot"])
    description = {
        "kind": KINDS[task],
        "robot": manifest["robot"],
        "settings": settings.to_dict(),
        "preparation": [name for name, _ in FEATURES],
        "data_hash": data_hash(manifest),
        "criteria": manifest["criteria"],
        "data": {"paths": [str(path) for path in paths], "rows": len(data)},
        "provenance": {"commit": commit(), "versions": versions()},
    }
    run = claim_run(out, description)
    if run["complete"]:
        yield f"{out}: this training is finished; best epoch {run['best']['epoch']}, loss {run['best']['loss']:.4f}"
        return
    training, validation = split_by_terrain(data, settings.validation_share, seed=settings.seed)
    trainer = Trainer(task, robot, encode_examples(robot, data.take(training)), settings)
    held = encode_examples(robot, data.take(validation))
    del data
    if (out / LAST).is_file():
        trainer.restore(load_tensors(out / LAST))
        run["history"] = run["history"][: trainer.epoch]
    total = settings.epochs * trainer.steps
    with progress("training", total, "steps", done=trainer.epoch * trainer.steps) as advance:
        while not run["complete"]:
            start = time.perf_counter()
            loss = trainer.run_epoch(advance)
            entry = {"epoch": trainer.epoch, "training_loss": loss, "loss": trainer.loss_on(held)}
            entry["seconds"] = time.perf_counter() - start
            run["history"].append(entry)
            if run["best"] is None or entry["loss"] < run["best"]["loss"]:
                run["best"] = entry
                save_tensors(out / BEST, trainer.net.state_dict())
            stale = trainer.epoch - run["best"]["epoch"]
            run["complete"] = trainer.epoch >= settings.epochs or stale >= settings.patience
            # The description before the state: a kill between them repeats the epoch, and nothing is lost.
            write_json(out / RUN, run)
            save_tensors(out / LAST, trainer.state())
    yield (
        f"trained {trainer.epoch} epochs of {len(trainer.examples)} samples in "
        f"{sum(e['seconds'] for e in run['history']):.0f} s; best epoch {run['best']['epoch']}: "
        f"loss {run['best']['loss']:.4f} on {len(held)} samples of other terrain"
    )


class Trainer:
    """Network, optimiser and place in the schedule; everything random is a function of seed and epoch."""

    def __init__(self, task: str, robot: Robot, examples: Examples, settings: FootholdTrainSettings) -> None:
        """Set up; training starts at epoch 0."""
        self.task, self.examples, self.settings = task, examples, settings
        self.steps = max(len(examples) // settings.batch, 1)
        self.epoch = 0
        torch.manual_seed(settings.seed)
        self.net: nn.Module = build_network(task, settings.network, settings.width)
        self.net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.optimiser = torch.optim.Adam(self.net.parameters(), lr=settings.learning_rate)
        hips = hip_heights(robot)
        self.hips = torch.tensor(hips, dtype=torch.float32)
        self.basis = basis_matrix(hips)
        self.bf16 = _has_bf16() if settings.bf16 is None else settings.bf16

    def run_epoch(self, advance: Any = None) -> float:
        """One epoch; its mean loss."""
        order = np.random.default_rng([self.settings.seed, self.epoch]).permutation(len(self.examples))
        total = 0.0
        self.net.train()
        for step in range(self.steps):
            rows = np.sort(order[step * self.settings.batch : (step + 1) * self.settings.batch])
            for group in self.optimiser.param_groups:
                group["lr"] = self._rate(self.epoch + step / self.steps)
            loss = self._loss(self.examples, rows)
            self.optimiser.zero_grad(set_to_none=True)
            loss.backward()
            self.optimiser.step()
            total += float(loss.detach())
            if advance is not None:
                advance(1)
        self.epoch += 1
        return total / self.steps

    @torch.no_grad()
    def loss_on(self, examples: Examples) -> float:
        """Mean loss on held-out samples."""
        self.net.eval()
        total, batch = 0.0, self.settings.batch
        for first in range(0, len(examples), batch):
            rows = np.arange(first, min(first + batch, len(examples)))
            total += float(self._loss(examples, rows)) * len(rows)
        return total / len(examples)

    def state(self) -> dict[str, Any]:
        """Everything that the rest of the training depends on."""
        return {"epoch": self.epoch, "net": self.net.state_dict(), "optimiser": self.optimiser.state_dict()}

    def restore(self, state: dict[str, Any]) -> None:
        """Carry on from :meth:`state`."""
        self.epoch = int(state["epoch"])
        self.net.load_state_dict(state["net"])
        self.optimiser.load_state_dict(state["optimiser"])

    def _rate(self, epoch: float) -> float:
        """Adam's rate: the paper's at first, down to a hundredth of it along a cosine over the epochs allowed."""
        falling = 0.5 * (1 + math.cos(math.pi * epoch / self.settings.epochs))
        return self.settings.learning_rate * (0.01 + 0.99 * falling)

    def _loss(self, examples: Examples, rows: NDArray[np.int64]) -> Tensor:
        heights = torch.from_numpy(examples.heights[rows].astype(np.float32))
        vector = torch.from_numpy(examples.vector[rows])
        with torch.autocast("cpu", torch.bfloat16, enabled=self.bf16):
            if isinstance(self.net, Dense):
                bounds = self.net.bounds(heights, vector).float()
            else:
                out = self.net(heights, vector).float()
        if isinstance(self.net, Dense):
            return self._dense_loss(self.net, bounds, vector, examples, rows)
        if isinstance(self.net, PaperVfa):
            return functional.cross_entropy(out, torch.from_numpy(examples.optimal[rows]))
        # Between the functions of the predicted weights and the counts that true weights are fitted to (appendix A).
        wanted = torch.from_numpy(examples.counts[rows])
        return functional.mse_loss(out @ self.basis.T / CELLS, wanted / CELLS) * 100

    def _dense_loss(
        self, net: Dense, bounds: Tensor, vector: Tensor, examples: Examples, rows: NDArray[np.int64]
    ) -> Tensor:
        log_safe = net.log_safe(bounds, vector[:, :1, None]).clamp(max=-1e-6)
        safe = torch.from_numpy(examples.safe[rows]).float()
        cross_entropy = -(safe * log_safe + (1 - safe) * torch.log(-torch.expm1(log_safe)))
        loss = cross_entropy.mean() * 10
        counted = np.flatnonzero(examples.counts[rows, 0] >= 0)
        if len(counted):
            hips = self.hips[None] - torch.from_numpy(examples.reference[rows[counted]])[:, None]
            error = net.counts(bounds[counted], hips) - torch.from_numpy(examples.counts[rows[counted]])
            loss = loss + _COUNTS_WEIGHT * (error / CELLS).abs().mean() * 10
        return loss


def _has_bf16() -> bool:
    """Whether the processor multiplies matrices in bfloat16 (AMX): with vector instructions alone it does not pay."""
    return bool(torch.cpu._is_amx_tile_supported())
