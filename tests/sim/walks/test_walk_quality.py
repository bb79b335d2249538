"""What a walk is measured by: velocity against command, shapes that touch, limits that are met, MuJoCo's warnings."""

import logging
from pathlib import Path

import mujoco
import numpy as np
import pytest

from legtool.configs.mjcf import MjcfNames
from legtool.sim.controllers.trot.trot import TrotController
from legtool.sim.robots.mjcf import load_mjcf
from legtool.sim.robots.physics import flat_world
from legtool.sim.robots.robot import SimRobot
from legtool.sim.robots.state import RobotState
from legtool.sim.walks.episode import Pushes, run_episode
from legtool.sim.walks.schedule import Schedule

FORWARD = Schedule(np.array([0.0, 0.5]), np.array([[0.0, 0, 0], [0.6, 0, 0]]), 4.0)


class Half(TrotController):
    """Walks at half the speed that it is told."""

    def step(self, state: RobotState, command: np.ndarray) -> np.ndarray:
        return super().step(state, 0.5 * command)


class Explosive(TrotController):
    """Asks for torques that no motion follows from."""

    def step(self, state: RobotState, command: np.ndarray) -> np.ndarray:
        return np.full(12, 1e14)


def mean(measured, name: str) -> float:
    total, of = measured[name]
    return total / of


def test_velocity_is_compared_with_commands_that_were_held_for_a_while(aliengo: SimRobot) -> None:
    right, slow = (run_episode(aliengo, cls(aliengo), FORWARD).measured for cls in (TrotController, Half))
    assert mean(right, "velocity_error") < 0.04
    assert mean(slow, "velocity_error") == pytest.approx(0.3, abs=0.05)
    walking = 2.5  # from the second after the command on; of the first one no second is left
    assert right["velocity_error"].of == pytest.approx(walking, abs=0.02)
    pushed = run_episode(
        aliengo, TrotController(aliengo), FORWARD, pushes=Pushes(np.array([2.0]), np.array([[0.1, 0.0]]))
    ).measured
    assert pushed["velocity_error"].of == pytest.approx(walking - 1.0, abs=0.02)


def test_a_shape_that_bears_load_beside_the_foot_is_named_with_its_share(written) -> None:
    def spur(spec: mujoco.MjSpec) -> None:
        spec.body("FL_knee").add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.03, 0, 0], pos=[0, 0.02, -0.25])

    path = written(spur)
    stand = Schedule(np.array([0.0]), np.zeros((1, 3)), 1.0)
    found, without = (
        run_episode(robot, TrotController(robot), stand).measured
        for robot in (load_mjcf(path, MjcfNames(no_contact=names)) for names in ((), ("FL_knee",)))
    )
    assert 0.1 < mean(found, "load.shank FL_knee (sphere)") < 0.35
    assert mean(found, "touching.shank FL_knee (sphere)") > 0.9
    assert mean(found, "load.trunk") == 0.0
    assert "load.shank FL_knee (sphere)" not in without
    assert sum(mean(without, name) for name in without if name.startswith("load.")) == 0.0


def test_torques_at_their_limit_and_joints_at_theirs_are_counted(written) -> None:
    def weak(spec: mujoco.MjSpec) -> None:
        for leg in ("FL", "FR", "RL", "RR"):
            joint = spec.joint(f"{leg}_knee_joint")
            joint.actfrclimited, joint.actfrcrange = mujoco.mjtLimited.mjLIMITED_TRUE, [-8, 8]

    robot = load_mjcf(written(weak))
    measured = run_episode(robot, TrotController(robot), FORWARD).measured
    assert mean(measured, "at_torque_limit.knee") > 0.5 > mean(measured, "at_torque_limit.hip")


def test_legs_that_are_stretched_straight_are_counted(written, aliengo: SimRobot) -> None:
    def unlimited(spec: mujoco.MjSpec) -> None:
        for leg in ("FL", "FR", "RL", "RR"):
            spec.joint(f"{leg}_knee_joint").limited = mujoco.mjtLimited.mjLIMITED_FALSE

    tall = load_mjcf(written(unlimited), MjcfNames(standing_height=0.51))
    assert mean(run_episode(tall, TrotController(tall), FORWARD).measured, "straight") > 0.2
    assert mean(run_episode(aliengo, TrotController(aliengo), FORWARD).measured, "straight") == 0.0


def test_feet_on_ice_slide(aliengo: SimRobot, written) -> None:
    ice = load_mjcf(written(), world=flat_world(0.08))
    slippery = run_episode(ice, TrotController(ice), FORWARD).measured
    firm = run_episode(aliengo, TrotController(aliengo), FORWARD).measured
    assert mean(slippery, "sliding") > 0.1 > 0.02 > mean(firm, "sliding")


def test_warnings_of_mujoco_are_counted_and_logged_and_nothing_else_is_written(
    aliengo: SimRobot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, capfd
) -> None:
    monkeypatch.chdir(tmp_path)
    with caplog.at_level(logging.WARNING, "legtool.mujoco"):
        episode = run_episode(aliengo, Explosive(aliengo), FORWARD)
    assert episode.fell and episode.warnings.get("badqacc", 0) >= 1
    assert any("QACC" in record.getMessage() for record in caplog.records)
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr().out == ""
