"""Time of one plan, 1-D at horizons 3, 5, 7 and 3-D at horizon 5 on the paper's scenarios; how the deadline is kept.

    python benchmarks/planner.py [BUNDLE]

The states are those of walks over the models themselves, with their noise. Without a bundle the made-up walker of the
runtime's tests walks. Wall times hold what other processes take; processor times, and calls that were not interrupted,
are given beside them.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from pathlib import Path

import numpy as np

from legtool_runtime import load_bundle
from legtool_runtime.motion.model import MotionModel, MotionState
from legtool_runtime.motion.planning.planner import Goal, Planner, PlannerSettings, planar_commands
from legtool_runtime.robot import Robot

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "runtime" / "tests" / "motion"))
import walker  # type: ignore[import-not-found]  # of the runtime's tests, found by the path above

LEFT, RIGHT = (0.0, 1.0), (-1.0, 0.0)
#: Gaps as x from, to and, where they are not across the whole path, y from, to [m]; the edge of a step is 4 cm unsafe.
SCENARIOS = {
    "I": [(0.9, 1.0), (1.9, 2.05)],
    "II": [(0.9, 1.05, *LEFT), (1.8, 1.95, *RIGHT), (2.5, 2.54)],
    "III": [(0.8, 0.9), (1.6, 1.72, *LEFT), (2.4, 2.53, *RIGHT), (3.1, 3.14), (3.5, 3.54)],
}
PAPER_MS = {3: "0.24-0.48", 5: "0.77-0.92", 7: "0.98-1.75"}
WALKS = 40


def timed_walks(planner: Planner, model: MotionModel, scenario: str) -> tuple[list[float], list[float], list[str]]:
    """Wall and processor time [ms] and status of every plan of the walks through a scenario."""
    wall, processor, statuses = [], [], []
    plan_once = planner.plan

    def timed(*args: object, **how: object) -> object:
        start = time.thread_time_ns()
        plan = plan_once(*args, **how)  # type: ignore[arg-type]  # whatever plan takes
        processor.append((time.thread_time_ns() - start) * 1e-6)
        wall.append(plan.planning_time_s * 1e3)
        statuses.append(plan.status)
        return plan

    planner.plan = timed  # type: ignore[method-assign, assignment]  # a stopwatch around it
    costmap = walker.strip(*SCENARIOS[scenario], unknown_unsafe=True)
    for seed in range(WALKS):
        walker.walk(planner, model, costmap, Goal(4.2, 0.0), steps=40, seed=seed)
    return wall, processor, statuses


def report(name: str, wall: list[float], processor: list[float], paper: str) -> None:
    w, p = np.percentile(wall, [50, 95, 99]), np.percentile(processor, [50, 95, 99])
    print(
        f"{name:24} wall median {w[0]:.3f} p95 {w[1]:.3f} p99 {w[2]:.3f}   "
        f"processor median {p[0]:.3f} p95 {p[1]:.3f} p99 {p[2]:.3f} ms   paper {paper}"
    )


def plans(model: MotionModel, robot: Robot) -> None:
    for horizon, commands in ((3, None), (5, None), (7, None), (5, planar_commands())):
        kind = "1-D" if commands is None else f"3-D ({len(commands)} commands)"
        for scenario in SCENARIOS:
            planner = Planner(model, robot, commands=commands, settings=PlannerSettings(horizon=horizon, **walker.BARE))
            planner.warm_up()
            wall, processor, statuses = timed_walks(planner, model, scenario)
            paper = PAPER_MS[horizon] if commands is None else "none"
            report(f"{kind} N={horizon} {scenario}", wall, processor, paper)
            print(f"{'':24} {len(wall)} plans: {', '.join(f'{s} {statuses.count(s)}' for s in sorted(set(statuses)))}")


def deadline(model: MotionModel, robot: Robot, calls: int) -> None:
    """A search that cannot end in time: a fine set of commands, 12 steps, towards a chasm."""
    settings = PlannerSettings(horizon=12, **walker.BARE)
    fine = planar_commands(np.round(np.arange(-4, 21) * 0.05, 2), np.arange(-4, 5) * 0.05, np.arange(-4, 5) * 0.125)
    planner = Planner(model, robot, commands=fine, settings=settings)
    planner.warm_up()
    costmap = walker.strip((1.2, 2.2))
    late, undisturbed = [], []
    half = np.array([0.5, 0.0, 0.0])
    for n in range(calls):
        x = 0.3 * np.random.default_rng(n).random()
        state = MotionState(half, half, half, robot.stance, n % 2)
        before = resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw
        plan = planner.plan(state, costmap, position=[x, 0, 0.36], rotation=np.eye(3), goal=Goal(5.0, 0.0))
        over = (plan.planning_time_s - settings.deadline_s) * 1e3
        late.append(over)
        if resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw == before:
            undisturbed.append(over)
    cut = sum(over > 0 for over in late)
    print(f"deadline of {settings.deadline_s * 1e3:g} ms: {cut} of {calls} searches were cut; passed by [ms]:")
    for name, values in (("all", late), ("not interrupted", undisturbed)):
        if not values:
            continue
        p = np.percentile(values, [50, 99, 99.9])
        print(f"  {name:16} median {p[0]:.3f} p99 {p[1]:.3f} p99.9 {p[2]:.3f} worst {max(values):.3f} ({len(values)})")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bundle", nargs="?")
    parser.add_argument("--calls", type=int, default=1000, help="searches that run into the deadline")
    options = parser.parse_args()
    if options.bundle is None:
        model, robot = walker.model(), walker.ROBOT
    else:
        bundle = load_bundle(options.bundle)
        model, robot = bundle.motion, bundle.robot
    plans(model, robot)
    deadline(model, robot, options.calls)


if __name__ == "__main__":
    main()
