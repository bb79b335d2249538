"""One trial of a suite: a planner walks a world once, from a start of its own."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from legtool.configs.courses import Course
from legtool.configs.motion import TransitionSettings
from legtool.configs.planner import PlannerEvalSettings
from legtool.configs.worlds import WorldSettings
from legtool.datasets.logs.recording import Recording
from legtool.datasets.motion.samples import motion_data
from legtool.datasets.motion.transitions import cut_transitions
from legtool.evaluation.suites.suite_robot import SuiteRobot
from legtool.models.motion import predict_frozen
from legtool.sim.controllers.blackbox import make_controller
from legtool.sim.controllers.controller import Controller
from legtool.sim.controllers.tracked import TrackedController
from legtool.sim.controllers.trot.gait import GRAVITY
from legtool.sim.robots.robot import SimRobot
from legtool.sim.walks.environment import Subscriber, WalkPlanner
from legtool.sim.walks.film import Film
from legtool.sim.walks.loop import run_trial
from legtool.sim.walks.missteps import LOADED, Missteps
from legtool.sim.walks.planners import GOAL_BEYOND_M, BlindPlanner, PlanHistory, VelocityPlanner
from legtool.sim.walks.recorder import Recorder
from legtool.sim.walks.scripted import Push, ScriptedPlanner, Tracking
from legtool.sim.walks.simulated import Eyes, SimulatedRobot, Until
from legtool.sim.walks.watchdog import Watchdog
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.mujoco_world import world_spec
from legtool.sim.worlds.world import World
from legtool_runtime import Bundle, terrain
from legtool_runtime.motion.features import TARGETS, as_on_level_ground
from legtool_runtime.motion.planning.pilot import Pilot
from legtool_runtime.motion.planning.plan import Goal, forward_commands, planar_commands
from legtool_runtime.motion.planning.planner import Planner
from legtool_runtime.motion.tracker import StepTracker
from legtool_runtime.rotations import rotation_of

Array = NDArray[np.float64]

BLIND, SCRIPTED = "blind", "scripted"
#: A foot whose load falls below this share of the robot's weight has lifted off.
_UNLOADED = 0.03
#: A controller or planner that takes longer than this for one tick, of real time, loses its trial [s].
_ANSWER_S = 30.0
ACTIONS: dict[str, Callable[[], Array]] = {
    "forward": forward_commands,
    "reversing": functools.partial(planar_commands, [round(0.1 * i, 1) for i in range(-3, 11)], [0.0], [0.0]),
    "planar": planar_commands,
}


@dataclass(eq=False)
class Walked:
    """A trial that is over.

    Attributes:
        world: where.
        robot: who.
        outcome: ``goal``, or why it ended before: ``fell``, ``stalled``, ``timeout``, or an error's text.
        missteps: when [s], where (x, y) [m], and which leg.
        history: of a planner of velocity commands.
        recording: what the robot measured, with joint positions and velocities (n, 4, 3) at its rows.
        film: of the first trials.
        tracking: of a walk by script.
        duration_s: simulated.
        elapsed_s: of real time.
    """

    world: World
    robot: SimRobot
    outcome: str
    missteps: list[tuple[float, float, float, int]]
    history: PlanHistory
    recording: Recording
    joint_positions: Array
    joint_velocities: Array
    film: Film | None
    tracking: Tracking | None
    duration_s: float
    elapsed_s: float

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
    where: WorldSettings | Course,
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
        where: the world, or a course, of which each trial draws its own.
        settings: of the suite.
        row: ``blind``, ``scripted``, or the velocity planner at a horizon, ``h5``.
        number: of the trial; all planners begin a trial of one number alike.
        name: of the recording.
    """
    rng = np.random.default_rng([settings.seed, number])
    spread = (settings.start_x, settings.start_y, settings.start_heading)
    x, y, heading = (0.0 if row == SCRIPTED else float(rng.uniform(-most, most)) for most in spread)
    world = build_world(world_of(where, who, settings, number), robot=who.name)
    robot = who.build(world_spec(world))
    sighted = row not in (BLIND, SCRIPTED)
    eyes = Eyes(who.camera, settings.elevation if settings.map == "truth" else None) if sighted else None
    planner: WalkPlanner
    controller: Controller | TrackedController
    if row == SCRIPTED:
        assert isinstance(where, Course)
        force_noise = 0.0 if settings.noise is None else settings.noise.foot_force
        controller = TrackedController(robot, replace(settings.tracker, force_noise=min(force_noise, 0.05)))
        controller.warm_up()
        planner = ScriptedPlanner(where, world, controller.robot, rng)
        disturb(robot, rng, settings.mass_error)
    else:
        controller = blind = make_controller(robot, settings.black_box)
        planner = BlindPlanner(settings.blind_speed)
        if sighted:
            assert bundle is not None
            planner = _velocity_planner(bundle, settings, row, robot, blind, world)
    environment = SimulatedRobot(
        world, robot, controller, rng=rng, noise=settings.noise, eyes=eyes, start=(x, y, heading),
        until=Until(settings.timeout_s), delay_s=settings.delay_s if row == SCRIPTED else 0.0,
    )  # fmt: skip
    recorder = Recorder(environment, ticks=environment.ticks)
    missteps = Missteps(environment)
    film = Film(environment, missteps, planner) if number < settings.films else None
    tracking = Tracking(environment, controller) if isinstance(controller, TrackedController) else None
    subscribers: list[Subscriber] = [recorder, missteps, *([film] if film else []), *([tracking] if tracking else [])]
    if settings.push_speed > 0.0 and isinstance(planner, ScriptedPlanner):
        subscribers.append(Push(environment, planner, settings.push_speed, rng))
    began = time.perf_counter()
    outcome = run_trial(environment, planner, [*subscribers, Watchdog(_ANSWER_S)])
    log = recorder.log
    return Walked(
        world, robot, outcome, missteps.found, getattr(planner, "history", PlanHistory()), log.recording(robot, name),
        log.joint_positions, log.joint_velocities, film, tracking, environment.time_s, time.perf_counter() - began,
    )  # fmt: skip


def world_of(
    where: WorldSettings | Course, who: SuiteRobot, settings: PlannerEvalSettings, number: int
) -> WorldSettings:
    """The world of a trial; that of a course is drawn, for all planners alike."""
    if isinstance(where, WorldSettings):
        return where
    return where.world(who.geometry, np.random.default_rng([settings.seed, number, 1]))


def motion_planner(bundle: Bundle, settings: PlannerEvalSettings, row: str) -> Planner:
    """The planner of a row ``h5``. No clock cuts its searches short: a trial must not depend on the machine's load.

    Raises:
        BundleError: the bundle has no motion line.
        StateError: its models were learned from states of another instant.
    """
    planning = replace(settings.planner, horizon=int(row.removeprefix("h")), deadline_s=None)
    return Planner(bundle.motion, bundle.robot, commands=ACTIONS[settings.actions](), settings=planning)


def _velocity_planner(
    bundle: Bundle, settings: PlannerEvalSettings, row: str, robot: SimRobot, controller: Controller, world: World
) -> VelocityPlanner:
    planner = motion_planner(bundle, settings, row)
    planner.warm_up()
    terrain.warm_up()
    weight = robot.mass * GRAVITY
    tracker = StepTracker(
        contact_on=LOADED * weight,
        contact_off=_UNLOADED * weight,
        first_pair=1 - getattr(controller, "swing_pair", 1),
    )
    way = world.goal - world.start[:2]
    beyond = world.goal + GOAL_BEYOND_M * way / max(float(np.hypot(*way)), 1e-9)
    goal = Goal(float(beyond[0]), float(beyond[1]))
    return VelocityPlanner(
        Pilot(planner, cruise_speed=settings.cruise_speed), tracker, robot.geometry,
        goal=goal, elevation=settings.elevation, costmap=settings.costmap,
    )  # fmt: skip


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
    return {
        **tracked,
        "outcome": walked.outcome,
        "success": walked.success,
        "clean": walked.clean,
        "missteps": walked.missteps,
        "duration_s": walked.duration_s,
        "real_time_factor": walked.duration_s / walked.elapsed_s,
        "planning_times_s": [round(value, 9) for value in history.planning_times_s],
        # Table II: the cost of the first executed node, summed over the re-plans.
        "cumulative_cost": float(sum(plan.cost[0] for plan in history.executed if len(plan.cost))),
        "errors": {} if bundle is None or len(walked.recording) < 2 else _model_errors(bundle, walked.recording),
    }


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
    rotation = np.stack([rotation_of(quaternion) for quaternion in recording.orientation])
    feet, level = as_on_level_ground(recording.feet_base, rotation)
    yaw = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
    heading = np.stack([np.cos(yaw / 2), 0 * yaw, 0 * yaw, np.sin(yaw / 2)], axis=1)
    changed = (level != rotation).any(axis=(1, 2))
    return replace(recording, feet_base=feet, orientation=np.where(changed[:, None], heading, recording.orientation))
