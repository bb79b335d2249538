"""Time of one tick of whole-body control: dynamics, quadratic program and torques, through the runtime's Python API.

    python benchmarks/tracking.py [ROBOT] [--ticks N]

Three kinds of ticks: swaying on four feet; a trot on two feet, disturbed as walking disturbs it; and a robot that has
been hit so hard that torques, forces and joints meet their bounds, where the solver takes longest.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from legtool.configs.robots import load_robot
from legtool.sim.robots.robot import build_robot
from legtool.sim.robots.tracked import tracked_robot
from legtool_runtime.robot import TROT_PAIRS
from legtool_runtime.tracking.assembly import References
from legtool_runtime.tracking.dynamics import GRAVITY, FullState
from legtool_runtime.tracking.model import TrackedRobot
from legtool_runtime.tracking.whole_body import SOLVED, WholeBody

#: How far each kind is from its references, and whether diagonal pairs swing.
KINDS = {"sway": (0.1, False), "trot": (0.4, True), "hit": (3.0, True)}
WARM_UP = 200


def tick(robot: TrackedRobot, size: float, trots: bool, rng: np.random.Generator) -> tuple[FullState, References]:
    geometry = robot.geometry
    rest, _ = geometry.joints(geometry.stance)
    position = np.array([0.0, 0.0, geometry.standing_height])
    orientation = np.array([1.0, *(0.05 * size * rng.normal(size=3))])
    state = FullState(
        position + 0.01 * size * rng.normal(size=3),
        orientation / np.linalg.norm(orientation),
        rest + 0.1 * size * rng.normal(size=(4, 3)),
        size * rng.normal(size=18) * np.repeat([0.3, 0.5, 3.0 if trots else 0.5], [3, 3, 12]),
    )
    stance = np.ones(4, dtype=bool)
    if trots and rng.random() < 0.8:
        stance[list(TROT_PAIRS[rng.integers(2)])] = False
    swing = np.zeros((4, 3, 3))
    swing[:, 0] = geometry.feet(rest) + position + 0.02 * size * rng.normal(size=(4, 3))
    swing[:, 1:] = size * rng.normal(size=(4, 2, 3)) * np.array([1.0, 10.0])[:, None]
    normals = np.array([0.0, 0.0, 1.0]) + 0.1 * size * rng.normal(size=(4, 3))
    forces = np.zeros((4, 3))
    forces[stance, 2] = robot.mass * GRAVITY / stance.sum()
    wanted = References(
        com=np.stack([position + robot.com, *(size * rng.normal(size=(2, 3)) * np.array([[0.3], [1.0]]))]),
        orientation=np.array([1.0, 0.0, 0.0, 0.0]),
        turning=size * rng.normal(size=(2, 3)),
        stance=stance,
        swing=swing,
        forces=forces,
        normals=normals / np.linalg.norm(normals, axis=1)[:, None],
        friction=np.full(4, 0.6),
    )
    return state, wanted


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robot", nargs="?", default="anymal_c")
    parser.add_argument("--ticks", type=int, default=5000, help="of each kind")
    options = parser.parse_args()
    robot = tracked_robot(build_robot(load_robot(options.robot)))
    control, rng = WholeBody(robot), np.random.default_rng(0)
    print(f"{robot.geometry.name}; microseconds; to reach: median 100, p99 300")
    print("  kind   solved  iterations p50 p99   processor p50  p95  p99    wall p50  p95  p99")
    for kind, (size, trots) in KINDS.items():
        ticks = [tick(robot, size, trots, rng) for _ in range(options.ticks)]
        for state, wanted in ticks[:WARM_UP]:
            control.control(state, wanted)
        wall, processor, iterations, solved = [], [], [], 0
        for state, wanted in ticks:
            start, start_cpu = time.perf_counter_ns(), time.thread_time_ns()
            answer = control.control(state, wanted)
            processor.append((time.thread_time_ns() - start_cpu) * 1e-3)
            wall.append((time.perf_counter_ns() - start) * 1e-3)
            iterations.append(answer.iterations)
            solved += answer.status == SOLVED
        i, c, w = (
            np.percentile(v, p) for v, p in ((iterations, [50, 99]), (processor, [50, 95, 99]), (wall, [50, 95, 99]))
        )
        print(
            f"  {kind:5} {100 * solved / len(ticks):6.1f} % {i[0]:13.0f} {i[1]:3.0f} "
            f"{c[0]:15.0f} {c[1]:4.0f} {c[2]:4.0f} {w[0]:11.0f} {w[1]:4.0f} {w[2]:4.0f}"
        )


if __name__ == "__main__":
    main()
