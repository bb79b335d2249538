"""Planar ground in an elevation map: the plane through each cell's neighbourhood, and cells that feet may stand on."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from legtool_runtime.terrain.elevation import HeightMap

Array = NDArray[np.float64]

#: Ground: deviation from the plane of 3 × 3 cells [m], and slope; less a border of one cell.
_ROUGHNESS_M, _STEEPEST = 0.02, math.tan(math.radians(30.0))


def local_planes(z: Array, resolution_m: float) -> tuple[Array, Array, Array]:
    """The plane through each full 3 × 3 neighbourhood of heights (n, m), by least squares.

    Returns:
        slopes along x and along y, and the root mean square off the plane [m], (n, m) each; NaN where a cell lacks.
    """
    kernel = np.array([-1.0, 0.0, 1.0])
    along_x = ndimage.correlate(z, np.outer(kernel, np.ones(3)), mode="constant", cval=np.nan) / 6
    along_y = ndimage.correlate(z, np.outer(np.ones(3), kernel), mode="constant", cval=np.nan) / 6
    mean = ndimage.correlate(z, np.full((3, 3), 1 / 9), mode="constant", cval=np.nan)
    square = ndimage.correlate(z**2, np.full((3, 3), 1 / 9), mode="constant", cval=np.nan)
    rest = square - mean**2 - 6 / 9 * (along_x**2 + along_y**2)
    return along_x / resolution_m, along_y / resolution_m, np.sqrt(np.maximum(rest, 0))


def flat_cells(elevation: HeightMap) -> NDArray[np.bool_]:
    """(n_x, n_y) cells of planar ground in an elevation map, less a border of one cell (QuadPiPS, section VIII-B2).

    As in the pipeline that the paper compares with: cells whose 3 × 3 heights are 2 cm off a plane at most, by their
    root mean square, which is no steeper than 30°.
    """
    slope_x, slope_y, off = local_planes(elevation.heights.astype(np.float64), elevation.resolution_m)
    with np.errstate(invalid="ignore"):
        flat = (off <= _ROUGHNESS_M) & (np.hypot(slope_x, slope_y) <= _STEEPEST)
    return ndimage.binary_erosion(flat, np.ones((3, 3), np.bool_))
