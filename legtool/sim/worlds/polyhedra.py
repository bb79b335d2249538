"""Primitives of a world as convex solids with corners, edges and faces; round ones as prisms."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool.sim.worlds.raycast import Scene
from legtool.sim.worlds.raycast_kernels import CYLINDER, PLANE, WEDGE

Array = NDArray[np.float64]
Rectangle = tuple[tuple[float, float], tuple[float, float]]

#: Sides of the prism that stands for a cylinder.
SIDES = 24
_BOX_CORNERS = np.array([(x, y, z) for z in (-1, 1) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))], dtype=float)
_WEDGE_CORNERS = np.array([(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1), (1, -1, 1), (1, 1, 1)], dtype=float)
#: Corners of each face, counter-clockwise from outside.
_BOX_FACES = ((4, 5, 6, 7), (3, 2, 1, 0), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
_WEDGE_FACES = ((0, 4, 5, 3), (3, 2, 1, 0), (1, 2, 5, 4), (0, 1, 4), (2, 3, 5))


class Polyhedron(NamedTuple):
    """A convex solid, or a single face of one that is endless.

    ``corners`` (m, 3) world frame [m]; ``faces`` corners of each, counter-clockwise from outside; ``around`` (m, 3)
    corners of a solid that holds all of a round one, else the same.
    """

    corners: Array
    faces: tuple[tuple[int, ...], ...]
    around: Array

    def edges(self) -> list[tuple[int, int]]:
        """Pairs of corners."""
        pairs = {(min(a, b), max(a, b)) for face in self.faces for a, b in zip(face, face[1:] + face[:1], strict=True)}
        return sorted(pairs)


def polyhedron_of(scene: Scene, number: int, area: Rectangle) -> Polyhedron:
    """The polyhedron of a primitive; of spheres, capsules and tubes the box about them.

    Args:
        scene: its primitives.
        number: which.
        area: lower and upper corner (x, y) of what is looked at, to which an endless plane, which must not be
            upright, is cut [m].
    """
    kind, (x, _, z) = int(scene.kinds[number]), scene.sizes[number].tolist()
    position, rotation = scene.positions[number], scene.rotations[number]
    if kind == PLANE:
        return _plane(position, rotation, scene.sizes[number], area)
    if kind == CYLINDER:
        return _prism(position, rotation, x, z)
    centre, half = scene.half_extents()
    corners, faces = (_WEDGE_CORNERS, _WEDGE_FACES) if kind == WEDGE else (_BOX_CORNERS, _BOX_FACES)
    placed = (centre[number] + corners * half[number]) @ rotation.T + position
    return Polyhedron(placed, faces, placed)


def _plane(position: Array, rotation: Array, size: Array, area: Rectangle) -> Polyhedron:
    normal = rotation[:, 2]
    (x0, y0), (x1, y1) = area
    corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    if size[0] > 0.0 and size[1] > 0.0:
        rectangle = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * size[:2]
        placed = rectangle @ rotation[:, :2].T + position
    else:
        z = position[2] - ((corners - position[:2]) @ normal[:2]) / normal[2]
        placed = np.column_stack([corners, z])
    return Polyhedron(placed, ((0, 1, 2, 3),), placed)


def _prism(position: Array, rotation: Array, radius: float, half: float) -> Polyhedron:
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    rings = np.concatenate([np.column_stack([ring, np.full(SIDES, z)]) for z in (-half, half)])
    low, high = tuple(range(SIDES)), tuple(range(SIDES, 2 * SIDES))
    sides = tuple((k, (k + 1) % SIDES, SIDES + (k + 1) % SIDES, SIDES + k) for k in range(SIDES))
    wider = rings / [np.cos(np.pi / SIDES), np.cos(np.pi / SIDES), 1.0]
    return Polyhedron(rings @ rotation.T + position, (high, low[::-1], *sides), wider @ rotation.T + position)
