import numpy as np

from legtool.sim.controllers.trot.trot import TrotController
from legtool.sim.robots.robot import SimRobot
from legtool.sim.walks.environment import VelocityCommand
from legtool.sim.walks.simulated import SimulatedRobot
from legtool_runtime.terrain.elevation import HeightMap


class Sees(TrotController):
    seen: HeightMap | None = None

    def see(self, terrain: HeightMap | None) -> None:
        self.seen = terrain


def test_a_controller_that_sees_is_handed_what_the_planner_knows_of_the_ground(aliengo: SimRobot) -> None:
    controller = Sees(aliengo)
    environment = SimulatedRobot(None, aliengo, controller, rng=np.random.default_rng(0))
    environment.begin()
    known = HeightMap(np.zeros((4, 4), np.float32), 0.1, np.zeros(2))
    for terrain in (known, None):
        environment.observe()
        environment.apply(VelocityCommand(np.zeros(3), terrain))
        assert controller.seen is terrain
