"""The plans of walks by script."""

from __future__ import annotations

import numpy as np
import pytest

from legtool.configs.courses import COURSES
from legtool.configs.robots import load_robot
from legtool.sim.robots.robot import build_robot
from legtool.sim.robots.state import RobotState
from legtool.sim.robots.tracked import tracked_robot
from legtool.sim.walks.environment import Observation, PlannedContacts
from legtool.sim.walks.scripted import ScriptedPlanner
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.mujoco_world import world_spec


@pytest.mark.parametrize("name", ["anymal_c", "go2", "aliengo", "hyq"])
def test_every_course_is_within_reach_of_every_robot_and_crosses_no_feet(name: str) -> None:
    settings = load_robot(name)
    geometry = settings.geometry()
    state = RobotState()
    state.position_world[2], state.orientation[0] = settings.standing_height, 1.0
    state.joint_positions[:], _ = geometry.joints(geometry.stance)
    for seed, course in enumerate(COURSES.values()):
        world = build_world(course.world(geometry, np.random.default_rng(seed)))
        robot = tracked_robot(build_robot(settings, world_spec(world)))
        answer = ScriptedPlanner(course, world, robot, np.random.default_rng(seed)).act(Observation(0.0, state))
        assert isinstance(answer, PlannedContacts)
        assert [len(leg) for leg in answer.plan.stances] == [course.cycles + 1] * 4
