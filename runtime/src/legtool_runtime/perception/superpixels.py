"""Superpixels of the sparse floor image: SLIC over points and normals (QuadPiPS, section V-D)."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.checks import Bounds, within
from legtool_runtime.errors import PerceptionError
from legtool_runtime.perception import superpixel_kernels as kernels
from legtool_runtime.perception import superpixel_planes as planes
from legtool_runtime.perception.egocan import CanImage, Pose
from legtool_runtime.perception.superpixel_kernels import ASSUMED, EMPTY, HEALTHY, REMOVED

__all__ = ["ASSUMED", "EMPTY", "HEALTHY", "REMOVED", "FloorGround", "SuperpixelSettings", "Superpixels", "oversegment"]

Floats = NDArray[np.float32]

#: What lies farther from all of the last frame's superpixels, in steps, is free for new ones: else those at the rim of
#: what was seen would grow as more comes into view.
_WARM_REACH = 0.75


_WEIGHTS = ("normal_weight", "plane_weight", "world_weight", "compact_weight")
_BOUNDS = {
    "number": Bounds(4, 2000),
    "iterations": Bounds(1, 50),
    "warm_iterations": Bounds(1, 50),
    **{name: Bounds(0.0, np.inf) for name in _WEIGHTS},
    "largest_normal_angle": Bounds(0.0, np.pi / 2, "rad", above=True),
    "largest_plane_distance": Bounds(0.0, 1.0, "m", above=True),
    "upright": Bounds(0.0, 0.999),
    "trials": Bounds(0, 1000),
    "sample": Bounds(3, 1000),
    "tolerance": Bounds(0.0, 0.2, "m", above=True),
    "least": Bounds(3, 1000),
}


@dataclass(frozen=True)
class SuperpixelSettings:
    """What a superpixel is; weights, number and iterations as in the paper's public code.

    Attributes:
        number: superpixels of a full image.
        iterations, warm_iterations: rounds of assignment and update from scratch, and from the last frame.
        normal_weight, plane_weight, world_weight, compact_weight: of equation 10.
        largest_normal_angle, largest_plane_distance: d_max of the first two terms, which no member exceeds [rad], [m].
        upright: least z of a healthy pixel's normal, levelled frame.
        trials, sample, tolerance: RANSAC's planes, points drawn per cluster, and distance of an inlier [m].
        least: pixels that make a superpixel.
    """

    number: int = 175
    iterations: int = 5
    warm_iterations: int = 1
    normal_weight: float = 25.0
    plane_weight: float = 100.0
    world_weight: float = 25.0
    compact_weight: float = 0.0
    largest_normal_angle: float = np.pi / 4
    largest_plane_distance: float = 0.025
    upright: float = 0.5
    trials: int = 10
    sample: int = 25
    tolerance: float = 0.01
    least: int = 24

    def __post_init__(self) -> None:
        within("superpixels", self, _BOUNDS, PerceptionError)
        if not any(getattr(self, name) for name in _WEIGHTS):
            raise PerceptionError(f"superpixels: all of {', '.join(_WEIGHTS)} are 0, expected one above")


@dataclass(frozen=True)
class FloorGround:
    """Flat ground that is taken for granted where nothing has been seen yet, around where the robot started.

    Attributes:
        centre: (3,) world [m].
        radius: [m].
    """

    centre: tuple[float, float, float]
    radius: float


@dataclass(frozen=True, eq=False)
class Superpixels:
    """The superpixels of one floor image.

    Attributes:
        assignment: (side, side) index of each pixel's superpixel, -1 for none.
        state: (side, side) EMPTY, HEALTHY, ASSUMED or REMOVED.
        points: (k, 3) centroids, levelled frame [m].
        normals: (k, 3) levelled frame.
        pixels: (k, 2) centroids as ix, iy.
        assumed: (k,) whether the ground there is only assumed.
        ids: (k,) the same number from frame to frame as long as a superpixel lives on.
        channels: (7, side²) the prepared image, see :class:`superpixel_kernels.Floor`.
        start, order: members of superpixel c are the flat pixels ``order[start[c]:start[c + 1]]``.
        focal_length: of the floor image [cells].
        transform_to_world: (4, 4) of the levelled frame.
    """

    assignment: NDArray[np.int32]
    state: NDArray[np.uint8]
    points: Floats
    normals: Floats
    pixels: Floats
    assumed: NDArray[np.bool_]
    ids: NDArray[np.int64]
    channels: Floats
    start: NDArray[np.int32]
    order: NDArray[np.int32]
    focal_length: float
    transform_to_world: Pose

    def __len__(self) -> int:
        return len(self.points)


def oversegment(
    floor: CanImage,
    settings: SuperpixelSettings | None = None,
    *,
    previous: Superpixels | None = None,
    ground: FloorGround | None = None,
) -> Superpixels:
    """Superpixels of the egocan's floor image.

    Args:
        floor: :meth:`Egocan.floor`.
        settings: defaults to the paper's.
        previous: the superpixels of the last frame: they are where this frame's begin, so that regions stay put while
            the robot moves. Free ground gets new ones.
        ground: where to assume ground that has not been seen; None assumes none.

    Returns:
        Only pixels that are seen, upright and steppable (or assumed) belong to superpixels. Equal inputs give equal
        results.

    Raises:
        PerceptionError: an image that is no cap.
    """
    s = settings or SuperpixelSettings()
    side = floor.labels.shape[0]
    if floor.labels.shape != (side, side) or floor.focal_length <= 0:
        raise PerceptionError(f"superpixels: image of {floor.labels.shape}, expected the egocan's square floor image")
    step = float(side / np.sqrt(s.number))
    weights = np.array([s.normal_weight, s.plane_weight, s.world_weight, s.compact_weight], dtype=np.float32)
    limits = np.array([1.0 - np.cos(s.largest_normal_angle), s.largest_plane_distance], dtype=np.float32)
    criteria, ransac = (
        kernels.SuperpixelCriteria(weights, limits, step),
        planes.Ransac(s.trials, s.sample, s.tolerance, s.least),
    )
    image = kernels.Floor(np.empty((7, side * side), dtype=np.float32), side, floor.focal_length)
    state = np.empty((side, side), dtype=np.uint8)
    assumed = _levelled(ground, floor.transform_to_world)
    kernels.prepare(floor.points, floor.normals, floor.labels, s.upright, assumed, image, state)
    room = 4 * s.number
    clusters, ids = np.empty((room, 9), dtype=np.float32), np.zeros(room, dtype=np.int64)
    assignment, best = np.full(side * side, -1, dtype=np.int32), np.empty(side * side, dtype=np.float32)
    start, order = np.zeros(room + 1, dtype=np.int32), np.empty(side * side, dtype=np.int32)
    keep = np.empty(room, dtype=np.bool_)
    count, next_id = 0, 0
    rounds = s.iterations
    if previous is not None and len(previous):
        count = _carry_over(previous, floor, step, clusters, ids)
        next_id = int(previous.ids.max()) + 1
        rounds = s.warm_iterations
        kernels.assign(image, clusters, count, int(_WARM_REACH * step), criteria, best, assignment)
    for _ in range(rounds):
        # A face smaller than the grid may lie across four squares.
        least = max(3, s.least // 4)
        grown = kernels.seed(image, assignment, step, least, s.largest_plane_distance, clusters, count)
        ids[count:grown] = next_id + np.arange(grown - count)
        next_id, count = next_id + grown - count, grown
        kernels.assign(image, clusters, count, int(step) + 1, criteria, best, assignment)
        kernels.members(assignment, count, start, order)
        kernels.separate(assignment, count, *_squares(side), start, order)
        planes.update(image, start, order, count, ransac, clusters, keep)
    # What is left of clusters that lost their pixels is dissolved.
    kept = keep[:count]
    if not kept.all():
        renumber = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1).astype(np.int32)
        sizes = np.diff(start[: count + 1])
        assignment, order = renumber[assignment], order[: start[count]][np.repeat(kept, sizes)]
        start = np.append(0, np.cumsum(sizes[kept])).astype(np.int32)
        clusters, ids = clusters[:count][kept], ids[:count][kept]
    clusters, ids = clusters[: kept.sum()], ids[: kept.sum()]
    return Superpixels(
        assignment.reshape(side, side),
        state,
        clusters[:, :3],
        clusters[:, 3:6],
        clusters[:, 7:],
        clusters[:, 6] > 0,
        ids,
        image.channels,
        start[: len(ids) + 1],
        order,
        floor.focal_length,
        floor.transform_to_world,
    )


@functools.cache
def _squares(side: int) -> tuple[NDArray[np.int32], int]:
    """The square that each pixel lies in, (side²,), for :func:`superpixel_kernels.separate`, and squares in a row."""
    across = side // kernels.LINK + 3
    one = np.arange(side) // kernels.LINK + 1
    return (one[:, None] * across + one).astype(np.int32).ravel(), across


def _levelled(ground: FloorGround | None, transform_to_world: Pose) -> Floats:
    """Centre in the levelled frame and radius, (4,) [m]; radius 0 for none."""
    if ground is None:
        return np.zeros(4, dtype=np.float32)
    centre = (np.asarray(ground.centre) - transform_to_world[:3, 3]) @ transform_to_world[:3, :3]
    return np.append(centre, ground.radius).astype(np.float32)


def _carry_over(previous: Superpixels, floor: CanImage, step: float, clusters: Floats, ids: NDArray[np.int64]) -> int:
    """Write the last frame's superpixels as they lie in this frame's image; how many still do."""
    side = floor.labels.shape[0]
    motion = np.linalg.inv(floor.transform_to_world) @ previous.transform_to_world
    points = previous.points @ motion[:3, :3].T + motion[:3, 3]
    normals = previous.normals @ motion[:3, :3].T
    below = points[:, 2] < -1e-3
    tangent = points[:, :2] / np.where(below, -points[:, 2], 1.0)[:, None]
    pixels = tangent * floor.focal_length + 0.5 * side - 0.5
    inside = below & (pixels > -0.5 * step).all(axis=1) & (pixels < side + 0.5 * step).all(axis=1)
    chosen = np.flatnonzero(inside)[: len(clusters)]
    n = len(chosen)
    clusters[:n, :3], clusters[:n, 3:6], clusters[:n, 7:] = points[chosen], normals[chosen], pixels[chosen]
    clusters[:n, 6] = previous.assumed[chosen]
    ids[:n] = previous.ids[chosen]
    return n
