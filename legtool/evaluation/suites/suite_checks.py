"""What refuses a suite before its first walk: planners, robots, bundles and worlds that do not go together."""

from __future__ import annotations

from legtool.configs.climbs import CLIMBS
from legtool.configs.courses import COURSES, Course
from legtool.configs.rows import dataclass_with, is_class, is_horizon
from legtool.errors import SettingsError
from legtool.evaluation.suites.suite import Suite
from legtool.evaluation.suites.suite_robot import SuiteRobot
from legtool.evaluation.suites.walkers import (
    HEURISTIC,
    POLICIES,
    POSES,
    REGIONS,
    SCRIPTED,
    motion_planner,
    world_settings,
)
from legtool.sim.controllers.blackbox import make_controller
from legtool.sim.controllers.tracked import GuidedController, TrackedController
from legtool.sim.walks.own import OwnPlanner
from legtool.sim.worlds.build import build_world
from legtool_runtime import Bundle
from legtool_runtime.foothold import Criteria
from legtool_runtime.search.settings import PipsSettings
from legtool_runtime.tracking.gaits import GaitTiming


def check(suite: Suite, bundle: Bundle | None) -> None:
    """Refuse at once what cannot plan or walk: models of another instant, a policy that is not as described.

    Rows with settings of their own are looked at one by one.
    """
    plain = tuple(name for name in suite.settings.planners if suite.settings.of_row(name)[1] is suite.settings)
    if plain:
        _check(suite._replace(settings=suite.settings.replace(planners=plain)), bundle)
    for name in suite.settings.planners:
        if name not in plain:
            planner, settings = suite.settings.of_row(name)
            _check(suite._replace(settings=settings.replace(planners=(planner,))), bundle)


def _check(suite: Suite, bundle: Bundle | None) -> None:
    settings = suite.settings
    if bundle is not None and "velocity" in settings.planners:
        motion_planner(bundle, settings, next(filter(is_horizon, settings.rows)))
    robots = {name: suite.robot_in(name) for name in suite.worlds}
    for name, world in suite.worlds.items():
        build_world(world_settings(world, robots[name], settings, 0), robot=robots[name].name).require_goal()
    on_feet = (SCRIPTED, *POSES, *REGIONS, *HEURISTIC, *POLICIES)
    tracked = [planner for planner in settings.planners if planner in on_feet]
    if tracked and settings.black_box is not None:
        raise SettingsError(
            f"planner {tracked[0]}: it plans feet, which the controller {settings.black_box} does not take; leave "
            "black_box out, or choose other planners"
        )
    if SCRIPTED in tracked:
        others = [name for name, world in suite.worlds.items() if not isinstance(world, Course)]
        if others:
            raise SettingsError(
                f"planner scripted: world {others[0]} has no script; expected courses, any of {', '.join(COURSES)}"
            )
        TrackedController(suite.robot.build(), settings.tracker)
    if any(row in (*POSES, *HEURISTIC) for row in tracked):
        _check_poses(suite, bundle, robots)
    if any(row in REGIONS or HEURISTIC.get(row, 0.0) is None for row in tracked):
        check_regions(suite, bundle)
    for row in settings.planners:
        if row in POLICIES:
            _check_policy(suite, row)
        if row in REGIONS:
            geometry = suite.robot.geometry
            dataclass_with(PipsSettings.of(geometry, REGIONS[row]), settings.pips, "pips")
        if is_class(row):
            _check_own(suite, row)
    make_controller(suite.robot.build(), settings.black_box)


def _check_poses(suite: Suite, bundle: Bundle | None, robots: dict[str, SuiteRobot]) -> None:
    """Refuse worlds and robots in which no feet can be chosen on the way."""
    for name, world in suite.worlds.items():
        if isinstance(world, Course):
            raise SettingsError(
                f"world {name}: its feet go by script; planners that choose footholds expect climbs, any of "
                f"{', '.join(CLIMBS)}, or other worlds"
            )
        robot = robots[name].build()
        GuidedController(robot, GaitTiming.trot())
        if suite.settings.criteria == "networks":
            if bundle is None:
                raise SettingsError("--bundle is missing: criteria=networks needs a bundle with a foothold line")
            Criteria(robot.geometry).refuse_other(bundle.vfa.robot, bundle.vfa)


def _check_own(suite: Suite, row: str) -> None:
    """Refuse a class that is none, or no planner, and answers that the suite's black box does not take."""
    name, place = next(iter(suite.worlds.items()))
    who = suite.robot_in(name)
    world = build_world(world_settings(place, who, suite.settings, 0), robot=who.name)
    own = OwnPlanner(row, who.build(), world, suite.settings.elevation)
    if own.answers != "velocity commands" and suite.settings.black_box is not None:
        raise SettingsError(
            f"planner {row}: it answers with {own.answers}, which the controller {suite.settings.black_box} does not "
            "take; leave black_box out, or choose other planners"
        )
    if own.wants_regions:
        check_regions(suite, None)


def _check_policy(suite: Suite, row: str) -> None:
    """Refuse worlds whose feet go by script, and a file or robot that is none of the policy's."""
    for name, world in suite.worlds.items():
        if isinstance(world, Course):
            raise SettingsError(
                f"world {name}: its feet go by script; policies that see a map expect other worlds, like --suite "
                "quadpips"
            )
    robot = suite.robot_in(next(iter(suite.worlds)), row).build()
    POLICIES[row](robot, getattr(suite.settings.policies, row))


def check_regions(suite: Suite, bundle: Bundle | None) -> None:
    """Refuse worlds whose feet go by script, and a segmenter that was trained for another camera."""
    for name, world in suite.worlds.items():
        if isinstance(world, Course):
            raise SettingsError(
                f"world {name}: its feet go by script; planners on regions expect other worlds, like --suite quadpips"
            )
    if suite.settings.regions != "camera" or bundle is None or "steppability" not in bundle.lines:
        return
    sensor = bundle.steppability.sensor
    if sensor is not None and sensor.camera != suite.robot.camera.camera():
        width, height = sensor.camera.width, sensor.camera.height
        raise SettingsError(
            f"the bundle's segmenter was trained for another camera, with images of {width} x {height}; set "
            f"camera_size=[{width},{height}] and the camera that it was trained for"
        )
