"""A robot walks through a drawn scene with its camera running: images, labels and poses, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legtool.configs.camera import DepthNoise
from legtool.configs.robots import SeeingRobot
from legtool.configs.scenes import SceneSettings
from legtool.sim.sensors.camera_motion import camera_poses
from legtool.sim.sensors.depth_camera import look, mount
from legtool.sim.worlds.labels import label_image
from legtool.sim.worlds.placement import DrawnScene, draw_scene
from legtool.sim.worlds.raycast import Cast
from legtool_runtime.perception.camera import Camera

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SceneView:
    """What the camera meets at one frame.

    Attributes:
        seen: exact, but for returns nearer than the sensor can see.
        label: (h, w) of LABELS, exact.
        depth: (h, w) float32 as the sensor has it [m], NaN without return.
    """

    seen: Cast
    label: NDArray[np.uint8]
    depth: NDArray[np.float32]


def view(
    drawn: DrawnScene,
    robot: SeeingRobot,
    camera: Camera,
    pose: Array,
    noise: DepthNoise,
    rng: np.random.Generator,
) -> SceneView:
    """Look at a scene once.

    Args:
        drawn: the scene.
        robot: the sensor's range, and the highest swing, that labels go by.
        camera: intrinsics.
        pose: (4, 4) optical frame to world.
        noise: errors of the camera.
        rng: of the errors.
    """
    image = look(drawn.world.scene, robot.camera, pose, rng, camera=camera, noise=noise)
    label = label_image(drawn.world, image.seen, camera, pose, swing_height_max=robot.swing_height_max)
    return SceneView(image.seen, label, image.depth)


@dataclass(frozen=True, eq=False)
class SequenceFrame:
    """One frame of a walk: the ``view``, and (4, 4) poses of camera (optical frame) and base in the world."""

    view: SceneView
    camera_to_world: Array
    base_to_world: Array


def walk_through(
    settings: SceneSettings, robot: SeeingRobot, number: int
) -> tuple[DrawnScene, Iterator[SequenceFrame]]:
    """A scene and the frames of a walk through it: the same bits for the same settings and number.

    Args:
        settings: of scene and camera; each ``SceneView`` holds exact depth, and that with all errors of the camera.
        robot: whose camera looks.
        number: of the scene.
    """
    shapes, walk, sensor = np.random.default_rng([settings.seed, number]).spawn(3)
    camera, noise = robot.camera.camera(), robot.camera.noise
    if settings.corruptions is not None:
        noise = noise.replace(steps=settings.corruptions)
    drawn = draw_scene(settings, robot, shapes)
    poses = camera_poses(drawn, robot, settings.camera, settings.frames, walk)
    base_from_camera = np.linalg.inv(mount(robot.camera))

    def steps() -> Iterator[SequenceFrame]:
        for pose in poses:
            yield SequenceFrame(view(drawn, robot, camera, pose, noise, sensor), pose, pose @ base_from_camera)

    return drawn, steps()
