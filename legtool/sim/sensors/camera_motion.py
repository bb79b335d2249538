"""The camera's way through a scene: carried by a walking trunk, with jitter in all six dimensions (QuadPiPS, V-B4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool.configs.robots import SeeingRobot
from legtool.configs.scenes import CameraMotion
from legtool.sim.worlds.placement import DrawnScene
from legtool.sim.worlds.raycast import camera_pose

Array = NDArray[np.float64]

#: A walking trunk's bounce and nod, at two steps in this time.
_PERIOD_S, _BOUNCE_M, _NOD_RAD = 0.68, 0.01, 0.02


def camera_poses(
    drawn: DrawnScene, robot: SeeingRobot, motion: CameraMotion, frames: int, rng: np.random.Generator
) -> Array:
    """Optical frame to world at each frame.

    The trunk walks straight on at constant speed, at standing height above what carries its feet, pitched as they are.

    Args:
        drawn: the scene and its way.
        robot: standing height, hips, camera mount.
        motion: spread of the mount, jitter.
        frames: how many.
        rng: draws mount and jitter.

    Returns:
        (frames, 4, 4).
    """
    mount = np.array(robot.camera.position)
    height = robot.standing_height + rng.uniform(-1, 1) * motion.height_spread
    pitch = robot.camera.pitch + rng.uniform(-1, 1) * motion.pitch_spread
    phase = rng.uniform(0, 2 * np.pi)
    way = np.array([np.cos(drawn.heading), np.sin(drawn.heading)])
    left = np.array([-way[1], way[0]])
    front, hind = robot.hip_x
    poses = np.empty((frames, 4, 4))
    for k in range(frames):
        base = drawn.length * k / max(frames - 1, 1) * way
        feet = np.array(
            [
                base + x * way + side * left
                for x in (front, hind)
                for side in (robot.hip_y + robot.abduction_offset, -robot.hip_y - robot.abduction_offset)
            ]
        )
        ground = drawn.world.height(feet[:, 0], feet[:, 1], below=2.0)
        slope = float(np.clip((ground[:2].mean() - ground[2:].mean()) / (front - hind), -0.4, 0.4))
        swing = 2 * np.pi * k * motion.frame_s / (_PERIOD_S / 2) + phase
        trunk_pitch = -float(np.arctan(slope)) + _NOD_RAD * np.cos(swing)
        z = ground.mean() + height + _BOUNCE_M * np.sin(swing)
        # The mount in the pitched trunk, then seen in the world.
        forward = np.cos(trunk_pitch) * mount[0] + np.sin(trunk_pitch) * mount[2]
        upward = -np.sin(trunk_pitch) * mount[0] + np.cos(trunk_pitch) * mount[2]
        position = np.array([*(base + forward * way + mount[1] * left), z + upward])
        jitter = rng.standard_normal(6)
        angles = np.array([0.0, pitch + trunk_pitch, drawn.heading]) + motion.jitter_angle * jitter[3:]
        poses[k] = camera_pose(
            position + motion.jitter_position * jitter[:3], roll=angles[0], pitch=angles[1], yaw=angles[2]
        )
    return poses
