"""ViTAL's comparison of body poses, kinematically: VPA against the terrain-based baseline TBR on the paper's courses.

The trunk is moved at constant speed; at every 2 cm both strategies give a pose, with the limits on its change, and the
exact criteria count the safe footholds that each leg has there, below its hip at the hip's height.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from legtool.configs.robots import load_robot
from legtool.datasets.store import claim_directory
from legtool.evaluation.foothold_report import write_vital_report
from legtool.evaluation.results import RESULTS, Metric, metric, provenance, write_results
from legtool.progress import progress
from legtool.sim.foothold_courses import WALKS, Walk, course_heights
from legtool_runtime.foothold import Criteria, Gait
from legtool_runtime.foothold.heightmap import extract_heightmap
from legtool_runtime.foothold.pose import PosePlanner, PoseSettings, hips_above, terrain_pose
from legtool_runtime.foothold.selection import FootholdSelector, hip_position
from legtool_runtime.terrain.elevation import HeightMap

Array = NDArray[np.float64]
STEP_M = 0.02
#: Strategies: VPA with both horizons and with one, with the paper's additive costs, and the baseline.
STRATEGIES: dict[str, PoseSettings | None] = {
    "vpa": PoseSettings(),
    "vpa_single": PoseSettings(horizons=1),
    "vpa_integral": PoseSettings(cost="integral"),
    "vpa_sum": PoseSettings(cost="sum"),
    "tbr": None,
}


@dataclass(frozen=True, eq=False)
class Trace:
    """One strategy's walk; n poses.

    Attributes:
        x: (n,) of the trunk [m].
        pose: (n, 3) height in the world [m], roll, pitch [rad].
        safe: (n, 4) exact numbers of safe footholds.
        margin: (n, 4) their change over hip heights m above and below: the error of equation 27.
    """

    x: Array
    pose: Array
    safe: NDArray[np.int64]
    margin: NDArray[np.int64]


def eval_vital(robot_name: str, out: Path, *, walks: tuple[str, ...] = tuple(WALKS)) -> Iterator[str]:
    """Walk all strategies over the courses and write ``results.json`` and ``report.html``.

    Args:
        robot_name: preset or YAML.
        out: directory for both files.
        walks: which of the walks.

    Yields:
        one line per walk.

    Raises:
        RobotError: no such robot.
        OutputError: ``out`` holds something else.
    """
    criteria = Criteria(load_robot(robot_name).geometry())
    metrics: dict[str, Metric] = {}
    traces: dict[str, dict[str, Trace]] = {}
    with progress("walking", len(walks) * len(STRATEGIES), "walks") as advance:
        for name in walks:
            for strategy, settings in STRATEGIES.items():
                trace = walk(criteria, WALKS[name], settings)
                traces.setdefault(name, {})[strategy] = trace
                metrics |= walk_metrics(name, strategy, trace)
                advance(1)
            value = {s: metrics[f"{name}.{s}.min_safe"]["value"] for s in STRATEGIES}
            zero = {s: metrics[f"{name}.{s}.without_safe"]["value"] for s in STRATEGIES}
            yield f"{name}: least safe footholds of the worst leg " + ", ".join(
                f"{s} {value[s]:.0f} (none on {100 * zero[s]:.0f} % of the way)" for s in STRATEGIES
            )
    claim_directory(out, RESULTS)
    settings_of = {s: None if v is None else vars(v) for s, v in STRATEGIES.items()}
    facts = provenance({"robot": robot_name, "strategies": settings_of}, seed=0, data_hash="", suite="vital")
    write_results(out / RESULTS, metrics, facts)
    write_vital_report(out / "report.html", metrics, traces, facts)


def walk_metrics(name: str, strategy: str, trace: Trace) -> dict[str, Metric]:
    """What a walk comes down to: safe footholds of the worst leg, and the pose's variation (equation 26)."""
    worst, n = trace.safe.min(axis=1), len(trace.x)
    step = np.diff(trace.pose, axis=0) / np.diff(trace.x)[:, None]
    key = f"{name}.{strategy}"
    return {
        f"{key}.min_safe": metric(worst.min(), None, n, "1"),
        f"{key}.mean_safe": metric(trace.safe.mean(), None, n, "1"),
        f"{key}.without_safe": metric((worst == 0).mean(), None, n, "1"),
        f"{key}.height_variation": metric(np.abs(step[:, 0]).mean(), None, n, "1"),
        f"{key}.pitch_variation_rad_m": metric(np.abs(step[:, 2]).mean(), None, n, "rad/m"),
        f"{key}.margin_error": metric(trace.margin.mean(), None, n, "1"),
    }


def walk(criteria: Criteria, walk: Walk, settings: PoseSettings | None) -> Trace:
    """Move the trunk over a course; ``settings`` None: with the baseline."""
    elevation = course_heights(walk.course)
    robot = criteria.robot
    # A trot whose steps fit the speed.
    frequency = 1.4
    gait = Gait(walk.speed / frequency, frequency, 0.55)
    planner = None if settings is None else PosePlanner(criteria, settings)
    selector = FootholdSelector(criteria)
    places = np.arange(walk.begin, walk.end, STEP_M)
    rate = walk.turn * walk.speed / (walk.end - walk.begin)
    previous, safe, margins = None, [], []
    poses: list[Array] = []
    # TBR keeps the choice of the last foothold that was found.
    feet = robot.stance + np.array([walk.begin, 0.0, robot.standing_height])
    for x in places:
        yaw = walk.heading + walk.turn * (x - walk.begin) / (walk.end - walk.begin)
        c, s = np.cos(yaw), np.sin(yaw)
        twist = (walk.speed * c, -walk.speed * s, 0.0, 0.0, 0.0, rate)
        base = np.array([x, 0.0])
        if planner is not None:
            plan = planner.plan(
                elevation,
                base_position=(float(x), 0.0),
                yaw=yaw,
                base_twist=twist,
                gait=gait,
                previous=previous,
                travelled_m=STEP_M,
            )
            previous = plan.poses[0]
            pose = np.array([previous.height, previous.roll, previous.pitch])
        else:
            last = poses[-1] if poses else np.array([robot.standing_height, 0.0, 0.0])
            pose = _baseline(selector, elevation, base, yaw, twist, gait, last, feet)
        poses.append(pose)
        counts = _counts(criteria, elevation, base, yaw, twist, gait, pose, PoseSettings().margin_m)
        safe.append(counts[:, 1])
        margins.append(np.abs(counts[:, 2] - counts[:, 0]))
    return Trace(places, np.array(poses), np.array(safe), np.array(margins))


def _baseline(
    selector: FootholdSelector,
    elevation: HeightMap,
    base: Array,
    yaw: float,
    twist: tuple[float, ...],
    gait: Gait,
    last: Array,
    feet: Array,
) -> Array:
    """The pose of TBR, the limits on its change those of VPA; ``feet`` (4, 3) chosen footholds, changed in place."""
    robot, limits = selector.criteria.robot, PoseSettings()
    for leg in range(4):
        found = selector.select_in(
            elevation,
            leg=leg,
            base_position=(*base, last[0]),
            attitude=(last[1], last[2], yaw),
            base_twist=twist,
            gait=Gait(gait.step_length_m, gait.step_frequency_hz, gait.duty_factor, gait.swing_s),
        )
        if found.position is not None:
            feet[leg] = found.position - [0, 0, robot.foot_radius]
        else:
            feet[leg, :2] = found.nominal
    wanted = np.array(terrain_pose(feet, yaw=yaw, height=robot.standing_height))
    reach = STEP_M * np.array([limits.height_per_m, limits.roll_per_m, limits.pitch_per_m])
    wanted[1:] = np.clip(wanted[1:], -limits.angle, limits.angle)
    return np.clip(wanted, last - reach, last + reach)


def _counts(
    criteria: Criteria,
    elevation: HeightMap,
    base: Array,
    yaw: float,
    twist: tuple[float, ...],
    gait: Gait,
    pose: Array,
    margin: float,
) -> NDArray[np.int64]:
    """(4, 3) exact numbers of safe footholds at a pose: hips lower by the margin, as they are, higher."""
    above = hips_above(criteria.robot.hips, pose)
    out = []
    for leg in range(4):
        center = hip_position(criteria.robot.hips[leg] * [1, 1, 0], (*base, 0.0), 0.0, 0.0, yaw)[:2]
        heights = extract_heightmap(elevation, center, yaw=yaw)
        hips = above[leg] + np.array([-margin, 0.0, margin])
        out.append(criteria.counts(heights, leg=leg, hip_heights=hips, base_twist=twist, gait=gait))
    return np.array(out)
