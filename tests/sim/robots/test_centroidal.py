"""The momentum that swings are optimised with, against MuJoCo's."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from legtool.configs.robots import load_robot
from legtool.sim.robots.robot import build_robot
from legtool.sim.robots.tracked import tracked_robot
from legtool_runtime.rotations import rotation_of
from legtool_runtime.search.swings.centroidal import fill_tree, make_tree


@pytest.mark.parametrize("name", ["anymal_c", "go2"])
def test_centroidal_momentum_is_mujocos(name: str) -> None:
    robot = build_robot(load_robot(name))
    tracked, data = tracked_robot(robot), mujoco.MjData(robot.model)
    model, tree, rng = tracked.model(), make_tree(), np.random.default_rng(0)
    rest, _ = robot.geometry.joints(robot.geometry.stance)
    base = int(robot.model.jnt_bodyid[0])
    for _ in range(10):
        orientation = rng.normal(size=4)
        orientation /= np.linalg.norm(orientation)
        joints, velocity = rest + rng.uniform(-1, 1, (4, 3)), rng.normal(size=18)
        data.qpos[:3], data.qpos[3:7] = rng.normal(size=3), orientation
        data.qpos[robot.qpos] = robot.joints_to_qpos(joints)
        data.qvel[:6] = velocity[:6]
        data.qvel[robot.dof] = robot.joint_sign * velocity[6:].reshape(4, 3)
        mujoco.mj_forward(robot.model, data)
        mujoco.mj_subtreeVel(robot.model, data)
        rotation = rotation_of(orientation)
        fill_tree(model, joints.ravel(), tree)
        angular = rotation @ (tree.locked @ velocity[3:6] + tree.rate.T @ velocity[6:])
        com_velocity = velocity[:3] + rotation @ (np.cross(velocity[3:6], tree.com) + tree.com_rate.T @ velocity[6:])
        np.testing.assert_allclose(angular, data.subtree_angmom[base], rtol=0, atol=1e-9)
        np.testing.assert_allclose(com_velocity, data.subtree_linvel[base], rtol=0, atol=1e-9)
        np.testing.assert_allclose(data.qpos[:3] + rotation @ tree.com, data.subtree_com[base], rtol=0, atol=1e-9)
