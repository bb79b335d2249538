"""The planner in closed loop: courses walked blind and planned, and what came of it (motion paper, IV-B, Table II)."""

from __future__ import annotations

import functools
import hashlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from legtool.configs.courses import load_course
from legtool.configs.motion import TransitionSettings
from legtool.configs.planner import PlannerEvalSettings
from legtool.configs.robots import load_robot
from legtool.datasets.logs.mcap_writer import write_mcap
from legtool.datasets.logs.recording import Recording
from legtool.datasets.motion.samples import motion_data
from legtool.datasets.motion.transitions import cut_transitions
from legtool.datasets.provenance import commit
from legtool.datasets.store import claim_directory, read_json, write_json
from legtool.errors import OutputError, RobotError
from legtool.evaluation.report.results import Metric, metric, provenance, write_results
from legtool.evaluation.suites.planner_plots import course_view, filmstrip
from legtool.evaluation.suites.planner_report import write_planner_report
from legtool.models.motion import predict_frozen
from legtool.sim.controllers.blackbox import make_controller
from legtool.sim.robots.mjcf import find_mjcf, load_mjcf
from legtool.sim.robots.robot import SimRobot, build_robot
from legtool.sim.sensors.maps import CameraMap, TrueMap
from legtool.sim.walks.pilots import BlindPilot, PlannedPilot
from legtool.sim.walks.walk import Walk, walk_course
from legtool.sim.worlds.course import Course, build_course, course_world
from legtool.workers import run_all
from legtool_runtime import Bundle, load_bundle, terrain
from legtool_runtime.motion.features import TARGETS, as_on_level_ground
from legtool_runtime.motion.planning.planner import Planner, PlannerSettings, forward_commands, planar_commands
from legtool_runtime.rotations import quaternion_about_z, rotation_of, yaw_of
from legtool_runtime.terrain.elevation import ElevationSettings

Array = NDArray[np.float64]

SUITE, TRIALS, RECORDINGS = "suite.json", "trials", "recordings"
BLIND = "blind"
#: Hips this far apart are two robots' [m].
_ANOTHER_ROBOT_M = 0.03
ACTIONS: dict[str, Callable[[], Array]] = {
    "forward": forward_commands,
    "reversing": functools.partial(planar_commands, [round(0.1 * i, 1) for i in range(-3, 11)], [0.0], [0.0]),
    "planar": planar_commands,
}


def eval_planner(bundle_path: Path, settings: PlannerEvalSettings, out: Path, *, workers: int = 1) -> Iterator[str]:
    """Walk every course of a suite, blind and at each horizon, and write results.json and report.html.

    Trials that an earlier run of the same suite finished in ``out`` are kept.

    Args:
        bundle_path: with a motion line.
        settings: courses, trials, horizons, map, and the planner's margins.
        out: directory of the results.
        workers: processes; outcomes do not depend on it, planning times may.

    Yields:
        the table, line by line.

    Raises:
        BundleError: the bundle is damaged, or has no motion line.
        RobotError: it was made for another robot.
        OutputError: ``out`` holds something else, or another suite.
    """
    bundle = load_bundle(bundle_path)
    if bundle.robot.name != settings.robot and bundle.robot.name != load_robot(settings.robot).name:
        raise RobotError(f"{bundle_path}: made for {bundle.robot.name}, the suite walks {settings.robot}; set robot")
    pilots = [BLIND, *(f"h{horizon}" for horizon in settings.horizons)]
    courses = {name: build_course(load_course(name)) for name in settings.courses}
    # What cannot plan or walk is refused at once: models of another instant, a policy that is not as described.
    _make_planner(bundle, settings, settings.horizons[0])
    robot = _make_robot(next(iter(courses.values())), settings)
    if np.abs(robot.geometry.hips - bundle.robot.hips).max() > _ANOTHER_ROBOT_M:
        raise RobotError(
            f"{bundle_path}: made for another robot than {settings.mjcf or settings.robot}; their hips differ"
        )
    make_controller(robot, settings.black_box)
    digest = bundle_hash(bundle_path)
    _claim(out, {"settings": settings.to_dict(), "bundle": digest})
    trials = [
        (name, pilot, k)
        for k in range(settings.trials)  # a suite that is looked at half-way has as many trials of each kind
        for name in courses
        for pilot in pilots
        if not _trial_path(out, name, pilot, k).is_file()
    ]
    total = len(courses) * len(pilots) * settings.trials
    run = functools.partial(run_trial, out, bundle_path, settings)
    run_all(run, trials, workers=workers, description="walking", unit="trials", done=total - len(trials))
    records = {  # a course that was named by its file or by its seed has a name of its own
        (course.settings.name, pilot): [read_json(_trial_path(out, name, pilot, k)) for k in range(settings.trials)]
        for name, course in courses.items()
        for pilot in pilots
    }
    metrics = {
        f"{name}.{pilot}.{key}": value
        for (name, pilot), found in records.items()
        for key, value in summarise(found).items()
    }
    origin = provenance(settings.to_dict(), seed=settings.seed, data_hash=digest, suite=settings.suite)
    write_results(out / "results.json", metrics, origin)
    drawings = {course.settings.name: _drawings(out, name, pilots) for name, course in courses.items()}
    write_planner_report(out / "report.html", metrics, records, drawings, origin)
    for (name, pilot), found in records.items():
        yield _line(name, pilot, found)


def run_trial(out: Path, bundle_path: Path, settings: PlannerEvalSettings, trial: tuple[str, str, int]) -> None:
    """Walk one trial and write its record, and for the first of each kind a recording and drawings."""
    name, pilot, k = trial
    bundle = load_bundle(bundle_path)
    course = build_course(load_course(name))
    began = time.perf_counter()
    walk, robot = _walk(bundle, course, settings, pilot, k)
    elapsed = time.perf_counter() - began
    recording = walk.log.recording(robot, f"{course.settings.name}.{pilot}.{k}")
    record = {
        "outcome": walk.outcome,
        "success": walk.success,
        "clean": walk.clean,
        "unclean": walk.unclean,
        "duration_s": walk.simulation.time_s,
        "real_time_factor": walk.simulation.time_s / elapsed,
        "planning_times_s": [round(value, 9) for value in walk.planning_times_s],
        # Table II: the cost of the first executed node, summed over the re-plans.
        "cumulative_cost": float(sum(plan.cost[0] for plan in walk.plans if len(plan.cost))),
        "errors": _model_errors(bundle, recording) if len(recording) > 1 else {},
    }
    if k == 0 and len(recording) > 1:
        stem = f"{course.settings.name}.{pilot}"
        (out / RECORDINGS).mkdir(exist_ok=True)
        write_mcap(
            out / RECORDINGS / f"{stem}.mcap",
            recording,
            joint_positions=walk.log.joint_positions,
            joint_velocities=walk.log.joint_velocities,
            frames=True,
            metadata={"robot": robot.geometry.name, "course": course.settings.name, "pilot": pilot},
        )
        for what, drawing in (
            ("course", course_view(course, walk, recording)),
            ("film", filmstrip(course, robot.geometry, recording, walk.log.joint_positions)),
        ):
            (out / TRIALS / f"{stem}.{what}.svg").write_text(drawing, encoding="utf-8")
    write_json(_trial_path(out, name, pilot, k), record)


def _walk(bundle: Bundle, course: Course, settings: PlannerEvalSettings, pilot: str, k: int) -> tuple[Walk, SimRobot]:
    # Blind and planned trials of one number begin alike.
    rng = np.random.default_rng([settings.seed, k])
    start = (
        float(rng.uniform(-settings.start_x, settings.start_x)),
        float(rng.uniform(-settings.start_y, settings.start_y)),
        float(rng.uniform(-settings.start_heading, settings.start_heading)),
    )
    robot = _make_robot(course, settings)
    controller = make_controller(robot, settings.black_box)
    if pilot == BLIND:
        walk = walk_course(
            course, robot, controller, BlindPilot(settings.blind_speed),
            noise=settings.noise, rng=rng, start=start, timeout_s=settings.timeout_s,
        )  # fmt: skip
        return walk, robot
    planner = _make_planner(bundle, settings, int(pilot.removeprefix("h")))
    planner.warm_up()
    terrain.warm_up()
    eyes: CameraMap | TrueMap
    if settings.map == "camera":
        width, height = settings.camera_size
        camera = load_robot(settings.robot).camera
        eyes = CameraMap(course, camera.replace(width=width, height=height), rng, ElevationSettings())
    else:
        eyes = TrueMap(course, ElevationSettings())
    walk = walk_course(
        course, robot, controller, PlannedPilot(planner, cruise_speed=settings.cruise_speed),
        eyes=eyes, noise=settings.noise, rng=rng, start=start, timeout_s=settings.timeout_s,
    )  # fmt: skip
    return walk, robot


def _make_robot(course: Course, settings: PlannerEvalSettings) -> SimRobot:
    world = course_world(course)
    if settings.mjcf is not None:
        return load_mjcf(find_mjcf(settings.mjcf), settings.mjcf_names, world)
    return build_robot(load_robot(settings.robot), world)


def _make_planner(bundle: Bundle, settings: PlannerEvalSettings, horizon: int) -> Planner:
    return Planner(
        bundle.motion,
        bundle.robot,
        commands=ACTIONS[settings.actions](),
        settings=PlannerSettings(
            horizon=horizon,
            deadline_s=settings.deadline_s,
            d_max_m=settings.d_max_m,
            margin_m=settings.margin_m,
            misstep_cost_m=settings.misstep_cost_m,
            steering_rad_s=settings.steering_rad_s,
        ),
    )


def _model_errors(bundle: Bundle, recording: Recording) -> dict[str, list[float]]:
    """Absolute errors of each model over the walk's steps, x and y pooled, as in Table II."""
    table, _ = cut_transitions([_as_planned(recording)], TransitionSettings(instant=bundle.motion.instant))
    steps = motion_data(table)
    if not len(steps):
        return {}
    errors = {}
    for model, targets in TARGETS.items():
        prefix = f"{model}."
        frozen: dict[str, Any] = {
            key.removeprefix(prefix): value for key, value in bundle.motion.parameters.items() if key.startswith(prefix)
        }
        frozen["degree"] = np.array(bundle.motion.degree)
        mean, _ = predict_frozen(frozen, steps.features)
        planar = [index for index, target in enumerate(targets) if target.split("_")[-1] in ("x", "y")]
        difference = np.abs(mean - steps.targets[model])[:, planar]
        errors[model] = np.round(difference.ravel(), 6).tolist()
    return errors


def _as_planned(recording: Recording) -> Recording:
    """The recording in the frames that the planner plans in: the horizontal one where the ground is uneven."""
    rotation = rotation_of(recording.orientation)
    feet, level = as_on_level_ground(recording.feet_base, rotation)
    heading = quaternion_about_z(yaw_of(rotation))
    changed = (level != rotation).any(axis=(1, 2))
    return replace(recording, feet_base=feet, orientation=np.where(changed[:, None], heading, recording.orientation))


def summarise(records: Sequence[dict[str, Any]]) -> dict[str, Metric]:
    """Metrics of the trials of one course and pilot: Wilson intervals for shares, quantiles' own for times."""
    n = len(records)
    out = {key: _share(sum(record[key] for record in records), n) for key in ("success", "clean")}
    out["duration_s"] = _mean([record["duration_s"] for record in records], "s")
    out["real_time_factor"] = _mean([record["real_time_factor"] for record in records], "1")
    for model in TARGETS:
        # A trial's mean is one sample: steps of one walk are not independent.
        means = [float(np.mean(record["errors"][model])) for record in records if record["errors"].get(model)]
        if means:
            out[f"{model}_mae"] = _mean(means, "m/s" if model == "cvm" else "m")
    times = np.concatenate([record["planning_times_s"] for record in records]) if records else np.zeros(0)
    if len(times):
        for key, quantile in (("median", 0.5), ("p95", 0.95), ("p99", 0.99), ("worst", 1.0)):
            out[f"planning_time_{key}_s"] = metric(float(np.quantile(times, quantile)), None, len(times), "s")
        out["cumulative_cost"] = _mean([record["cumulative_cost"] for record in records], "m")
    return out


def _share(successes: int, n: int) -> Metric:
    interval = binomtest(successes, n).proportion_ci(method="wilson")
    return metric(successes / n, (float(interval.low), float(interval.high)), n, "1")


def _mean(values: Sequence[float], unit: str) -> Metric:
    samples = np.asarray(values)
    if len(samples) < 2:
        return metric(float(samples.mean()), None, len(samples), unit)
    rng = np.random.default_rng(0)
    means = samples[rng.integers(len(samples), size=(2000, len(samples)))].mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return metric(float(samples.mean()), (float(low), float(high)), len(samples), unit)


def bundle_hash(path: Path) -> str:
    """SHA-256 of a bundle's manifest, which names every file by its hash."""
    return hashlib.sha256((path / "bundle.json").read_bytes()).hexdigest()


def _claim(out: Path, identity: dict[str, Any]) -> None:
    claim_directory(out, SUITE)
    if (out / SUITE).is_file():
        held = read_json(out / SUITE)
        if {key: held.get(key) for key in identity} != identity:
            raise OutputError(f"{out}: holds trials of another suite, bundle or settings; choose another --out")
    else:
        write_json(out / SUITE, {**identity, "commit": commit()})
    (out / TRIALS).mkdir(exist_ok=True)


def _trial_path(out: Path, course: str, pilot: str, k: int) -> Path:
    return out / TRIALS / f"{Path(course).stem.replace(':', '_')}.{pilot}.{k:04d}.json"


def _drawings(out: Path, course: str, pilots: Sequence[str]) -> dict[str, dict[str, str]]:
    stem = load_course(course).name
    return {
        pilot: {
            what: path.read_text(encoding="utf-8")
            for what in ("course", "film")
            if (path := out / TRIALS / f"{stem}.{pilot}.{what}.svg").is_file()
        }
        for pilot in pilots
    }


def _line(course: str, pilot: str, records: Sequence[dict[str, Any]]) -> str:
    n = len(records)
    reached, clean = (sum(record[key] for record in records) for key in ("success", "clean"))
    text = f"{course} {pilot}: success {reached}/{n}, clean {clean}/{n}"
    times = np.concatenate([record["planning_times_s"] for record in records])
    if len(times):
        median, p99 = np.quantile(times, [0.5, 0.99]) * 1e3
        text += f", planning median {median:.2f} ms, p99 {p99:.2f} ms"
    return text
