"""Convex planar regions that a foot may be set on (QuadPiPS, section V-E)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.checks import Bounds, within
from legtool_runtime.errors import PerceptionError
from legtool_runtime.perception import region_kernels as kernels
from legtool_runtime.perception.egocan_view_kernels import GRAZING
from legtool_runtime.perception.polygon_kernels import CORNERS
from legtool_runtime.perception.superpixel_kernels import Floor
from legtool_runtime.perception.superpixels import Superpixels

Doubles = NDArray[np.float64]


@dataclass(frozen=True)
class RegionSettings:
    """What a region is.

    Attributes:
        tolerance: points farther from the plane do not shape the region [m].
        least_area: smaller regions are left out [m²]; a foot of 2 cm radius covers 0.0013 m².
        trim: whether what hangs over edges is cut off; it is measured in any case.
    """

    tolerance: float = 0.01
    least_area: float = 0.002
    trim: bool = True

    def __post_init__(self) -> None:
        bounds = {"tolerance": Bounds(0.0, 0.1, "m", above=True), "least_area": Bounds(0.0, 1.0, "m²")}
        within("regions", self, bounds, PerceptionError)


@dataclass(frozen=True, eq=False)
class Regions:
    """Convex planar regions, one for each superpixel that makes one.

    Attributes:
        poses: (k, 4, 4) region to world: origin in the superpixel's centroid, z its normal, x above the world's x.
        boundaries: k arrays (n, 2), corners counter-clockwise in the region's x and y [m].
        areas: (k,) [m²].
        overhang: (k,) area of the region that hangs over edges or over what was never seen [m²].
        trimmed: (k,) area that hung over before the region was cut [m²].
        assumed: (k,) whether the ground there is only assumed.
        ids: (k,) of the superpixels: the same from frame to frame.
        superpixels: (k,) index of each region's superpixel.
    """

    poses: Doubles
    boundaries: tuple[Doubles, ...]
    areas: Doubles
    overhang: Doubles
    trimmed: Doubles
    assumed: NDArray[np.bool_]
    ids: NDArray[np.int64]
    superpixels: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.poses)

    def corners_world(self, index: int) -> Doubles:
        """(n, 3) corners of one region, world [m]."""
        pose = self.poses[index]
        return self.boundaries[index] @ pose[:3, :2].T + pose[:3, 3]


def convex_regions(superpixels: Superpixels, settings: RegionSettings | None = None) -> Regions:
    """The convex hull of each superpixel in its plane, less what hangs over an edge.

    A hull is convex where a superpixel need not be: across a corner, a hole, or the gap between two stones it covers
    ground that nothing was seen of, or that is known to be different. That part is measured and cut off. A plane that
    the can's origin sees at a grazing angle is no ground.
    """
    s = settings or RegionSettings()
    count = len(superpixels)
    rotation = superpixels.transform_to_world[:3, :3]
    points = superpixels.points.astype(np.float64)
    axes = _axes(superpixels.normals.astype(np.float64) @ rotation.T) @ rotation
    corners, sizes = np.empty((count, CORNERS, 2)), np.zeros(count, dtype=np.int32)
    areas, overhang = np.zeros(count), np.zeros((count, 2))
    kernels.build(
        Floor(superpixels.channels, len(superpixels.state), superpixels.focal_length),
        superpixels.state,
        superpixels.start,
        superpixels.order,
        kernels.Planes(points, np.ascontiguousarray(axes), superpixels.assumed),
        s.tolerance,
        s.trim,
        kernels.Outlines(corners, sizes, areas, overhang),
    )
    # A plane along the line of sight joins edges that are seen one past the other, as those of stairs going down.
    facing = -np.sum(points * superpixels.normals, axis=1) > GRAZING * np.linalg.norm(points, axis=1)
    chosen = np.flatnonzero((sizes >= 3) & (areas > s.least_area) & facing)
    poses = np.tile(np.eye(4), (len(chosen), 1, 1))
    poses[:, :3, :3] = np.swapaxes(axes[chosen] @ rotation.T, 1, 2)
    poses[:, :3, 3] = points[chosen] @ rotation.T + superpixels.transform_to_world[:3, 3]
    return Regions(
        poses,
        tuple(corners[c, : sizes[c]].copy() for c in chosen),
        areas[chosen],
        overhang[chosen, 1],
        overhang[chosen, 0],
        superpixels.assumed[chosen],
        superpixels.ids[chosen],
        chosen,
    )


def _axes(normals: Doubles) -> Doubles:
    """(k, 3, 3) rows x, y, z of frames with the given z, (k, 3), whose x lies above or below the given frame's x."""
    x, y, z = normals.T
    length, none = np.hypot(y, z), np.zeros(len(normals))
    rows = [length, -x * y / length, -x * z / length, none, z / length, -y / length, x, y, z]
    return np.stack(rows, axis=1).reshape(-1, 3, 3)
