"""What the trials of a suite are made from, and what decides their outcome."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from legtool.configs.climbs import CLIMBS, Climb
from legtool.configs.courses import COURSES, any_world
from legtool.configs.families import ARENA, FAMILIES, Family
from legtool.configs.planner import PlannerEvalSettings
from legtool.datasets.contents import bundle_content, controller_content
from legtool.datasets.files import sha256
from legtool.evaluation.suites.suite_robot import SuiteRobot, policy_robot, suite_robot
from legtool.evaluation.suites.walkers import BLIND, POLICIES, SCRIPTED, Place
from legtool_runtime import Bundle

#: Settings that say which trials there are, not how one goes; and those that a blind planner does not look at.
_WHICH = (
    "suite", "planners", "trials", "horizons", "films", "deadline_s", "robot", "mjcf", "mjcf_names", "black_box",
    "policies",
)  # fmt: skip
_SIGHT = (
    "map", "regions", "swing", "lift", "expansions", "camera", "camera_size", "actions", "cruise_speed", "planner",
    "elevation", "costmap", "pose", "criteria", "speed", "latency_s", "monitor",
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
        if row in POLICIES:
            return policy_robot(self.robot, self.settings)
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
    every = suite.settings.to_dict()
    shared = {
        "settings": {name: value for name, value in every.items() if name not in (*_WHICH, *_SIGHT)},
        "controller": controller_content(suite.settings.black_box),
    }
    sight = {"sight": {name: every[name] for name in _SIGHT}}
    if bundle is not None:
        sight["bundle"] = bundle_content(bundle.manifest)
    return {
        (name, row): {
            **shared,
            "robot": suite.robot_in(name, row).content(),
            "world": _content(world),
            **({"policy": _policy_content(row, suite.settings)} if row in POLICIES else {}),
            **({} if row in (BLIND, SCRIPTED) else sight),
        }
        for name, world in suite.worlds.items()
        for row in suite.settings.rows
    }


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
