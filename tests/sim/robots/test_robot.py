from __future__ import annotations

import mujoco
import numpy as np

from legtool.configs.robots import load_robot
from legtool.sim.robots.leg import leg_terms
from legtool.sim.robots.physics import TERRAIN_CONTACT, flat_world
from legtool.sim.robots.robot import SimRobot, build_robot
from legtool_runtime.robot import LEGS


def test_model_weighs_what_the_settings_say() -> None:
    for name, mass in (("aliengo", 22.64), ("go2", 15.02), ("hyq", 89.8)):
        settings = load_robot(name)
        robot = build_robot(settings)
        assert abs(robot.mass - mass) < 0.05
        assert abs(robot.mass - settings.total_mass) < 1e-3
        assert abs(robot.trunk_mass + robot.link_mass.sum() - robot.mass) < 1e-9


def test_feet_of_the_model_are_where_the_geometry_puts_them(any_robot: SimRobot) -> None:
    data = mujoco.MjData(any_robot.model)
    any_robot.place(data)
    rest, within_reach = any_robot.geometry.joints(any_robot.geometry.stance)
    assert within_reach.all()
    low, high = any_robot.geometry.joint_limits[..., 0], any_robot.geometry.joint_limits[..., 1]
    assert (rest > low).all() and (rest < high).all()
    angles = rest + np.random.default_rng(0).uniform(-0.3, 0.3, (4, 3))
    data.qpos[any_robot.qpos] = any_robot.joints_to_qpos(angles)
    mujoco.mj_kinematics(any_robot.model, data)
    feet = data.site_xpos[[any_robot.model.site(f"{leg}_force").id for leg in LEGS]]
    expected = any_robot.geometry.feet(angles) + np.array([0, 0, any_robot.geometry.standing_height])
    np.testing.assert_allclose(feet, expected, atol=1e-9)


def test_leg_terms_agree_with_mujoco(any_robot: SimRobot) -> None:
    model, data = any_robot.model, mujoco.MjData(any_robot.model)
    rng = np.random.default_rng(1)
    any_robot.place(data)
    rest, _ = any_robot.geometry.joints(any_robot.geometry.stance)
    angles = rest + rng.uniform(-0.4, 0.4, (4, 3))
    data.qpos[any_robot.qpos] = any_robot.joints_to_qpos(angles)
    tilt = np.array([0.97, 0.1, -0.2, 0.05])
    data.qpos[3:7] = tilt / np.linalg.norm(tilt)
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, data.qpos[3:7])
    gravity = rotation.reshape(3, 3).T @ [0, 0, -9.81]
    chain = np.stack(
        [
            any_robot.geometry.abduction_offset,
            any_robot.geometry.thigh_length,
            any_robot.geometry.shank_length,
        ],
        axis=1,
    )
    moment = any_robot.trunk_mass * any_robot.trunk_com
    for leg in range(4):
        torque, inertia = np.empty(3), np.empty((3, 3))
        leg_terms(
            any_robot.geometry.hips[leg],
            chain[leg],
            angles[leg],
            any_robot.link_mass[leg],
            any_robot.link_com[leg],
            any_robot.link_inertia[leg],
            gravity,
            moment,
            torque,
            inertia,
        )
        dof = any_robot.dof[leg]
        np.testing.assert_allclose(torque, data.qfrc_bias[dof], atol=1e-6)
        np.testing.assert_allclose(inertia + np.diag(any_robot.armature[leg]), mass[np.ix_(dof, dof)], atol=1e-6)
    com = rotation.reshape(3, 3) @ (moment / any_robot.mass) + data.qpos[:3]
    np.testing.assert_allclose(com, data.subtree_com[model.body("trunk").id], atol=1e-6)


def test_robot_is_put_into_a_world_that_holds_terrain() -> None:
    world = flat_world()
    world.worldbody.add_geom(
        name="step", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.2, 1, 0.03], pos=[0, 0, 0.03], **TERRAIN_CONTACT
    )
    robot = build_robot(load_robot("aliengo"), world)
    data = mujoco.MjData(robot.model)
    robot.place(data, position=np.array([0.24, 0.0, 0.44]))
    for _ in range(300):
        mujoco.mj_step(robot.model, data)
    touched = {robot.model.geom(geom).name for contact in data.contact for geom in contact.geom}
    assert "step" in touched and "floor" in touched
