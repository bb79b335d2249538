"""Who walks a suite: the robot of the bundle, of a preset, or of an MJCF file, and its depth camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from legtool.configs.camera import DepthCamera
from legtool.configs.mjcf import MjcfNames
from legtool.configs.planner import PlannerEvalSettings
from legtool.configs.robots import PRESETS, RobotSettings, load_robot
from legtool.datasets.contents import mjcf_content
from legtool.errors import RobotError, SettingsError
from legtool.sim.robots.mjcf import find_mjcf, load_mjcf
from legtool.sim.robots.named import camera_above_hips
from legtool.sim.robots.robot import SimRobot, build_robot
from legtool_runtime import Bundle, Robot

#: Hips this far apart are two robots' [m].
_ANOTHER_ROBOT_M = 0.03
#: The highest obstacle that the swing of an MJCF file's robot steps over [m]: only films show labels by it.
_SWING_HEIGHT_M = 0.15


@dataclass(frozen=True, eq=False)
class SuiteRobot:
    """The robot of a suite, to be put into any world.

    Attributes:
        name: for results.
        settings: lengths and masses; None for an MJCF file.
        mjcf: that file.
        mjcf_names: its elements' names.
        camera: its depth camera.
    """

    name: str
    settings: RobotSettings | None
    mjcf: Path | None
    mjcf_names: MjcfNames
    camera: DepthCamera

    def build(self, world: mujoco.MjSpec | None = None) -> SimRobot:
        """The robot in a world; without one on a flat floor."""
        if self.mjcf is not None:
            return load_mjcf(self.mjcf, self.mjcf_names, world)
        assert self.settings is not None
        return build_robot(self.settings, world)

    def content(self) -> dict[str, Any]:
        """All that decides how it walks, for the identity of trials."""
        made: dict[str, Any] = {}
        if self.mjcf is not None:
            made = {"mjcf": mjcf_content(self.mjcf), "names": self.mjcf_names.to_dict()}
        elif self.settings is not None:
            made = {"settings": self.settings.to_dict()}
        return {**made, "camera": self.camera.to_dict()}

    @property
    def geometry(self) -> Robot:
        """Its kinematics."""
        return self.build().geometry if self.settings is None else self.settings.geometry()

    @property
    def swing_height_max(self) -> float:
        """Highest obstacle that a swing steps over [m]."""
        return _SWING_HEIGHT_M if self.settings is None else self.settings.swing_height_max


def suite_robot(settings: PlannerEvalSettings, bundle: Bundle | None) -> SuiteRobot:
    """The robot that a suite walks.

    Args:
        settings: ``robot``, ``mjcf`` and ``camera`` name it; what they leave open comes from the bundle.
        bundle: that planners plan with.

    Raises:
        RobotError: the bundle was made for another robot, or for one that is no preset and is not named.
        SettingsError: neither a robot nor a bundle is named.
    """
    preset = None if settings.robot is None else load_robot(settings.robot)
    if settings.mjcf is None and preset is None:
        if bundle is None:
            raise SettingsError("--robot is missing: without a bundle, name the robot that walks (or its --mjcf)")
        if not _is_preset(bundle.robot.name):
            raise RobotError(
                f"the bundle is made for {bundle.robot.name}, which is no preset; name its YAML file with --robot, or "
                "its model with --mjcf"
            )
        preset = load_robot(bundle.robot.name)
    mjcf = None if settings.mjcf is None else find_mjcf(settings.mjcf)
    if preset is None and bundle is not None and _is_preset(bundle.robot.name):
        preset = load_robot(bundle.robot.name)  # its camera: an MJCF file has none
    name = preset.name if mjcf is None and preset is not None else settings.mjcf or ""
    robot = SuiteRobot(name, preset if mjcf is None else None, mjcf, settings.mjcf_names, DepthCamera())
    built = robot.build()
    if bundle is not None:
        _check_bundle(bundle, built, preset if mjcf is None else None, name)
    width, height = settings.camera_size
    camera = settings.camera or (preset.camera if preset is not None else None)
    camera = (camera or camera_above_hips(built.geometry)).replace(width=width, height=height)
    return SuiteRobot(built.geometry.name, robot.settings, mjcf, settings.mjcf_names, camera)


def policy_robot(robot: SuiteRobot, settings: PlannerEvalSettings) -> SuiteRobot:
    """The robot of the suite as ANYmal's policies walk it: a model with the masses of the real one.

    Raises:
        RobotError: the package that the model comes from is not installed.
        SettingsError: the suite's robot is another one than the model.
    """
    where = settings.policies.robot
    if where is None:
        return robot
    height = round(robot.geometry.standing_height, 4)
    names = MjcfNames(standing_height=height)
    made = SuiteRobot(robot.name, None, find_mjcf(where), names, robot.camera)
    if np.abs(made.build().geometry.hips - robot.geometry.hips).max() > _ANOTHER_ROBOT_M:
        raise SettingsError(
            f"robot {robot.name}: em_rl and em_dtc are policies of another robot ({where}); choose --robot anymal_c or "
            "leave them out"
        )
    return made


def _is_preset(name: str) -> bool:
    return (PRESETS / f"{name}.yaml").is_file()


def _check_bundle(bundle: Bundle, built: SimRobot, preset: RobotSettings | None, name: str) -> None:
    made = bundle.robot
    if preset is not None and made.name != preset.name:
        raise RobotError(f"the bundle is made for {made.name}, the suite walks {name}; set robot, or leave it out")
    if np.abs(built.geometry.hips - made.hips).max() > _ANOTHER_ROBOT_M:
        raise RobotError(f"the bundle is made for another robot ({made.name}) than {name}; their hips differ")
