"""A simulated Aliengo before a gap."""

from collections.abc import Callable

import numpy as np
import pytest

from legtool.configs.robots import load_robot
from legtool.configs.worlds import load_world
from legtool.sim.controllers.trot.trot import TrotController
from legtool.sim.robots.robot import SimRobot, build_robot
from legtool.sim.walks.simulated import SimulatedRobot, Until
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.mujoco_world import world_spec
from legtool.sim.worlds.world import World

Make = Callable[..., SimulatedRobot]


@pytest.fixture(scope="session")
def world() -> World:
    return build_world(load_world("gap_10"))


@pytest.fixture(scope="session")
def robot(world: World) -> SimRobot:
    return build_robot(load_robot("aliengo"), world_spec(world))


@pytest.fixture
def make(world: World, robot: SimRobot) -> Make:
    """Makes a simulated robot; by default with the built-in trot."""

    def environment(controller=None, **changes) -> SimulatedRobot:
        rng = changes.pop("rng", np.random.default_rng(0))
        until = Until(**{name: changes.pop(name) for name in Until._fields if name in changes})
        return SimulatedRobot(world, robot, controller or TrotController(robot), rng=rng, until=until, **changes)

    return environment
