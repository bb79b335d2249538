"""Controllers that are not ours: a learned policy walks, and what cannot walk is refused by name."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from legtool.configs.policies import load_policy_settings
from legtool.configs.robots import load_robot
from legtool.errors import SettingsError
from legtool.sim.controllers.blackbox import make_controller
from legtool.sim.robots.robot import SimRobot, build_robot
from legtool.sim.walks.episode import run_episode
from legtool.sim.walks.schedule import Schedule

EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "policies" / "aliengo.yaml"


@pytest.fixture(scope="module")
def robot() -> SimRobot:
    return build_robot(load_robot("aliengo"))


def described(tmp_path: Path, **changes: object) -> Path:
    path = tmp_path / "policy.yaml"
    path.write_text(yaml.safe_dump({**yaml.safe_load(EXAMPLE.read_text()), **changes}))
    return path


def test_a_learned_policy_walks_at_the_commanded_speed(shared_data: Path, tmp_path: Path, robot: SimRobot) -> None:
    onnx = shared_data / "controllers" / "aliengo_policy" / "policy.onnx"
    controller = make_controller(robot, str(described(tmp_path, onnx=str(onnx))))
    schedule = Schedule(np.array([0.0, 1.0]), np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]), 6.0)
    episode = run_episode(robot, controller, schedule)
    assert not episode.fell
    late = episode.recording.stamps_ns > 3_000_000_000
    assert episode.recording.velocity_base[late, 0].mean() == pytest.approx(0.5, abs=0.05)
    assert abs(episode.recording.velocity_base[late, 1].mean()) < 0.05


def test_shapes_that_disagree_with_the_description_are_refused(
    shared_data: Path, tmp_path: Path, robot: SimRobot
) -> None:
    onnx = shared_data / "controllers" / "aliengo_policy" / "policy.onnx"
    path = described(tmp_path, onnx=str(onnx), history=4)
    with pytest.raises(SettingsError, match=r"its input has shape \(1, 260\), the description asks for 208"):
        make_controller(robot, str(path))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"onnx": "none.onnx"}, "no such policy"),
        ({"joint_order": ["FL_hip"] * 12}, "joint_order must name each of"),
        ({"home": [0.0]}, "home has 1 angles"),
        ({"phase": None}, "say how it runs under 'phase'"),
        ({"observation": ["gravity", "sonar"]}, "observation"),
        ({"rate": 50}, "unknown setting 'rate'"),
    ],
)
def test_a_wrong_description_is_refused_by_name(tmp_path: Path, robot: SimRobot, changes: dict, expected: str) -> None:
    with pytest.raises(SettingsError, match=expected):
        make_controller(robot, str(described(tmp_path, **changes)))


def test_a_file_that_is_no_network_is_refused(tmp_path: Path, robot: SimRobot) -> None:
    (tmp_path / "policy.onnx").write_bytes(b"not a network")
    with pytest.raises(SettingsError, match="not an ONNX model that onnxruntime can run"):
        make_controller(robot, str(described(tmp_path)))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("spot", "expected a policy's YAML file, or module:Class"),
        ("no_such_module:Class", "cannot be imported"),
        ("json:Missing", "cannot be imported"),
        ("builtins:str", "has no reset, step, accepts_command"),
    ],
)
def test_a_class_that_is_no_controller_is_refused(robot: SimRobot, name: str, expected: str) -> None:
    with pytest.raises(SettingsError, match=expected):
        make_controller(robot, name)


def test_the_example_describes_a_frame_of_52_numbers() -> None:
    settings = load_policy_settings(EXAMPLE)
    assert settings.frame_size == 52
    assert settings.onnx.parent == EXAMPLE.parent
