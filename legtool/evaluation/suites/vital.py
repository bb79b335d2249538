"""ViTAL's comparison of body poses, kinematically: VPA against the terrain-based baseline TBR in the paper's worlds.

The trunk is moved at constant speed; at every 2 cm each strategy gives a pose, with the same limits on its change, and
the exact criteria count the safe footholds that each leg has there, below its hip, at the hip's height and the trunk's
attitude. Then the path is walked step by step, and MuJoCo's own geometry counts collisions and violations of the
workspace.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from legtool.configs.robots import load_robot
from legtool.configs.vital import VitalSettings
from legtool.datasets.work import RESULTS
from legtool.evaluation.judges import judge_poses
from legtool.evaluation.report.intervals import share
from legtool.evaluation.report.results import Metric, metric, provenance, write_results
from legtool.evaluation.suites.trials import TrialKey, Trials, trial_key
from legtool.evaluation.suites.vital_report import write_vital_report
from legtool.evaluation.suites.vital_trace import Trace
from legtool.sim.walks.kinematic import walk_steps
from legtool.sim.walks.trunk_path import PATHS, TrunkPath, vital_map, vital_world
from legtool.sim.worlds.world import World
from legtool.workers import Workers
from legtool_runtime.foothold import Criteria, Gait, Tuple
from legtool_runtime.foothold.heightmap import extract_heightmap
from legtool_runtime.foothold.pose import PosePlanner, terrain_pose
from legtool_runtime.foothold.pose_settings import PoseSettings
from legtool_runtime.foothold.selection import FootholdSelector
from legtool_runtime.rotations import place
from legtool_runtime.terrain.elevation import HeightMap

Array = NDArray[np.float64]
STEP_M = 0.02
#: Strategies: VPA with both horizons and with one, with the paper's additive costs, and the baseline.
STRATEGIES: dict[str, PoseSettings | None] = {
    "vpa": PoseSettings(),
    "tbr": None,
    "vpa_single": PoseSettings(horizons=1),
    "vpa_integral": PoseSettings(cost="integral"),
    "vpa_integral_single": PoseSettings(cost="integral", horizons=1),
    "vpa_sum": PoseSettings(cost="sum"),
}
#: The first two walk everywhere; the others where the paper compares them: stairs (Figs. 12 and 13).
EVERYWHERE, STUDIED = ("vpa", "tbr"), ("stairs", "stairs_04")
_FRAMES = (0.2, 0.6, 1.4, 1.9)


def eval_vital(settings: VitalSettings, out: Path, *, workers: int | Workers = 1) -> Iterator[str]:
    """Walk the strategies through the worlds and write ``results.json`` and ``report.html``.

    Args:
        settings: robot, walks, worlds.
        out: directory for both; walks that are finished there, of the same robots and worlds, are kept.
        workers: processes; the result does not depend on it.

    Yields:
        one line per walk.

    Raises:
        RobotError: no such robot.
        OutputError: ``out`` holds something else.
    """
    for name in {_robot(settings, walk) for walk in settings.walks}:
        load_robot(name)
    keys = {(name, s): _key(settings, name, s) for name in settings.walks for s in strategies(name)}
    with Trials(out, "vital", ".npz", workers=workers) as trials:
        trials.run(keys.values(), functools.partial(_run, settings, trials))
        yield from _report(settings, out, {pair: Trace.load(trials.path(key)) for pair, key in keys.items()})


def _report(settings: VitalSettings, out: Path, walked: Mapping[tuple[str, str], Trace]) -> Iterator[str]:
    metrics: dict[str, Metric] = {}
    traces: dict[str, dict[str, Trace]] = {}
    for name in settings.walks:
        traces[name] = {strategy: walked[name, strategy] for strategy in strategies(name)}
        for strategy, trace in traces[name].items():
            metrics |= walk_metrics(name, strategy, trace)
        yield f"{name}: " + "; ".join(_line(metrics, f"{name}.{strategy}", strategy) for strategy in traces[name])
    how = {s: None if v is None else dict(vars(v)) for s, v in STRATEGIES.items()}
    facts = provenance(settings.to_dict(), seed=settings.seed, data_hash="", suite="vital", strategies=how)
    verdict = judge_poses(metrics, settings.walks)
    write_results(out / RESULTS.marker, metrics, facts, verdict=verdict.to_dict())
    write_vital_report(out / "report.html", metrics, traces, facts, verdict)
    yield from verdict.lines()


def strategies(name: str) -> tuple[str, ...]:
    """The strategies that are walked on one walk."""
    return tuple(STRATEGIES) if name in STUDIED else EVERYWHERE


def _line(metrics: Mapping[str, Metric], key: str, strategy: str) -> str:
    value = {name: metrics[f"{key}.{name}"]["value"] for name in ("min_safe", "collisions", "workspace_violations")}
    steps = metrics[f"{key}.collisions"]["n"]
    return (
        f"{strategy} at least {value['min_safe']:.0f} safe footholds, {value['collisions'] * steps:.0f} collisions and "
        f"{value['workspace_violations'] * steps:.0f} violations on {steps} steps"
    )


def _key(settings: VitalSettings, name: str, strategy: str) -> TrialKey:
    robot, path = load_robot(_robot(settings, name)), PATHS[name]
    decides = {"robot": robot, "walk": path, "world": _world(settings, path).settings, "strategy": STRATEGIES[strategy]}
    return trial_key(name, strategy, 0, decides)


def _world(settings: VitalSettings, path: TrunkPath) -> World:
    return vital_world(path.world, seed=settings.seed, scale=settings.scale)


def _run(settings: VitalSettings, trials: Trials, key: TrialKey) -> None:
    robot, path = load_robot(_robot(settings, key.world)), PATHS[key.world]
    world = _world(settings, path)
    elevation = vital_map(world)
    trace = walk(Criteria(robot.geometry()), path, STRATEGIES[key.planner], elevation)
    steps = walk_steps(robot, world, path, trace.x, trace.pose, frames_at=_FRAMES)
    profile = elevation.heights[:, elevation.heights.shape[1] // 2]
    at = elevation.lower_corner[0] + elevation.resolution_m * (np.arange(len(profile)) + 0.5)
    trace.with_steps(steps, np.stack([at, profile])).save(trials.path(key))


def _robot(settings: VitalSettings, name: str) -> str:
    return settings.fast_robot if name == "stairs_075" else settings.robot


def walk_metrics(name: str, strategy: str, trace: Trace) -> dict[str, Metric]:
    """What a walk comes down to.

    ``min_safe``: safe footholds of the worst leg at the worst place; ``without_safe``: share of the way on which a leg
    has none; variations of the pose (equation 26); ``margin_error``: change of safe footholds over the margin (27);
    ``collisions``, ``workspace_violations``, ``blind``: shares of the steps, with Wilson intervals;
    ``joint_excess_rad``: the farthest that a joint was beyond its limits.
    """
    worst, n = trace.safe.min(axis=1), len(trace.x)
    step = np.diff(trace.pose, axis=0) / np.diff(trace.x)[:, None]
    error = np.abs(trace.around[..., 1] - trace.around[..., 0])
    key = f"{name}.{strategy}"
    shares = {"collisions": trace.collided, "workspace_violations": trace.violated, "blind": trace.blind}
    return {
        f"{key}.min_safe": metric(worst.min(), None, n, "1"),
        f"{key}.mean_safe": metric(trace.safe.mean(), None, n, "1"),
        f"{key}.without_safe": metric((worst == 0).mean(), None, n, "1"),
        f"{key}.height_variation": metric(np.abs(step[:, 0]).mean(), None, n, "1"),
        f"{key}.pitch_variation_rad_m": metric(np.abs(step[:, 2]).mean(), None, n, "rad/m"),
        f"{key}.margin_error": metric(error.mean(), None, n, "1"),
        f"{key}.joint_excess_rad": metric(trace.excess, None, trace.steps, "rad"),
        **{f"{key}.{what}": share(count, trace.steps) for what, count in shares.items()},
    }


def walk(criteria: Criteria, path: TrunkPath, settings: PoseSettings | None, elevation: HeightMap) -> Trace:
    """Move the trunk along a path; ``settings`` None: with the baseline."""
    robot, gait = criteria.robot, path.gait
    planner = None if settings is None else PosePlanner(criteria, settings)
    selector = FootholdSelector(criteria)
    places = np.arange(path.begin, path.end, STEP_M)
    previous, counts = None, []
    poses: list[Array] = []
    # TBR keeps the choice of the last foothold that was found.
    feet = robot.stance + np.array([path.begin, 0.0, robot.standing_height])
    for x in places:
        yaw, twist = path.yaw(float(x)), path.twist(float(x))
        base = np.array([x, 0.0])
        if planner is not None:
            plan = planner.plan(
                elevation, base_position=(float(x), 0.0), yaw=yaw, base_twist=twist, gait=gait,
                previous=previous, travelled_m=STEP_M,
            )  # fmt: skip
            previous = plan.poses[0]
            pose = np.array([previous.height, previous.roll, previous.pitch])
        else:
            last = poses[-1] if poses else np.array([robot.standing_height, 0.0, 0.0])
            pose = _baseline(selector, elevation, base, yaw, twist, gait, last, feet)
        poses.append(pose)
        counts.append(_counts(criteria, elevation, base, yaw, twist, gait, pose, PoseSettings().margin_m))
    every = np.array(counts)
    return Trace(places, np.array(poses), every[..., 1], every[..., [0, 2]])


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
    robot = selector.criteria.robot
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
    wanted = terrain_pose(feet, yaw=yaw, height=robot.standing_height)
    return PoseSettings().limited(wanted, before=last, travelled_m=STEP_M)


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
    height, roll, pitch = pose.tolist()
    out = []
    for leg, hip in enumerate(place(criteria.robot.hips, roll, pitch, yaw, (*base, height))):
        heights = extract_heightmap(elevation, hip[:2], yaw=yaw)
        below = Tuple(heights, leg=leg, base_twist=twist, gait=gait, roll=roll, pitch=pitch)
        out.append(criteria.counts(below, hip[2] + np.array([-margin, 0.0, margin])))
    return np.array(out)
