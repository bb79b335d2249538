"""The true regions of a world: what perception would find if it saw everything, and saw it exactly."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool.sim.worlds.carriers import TOP
from legtool.sim.worlds.convex import area, centroid, cut, hull, outside
from legtool.sim.worlds.polyhedra import Polyhedron, Rectangle, polyhedron_of
from legtool.sim.worlds.raycast_kernels import PLANE
from legtool.sim.worlds.world import CYLINDRIC, FLOOR, WALL, World
from legtool_runtime.perception.regions import Regions, RegionSettings

Array = NDArray[np.float64]

#: Faces are cut into pieces about as long and as wide as this, as superpixels are [m].
CELL_M = 0.25
#: What is no more than this above a face lies in it [m].
_LEVEL_M = 1e-6


def steppable_regions(
    world: World,
    low: tuple[float, float],
    high: tuple[float, float],
    *,
    cell_m: float = CELL_M,
    least_area: float | None = None,
) -> Regions:
    """Faces on which a foot may stand, less what other solids cover, cut into convex pieces.

    A face is steppable where it faces up by no less than a top (60° of slope), belongs to ground, and is the highest
    thing at its place. Faces of a floor that is not flat are no regions, and walls cover nothing. Pieces lie in each
    face's own grid, so that they are the same at every call, and so are their ids.

    Args:
        world: what is looked at.
        low, high: corners (x, y) of the rectangle in which regions begin, and to which endless floors are cut [m].
        cell_m: about the sides of the pieces [m].
        least_area: smaller pieces are left out; None: those that perception leaves out [m²].

    Returns:
        regions without overhang; ``superpixels`` are their own numbers.
    """
    smallest = RegionSettings().least_area if least_area is None else least_area
    rectangle = (low, high)
    solids = {g: polyhedron_of(world.scene, g, rectangle) for g in _solid_numbers(world)}
    poses, boundaries, areas = [], [], []
    for number, solid in solids.items():
        if not _carries(world, number):
            continue
        for face in solid.faces:
            frame = _frame(solid.corners[list(face)])
            if frame is None:
                continue
            outline = (solid.corners[list(face)] - frame[:3, 3]) @ frame[:3, :2]
            covers = (_over(other, frame, g > number) for g, other in solids.items() if g != number)
            holes = [cover for cover in covers if len(cover)]
            for piece in _free(_within(outline, frame, rectangle), holes, cell_m):
                if area(piece) >= smallest:
                    middle = centroid(piece)
                    pose = frame.copy()
                    pose[:3, 3] += frame[:3, :2] @ middle
                    poses.append(pose)
                    boundaries.append(piece - middle)
                    areas.append(area(piece))
    count = len(poses)
    ids = np.arange(count, dtype=np.int64)
    none = np.zeros(count)
    return Regions(
        np.array(poses).reshape(-1, 4, 4), tuple(boundaries), np.array(areas), none, none.copy(),
        np.zeros(count, dtype=np.bool_), ids, ids.copy(),
    )  # fmt: skip


def near(regions: Regions, position: ArrayLike, radius_m: float) -> Regions:
    """The regions whose origins are no farther than this from a place, seen from above.

    Args:
        regions: all.
        position: (2,) or longer, x and y [m].
        radius_m: [m].
    """
    away = regions.poses[:, :2, 3] - np.asarray(position, dtype=float)[:2]
    chosen = np.flatnonzero(np.hypot(away[:, 0], away[:, 1]) <= radius_m)
    return Regions(
        regions.poses[chosen], tuple(regions.boundaries[k] for k in chosen), regions.areas[chosen],
        regions.overhang[chosen], regions.trimmed[chosen], regions.assumed[chosen], regions.ids[chosen],
        regions.superpixels[chosen],
    )  # fmt: skip


def _solid_numbers(world: World) -> list[int]:
    """Primitives that carry feet or cover what does: all but walls, and planes that do not face up."""
    scene = world.scene
    faces_up = (scene.kinds != PLANE) | (scene.rotations[:, 2, 2] > TOP)
    return np.flatnonzero(faces_up & (world.classes[: len(scene.kinds)] != WALL)).tolist()


def _carries(world: World, number: int) -> bool:
    shape = world.classes[number]
    return bool(world.ground[number] and (shape <= CYLINDRIC or shape == FLOOR))


def _frame(corners: Array) -> Array | None:
    """(4, 4) frame of a face as regions have it, z its normal and x above the world's x; None where no foot stands."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[1])
    normal /= float(np.linalg.norm(normal))
    if not normal[2] > TOP:
        return None
    x, y, z = normal
    length = float(np.hypot(y, z))
    frame = np.eye(4)
    frame[:3, 0] = length, -x * y / length, -x * z / length
    frame[:3, 1] = 0.0, z / length, -y / length
    frame[:3, 2], frame[:3, 3] = normal, corners[0]
    return frame


def _dropped(points: Array, frame: Array) -> Array:
    """(m, 2) where points (m, 2) or (m, 3), moved along the vertical, lie in a face's frame."""
    normal, origin = frame[:3, 2], frame[:3, 3]
    away = points[:, :2] - origin[:2]
    z = -(away @ normal[:2]) / normal[2]
    found: Array = np.column_stack([away, z]) @ frame[:3, :2]
    return found


def _over(solid: Polyhedron, frame: Array, later: bool) -> Array:
    """What a solid covers of a face's plane, in its frame: seen from above, all of it that is above the plane.

    Of two faces in one plane the ``later`` one covers the other.
    """
    corners = solid.around
    above = (corners - frame[:3, 3]) @ frame[:3, 2]
    if above.max() <= _LEVEL_M:
        level = np.abs(above) <= _LEVEL_M
        covers = later and np.count_nonzero(level) >= 3
        return hull(_dropped(corners[level], frame)) if covers else np.empty((0, 2))
    points = [corners[above > _LEVEL_M]]
    for a, b in solid.edges():
        if (above[a] > _LEVEL_M) != (above[b] > _LEVEL_M):
            share = (_LEVEL_M - above[a]) / (above[b] - above[a])
            points.append((corners[a] + share * (corners[b] - corners[a]))[None])
    return hull(_dropped(np.concatenate(points), frame))


def _within(outline: Array, frame: Array, rectangle: Rectangle) -> Array:
    """The part of a face whose place is in the rectangle."""
    (x0, y0), (x1, y1) = rectangle
    corners = _dropped(np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]), frame)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        outward = np.array([b[1] - a[1], a[0] - b[0]])
        outline = cut(outline, outward, float(outward @ a))
    return outline


def _free(outline: Array, holes: list[Array], cell_m: float) -> Iterator[Array]:
    """The pieces of an outline beside all holes."""
    if not len(outline):
        return
    low = np.array([hole.min(axis=0) for hole in holes]).reshape(-1, 2)
    high = np.array([hole.max(axis=0) for hole in holes]).reshape(-1, 2)
    for cell in _cells(outline, cell_m):
        pieces = [cell]
        meets = (low < cell.max(axis=0)).all(axis=1) & (high > cell.min(axis=0)).all(axis=1)
        for k in np.flatnonzero(meets):
            pieces = [left for piece in pieces for left in outside(piece, holes[k])]
        yield from pieces


def _cells(outline: Array, cell_m: float) -> Iterator[Array]:
    """A polygon cut by a grid along its first edge, into as many equal strips each way as come nearest to the cell."""
    along = outline[1] - outline[0]
    along = along / float(np.hypot(*along))
    axes = (along, np.array([-along[1], along[0]]))
    edges = []
    for axis in axes:
        places = outline @ axis
        count = max(1, round(float(np.ptp(places)) / cell_m))
        edges.append(np.linspace(places.min(), places.max(), count + 1))
    for a, b in zip(edges[0][:-1], edges[0][1:], strict=True):
        strip = cut(cut(outline, axes[0], float(b)), -axes[0], -float(a))
        for c, d in zip(edges[1][:-1], edges[1][1:], strict=True):
            if len(cell := cut(cut(strip, axes[1], float(d)), -axes[1], -float(c))):
                yield cell
