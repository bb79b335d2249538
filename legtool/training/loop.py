"""The training loop, on PyTorch Ignite: epochs, early stopping, and a state on disk to resume from."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import torch
from ignite.engine import Engine, Events
from ignite.handlers import EarlyStopping
from ignite.metrics import Average
from torch import nn

from legtool.datasets.files import write_json
from legtool.datasets.network_run import BEST, LAST, load_tensors, save_tensors
from legtool.datasets.work import RUN
from legtool.progress import progress

#: Channels from which PyTorch's pointwise convolutions of stride 2 are sound in every memory format.
_NARROW = 16


class Learner(Protocol):
    """A network and how it learns. All random draws are a function of its settings and the epoch.

    Attributes:
        net: the network.
        optimiser: optimiser of its parameters.
        steps: number of steps in an epoch.
    """

    net: nn.Module
    optimiser: torch.optim.Optimizer
    steps: int

    def begin(self, epoch: int) -> None:
        """Prepare an epoch, counted from 0."""

    def update(self, step: int) -> float:
        """Take one step of the epoch and return its loss."""
        ...

    def measure(self, training_loss: float) -> dict[str, Any]:
        """Return the record of the epoch: its mean loss, and metrics on held-out data."""
        ...


def fit(
    learner: Learner,
    run: dict[str, Any],
    out: Path,
    *,
    epochs: int,
    score: Callable[[dict[str, Any]], float],
    patience: int | None = None,
) -> None:
    """Train to the end, from the start or from the epoch at which the run was interrupted, with the same weights.

    After each epoch the directory of the run contains the best weights, the history, and the state of everything that
    the rest of the training depends on.

    Args:
        learner: network, optimiser, data.
        run: ``run.json`` as claimed; its history, best epoch and completion are kept up to date.
        out: the run's directory.
        epochs: the greatest number of epochs.
        score: score of the record that :meth:`Learner.measure` returns; larger is better.
        patience: epochs without a better score before training stops; None to train all epochs.

    Raises:
        DatasetError: the state on disk is damaged.
        OutputError: the disk is full, or the files cannot be written.
    """
    engine = Engine(lambda _, step: learner.update(step))
    engine.logger.setLevel(logging.CRITICAL)  # an interruption is told once, by the command
    Average().attach(engine, "loss")
    stopper = EarlyStopping(patience or epochs, lambda _: score(run["history"][-1]), engine)
    stopper.logger.setLevel(logging.WARNING)  # that it stopped is told by how many epochs there were
    done = 0
    if (out / LAST).is_file():
        state = load_tensors(out / LAST)
        done = int(state["epoch"])
        learner.net.load_state_dict(state["net"])
        learner.optimiser.load_state_dict(state["optimiser"])
        stopper.load_state_dict(state["stopper"])
        run["history"] = run["history"][:done]
        engine.load_state_dict({"epoch": done, "epoch_length": learner.steps, "max_epochs": epochs})
    began = time.perf_counter()

    @engine.on(Events.EPOCH_STARTED)
    def begin(engine: Engine) -> None:
        nonlocal began
        began = time.perf_counter()
        learner.net.train()
        learner.begin(engine.state.epoch - 1)

    @engine.on(Events.EPOCH_COMPLETED)
    def keep(engine: Engine) -> None:
        entry = {"epoch": engine.state.epoch, **learner.measure(float(engine.state.metrics["loss"]))}
        entry["seconds"] = time.perf_counter() - began
        run["history"].append(entry)
        if run["best"] is None or score(entry) > score(run["best"]):
            run["best"] = entry
            save_tensors(out / BEST, {name: tensor.cpu() for name, tensor in learner.net.state_dict().items()})
        stopper(engine)
        run["complete"] = bool(engine.should_terminate) or engine.state.epoch >= epochs
        # The description before the state: a kill between them repeats the epoch, and nothing is lost.
        write_json(out / RUN.marker, run)
        state = {"epoch": engine.state.epoch, "stopper": dict(stopper.state_dict())}
        save_tensors(
            out / LAST, {**state, "net": learner.net.state_dict(), "optimiser": learner.optimiser.state_dict()}
        )

    with progress("training", epochs * learner.steps, "steps", done=done * learner.steps) as advance:
        engine.add_event_handler(Events.ITERATION_COMPLETED, lambda: advance(1))
        engine.run(range(learner.steps), max_epochs=epochs, epoch_length=learner.steps)


def layout_for(net: nn.Module, device: torch.device) -> torch.memory_format:
    """The memory format that a network trains fastest in: channels last.

    On a processor, PyTorch (2.13) ends with a segmentation fault in a pointwise convolution of stride 2 with fewer than
    16 channels in that format; networks with one keep the usual format.
    """
    narrow = any(
        part.kernel_size == (1, 1) and part.stride != (1, 1) and part.in_channels < _NARROW
        for part in net.modules()
        if isinstance(part, nn.Conv2d)
    )
    return torch.contiguous_format if narrow and device.type == "cpu" else torch.channels_last


def multiplies_bf16(device: torch.device) -> bool:
    """Return whether a device multiplies bfloat16 in hardware; otherwise bfloat16 is slower than single precision."""
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported())
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
