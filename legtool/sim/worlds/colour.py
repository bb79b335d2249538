"""A colour image of a scene, for people to look at."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool.configs.world_parts import SHAPES
from legtool.sim.worlds.raycast import Cast
from legtool.sim.worlds.world import FLOOR, World
from legtool_runtime.perception.camera import Camera

#: Red, green, blue of each class.
COLOURS = np.array(
    [
        (70, 130, 200), (210, 140, 60), (120, 180, 110), (200, 80, 90), (160, 100, 190),
        (230, 200, 70), (90, 190, 190), (220, 130, 170), (175, 170, 160), (205, 205, 195),
    ]
)  # fmt: skip
_SKY = np.array([150.0, 190.0, 235.0])
_LIGHT = np.array([-0.45, 0.35, 0.82])
assert len(COLOURS) == len(SHAPES)


def colour_image(world: World, seen: Cast, camera: Camera, pose: ArrayLike, *, step: int = 2) -> NDArray[np.uint8]:
    """Shaded shapes on a chequered floor of 0.5 m squares.

    Args:
        world: what was seen.
        seen: by the ray caster, with normals.
        camera, pose: (4, 4) optical frame to world, that it was seen with.
        step: every ``step``-th pixel is drawn.

    Returns:
        (h / step, w / step, 3) red, green, blue.
    """
    pose = np.asarray(pose, dtype=np.float32)
    depth, geom, normal = seen.depth[::step, ::step], seen.geom[::step, ::step], seen.normal[::step, ::step]
    u = (np.arange(0, camera.width, step, dtype=np.float32) - camera.cx) / camera.fx
    v = (np.arange(0, camera.height, step, dtype=np.float32) - camera.cy) / camera.fy
    x, y = (
        pose[k, 3] + depth * (pose[k, 0] * u + pose[k, 1] * v[:, None] + pose[k, 2]) for k in range(2)
    )  # world coordinates
    classes = np.append(world.classes, 0)[geom]
    # Shapes of a class differ a little, so that two of them are told apart where they touch.
    tone = 0.85 + 0.3 * ((geom * 0.618034) % 1.0)
    with np.errstate(invalid="ignore"):
        dark = (np.floor(2 * x) + np.floor(2 * y)) % 2 == 1
    tone = np.where(classes == FLOOR, np.where(dark, 0.85, 1.0), tone)
    light = 0.45 + 0.55 * np.clip(normal @ _LIGHT.astype(np.float32), 0, 1)
    picture = COLOURS.astype(np.float32)[classes] * (tone * light)[..., None]
    picture[geom < 0] = _SKY
    return np.clip(picture, 0, 255).astype(np.uint8)
