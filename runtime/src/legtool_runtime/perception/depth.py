"""What is done to a depth image before it is segmented, by the robot and by training alike (QuadPiPS, section V-B6).

A sensor's image is decimated and its small holes are filled, as RealSense's filters of these names do it. Training puts
its corrupted images through the same list of steps, and a bundle names the list that its segmenter was trained with.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from legtool_runtime.cache import kernel
from legtool_runtime.errors import PerceptionError
from legtool_runtime.perception.camera import Camera, Depth

#: Pixels of a block's side that decimation makes one pixel of.
FACTOR = 2
#: Sweeps of hole filling: a hole is closed if it is at most about twice as many pixels across.
SWEEPS = 4
#: Known neighbours, of eight, that a pixel without return needs to be filled: a straight edge of the unseen has three.
ENOUGH = 4


def decimate(depth: Depth) -> Depth:
    """Halve an image: the median of each 2 × 2 block's returns, of an even number the nearer middle one.

    No depth is made up between two surfaces.

    Args:
        depth: (h, w) [m], NaN where there is no return; an odd last row or column is left out.

    Returns:
        (h // 2, w // 2) [m], NaN where a block holds no return.
    """
    out = np.empty((depth.shape[0] // FACTOR, depth.shape[1] // FACTOR), dtype=np.float32)
    _decimate(depth, out)
    return out


def fill_holes(depth: Depth) -> Depth:
    """Fill small holes with the farthest depth around them.

    Args:
        depth: (h, w) [m], NaN where there is no return.

    Returns:
        (h, w) [m]; NaN inside large holes, and beyond the edge of what was seen.
    """
    one, two = depth.copy(), depth.copy()
    for _ in range(SWEEPS):
        if not _fill(one, two):
            break
        one[...] = two
    return one


#: The steps, by the names that bundles and runs know them by.
STEPS = {"decimate": decimate, "fill_holes": fill_holes}
#: The list that training and robot use.
PREPARATION = ("decimate", "fill_holes")


def prepare(depth: Depth, steps: Sequence[str] = PREPARATION) -> Depth:
    """Put a depth image through the steps.

    Args:
        depth: (h, w) [m], NaN where there is no return, as ``as_metres`` gives it.
        steps: names in STEPS, in order.

    Returns:
        float32 [m], NaN where there is no return.

    Raises:
        PerceptionError: a step that this runtime does not know.
    """
    for step in steps:
        if step not in STEPS:
            raise PerceptionError(
                f"preparation step {step!r}: expected one of {', '.join(STEPS)}; upgrade legtool-runtime"
            )
        depth = STEPS[step](depth)
    return depth


def prepared_camera(camera: Camera, steps: Sequence[str] = PREPARATION) -> Camera:
    """The camera that would have taken the prepared image."""
    for _ in range(list(steps).count("decimate")):
        width, height = camera.width // FACTOR, camera.height // FACTOR
        # The middle of a 2 × 2 block lies half a pixel from its first one.
        cx, cy = (camera.cx - 0.5) / FACTOR, (camera.cy - 0.5) / FACTOR
        camera = Camera(width, height, camera.fx / FACTOR, camera.fy / FACTOR, cx, cy)
    return camera


def fit_camera(depth: Depth, camera: Camera, target: Camera) -> Depth:
    """The image that another camera in the same place would have taken, each pixel from the ray nearest to its own.

    A segmenter knows one camera; images of a sensor with other intrinsics are brought to it by this.

    Args:
        depth: (h, w) [m], NaN where there is no return.
        camera: that took it.
        target: that is wanted.

    Returns:
        (target.height, target.width) [m], NaN where there is no return, or what is wanted was not in view.
    """
    u = np.rint((np.arange(target.width) - target.cx) / target.fx * camera.fx + camera.cx).astype(np.int64)
    v = np.rint((np.arange(target.height) - target.cy) / target.fy * camera.fy + camera.cy).astype(np.int64)
    out = depth[np.clip(v, 0, camera.height - 1)][:, np.clip(u, 0, camera.width - 1)].astype(np.float32)
    out[(v < 0) | (v >= camera.height)] = np.nan
    out[:, (u < 0) | (u >= camera.width)] = np.nan
    return out


@kernel
def _decimate(depth: Depth, out: Depth) -> None:
    inf, nan = np.float32(np.inf), np.float32(np.nan)
    for v in range(out.shape[0]):
        for u in range(out.shape[1]):
            a, b = depth[2 * v, 2 * u], depth[2 * v, 2 * u + 1]
            c, d = depth[2 * v + 1, 2 * u], depth[2 * v + 1, 2 * u + 1]
            known = int(a == a) + int(b == b) + int(c == c) + int(d == d)
            a, b = a if a == a else inf, b if b == b else inf
            c, d = c if c == c else inf, d if d == d else inf
            low, high = min(a, b), max(a, b)
            least, other = min(low, min(c, d)), max(low, min(c, d))
            second = min(other, min(high, max(c, d)))
            # Of four the second, of three the second, of two and one the first.
            out[v, u] = second if known >= 3 else (least if known > 0 else nan)


@kernel
def _fill(before: Depth, after: Depth) -> int:
    """One sweep; how many pixels were filled."""
    height, width = before.shape
    filled = 0
    for v in range(height):
        for u in range(width):
            if before[v, u] == before[v, u]:
                continue
            known = 0
            farthest = np.float32(0.0)
            for j in range(max(v - 1, 0), min(v + 2, height)):
                for i in range(max(u - 1, 0), min(u + 2, width)):
                    z = before[j, i]
                    if z == z:
                        known += 1
                        farthest = max(farthest, z)
            if known >= ENOUGH:
                after[v, u] = farthest
                filled += 1
    return filled
