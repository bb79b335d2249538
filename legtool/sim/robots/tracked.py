"""A simulated robot as the tracking controller knows it."""

from __future__ import annotations

from legtool.sim.robots.robot import SimRobot
from legtool_runtime.tracking.model import TrackedRobot


def tracked_robot(robot: SimRobot) -> TrackedRobot:
    """The runtime's description of a simulated robot's dynamics, taken from its compiled model.

    Raises:
        RobotError: a mass, inertia or limit that cannot be controlled with.
    """
    return TrackedRobot(
        geometry=robot.geometry,
        trunk_mass=robot.trunk_mass,
        trunk_com=robot.trunk_com,
        trunk_inertia=robot.trunk_inertia,
        link_mass=robot.link_mass,
        link_com=robot.link_com,
        link_inertia=robot.link_inertia,
        armature=robot.armature,
        joint_friction=robot.joint_friction,
        joint_damping=robot.joint_damping,
        torque_limit=robot.torque_limit,
    )
