"""A world of shapes with classes: what carries a foot where, and the label of every face (QuadPiPS, section V-B2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool.configs.scenes import SHAPES
from legtool.sim.worlds.raycast import Cast, Primitive, Scene, plane
from legtool.sim.worlds.raycast_kernels import CYLINDER, WEDGE
from legtool.sim.worlds.surface import Surface
from legtool_runtime.cache import kernel
from legtool_runtime.perception import NON_PASSABLE, PASSABLE, STEPPABLE, UNKNOWN
from legtool_runtime.perception.camera import Camera

Array = NDArray[np.float64]

CUBOID, RAMP, CYLINDRIC, SPHERIC, SEMISPHERIC, POLE, PIPE, TUBULAR, FLOOR, WALL = range(len(SHAPES))

#: Support beside a face is looked for this far outside it [m].
_BESIDE = 0.01
#: A face is the top where its normal is at most this far from the primitive's own top.
_TOP = 0.5


@dataclass(frozen=True, eq=False)
class World:
    """A scene whose primitives have classes.

    Attributes:
        scene: primitive 0 is the endless ground at z = 0; a surface lies on it.
        classes: (n,) index into SHAPES of each number the ray caster gives, the surface's included.
        tops: (n,) highest point of each [m]; of floors and walls it means nothing.
    """

    scene: Scene
    classes: NDArray[np.uint8]
    tops: Array

    def support(self, x: ArrayLike, y: ArrayLike, *, below: float = np.inf) -> Array:
        """Highest floor, cuboid, ramp or cylinder top at world x, y that is lower than ``below`` [m]."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        out = np.zeros(x.shape)
        if self.scene.surface is not None:
            out = np.maximum(out, self.scene.surface.height(x, y))
        carriers = carrier_table(self)
        flat = np.array([highest_carrier(carriers, u, v, below)[0] for u, v in zip(x.ravel(), y.ravel(), strict=True)])
        return np.maximum(out, flat.reshape(x.shape))


class Builder:
    """Collects shapes into a world."""

    def __init__(self, surface: Surface | None = None) -> None:
        self._surface = surface
        self._primitives: list[Primitive] = [plane([0.0, 0.0, 0.0], np.eye(3))]
        self._classes: list[int] = [FLOOR]
        self._tops: list[float] = [0.0]
        self.world = self._build()

    def add(self, shape: int, primitive: Primitive, top: float) -> None:
        """Add a primitive of class ``shape`` whose highest point lies at ``top`` [m]."""
        self._primitives.append(primitive)
        self._classes.append(shape)
        self._tops.append(top)
        self.world = self._build()

    def _build(self) -> World:
        extra = [] if self._surface is None else [FLOOR]
        return World(
            Scene.of(self._primitives, self._surface),
            np.array([*self._classes, *extra], dtype=np.uint8),
            np.array([*self._tops, *[0.0 for _ in extra]]),
        )


def label_image(
    world: World, seen: Cast, camera: Camera, pose: ArrayLike, *, swing_height_max: float
) -> NDArray[np.uint8]:
    """The label of every pixel, exact: that of the face its ray meets.

    Top faces of cuboids, ramps and cylinders are steppable, and so is floor. Their other faces are passable where the
    riser, from the support beside the face to the shape's top, is at most ``swing_height_max``. The other classes are
    passable as a whole where their top is at most that far above the support below their middle. Walls and ceiling are
    non-passable.

    Args:
        world: what was seen.
        seen: by the ray caster, with normals.
        camera, pose: (4, 4) optical frame to world, that it was seen with.
        swing_height_max: highest obstacle that a swing steps over [m].

    Returns:
        (h, w) of ``legtool_runtime.perception.LABELS``; unknown where there is no return.
    """
    scene, surface = world.scene, world.scene.surface
    whole = np.full(len(world.classes), UNKNOWN, dtype=np.uint8)
    whole[world.classes == FLOOR] = STEPPABLE
    whole[world.classes == WALL] = NON_PASSABLE
    for g in np.flatnonzero((world.classes >= SPHERIC) & (world.classes <= TUBULAR)):
        x, y = scene.positions[g, :2]
        rise = world.tops[g] - float(world.support(x, y, below=world.tops[g] - 1e-6))
        whole[g] = PASSABLE if rise <= swing_height_max else NON_PASSABLE
    pose = np.asarray(pose, dtype=float)
    if surface is None:
        heights, resolution, corner = np.zeros((2, 2)), 1.0, np.full(2, np.inf)
    else:
        heights, resolution, corner = surface.heights, surface.resolution_m, surface.origin
    labels = np.empty(seen.geom.shape, dtype=np.uint8)
    _label(
        whole, scene.kinds, scene.rotations, world.tops, carrier_table(world), heights, resolution, corner,
        np.array([camera.fx, camera.fy, camera.cx, camera.cy]), np.ascontiguousarray(pose[:3, :3]), pose[:3, 3],
        swing_height_max, seen.depth, seen.geom, seen.normal, labels,
    )  # fmt: skip
    return labels


def class_image(world: World, seen: Cast) -> NDArray[np.uint8]:
    """(h, w) number in SHAPES of the shape at each pixel plus one, 0 where there is no return."""
    return np.append(world.classes + 1, 0).astype(np.uint8)[seen.geom]


def carrier_table(world: World) -> Array:
    """(m, 9) kind, x, y, z, cosine and sine of yaw, and the three sizes of everything that carries a foot."""
    scene = world.scene
    which = np.flatnonzero(world.classes[: len(scene.kinds)] <= CYLINDRIC)
    r = scene.rotations[which]
    return np.column_stack(
        [scene.kinds[which], scene.positions[which], r[:, 0, 0], r[:, 1, 0], scene.sizes[which]]
    ).reshape(len(which), 9)


@kernel
def highest_carrier(carriers: Array, x: float, y: float, below: float) -> tuple[float, int]:
    """Highest top of a carrier over (x, y) that is lower than ``below``, and its row; the ground is 0 and -1."""
    best, which = 0.0, -1
    for k in range(carriers.shape[0]):
        kind, px, py, pz, c, s, sx, sy, sz = carriers[k]
        u = c * (x - px) + s * (y - py)
        v = c * (y - py) - s * (x - px)
        top = pz + sz
        if kind == CYLINDER:
            over = u * u + v * v <= sx * sx
        else:
            over = abs(u) <= sx and abs(v) <= sy
            if kind == WEDGE:
                top = pz + sz * u / sx
        if over and best < top < below:
            best, which = top, k
    return best, which


@kernel
def _ground(heights: Array, resolution: float, corner: Array, x: float, y: float) -> float:
    """Height of the floor at (x, y), nearest grid point."""
    i, j = (x - corner[0]) / resolution, (y - corner[1]) / resolution
    if not (0.0 <= i <= heights.shape[0] - 1.0 and 0.0 <= j <= heights.shape[1] - 1.0):
        return 0.0
    return heights[int(i + 0.5), int(j + 0.5)]


@kernel
def _label(
    whole: NDArray[np.uint8],
    kinds: NDArray[np.int64],
    rotations: Array,
    tops: Array,
    carriers: Array,
    heights: Array,
    resolution: float,
    corner: Array,
    intrinsics: Array,
    turn: Array,
    position: Array,
    swing_height_max: float,
    depth: NDArray[np.float32],
    geoms: NDArray[np.int32],
    normals: NDArray[np.float32],
    labels: NDArray[np.uint8],
) -> None:
    fx, fy, cx, cy = intrinsics
    for v in range(depth.shape[0]):
        b = (v - cy) / fy
        for u in range(depth.shape[1]):
            g = geoms[v, u]
            if g < 0:
                labels[v, u] = UNKNOWN
                continue
            if whole[g] != UNKNOWN:
                labels[v, u] = whole[g]
                continue
            nx, ny, nz = normals[v, u]
            r = rotations[g]
            if r[0, 2] * nx + r[1, 2] * ny + r[2, 2] * nz > _TOP:
                labels[v, u] = STEPPABLE
                continue
            a, t = (u - cx) / fx, depth[v, u]
            x = position[0] + t * (turn[0, 0] * a + turn[0, 1] * b + turn[0, 2]) + _BESIDE * nx
            y = position[1] + t * (turn[1, 0] * a + turn[1, 1] * b + turn[1, 2]) + _BESIDE * ny
            beside = max(highest_carrier(carriers, x, y, tops[g])[0], _ground(heights, resolution, corner, x, y))
            labels[v, u] = PASSABLE if tops[g] - beside <= swing_height_max else NON_PASSABLE
