"""The ray caster: exact depth, geometry and normals of a world of primitives, seen by a pinhole camera.

It needs no display and no GL. Scenes for training, the simulated depth camera and the ground truth all come from here;
what it says is checked pixel by pixel against MuJoCo's rays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool.sim.worlds.raycast_kernels import (
    BOX,
    CAPSULE,
    CYLINDER,
    PLANE,
    SEMISPHERE,
    SPHERE,
    TUBE,
    WEDGE,
    cast_primitive,
    primitive_normals,
)
from legtool.sim.worlds.rays import view_of
from legtool.sim.worlds.surface import Surface, cast_surface, cell_tops, grid_of, surface_normals
from legtool_runtime.perception.camera import Camera
from legtool_runtime.rotations import from_angles

Array = NDArray[np.float64]

#: Parts of a primitive closer to the camera than this are not culled by it [m].
_NEAR = 1e-3

#: Edges of a box, as pairs of corner numbers whose bits are the signs of x, y, z.
_EDGES = np.array([(a, a | bit) for bit in (1, 2, 4) for a in range(8) if not a & bit])
_SIGNS = np.array([[1.0 if corner & bit else -1.0 for bit in (1, 2, 4)] for corner in range(8)])


class Primitive(NamedTuple):
    """One primitive of a scene: make it with the functions below.

    ``position`` and ``rotation`` (local to world) place the local frame of ``size``, in metres.
    """

    kind: int
    size: tuple[float, float, float]
    position: ArrayLike
    rotation: ArrayLike


class Cast(NamedTuple):
    """What a camera sees, exactly.

    ``depth`` (h, w) float32 along the optical axis [m], NaN without return; ``geom`` (h, w) int32 number of the
    primitive, the surface last, -1 without return; ``normal`` (h, w, 3) float32 outward, world frame, 0 without return.
    """

    depth: NDArray[np.float32]
    geom: NDArray[np.int32]
    normal: NDArray[np.float32]


def plane(position: ArrayLike, rotation: ArrayLike, half_x: float = 0.0, half_y: float = 0.0) -> Primitive:
    """A plane at local z = 0, seen from above only; a half length of 0 is endless."""
    return Primitive(PLANE, (half_x, half_y, 0.0), position, rotation)


def box(position: ArrayLike, rotation: ArrayLike, half_sizes: Sequence[float]) -> Primitive:
    """A box about its centre."""
    return Primitive(BOX, (half_sizes[0], half_sizes[1], half_sizes[2]), position, rotation)


def wedge(position: ArrayLike, rotation: ArrayLike, half_sizes: Sequence[float]) -> Primitive:
    """A ramp in the box ``half_sizes``: it rises along local x from the box's bottom to its top."""
    return Primitive(WEDGE, (half_sizes[0], half_sizes[1], half_sizes[2]), position, rotation)


def cylinder(position: ArrayLike, rotation: ArrayLike, radius: float, half_length: float) -> Primitive:
    """A solid cylinder along local z, about its centre."""
    return Primitive(CYLINDER, (radius, 0.0, half_length), position, rotation)


def sphere(position: ArrayLike, radius: float) -> Primitive:
    """A sphere about its centre."""
    return Primitive(SPHERE, (radius, 0.0, 0.0), position, np.eye(3))


def semisphere(position: ArrayLike, rotation: ArrayLike, radius: float) -> Primitive:
    """The half of a sphere with local z ≥ 0."""
    return Primitive(SEMISPHERE, (radius, 0.0, 0.0), position, rotation)


def capsule(position: ArrayLike, rotation: ArrayLike, radius: float, half_length: float) -> Primitive:
    """A cylinder along local z with balls at its ends, which ``half_length`` leaves out."""
    return Primitive(CAPSULE, (radius, 0.0, half_length), position, rotation)


def tube(position: ArrayLike, rotation: ArrayLike, outer: float, inner: float, half_length: float) -> Primitive:
    """A hollow cylinder along local z, open at both ends."""
    return Primitive(TUBE, (outer, inner, half_length), position, rotation)


@dataclass(frozen=True, eq=False)
class Scene:
    """A world of primitives.

    Attributes:
        kinds: (n,) kind of each.
        sizes: (n, 3) [m], as the kind has them.
        positions: (n, 3) world frame [m].
        rotations: (n, 3, 3) local to world.
        surface: a height surface besides; its number is n.
    """

    kinds: NDArray[np.int64]
    sizes: Array
    positions: Array
    rotations: Array
    surface: Surface | None = None

    @classmethod
    def of(cls, primitives: Sequence[Primitive], surface: Surface | None = None) -> Scene:
        """A scene from a list; a primitive's number is its place in the list."""
        n = len(primitives)
        return cls(
            np.array([p.kind for p in primitives], dtype=np.int64),
            np.array([p.size for p in primitives], dtype=float).reshape(n, 3),
            np.array([p.position for p in primitives], dtype=float).reshape(n, 3),
            np.array([p.rotation for p in primitives], dtype=float).reshape(n, 3, 3),
            surface,
        )

    def half_extents(self) -> tuple[Array, Array]:
        """Bounding boxes in the primitives' frames: centres (n, 3) and half sizes (n, 3) [m]; inf where endless."""
        centre, half = np.zeros_like(self.sizes), self.sizes.copy()
        x, _, z = self.sizes.T
        ball = (self.kinds == SPHERE) | (self.kinds == SEMISPHERE)
        half[ball] = x[ball, None]
        dome = self.kinds == SEMISPHERE
        half[dome, 2] = centre[dome, 2] = 0.5 * x[dome]
        long = (self.kinds == CYLINDER) | (self.kinds == CAPSULE) | (self.kinds == TUBE)
        half[long, 1] = x[long]
        capsules = self.kinds == CAPSULE
        half[capsules, 2] = (x + z)[capsules]
        planes = self.kinds == PLANE
        half[planes, :2] = np.where(self.sizes[planes, :2] > 0, self.sizes[planes, :2], np.inf)
        return centre, half


def cast(scene: Scene, camera: Camera, pose: ArrayLike, *, far: float = np.inf, normals: bool = True) -> Cast:
    """Cast a ray through the middle of each pixel.

    A primitive that the camera is inside of is not seen.

    Args:
        scene: the world.
        camera: its intrinsics.
        pose: (4, 4) optical frame to world.
        far: no return beyond this depth [m].
        normals: without them ``normal`` is empty, and the cast faster.
    """
    view = view_of(camera, pose)
    intrinsics = np.array(view[:4])
    shape = (camera.height, camera.width)
    depth = np.full(shape, far, dtype=np.float64)
    geom = np.full(shape, -1, dtype=np.int32)
    turns = np.ascontiguousarray(np.swapaxes(scene.rotations, 1, 2) @ view.turn)
    origins = np.einsum("nji,nj->ni", scene.rotations, view.position - scene.positions)
    rectangles, nearest = _screen_rectangles(scene, camera, turns, origins)
    # Near to far, so that what is hidden is skipped pixel by pixel.
    for g in np.argsort(nearest, kind="stable"):
        if rectangles[g, 0] < rectangles[g, 1] and rectangles[g, 2] < rectangles[g, 3]:
            cast_primitive(
                int(g), int(scene.kinds[g]), scene.sizes[g], origins[g], turns[g], intrinsics,
                tuple(rectangles[g].tolist()), float(nearest[g]), depth, geom,
            )  # fmt: skip
    n, grid = len(scene.kinds), grid_of(scene.surface)
    if scene.surface is not None:
        cast_surface(n, grid, cell_tops(grid.heights), view, depth, geom)
    normal = np.zeros((*shape, 3) if normals else (0, 0, 3), dtype=np.float32)
    if normals:
        primitive_normals(scene.kinds, scene.sizes, origins, turns, scene.rotations, view, depth, geom, normal)
        if scene.surface is not None:
            surface_normals(n, grid, view, depth, geom, normal)
    return Cast(np.where(geom >= 0, depth, np.nan).astype(np.float32), geom, normal)


def camera_pose(position: ArrayLike, *, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Array:
    """(4, 4) optical frame to world of a camera at ``position`` [m], turned as a body is by roll, pitch, yaw [rad].

    Without them it looks along world x; a pitch above 0 looks down.
    """
    pose = np.eye(4)
    pose[:3, :3] = from_angles(roll, pitch, yaw) @ np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    pose[:3, 3] = position
    return pose


def _screen_rectangles(scene: Scene, camera: Camera, turns: Array, origins: Array) -> tuple[NDArray[np.int64], Array]:
    """Rows and columns (n, 4) that can show each primitive, and the depth (n,) before which none of it lies."""
    centre, half = scene.half_extents()
    whole = np.array([0, camera.height, 0, camera.width])
    rectangles = np.tile(whole, (len(scene.kinds), 1))
    nearest = np.zeros(len(scene.kinds))
    for g in range(len(scene.kinds)):
        if not np.isfinite(half[g]).all():
            nearest[g] = _NEAR
            continue
        corners = (centre[g] + _SIGNS * half[g] - origins[g]) @ turns[g]  # optical frame
        z = corners[:, 2]
        nearest[g] = max(z.min() - 1e-6, 0.0)
        ahead = z > _NEAR
        a, b = corners[_EDGES[:, 0]], corners[_EDGES[:, 1]]
        crossing = ahead[_EDGES[:, 0]] != ahead[_EDGES[:, 1]]
        a, b = a[crossing], b[crossing]
        share = (_NEAR - a[:, 2:]) / (b[:, 2:] - a[:, 2:])
        seen = np.concatenate([corners[ahead], a + share * (b - a)])
        if not len(seen):
            rectangles[g] = 0
            continue
        u = camera.fx * seen[:, 0] / seen[:, 2] + camera.cx
        v = camera.fy * seen[:, 1] / seen[:, 2] + camera.cy
        bounds = [np.floor(v.min()), np.ceil(v.max()) + 1, np.floor(u.min()), np.ceil(u.max()) + 1]
        limits = [camera.height, camera.height, camera.width, camera.width]
        rectangles[g] = np.clip(bounds, 0, limits).astype(np.int64)
    return rectangles, nearest
