"""Contacts of links are told from those of feet, and ankles over sunken feet from collisions."""

import mujoco
import numpy as np
import pytest

from legtool.configs.robots import load_robot
from legtool.configs.worlds import WorldSettings
from legtool.sim.controllers.trot.trot import TrotController
from legtool.sim.robots.robot import build_robot
from legtool.sim.robots.state import RobotState
from legtool.sim.walks.contacts import LinkContacts
from legtool.sim.walks.environment import Observation, VelocityCommand
from legtool.sim.walks.simulated import SimulatedRobot
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.mujoco_world import world_spec

ANSWER = VelocityCommand(np.zeros(3))


def placed(boxes: tuple, lower: float = 0.0) -> tuple[SimulatedRobot, LinkContacts]:
    world = build_world(WorldSettings(name="short", goal=(1.0, 0.0), boxes=boxes))
    robot = build_robot(load_robot("hyq"), world_spec(world))
    environment = SimulatedRobot(world, robot, TrotController(robot), rng=np.random.default_rng(0))
    contacts = LinkContacts(environment, environment.simulation.controller)
    environment.simulation.data.qpos[2] -= lower
    mujoco.mj_forward(robot.model, environment.simulation.data)
    return environment, contacts


def test_a_standing_robot_touches_with_its_feet_alone() -> None:
    _, contacts = placed((), lower=0.003)
    contacts.tick(Observation(0.0, RobotState()), ANSWER)
    assert not contacts.found and not contacts.ankles


def test_a_box_between_the_legs_is_met_by_the_trunk() -> None:
    _, contacts = placed(({"center": (0.25, 0.0, 0.3), "size": (0.2, 0.1, 0.6)},))
    contacts.tick(Observation(0.0, RobotState()), ANSWER)
    assert contacts.found == [(0.0, "trunk")]


def test_a_riser_that_a_shank_leans_on_is_a_collision() -> None:
    environment, contacts = placed(())
    shank = environment.simulation.data.body("FL_knee").xpos
    _, contacts = placed(({"center": (float(shank[0]), float(shank[1]), 0.15), "size": (0.04, 0.04, 0.3)},))
    contacts.tick(Observation(0.0, RobotState()), ANSWER)
    assert "FL_knee" in {body for _, body in contacts.found} and not contacts.ankles


def test_an_ankle_over_a_sunken_foot_is_none() -> None:
    _, contacts = placed((), lower=0.02)
    contacts.tick(Observation(0.0, RobotState()), ANSWER)
    assert contacts.ankles and not contacts.found


@pytest.mark.parametrize(("later", "count"), [(0.1, 1), (0.2, 2)])
def test_contacts_of_a_body_that_are_near_in_time_are_one(later: float, count: int) -> None:
    _, contacts = placed(({"center": (0.25, 0.0, 0.3), "size": (0.2, 0.1, 0.6)},))
    for time_s in (0.0, later):
        contacts.tick(Observation(time_s, RobotState()), ANSWER)
    assert len(contacts.found) == count
