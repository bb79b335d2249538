"""A world as MuJoCo's world: each primitive a geom, with its friction, under its name."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool.sim.robots.physics import FLOOR_FRICTION, TERRAIN_CONTACT, empty_world
from legtool.sim.worlds.raycast_kernels import BOX, CAPSULE, CYLINDER, PLANE, SEMISPHERE, SPHERE, TUBE, WEDGE
from legtool.sim.worlds.surface import Surface
from legtool.sim.worlds.world import World

_GEOM = mujoco.mjtGeom
#: Facets around a tube and a semisphere; what a surface's solid reaches below its lowest point [m].
_TUBE_FACETS, _DOME_FACETS, _BELOW_M = 256, 192, 0.1


def world_spec(world: World) -> mujoco.MjSpec:
    """A world for the simulation, with the solver options and contact rules that every simulation here uses.

    Wedges, semispheres and tubes are meshes. MuJoCo's contacts take a mesh's convex hull, so that a tube is solid to
    feet, and open to rays.
    """
    spec = empty_world()
    scene = world.scene
    for number, (kind, size, position, rotation) in enumerate(
        zip(scene.kinds, scene.sizes, scene.positions, scene.rotations, strict=True)
    ):
        name = world.names[number]
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, rotation.ravel())
        spec.worldbody.add_geom(
            name=name,
            pos=position,
            quat=quaternion,
            friction=[world.friction[number], *FLOOR_FRICTION[1:]],
            **_geom(spec, name, int(kind), size),
            **TERRAIN_CONTACT,
        )
    if scene.surface is not None:
        _add_surface(spec, scene.surface, world.names[-1], float(world.friction[-1]))
    return spec


def _geom(spec: mujoco.MjSpec, name: str, kind: int, size: NDArray[np.float64]) -> dict[str, Any]:
    x, y, z = size.tolist()
    match kind:
        case _ if kind == PLANE:
            return {"type": _GEOM.mjGEOM_PLANE, "size": [x, y, 1]}
        case _ if kind == BOX:
            return {"type": _GEOM.mjGEOM_BOX, "size": [x, y, z]}
        case _ if kind == CYLINDER:
            return {"type": _GEOM.mjGEOM_CYLINDER, "size": [x, z, 0]}
        case _ if kind == SPHERE:
            return {"type": _GEOM.mjGEOM_SPHERE, "size": [x, 0, 0]}
        case _ if kind == CAPSULE:
            return {"type": _GEOM.mjGEOM_CAPSULE, "size": [x, z, 0]}
    vertices, faces = _MESHES[kind](x, y, z)
    spec.add_mesh(name=name, uservert=np.ravel(vertices), userface=np.ravel(faces).astype(np.int32))
    return {"type": _GEOM.mjGEOM_MESH, "meshname": name}


def _wedge(a: float, b: float, c: float) -> tuple[ArrayLike, ArrayLike]:
    vertices = [(-a, -b, -c), (a, -b, -c), (a, -b, c), (-a, b, -c), (a, b, -c), (a, b, c)]
    faces = [(0, 1, 2), (3, 5, 4), (0, 3, 4), (0, 4, 1), (1, 4, 5), (1, 5, 2), (0, 2, 5), (0, 5, 3)]
    return vertices, faces


def _tube(outer: float, inner: float, half: float) -> tuple[ArrayLike, ArrayLike]:
    n = _TUBE_FACETS
    angle = np.arange(n) * 2 * np.pi / n
    ring = np.stack([np.cos(angle), np.sin(angle)], 1)
    rings = [np.c_[r * ring, np.full(n, z)] for r, z in ((outer, -half), (outer, half), (inner, half), (inner, -half))]
    faces = []
    for k in range(4):
        for i in range(n):
            a, b = k * n + i, k * n + (i + 1) % n
            c, d = (k + 1) % 4 * n + i, (k + 1) % 4 * n + (i + 1) % n
            faces += [(a, b, d), (a, d, c)]
    return np.concatenate(rings), faces


def _dome(radius: float, _: float, __: float) -> tuple[ArrayLike, ArrayLike]:
    n = _DOME_FACETS
    polar, around = np.meshgrid(np.linspace(np.pi / 2, 0, n // 4 + 1)[:-1], np.arange(n) * 2 * np.pi / n, indexing="ij")
    points = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], -1)
    rows = points.shape[0]
    vertices = np.concatenate([radius * points.reshape(-1, 3), [[0, 0, radius], [0, 0, 0]]])
    faces = []
    for i in range(n):
        j = (i + 1) % n
        for k in range(rows - 1):
            faces += [(k * n + i, k * n + j, (k + 1) * n + j), (k * n + i, (k + 1) * n + j, (k + 1) * n + i)]
        faces += [((rows - 1) * n + i, (rows - 1) * n + j, rows * n), (j, i, rows * n + 1)]
    return vertices, faces


_MESHES = {WEDGE: _wedge, SEMISPHERE: _dome, TUBE: _tube}


def _add_surface(spec: mujoco.MjSpec, surface: Surface, name: str, friction: float) -> None:
    nx, ny = surface.heights.shape
    low, high = surface.heights.min(), surface.heights.max()
    half = np.array([nx - 1, ny - 1]) * surface.resolution_m / 2
    data = (surface.heights - low) / (high - low)
    spec.add_hfield(name=name, nrow=ny, ncol=nx, size=[*half, high - low, _BELOW_M], userdata=data.T.ravel())
    spec.worldbody.add_geom(
        name=name,
        type=_GEOM.mjGEOM_HFIELD,
        hfieldname=name,
        pos=[*(surface.origin + half), low],
        friction=[friction, *FLOOR_FRICTION[1:]],
        **TERRAIN_CONTACT,
    )
