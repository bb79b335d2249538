"""A robot-centric 2.5-D elevation map, fused from depth images with a variance per cell.

Each cell represents the highest surface there. Of the points that one image puts into a cell, only those consistent
with the highest one count. An older estimate is replaced by a higher one at once, and by a lower one only if that is
much more certain or has contradicted it for a while. The edge of a step therefore stays where the upper surface ends,
and no height between two surfaces is ever invented. Cells that no ray reached are NaN.

Cells are aligned with the world: cell (i, j) of the world covers x in [i·r, (i+1)·r) and is stored at (i mod n_x,
j mod n_y) of a buffer. Moving the map therefore only clears the cells that enter it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime import checks
from legtool_runtime.checks import Bounds
from legtool_runtime.errors import MapError
from legtool_runtime.terrain import fusion
from legtool_runtime.terrain.settings import ElevationSettings

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Heights at one moment, in the form that planners read. Maps from other sources are passed in as a HeightMap.

    Attributes:
        heights: (n_x, n_y) height of the highest surface, world frame [m]; NaN where unknown. Indexed [ix, iy].
        resolution_m: side of a cell.
        center: (2,) x, y of the middle of the map, world frame [m]; the centre of cell (ix, iy) lies at
            ``center + (ix - (n_x - 1) / 2, iy - (n_y - 1) / 2) · resolution_m``.
        variance: (n_x, n_y) of the heights [m²], NaN where unknown; None if there is no variance.

    Raises:
        MapError: a shape is wrong, a height is infinite, or the resolution or the centre is not valid.
    """

    heights: Array32
    resolution_m: float
    center: Array
    variance: Array32 | None = None

    def __post_init__(self) -> None:
        heights = _grid("heights", self.heights)
        object.__setattr__(self, "heights", heights)
        object.__setattr__(self, "center", checks.finite("map: center", self.center, (2,), MapError))
        checks.within("map", self, {"resolution_m": Bounds(0.001, 1.0, "m")}, MapError)
        if self.variance is not None:
            variance = _grid("variance", self.variance)
            if variance.shape != heights.shape:
                raise MapError(f"map: variance has shape {variance.shape}, expected {heights.shape} as the heights")
            object.__setattr__(self, "variance", variance)

    @property
    def lower_corner(self) -> Array:
        """(2,) x, y of the outer corner of cell (0, 0), world frame [m]."""
        return self.center - 0.5 * self.resolution_m * np.array(self.heights.shape)

    def points(self, place: ArrayLike, *, within_m: float) -> Array32:
        """(m, 3) the middles of the known cells that are at most ``within_m`` from (2,) a place in x and in y [m]."""
        shape, cell = np.array(self.heights.shape), self.resolution_m
        middle = (np.asarray(place, dtype=np.float64) - self.lower_corner) / cell
        low = np.clip(np.ceil(middle - within_m / cell - 0.5), 0, shape).astype(int)
        high = np.clip(np.floor(middle + within_m / cell + 0.5), 0, shape).astype(int)
        window = self.heights[low[0] : high[0], low[1] : high[1]]
        i, j = np.nonzero(~np.isnan(window))
        xy = self.lower_corner + cell * (np.stack([i, j], axis=1) + low + 0.5)
        return np.column_stack([xy, window[i, j]]).astype(np.float32)


def _grid(name: str, value: ArrayLike) -> Array32:
    grid = checks.array(f"map: {name}", value, MapError, np.float32)
    if grid.ndim != 2 or min(grid.shape) < 3:
        raise MapError(f"map: {name} of shape {grid.shape}, expected (n_x, n_y) with at least 3 cells a side")
    if np.isinf(grid).any():
        raise MapError(f"map: {name} hold an infinite value; mark unknown cells by NaN")
    return grid


class ElevationGrid:
    """A map that moves with the robot.

    All world coordinates are in one fixed world frame. The map must not be used by several threads at once.
    """

    def __init__(self, settings: ElevationSettings | None = None, *, center: ArrayLike = (0.0, 0.0)) -> None:
        """Create an empty map around ``center`` (2,) [m]."""
        self.settings = settings or ElevationSettings()
        n = round(self.settings.size_m / self.settings.resolution_m)
        self._shape = (n, n)
        self._cells = fusion.Cells(
            height=np.full(self._shape, np.nan, np.float32),
            variance=np.full(self._shape, np.nan, np.float32),
            seen=np.zeros(self._shape),
            doubted=np.full(self._shape, np.inf),
            hits=np.zeros(self._shape, np.float32),
            due=np.zeros(self._shape, np.float32),
        )
        self._first = self._first_cell(center)
        self._frame = fusion.DepthFrame(*(np.empty(self._shape, np.float32) for _ in range(4)))
        self._points = np.empty(0, np.int32), np.empty((0, 2), np.float32)

    @property
    def center(self) -> Array:
        """(2,) x, y of the middle of the map, world frame [m]."""
        return (np.array(self._first) + 0.5 * np.array(self._shape)) * self.settings.resolution_m

    def move_to(self, center: ArrayLike) -> None:
        """Move the map to the cell nearest to ``center`` (2,) [m]. Cells that stay inside are kept without a copy.

        Raises:
            MapError: the centre is not two numbers within 10,000 km of the origin.
        """
        first = self._first_cell(center)
        for axis in (0, 1):
            old, new, n = self._first[axis], first[axis], self._shape[axis]
            if new > old:
                entering = range(max(old + n, new), new + n)
            else:
                entering = range(new, min(old, new + n))
            if entering:
                cells = np.arange(entering.start, entering.stop) % n
                index = (cells, slice(None)) if axis == 0 else (slice(None), cells)
                self._cells.height[index] = np.nan
                self._cells.variance[index] = np.nan
                self._cells.doubted[index] = np.inf
                self._cells.hits[index] = 0.0
                self._cells.due[index] = 0.0
        self._first = first

    def update(
        self,
        depth: NDArray[Any],
        intrinsics: ArrayLike,
        *,
        transform_camera_to_world: ArrayLike,
        time_s: float,
    ) -> int:
        """Fuse one depth image. Call :meth:`move_to` first.

        Args:
            depth: (height, width) distance along the optical axis, as floats [m] with 0 or NaN where nothing returns,
                or as uint16 [mm].
            intrinsics: (4,) f_x, f_y, c_x, c_y [px]; pixel (u, v) looks along ((u - c_x)/f_x, (v - c_y)/f_y, 1).
            transform_camera_to_world: (4, 4) pose of the camera's optical frame: z forward, x right, y down.
            time_s: when the image was taken.

        Returns:
            The number of cells that the image observed.

        Raises:
            MapError: the image, intrinsics, pose or time cannot be used. The map is left unchanged.
        """
        image = _depth(depth)
        fx, fy, cx, cy = checks.finite("intrinsics", intrinsics, (4,), MapError)
        if not (fx > 0 and fy > 0):
            raise MapError(f"intrinsics: f_x, f_y are {fx}, {fy} px, expected positive")
        pose = checks.pose("transform_camera_to_world", transform_camera_to_world, MapError)
        rotation = np.ascontiguousarray(pose[:3, :3])
        time_s = checks.number("time_s", time_s, MapError, "s")
        room = image.size + image.size // 2
        if len(self._points[0]) < room:
            self._points = np.empty(room, np.int32), np.empty((room, 2), np.float32)
        s = self.settings
        options = fusion.Options(
            float(fx), float(fy), float(cx), float(cy), s.resolution_m, s.min_range_m, s.max_range_m,
            s.range_noise, s.base_noise_m, s.gate, s.drift_m_per_sqrt_s**2, s.replace_after_s, s.ceiling_m, s.jump,
            s.bridge_m,
        )  # fmt: skip
        cell, point = self._points
        position = pose[:3, 3].copy()
        fusion.collect(image, rotation, position, self._first, options, cell, point, self._frame)
        reached = fusion.fuse(self._frame, self._first, options, float(time_s), self._cells)
        size = (image.shape[0], image.shape[1])
        fusion.judge(self._frame.pixels, rotation, position, size, self._first, options, self._cells)
        return reached

    def assume_flat(self, center: ArrayLike, *, radius_m: float, height_m: float) -> None:
        """Fill the unknown cells of a disc, such as the ground under a standing robot, which no camera sees.

        Args:
            center: (2,) x, y of the disc, world frame [m].
            radius_m: radius of the disc.
            height_m: world height, stored with a standard deviation of 5 cm, so that the first observation replaces it.
        """
        x, y = checks.finite("center", center, (2,), MapError)
        r = self.settings.resolution_m
        ix = (np.arange(self._shape[0]) + self._first[0] + 0.5) * r - x
        iy = (np.arange(self._shape[1]) + self._first[1] + 0.5) * r - y
        inside = np.hypot(ix[:, None], iy[None, :]) <= radius_m
        inside = np.roll(inside, (self._first[0] % self._shape[0], self._first[1] % self._shape[1]), axis=(0, 1))
        unknown = inside & np.isnan(self._cells.height)
        self._cells.height[unknown] = height_m
        self._cells.variance[unknown] = 0.05**2
        self._cells.seen[unknown] = -np.inf

    def map(self) -> HeightMap:
        """Return a copy of the heights and variances in plain order; cells that too few pixels hit are unknown."""
        shift = (-self._first[0] % self._shape[0], -self._first[1] % self._shape[1])
        known = fusion.supported(self._cells, self.settings.support)
        heights, variance = (np.roll(grid, shift, axis=(0, 1)) for grid in (known, self._cells.variance))
        variance[np.isnan(heights)] = np.nan
        return HeightMap(heights, self.settings.resolution_m, self.center, variance)

    def _first_cell(self, center: ArrayLike) -> tuple[int, int]:
        place = checks.finite("center", center, (2,), MapError)
        if np.abs(place).max() > checks.FARTHEST_M:
            raise MapError(
                f"center: {place.tolist()} m, expected at most {checks.FARTHEST_M:g} m from the origin on each axis"
            )
        x, y = place / self.settings.resolution_m
        return round(float(x) - 0.5 * self._shape[0]), round(float(y) - 0.5 * self._shape[1])


def _depth(depth: NDArray[Any]) -> Array32:
    image = depth if isinstance(depth, np.ndarray) else checks.array("depth", depth, MapError, np.float32)
    if image.ndim != 2 or min(image.shape) < 3:
        raise MapError(f"depth: shape {image.shape}, expected (height, width) of at least 3 × 3 pixels")
    if image.dtype == np.uint16:
        return np.ascontiguousarray(image * np.float32(0.001))
    if image.dtype.kind != "f":
        raise MapError(f"depth: {image.dtype} values, expected floats in metres or uint16 in millimetres")
    if image.dtype == np.float64:
        return checks.array("depth", image, MapError, np.float32)
    return np.ascontiguousarray(image, dtype=np.float32)
