"""A foothold network as a run on disk left it: its description, and its best weights loaded."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import nn

from legtool.datasets.network_run import FOOTHOLD_KINDS, load_best, read_run
from legtool.errors import DatasetError
from legtool.models.foothold import Dense, build_network
from legtool_runtime.foothold import Criteria, CriteriaSettings
from legtool_runtime.foothold.features import FEATURES, Kind
from legtool_runtime.robot import Robot


def input_kind(task: str, network: str) -> Kind:
    """What inputs are encoded for: the network of a task, or the dense one that serves both."""
    if network == "dense":
        return "dense"
    return "vfa" if task == "vfa" else "vpa"


@dataclass(frozen=True, eq=False)
class FootholdRun:
    """A run, its best weights loaded.

    Attributes:
        path: its directory.
        description: ``run.json``.
        robot: whose footholds it learned.
        criteria: that judged them.
        task: ``vfa`` or ``vpa``.
        network: ``paper`` or ``dense``; the dense one serves both tasks.
        net: with its best weights, in evaluation mode.
    """

    path: Path
    description: dict[str, Any]
    robot: Robot
    criteria: Criteria
    task: str
    network: str
    net: nn.Module

    @property
    def kind(self) -> Kind:
        """What its network's inputs are encoded for."""
        return input_kind(self.task, "dense" if isinstance(self.net, Dense) else self.network)

    def untrained(self) -> FootholdRun:
        """The same with the weights that training started from: the check by the criteria or the geometry that the
        network is told of, corrected by nothing. Its ``network`` is ``guess``."""
        settings = self.description["settings"]
        net = build_network(self.task, self.network, settings["width"], self.robot, self.criteria.settings)
        return replace(self, network="guess", net=net.eval())


def load_foothold_run(path: Path) -> FootholdRun:
    """Load a run with its best weights, finished or not.

    Raises:
        DatasetError: not a run of this line, damaged, newer than this legtool, without a finished epoch, or trained on
            other inputs than networks take now.
    """
    tasks = {kind: task for task, kind in FOOTHOLD_KINDS.items()}
    description = read_run(path, tasks, "legtool train vfa or legtool train vpa")
    if description.get("preparation") != [name for name, _ in FEATURES]:
        raise DatasetError(
            f"{path}: its network learned from other inputs than this legtool's, which hold the trunk's roll and "
            "pitch; collect footholds and train it anew"
        )
    task, settings = tasks[description["kind"]], description["settings"]
    robot = Robot.from_dict(description["robot"])
    criteria = Criteria(robot, CriteriaSettings(**description["criteria"]))
    net = build_network(task, settings["network"], settings["width"], robot, criteria.settings)
    load_best(path, net)
    return FootholdRun(path, description, robot, criteria, task, settings["network"], net.to(torch.float32))
