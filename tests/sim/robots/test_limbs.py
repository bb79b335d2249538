"""Arms, tails and heads are held at their pose; what else lies about in a file is left there."""

import mujoco
import numpy as np
import pytest

from legtool.configs.robots import load_robot
from legtool.sim.robots.mjcf import PREFIX, load_mjcf

#: Positions of shoulder [rad] and gripper [m] in the keyframe.
SHOULDER, GRIPPER = 0.9, 0.03


def add_arm(spec: mujoco.MjSpec) -> None:
    """An arm of 3 kg in a turned frame, whose gripper a tendon and an equality tie to its shoulder; and a ball."""
    frame = spec.body("trunk").add_frame(pos=[0.1, 0, 0.05], quat=[0.9, 0, 0.1, 0.3])
    shoulder = spec.body("trunk").add_body(name="arm", pos=[0.1, 0, 0.1], quat=[0.8, 0.1, 0.2, 0])
    shoulder.set_frame(frame)
    shoulder.add_joint(name="shoulder", axis=[0, 1, 0.2], pos=[0.02, 0, 0])
    shoulder.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[0, 0, 0, 0.3, 0, 0], size=[0.03, 0, 0], mass=2.0)
    hand = shoulder.add_body(name="hand", pos=[0.3, 0, 0])
    hand.add_joint(name="gripper", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1, 0, 0])
    hand.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.03, 0, 0], mass=1.0)
    tendon = spec.add_tendon(name="cable")
    tendon.wrap_joint("shoulder", 1.0)
    tendon.wrap_joint("gripper", 2.0)
    tied = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1="gripper", name2="shoulder")
    tied.objtype = mujoco.mjtObj.mjOBJ_JOINT
    ball = spec.worldbody.add_body(name="ball", pos=[2, 0, 1])
    ball.add_freejoint()
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.1, 0, 0])


def add_stowed_arm(spec: mujoco.MjSpec) -> None:
    add_arm(spec)
    model = spec.compile()
    qpos = np.array(model.qpos0)
    qpos[model.joint("shoulder").qposadr[0]], qpos[model.joint("gripper").qposadr[0]] = SHOULDER, GRIPPER
    spec.add_key(name="stowed", qpos=qpos)


@pytest.mark.parametrize("stowed", [True, False])
def test_an_arm_is_held_as_in_the_first_keyframe_or_as_drawn(written, stowed: bool) -> None:
    path = written(add_stowed_arm if stowed else add_arm)
    robot = load_mjcf(path)
    assert robot.held == ("shoulder", "gripper")
    assert robot.model.nq == 19 and robot.model.ntendon == 0 and robot.model.neq == 0
    drawn = mujoco.MjModel.from_xml_path(str(path))
    wanted, found = mujoco.MjData(drawn), mujoco.MjData(robot.model)
    if stowed:
        mujoco.mj_resetDataKeyframe(drawn, wanted, 0)
    mujoco.mj_kinematics(drawn, wanted)
    robot.place(found)
    for _ in range(400):  # it falls, and the arm with it
        mujoco.mj_step(robot.model, found)
    mujoco.mj_kinematics(robot.model, found)

    def hand(model: mujoco.MjModel, data: mujoco.MjData, prefix: str) -> np.ndarray:
        trunk, tip = model.body(f"{prefix}trunk").id, model.body(f"{prefix}hand").id
        return data.xmat[trunk].reshape(3, 3).T @ (data.xpos[tip] - data.xpos[trunk])

    np.testing.assert_allclose(hand(robot.model, found, PREFIX), hand(drawn, wanted, ""), atol=1e-9)


def test_the_mass_of_what_is_held_stays_and_is_the_trunks(written) -> None:
    robot, bare = load_mjcf(written(add_arm, "arm.xml")), load_mjcf(written())
    assert robot.mass == pytest.approx(bare.mass + 3.0)
    assert robot.trunk_mass == pytest.approx(bare.trunk_mass + 3.0)
    assert np.linalg.norm(robot.trunk_com - bare.trunk_com) > 0.01
    assert bare.held == ()
    np.testing.assert_allclose(robot.geometry.hips, load_robot("aliengo").geometry().hips, atol=1e-6)


def test_what_does_not_hang_on_the_robot_is_left_out(written) -> None:
    model = load_mjcf(written(add_arm)).model
    assert [model.body(k).name for k in range(model.nbody) if model.body(k).name.endswith("ball")] == []
