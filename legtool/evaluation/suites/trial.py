"""One trial of a suite: a planner walks a world once, from a start of its own."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from legtool.configs.camera import DepthCamera
from legtool.configs.climbs import Climb
from legtool.configs.families import Family
from legtool.configs.motion import TransitionSettings
from legtool.configs.planner import PlannerEvalSettings
from legtool.configs.rows import is_class
from legtool.configs.sweep import CONTROL_RATE_HZ
from legtool.datasets.logs.mcap_writer import Message, NamedColumns, PlanColumns
from legtool.datasets.logs.recording import Recording
from legtool.datasets.motion.level import as_on_level
from legtool.datasets.motion.samples import motion_data
from legtool.datasets.motion.transitions import cut_transitions
from legtool.evaluation.suites.suite_robot import SuiteRobot
from legtool.evaluation.suites.walkers import SCRIPTED, Place, Walker, make_walker, world_settings
from legtool.models.motion import predict_frozen
from legtool.sim.controllers.controller import AnyController, takes
from legtool.sim.controllers.tracked import GuidedController, TrackedController
from legtool.sim.robots.robot import SimRobot
from legtool.sim.sensors.depth_camera import side_cameras
from legtool.sim.walks.contacts import LinkContacts
from legtool.sim.walks.effort import Effort
from legtool.sim.walks.environment import Observation, Subscriber, WalkPlanner
from legtool.sim.walks.film import Film
from legtool.sim.walks.guide import progress
from legtool.sim.walks.loop import run_trial
from legtool.sim.walks.missteps import Missteps
from legtool.sim.walks.pips import PipsPlanner, PlannedFrame
from legtool.sim.walks.planners import PlanHistory, VelocityPlanner
from legtool.sim.walks.postures import Moment, Postures
from legtool.sim.walks.recorder import PlanRecorder, Recorder
from legtool.sim.walks.scene import NOTHING, CameraRecorder, SceneRecorder
from legtool.sim.walks.scripted import Push, ScriptedPlanner, Tracking
from legtool.sim.walks.simulated import Eyes, SimulatedRobot, Until
from legtool.sim.walks.simulation import TICK_NS
from legtool.sim.walks.stages import StageLog
from legtool.sim.walks.vital import VitalPlanner
from legtool.sim.walks.watchdog import Watchdog
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.mujoco_world import world_spec
from legtool.sim.worlds.world import World
from legtool_runtime import Bundle
from legtool_runtime.foothold import Criteria
from legtool_runtime.motion.features import TARGETS

Array = NDArray[np.float64]

#: A controller or planner that takes longer than this for one tick, of real time, loses its trial [s].
_ANSWER_S = 30.0
#: True regions are handed out as far as this from the robot [m].
REGIONS_M = 2.0
#: A walk that ended so soon after an event was lost by the stage that the event speaks against [s].
CAUSED_S = 3.0
#: Progress is noted about this often [s].
PROGRESS_S = 0.5


@dataclass(eq=False)
class Walked:
    """A trial that is over.

    Attributes:
        world: where.
        robot: who.
        outcome: ``goal``, or why it ended before: ``fell``, ``stalled``, ``timeout``, or an error's text.
        missteps: when [s], where (x, y) [m], and which leg.
        edges: the same of feet that came to stand within a centimetre of an edge.
        history: of a planner of velocity commands, or the times that poses took.
        recording: what the robot measured, with joint positions and velocities (n, 4, 3) at its rows.
        plan: what a tracking controller was to do, at the same rows.
        film: of the first trials.
        tracking: of a walk whose feet are planned.
        contacts: of links and swinging feet with the terrain.
        postures: of the trunk, where its poses are planned.
        blind_steps: for which no foothold was safe, and all that were chosen.
        stages: of a planner that works in stages.
        progress: rows (time [s], share of the way covered so far) of a walk through a world of a family.
        frames: of a planner on regions.
        beside: what its monitor was told and said, at the recording's rows.
        effort: of the joints, and the way.
        duration_s: simulated.
        elapsed_s: of real time.
        messages: what was seen, known and planned, of a walk that is recorded.
        every_tick: recording, joint positions and velocities of all ticks, where images are recorded.
        replay: what a replay needs to plan the same again.
    """

    world: World
    robot: SimRobot
    outcome: str
    missteps: list[tuple[float, float, float, int]]
    edges: list[tuple[float, float, float, int]]
    history: PlanHistory
    recording: Recording
    joint_positions: Array
    joint_velocities: Array
    plan: PlanColumns | None
    film: Film | None
    tracking: Tracking | None
    contacts: LinkContacts
    postures: tuple[Moment, ...]
    blind_steps: tuple[int, int]
    stages: StageLog | None
    progress: Array
    frames: tuple[PlannedFrame, ...]
    beside: tuple[NamedColumns, ...]
    effort: Effort
    duration_s: float
    elapsed_s: float
    messages: tuple[Message, ...] = ()
    every_tick: tuple[Recording, Array, Array] | None = None
    replay: dict[str, Any] | None = None

    @property
    def success(self) -> bool:
        """Whether the goal was reached."""
        return self.outcome == "goal"

    @property
    def clean(self) -> bool:
        """Whether it was reached without a misstep."""
        return self.success and not self.missteps


def walk_trial(
    bundle: Bundle | None,
    who: SuiteRobot,
    where: Place,
    settings: PlannerEvalSettings,
    row: str,
    number: int,
    *,
    name: str,
) -> Walked:
    """Walk once: the same trial for the same arguments, however fast the machine is.

    Args:
        bundle: that the velocity planner plans with.
        who: walks.
        where: the world, or what each trial draws its own from.
        settings: of the suite.
        row: see :func:`.make_walker`.
        number: of the trial; all planners begin a trial of one number alike.
        name: of the recording.
    """
    rng = np.random.default_rng([settings.seed, number])
    spread = _spread(where, settings)
    x, y, heading = (0.0 if row == SCRIPTED else float(rng.uniform(-most, most)) for most in spread)
    world = build_world(world_settings(where, who, settings, number), robot=who.name)
    robot = who.build(world_spec(world))
    walker = make_walker(
        row, robot, world, where=where, number=number, settings=settings, bundle=bundle, rng=rng,
        sight=sight_of(who, where, settings),
    )  # fmt: skip
    planner, controller = walker.planner, walker.controller
    eyes = _eyes(who, where, settings, walker, None if is_class(row) else bundle)
    if row == SCRIPTED:
        disturb(robot, rng, settings.mass_error)
    environment = SimulatedRobot(
        world, robot, controller, rng=rng, noise=settings.noise, eyes=eyes, start=(x, y, heading + walker.heading),
        until=Until(max(settings.timeout_s, walker.most_s), at_goal=walker.at_goal),
        delay_s=settings.delay_s if takes(controller) != "velocity commands" else 0.0,
    )  # fmt: skip
    recorder = Recorder(environment, ticks=environment.ticks)
    missteps = Missteps(environment)
    film = Film(environment, missteps, planner) if number < settings.films else None
    contacts, effort = LinkContacts(environment, controller), Effort(environment)
    tracking = postures = planned = None
    if isinstance(controller, (TrackedController, GuidedController)):
        tracking, planned = Tracking(environment, controller), PlanRecorder(environment, controller)
    if isinstance(planner, VitalPlanner) and isinstance(controller, GuidedController):
        postures = Postures(environment, controller, planner, Criteria(robot.geometry))
    scenes = SceneRecorder(lambda: getattr(planner, "known", NOTHING), _stamp) if number < settings.records else None
    camera = ticks = None
    if scenes is not None and settings.record_images:
        camera, ticks = CameraRecorder(_stamp), Recorder(environment, ticks=environment.ticks, every=1)
    lookers: list[Subscriber | None] = [
        recorder,
        planned,
        missteps,
        contacts,
        effort,
        film,
        tracking,
        postures,
        scenes,
        camera,
        ticks,
    ]
    subscribers = [looker for looker in lookers if looker is not None]
    if settings.push_speed > 0.0 and isinstance(planner, (ScriptedPlanner, PipsPlanner)):
        subscribers.append(Push(environment, planner.share, settings.push_speed, rng))
    environment.warm_up()
    began = time.perf_counter()
    outcome = run_trial(environment, planner, [*subscribers, Watchdog(_ANSWER_S)])
    log = recorder.log
    return Walked(
        world, robot, outcome, missteps.found, missteps.edges, _history(planner), log.recording(robot, name),
        log.joint_positions, log.joint_velocities, None if planned is None else planned.columns(),
        film, tracking, contacts,
        () if postures is None else tuple(postures.moments), _blind_steps(controller),
        getattr(planner, "stages", None), _progress(world, log.recording(robot, name), where),
        tuple(getattr(planner, "frames", ())), planner.monitor.columns() if isinstance(planner, PipsPlanner) else (),
        effort, environment.time_s, time.perf_counter() - began,
        (*(() if scenes is None else scenes.messages), *(() if camera is None else camera.messages)),
        None if ticks is None else _every_tick(ticks, robot, name),
        _replay(planner, settings, None if camera is None else camera.mount),
    )  # fmt: skip


def _stamp(observation: Observation) -> int:
    """Time of logging of an observation [ns]: recordings of simulated walks begin at 0."""
    return round(observation.time_s * CONTROL_RATE_HZ) * TICK_NS


def _every_tick(recorder: Recorder, robot: SimRobot, name: str) -> tuple[Recording, Array, Array]:
    log = recorder.log
    return log.recording(robot, name), log.joint_positions, log.joint_velocities


def _replay(planner: WalkPlanner, settings: PlannerEvalSettings, mount: Array | None) -> dict[str, Any] | None:
    """What ``legtool replay`` needs beside the recording to plan the same."""
    if not isinstance(planner, VelocityPlanner) or planner.goal is None:
        return None
    planned = settings.to_dict()
    return {
        **{name: planned[name] for name in ("actions", "cruise_speed", "planner", "elevation", "costmap")},
        "goal": [planner.goal.x, planner.goal.y],
        "horizon": planner.horizon,
        **planner.tracker.thresholds,
        **({} if mount is None else {"mount": mount.tolist()}),
    }


def _spread(where: Place, settings: PlannerEvalSettings) -> tuple[float, float, float]:
    """Largest offsets of the start: the suite's, and no more than a family's own."""
    spread = (settings.start_x, settings.start_y, settings.start_heading)
    if not isinstance(where, Family):
        return spread
    x, y, heading = (min(pair) for pair in zip(spread, where.start, strict=True))
    return x, y, heading


def sight_of(who: SuiteRobot, where: Place, settings: PlannerEvalSettings) -> float | None:
    """Half of the horizontal view of a robot whose only camera looks ahead [rad]."""
    if settings.regions == "truth" or (isinstance(where, Family) and where.side_cameras):
        return None
    return 0.5 * who.camera.horizontal_view


def camera_of(who: SuiteRobot, where: Place, settings: PlannerEvalSettings) -> DepthCamera:
    """The robot's camera, as it is mounted in an experiment, unless the suite gives another one."""
    pitch = where.camera_pitch if isinstance(where, Family) and settings.camera is None else None
    return who.camera if pitch is None else who.camera.replace(pitch=pitch)


def _eyes(
    who: SuiteRobot, where: Place, settings: PlannerEvalSettings, walker: Walker, bundle: Bundle | None
) -> Eyes | None:
    """What the walker is given of the terrain.

    With true regions go true heights. Images that regions are found in have true labels, unless the bundle finds them.
    """
    if not walker.sees:
        return None
    given = settings.map == "truth" or (isinstance(where, Climb) and where.surveyed)
    heights = settings.elevation if given else None
    camera = camera_of(who, where, settings)
    beside = side_cameras(camera) if isinstance(where, Family) and where.side_cameras else ()
    if not walker.on_regions:
        return Eyes(camera, heights, beside=beside)
    if settings.regions == "truth":
        return Eyes(camera, settings.elevation, regions_m=REGIONS_M)
    finds = bundle is not None and "steppability" in bundle.lines
    return Eyes(camera, heights, images=True, labelled_m=None if finds else who.swing_height_max, beside=beside)


def _progress(world: World, recording: Recording, where: Place) -> Array:
    """(n, 2) time [s] and share of the way that was covered by then, about every half a second and at the end."""
    if not isinstance(where, Family) or not len(recording):
        return np.empty((0, 2))
    times = 1e-9 * (recording.stamps_ns - recording.stamps_ns[0])
    shares = progress(world, recording.position_world)
    every = max(1, round(PROGRESS_S / max(float(times[-1]) / max(len(times) - 1, 1), 1e-9)))
    rows = np.unique(np.append(np.arange(0, len(times), every), len(times) - 1))
    return np.column_stack([times[rows], shares[rows]])


def _history(planner: WalkPlanner) -> PlanHistory:
    if isinstance(planner, VitalPlanner):
        return PlanHistory(planning_times_s=planner.planning_times_s)
    found: PlanHistory = getattr(planner, "history", PlanHistory())
    return found


def _blind_steps(controller: AnyController) -> tuple[int, int]:
    if not isinstance(controller, GuidedController):
        return 0, 0
    chosen = [one.choice.by for one in controller.gait.chosen if one.phase == 0.0]
    return sum(by != "safe" for by in chosen), len(chosen)


def disturb(robot: SimRobot, rng: np.random.Generator, share: float) -> None:
    """Change the mass and inertia of every body by a share drawn with this standard deviation."""
    if share == 0.0:
        return
    factors = np.clip(1.0 + share * rng.standard_normal(robot.model.nbody), 0.5, 1.5)
    robot.model.body_mass *= factors
    robot.model.body_inertia *= factors[:, None]


def record_of(walked: Walked, bundle: Bundle | None) -> dict[str, Any]:
    """What is kept of a trial: plain JSON types."""
    history, tracking = walked.history, walked.tracking
    tracked = {} if tracking is None else {
        "landings": [(round(when, 4), leg, round(error, 6)) for when, leg, error in tracking.landings],
        "saturated": tracking.saturated,
    }  # fmt: skip
    posed = {} if not walked.postures else {
        "postures": [_rounded(moment) for moment in walked.postures],
        "blind_steps": walked.blind_steps,
    }  # fmt: skip
    return {
        **tracked,
        **posed,
        **_staged(walked),
        "link_contacts": [(round(when, 3), body) for when, body in walked.contacts.found],
        "ankle_contacts": [(round(when, 3), body) for when, body in walked.contacts.ankles],
        "foot_hits": [(round(when, 3), leg) for when, leg in walked.contacts.hits],
        "outcome": walked.outcome,
        "success": walked.success,
        "clean": walked.clean,
        "missteps": walked.missteps,
        "edges": walked.edges,
        "duration_s": walked.duration_s,
        "cost_of_transport": walked.effort.cost_of_transport,
        "work_j": round(walked.effort.work_j, 3),
        "way_m": round(walked.effort.way_m, 4),
        "real_time_factor": walked.duration_s / walked.elapsed_s,
        "planning_times_s": [round(value, 9) for value in history.planning_times_s],
        # Table II: the cost of the first executed node, summed over the re-plans.
        "cumulative_cost": float(sum(plan.cost[0] for plan in history.executed if len(plan.cost))),
        "errors": _model_errors(bundle, walked.recording),
    }


def _staged(walked: Walked) -> dict[str, Any]:
    """Progress through a world of a family, and what a planner in stages noted."""
    out: dict[str, Any] = {}
    if len(walked.progress):
        out["progress"] = [(round(when, 2), round(share, 4)) for when, share in walked.progress.tolist()]
    if walked.stages is not None:
        out["stages"] = {
            "times_s": {stage: [round(t, 6) for t in times] for stage, times in walked.stages.times_s.items()},
            "counts": walked.stages.counts,
            "blocked_by": walked.stages.blocked_by,
            "reason": walked.stages.reason,
            "told": [(round(when, 3), event) for when, event, _ in walked.stages.told],
            "cause": walked.stages.cause(walked.duration_s - CAUSED_S),
        }
    return out


def _rounded(moment: Moment) -> list[Any]:
    """Time, place, attitude, planned and filtered pose, safe footholds, and whether the ground is uneven."""
    parts = (moment.place, moment.attitude, moment.planned, moment.filtered)
    return [
        round(moment.time_s, 3),
        *(np.round(part, 5).tolist() for part in parts),
        moment.safe,
        moment.climbs,
    ]


def _model_errors(bundle: Bundle | None, recording: Recording) -> dict[str, list[float]]:
    """Absolute errors of each model over the steps, x and y pooled, as in Table II; none without a motion line."""
    if bundle is None or "motion" not in bundle.lines or len(recording) < 2:
        return {}
    table, _ = cut_transitions([as_on_level(recording)], TransitionSettings(instant=bundle.motion.instant))
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
