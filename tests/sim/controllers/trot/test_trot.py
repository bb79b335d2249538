from __future__ import annotations

import numpy as np
import pytest

from legtool.configs.controller import TrotSettings
from legtool.configs.robots import load_robot
from legtool.configs.sweep import CONTROL_RATE_HZ, Noise
from legtool.sim.controllers.trot.trot import TrotController, parameters
from legtool.sim.robots.robot import SimRobot, build_robot
from legtool.sim.robots.state import RobotState
from legtool.sim.walks.episode import Episode, Pushes, run_episode
from legtool.sim.walks.schedule import Schedule, random_schedule


def walk(robot: SimRobot, commands: list[list[float]], times: list[float], duration_s: float) -> Episode:
    return run_episode(robot, TrotController(robot), Schedule(np.array(times), np.array(commands), duration_s))


class Witness(TrotController):
    """Notes what the controller says of itself at every tick."""

    def __init__(self, robot: SimRobot) -> None:
        super().__init__(robot)
        self.ticks: list[tuple[bool, int, float, bool, int]] = []

    def step(self, state: RobotState, command: np.ndarray) -> np.ndarray:
        torque = super().step(state, command)
        self.ticks.append(
            (self.transition, self.swing_pair, float(self.command[0]), self.stepping, int(self.stance_legs.sum()))
        )
        return torque


def test_stands_still_without_a_command(any_robot: SimRobot) -> None:
    episode = walk(any_robot, [[0, 0, 0]], [0], 3.0)
    assert not episode.fell
    moved = np.abs(episode.recording.position_world - episode.recording.position_world[0])
    # It shifts its centre of mass, which need not lie below the trunk's origin, to between its feet.
    assert moved[:, :2].max() < 0.03 and moved[:, 2].max() < 0.02
    assert (episode.recording.contact_force[100:] > 0).all()


@pytest.mark.parametrize("command", [[0.5, 0.0, 0.0], [-0.3, 0.0, 0.0], [0.0, 0.2, 0.0], [0.3, 0.0, 0.5]])
def test_follows_its_command(any_robot: SimRobot, command: list[float]) -> None:
    episode = walk(any_robot, [[0, 0, 0], command], [0, 0.5], 6.0)
    steady = episode.recording.stamps_ns > 3_000_000_000
    assert not episode.fell
    reached = [*episode.recording.velocity_base[steady, :2].mean(axis=0), episode.recording.yaw_rate[steady].mean()]
    np.testing.assert_allclose(reached, command, atol=0.06)


def test_stops_and_stands_again(any_robot: SimRobot) -> None:
    episode = walk(any_robot, [[0, 0, 0], [0.8, 0, 0.3], [0, 0, 0]], [0, 0.5, 3.0], 7.0)
    last = episode.recording.stamps_ns > 6_000_000_000
    assert not episode.fell
    assert np.abs(episode.recording.velocity_base[last]).max() < 0.03
    assert (episode.recording.contact_force[last] > 0).all()


def test_takes_up_a_command_at_the_end_of_full_stance_and_holds_it(aliengo: SimRobot) -> None:
    witness = Witness(aliengo)
    schedule = random_schedule(8.0, seed=3, hold_s=(0.2, 0.8))
    assert not run_episode(aliengo, witness, schedule).fell
    transition, pair, held, stepping, standing = (np.array(column) for column in zip(*witness.ticks, strict=True))
    changed = np.flatnonzero(np.diff(held)) + 1
    assert len(changed) > 5
    assert transition[changed].all()
    begins = np.flatnonzero(transition)
    assert (standing[begins - 1] == 4).all(), "a step begins from full stance"
    assert (np.abs(np.diff(pair[begins])) == 1).all(), "pairs take turns"
    settings = TrotSettings()
    ticks = round((settings.swing_s + settings.full_stance_s) * CONTROL_RATE_HZ)
    assert np.median(np.diff(begins)) == ticks
    assert stepping[begins].all()


def test_a_step_depends_on_nothing_before_it(aliengo: SimRobot) -> None:
    # Two pasts, one present: after a while at the same command the gait is the same, so nothing was integrated up.
    ends = []
    for past in (0.2, 0.9):
        episode = walk(aliengo, [[0, 0, 0], [past, 0, 0], [0.5, 0, 0]], [0, 0.5, 4.0], 9.0)
        steady = episode.recording.stamps_ns > 6_000_000_000
        ends.append(episode.recording.velocity_base[steady, 0].mean())
    assert abs(ends[0] - ends[1]) < 0.01


def test_withstands_pushes_from_all_sides(any_robot: SimRobot) -> None:
    for angle in np.arange(0.0, 2 * np.pi, np.pi / 2):
        change = 0.5 * np.array([[np.cos(angle), np.sin(angle)]])
        schedule = Schedule(np.array([0.0, 0.5]), np.array([[0.0, 0, 0], [0.4, 0, 0]]), 4.0)
        pushed = run_episode(
            any_robot, TrotController(any_robot), schedule, pushes=Pushes(np.array([2.0 + angle / 20]), change)
        )
        assert not pushed.fell


def test_walks_on_its_own_noisy_estimate(any_robot: SimRobot) -> None:
    episode = run_episode(
        any_robot,
        TrotController(any_robot),
        random_schedule(20.0, seed=5),
        noise=Noise(),
        rng=np.random.default_rng(5),
    )
    assert not episode.fell and episode.duration_s == 20.0


@pytest.mark.slow
def test_never_falls_in_ten_minutes_of_random_commands(any_robot: SimRobot) -> None:
    for seed in range(10):
        schedule = random_schedule(60.0, seed=100 + seed)
        episode = run_episode(
            any_robot, TrotController(any_robot), schedule, noise=Noise(), rng=np.random.default_rng(seed)
        )
        assert not episode.fell


def test_presets_walk_by_the_settings_as_they_are(any_robot: SimRobot) -> None:
    record, settings = parameters(any_robot, TrotSettings())[0], TrotSettings()
    assert (record["compensated"] == settings.friction_compensation).all() and (record["friction_rate"] == 0.5).all()
    assert (record["damping"] == any_robot.joint_damping).all() and record["velocity_trim"] == settings.velocity_trim


@pytest.mark.parametrize(("friction", "damping"), [(0.0, 0.0), (4.0, 0.2), (0.35, 3.0)])
def test_drag_in_the_joints_hardly_slows_it_whatever_there_is_of_it(friction: float, damping: float) -> None:
    """An Aliengo has 0.35 Nm and 0.2 Nm s: compensated alike it was 0.07 m/s and 0.085 rad/s too slow with 4 Nm."""
    robot = build_robot(load_robot("aliengo").replace(joint_friction=friction, joint_damping=damping))
    episode = walk(robot, [[0, 0, 0], [0.6, 0.1, 0.3]], [0, 0.5], 5.0)
    steady = episode.recording.stamps_ns > 2_500_000_000
    assert not episode.fell
    reached = [*episode.recording.velocity_base[steady, :2].mean(axis=0), episode.recording.yaw_rate[steady].mean()]
    np.testing.assert_allclose(reached, [0.6, 0.1, 0.3], atol=0.03)
