"""Work of the joints, and the way that it was done over."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from legtool.configs.sweep import CONTROL_RATE_HZ
from legtool.sim.robots.robot import SimRobot
from legtool.sim.walks.effort import Effort


def walk(robot: SimRobot, place: Any, seconds: float) -> Effort:
    """Joints that turn at 0.5 rad/s under torques of 2 Nm, of which half brake, while the trunk goes its way."""
    simulation = SimpleNamespace(
        robot=robot,
        data=SimpleNamespace(qpos=np.zeros(robot.model.nq), qvel=np.zeros(robot.model.nv)),
        torque=2.0 * np.tile([1.0, -1.0], 6),
    )
    simulation.data.qvel[robot.dof] = 0.5
    effort = Effort(SimpleNamespace(simulation=simulation))  # type: ignore[arg-type]
    effort.begin()
    for k in range(1, round(seconds * CONTROL_RATE_HZ) + 1):
        simulation.data.qpos[robot.base_qpos : robot.base_qpos + 2] = place(k / CONTROL_RATE_HZ)
        effort.tick(None, None)  # type: ignore[arg-type]
    effort.end()
    return effort


def test_braking_costs_as_much_as_driving(aliengo: SimRobot) -> None:
    effort = walk(aliengo, lambda t: (0.4 * t, 0.0), 5.2)
    assert effort.work_j == pytest.approx(12 * 2.0 * 0.5 * 5.2)
    assert effort.way_m == pytest.approx(0.4 * 5.2)
    assert effort.cost_of_transport == pytest.approx(effort.work_j / (aliengo.mass * 9.81 * 2.08), rel=1e-3)


def test_sway_within_a_step_is_no_way_and_turns_are(aliengo: SimRobot) -> None:
    swaying = walk(aliengo, lambda t: (0.4 * t, 0.05 * np.sin(4.0 * np.pi * t)), 4.0)
    assert swaying.way_m == pytest.approx(1.6, abs=0.01)
    corner = walk(aliengo, lambda t: (min(t, 2.0), max(t - 2.0, 0.0)), 4.0)
    assert corner.way_m == pytest.approx(4.0)


def test_a_robot_that_goes_nowhere_has_no_cost_of_transport(aliengo: SimRobot) -> None:
    assert walk(aliengo, lambda t: (0.01 * t, 0.0), 3.0).cost_of_transport is None
