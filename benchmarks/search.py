"""Time of the searches of QuadPiPS over whole courses, through the runtime's Python API; how the deadline is kept.

    python benchmarks/search.py WORLDS [--robot anymal_c] [--mode walkable] [--every 0.24]

WORLDS is a directory of the QuadPiPS environments as JSON. A robot that tracks perfectly walks each of them on true
regions: a frame every so many seconds of the plan's clock, from start to goal. Wall times hold what other processes
take; frames that were not interrupted, and the processor time of whole frames, are given beside them. Some of the
foothold searches are then done again: until the first path with time for it, by processor time, and the longest of
them with the deadline.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from legtool.configs.robots import load_robot
from legtool_runtime.perception.regions import Regions
from legtool_runtime.robot import Robot
from legtool_runtime.search.feet import FootPlan, FootPlanner, FootProblem
from legtool_runtime.search.pips import Pips, PipsPlan
from legtool_runtime.search.settings import PipsSettings
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.contact_plan import ContactPlan

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "runtime" / "tests" / "search"))
import true_regions  # type: ignore[import-not-found]  # of the runtime's tests, found by the path above

PAPER_MS = {"torso": 33.0, "feet, first": 67.0}
TARGET_MS = {"candidates": "1", "torso": "p99 1.5", "field": "5", "feet, first": "1 / 10", "feet": "10 + 0.2"}
LONGEST_S = 120.0
#: Of the foothold searches one in so many is done again; so many of the longest, so many times, with the deadline.
ONE_IN, LONGEST, TIMES = 5, 20, 25


@dataclass
class Walk:
    """What came of a course."""

    outcome: str = ""
    time_s: float = 0.0
    frames: int = 0
    left_m: float = 0.0
    statuses: dict[str, int] = field(default_factory=dict)
    times: dict[str, list[float]] = field(default_factory=dict)
    quiet: dict[str, list[float]] = field(default_factory=dict)
    kept: list[float] = field(default_factory=list)


def course(name: str, path: Path, robot: Robot, side: float | None) -> tuple[Regions, np.ndarray, np.ndarray, list]:
    faces, start, goal = true_regions.world(path / f"{name}.json", robot.name)
    pieces = (
        faces if side is None else [p for f in faces for p in (true_regions.cut(f, side) if len(f[1]) == 4 else [f])]
    )
    return true_regions.regions_of(pieces), start, goal, faces


def feet_at(plan: ContactPlan, time_s: float) -> np.ndarray:
    """Contact points; of swinging feet the way is shared evenly."""
    out = np.empty((4, 3))
    for leg in range(4):
        last, following = plan.last(leg, time_s), plan.next(leg, time_s)
        assert last is not None
        share = plan.swing_phase(leg, time_s)
        out[leg] = (
            last.place if share == 0.0 or following is None else last.place + share * (following.place - last.place)
        )
    return out


def walk(
    pips: Pips, regions: Regions, start: np.ndarray, goal: np.ndarray, feet: np.ndarray, every: float,
    elevation: HeightMap | None = None,
) -> Walk:  # fmt: skip
    out, plan, now, height = Walk(), None, 0.0, pips.robot.standing_height
    stuck = 0
    while now < LONGEST_S and stuck < 40:
        here = feet if plan is None else feet_at(plan, now)
        ahead = here[0] + here[1] - here[2] - here[3]
        position = here.mean(axis=0) + np.array([0.0, 0.0, height])
        cpu, before = time.thread_time_ns(), resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw
        answer = pips.plan(
            regions, position=position, yaw=float(np.arctan2(ahead[1], ahead[0])), feet=here, goal=goal, time_s=now,
            plan=plan, elevation=elevation,
        )  # fmt: skip
        undisturbed = resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw == before
        note(out, answer, (time.thread_time_ns() - cpu) * 1e-9, plan, now)
        if undisturbed:
            first = {} if answer.feet is None else {"feet, first": answer.feet.first_s}
            for stage, value in {**answer.times_s, **first}.items():
                out.quiet.setdefault(stage, []).append(value)
        plan = answer.plan
        out.left_m = float(np.hypot(*(position[:2] - goal)))
        if answer.status == "reached":
            out.outcome = "reached"
            break
        out.outcome = f"{answer.status}: {answer.reason}"
        stuck = stuck + 1 if now > plan.end_s + 1.0 else 0
        now += every
    out.time_s = now
    return out


def note(out: Walk, answer: PipsPlan, cpu_s: float, before: ContactPlan | None, now: float) -> None:
    out.frames += 1
    status = answer.status if answer.feet is None else f"{answer.feet.status} {answer.feet.gait}"
    out.statuses[status] = out.statuses.get(status, 0) + 1
    for stage, value in answer.times_s.items():
        out.times.setdefault(stage, []).append(value)
    if answer.feet is not None:
        out.times.setdefault("feet, first", []).append(answer.feet.first_s)
        out.times.setdefault("whole, processor", []).append(cpu_s)
    if before is not None and answer.changed:
        old = [s.place for row in before.stances for s in row if s.begin_s > now]
        new = [s.place for row in answer.plan.stances for s in row]
        if old:
            out.kept.append(float(np.mean([min(np.linalg.norm(p - q) for q in new) < 0.03 for p in old])))


def report(name: str, times: dict[str, list[float]]) -> None:
    for stage in ("candidates", "torso", "field", "feet, first", "feet", "plan", "whole", "whole, processor"):
        if values := times.get(stage):
            p = 1e3 * np.percentile(values, [50, 95, 99, 99.9])
            paper = f"   paper {PAPER_MS[stage]:g}" if stage in PAPER_MS else ""
            target = f"   to reach {TARGET_MS[stage]}" if stage in TARGET_MS else ""
            print(
                f"{name:24} {stage:18} median {p[0]:7.3f} p95 {p[1]:7.3f} p99 {p[2]:7.3f} p99.9 {p[3]:7.3f} "
                f"worst {1e3 * max(values):7.3f} ms{paper}{target}"
            )


def record(planner: FootPlanner, problems: list[FootProblem]) -> None:
    """Keep one in so many of the problems that a planner is asked to solve."""
    plan, count = planner.plan, 0

    def kept(problem: FootProblem, **how: object) -> FootPlan:
        nonlocal count
        count += 1
        if count % ONE_IN == 1:
            field = problem.field  # overwritten by the next frame's
            problems.append(replace(problem, field=field and field._replace(values=field.values.copy())))
        return plan(problem, **how)  # type: ignore[arg-type]  # whatever plan takes

    planner.plan = kept  # type: ignore[method-assign, assignment]  # a recorder around it


def again(robot: Robot, settings: PipsSettings, problems: list[FootProblem]) -> None:
    first = FootPlanner(robot, replace(settings, feet=replace(settings.feet, weights=settings.feet.weights[:1])))
    took, statuses = [], {}
    for problem in problems:
        start = time.thread_time_ns()
        found = first.plan(problem, deadline_s=2.0)
        took.append((time.thread_time_ns() - start) * 1e-6)
        name = f"{found.status} {found.gait}"
        statuses[name] = statuses.get(name, 0) + 1
    p = np.percentile(took, [50, 95, 99])
    print(
        f"{len(took)} searches until the first path, deadline 2 s: processor median {p[0]:.3f} p95 {p[1]:.3f} "
        f"p99 {p[2]:.3f} worst {max(took):.3f} ms   to reach 1 / 10; "
        + ", ".join(f"{v} {k}" for k, v in sorted(statuses.items()))
    )
    planner, late, quiet, answers = FootPlanner(robot, settings), [], [], 0
    for n in np.argsort(took)[-LONGEST:]:
        for _ in range(TIMES):
            before = resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw
            found = planner.plan(problems[n])
            over = 1e3 * (found.planning_time_s - settings.feet.deadline_s)
            late.append(over)
            answers += len(found) > 0
            if resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw == before:
                quiet.append(over)
    print(
        f"deadline of {1e3 * settings.feet.deadline_s:g} ms, the longest searches: {answers} of {len(late)} with steps"
    )
    for name, values in (("all", late), ("not interrupted", quiet)):
        if values:
            p = np.percentile(values, [50, 99, 99.9])
            print(f"  passed by [ms], {name} ({len(values)}): median {p[0]:.3f} p99 {p[1]:.3f} p99.9 {p[2]:.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("worlds", type=Path)
    parser.add_argument("--only", nargs="*", help="names of worlds; all that the robot is for unless given")
    parser.add_argument("--robot", default="anymal_c")
    parser.add_argument("--mode", default="walkable", choices=["walkable", "paper"])
    parser.add_argument("--every", type=float, default=0.24, help="of the plan's clock between frames [s]")
    parser.add_argument("--quiet", action="store_true", help="times of all worlds together only")
    options = parser.parse_args()
    robot = load_robot(options.robot).geometry()
    pips = Pips(robot, PipsSettings.of(robot, options.mode))
    pips.warm_up()
    problems: list[FootProblem] = []
    record(pips._feet, problems)
    every: dict[str, list[float]] = {}
    quiet: dict[str, list[float]] = {}
    for name in options.only or sorted(p.stem for p in options.worlds.glob("*.json")):
        regions, start, goal, faces = course(name, options.worlds, robot, 0.2 if options.mode == "paper" else None)
        pips.reset()
        done = walk(pips, regions, start, goal, true_regions.standing(robot, faces, *start), options.every)
        statuses = ", ".join(f"{v} {k}" for k, v in sorted(done.statuses.items()))
        kept = f"{100 * np.mean(done.kept):.0f} %" if done.kept else "-"
        print(
            f"{name:24} {done.outcome}; {done.left_m:.2f} m left after {done.time_s:.1f} s, {done.frames} frames: "
            f"{statuses}; future footholds kept {kept}"
        )
        if not options.quiet:
            report(name, done.times)
        for stage, values in done.times.items():
            every.setdefault(stage, []).extend(values)
        for stage, values in done.quiet.items():
            quiet.setdefault(stage, []).extend(values)
    report(f"all ({len(every.get('whole', []))})", every)
    report(f"not interrupted ({len(quiet.get('whole', []))})", quiet)
    again(robot, pips.settings, problems)


if __name__ == "__main__":
    main()
