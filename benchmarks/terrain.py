"""Time of one elevation map update and of one foot costmap, on one core.

    OMP_NUM_THREADS=1 python benchmarks/terrain.py

Depth of 640 × 480 pixels of ground with a gap and a step, noisy, seen from a walking robot, goes into 4 m × 4 m at
2 cm. Wall times hold what other processes take; processor times are given beside them.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.terrain import ElevationGrid, foot_costmap

WIDTH, HEIGHT, FOCAL, PITCH = 640, 480, 385.0, 0.5
INTRINSICS = (FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
#: Lower and upper corners [m]: ground, a 15 cm gap, a step of 6 cm, the floor far below.
BOXES = np.array(
    [
        [[-9, -9, -2], [0.8, 9, 0]],
        [[0.95, -9, -2], [1.6, 9, 0]],
        [[1.6, -9, -2], [9, 9, 0.06]],
        [[-9, -9, -2], [9, 9, -0.5]],
    ]
)
REPEATS = 300


def pose(x: float) -> NDArray[np.float64]:
    """(4, 4) optical frame to world: half a metre up, looking down ahead."""
    c, s = np.cos(PITCH), np.sin(PITCH)
    out = np.eye(4)
    out[:3, :3] = np.array([[0, -s, c], [-1, 0, 0], [0, -c, -s]])
    out[:3, 3] = x, 0.0, 0.5
    return out


def render(transform: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float32]:
    """Noisy depth of the boxes [m]."""
    fx, fy, cx, cy = INTRINSICS
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(u.shape)], axis=-1) @ transform[:3, :3].T
    depth = np.full(u.shape, np.inf)
    for low, high in BOXES:
        with np.errstate(divide="ignore"):
            a, b = (low - transform[:3, 3]) / rays, (high - transform[:3, 3]) / rays
        enter, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
        depth = np.where((enter < leave) & (enter > 0), np.minimum(depth, enter), depth)
    depth = np.where(np.isfinite(depth), depth, 0.0)
    return (depth + 0.004 * depth**2 * rng.standard_normal(depth.shape)).astype(np.float32)


def report(name: str, call: Callable[[int], object], least: str) -> None:
    for n in range(20):
        call(n)
    wall, processor = np.empty(REPEATS), np.empty(REPEATS)
    for n in range(REPEATS):
        start, start_cpu = time.perf_counter_ns(), time.thread_time_ns()
        call(n)
        wall[n] = (time.perf_counter_ns() - start) * 1e-6
        processor[n] = (time.thread_time_ns() - start_cpu) * 1e-6
    w, p = np.percentile(wall, [0, 50, 95, 99]), np.percentile(processor, [50, 95, 99])
    print(
        f"{name:44} wall fastest {w[0]:.3f} median {w[1]:.3f} p95 {w[2]:.3f} p99 {w[3]:.3f}   "
        f"processor median {p[0]:.3f} p95 {p[1]:.3f} p99 {p[2]:.3f} ms   wanted {least}"
    )


def main() -> None:
    rng = np.random.default_rng(0)
    frames = [(x, pose(x), render(pose(x), rng)) for x in np.linspace(0.0, 0.4, 12)]
    grid = ElevationGrid()
    clock = iter(range(10**9))

    def update(n: int, scale: float = 1.0) -> None:
        x, transform, depth = frames[n % len(frames)]
        grid.move_to((x, 0.0))
        image = depth if scale == 1.0 else millimetres[n % len(frames)]
        grid.update(image, INTRINSICS, transform_camera_to_world=transform, time_s=next(clock) / 15)

    millimetres = [np.round(depth * 1000).clip(0, 65535).astype(np.uint16) for *_, depth in frames]
    report("move and update, 640 × 480 floats", update, "≤ 5 ms")
    report("move and update, 640 × 480 uint16", lambda n: update(n, 0.001), "≤ 5 ms")
    cells = grid.map()
    seen = np.mean(~np.isnan(cells.heights))
    report(f"costmap, 200 × 200, {seen:.0%} seen", lambda _: foot_costmap(cells), "≤ 1 ms")
    report("map read out", lambda _: grid.map(), "none")


if __name__ == "__main__":
    main()
