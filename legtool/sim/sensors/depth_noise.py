"""What a real depth sensor does to an exact depth image, in named steps (QuadPiPS, section V-B6).

Each step takes depth (h, w) float32 [m], NaN without return, the number of the shape at each pixel, which tells
boundaries, and a generator; the same generator gives the same image.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from legtool.configs.camera import Corruption, DepthNoise
from legtool_runtime.cache import kernel

Depth = NDArray[np.float32]
Mask = NDArray[np.bool_]
Step = Callable[[Depth, NDArray[np.int32], np.random.Generator, DepthNoise], Depth]

#: Errors of a sensor like an Intel RealSense D435.
USUAL = DepthNoise()
#: Width of the images that lengths in pixels are for: errors keep their angle in smaller images of the same camera.
NATIVE_WIDTH = 640
#: Width of an object's boundary, on either side [pixel].
BOUNDARY = 4
#: Neighbouring depths further apart than this share of them lie on either side of a boundary.
JUMP = 0.05

#: Oil painting: side of the window is twice this and one [pixel]; its depths are sorted into so many bins.
OIL_RADIUS, OIL_BINS = 4, 6
#: Side of the blocks in which that window is shifted, and by how much at most [pixel].
OIL_BLOCK, OIL_SHIFT = 4, 2
#: Voids: how many on boundaries and on surfaces, at most, and their sizes [pixel].
BOUNDARY_VOIDS, SURFACE_VOIDS, VOID_SIZE = 24, 6, (8, 500)
#: Blur: standard deviation [pixel].
BLUR_SIGMA = 0.9


def scaled(pixels: float, depth: Depth) -> int:
    """A length in pixels of images of NATIVE_WIDTH, in those of ``depth`` (h, w); at least one."""
    return max(1, round(pixels * depth.shape[1] / NATIVE_WIDTH))


def boundaries(depth: Depth, geom: NDArray[np.int32], *, width: int = BOUNDARY) -> Mask:
    """Dilated object boundaries.

    Args:
        depth: (h, w) [m], NaN without return.
        geom: (h, w) number of the shape at each pixel.
        width: on either side, pixels of images of NATIVE_WIDTH.
    """
    edge = np.zeros(depth.shape, dtype=np.uint8)
    _edges(depth, geom, JUMP, edge)
    side = 2 * scaled(width, depth) + 1
    return cv2.dilate(edge, np.ones((side, side), np.uint8)) > 0


def oil_painting(depth: Depth, geom: NDArray[np.int32], rng: np.random.Generator, noise: DepthNoise = USUAL) -> Depth:
    """Ragged, blotchy boundaries: each pixel takes the mean of the commonest depths around it.

    The window is shifted at random, block by block, so that a straight boundary is ragged too.
    """
    del noise
    block, most = scaled(OIL_BLOCK, depth), scaled(OIL_SHIFT, depth)
    shifts = rng.integers(-most, most + 1, (depth.shape[0] // block + 1, depth.shape[1] // block + 1, 2))
    out = depth.copy()
    _oil(depth, boundaries(depth, geom), (shifts, block), scaled(OIL_RADIUS, depth), OIL_BINS, out)
    return out


def gaussian_noise(depth: Depth, geom: NDArray[np.int32], rng: np.random.Generator, noise: DepthNoise = USUAL) -> Depth:
    """Noise that grows with depth over surfaces, as stereo's does, and is strong on boundaries."""
    out = rng.standard_normal(depth.shape, dtype=np.float32)
    _noise(depth, boundaries(depth, geom), noise.boundary_sigma, noise.surface_sigma, out)
    return out


def void_blobs(depth: Depth, geom: NDArray[np.int32], rng: np.random.Generator, noise: DepthNoise = USUAL) -> Depth:
    """Connected groups of pixels lose their return, on boundaries and on surfaces."""
    del noise
    edge = boundaries(depth, geom, width=1)
    out = depth.copy()
    for mask, most in ((edge, BOUNDARY_VOIDS), (~edge, SURFACE_VOIDS)):
        places = np.flatnonzero(mask & ~np.isnan(depth))
        if not len(places):
            continue
        count = int(rng.integers(0, most + 1))
        seeds = places[rng.integers(0, len(places), count)]
        sizes = np.exp(rng.uniform(np.log(VOID_SIZE[0]), np.log(VOID_SIZE[1]), count))
        sizes = np.maximum(sizes * (depth.shape[1] / NATIVE_WIDTH) ** 2, 1.0).astype(np.int64)
        _grow(out, seeds, sizes, rng)
    return out


def blur(depth: Depth, geom: NDArray[np.int32], rng: np.random.Generator, noise: DepthNoise = USUAL) -> Depth:
    """Gaussian blur over the returns; pixels without return stay so, and lend nothing to their neighbours."""
    del geom, rng, noise
    known = (~np.isnan(depth)).astype(np.float32)
    sigma = BLUR_SIGMA * depth.shape[1] / NATIVE_WIDTH
    total = cv2.GaussianBlur(np.nan_to_num(depth), (5, 5), sigma)
    weight = cv2.GaussianBlur(known, (5, 5), sigma)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(known > 0, total / weight, np.float32(np.nan))


STEPS: dict[Corruption, Step] = {
    "oil_painting": oil_painting,
    "gaussian_noise": gaussian_noise,
    "void_blobs": void_blobs,
    "blur": blur,
}


def corrupt(depth: Depth, geom: NDArray[np.int32], noise: DepthNoise, rng: np.random.Generator) -> Depth:
    """Put an exact depth image through the steps of ``noise``, in order; each draws from a stream of its own."""
    streams = dict(zip(STEPS, rng.spawn(len(STEPS)), strict=True))
    for step in noise.steps:
        depth = STEPS[step](depth, geom, streams[step], noise)
    return depth


@kernel
def _edges(depth: Depth, geom: NDArray[np.int32], jump: float, edge: NDArray[np.uint8]) -> None:
    """Mark both pixels of each pair of neighbours between which there is a boundary in ``edge`` (h, w) of zeros."""
    height, width = depth.shape
    apart = np.zeros(width, np.uint8)
    for v in range(height):
        # Without branches, and one array written at a time: that is vector code.
        for u in range(width - 1):
            z = depth[v, u]
            apart[u] = (geom[v, u + 1] != geom[v, u]) | (abs(depth[v, u + 1] - z) > jump * z)
        for u in range(width - 1):
            edge[v, u] |= apart[u]
        for u in range(width - 1):
            edge[v, u + 1] |= apart[u]
        if v + 1 == height:
            break
        for u in range(width):
            z = depth[v, u]
            apart[u] = (geom[v + 1, u] != geom[v, u]) | (abs(depth[v + 1, u] - z) > jump * z)
        for u in range(width):
            edge[v, u] |= apart[u]
            edge[v + 1, u] |= apart[u]


@kernel
def _oil(depth: Depth, mask: Mask, shifted: tuple[NDArray[np.int64], int], radius: int, bins: int, out: Depth) -> None:
    shifts, block = shifted
    height, width = depth.shape
    count, total = np.empty(bins, np.int64), np.empty(bins, np.float64)
    for v in range(height):
        for u in range(width):
            if not mask[v, u] or depth[v, u] != depth[v, u]:
                continue
            cv = v + shifts[v // block, u // block, 0]
            cu = u + shifts[v // block, u // block, 1]
            top, bottom = max(cv - radius, 0), min(cv + radius + 1, height)
            left, right = max(cu - radius, 0), min(cu + radius + 1, width)
            low, high = np.inf, -np.inf
            for j in range(top, bottom):
                for i in range(left, right):
                    z = depth[j, i]
                    if z == z:
                        low, high = min(low, z), max(high, z)
            if not high > low:
                continue
            count[:] = 0
            total[:] = 0.0
            scale = bins / (high - low)
            for j in range(top, bottom):
                for i in range(left, right):
                    z = depth[j, i]
                    if z == z:
                        k = min(int((z - low) * scale), bins - 1)
                        count[k] += 1
                        total[k] += z
            best = np.argmax(count)
            out[v, u] = total[best] / count[best]


@kernel
def _noise(depth: Depth, mask: Mask, boundary: float, surface: float, out: Depth) -> None:
    """Turn standard normal ``out`` (h, w) into noisy depth."""
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z = depth[v, u]
            sigma = surface * z * z
            if mask[v, u]:
                sigma = max(sigma, boundary * z)
            out[v, u] = max(z + np.float32(sigma) * out[v, u], np.float32(0.01)) if z == z else z


@kernel
def _grow(depth: Depth, seeds: NDArray[np.int64], sizes: NDArray[np.int64], rng: np.random.Generator) -> None:
    """Void a connected blob of the given size [pixel] around each seed, taking border pixels at random."""
    height, width = depth.shape
    border = np.empty(4 * sizes.max() + 4 if sizes.size else 1, np.int64)
    for seed, size in zip(seeds, sizes):  # noqa: B905  numba knows no strict
        border[0], length, done = seed, 1, 0
        while length > 0 and done < size:
            k = int(rng.random() * length)
            pixel = border[k]
            length -= 1
            border[k] = border[length]
            v, u = pixel // width, pixel % width
            if depth[v, u] != depth[v, u]:
                continue
            depth[v, u] = np.nan
            done += 1
            for dv, du in ((0, 1), (1, 0), (0, -1), (-1, 0)):
                j, i = v + dv, u + du
                if 0 <= j < height and 0 <= i < width and depth[j, i] == depth[j, i] and length < border.size:
                    border[length] = j * width + i
                    length += 1
