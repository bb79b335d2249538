"""Train the foothold networks: samples in memory, and losses. The loop is in :mod:`legtool.training.loop`."""

from __future__ import annotations

import math
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
from legtool.datasets.foothold.heightmaps import FootholdData, load_footholds, split_by_terrain
from legtool.datasets.network_run import FOOTHOLD_KINDS, claim_run
from legtool.datasets.store import data_hash, load_manifest
from legtool.errors import DatasetError
from legtool.models.foothold import CELLS, Dense, PaperVfa, basis_matrix, build_network
from legtool.models.foothold_run import input_kind
from legtool.provenance import commit, versions
from legtool.training.loop import fit, multiplies_bf16
from legtool_runtime.foothold import Criteria, CriteriaSettings
from legtool_runtime.foothold.criteria.judge import FC, KF, LC, TR, UNKNOWN
from legtool_runtime.foothold.features import FEATURES, Kind, encode
from legtool_runtime.foothold.settings import hip_heights
from legtool_runtime.robot import Robot

#: Cells of each map that the dense network learns from in a step, and by how much those at the edge of where the leg
#: collides are preferred: the others are seldom in doubt.
_CELLS, _PREFERENCE = 64, 0.35
#: Samples that are encoded together, so that the whole dataset is in memory in half precision only.
_CHUNK = 10_000
#: So few safe footholds that a map's error is no more told by their share [cells].
_FEW = 5.0
#: Cells that other criteria decide, and those left by whether the leg collides.
_SETTLED, _COLLIDES, _CLEAR = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Examples:
    """Encoded samples in memory: each is read and encoded once, whatever the number of epochs.

    Attributes:
        heights: (n, 1, 33, 33) float16, mirrored.
        vector: (n, 29).
        coarse: float16, the coarse check of the paper's networks, see :class:`.features.Inputs`.
        hip: (n,) hip height that ``cells`` are judged for, above the map's median [m].
        optimal: (n,) class of the optimal foothold in the mirrored map; 1089: none.
        cells: (n, 33, 33) uint8, mirrored: whether the leg collides, or other criteria decide.
        counts: (n, 31) over hip heights above the map's median; -1 where there are none.
    """

    heights: NDArray[np.float16]
    vector: NDArray[np.float32]
    coarse: NDArray[np.float16] | None
    hip: NDArray[np.float32]
    optimal: NDArray[np.int64]
    cells: NDArray[np.uint8]
    counts: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.vector)


def encode_examples(criteria: Criteria, data: FootholdData, kind: Kind) -> Examples:
    """Encode samples as the networks take them."""
    parts = []
    for first in range(0, max(len(data), 1), _CHUNK):
        inputs = encode(criteria, kind, data.take(slice(first, first + _CHUNK)).tuples())
        coarse = None if inputs.coarse is None else inputs.coarse.astype(np.float16)
        parts.append((inputs.heights.astype(np.float16), inputs.vector, coarse, inputs.median))
    heights, vector, checked, median = zip(*parts, strict=True)
    right = data.leg % 2 == 1
    cells = np.where(data.reasons & (TR | KF | FC | UNKNOWN), _SETTLED, np.where(data.reasons & LC, _COLLIDES, _CLEAR))
    cells = cells.astype(np.uint8)
    cells[right] = cells[right][:, :, ::-1]
    ix, iy = np.divmod(data.optimal.astype(np.int64), 33)
    optimal = np.where(data.optimal < 0, CELLS, ix * 33 + np.where(right, 32 - iy, iy))
    return Examples(
        heights=np.concatenate(heights),
        vector=np.concatenate(vector),
        coarse=None if kind == "dense" else np.concatenate(checked),
        hip=data.hip_height - np.concatenate(median),
        optimal=optimal,
        cells=cells,
        counts=data.counts.astype(np.float32),
    )


def train_foothold(
    task: str, paths: Sequence[Path], settings: FootholdTrainSettings, out: Path, *, workers: int = 1
) -> Iterator[str]:
    """Train one network and write a run.

    Args:
        task: ``vfa`` or ``vpa``; the dense network is the same for both.
        paths: datasets of ``collect footholds``, of one robot.
        settings: network, schedule.
        out: directory of the run; the same command resumes a run that was interrupted.
        workers: number of threads.

    Yields:
        What was done, line by line.

    Raises:
        DatasetError: there is no dataset, one is of another kind, or it has no samples for the task.
        OutputError: ``out`` holds something else.
    """
    torch.set_num_threads(workers)
    data, manifest = load_footholds(paths)
    if settings.network == "paper":
        data = data.take(data.vpa == (1 if task == "vpa" else 0))
    if len(data) == 0:
        raise DatasetError(f"{paths[0]}: holds no samples for {task}; collect with another vpa_share")
    robot = Robot.from_dict(manifest["robot"])
    identity = {
        "kind": FOOTHOLD_KINDS[task],
        "robot": manifest["robot"],
        "settings": settings.to_dict(),
        "preparation": [name for name, _ in FEATURES],
        "data_hash": data_hash(*(load_manifest(path) for path in paths)),
        "criteria": manifest["criteria"],
    }
    origin = {"paths": [str(path) for path in paths], "rows": len(data)}
    with claim_run(out, identity, data=origin, provenance={"commit": commit(), "versions": versions()}) as run:
        if run["complete"]:
            yield f"{out}: this training is finished; best epoch {run['best']['epoch']}, loss {run['best']['loss']:.4f}"
            return
        training, validation = split_by_terrain(data, settings.validation_share, seed=settings.seed)
        thresholds = CriteriaSettings(**manifest["criteria"])
        criteria, kind = Criteria(robot, thresholds), input_kind(task, settings.network)
        examples, held = (encode_examples(criteria, data.take(rows), kind) for rows in (training, validation))
        learner = FootholdLearner(task, robot, thresholds, examples, held, settings)
        del data, examples, held
        fit(
            learner, run, out, epochs=settings.epochs, patience=settings.patience,
            score=lambda entry: -float(entry["loss"]),
        )  # fmt: skip
        yield (
            f"trained {len(run['history'])} epochs of {len(learner.examples)} samples in "
            f"{sum(e['seconds'] for e in run['history']):.0f} s; best epoch {run['best']['epoch']}: "
            f"loss {run['best']['loss']:.4f} on {len(learner.held)} samples of other terrain"
        )
        if len(run["history"]) < settings.epochs:
            yield (
                f"stopped early, after {len(run['history'])} of {settings.epochs} epochs: the last {settings.patience} "
                "were no better"
            )


class FootholdLearner:
    """A foothold network, its optimiser and its samples; the order of samples is a function of seed and epoch."""

    def __init__(
        self,
        task: str,
        robot: Robot,
        criteria: CriteriaSettings,
        examples: Examples,
        held: Examples,
        settings: FootholdTrainSettings,
    ) -> None:
        """Set up the network; ``held`` are samples of other terrain, which decide when to stop."""
        self.task, self.examples, self.held, self.settings = task, examples, held, settings
        self.steps = max(len(examples) // settings.batch, 1)
        self._epoch, self._order = 0, np.arange(len(examples))
        self._random = np.random.default_rng(settings.seed)
        torch.manual_seed(settings.seed)
        self.net: nn.Module = build_network(task, settings.network, settings.width, robot, criteria)
        self.net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # not in torch's stubs
        self.optimiser: torch.optim.Optimizer = torch.optim.Adam(self.net.parameters(), lr=settings.learning_rate)
        hips = hip_heights(robot)
        self.hips = torch.tensor(hips, dtype=torch.float32)
        self.basis = basis_matrix(hips)
        self.bf16 = multiplies_bf16(torch.device("cpu")) if settings.bf16 is None else settings.bf16

    def begin(self, epoch: int) -> None:
        """Shuffle the samples."""
        self._epoch = epoch
        self._random = np.random.default_rng([self.settings.seed, epoch])
        self._order = self._random.permutation(len(self.examples))

    def update(self, step: int) -> float:
        """Take one step of Adam on a batch and return its loss."""
        rows = np.sort(self._order[step * self.settings.batch : (step + 1) * self.settings.batch])
        for group in self.optimiser.param_groups:
            group["lr"] = self._rate(self._epoch + step / self.steps)
        loss = self._loss(self.examples, rows)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        self.optimiser.step()
        return float(loss.detach())

    @torch.no_grad()
    def measure(self, training_loss: float) -> dict[str, Any]:
        """Return the mean losses during training and on the held-out samples."""
        self.net.eval()
        total, batch = 0.0, self.settings.batch
        self._random = np.random.default_rng(self.settings.seed)  # the same cells after each epoch
        for first in range(0, len(self.held), batch):
            rows = np.arange(first, min(first + batch, len(self.held)))
            total += float(self._loss(self.held, rows)) * len(rows)
        return {"training_loss": training_loss, "loss": total / len(self.held)}

    def _rate(self, epoch: float) -> float:
        """Adam's rate: the paper's at first, down to a hundredth of it along a cosine over the epochs allowed."""
        falling = 0.5 * (1 + math.cos(math.pi * epoch / self.settings.epochs))
        return self.settings.learning_rate * (0.01 + 0.99 * falling)

    def _loss(self, examples: Examples, rows: NDArray[np.int64]) -> Tensor:
        heights = torch.from_numpy(examples.heights[rows].astype(np.float32))
        vector = torch.from_numpy(examples.vector[rows])
        if isinstance(self.net, Dense):
            return self._dense_loss(self.net, heights, vector, examples.hip[rows], examples.cells[rows])
        assert examples.coarse is not None
        coarse = torch.from_numpy(examples.coarse[rows].astype(np.float32))
        with torch.autocast("cpu", torch.bfloat16, enabled=self.bf16):
            out = self.net(heights, vector, coarse).float()
        if isinstance(self.net, PaperVfa):
            return functional.cross_entropy(out, torch.from_numpy(examples.optimal[rows]))
        # Between the functions of the predicted weights and the counts that true weights are fitted to (appendix A);
        # not their squares, which a few open maps would rule, but each map's error by how many footholds it has.
        wanted = torch.from_numpy(examples.counts[rows])
        error = (out @ self.basis.T - wanted).abs().mean(dim=1)
        return (error / (wanted.mean(dim=1) + _FEW)).mean()

    def _dense_loss(
        self, net: Dense, heights: Tensor, vector: Tensor, hip: NDArray[np.float32], cells: NDArray[np.uint8]
    ) -> Tensor:
        """Cross-entropy of whether the leg stays clear of the terrain, for some cells of each map."""
        chosen = _choose_cells(cells, self._random)
        label = torch.from_numpy(np.take_along_axis(cells.reshape(len(cells), -1), chosen, axis=1))
        told = net.cues(heights, vector, torch.from_numpy(chosen))
        with torch.autocast("cpu", torch.bfloat16, enabled=self.bf16):
            logit = net.clear(net.judge(told, vector)[:, 3], torch.from_numpy(hip)[:, None])
        loss = functional.binary_cross_entropy_with_logits(logit, (label == _CLEAR).float(), reduction="none")
        learned = label != _SETTLED
        return (loss * learned).sum() / learned.sum().clamp(min=1)


def _choose_cells(cells: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.int64]:
    """(n, _CELLS) numbers of cells to learn from, at random, those beside one of another label rather than others."""
    clear = cells == _CLEAR
    edge = np.zeros(cells.shape, bool)
    for axis in (1, 2):
        here, there = (np.moveaxis(edge, axis, 0)[part] for part in (slice(1, None), slice(None, -1)))
        changes = np.diff(np.moveaxis(clear, axis, 0), axis=0)
        here |= changes
        there |= changes
    rank = rng.random(cells.shape, dtype=np.float32) + _PREFERENCE * edge
    rank[cells == _SETTLED] = -1
    return np.argpartition(-rank.reshape(len(cells), -1), _CELLS, axis=1)[:, :_CELLS]
