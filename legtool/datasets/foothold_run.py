"""A run of the foothold line on disk: the files of every network's run, and how to load its best weights."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import nn

from legtool.datasets.steppability_run import BEST, RUN, SCHEMA_VERSION, load_tensors
from legtool.datasets.store import read_json
from legtool.errors import DatasetError
from legtool.models.foothold import build_network
from legtool_runtime.foothold import Criteria, CriteriaSettings
from legtool_runtime.robot import Robot

#: Kinds of run, by task.
KINDS = {"vfa": "foothold_vfa", "vpa": "foothold_vpa"}


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


def load_foothold_run(path: Path) -> FootholdRun:
    """Load a run with its best weights, finished or not.

    Raises:
        DatasetError: not a run of this line, damaged, newer than this legtool, or without a finished epoch.
    """
    if not (path / RUN).is_file():
        raise DatasetError(f"{path}: not a run (no {RUN}); make one with legtool train vfa or legtool train vpa")
    description = read_json(path / RUN)
    tasks = {kind: task for task, kind in KINDS.items()}
    if description.get("kind") not in tasks:
        raise DatasetError(f"{path}: a run of kind {description.get('kind')!r}, expected {' or '.join(tasks)}")
    if not isinstance(description.get("schema_version"), int) or description["schema_version"] > SCHEMA_VERSION:
        raise DatasetError(f"{path}: schema {description.get('schema_version')} is newer; upgrade legtool")
    if description.get("best") is None:
        raise DatasetError(f"{path}: no epoch is finished; run its train command again to carry on")
    task, settings = tasks[description["kind"]], description["settings"]
    robot = Robot.from_dict(description["robot"])
    criteria = Criteria(robot, CriteriaSettings(**description["criteria"]))
    net = build_network(task, settings["network"], settings["width"], robot, criteria.settings)
    try:
        net.load_state_dict(load_tensors(path / BEST))
    except RuntimeError as error:
        raise DatasetError(f"{path / BEST}: not the weights of this run's network; train again") from error
    return FootholdRun(path, description, robot, criteria, task, settings["network"], net.eval().to(torch.float32))
