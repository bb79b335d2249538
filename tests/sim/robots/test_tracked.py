from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from legtool.configs.robots import load_robot
from legtool.sim.robots.mjcf import load_mjcf
from legtool.sim.robots.robot import SimRobot, add_robot, build_robot
from legtool.sim.robots.tracked import tracked_robot
from legtool_runtime.robot import LEGS
from legtool_runtime.tracking.dynamics import FullState, dynamics_terms, make_terms

PRESETS = ("aliengo", "go2", "hyq", "hyqreal", "anymal_c")


def check_against_mujoco(robot: SimRobot, feet: list[int], tolerance: float) -> None:
    """Every term at random states; ``feet`` are the sites in their centres."""
    tracked = tracked_robot(robot)
    model, data = tracked.model(), mujoco.MjData(robot.model)
    terms, rng = make_terms(), np.random.default_rng(0)
    rest, _ = robot.geometry.joints(robot.geometry.stance)
    mass, jacobian, rate = np.zeros((18, 18)), np.zeros((3, 18)), np.zeros((3, 18))

    def agree(ours: np.ndarray, theirs: np.ndarray) -> None:
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=tolerance * max(1.0, np.abs(theirs).max()))

    for _ in range(10):
        orientation, normals = rng.normal(size=4), rng.normal(size=(4, 3))
        orientation /= np.linalg.norm(orientation)
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        state = FullState(rng.normal(size=3), orientation, rest + rng.uniform(-1, 1, (4, 3)), 3 * rng.normal(size=18))
        data.qpos[:3], data.qpos[3:7] = state.position, orientation
        data.qpos[robot.qpos] = robot.joints_to_qpos(state.joints)
        data.qvel[:6] = state.velocity[:6]
        data.qvel[robot.dof] = robot.joint_sign * state.velocity[6:].reshape(4, 3)
        mujoco.mj_forward(robot.model, data)
        mujoco.mj_subtreeVel(robot.model, data)
        mujoco.mj_fullM(robot.model, data, mass)
        order = np.concatenate([np.arange(6), robot.dof.ravel()])
        sign = np.concatenate([np.ones(6), robot.joint_sign.ravel()])
        dynamics_terms(model, state, normals, terms)
        agree(terms.mass, mass[np.ix_(order, order)] * np.outer(sign, sign))
        agree(terms.bias, data.qfrc_bias[order] * sign)
        agree(terms.com, data.subtree_com[1])
        agree(terms.com_velocity, data.subtree_linvel[1])
        agree(terms.momentum, data.subtree_angmom[1])
        for leg, site in enumerate(feet):
            body, centre = robot.model.site_bodyid[site], data.site_xpos[site]
            agree(terms.feet[leg], centre)
            mujoco.mj_jac(robot.model, data, jacobian, None, centre, body)
            agree(terms.jacobian[leg], jacobian[:, order] * sign)
            agree(terms.feet_velocity[leg], jacobian @ data.qvel)
            mujoco.mj_jacDot(robot.model, data, rate, None, centre, body)
            agree(terms.drift[leg], rate @ data.qvel)
            contact = centre - robot.geometry.foot_radius * normals[leg]
            mujoco.mj_jac(robot.model, data, jacobian, None, contact, body)
            agree(terms.contact_jacobian[leg], jacobian[:, order] * sign)
            agree(terms.contact_velocity[leg], jacobian @ data.qvel)


@pytest.mark.parametrize("name", PRESETS)
def test_dynamics_are_those_of_mujoco(name: str) -> None:
    robot = build_robot(load_robot(name))
    check_against_mujoco(robot, [robot.model.site(f"{leg}_force").id for leg in LEGS], 1e-9)


@pytest.mark.parametrize("name", PRESETS)
def test_standing_robot_has_the_simulators_mass_centre_and_inertia(name: str) -> None:
    robot = build_robot(load_robot(name))
    tracked = tracked_robot(robot)
    assert abs(tracked.mass - robot.mass) < 1e-9
    np.testing.assert_allclose(tracked.com, robot.com, atol=1e-12)
    np.testing.assert_allclose(tracked.inertia, robot.inertia, atol=1e-11)


def test_robot_of_an_mjcf_file_with_turned_joints_has_its_dynamics(tmp_path: Path) -> None:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    add_robot(spec, load_robot("anymal_c"))
    for joint in spec.joints:
        if joint.name.startswith("RR"):
            joint.axis, joint.range = -np.array(joint.axis), -np.array(joint.range)[::-1]
    spec.compile()
    path = tmp_path / "dog.xml"
    path.write_text(spec.to_xml(), encoding="utf-8")
    robot = load_mjcf(path)
    assert (robot.joint_sign[3] == -1).all()
    # Chain and masses of a file are measured to the digits it is written with.
    check_against_mujoco(robot, [robot.model.site(f"robot/legtool_force_{leg}").id for leg in LEGS], 1e-4)
