"""Walks by contact plans in MuJoCo whose body follows optimised motions."""

from __future__ import annotations

import numpy as np

from legtool.configs.courses import Course
from legtool.configs.robots import load_robot
from legtool.sim.controllers.tracked import TrackedController
from legtool.sim.robots.robot import build_robot
from legtool.sim.walks.loop import run
from legtool.sim.walks.missteps import Missteps
from legtool.sim.walks.scripted import ScriptedPlanner, Tracking
from legtool.sim.walks.simulated import SimulatedRobot, Until
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.mujoco_world import world_spec


def test_a_robot_walks_stones_on_optimised_motions() -> None:
    course = Course(name="two_rows", ground="stones", rise=0.05, cycles=3)
    settings = load_robot("anymal_c")
    world = build_world(course.world(settings.geometry(), np.random.default_rng(3)))
    robot = build_robot(settings, world_spec(world))
    controller = TrackedController(robot, optimised=True)
    planner = ScriptedPlanner(course, world, controller.robot, np.random.default_rng(4))
    environment = SimulatedRobot(world, robot, controller, rng=np.random.default_rng(5), until=Until(30.0))
    missteps, tracking = Missteps(environment), Tracking(environment, controller)
    assert run(environment, planner, [missteps, tracking]) == "goal"
    assert not missteps.found
    assert controller.references is not None
    assert len(controller.references.times_s) >= 6 and not controller.references.refused
    assert max(error for *_, error in tracking.landings) < 0.01
