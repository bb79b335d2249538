"""The simulated depth camera: scenes for training, perception walks and closed loops all look through it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool.configs.camera import DepthCamera, DepthNoise
from legtool.sim.sensors.depth_noise import corrupt
from legtool.sim.worlds.raycast import Cast, Scene, camera_pose, cast
from legtool_runtime.perception.camera import Camera

Array = NDArray[np.float64]

#: Cameras on the left and right are this far off the middle of the trunk [m].
_BESIDE_M = 0.2


class Look(NamedTuple):
    """One image of the depth camera.

    Attributes:
        seen: exact within the camera's range: depth is NaN where there is no return.
        depth: (h, w) float32 as the camera measures it [m], NaN without return.
    """

    seen: Cast
    depth: NDArray[np.float32]


def look(
    scene: Scene,
    sensor: DepthCamera,
    pose: ArrayLike,
    rng: np.random.Generator,
    *,
    camera: Camera | None = None,
    noise: DepthNoise | None = None,
    normals: bool = True,
) -> Look:
    """Take one image.

    Args:
        scene: what there is to see.
        sensor: range and errors.
        pose: (4, 4) optical frame to world.
        rng: of the errors.
        camera: intrinsics of another image size than the sensor's own.
        noise: other errors than the sensor's own.
        normals: whether the exact cast holds normals.
    """
    near, far = sensor.range_m
    seen = cast(scene, camera or sensor.camera(), pose, far=far, normals=normals)
    seen = seen._replace(depth=np.where(seen.depth < near, np.float32(np.nan), seen.depth))
    # Where a surface floor meets the ground around it there is no boundary of an object.
    objects = np.where(seen.geom == len(scene.kinds), 0, seen.geom).astype(np.int32)
    return Look(seen, corrupt(seen.depth, objects, noise or sensor.noise, rng))


class SideCamera(NamedTuple):
    """A depth camera that looks ``yaw`` [rad] to the left of the trunk's forward axis."""

    camera: DepthCamera
    yaw: float


def mount(sensor: DepthCamera, *, yaw: float = 0.0) -> Array:
    """(4, 4) nominal optical frame to base.

    Args:
        sensor: where it is, and how far it looks down.
        yaw: how far it looks to the left [rad].
    """
    return camera_pose(sensor.position, pitch=sensor.pitch, yaw=yaw)


def side_cameras(sensor: DepthCamera) -> tuple[SideCamera, SideCamera]:
    """The same camera twice more, on the left and on the right of the trunk, looking to these sides."""
    z = sensor.position[2]
    left, right = (sensor.replace(position=(0.0, y, z)) for y in (_BESIDE_M, -_BESIDE_M))
    return SideCamera(left, 0.5 * np.pi), SideCamera(right, -0.5 * np.pi)
