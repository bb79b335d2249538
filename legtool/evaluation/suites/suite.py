"""What the trials of a suite are made from, and what decides their outcome."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from legtool.configs.climbs import CLIMBS, Climb
from legtool.configs.courses import COURSES, any_world
from legtool.configs.families import ARENA, FAMILIES, Family
from legtool.configs.planner import PlannerEvalSettings
from legtool.configs.rows import is_class, is_horizon
from legtool.datasets.contents import bundle_content, controller_content
from legtool.datasets.files import sha256
from legtool.evaluation.suites.suite_robot import SuiteRobot, policy_robot, suite_robot
from legtool.evaluation.suites.walkers import (
    BLIND,
    HEURISTIC,
    POLICIES,
    POSES,
    REGIONS,
    SCRIPTED,
    Place,
    commands_left_out,
)
from legtool_runtime import Bundle

#: Settings that say which trials there are, not how one goes; and those that a blind planner does not look at.
_WHICH = (
    "suite", "planners", "trials", "horizons", "films", "records", "record_images", "deadline_s", "robot", "mjcf",
    "mjcf_names", "black_box", "policies", "extrapolate",
)  # fmt: skip
_SIGHT = (
    "map", "regions", "swing", "lift", "expansions", "camera", "camera_size", "actions", "cruise_speed", "planner",
    "elevation", "costmap", "pose", "criteria", "speed", "latency_s", "monitor", "pips", "swing_window", "warm_start",
)  # fmt: skip


class Suite(NamedTuple):
    """All that the trials of a suite are made from.

    Attributes:
        settings: of the suite.
        bundle_path: that planners plan with, None where all are blind.
        robot: who walks.
        worlds: by the name that they have in results; of a course each trial draws its own.
    """

    settings: PlannerEvalSettings
    bundle_path: Path | None
    robot: SuiteRobot
    worlds: dict[str, Place]

    def robot_in(self, world: str, row: str = "") -> SuiteRobot:
        """Who walks a row in a world: the suite's robot, the one that a climb names, or that of the policies."""
        where = self.worlds[world]
        planner, settings = self.settings.of_row(row)
        if planner in POLICIES:
            return policy_robot(self.robot, settings)
        if not isinstance(where, Climb) or where.robot is None:
            return self.robot
        return suite_robot(self.settings.replace(robot=where.robot, mjcf=None, camera=None), None)


def worlds_of(settings: PlannerEvalSettings) -> dict[str, Place]:
    """Worlds by name; of several with one name the later ones are numbered."""
    worlds: dict[str, Place] = {}
    for given in settings.worlds:
        named = COURSES.get(given) or CLIMBS.get(given) or FAMILIES.get(given) or ARENA.get(given)
        world = named or any_world(given)
        name, number = world.name, 2
        while name in worlds:
            name, number = f"{world.name}_{number}", number + 1
        worlds[name] = world
    return worlds


def decides_of(suite: Suite, bundle: Bundle | None) -> dict[tuple[str, str], dict[str, Any]]:
    """By world and planner all that decides its trials, but their number."""
    decides = {}
    for row in suite.settings.rows:
        of_row = _decides_row(row, suite.settings, bundle)
        for name, world in suite.worlds.items():
            decides[name, row] = {
                **of_row, "robot": suite.robot_in(name, row).content(), "world": _content(world),
            }  # fmt: skip
    return decides


def _decides_row(row: str, given: PlannerEvalSettings, bundle: Bundle | None) -> dict[str, Any]:
    """What decides the trials of a row in whatever world."""
    planner, settings = given.of_row(row)
    every = settings.to_dict()
    decides: dict[str, Any] = {
        "settings": {name: value for name, value in every.items() if name not in (*_WHICH, *_SIGHT)},
        "controller": controller_content(settings.black_box),
    }
    if planner in (BLIND, SCRIPTED):
        return decides
    decides["sight"] = {name: every[name] for name in _SIGHT}
    if bundle is not None and _uses_bundle(planner, settings, bundle):
        decides["bundle"] = bundle_content(bundle.manifest)
    if bundle is not None and is_horizon(planner):
        # Not the setting but what comes of it: where nothing is left out, it decides nothing.
        left_out = commands_left_out(bundle, settings)
        decides |= {"left_out": left_out.tolist()} if len(left_out) else {}
    if planner in POLICIES:
        decides["policy"] = _policy_content(planner, settings)
    if is_class(planner):
        decides["class"] = controller_content(planner)
    return decides


def _uses_bundle(planner: str, settings: PlannerEvalSettings, bundle: Bundle) -> bool:
    """Whether trials of a planner depend on the bundle: others are kept when one is given for a planner beside."""
    if planner in POSES:
        return settings.criteria == "networks"
    if planner in REGIONS or HEURISTIC.get(planner, 0.0) is None:
        return settings.regions == "camera" and "steppability" in bundle.lines
    return is_horizon(planner)


def _policy_content(row: str, settings: PlannerEvalSettings) -> list[dict[str, str]]:
    """The network of a policy's row."""
    path = getattr(settings.policies, row)
    return [] if path is None or not path.is_file() else [{"sha256": sha256(path)}]


def _content(world: Place) -> dict[str, Any]:
    """All that a world is made from."""
    if isinstance(world, Climb):
        return {"climb": world.to_dict(), "world": world.settings().to_dict()}
    if isinstance(world, Family):
        # One member stands for the rule by which all are drawn.
        return {"family": world.to_dict(), "world": world.settings().to_dict(), "drawn": world.settings(0).to_dict()}
    return world.to_dict()
