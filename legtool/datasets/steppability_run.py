"""A run of the steppability line on disk: ``run.json``, the best weights, and the state to carry on from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from legtool.configs.robots import RobotSettings
from legtool.configs.settings import build
from legtool.configs.steppability import NetworkSettings
from legtool.datasets.store import claim_directory, read_json, replacing, write_json
from legtool.errors import DatasetError, OutputError
from legtool.models.steppability import SteppabilityNet
from legtool_runtime.perception.camera import Camera
from legtool_runtime.perception.depth import prepared_camera

KIND = "steppability"
RUN, BEST, LAST = "run.json", "best.pt", "last.pt"
SCHEMA_VERSION = 1
#: What makes two commands the same training.
_IDENTITY = ("kind", "robot", "settings", "preparation", "data_hash")


@dataclass(frozen=True, eq=False)
class SteppabilityRun:
    """A run, its best weights loaded.

    Attributes:
        path: its directory.
        description: ``run.json``: robot, settings, preparation, history of epochs, the best of them, provenance.
        robot: whose camera took the images.
        camera: of the prepared images.
        net: the network with its best weights, in evaluation mode.
    """

    path: Path
    description: dict[str, Any]
    robot: RobotSettings
    camera: Camera
    net: SteppabilityNet


def claim_run(path: Path, description: Mapping[str, Any]) -> dict[str, Any]:
    """Begin a run, or take up the one that the same command left there; its ``run.json``.

    Raises:
        OutputError: the directory holds something else, or a run of other settings or data.
    """
    claim_directory(path, RUN)
    if (path / RUN).is_file():
        there = read_json(path / RUN)
        for key in _IDENTITY:
            if there.get(key) != description[key]:
                raise OutputError(f"{path}: holds a run with another {key}; choose another --out, or remove it")
        return there
    fresh = {"schema_version": SCHEMA_VERSION, **description, "history": [], "best": None, "complete": False}
    write_json(path / RUN, fresh)
    return fresh


def save_tensors(path: Path, state: Mapping[str, Any]) -> None:
    """Write tensors atomically.

    Raises:
        OutputError: the disk is full or the place cannot be written.
    """
    with replacing(path) as temporary:
        torch.save(dict(state), temporary)


def load_tensors(path: Path) -> dict[str, Any]:
    """Read tensors; nothing in the file is run.

    Raises:
        DatasetError: missing or damaged.
    """
    try:
        loaded: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise DatasetError(f"{path}: missing; train again") from error
    except Exception as error:
        raise DatasetError(f"{path}: damaged, cannot be read; remove the run and train again") from error
    return loaded


def build_net(network: NetworkSettings, robot: RobotSettings, camera: Camera) -> SteppabilityNet:
    """The network for a robot's prepared images, with random weights."""
    height = robot.standing_height + robot.camera.position[2]
    return SteppabilityNet(network, camera, pitch=robot.camera.pitch, height=height)


def load_run(path: Path) -> SteppabilityRun:
    """Load a run with its best weights, finished or not.

    Raises:
        DatasetError: not a run of this line, damaged, newer than this legtool, or without a finished epoch.
    """
    if not (path / RUN).is_file():
        raise DatasetError(f"{path}: not a run (no {RUN}); make one with legtool train steppability")
    description = read_json(path / RUN)
    if description.get("kind") != KIND:
        raise DatasetError(f"{path}: a run of kind {description.get('kind')!r}, expected {KIND}")
    if not isinstance(description.get("schema_version"), int) or description["schema_version"] > SCHEMA_VERSION:
        raise DatasetError(
            f"{path}: schema {description.get('schema_version')} is newer than {SCHEMA_VERSION}; upgrade"
        )
    if description.get("best") is None:
        raise DatasetError(f"{path}: no epoch is finished; run its train command again to carry on")
    robot = build(RobotSettings, description["robot"], source=str(path / RUN))
    network = build(NetworkSettings, description["settings"]["network"], source=str(path / RUN))
    camera = prepared_camera(robot.camera.camera(), description["preparation"])
    net = build_net(network, robot, camera)
    try:
        net.load_state_dict(load_tensors(path / BEST))
    except RuntimeError as error:
        raise DatasetError(f"{path / BEST}: not the weights of this run's network; train again") from error
    return SteppabilityRun(path, description, robot, camera, net.eval())
