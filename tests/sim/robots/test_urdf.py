"""Robots from URDF files: fixed links are lumped, and the legs are found as in MJCF files."""

import importlib.metadata
import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest

from legtool.configs.mjcf import MjcfNames
from legtool.configs.robots import load_robot
from legtool.errors import RobotError
from legtool.sim.robots.mjcf import find_mjcf, load_mjcf
from legtool.sim.robots.robot import build_robot
from legtool.sim.robots.urdf import read_urdf

ARM = """<robot name="arm">
  <link name="base"><inertial><origin xyz="0 0 0.1"/><mass value="2"/>
    <inertia ixx="0.2" iyy="0.3" izz="0.4" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://nowhere/base.dae"/></geometry></visual></link>
  <link name="box"><inertial><origin xyz="0.5 0 0" rpy="0 0 1.5707963267948966"/><mass value="6"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="0.2 0.4 0.6"/></geometry></collision></link>
  <link name="empty"/>
  <link name="tip"><inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1"/></inertial>
    <collision><origin xyz="0 0 -0.3"/><geometry><sphere radius="0.05"/></geometry></collision></link>
  <joint name="bolted" type="fixed"><parent link="base"/><child link="box"/><origin xyz="0 1 0"/></joint>
  <joint name="hung" type="fixed"><parent link="box"/><child link="empty"/>
    <origin xyz="0 0 -0.2" rpy="0 1.5707963 0"/></joint>
  <joint name="hinge" type="KIND"><parent link="empty"/><child link="tip"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="2" effort="80"/><dynamics damping="0.5" friction="0.25"/></joint>
</robot>"""
ANYMAL = "example_robot_data:anymal_c"


def arm(tmp_path: Path, kind: str = "revolute") -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(ARM.replace("KIND", kind))
    return path


def test_links_that_are_fixed_to_each_other_are_one_body(tmp_path: Path) -> None:
    model = read_urdf(arm(tmp_path)).compile()
    base = model.body("base")
    assert model.nbody == 3 and float(base.mass[0]) == pytest.approx(8.0)
    centre = (2 * np.array([0, 0, 0.1]) + 6 * np.array([0.5, 1.0, 0])) / 8
    assert base.ipos == pytest.approx(centre)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    axes = data.ximat[base.id].reshape(3, 3)
    wanted = np.diag([0.2, 0.3, 0.4]) + np.diag([0.02, 0.01, 0.03])  # the box's axes are turned by 90 degrees
    for mass, place in ((2, [0, 0, 0.1]), (6, [0.5, 1.0, 0])):
        arm_ = np.array(place) - centre
        wanted += mass * (arm_ @ arm_ * np.eye(3) - np.outer(arm_, arm_))
    assert axes @ np.diag(model.body_inertia[base.id]) @ axes.T == pytest.approx(wanted)


def test_joints_and_shapes_lie_where_the_file_has_them(tmp_path: Path) -> None:
    model = read_urdf(arm(tmp_path)).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    hinge, ball = model.joint("hinge"), model.geom("tip")
    assert data.xanchor[hinge.id] == pytest.approx([0, 1, -0.2])
    assert data.geom_xpos[ball.id] == pytest.approx([-0.3, 1, -0.2], abs=1e-6)
    assert hinge.range == pytest.approx([-1, 2]) and model.jnt_actfrcrange[hinge.id] == pytest.approx([-80, 80])
    assert model.dof_damping[0] == pytest.approx(0.5) and model.dof_frictionloss[0] == pytest.approx(0.25)
    boxes = model.geom_size[model.geom_type == mujoco.mjtGeom.mjGEOM_BOX]
    assert boxes == pytest.approx(np.array([[0.1, 0.2, 0.3]]))


def test_a_slide_moves_along_its_axis(tmp_path: Path) -> None:
    model = read_urdf(arm(tmp_path, "prismatic")).compile()
    assert model.jnt_type[0] == mujoco.mjtJoint.mjJNT_SLIDE and model.joint("hinge").range == pytest.approx([-1, 2])


def test_a_root_that_floats_in_a_world_is_the_trunk(tmp_path: Path) -> None:
    path = arm(tmp_path)
    joint = '<joint name="free" type="floating"><parent link="world"/><child link="base"/></joint>'
    path.write_text(path.read_text().replace("</robot>", f'<link name="world"/>{joint}</robot>'))
    model = read_urdf(path).compile()
    assert [model.body(k).name for k in range(model.nbody)] == ["world", "base", "tip"] and model.njnt == 1


def test_an_inertia_that_breaks_the_triangle_inequality_is_balanced(tmp_path: Path) -> None:
    path = arm(tmp_path)
    path.write_text(path.read_text().replace('ixx="0.1" iyy="0.1" izz="0.1"', 'ixx="0.1" iyy="0.1" izz="0.201"'))
    assert read_urdf(path).compile().body("tip").inertia == pytest.approx([0.201, 0.1005, 0.1005], abs=1e-6)


def test_a_foot_that_is_drawn_as_a_mesh_touches_with_a_sphere(tmp_path: Path) -> None:
    path = arm(tmp_path)
    text = path.read_text().replace('"tip"', '"left_foot"')
    path.write_text(text.replace('<sphere radius="0.05"/>', '<mesh filename="package://nowhere/foot.stl"/>'))
    foot = read_urdf(path).compile().geom("left_foot")
    assert foot.type == mujoco.mjtGeom.mjGEOM_SPHERE and foot.size[0] == 0.02


def test_what_is_no_urdf_of_hinges_and_slides_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"joint hinge is planar; expected one of: fixed, revolute, .*prismatic"):
        read_urdf(arm(tmp_path, "planar"))
    broken = tmp_path / "broken.urdf"
    broken.write_text("<robot><link/></robot>")
    with pytest.raises(RobotError, match="not a URDF file"):
        load_mjcf(broken)


def test_a_robot_of_a_package_that_is_not_there_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> None:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "files", absent)
    with pytest.raises(RobotError, match="pip install --no-deps example-robot-data"):
        find_mjcf(ANYMAL)


def test_robots_of_the_package_are_found_by_their_directories(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    class File(type(Path())):
        def locate(self) -> Path:
            return tmp_path / self

    names = ("b_description/urdf/b_arm.urdf", "b_description/urdf/b.urdf", "c_simple_description/robots/d.urdf")
    monkeypatch.setattr(importlib.metadata, "files", lambda name: [File(f"share/robots/{one}") for one in names])
    assert find_mjcf("example_robot_data:b") == tmp_path / "share/robots/b_description/urdf/b.urdf"
    assert find_mjcf("example_robot_data:c").name == "d.urdf"
    with pytest.raises(RobotError, match="no such robot; it has: b, c"):
        find_mjcf("example_robot_data:e")


def test_the_real_anymal_c_has_the_lengths_of_the_preset(tmp_path: Path) -> None:
    try:
        path = find_mjcf(ANYMAL)
    except RobotError as error:
        pytest.skip(str(error))
    copy = tmp_path / "anymal.urdf"  # without its meshes
    shutil.copyfile(path, copy)
    robot, preset = load_mjcf(copy, MjcfNames(standing_height=0.55)), build_robot(load_robot("anymal_c"))
    assert robot.mass == pytest.approx(52.13, abs=0.01)
    for what in ("hips", "abduction_offset", "thigh_length", "shank_length", "knee_sign", "stance"):
        found, wanted = getattr(robot.geometry, what), getattr(preset.geometry, what)
        assert found == pytest.approx(wanted, abs=2e-3), what
