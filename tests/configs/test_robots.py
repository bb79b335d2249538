import numpy as np
import pytest
import yaml

from legtool.configs.robots import PRESETS, load_geometry, load_robot
from legtool.errors import RobotError, SettingsError
from legtool_runtime.foothold import Criteria, Gait, Tuple

NAMES = sorted(path.stem for path in PRESETS.glob("*.yaml"))


@pytest.mark.parametrize("name", NAMES)
def test_every_preset_stands_within_its_joint_limits(name: str) -> None:
    robot = load_geometry(name).geometry()
    joints, reachable = robot.joints(robot.stance)
    assert reachable.all()
    assert (joints >= robot.joint_limits[..., 0]).all()
    assert (joints <= robot.joint_limits[..., 1]).all()
    np.testing.assert_allclose(robot.feet(joints), robot.stance, atol=1e-12)
    assert np.array_equal(np.sign(joints[:, 2]), robot.knee_sign)


@pytest.mark.parametrize("name", NAMES)
def test_every_preset_is_left_right_symmetric(name: str) -> None:
    robot = load_geometry(name).geometry()
    mirror = robot.stance[[1, 0, 3, 2]] * [1, -1, 1]
    np.testing.assert_allclose(mirror, robot.stance)


@pytest.mark.parametrize("name", NAMES)
def test_every_preset_stands_among_safe_footholds_on_flat_ground(name: str) -> None:
    robot = load_geometry(name).geometry()
    criteria, gait = Criteria(robot), Gait(0.14, 1.4, 0.55)
    for leg in range(4):
        hip = robot.standing_height + robot.hips[leg, 2]
        t = Tuple(np.zeros((33, 33)), leg=leg, hip_height=hip, base_twist=(0.2, 0, 0, 0, 0, 0), gait=gait)
        found = criteria.evaluate(t)
        assert found.count > 300


def test_an_unknown_robot_lists_the_presets() -> None:
    with pytest.raises(RobotError, match="aliengo"):
        load_robot("cheetah")
    with pytest.raises(RobotError, match="spot"):
        load_geometry("cheetah")


SPOT = {"hip_x": [0.3, -0.3], "hip_y": 0.055, "abduction_offset": 0.11, "thigh_length": 0.32, "shank_length": 0.37}


@pytest.mark.parametrize("extra", [{}, {"joint_damping": 1.0, "trunk": {"mass": 16.0}}])
def test_a_robot_whose_logs_are_read_needs_lengths_alone(tmp_path, extra) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump({"name": "mine", "knee_sign": [-1, -1], **SPOT, **extra}))
    robot = load_geometry(str(path)).geometry()
    joints, reachable = robot.joints(robot.stance)
    assert reachable.all() and (joints[:, 2] < -0.5).all()


def test_all_missing_settings_are_named_at_once(tmp_path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump({"name": "mine", "hip_x": [0.3, -0.3]}))
    lengths = "hip_y, abduction_offset, thigh_length, shank_length, knee_sign"
    with pytest.raises(SettingsError, match=f"settings are missing: {lengths}$"):
        load_geometry(str(path))
    with pytest.raises(
        SettingsError, match=r"settings are missing: source, hip_y.*torque_limits.*trunk, hip, thigh, shank"
    ):
        load_robot(str(path))


def test_the_foot_beside_anymal_c_s_shank_is_an_angle_at_the_knee() -> None:
    settings = load_geometry("anymal_c")
    offset = settings.joint_offset.reshape(4, 3)
    shank = settings.shank_length
    # In the shank's own frame the foot lies 0.088 m ahead of the axis in front, behind it at the back.
    for leg, ahead in enumerate([0.088, 0.088, -0.088, -0.088]):
        assert -shank * np.sin(offset[leg, 2]) == pytest.approx(ahead, abs=1e-3)
    assert not offset[:, :2].any()


def test_a_robot_that_cannot_stand_is_refused(tmp_path) -> None:
    text = (PRESETS / "aliengo.yaml").read_text().replace("standing_height: 0.39", "standing_height: 0.9")
    path = tmp_path / "tall.yaml"
    path.write_text(text)
    with pytest.raises(SettingsError, match="beyond the legs' reach"):
        load_robot(str(path))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("thigh_length", 25),
        ("shank_length", 200),
        ("hip_x", [240, -240]),
        ("foot_radius", 0.5),
        ("standing_height", 38),
    ],
)
def test_a_length_in_another_unit_is_refused(key: str, value: object, tmp_path) -> None:
    plain = yaml.safe_load((PRESETS / "aliengo.yaml").read_text())
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump({**plain, key: value}))
    with pytest.raises(SettingsError, match=f"'{key}.* should be less than or equal to"):
        load_geometry(str(tmp_path / "robot.yaml"))


def test_a_wrong_value_does_not_hide_what_is_missing(tmp_path) -> None:
    plain = yaml.safe_load((PRESETS / "aliengo.yaml").read_text())
    for key in ("shank_length", "hip_y"):
        del plain[key]
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump({**plain, "hip_x": [240, -240]}))
    with pytest.raises(SettingsError, match=r"'hip_x\.0' is 240; should be .*; missing besides: hip_y, shank_length"):
        load_robot(str(tmp_path / "robot.yaml"))
