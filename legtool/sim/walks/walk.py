"""Closed loop: a robot walks a course, blind or planned, with the map from its own depth camera or from the truth."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from legtool.configs.sweep import CONTROL_RATE_HZ, Noise
from legtool.sim.controllers.controller import Controller
from legtool.sim.controllers.trot.gait import GRAVITY
from legtool.sim.robots.robot import SimRobot
from legtool.sim.sensors.maps import CAMERA_RATE_HZ, CameraMap, TrueMap
from legtool.sim.walks.simulation import TICK_S, Log, Simulation
from legtool.sim.walks.watchdog import Watchdog
from legtool.sim.worlds.course import Course
from legtool_runtime.errors import LegtoolError
from legtool_runtime.motion.planning.plan import Plan
from legtool_runtime.motion.tracker import StepTracker
from legtool_runtime.rotations import rotation_of, to_base
from legtool_runtime.terrain.costmap import FootCostmap, foot_costmap

Array = NDArray[np.float64]

#: Shares of the robot's weight above and below which a foot is, and is no longer, in contact.
CONTACT_ON, CONTACT_OFF = 0.08, 0.03
#: A foot that bears load for this long, this far off the floor below its centre, stands in a gap or on an edge;
#: a toe that brushes a riser on its way does not [m], [s].
CLEAN_HEIGHT_M = 0.025
CLEAN_S = 0.03
#: Ticks between plans while all feet stand: the last plan before lift-off is the one the controller takes up.
PLAN_EVERY = 2
#: Ticks between looks at the feet and the trunk.
CHECK_EVERY = 2
LOG_EVERY = 2
#: Steps between the plans that are kept for drawings.
SNAPSHOT_EVERY = 4


class Pilot(Protocol):
    """Chooses the velocity command."""

    def command(self, walk: Walk) -> Array:
        """(3,) vx, vy [m/s], yaw rate [rad/s] from now on; asked for whenever all feet stand."""


@dataclass
class Walk:
    """A walk under way, and what is left of it.

    Attributes:
        course: what is walked.
        simulation: the robot on it.
        tracker: follows its steps.
        log: what the robot measured.
        outcome: ``goal``, or why it ended before: ``fell``, ``stalled``, ``timeout``, or an error's text.
        unclean: when a foot began to stand in a gap or on an edge [s], and where: (x, y) world frame [m].
        plans: of a planned walk, the last one before each lift-off.
        planning_times_s: of every plan.
        plan: the latest, of a planned walk; ``costmap`` likewise.
        snapshots: (plan, costmap, position) of some of the plans, for drawings.
    """

    course: Course
    simulation: Simulation
    tracker: StepTracker
    log: Log
    outcome: str = ""
    unclean: list[tuple[float, float, float]] = field(default_factory=list)
    plans: list[Plan] = field(default_factory=list)
    planning_times_s: list[float] = field(default_factory=list)
    plan: Plan | None = None
    costmap: FootCostmap | None = None
    snapshots: list[tuple[Plan, FootCostmap, Array]] = field(default_factory=list)
    misplaced_s: Array = field(default_factory=lambda: np.zeros(4))

    @property
    def success(self) -> bool:
        """Whether the goal was reached."""
        return self.outcome == "goal"

    @property
    def clean(self) -> bool:
        """Whether it was reached and no foot ever stood in a gap or on an edge."""
        return self.success and not self.unclean


def walk_course(
    course: Course,
    robot: SimRobot,
    controller: Controller,
    pilot: Pilot,
    *,
    eyes: CameraMap | TrueMap | None = None,
    noise: Noise | None = None,
    rng: np.random.Generator,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    timeout_s: float = 60.0,
    stall_s: float = 30.0,
    answer_s: float = 30.0,
) -> Walk:
    """Walk a course once.

    Args:
        course: in whose world ``robot`` was built.
        robot: the robot in it.
        controller: makes it walk; whatever it throws ends the walk as a failure.
        pilot: chooses the commands, whenever all feet stand.
        eyes: makes the map for a planned walk; None for a blind one.
        noise: of the robot's estimate of its state.
        rng: of the noise.
        start: x, y [m] and heading [rad].
        timeout_s: the walk ends after this.
        stall_s: and when it makes no headway for this long.
        answer_s: or when a controller or a planner takes longer than this for one tick, of real time.
    """
    ticks = round(timeout_s * CONTROL_RATE_HZ)
    position = np.array([start[0], start[1], robot.geometry.standing_height])
    with Watchdog(answer_s) as watchdog:
        simulation = Simulation(robot, controller, ticks=ticks, noise=noise, rng=rng, position=position, yaw=start[2])
        weight = robot.mass * GRAVITY
        tracker = StepTracker(
            contact_on=CONTACT_ON * weight,
            contact_off=CONTACT_OFF * weight,
            first_pair=1 - getattr(controller, "swing_pair", 1),
        )
        walk = Walk(course, simulation, tracker, Log(ticks=ticks, every=LOG_EVERY))
        try:
            simulation.begin()
            walk.outcome = _run(walk, pilot, eyes, ticks, stall_s, watchdog)
        except LegtoolError as error:
            walk.outcome = f"error: {error}"
        except Exception as error:  # a black box may throw anything; its trial has failed, the suite goes on
            walk.outcome = f"error: {type(error).__name__}: {error}"
    return walk


def _run(
    walk: Walk, pilot: Pilot, eyes: CameraMap | TrueMap | None, ticks: int, stall_s: float, watchdog: Watchdog
) -> str:
    simulation, tracker, log = walk.simulation, walk.tracker, walk.log
    state = simulation.state
    geometry = simulation.robot.geometry
    look_every = round(CONTROL_RATE_HZ / CAMERA_RATE_HZ)
    command = np.zeros(3)
    steps = 0
    best, best_time = -np.inf, 0.0
    for tick in range(ticks):
        if tick:
            watchdog.feed()
        simulation.observe()
        if eyes is not None and tick % look_every == 0:
            walk.costmap = foot_costmap(eyes.look(simulation))
        velocity = to_base(state.orientation[None], state.velocity_world[None])[0]
        velocity[2] = state.angular_velocity_base[2]
        tracker.update(
            simulation.time_s,
            velocity=velocity,
            feet_base=geometry.feet(state.joint_positions),
            contact_force=state.foot_forces,
            reference=command,
        )
        if tracker.full_stance and tick % PLAN_EVERY == 0:
            command = pilot.command(walk)
        if tracker.steps > steps and walk.plan is not None:
            walk.plans.append(walk.plan)
            if walk.costmap is not None and len(walk.plans) % SNAPSHOT_EVERY == 1:
                walk.snapshots.append((walk.plan, walk.costmap, state.position_world.copy()))
        steps = tracker.steps
        simulation.act(command)
        if tick % LOG_EVERY == 0:
            log.add(state.values, command, simulation.torque)
        if tick % CHECK_EVERY == 0:
            if simulation.diverged():
                return "error: the physics diverged under the controller's torques"
            if simulation.fallen():
                return "fell"
            _check_feet(walk)
            x = float(state.position_world[0])
            if x >= walk.course.settings.length:
                return "goal"
            if x > best + 0.05:
                best, best_time = x, simulation.time_s
            elif simulation.time_s - best_time > stall_s:
                return "stalled"
    return "timeout"


def _check_feet(walk: Walk) -> None:
    """Note feet that stand where they should not: the truth, without noise."""
    robot, data = walk.simulation.robot, walk.simulation.data
    loaded = data.sensordata[robot.force_sensor] > CONTACT_ON * robot.mass * GRAVITY
    base = data.qpos[robot.base_qpos : robot.base_qpos + 7]
    angles = robot.joint_sign * data.qpos[robot.qpos] + robot.joint_offset
    feet = base[:3] + robot.geometry.feet(angles) @ rotation_of(base[3:]).T
    floor = walk.course.height(feet[:, 0], feet[:, 1])
    misplaced = loaded & (np.abs(feet[:, 2] - robot.geometry.foot_radius - floor) > CLEAN_HEIGHT_M)
    before = walk.misplaced_s.copy()
    walk.misplaced_s[:] = np.where(misplaced, before + CHECK_EVERY * TICK_S, 0.0)
    for leg in np.flatnonzero((before < CLEAN_S) & (walk.misplaced_s >= CLEAN_S)):
        walk.unclean.append((walk.simulation.time_s, float(feet[leg, 0]), float(feet[leg, 1])))
