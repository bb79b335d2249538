import numpy as np
import pytest

from legtool.configs.robots import PRESETS, load_robot
from legtool.errors import RobotError, SettingsError
from legtool_runtime.foothold import Criteria, Gait, Tuple

NAMES = sorted(path.stem for path in PRESETS.glob("*.yaml"))


@pytest.mark.parametrize("name", NAMES)
def test_every_preset_stands_within_its_joint_limits(name: str) -> None:
    robot = load_robot(name).geometry()
    joints, reachable = robot.joints(robot.stance)
    assert reachable.all()
    assert (joints >= robot.joint_limits[..., 0]).all()
    assert (joints <= robot.joint_limits[..., 1]).all()
    np.testing.assert_allclose(robot.feet(joints), robot.stance, atol=1e-12)
    assert np.array_equal(np.sign(joints[:, 2]), robot.knee_sign)


@pytest.mark.parametrize("name", NAMES)
def test_every_preset_is_left_right_symmetric(name: str) -> None:
    robot = load_robot(name).geometry()
    mirror = robot.stance[[1, 0, 3, 2]] * [1, -1, 1]
    np.testing.assert_allclose(mirror, robot.stance)


@pytest.mark.parametrize("name", NAMES)
def test_every_preset_stands_among_safe_footholds_on_flat_ground(name: str) -> None:
    robot = load_robot(name).geometry()
    criteria, gait = Criteria(robot), Gait(0.14, 1.4, 0.55)
    for leg in range(4):
        hip = robot.standing_height + robot.hips[leg, 2]
        t = Tuple(np.zeros((33, 33)), leg=leg, hip_height=hip, base_twist=(0.2, 0, 0, 0, 0, 0), gait=gait)
        found = criteria.evaluate(t)
        assert found.count > 300


def test_an_unknown_robot_lists_the_presets() -> None:
    with pytest.raises(RobotError, match="aliengo"):
        load_robot("spot")


def test_a_robot_that_cannot_stand_is_refused(tmp_path) -> None:
    text = (PRESETS / "aliengo.yaml").read_text().replace("standing_height: 0.39", "standing_height: 0.9")
    path = tmp_path / "tall.yaml"
    path.write_text(text)
    with pytest.raises(SettingsError, match="beyond the legs' reach"):
        load_robot(str(path))
