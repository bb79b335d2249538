"""Maps made fit for foothold criteria: what edges hide is bounded by the line of sight, and speckle is taken out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.errors import MapError
from legtool_runtime.terrain.elevation import HeightMap

Array32 = NDArray[np.float32]


def fill_hidden(elevation: HeightMap, *, widest_m: float = 0.12, least_step_m: float = 0.03) -> HeightMap:
    """The map with the strips that lie hidden behind edges.

    A camera that looks over the edge of a step does not see the ground right behind it. The ray that grazes the edge
    meets the ground again where it is seen: nothing that is hidden between rises above the line between the two. Along
    rows and columns of cells, unknown cells between known ones that are no farther apart than ``widest_m``, and of
    which one is higher by ``least_step_m`` or more, are given that line. It is a bound for legs and feet that pass, and
    too steep for a foot to stand on. Between known cells of one height there may be a gap: these cells stay unknown.

    Args:
        elevation: the map.
        widest_m: of a strip [m].
        least_step_m: between its two sides [m].

    Raises:
        MapError: a width or step that is not positive and finite.
    """
    for name, value in (("widest_m", widest_m), ("least_step_m", least_step_m)):
        if not 0.0 < value < np.inf:
            raise MapError(f"hidden strips: {name} is {value}, expected a positive number of metres")
    most = round(widest_m / elevation.resolution_m)
    heights = np.empty_like(elevation.heights)
    _fill(elevation.heights, most, np.float32(least_step_m), heights)
    return HeightMap(heights, elevation.resolution_m, elevation.center, elevation.variance)


def without_speckle(elevation: HeightMap) -> HeightMap:
    """The map with each known height replaced by the median of what is known in its 3 × 3 cells.

    Straight edges stay where they are; a height that noise has thrown off its surface goes back to it. Cells of which
    fewer than five of the nine are known stay as they are, and unknown ones unknown.
    """
    heights = np.empty_like(elevation.heights)
    _median(elevation.heights, heights)
    return HeightMap(heights, elevation.resolution_m, elevation.center, elevation.variance)


@kernel
def _median(heights: Array32, out: Array32) -> None:
    n, m = heights.shape
    near = np.empty(9, np.float32)
    middle, whole = np.empty(m, np.float32), np.empty(m, np.float32)
    for i in range(n):
        whole[:] = np.float32(np.nan)
        if 0 < i < n - 1:
            _middle_of_nine(heights[i - 1], heights[i], heights[i + 1], middle, whole)
        for j in range(m):
            if whole[j] == whole[j]:
                out[i, j] = middle[j]
                continue
            out[i, j] = heights[i, j]
            if heights[i, j] != heights[i, j]:
                continue
            count = 0
            for u in range(max(i - 1, 0), min(i + 2, n)):
                for v in range(max(j - 1, 0), min(j + 2, m)):
                    value = heights[u, v]
                    if value == value:
                        k = count
                        while k > 0 and near[k - 1] > value:  # sorted as they come
                            near[k] = near[k - 1]
                            k -= 1
                        near[k] = value
                        count += 1
            if count >= 5:
                out[i, j] = near[count // 2] if count % 2 == 1 else 0.5 * (near[count // 2 - 1] + near[count // 2])


@kernel
def _middle_of_nine(above: Array32, row: Array32, below: Array32, middle: Array32, whole: Array32) -> None:
    """Write the medians (m,) of 3 x 3 cells, and into ``whole`` their sums: NaN where one of the nine is unknown.

    By minima and maxima alone, which make vector code: columns are sorted, then the greatest of the least, the middle
    of the middle and the least of the greatest have the median in their middle.
    """
    m = row.shape[0]
    low, mid, high = np.empty(m, np.float32), np.empty(m, np.float32), np.empty(m, np.float32)
    total = np.empty(m, np.float32)
    for j in range(m):
        a, b, c = above[j], row[j], below[j]
        total[j] = a + b + c
        least, most = (a if a < b else b), (b if a < b else a)
        low[j] = least if least < c else c
        high[j] = c if most < c else most
        c = c if c > least else least
        mid[j] = c if c < most else most
    for j in range(1, m - 1):
        whole[j] = total[j - 1] + total[j] + total[j + 1]
        a, b, c = low[j - 1], low[j], low[j + 1]
        a = a if a > b else b
        lowest = a if a > c else c
        a, b, c = high[j - 1], high[j], high[j + 1]
        a = a if a < b else b
        highest = a if a < c else c
        a, b, c = mid[j - 1], mid[j], mid[j + 1]
        least, most = (a if a < b else b), (b if a < b else a)
        c = c if c > least else least
        centre = c if c < most else most
        least, most = (lowest if lowest < highest else highest), (highest if lowest < highest else lowest)
        c = centre if centre > least else least
        middle[j] = c if c < most else most


@kernel
def _fill(heights: Array32, most: int, least: np.float32, out: Array32) -> None:
    """Write the filled ``heights`` (n, m) into ``out``; of lines along rows and along columns the lower counts."""
    out[:] = heights
    n, m = heights.shape
    for axis in range(2):
        lines, cells = (n, m) if axis == 0 else (m, n)
        for line in range(lines):
            last = -1  # the last known cell
            for cell in range(cells):
                value = heights[line, cell] if axis == 0 else heights[cell, line]
                if value != value:
                    continue
                wide = cell - last - 1
                if last >= 0 and 0 < wide <= most:
                    first = heights[line, last] if axis == 0 else heights[last, line]
                    if abs(value - first) >= least:
                        for k in range(last + 1, cell):
                            share = np.float32(k - last) / np.float32(wide + 1)
                            bound = first + (value - first) * share
                            i, j = (line, k) if axis == 0 else (k, line)
                            if out[i, j] != out[i, j] or bound < out[i, j]:
                                out[i, j] = bound
                last = cell
