"""Time the exact foothold criteria: one heightmap and one hip height with every mask, and counts over 31 hip heights.

    python benchmarks/foothold.py [robot]

One core. Stairs are timed beside flat and rough ground, for noise hides the work: it fails early. Single process, whose
fastest call is given beside the median, for other processes take the core away.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from legtool.configs.robots import load_robot
from legtool_runtime.foothold import RESOLUTION_M, SIZE, Criteria, Gait, hip_heights

TWIST = (0.3, 0.0, 0.0, 0.0, 0.0, 0.1)
GAIT = Gait(step_length_m=0.21, step_frequency_hz=1.4, duty_factor=0.55, time_to_touchdown_s=10.0)
CALLS = 400


def terrains() -> dict[str, np.ndarray]:
    """Flat ground, the paper's stairs (10 cm rise, 25 cm go) at several places, and rough ground."""
    x = (np.arange(SIZE) - SIZE // 2) * RESOLUTION_M
    out = {"flat": [np.zeros((SIZE, SIZE))]}
    out["stairs"] = [
        np.repeat(((np.floor((x + s) / 0.25) - np.floor(s / 0.25)) * 0.1)[:, None], SIZE, axis=1)
        for s in np.arange(0.01, 0.25, 0.03)
    ]
    rng = np.random.default_rng(0)
    out["rough"] = [np.kron(rng.uniform(-0.05, 0.05, (7, 7)), np.ones((5, 5)))[:SIZE, :SIZE] for _ in range(8)]
    return {name: [h.astype(np.float32) for h in maps] for name, maps in out.items()}


def timed(call: Callable[[int], object], calls: int) -> np.ndarray:
    call(0)
    times = np.empty(calls)
    for n in range(calls):
        start = time.perf_counter_ns()
        call(n)
        times[n] = (time.perf_counter_ns() - start) * 1e-6
    return times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robot", nargs="?", default="hyq")
    robot = load_robot(parser.parse_args().robot).geometry()
    criteria = Criteria(robot)
    criteria.warm_up()
    hips = hip_heights(robot)
    standing = float(robot.standing_height + robot.hips[0, 2])
    print(f"{robot.name}, {SIZE} × {SIZE} cells, legs FL and RL in turn, {CALLS} calls [ms]")
    for name, maps in terrains().items():
        one = timed(
            lambda n, maps=maps: criteria.evaluate(
                maps[n % len(maps)], leg=2 * (n % 2), hip_height=standing, base_twist=TWIST, gait=GAIT
            ),
            CALLS,
        )
        many = timed(
            lambda n, maps=maps: criteria.counts(
                maps[n % len(maps)], leg=2 * (n % 2), hip_heights=hips, base_twist=TWIST, gait=GAIT
            ),
            CALLS // 8,
        )
        for what, t in (("every mask, one hip height", one), (f"counts, {len(hips)} hip heights", many)):
            low, median, high = np.percentile(t, [0, 50, 95])
            print(f"  {name:7} {what:27} median {median:6.3f}  fastest {low:6.3f}  p95 {high:6.3f}")
    print("the paper: 7.5 ms for one leg's exact evaluation")


if __name__ == "__main__":
    main()
