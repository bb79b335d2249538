"""Robots on a flat floor in MuJoCo under whole-body control: swaying on four feet, and on three drawing with one."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np
import pytest

from legtool.configs.robots import load_robot
from legtool.configs.sweep import CONTROL_RATE_HZ
from legtool.sim.robots.physics import SUBSTEPS
from legtool.sim.robots.robot import SimRobot, build_robot
from legtool.sim.robots.tracked import tracked_robot
from legtool_runtime.tracking.assembly import References, orientation_error
from legtool_runtime.tracking.dynamics import GRAVITY, FullState
from legtool_runtime.tracking.whole_body import REFERENCE_HEIGHT, SOLVED, WholeBody

PRESETS = ("aliengo", "go2", "hyq", "anymal_c")
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
#: Seconds in which a motion begins.
BEGIN_S = 1.0


class Errors(NamedTuple):
    com_mm: np.ndarray
    tilt_deg: np.ndarray
    foot_mm: float
    torque_share: float


def eased(t: float) -> float:
    t = min(max(t, 0.0), 1.0)
    return t**3 * (10 - 15 * t + 6 * t**2)


def with_rates(path: Callable[[float], np.ndarray], t: float) -> np.ndarray:
    """Position, velocity and acceleration of a path, by differences."""
    h = 1e-4
    before, now, after = path(t - h), path(t), path(t + h)
    return np.stack([now, (after - before) / (2 * h), (after - 2 * now + before) / h**2])


def walk(robot: SimRobot, seconds: float, plan: Callable[[float, References, WholeBody], None]) -> Errors:
    """Follow the references that ``plan`` writes; the largest errors after the robot has settled on its feet."""
    tracked = tracked_robot(robot)
    control, data = WholeBody(tracked), mujoco.MjData(robot.model)
    robot.place(data)
    wanted = References(
        com=np.stack([data.qpos[:3] + tracked.com, np.zeros(3), np.zeros(3)]),
        orientation=UPRIGHT.copy(),
        turning=np.zeros((2, 3)),
        stance=np.ones(4, dtype=bool),
        swing=np.zeros((4, 3, 3)),
        forces=np.zeros((4, 3)),
        normals=np.tile([0.0, 0.0, 1.0], (4, 1)),
        friction=np.full(4, 0.6),
    )
    com, tilt, foot, share = [], [], [0.0], []
    for tick in range(int(seconds * CONTROL_RATE_HZ)):
        state = FullState(data.qpos[:3].copy(), data.qpos[3:7].copy(), data.qpos[robot.qpos], data.qvel.copy())
        plan(tick / CONTROL_RATE_HZ, wanted, control)
        wanted.forces[:, 2] = np.where(wanted.stance, tracked.mass * GRAVITY / wanted.stance.sum(), 0.0)
        answer = control.control(state, wanted)
        assert answer.status == SOLVED
        error = np.zeros(3)
        orientation_error(state.orientation, wanted.orientation, error)
        com.append(control.terms.com - wanted.com[0])
        tilt.append(error)
        share.append(answer.torque_share)
        if not wanted.stance.all():
            foot.append(float(np.abs(control.terms.feet - wanted.swing[:, 0])[~wanted.stance].max()))
        data.qfrc_applied[robot.dof.ravel()] = answer.torques
        mujoco.mj_step(robot.model, data, SUBSTEPS)
    return Errors(
        1e3 * np.abs(com).max(axis=0), np.rad2deg(np.abs(tilt).max(axis=0)), 1e3 * max(foot), float(max(share))
    )


def sway(robot: SimRobot) -> Callable[[float, References, WholeBody], None]:
    """Sinusoids of 3 cm, scaled to the robot's height, and 3 to 5 degrees about and along all axes."""
    reach = 0.03 * robot.geometry.standing_height / REFERENCE_HEIGHT
    tracked = tracked_robot(robot)
    middle = np.array([0.0, 0.0, robot.geometry.standing_height]) + tracked.com
    phase = np.array([0.0, 1.0, 2.0])

    def place(t: float) -> np.ndarray:
        return middle + reach * eased(t / BEGIN_S) * np.sin(2 * np.pi * 0.5 * t + phase)

    def turn(t: float) -> np.ndarray:
        return np.radians([3.0, 4.0, 5.0]) * eased(t / BEGIN_S) * np.sin(2 * np.pi * 0.4 * t + phase)

    def plan(t: float, wanted: References, control: WholeBody) -> None:
        wanted.com[:] = with_rates(place, t)
        vector, wanted.turning[0], wanted.turning[1] = with_rates(turn, t)
        mujoco.mju_axisAngle2Quat(
            wanted.orientation, vector / max(np.linalg.norm(vector), 1e-12), np.linalg.norm(vector)
        )

    return plan


def draw(robot: SimRobot) -> Callable[[float, References, WholeBody], None]:
    """The centre of mass moves over three feet, then the fourth draws a circle of 3 cm radius in the air."""
    size = robot.geometry.standing_height / REFERENCE_HEIGHT
    tracked = tracked_robot(robot)
    begin = np.array([0.0, 0.0, robot.geometry.standing_height]) + tracked.com
    end = begin.copy()
    end[:2] = robot.geometry.stance[1:, :2].mean(axis=0)
    lift_s, lifted = BEGIN_S + 0.2, np.full(3, np.nan)

    def path(t: float) -> np.ndarray:
        turn = 2 * np.pi * (t - lift_s - 0.5)
        circle = 0.03 * size * eased(2 * (t - lift_s - 0.5)) * np.array([np.cos(turn), np.sin(turn), 0.0])
        return lifted + np.array([0.0, 0.0, 0.08 * size]) * eased(2 * (t - lift_s)) + circle

    def plan(t: float, wanted: References, control: WholeBody) -> None:
        wanted.com[:] = with_rates(lambda t: begin + (end - begin) * eased(t / BEGIN_S), t)
        if t >= lift_s:
            if wanted.stance[0]:
                lifted[:] = control.terms.feet[0]
                wanted.stance[0] = False
            wanted.swing[0] = with_rates(path, t)

    return plan


@pytest.fixture(scope="module", params=PRESETS)
def robot(request: pytest.FixtureRequest) -> SimRobot:
    return build_robot(load_robot(request.param))


def test_body_sways_about_all_six_axes(robot: SimRobot) -> None:
    errors = walk(robot, 3.0, sway(robot))
    print(robot.geometry.name, errors)
    assert errors.com_mm.max() < 1.5
    assert errors.tilt_deg.max() < 0.6
    assert errors.torque_share < 0.6


def test_one_foot_draws_while_three_stand(robot: SimRobot) -> None:
    errors = walk(robot, 4.0, draw(robot))
    print(robot.geometry.name, errors)
    assert errors.com_mm.max() < 1.5
    assert errors.tilt_deg.max() < 0.6
    assert errors.foot_mm < 1.7
