"""Who walks a trial: each planner of a suite with the controller that goes with it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from legtool.configs.climbs import Climb
from legtool.configs.courses import Course
from legtool.configs.families import Family
from legtool.configs.planner import PlannerEvalSettings
from legtool.configs.rows import dataclass_with, is_class
from legtool.configs.worlds import WorldSettings
from legtool.evaluation.suites.suite_robot import SuiteRobot
from legtool.sim.controllers.anymal.em_dtc import EmDtcController
from legtool.sim.controllers.anymal.em_rl import EmRlController
from legtool.sim.controllers.blackbox import make_controller
from legtool.sim.controllers.controller import AnyController, Controller
from legtool.sim.controllers.tracked import GuidedController, TrackedController
from legtool.sim.controllers.trot.gait import GRAVITY
from legtool.sim.robots.robot import SimRobot
from legtool.sim.walks.environment import WalkPlanner
from legtool.sim.walks.heuristic import HeuristicPlanner
from legtool.sim.walks.missteps import LOADED
from legtool.sim.walks.operators import HeldHeading, OperatedPlanner, Operator, Route, TowardsGoal
from legtool.sim.walks.own import OwnPlanner
from legtool.sim.walks.pips import Latency, PipsPlanner, pips_for
from legtool.sim.walks.planners import GOAL_BEYOND_M, BlindPlanner, VelocityPlanner
from legtool.sim.walks.region_finder import RegionFinder
from legtool.sim.walks.scripted import ScriptedPlanner
from legtool.sim.walks.vital import VitalPlanner
from legtool.sim.worlds.world import World
from legtool_runtime import Bundle, terrain
from legtool_runtime.foothold import Criteria
from legtool_runtime.foothold.pose_settings import PoseSettings
from legtool_runtime.foothold.selection import FootholdSelector
from legtool_runtime.motion.planning.pilot import Pilot
from legtool_runtime.motion.planning.plan import Goal, forward_commands, planar_commands
from legtool_runtime.motion.planning.planner import Planner
from legtool_runtime.motion.tracker import StepTracker
from legtool_runtime.perception import chain as perception
from legtool_runtime.perception.chain import PerceptionSettings
from legtool_runtime.perception.egocan import EgocanSettings
from legtool_runtime.robot import Robot
from legtool_runtime.search.pips import Pips
from legtool_runtime.search.settings import Mode
from legtool_runtime.tracking.gaits import GaitTiming

Array = NDArray[np.float64]
#: Where a trial is walked: a world, or what each trial draws its own world from.
Place = WorldSettings | Course | Climb | Family

BLIND, SCRIPTED = "blind", "scripted"
#: Rows of ViTAL's body poses: by VPA, with one horizon (Fig. 12) and with the paper's costs (Fig. 13), and by TBR.
POSES: dict[str, Callable[[PoseSettings], PoseSettings | None]] = {
    "vital": lambda pose: pose,
    "tbr": lambda pose: None,
    "vital_single": lambda pose: replace(pose, horizons=1),
    "vital_sum": lambda pose: replace(pose, cost="sum"),
    "vital_integral": lambda pose: replace(pose, cost="integral"),
}
#: Rows of QuadPiPS: by the rules with which plans can be walked, and by the paper's own.
REGIONS: dict[str, Mode] = {"quadpips": "walkable", "quadpips_paper": "paper"}
#: Rows of gaits that step on the nearest admissible ground, as QuadPiPS' baselines do: S-MPC on the regions that
#: quadpips walks on, EM-MPC on flat cells of an elevation map [m], in today's resolution and in the one of the paper.
HEURISTIC: dict[str, float | None] = {"s_mpc": None, "em_mpc": 0.02, "em_mpc_6cm": 0.06}
#: Rows of learned policies that see a map: EM-RL, and EM-DTC, which follows the footholds of em_mpc.
POLICIES: dict[str, type[EmRlController] | type[EmDtcController]] = {"em_rl": EmRlController, "em_dtc": EmDtcController}
#: What policies take for granted of strips up to this wide that edges hide: the line of sight over them [m].
_HIDDEN_M = 1.0
#: A foot whose load falls below this share of the robot's weight has lifted off.
_UNLOADED = 0.03
ACTIONS: dict[str, Callable[[], Array]] = {
    "forward": forward_commands,
    "reversing": functools.partial(planar_commands, [round(0.1 * i, 1) for i in range(-3, 11)], [0.0], [0.0]),
    "planar": planar_commands,
}


@dataclass(frozen=True, eq=False)
class Walker:
    """A planner and its controller.

    Attributes:
        planner: decides.
        controller: carries out what it answers.
        sees: whether it is given a map.
        on_regions: whether it is given regions besides.
        at_goal: whether the goal counts when all feet stand there, and no plan that is walked to its end.
        heading: of the robot at the start, off the world's [rad].
        most_s: the walk is lost after this, if the suite gives no more [s].
    """

    planner: WalkPlanner
    controller: AnyController
    sees: bool = False
    on_regions: bool = False
    at_goal: bool = False
    heading: float = 0.0
    most_s: float = 0.0


def make_walker(
    row: str,
    robot: SimRobot,
    world: World,
    *,
    where: Place,
    number: int,
    settings: PlannerEvalSettings,
    bundle: Bundle | None,
    rng: np.random.Generator,
    sight: float | None = None,
) -> Walker:
    """The walker of a row.

    Args:
        row: ``blind``, ``scripted``, one of :data:`POSES`, :data:`REGIONS`, :data:`HEURISTIC` or :data:`POLICIES`, or
            the velocity planner at a horizon, ``h5``.
        robot: that walks.
        world: in which it was built.
        where: what the world was made from.
        number: of the trial.
        settings: of the suite.
        bundle: that planners plan with.
        rng: of the trial.
        sight: see :func:`.pips_for`.
    """
    if row == SCRIPTED:
        assert isinstance(where, Course)
        tracked = TrackedController(robot, replace(settings.tracker, force_noise=_force_noise(settings)))
        tracked.warm_up()
        return Walker(ScriptedPlanner(where, world, tracked.robot, rng), tracked)
    climb = where if isinstance(where, Climb) else None
    operator: Operator
    if isinstance(where, Family):
        operator, most_s = TowardsGoal(world), where.timeout_s
    else:
        operator = _route(world, climb, settings, number)
        most_s = 0.0 if climb is None else 3.0 * operator.length_m / max(operator.speed, 1e-3)
    if is_class(row):
        return _own(row, robot, world, settings, most_s)
    if row in REGIONS:
        return _pips(row, robot, world, settings, bundle, most_s, _latency(settings, number), sight)
    if row in HEURISTIC:
        return _heuristic(HEURISTIC[row], robot, world, settings, bundle, most_s)
    if row in POLICIES:
        return _policy(row, robot, world, settings, most_s)
    if row in POSES:
        return _vital(row, robot, operator, climb, settings, bundle, most_s)
    controller = make_controller(robot, settings.black_box)
    if row == BLIND:
        named = isinstance(where, (Climb, Family))
        planner = OperatedPlanner(operator) if named else BlindPlanner(settings.blind_speed)
        return Walker(planner, controller, heading=operator.heading, most_s=most_s)
    assert bundle is not None
    return Walker(
        _velocity_planner(bundle, settings, row, robot, controller, world), controller, sees=True, most_s=most_s
    )


def _pips(
    row: str, robot: SimRobot, world: World, settings: PlannerEvalSettings, bundle: Bundle | None, most_s: float,
    latency: Latency | None, sight: float | None,
) -> Walker:  # fmt: skip
    controller = TrackedController(
        robot, replace(settings.tracker, force_noise=_force_noise(settings)), optimised=settings.swing == "optimised",
        window=settings.swing_window,
    )  # fmt: skip
    pips = pips_for(controller.robot, world, REGIONS[row], expansions=settings.expansions, sight=sight)
    if settings.pips:
        changes = dataclass_with(pips.settings, settings.pips, "pips")
        pips = Pips(controller.robot.geometry, changes, com_offset=controller.robot.com)
    finder = _finder(controller.robot.geometry, settings, bundle)
    controller.warm_up()
    pips.warm_up()
    terrain.warm_up()
    planner = PipsPlanner(
        pips, world, controller, finder, settings.elevation, latency=latency, acts=settings.monitor == "acts"
    )
    return Walker(planner, controller, sees=True, on_regions=True, at_goal=True, most_s=most_s)


def _finder(robot: Robot, settings: PlannerEvalSettings, bundle: Bundle | None) -> RegionFinder:
    """What finds regions, warmed up."""
    segment = bundle.steppability if bundle is not None and "steppability" in bundle.lines else None
    if settings.regions == "camera":
        perception.warm_up()
    chain = PerceptionSettings(egocan=EgocanSettings(lift=settings.lift), warm_start=settings.warm_start)
    return RegionFinder(robot, chain, segment)


def _own(row: str, robot: SimRobot, world: World, settings: PlannerEvalSettings, most_s: float) -> Walker:
    """A planner of the user's with the controller that takes its answers."""
    own = OwnPlanner(row, robot, world, settings.elevation)
    controller: AnyController
    if own.answers == "contact plans":
        tracked = TrackedController(robot, replace(settings.tracker, force_noise=_force_noise(settings)))
        tracked.warm_up()
        own.task.follow(tracked)
        controller = tracked
    elif own.answers == "guided gaits":
        guided = GuidedController(robot, GaitTiming.trot_at(TowardsGoal.speed), force_noise=_force_noise(settings))
        guided.warm_up()
        controller = guided
    else:
        controller = make_controller(robot, settings.black_box)
    terrain.warm_up()
    if own.wants_regions and settings.regions == "camera":
        perception.warm_up()
    at_goal = own.wants_regions or own.answers == "contact plans"
    return Walker(own, controller, sees=True, on_regions=own.wants_regions, at_goal=at_goal, most_s=most_s)


def _heuristic(
    resolution_m: float | None, robot: SimRobot, world: World, settings: PlannerEvalSettings, bundle: Bundle | None,
    most_s: float,
) -> Walker:  # fmt: skip
    controller = GuidedController(robot, GaitTiming.trot_at(TowardsGoal.speed), force_noise=_force_noise(settings))
    geometry, on_regions = controller.robot.geometry, resolution_m is None
    elevation = settings.elevation if resolution_m is None else replace(settings.elevation, resolution_m=resolution_m)
    finder = _finder(geometry, settings, bundle) if on_regions else None
    controller.warm_up()
    terrain.warm_up()
    planner = HeuristicPlanner(world, geometry, elevation, finder=finder)
    return Walker(planner, controller, sees=True, on_regions=on_regions, at_goal=on_regions, most_s=most_s)


def _policy(row: str, robot: SimRobot, world: World, settings: PlannerEvalSettings, most_s: float) -> Walker:
    """EM-RL is told the command alone; EM-DTC, whose robot turns by itself, is given footholds and a held heading."""
    terrain.warm_up()
    made, goal = POLICIES[row], TowardsGoal(world)
    controller, follows = made(robot, getattr(settings.policies, row)), made is EmDtcController
    operator = HeldHeading(goal) if follows else goal
    planner = HeuristicPlanner(
        world, robot.geometry, settings.elevation, operator=operator, chooses=follows, hidden_m=_HIDDEN_M
    )
    return Walker(planner, controller, sees=True, most_s=most_s)


def _latency(settings: PlannerEvalSettings, number: int) -> Latency | None:
    if settings.latency_s == 0.0:
        return None
    return Latency(settings.latency_s, np.random.default_rng([settings.seed, number, 2]))


def _force_noise(settings: PlannerEvalSettings) -> float:
    return 0.0 if settings.noise is None else min(settings.noise.foot_force, 0.05)


def _route(world: World, climb: Climb | None, settings: PlannerEvalSettings, number: int) -> Route:
    way = world.goal - world.start[:2]
    start = np.array([*world.start[:2], np.arctan2(way[1], way[0])])
    length = max(float(np.hypot(*way)), 0.1)
    if climb is None:
        return Route(start, length, settings.speed)
    return Route(start, length, climb.speed(number), climb.heading, climb.turn)


def _vital(
    row: str,
    robot: SimRobot,
    operator: Operator,
    climb: Climb | None,
    settings: PlannerEvalSettings,
    bundle: Bundle | None,
    most_s: float,
) -> Walker:
    crawls = climb is not None and climb.gait == "crawl"
    timing = GaitTiming.crawl_online() if crawls else GaitTiming.trot_at(operator.speed)
    criteria, network = Criteria(robot.geometry), None
    selector = FootholdSelector(criteria)
    if settings.criteria == "networks":
        assert bundle is not None
        selector, network = FootholdSelector(criteria, method="verified", network=bundle.vfa), bundle.vpa
    controller = GuidedController(robot, timing, force_noise=_force_noise(settings))
    planner = VitalPlanner(
        operator, timing, selector, pose=POSES[row](settings.pose), network=network,
        coarse=settings.criteria == "coarse", elevation=settings.elevation,
    )  # fmt: skip
    controller.warm_up()
    planner.warm_up()
    return Walker(planner, controller, sees=True, heading=operator.heading, most_s=most_s)


def commands_left_out(bundle: Bundle, settings: PlannerEvalSettings) -> NDArray[np.float64]:
    """(m, 3) commands that :func:`motion_planner` leaves out, because the models were not fitted to such."""
    commands = np.asarray(ACTIONS[settings.actions]())
    if settings.extrapolate:
        return commands[:0]
    return commands[commands.any(axis=1) & ~bundle.motion.covers(commands)]


def motion_planner(bundle: Bundle, settings: PlannerEvalSettings, row: str) -> Planner:
    """The planner of a row ``h5``. No clock cuts its searches short: a trial must not depend on the machine's load.

    Raises:
        BundleError: the bundle has no motion line.
    """
    planning = replace(settings.planner, horizon=int(row.removeprefix("h")), deadline_s=None)
    commands = ACTIONS[settings.actions]()
    return Planner(
        bundle.motion, bundle.robot, commands=commands, settings=planning, instant=bundle.motion.instant,
        extrapolate=settings.extrapolate,
    )  # fmt: skip


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
        instant=bundle.motion.instant,
    )
    way = world.goal - world.start[:2]
    beyond = world.goal + GOAL_BEYOND_M * way / max(float(np.hypot(*way)), 1e-9)
    goal = Goal(float(beyond[0]), float(beyond[1]))
    return VelocityPlanner(
        Pilot(planner, cruise_speed=settings.cruise_speed), tracker, robot.geometry,
        goal=goal, elevation=settings.elevation, costmap=settings.costmap,
    )  # fmt: skip


def world_settings(where: Place, who: SuiteRobot, settings: PlannerEvalSettings, number: int) -> WorldSettings:
    """The world of a trial; that of a course, climb or family is drawn, for all planners alike.

    Of a family trial 0 walks the published world.
    """
    if isinstance(where, WorldSettings):
        return where
    rng = np.random.default_rng([settings.seed, number, 1])
    if isinstance(where, Family):
        published = number == 0 or settings.members == "published"
        legs = float((who.geometry.thigh_length + who.geometry.shank_length).max())
        return where.settings(None if published else int(rng.integers(2**31)), legs_m=legs)
    if isinstance(where, Climb):
        return where.settings(int(rng.integers(2**31)))
    return where.world(who.geometry, rng)
