from __future__ import annotations

import numpy as np

from legtool.configs.sweep import Noise
from legtool.sim.controllers.trot.trot import TrotController
from legtool.sim.robots.robot import SimRobot
from legtool.sim.robots.state import RobotState
from legtool.sim.sensors.state_noise import sense_errors
from legtool.sim.walks.episode import Pushes, run_episode
from legtool.sim.walks.schedule import Schedule

STAND = Schedule(np.array([0.0]), np.zeros((1, 3)), 2.0)


class Limp:
    """A controller that gives up."""

    def reset(self, state: RobotState) -> None:
        pass

    def step(self, state: RobotState, command: np.ndarray) -> np.ndarray:
        return np.zeros(12)

    def accepts_command(self) -> bool:
        return True


def test_a_fall_ends_the_episode(aliengo: SimRobot) -> None:
    episode = run_episode(aliengo, Limp(), STAND)
    assert episode.fell
    assert 0.05 < episode.duration_s < 1.5
    assert len(episode.recording) == len(episode.joint_positions)


def test_rows_come_at_the_set_rate_from_zero_on(aliengo: SimRobot) -> None:
    for rate in (100, 200):
        recording = run_episode(aliengo, TrotController(aliengo), STAND, record_rate_hz=rate).recording
        assert recording.stamps_ns[0] == 0
        assert (np.diff(recording.stamps_ns) == 1_000_000_000 // rate).all()
        assert len(recording) == 2 * rate
        recording_feet = aliengo.geometry.stance
        np.testing.assert_allclose(recording.feet_base[0], recording_feet, atol=1e-9)


def test_contact_forces_add_up_to_the_weight(any_robot: SimRobot) -> None:
    recording = run_episode(any_robot, TrotController(any_robot), STAND).recording
    assert recording.contact_force is not None
    weight = recording.contact_force[200:].sum(axis=1).mean()
    assert abs(weight / (any_robot.mass * 9.81) - 1) < 0.01


def test_velocity_is_given_in_the_base_frame(aliengo: SimRobot) -> None:
    schedule = Schedule(np.array([0.0, 0.5]), np.array([[0.0, 0, 0], [0.5, 0, 0]]), 4.0)
    recording = run_episode(aliengo, TrotController(aliengo), schedule, yaw=2.0).recording
    steady = recording.stamps_ns > 2_000_000_000
    assert abs(recording.velocity_base[steady, 0].mean() - 0.5) < 0.05
    travelled = recording.position_world[-1] - recording.position_world[steady][0]
    assert abs(np.arctan2(travelled[1], travelled[0]) - 2.0) < 0.15


def test_a_push_changes_the_velocity_at_once(aliengo: SimRobot) -> None:
    pushes = Pushes(np.array([1.0]), np.array([[0.3, 0.0]]))
    recording = run_episode(aliengo, TrotController(aliengo), STAND, pushes=pushes).recording
    before, after = np.searchsorted(recording.stamps_ns, [990_000_000, 1_005_000_000])
    assert 0.2 < recording.velocity_base[after, 0] - recording.velocity_base[before, 0] < 0.31


def test_the_command_in_force_stands_in_its_row(aliengo: SimRobot) -> None:
    schedule = Schedule(np.array([0.0, 0.5, 2.0]), np.array([[0, 0, 0], [0.3, 0, 0], [0.6, 0, 0.1]]), 3.0)
    recording = run_episode(aliengo, TrotController(aliengo), schedule).recording
    changes = np.flatnonzero(np.abs(np.diff(recording.command, axis=0)).any(axis=1)) + 1
    assert len(changes) == 2
    assert recording.stamps_ns[changes[0]] == 500_000_000, "a standing robot is told at once"
    assert 0 <= recording.stamps_ns[changes[1]] - 2_000_000_000 < 400_000_000, "a walking one before its next step"


def test_errors_have_the_set_spread_and_wander() -> None:
    noise = Noise(velocity=0.05, joint_position=0.002, correlation_s=0.2)
    errors = sense_errors(noise, np.random.default_rng(0), 40_000, rate_hz=400.0, weight=200.0)
    velocity, joints = errors[:, 6], errors[:, 12]
    assert abs(velocity.std() / 0.05 - 1) < 0.15 and abs(joints.std() / 0.002 - 1) < 0.05
    lag = np.corrcoef(velocity[80:], velocity[:-80])[0, 1]
    assert abs(lag - np.exp(-1)) < 0.15
    assert abs(np.corrcoef(joints[1:], joints[:-1])[0, 1]) < 0.05
