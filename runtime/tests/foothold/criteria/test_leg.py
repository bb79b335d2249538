import numpy as np
import pytest

from legtool_runtime.foothold import Gait, Tuple
from legtool_runtime.foothold.criteria.gait_cycle import cycle_of
from legtool_runtime.foothold.criteria.leg import bend_leg, chain, reach_foot
from legtool_runtime.robot import leg_forward, leg_inverse
from legtool_runtime.rotations import from_angles


def plain(robot, leg, hip, trunk, foot):
    """Margin, knee and thigh axis by the kinematics of :mod:`legtool_runtime.robot`, for a trunk (3, 3) at a hip."""
    lengths = robot.abduction_offset[leg], robot.thigh_length[leg], robot.shank_length[leg]
    inside, angles, knee, axis = trunk.T @ (foot - hip), np.empty(3), np.empty(3), np.empty(3)
    reached = leg_inverse(np.zeros(3), *lengths, robot.knee_sign[leg], inside, angles)
    leg_forward(np.zeros(3), *lengths[:2], 0.0, angles, knee)
    leg_forward(np.zeros(3), lengths[0], 0.0, 0.0, angles, axis)
    low, high = robot.joint_limits[leg].T
    lateral = inside[1] ** 2 + inside[2] ** 2 - lengths[0] ** 2
    margin = min(lateral, np.sin(angles[2]) ** 2, (np.cos(angles - (low + high) / 2) - np.cos((high - low) / 2)).min())
    return margin if reached else -1.0, hip + trunk @ knee, hip + trunk @ axis


@pytest.mark.parametrize("tilt", [0.0, 0.5])
def test_legs_are_bent_as_by_the_plain_kinematics_whatever_the_trunks_attitude(robots, tilt):
    rng = np.random.default_rng(0)
    within = 0
    for n in range(60):
        robot, leg = robots[n % 2], int(rng.integers(4))
        roll, pitch = rng.uniform(-tilt, tilt, 2)
        twist = rng.normal(scale=[0.3, 0.1, 0.05, 0.1, 0.1, 0.5])
        how = {"base_twist": twist, "gait": Gait(), "nominal": (0.05, -0.02), "roll": roll, "pitch": pitch}
        t = Tuple(np.zeros((33, 33)), leg=leg, hip_height=0.55, **how)
        cycle, tau = cycle_of(robot, t, 0.12), rng.uniform(-0.3, 0.3)
        trunk = from_angles(roll, pitch, twist[5] * tau)
        velocity = twist[:3] + np.cross(twist[3:], from_angles(roll, pitch, 0.0) @ robot.hips[leg])
        hip = np.array([-0.05, 0.02, 0.55]) + velocity * tau
        feet = np.stack([rng.uniform(-0.5, 0.4, 32), rng.uniform(-0.3, 0.3, 32), rng.uniform(-0.1, 0.2, 32)])
        feet = feet.astype(np.float32)
        margin, links, reach = np.ones(32, np.float32), np.empty((6, 32), np.float32), np.ones(32, np.float32)
        bend_leg(chain(robot, leg), cycle, 0.55, tau, feet, links, margin)
        reach_foot(chain(robot, leg), cycle, 0.55, tau, feet, reach)
        assert reach == pytest.approx(margin, abs=1e-5)
        for j in range(32):
            wanted, knee, axis = plain(robot, leg, hip, trunk, feet[:, j].astype(float))
            assert (margin[j] >= 0) == (wanted >= 0) or abs(wanted) < 1e-4
            if wanted >= 0:
                within += 1
                assert margin[j] == pytest.approx(wanted, abs=1e-4)
                assert links[:3, j] == pytest.approx(knee, abs=1e-4)
                assert links[3:, j] == pytest.approx(axis, abs=1e-4)
    assert within > 300
