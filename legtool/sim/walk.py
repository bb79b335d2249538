"""Closed loop: a robot walks a course, blind or planned, with the map from its own depth camera or from the truth."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from legtool.configs.robots import DepthCamera
from legtool.configs.sweep import CONTROL_RATE_HZ, Noise
from legtool.sim.controller import Controller
from legtool.sim.course import Course
from legtool.sim.gait import GRAVITY
from legtool.sim.raycast import Scene, box, camera_pose, cast, plane
from legtool.sim.robot import SimRobot
from legtool.sim.simulation import TICK_S, Log, Simulation, to_base
from legtool.sim.watchdog import Watchdog
from legtool_runtime.errors import LegtoolError
from legtool_runtime.motion.planner import Goal, Plan, Planner
from legtool_runtime.motion.tracker import StepTracker
from legtool_runtime.terrain.costmap import CostmapSettings, FootCostmap, foot_costmap
from legtool_runtime.terrain.elevation import ElevationGrid, ElevationSettings, HeightMap

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
#: The simulated depth camera: rate [Hz], and standard deviation of its readings over their square [1/m].
CAMERA_RATE_HZ = 15
DEPTH_NOISE = 0.003
DEPTH_FAR_M = 4.0
#: The planner's goal lies beyond the finish, so that the robot walks over it instead of creeping up to it [m].
GOAL_BEYOND_M = 0.6
#: Without this much headway [m] for so long [s] a robot backs off by so much [m], for at most so long [s].
HEADWAY_M, PATIENCE_S, RUN_UP_M, BACK_OFF_S = 0.05, 2.0, 0.8, 6.0


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
        costmap: the latest, of a planned walk.
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


class BlindPilot:
    """Walks ahead at one speed: what an operator without eyes on the feet does."""

    def __init__(self, speed: float) -> None:
        self.speed = speed

    def command(self, walk: Walk) -> Array:
        """The same speed always."""
        return np.array([self.speed, 0.0, 0.0])


class PlannedPilot:
    """Plans at every full stance on a map, and commands the plan's first velocity.

    Where no whole sequence is found, because none is safe or time is up, it goes on with the one that the last step
    began: to brake before an edge, against that plan, is no surer way over it. A robot that has halted before an
    obstacle backs off for a run-up, if its commands let it: what is crossed at speed alone is never crossed from rest.
    """

    def __init__(
        self, planner: Planner, *, bold: Planner | None = None, costmap: CostmapSettings | None = None
    ) -> None:
        """Plan with ``planner``; and from a run-up until the halt is left behind with ``bold``, of narrower margins."""
        self.planner = planner
        self._bold = bold or planner
        self._bold_until = -np.inf
        self.costmap_settings = costmap or CostmapSettings()
        self.last: Plan | None = None
        self._backs_off = bool((planner.commands[:, 0] < 0).any())
        self._farthest, self._since_s = -np.inf, 0.0
        self._back_to: float | None = None
        #: The whole plans that the latest steps began with, and how many steps there had been.
        self._whole: list[tuple[int, Plan]] = []

    def command(self, walk: Walk) -> Array:
        """The first command of a new plan.

        Raises:
            LegtoolError: at the start, what the planner could not plan from.
        """
        assert walk.costmap is not None
        state = walk.simulation.state
        goal = self._goal(walk)
        here: dict[str, Any] = {"position": state.position_world, "rotation": rotation_of(state.orientation)}
        if self.last is None:
            self.planner.check(walk.tracker.state(), walk.costmap, **here, goal=goal)
        planner = self._bold if state.position_world[0] < self._bold_until and self._back_to is None else self.planner
        plan = planner.plan(walk.tracker.state(), walk.costmap, **here, goal=goal)
        walk.planning_times_s.append(plan.planning_time_s)
        self.last = plan
        steps = walk.tracker.steps
        if plan.status in ("goal", "horizon"):
            before = [earlier for earlier in self._whole if earlier[0] < steps]
            self._whole = [*before[-1:], (steps, plan)]
            return plan.command
        for made, whole in self._whole:
            if made < steps and steps - made < len(whole.commands):
                command: Array = whole.commands[steps - made]
                return command
        return plan.command

    def _goal(self, walk: Walk) -> Goal:
        """Beyond the finish; or behind, where there was no headway for a while."""
        x, y = walk.simulation.state.position_world[:2]
        now = walk.simulation.time_s
        if self._back_to is not None and (x < self._back_to or now - self._since_s > BACK_OFF_S):
            self._back_to, self._farthest, self._since_s = None, x, now
        if x > self._farthest + HEADWAY_M:
            self._farthest, self._since_s = x, now
        elif self._back_to is None and self._backs_off and now - self._since_s > PATIENCE_S:
            self._back_to, self._since_s = x - RUN_UP_M, now
            self._bold_until = x + RUN_UP_M
        if self._back_to is not None:
            return Goal(self._back_to - GOAL_BEYOND_M, float(y))
        return Goal(walk.course.goal[0] + GOAL_BEYOND_M, float(y))


class CameraMap:
    """The elevation map that the robot's own depth camera builds."""

    def __init__(
        self, course: Course, camera: DepthCamera, rng: np.random.Generator, settings: ElevationSettings
    ) -> None:
        self._scene = course_scene(course)
        self._mount = camera
        self._camera = camera.camera()
        self._intrinsics = np.array([self._camera.fx, self._camera.fy, self._camera.cx, self._camera.cy])
        self._rng = rng
        self.grid = ElevationGrid(settings)
        self._begun = False

    def look(self, simulation: Simulation) -> HeightMap:
        """Take an image from where the camera truly is, and fuse it at where the robot believes it is."""
        robot, data, state = simulation.robot, simulation.data, simulation.state
        base = data.qpos[robot.base_qpos : robot.base_qpos + 7]
        seen = cast(self._scene, self._camera, self._pose(base[:3], base[3:]), far=DEPTH_FAR_M, normals=False)
        depth = seen.depth + self._rng.standard_normal(seen.depth.shape, np.float32) * (DEPTH_NOISE * seen.depth**2)
        here = state.position_world
        self.grid.move_to(here[:2])
        if not self._begun:
            ground = here[2] - robot.geometry.standing_height
            self.grid.assume_flat(here[:2], radius_m=0.9, height_m=ground)
            self._begun = True
        pose = self._pose(here, state.orientation)
        self.grid.update(depth, self._intrinsics, transform_camera_to_world=pose, time_s=simulation.time_s)
        return self.grid.map()

    def _pose(self, position: Array, orientation: Array) -> Array:
        base = np.eye(4)
        base[:3, :3] = rotation_of(orientation)
        base[:3, 3] = position
        pose: Array = base @ camera_pose(self._mount.position, pitch=self._mount.pitch)
        return pose


class TrueMap:
    """The course itself as a map around the robot."""

    def __init__(self, course: Course, settings: ElevationSettings) -> None:
        self._course = course
        self._settings = settings

    def look(self, simulation: Simulation) -> HeightMap:
        """The true heights, on a grid aligned with the world."""
        r = self._settings.resolution_m
        n = round(self._settings.size_m / r)
        first = np.round(simulation.state.position_world[:2] / r - 0.5 * n)
        x = (first[0] + np.arange(n) + 0.5) * r
        y = (first[1] + np.arange(n) + 0.5) * r
        return HeightMap(self._course.height(x[:, None], y[None, :]).astype(np.float32), r, (first + 0.5 * n) * r)


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
            walk.costmap = foot_costmap(eyes.look(simulation), getattr(pilot, "costmap_settings", None))
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
        if tracker.steps > steps and isinstance(pilot, PlannedPilot) and pilot.last is not None:
            walk.plans.append(pilot.last)
            if walk.costmap is not None and len(walk.plans) % SNAPSHOT_EVERY == 1:
                walk.snapshots.append((pilot.last, walk.costmap, state.position_world.copy()))
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


def course_scene(course: Course) -> Scene:
    """The course for the ray caster: its boxes over the pit's floor."""
    upright = np.eye(3)
    boxes = [
        box((high + low) / 2, upright, ((high - low) / 2).tolist())
        for low, high in zip(course.lower, course.upper, strict=True)
    ]
    return Scene.of([*boxes, plane((0.0, 0.0, -course.settings.pit_depth), upright)])


def rotation_of(quaternion: Array) -> Array:
    """(3, 3) rotation matrix of a unit quaternion w, x, y, z."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
