"""Time the preview's re-plan, the body reference and their parts, walking over stones, on one core.

    python benchmarks/preview.py [--robot anymal_c] [--plans 1000] [--nodes 20]

A re-plan is everything from the measured state to forces: nodes, assembly, interior point method. To reach: a median of
1 ms and 3 ms at the 99th percentile. Beside the time by the clock stands that of the thread: they differ by what else
runs on the machine.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from legtool.configs.robots import load_robot
from legtool_runtime.tracking.body_reference import ReferenceMaker
from legtool_runtime.tracking.contact_plan import ContactPlan
from legtool_runtime.tracking.gaits import GaitTiming, plan_from_gait
from legtool_runtime.tracking.preview import BodyState, Preview
from legtool_runtime.tracking.settings import PreviewSettings

WARM_UP = 50


def timed(call: Callable[[int], object], count: int) -> np.ndarray:
    """(count, 2) times of calls by the clock and of the thread [ms], after a warm-up."""
    out = np.empty((count + WARM_UP, 2))
    for k in range(count + WARM_UP):
        wall, thread = time.perf_counter(), time.thread_time()
        call(k)
        out[k] = time.perf_counter() - wall, time.thread_time() - thread
    return 1e3 * out[WARM_UP:]


def line(name: str, times: np.ndarray, extra: str = "") -> None:
    clock, thread = (np.percentile(times[:, i], [50, 95, 99]) for i in (0, 1))
    print(f"{name:34}" + "".join(f"{v:9.3f}" for v in (*clock, *thread)) + f"   {extra}")


def stones(stance: np.ndarray, scale: float, rng: np.random.Generator) -> list[np.ndarray]:
    """Footholds of each leg: 40 cm apart, neighbours ± 10 cm, scaled with the robot."""
    out = []
    for leg in range(4):
        places = np.zeros((12, 3))
        places[:, :2] = stance[leg, :2]
        places[:, 0] += 0.4 * scale * np.arange(12)
        places[1:, 2] = np.clip(np.cumsum(rng.uniform(-0.1, 0.1, 11)), -0.2, 0.2) * scale
        out.append(places)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", default="anymal_c")
    parser.add_argument("--plans", type=int, default=1000)
    parser.add_argument("--nodes", type=int, default=20)
    options = parser.parse_args()
    settings = load_robot(options.robot)
    robot, mass = settings.geometry(), settings.total_mass
    scale = float((robot.thigh_length + robot.shank_length).max()) / 0.6125
    size = np.ptp(robot.stance[:, :2], axis=0)
    box = np.array([size[1], size[0], 0.3 * scale])
    inertia = mass / 12 * np.diag(box @ box - box**2)  # of a box between the feet: times do not hang on it
    maker = ReferenceMaker(robot)
    print(f"{options.robot}, {options.plans} re-plans, {options.nodes} nodes; by the clock, of the thread [ms]")
    print(f"{'':34}   median      95 %      99 %   median      95 %      99 %")
    for gait, timing in (("trot", GaitTiming.trot()), ("crawl", GaitTiming.crawl())):
        plan = plan_from_gait(timing, stones(robot.stance, scale, np.random.default_rng(0)), start_s=0.5, robot=robot)
        walk(gait, plan, maker, Preview(
            mass=mass, inertia=inertia, height=maker.height, settings=PreviewSettings(nodes=options.nodes)
        ), options.plans)  # fmt: skip


def walk(gait: str, plan: ContactPlan, maker: ReferenceMaker, preview: Preview, count: int) -> None:
    rng = np.random.default_rng(1)
    at = np.resize(np.arange(0.4, plan.end_s, 0.02), count + WARM_UP)
    references, states = [], []
    for t in at:
        references.append(maker.from_contacts(plan, start_s=t))
        point = references[-1].at(t)
        states.append(BodyState(
            point.position + rng.normal(size=3) * 0.01, point.velocity + rng.normal(size=3) * 0.05, point.rotation,
            point.angular_velocity + rng.normal(size=3) * 0.05,
        ))  # fmt: skip
    found = []
    times = timed(lambda k: found.append(preview.solve(states[k], references[k], plan, at[k])), count)
    unsolved = sum(not solution.solved for solution in found)
    steps = np.array([solution.iterations for solution in found])
    line(
        f"{gait}: preview re-plan", times, f"{steps.mean():.1f} iterations, at most {steps.max()}, {unsolved} unsolved"
    )

    def cold(k: int) -> None:
        preview.forget()
        preview.solve(states[k], references[k], plan, at[k])

    line(f"{gait}: without the last solution", timed(cold, count))
    line(
        f"{gait}: nodes and assembly alone",
        timed(lambda k: preview.problem(states[k], references[k], plan, at[k]), count),
    )
    line(f"{gait}: body reference, 2 s", timed(lambda k: maker.from_contacts(plan, start_s=at[k]), count))


if __name__ == "__main__":
    main()
