"""The robot that settings name: its geometry and its camera, without a walk."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from legtool.configs.camera import DepthCamera
from legtool.configs.footholds import FootholdSettings
from legtool.configs.mjcf import MjcfNames
from legtool.configs.robots import MeasuredRobot, load_robot, read_seeing_robot
from legtool.configs.scenes import SceneSettings
from legtool.errors import RobotError, SettingsError
from legtool.pipeline import footholds
from legtool.pipeline.scenes import scene_frames
from legtool.sim.robots.named import mjcf_inputs, named_geometry, seeing_robot
from legtool.sim.robots.robot import add_robot


@pytest.fixture
def dog(tmp_path: Path) -> Path:
    """HyQ as an MJCF file of another name."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    add_robot(spec, load_robot("hyq"))
    spec.compile()
    path = tmp_path / "dog.xml"
    path.write_text(spec.to_xml(), encoding="utf-8")
    return path


def test_an_mjcf_file_takes_the_place_of_the_preset(dog: Path) -> None:
    found = named_geometry("aliengo", str(dog), MjcfNames())
    assert found.name == "dog"
    np.testing.assert_allclose(found.hips, load_robot("hyq").geometry().hips, atol=1e-6)
    assert named_geometry("aliengo", None, MjcfNames()).name == "aliengo"


def test_it_sees_from_above_its_front_hips_unless_a_camera_is_set(dog: Path) -> None:
    robot = seeing_robot("go2", str(dog), MjcfNames(), None)
    assert isinstance(robot, MeasuredRobot)
    hips = robot.geometry().hips
    assert robot.camera.position == pytest.approx((hips[0, 0] + 0.05, 0.0, hips[0, 2] + 0.06), abs=1e-3)
    mounted = DepthCamera(width=320, height=240, pitch=0.9)
    assert seeing_robot("go2", str(dog), MjcfNames(), mounted).camera == mounted
    assert seeing_robot("go2", None, MjcfNames(), mounted).camera == mounted
    assert seeing_robot("go2", None, MjcfNames(), None) == load_robot("go2")


def test_what_scenes_are_seen_by_is_read_back_from_their_dataset(dog: Path) -> None:
    robot = seeing_robot("go2", str(dog), MjcfNames(), None)
    back = read_seeing_robot(robot.to_dict(), "data")
    assert back == robot
    assert back.geometry().to_dict() == named_geometry("", str(dog), MjcfNames()).to_dict()
    preset = load_robot("hyq")
    assert back.hip_x == pytest.approx(preset.hip_x, abs=1e-6)
    assert back.hip_y == pytest.approx(preset.hip_y, abs=1e-6)
    assert back.abduction_offset == pytest.approx(preset.abduction_offset, abs=1e-6)
    assert read_seeing_robot(preset.to_dict(), "data") == preset
    with pytest.raises(SettingsError, match="data: unknown setting 'wheels'"):
        read_seeing_robot({**robot.to_dict(), "wheels": 4}, "data")


def test_scenes_are_seen_by_the_robot_of_an_mjcf_file(dog: Path) -> None:
    small = DepthCamera(width=64, height=48)
    settings = SceneSettings(mjcf=str(dog), depth_camera=small, scenes=1, frames=1)
    frame = scene_frames(settings, 0)[0]
    assert frame.depth.shape == (48, 64)
    higher = scene_frames(SceneSettings(robot="go2", depth_camera=small, scenes=1, frames=1), 0)[0]
    assert frame.pose[2, 3] > higher.pose[2, 3] + 0.1  # HyQ's camera is higher than Go2's


def test_heightmaps_are_labelled_for_the_robot_of_an_mjcf_file(
    dog: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged: list[str] = []
    monkeypatch.setattr(footholds, "run_parts", lambda store, write, **_: write(0))
    monkeypatch.setattr(footholds, "foothold_samples", lambda *given: judged.append(given[2].robot.name) or [])
    monkeypatch.setattr(footholds, "write_part", lambda *_, **__: None)
    monkeypatch.setattr(footholds, "to_table", lambda _: None)
    monkeypatch.setattr(footholds, "_counts", lambda _: {})
    footholds.collect_footholds(FootholdSettings(mjcf=str(dog), samples=1), tmp_path / "data")
    manifest = json.loads((tmp_path / "data" / "manifest.json").read_text(encoding="utf-8"))
    assert judged == ["dog"] == [manifest["robot"]["name"]]
    assert manifest["inputs"] == mjcf_inputs(str(dog), MjcfNames())
    dog.write_text(dog.read_text(encoding="utf-8") + "<!-- changed -->", encoding="utf-8")
    assert manifest["inputs"] != mjcf_inputs(str(dog), MjcfNames())
    assert mjcf_inputs(None, MjcfNames()) == []


def test_a_file_that_is_no_robot_is_told(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"absent\.xml: not an MJCF file"):
        named_geometry("go2", str(tmp_path / "absent.xml"), MjcfNames())
