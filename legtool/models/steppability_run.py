"""A segmenter as a run on disk left it: its description, and its best weights loaded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from legtool.configs.robots import SeeingRobot, read_seeing_robot
from legtool.configs.settings import build
from legtool.configs.steppability import NetworkSettings
from legtool.datasets.network_run import STEPPABILITY_KIND, load_best, read_run
from legtool.datasets.work import RUN
from legtool.models.steppability import SteppabilityNet
from legtool_runtime.perception.camera import Camera
from legtool_runtime.perception.depth import prepared_camera


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
    robot: SeeingRobot
    camera: Camera
    net: SteppabilityNet


def build_net(network: NetworkSettings, robot: SeeingRobot, camera: Camera) -> SteppabilityNet:
    """The network for a robot's prepared images, with random weights."""
    height = robot.standing_height + robot.camera.position[2]
    return SteppabilityNet(network, camera, pitch=robot.camera.pitch, height=height)


def load_steppability_run(path: Path) -> SteppabilityRun:
    """Load a run with its best weights, finished or not.

    Raises:
        DatasetError: not a run of this line, damaged, newer than this legtool, or without a finished epoch.
    """
    description = read_run(path, [STEPPABILITY_KIND], "legtool train steppability")
    robot = read_seeing_robot(description["robot"], source=str(path / RUN.marker))
    network = build(NetworkSettings, description["settings"]["network"], source=str(path / RUN.marker))
    camera = prepared_camera(robot.camera.camera(), description["preparation"])
    net = build_net(network, robot, camera)
    load_best(path, net)
    return SteppabilityRun(path, description, robot, camera, net)
