"""The label of every face of a world, pixel by pixel (QuadPiPS, section V-B2)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool.sim.worlds.carriers import TOP, Carriers, highest_carrier
from legtool.sim.worlds.raycast import Cast
from legtool.sim.worlds.rays import PixelRays, pixel_ray, view_of
from legtool.sim.worlds.surface import HeightGrid, grid_of
from legtool.sim.worlds.world import FLOOR, SPHERIC, TUBULAR, WALL, World
from legtool_runtime.cache import kernel
from legtool_runtime.perception import NON_PASSABLE, PASSABLE, STEPPABLE, UNKNOWN
from legtool_runtime.perception.camera import Camera

Array = NDArray[np.float64]

#: Support beside a face is looked for this far outside it [m].
_BESIDE = 0.01


class LabelledFaces(NamedTuple):
    """How the faces of n primitives are labelled.

    ``whole`` (n,) the label of all faces, UNKNOWN where it depends on the face; ``tops`` (n,) highest points [m];
    ``ground`` (n,) whether the top faces are steppable.
    """

    whole: NDArray[np.uint8]
    tops: Array
    ground: NDArray[np.bool_]


def label_image(
    world: World, seen: Cast, camera: Camera, pose: ArrayLike, *, swing_height_max: float
) -> NDArray[np.uint8]:
    """The label of every pixel, exact: that of the face its ray meets.

    Top faces of cuboids, ramps and cylinders are steppable, and so is floor, where they are ground. Other faces are
    passable where the riser, from the support beside the face to the shape's top, is at most ``swing_height_max``. The
    other classes are passable as a whole where their top is at most that far above the support below their middle.
    Walls, ceiling, and floor that is no ground are non-passable. A primitive with a label of its own keeps it.

    Args:
        world: what was seen.
        seen: by the ray caster, with normals.
        camera, pose: (4, 4) optical frame to world, that it was seen with.
        swing_height_max: highest obstacle that a swing steps over [m].

    Returns:
        (h, w) of ``legtool_runtime.perception.LABELS``; unknown where there is no return.
    """
    faces = LabelledFaces(_whole(world, swing_height_max), world.tops, world.ground)
    labels = np.empty(seen.geom.shape, dtype=np.uint8)
    floor = grid_of(world.scene.surface)
    _label(faces, world.carriers, floor, view_of(camera, pose), swing_height_max, seen, labels)
    return labels


def class_image(world: World, seen: Cast) -> NDArray[np.uint8]:
    """(h, w) number in SHAPES of the shape at each pixel plus one, 0 where there is no return."""
    return np.append(world.classes + 1, 0).astype(np.uint8)[seen.geom]


def _whole(world: World, swing_height_max: float) -> NDArray[np.uint8]:
    """(n,) the label that all faces of each primitive share, UNKNOWN where they differ."""
    whole = np.full(len(world.classes), UNKNOWN, dtype=np.uint8)
    whole[world.classes == FLOOR] = np.where(world.ground, STEPPABLE, NON_PASSABLE)[world.classes == FLOOR]
    whole[world.classes == WALL] = NON_PASSABLE
    for g in np.flatnonzero((world.classes >= SPHERIC) & (world.classes <= TUBULAR)):
        x, y = world.scene.positions[g, :2]
        rise = world.tops[g] - float(world.height(x, y, below=world.tops[g] - 1e-6))
        whole[g] = PASSABLE if rise <= swing_height_max else NON_PASSABLE
    return np.where(world.labels != UNKNOWN, world.labels, whole)


@kernel
def _floor(heights: Array, i: float, j: float) -> float:
    """Height of the surface at the grid point nearest to (i, j); -inf beside it."""
    if not (0.0 <= i <= heights.shape[0] - 1.0 and 0.0 <= j <= heights.shape[1] - 1.0):
        return -np.inf
    return heights[int(i + 0.5), int(j + 0.5)]


@kernel
def _label(
    faces: LabelledFaces, carriers: Carriers, floor: HeightGrid, view: PixelRays, swing_height_max: float, seen: Cast,
    labels: NDArray[np.uint8],
) -> None:  # fmt: skip
    whole, tops, ground = faces.whole, faces.tops, faces.ground
    depth, geom, normal = seen.depth, seen.geom, seen.normal
    heights, upright, turned = floor.heights, carriers.upright, carriers.turned
    turn, px, py = view.turn, view.position[0], view.position[1]
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            g = geom[v, u]
            if g < 0:
                labels[v, u] = UNKNOWN
                continue
            if whole[g] != UNKNOWN:
                labels[v, u] = whole[g]
                continue
            nx, ny, nz = normal[v, u, 0], normal[v, u, 1], normal[v, u, 2]
            if nz > TOP and ground[g]:
                labels[v, u] = STEPPABLE
                continue
            t = depth[v, u]
            dx, dy, _ = pixel_ray(view, turn, u, v)
            x = px + t * dx + _BESIDE * nx
            y = py + t * dy + _BESIDE * ny
            i, j = (x - floor.corner[0]) / floor.resolution, (y - floor.corner[1]) / floor.resolution
            beside = max(highest_carrier(upright, turned, x, y, tops[g])[0], _floor(heights, i, j))
            labels[v, u] = PASSABLE if tops[g] - beside <= swing_height_max else NON_PASSABLE
