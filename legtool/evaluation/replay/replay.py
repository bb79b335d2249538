"""A log in the environment's place: the runtime maps, predicts and plans as on the robot, and commands nothing."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from legtool.configs.log import LogSettings
from legtool.configs.motion import TransitionSettings
from legtool.configs.replay import ReplaySettings
from legtool.configs.robots import RobotGeometry, load_geometry
from legtool.configs.topics import TopicSettings, load_topics
from legtool.datasets.contents import files_content
from legtool.datasets.logs import scene_messages as scene
from legtool.datasets.logs.depth import DepthLog, metadata_of
from legtool.datasets.logs.formats import kind_of
from legtool.datasets.logs.log import LogReader
from legtool.datasets.logs.mcap_writer import Message, write_mcap
from legtool.datasets.logs.recording import Recording, concatenate
from legtool.datasets.motion.from_log import cut_filled
from legtool.datasets.motion.level import as_on_level
from legtool.datasets.motion.transitions import cut_transitions
from legtool.datasets.work import RESULTS, claim, digest
from legtool.errors import LogError, RobotError
from legtool.evaluation.replay.predictions import Ahead, one_step, several_steps
from legtool.evaluation.replay.report import write_replay_report
from legtool.evaluation.replay.scores import Replayed, measure
from legtool.evaluation.report.results import provenance, write_results
from legtool.evaluation.suites.planner import RECORDED
from legtool.evaluation.suites.walkers import ACTIONS
from legtool.sim.walks.loop import run
from legtool.sim.walks.planners import VelocityPlanner
from legtool.sim.walks.recorded import OFF, ON, RecordedRobot
from legtool.sim.walks.region_finder import RegionFinder
from legtool.sim.walks.replayed import ReplayPlanner, TimedLabels, Touchdown, Watcher
from legtool.sim.walks.scene import FEET, SceneRecorder
from legtool_runtime import Bundle, Robot, load_bundle, terrain
from legtool_runtime.motion.planning.pilot import Pilot
from legtool_runtime.motion.planning.plan import Goal
from legtool_runtime.motion.planning.planner import Planner
from legtool_runtime.motion.tracker import StepTracker
from legtool_runtime.perception import chain as perception
from legtool_runtime.perception.chain import PerceptionSettings

RECORDING, REPORT = "replay.mcap", "report.html"
#: Hips this far apart are two robots' [m].
_ANOTHER_ROBOT_M = 0.03
#: Footsteps that are shown at once.
_SHOWN = 12


class Given(NamedTuple):
    """A log that is to be replayed, and with what."""

    paths: tuple[Path, ...]
    topics: TopicSettings
    robot: RobotGeometry
    bundle: Bundle
    settings: ReplaySettings
    recorded: dict[str, Any]


def replay(paths: Sequence[Path], bundle_path: Path, settings: ReplaySettings, out: Path) -> Iterator[str]:
    """Replay a log, and write ``replay.mcap``, ``results.json`` and ``report.html``.

    Args:
        paths: one log, or bags of one run that complete each other.
        bundle_path: of the models; what it lacks is left out.
        settings: robot, topics, and what the planner takes besides.
        out: directory of the results.

    Yields:
        the main figures, line by line.

    Raises:
        BundleError: the bundle is damaged.
        LogError: the log is missing, damaged, contradicts itself, or lacks a signal.
        RobotError: the bundle was made for another robot.
        OutputError: ``out`` holds something else.
    """
    given = _given(paths, bundle_path, settings)
    log_settings = LogSettings(
        robot=settings.robot or given.bundle.robot.name, topics=settings.topics, msgs=settings.msgs
    )
    cut, notes = cut_filled(given.paths, given.topics, given.robot, log_settings, 0)
    reasons = [finding.text for finding in cut.findings if finding.level == "refuse" and not finding.unfilled]
    if reasons:
        raise LogError(f"{paths[0]}: {reasons[0]}")
    unfilled = {finding.signal: None for finding in cut.findings if finding.unfilled}
    given = given._replace(topics=given.topics.replace(**unfilled) if unfilled else given.topics)
    notes = [*notes, *(finding.text for finding in cut.findings if finding.level == "warn")]
    with claim(out, RESULTS):
        replayed, recording, messages = play(given)
        replayed.notes = notes
        metrics = measure(replayed, given.settings.deadline_s)
        origin = provenance(
            given.settings.to_dict(), seed=0, data_hash=digest([files_content(path) for path in paths]),
            robot=given.robot.name, data=[str(path) for path in paths], bundle=given.bundle.manifest["content_sha256"],
            counts=replayed.counts,
        )  # fmt: skip
        write_mcap(
            out / RECORDING, recording, frames=True, more=messages,
            metadata={"robot": given.robot.name, "log": paths[0].name, "bundle": str(bundle_path)},
        )  # fmt: skip
        write_results(out / RESULTS.marker, metrics, origin)
        write_replay_report(out / REPORT, metrics, replayed, recording, origin)
    yield from _told(replayed, given)


def play(given: Given) -> tuple[Replayed, Recording, list[Message]]:
    """Run the loop on a log, and compare predictions with what happened.

    Returns:
        what came of it, the log as one recording of sampled rows, and what was seen and planned as messages.
    """
    topics, robot, settings = given.topics, given.robot.geometry(), given.settings
    reader = LogReader(given.paths, topics, robot, messages=settings.msgs, joint_offset=given.robot.joint_offset)
    depth = _depth(given)
    environment = RecordedRobot(reader, robot, depth=depth, thresholds=settings.contact_on is None)
    planner = _planner(given, robot, depth is not None)
    scenes = SceneRecorder(lambda: planner.known, lambda observation: environment.stamp_ns)
    watcher = Watcher(planner, lambda: environment.parts[-1].command[environment.row])
    began = time.perf_counter()
    run(environment, planner, [scenes, watcher])
    elapsed = time.perf_counter() - began
    parts = environment.parts
    whole = concatenate(parts)
    replayed = Replayed(
        duration_s=float(whole.stamps_ns[-1] - whole.stamps_ns[0]) * 1e-9, elapsed_s=elapsed, images=planner.images,
        missed=environment.missed, regions=planner.regions, perception_s=planner.perception_s,
        labels_s=[] if planner.labels is None else planner.labels.times_s, touchdowns=watcher.touchdowns,
    )  # fmt: skip
    if planner.velocity is not None:
        replayed.answers = watcher.answers
        replayed.planning_s, replayed.map_s = planner.velocity.history.planning_times_s, planner.velocity.map_times_s
    messages = [*scenes.messages, *_frame(depth, int(whole.stamps_ns[0]))]
    if "motion" in given.bundle.lines:
        table, replayed.counts = _steps(given, parts, level=planner.velocity is not None)
        if replayed.counts.get("steps", 0):
            replayed.one = one_step(table, given.bundle.motion)
            replayed.ahead = several_steps(table, given.bundle.motion, robot, settings.horizon)
            messages += footsteps(replayed.ahead, watcher.touchdowns)
    sampled = concatenate([_sampled(part) for part in parts])
    return replayed, sampled, messages


def footsteps(ahead: Ahead, touchdowns: Sequence[Touchdown]) -> list[Message]:
    """The latest footsteps at each step: where models expected them, and where feet came down."""
    unsafe = np.array([one.place for one in touchdowns if one.said == "unsafe"]).reshape(-1, 3)
    out = []
    for n, stamp in enumerate(ahead.stamps_ns.tolist()):
        shown = slice(max(0, n + 1 - _SHOWN), n + 1)
        predicted, actual = ahead.predicted[shown].reshape(-1, 3), ahead.actual[shown].reshape(-1, 3)
        bad = np.array([len(unsafe) > 0 and bool((np.hypot(*(unsafe - p)[:, :2].T) < 0.01).any()) for p in actual])
        colours = np.where(bad[:, None], np.array(scene.RED), np.array(scene.BLUE))
        between = np.stack([predicted, actual], axis=1).reshape(-1, 3)
        shapes = [
            scene.Shape("predicted", scene.SPHERE_LIST, predicted, scene.GREEN, 0.03),
            scene.Shape("actual", scene.SPHERE_LIST, actual, colours, 0.04),
            scene.Shape("error", scene.LINE_LIST, between, scene.RED, 0.006),
        ]
        out.append(scene.markers(int(stamp), FEET, shapes))
    return out


def _given(paths: Sequence[Path], bundle_path: Path, settings: ReplaySettings) -> Given:
    if not paths:
        raise LogError("no log was given; name the log to replay")
    for path in paths:
        kind_of(path)  # refused before anything else is loaded
    bundle = load_bundle(bundle_path)
    recorded: dict[str, Any] = json.loads(metadata_of(paths[0]).get(RECORDED, "{}")) if len(paths) == 1 else {}
    robot = load_geometry(settings.robot or bundle.robot.name)
    if np.abs(robot.geometry().hips - bundle.robot.hips).max() > _ANOTHER_ROBOT_M:
        raise RobotError(f"{bundle_path}: made for another robot ({bundle.robot.name}) than {robot.name}; hips differ")
    topics = load_topics(settings.topics)
    if topics.csv is None and kind_of(paths[0]) == "csv":
        raise LogError(f"{paths[0]}: is a table, but topics {topics.name!r} are of a bag; choose a preset with columns")
    return Given(tuple(paths), topics, robot, bundle, settings.as_recorded(recorded), recorded)


def _depth(given: Given) -> DepthLog | None:
    """The log's depth images; None of a table, or of a log without them."""
    topics = given.topics
    if topics.depth is None or topics.csv is not None:
        return None
    if topics.depth.optional:
        from legtool.datasets.logs.bag import topics_in

        if topics.depth.topic not in topics_in(given.paths):
            return None
    depth = DepthLog(given.paths, topics)
    if "mount" in given.recorded:
        depth.transform_camera_to_base = np.array(given.recorded["mount"], dtype=np.float64)  # to the last bit
    return depth


def _planner(given: Given, robot: Robot, sees: bool) -> ReplayPlanner:
    """What the bundle has for this log."""
    bundle = given.bundle
    velocity: VelocityPlanner | None = None
    finder: RegionFinder | None = None
    labels: TimedLabels | None = None
    if sees and "motion" in bundle.lines:
        velocity = _velocity(given, robot)
    if sees and "steppability" in bundle.lines:
        perception.warm_up()
        labels = TimedLabels(bundle.steppability)
        finder = RegionFinder(robot, PerceptionSettings(), labels)
    return ReplayPlanner(velocity, finder, labels)


def _velocity(given: Given, robot: Robot) -> VelocityPlanner:
    settings, bundle = given.settings, given.bundle
    instant = bundle.motion.instant
    planning = settings.planner.__class__(**{**vars(settings.planner), "horizon": settings.horizon, "deadline_s": None})
    planner = Planner(
        bundle.motion, bundle.robot, commands=ACTIONS[settings.actions](), settings=planning, instant=instant
    )
    planner.warm_up()
    terrain.warm_up()
    on, off = (ON, OFF) if settings.contact_on is None else (settings.contact_on, settings.contact_off or OFF)
    tracker = StepTracker(contact_on=on, contact_off=off, first_pair=settings.first_pair, instant=instant)
    return VelocityPlanner(
        Pilot(planner, cruise_speed=settings.cruise_speed), tracker, robot,
        goal=None if settings.goal is None else Goal(*settings.goal),
        elevation=settings.elevation, costmap=settings.costmap,
    )  # fmt: skip


def _steps(given: Given, parts: Sequence[Recording], *, level: bool) -> tuple[pa.Table, dict[str, float]]:
    """The log's steps, at the instant of the bundle's models."""
    instant = given.bundle.motion.instant
    if given.topics.events and instant != "touchdown":
        raise LogError(
            f"{given.paths[0]}: its rows are touchdowns, and the bundle's models take states at {instant}; "
            "train models on a log of touchdowns"
        )
    chunks = [as_on_level(part) for part in parts] if level else parts
    return cut_transitions(chunks, TransitionSettings(instant=instant))


def _sampled(part: Recording) -> Recording:
    """A recording that viewers take: rows of touchdowns are rows like others there."""
    return dataclasses.replace(part, swing_pair=None)


def _frame(depth: DepthLog | None, stamp_ns: int) -> list[Message]:
    return [] if depth is None else [scene.fixed_frame(stamp_ns, depth.transform_camera_to_base)]


def _told(replayed: Replayed, given: Given) -> Iterator[str]:
    speed = replayed.duration_s / max(replayed.elapsed_s, 1e-9)
    seen = f" ({speed:.1f} times as fast), {replayed.images} depth images" if replayed.images else ", no depth images"
    yield (f"replayed {replayed.duration_s:.1f} s of {given.robot.name} in {replayed.elapsed_s:.1f} s{seen}")
    metrics = measure(replayed, given.settings.deadline_s)

    def line(name: str, label: str, factor: float, unit: str) -> str | None:
        if name not in metrics:
            return None
        one = metrics[name]
        interval = "" if one["ci95"] is None else " [{:.3g}, {:.3g}]".format(*(factor * end for end in one["ci95"]))
        return f"  {label}: {factor * one['value']:.3g}{interval} {unit}, n {one['n']}"

    last = given.settings.horizon
    rows = [
        ("fdm.mae", "footholds, one step ahead", 1e3, "mm"),
        ("cdm.mae", "CoM, one step ahead", 1e3, "mm"),
        ("cvm.mae", "velocity, one step ahead", 1.0, "m/s"),
        ("fdm.coverage90", "footholds within their 90 % intervals", 100.0, "%"),
        (f"ahead.{last}.touchdown.mae", f"footholds, {last} steps ahead", 1e3, "mm"),
        (f"ahead.{last}.touchdown.coverage90", f"footholds {last} steps ahead within theirs", 100.0, "%"),
        ("touchdowns.unsafe", "touchdowns on ground that the map calls unsafe", 100.0, "%"),
        ("plans.steps_planned", "steps with a whole plan", 100.0, "%"),
        ("plans.late", f"plans later than {1e3 * given.settings.deadline_s:g} ms", 100.0, "%"),
        ("plans.as_commanded", "ticks at which the plan is what was commanded", 100.0, "%"),
        ("labels.age.median_s", "age of labels, median", 1e3, "ms"),
    ]
    yield from (text for row in rows if (text := line(*row)) is not None)
    if replayed.answers is None:
        yield "  no plans: the log has no depth images that its topics name, or the bundle no motion line"
    yield from (f"  warning: {note}" for note in replayed.notes)
