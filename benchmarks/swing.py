"""Time and acceptance of the swing optimisation (QuadPiPS, VI-D) over the environments, through the runtime's API.

    python benchmarks/swing.py WORLDS [--robot anymal_c] [--count 1000] [--chains 100]

WORLDS is a directory of the QuadPiPS environments as JSON. A robot that tracks perfectly walks each of them on true
regions, from starts that are moved by seed; of the distinct transitions of its paths so many are drawn, and each of
them is optimised by itself, from the tracking controller's reference. Then so many paths are optimised transition by
transition, each from the state in which the last one ended. Wall times hold what other processes take; processor times
are given beside them.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

from legtool.configs.robots import load_robot
from legtool.sim.robots.robot import build_robot
from legtool.sim.robots.tracked import tracked_robot
from legtool_runtime.perception.regions import Regions
from legtool_runtime.robot import Robot
from legtool_runtime.search.contact_plans import contact_plan, timing_of
from legtool_runtime.search.feet import FootPlan
from legtool_runtime.search.pips import Pips, PipsPlan
from legtool_runtime.search.settings import PipsSettings, size_of
from legtool_runtime.search.swings.optimiser import SwingMotion, SwingOptimiser, SwingState
from legtool_runtime.search.swings.settings import SwingSettings
from legtool_runtime.terrain.elevation import HeightMap

sys.path.insert(0, str(Path(__file__).resolve().parent))
import search as courses  # type: ignore[import-not-found]  # the benchmark beside this one

WORLDS = (
    "ramp", "stairs", "rubble", "pegboard", "balance_beam", "ramped_balance_beam", "ramped_stepping_stones",
    "sparse_stepping_stones", "obstructed_balance_beam", "winding_balance_beam",
)  # fmt: skip
PAPER_MS, CELL_M, START_S = 143.0, 0.02, 0.3
#: Starts are moved by so much ahead, aside [m], and turned [rad].
MOVED = (0.12, 0.08, 0.05)
#: Walks that may be needed until enough distinct transitions are found.
WALKS = 60


def wilson(good: int, count: int) -> tuple[float, float]:
    """Interval of 95 % for a share, in per cent."""
    z, share = 1.96, good / count
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * math.sqrt(share * (1 - share) / count + z * z / (4 * count * count))
    return 100 * (middle - half), 100 * (middle + half)


def height_map(faces: list) -> HeightMap:
    """The highest face at every place."""
    corners = np.concatenate([c @ p[:3, :2].T + p[:3, 3] for p, c in faces])
    low, high = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    shape = np.ceil((high - low) / CELL_M).astype(int) + 1
    x, y = (low[i] + CELL_M * (np.arange(shape[i]) + 0.5) for i in range(2))
    heights = np.full(shape, np.nan, np.float32)
    for pose, boundary in faces:
        outline = (boundary @ pose[:3, :2].T + pose[:3, 3])[:, :2]
        first = np.maximum(np.floor((outline.min(axis=0) - low) / CELL_M).astype(int), 0)
        last = np.ceil((outline.max(axis=0) - low) / CELL_M).astype(int) + 1
        part = np.s_[first[0] : last[0], first[1] : last[1]]
        gx, gy = np.meshgrid(x[first[0] : last[0]], y[first[1] : last[1]], indexing="ij")
        inside = np.ones(gx.shape, bool)
        for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
            inside &= (b[0] - a[0]) * (gy - a[1]) - (b[1] - a[1]) * (gx - a[0]) >= 0
        z = pose[2, 3] - (pose[0, 2] * (gx - pose[0, 3]) + pose[1, 2] * (gy - pose[1, 3])) / pose[2, 2]
        heights[part] = np.where(inside, np.fmax(heights[part], z), heights[part])
    return HeightMap(heights, CELL_M, low + 0.5 * CELL_M * shape)


def paths_of(
    pips: Pips, regions: Regions, start: np.ndarray, goal: np.ndarray, feet: np.ndarray, elevation: HeightMap
) -> list[FootPlan]:
    """All paths of stances of a walk."""
    found: list[FootPlan] = []
    plan = pips.plan

    def kept(*what: object, **how: object) -> PipsPlan:
        answer = plan(*what, **how)  # type: ignore[arg-type]  # whatever plan takes
        if answer.feet is not None and len(answer.feet):
            found.append(answer.feet)
        return answer

    pips.plan = kept  # type: ignore[method-assign, assignment]  # a recorder around it
    try:
        courses.walk(pips, regions, start, goal, feet, 0.48, elevation)
    finally:
        pips.plan = plan  # type: ignore[method-assign]
    return found


def transitions(paths: list[FootPlan]) -> list[tuple[FootPlan, int]]:
    """Distinct ones: path and index."""
    seen: dict[bytes, tuple[FootPlan, int]] = {}
    for path in paths:
        for k in np.flatnonzero(~path.families.all(axis=1)).tolist():
            seen.setdefault(np.round(path.positions[k : k + 2], 3).tobytes(), (path, k))
    return list(seen.values())


def lift_s(path: FootPlan, k: int, size: float) -> float:
    """When a transition's feet lift in the path's contact plan, for a robot of that size."""
    return START_S + timing_of(path.gait, size).step_s * int((~path.families[:k].all(axis=1)).sum())


def measure(motions: list[SwingMotion], cpu_ms: list[float], name: str) -> None:
    good = sum(m.accepted for m in motions)
    low, high = wilson(good, len(motions))
    wall = 1e3 * np.array([m.solve_s for m in motions])
    p, c = np.percentile(wall, [50, 95, 99]), np.percentile(cpu_ms, [50, 95, 99])
    refused = ", ".join(f"{v} {k}" for k, v in Counter(m.rule for m in motions if not m.accepted).most_common())
    print(
        f"{name:34} {good:5} of {len(motions):5} [{low:.1f}, {high:.1f}] %   "
        f"wall {p[0]:5.1f} {p[1]:5.1f} {p[2]:5.1f}   processor {c[0]:5.1f} {c[1]:5.1f} {c[2]:5.1f} ms   "
        f"passes {np.mean([m.passes for m in motions]):.1f}   "
        f"{refused or 'none refused'}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("worlds", type=Path)
    parser.add_argument("--only", nargs="*", default=WORLDS)
    parser.add_argument("--robot", default="anymal_c")
    parser.add_argument("--count", type=int, default=1000, help="transitions a world")
    parser.add_argument("--chains", type=int, default=100, help="paths a world")
    parser.add_argument("--window", type=int, default=1, help="transitions that are optimised at once")
    parser.add_argument("--seed", type=int, default=2000)
    parser.add_argument("--refused", action="store_true", help="say why each was refused")
    options = parser.parse_args()
    robot = tracked_robot(build_robot(load_robot(options.robot)))
    geometry: Robot = robot.geometry
    size = size_of(geometry)
    optimiser = SwingOptimiser(robot, SwingSettings(window=options.window))
    optimiser.warm_up()
    pips = Pips(geometry, PipsSettings.of(geometry), com_offset=robot.com)
    pips.warm_up()
    print(f"{geometry.name}; to reach: 15 ms, p99 30, 98 % accepted; the paper's {PAPER_MS:g} ms a transition")
    print(f"{'':34} accepted   wall p50 p95 p99   processor p50 p95 p99")
    every: list[SwingMotion] = []
    every_cpu: list[float] = []

    def run(path: FootPlan, k: int, start: SwingState | None, elevation: HeightMap, regions: Regions) -> SwingMotion:
        plan = contact_plan(path, start_s=START_S, size=size)
        began = time.thread_time_ns()
        motion = optimiser.optimise(
            plan, start_s=lift_s(path, k, size), start=start, elevation=elevation, regions=regions
        )
        cpu.append(1e-6 * (time.thread_time_ns() - began))
        if options.refused and not motion.accepted:
            print(f"    {path.gait} {k}: {motion.reason}")
        return motion

    for name in options.only:
        rng = np.random.default_rng(options.seed)
        regions, start, goal, faces = courses.course(name, options.worlds, geometry, None)
        tops, _, _ = courses.true_regions.world(options.worlds / f"{name}.json", geometry.name, passable=True)
        elevation = height_map(tops)
        paths: list[FootPlan] = []
        for _ in range(WALKS):
            moved = start + rng.uniform(-1.0, 1.0, 3) * MOVED
            feet = courses.true_regions.standing(geometry, faces, *moved)
            pips.reset()
            paths += paths_of(pips, regions, moved, goal, feet, elevation)
            if len(transitions(paths)) >= options.count:
                break
        pool = transitions(paths)
        drawn = rng.permutation(len(pool))[: options.count]
        cpu: list[float] = []
        motions = [run(*pool[i], None, elevation, regions) for i in drawn]
        measure(motions, cpu, f"{name}")
        every, every_cpu = every + motions, every_cpu + cpu
        cpu, motions = [], []
        for i in rng.permutation(len(paths))[: options.chains]:
            state = None
            for k in np.flatnonzero(~paths[i].families.all(axis=1)).tolist():
                motion = run(paths[i], k, state, elevation, regions)
                motions.append(motion)
                state = motion.state(motion.times_s[-1]) if motion.accepted else None
        if motions:
            measure(motions, cpu, "  in chains")
    measure(every, every_cpu, "all")


if __name__ == "__main__":
    main()
