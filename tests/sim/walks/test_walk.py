"""Walks whose controller or planner misbehaves end as failures with a reason, at once, and end alone."""

import time

import numpy as np
import pytest

from legtool.configs.robots import load_robot
from legtool.configs.worlds import load_world
from legtool.errors import ControllerError
from legtool.sim.controllers.trot.trot import TrotController
from legtool.sim.robots.robot import SimRobot, build_robot
from legtool.sim.walks.pilots import BlindPilot
from legtool.sim.walks.walk import walk_course
from legtool.sim.walks.watchdog import Watchdog
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.mujoco_world import world_spec
from legtool.sim.worlds.world import World


@pytest.fixture(scope="module")
def course() -> World:
    return build_world(load_world("gap_10"))


@pytest.fixture(scope="module")
def robot(course: World) -> SimRobot:
    return build_robot(load_robot("aliengo"), world_spec(course))


class Limp:
    """Never moves; what it does wrong it does at its fifth tick."""

    def __init__(self, wrong=None, at_reset=None) -> None:
        self.wrong, self.at_reset, self.ticks = wrong, at_reset, 0

    def reset(self, state) -> None:
        if self.at_reset:
            self.at_reset()

    def accepts_command(self) -> bool:
        return True

    def step(self, state, command):
        self.ticks += 1
        return self.wrong() if self.wrong and self.ticks == 5 else np.zeros(12)


def fail():
    raise ValueError("lost a packet")


def spin():
    while True:
        pass


@pytest.mark.parametrize(
    ("controller", "reason"),
    [
        (Limp(fail), "error: ValueError: lost a packet"),
        (Limp(at_reset=fail), "error: ValueError: lost a packet"),
        (Limp(lambda: np.full(12, np.nan)), "expected 12 finite torques"),
        (Limp(lambda: np.zeros(11)), "expected 12 finite torques"),
        (Limp(lambda: None), "expected 12 finite torques"),
        (Limp(lambda: np.full(12, 1e12)), "physics diverged"),
        (Limp(lambda: time.sleep(60)), "gave no answer for 0.2 s"),
        (Limp(spin), "gave no answer for 0.2 s"),
        (Limp(), "fell"),
    ],
)
def test_a_controller_that_misbehaves_loses_its_walk_with_the_reason(course, robot, controller, reason) -> None:
    began = time.monotonic()
    walk = walk_course(course, robot, controller, BlindPilot(0.5), rng=np.random.default_rng(0), answer_s=0.2)
    assert reason in walk.outcome
    assert not walk.success and not walk.clean
    assert time.monotonic() - began < 20


def test_a_pilot_that_throws_loses_its_walk(course, robot) -> None:
    class Broken:
        def command(self, walk):
            raise RuntimeError("no plan")

    walk = walk_course(course, robot, TrotController(robot), Broken(), rng=np.random.default_rng(0))
    assert walk.outcome == "error: RuntimeError: no plan"


def test_a_watchdog_that_is_fed_keeps_still() -> None:
    with Watchdog(0.1) as watchdog:
        for _ in range(6):
            watchdog.feed()
            time.sleep(0.03)
    time.sleep(0.15)  # and does nothing after its block
    with pytest.raises(ControllerError, match="no answer"), Watchdog(0.05) as watchdog:
        watchdog.feed()
        time.sleep(1)
