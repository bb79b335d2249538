from dataclasses import fields

import numpy as np
import pytest

from legtool.configs.robots import load_robot
from legtool.configs.topics import load_topics
from legtool.datasets.logs.log import read_log
from legtool.datasets.logs.mcap_writer import write_mcap
from legtool.datasets.logs.plausible import check_plausible
from legtool.datasets.logs.recording import Recording, concatenate
from legtool.errors import LogError
from legtool_runtime.robot import Robot

LABELS = {name: f"{name} (topic /{name})" for name in ("position", "velocity", "command", "feet", "joints")}
TOPICS = load_topics("legtool")


@pytest.fixture(scope="module")
def recording(robot: Robot) -> Recording:
    n = 400
    t = np.arange(n) * 0.005
    feet = robot.feet(robot.joints(robot.stance)[0].reshape(12) + 0.1 * np.sin(9 * t[:, None] + np.arange(12)))
    still = np.tile([1.0, 0, 0, 0], (n, 1))
    forward = np.tile([0.4, 0, 0], (n, 1))
    place = np.stack([0.4 * t, 0 * t, 0.38 + 0 * t], axis=1)
    return Recording("walk", (t * 1e9).astype(np.int64), place, still, forward, 0 * t, forward, feet)


def change(recording: Recording, **values) -> Recording:
    return Recording(**{**{f.name: getattr(recording, f.name) for f in fields(recording)}, **values})


def test_a_walk_is_plausible(recording, robot):
    check_plausible(recording, robot, LABELS, TOPICS, robot.joints(recording.feet_base)[0].reshape(-1, 12))


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        (
            lambda r: {"position_world": 1000 * r.position_world},
            r"position \(topic /position\): the trunk moves at 400",
        ),
        (lambda r: {"velocity_base": 1000 * r.velocity_base}, r"velocity \(topic /velocity\): the trunk moves at 400"),
        (lambda r: {"command": 1000 * r.command}, r"command \(topic /command\): is at 400 m/s, expected below 10 m/s"),
        (lambda r: {"feet_base": 1000 * r.feet_base}, r"foot \w\w is \d+\.?\d* m from its hip.*in millimetres"),
    ],
)
def test_millimetres_declared_as_metres_are_told_with_the_measured_value(recording, robot, values, expected):
    with pytest.raises(LogError, match=expected):
        check_plausible(change(recording, **values(recording)), robot, LABELS, TOPICS, None)


def test_a_single_glitch_of_the_tracker_is_no_reason_to_refuse(recording, robot):
    place = recording.position_world.copy()
    place[200] += 5.0
    check_plausible(change(recording, position_world=place), robot, LABELS, TOPICS, None)


def test_another_robots_feet_are_beyond_reach(recording):
    hyq = load_robot("hyq").geometry()
    stance = np.tile(hyq.stance, (len(recording), 1, 1))
    with pytest.raises(LogError, match=r"beyond the 0\.\d+ m reach of go2's leg; check --robot"):
        check_plausible(change(recording, feet_base=stance), load_robot("go2").geometry(), LABELS, TOPICS, None)


def test_joints_of_another_robot_disagree_with_the_feet(tmp_path, recording, robot):
    path = tmp_path / "walk.mcap"
    joints, _ = robot.joints(recording.feet_base)
    write_mcap(path, recording, joint_positions=joints, metadata={})
    topics = load_topics("legtool")
    assert len(concatenate(list(read_log(path, topics, robot)))) == len(recording)
    with pytest.raises(LogError, match=r"feet and joint angles disagree by 0\.\d+ m .* by the kinematics of go2"):
        list(read_log(path, topics, load_robot("go2").geometry()))


def test_two_robots_mixed_in_one_log_are_refused(tmp_path, recording, robot):
    """Every second message comes from a robot with other legs that stands elsewhere."""
    other = np.arange(len(recording)) % 2 == 1
    joints, _ = robot.joints(recording.feet_base)
    theirs, _ = load_robot("go2").geometry().joints(load_robot("go2").geometry().stance)
    joints[other] = theirs
    write_mcap(tmp_path / "joints.mcap", recording, joint_positions=joints, metadata={})
    with pytest.raises(LogError, match="two robots' logs are mixed"):
        list(read_log(tmp_path / "joints.mcap", load_topics("legtool"), robot))
    place = recording.position_world.copy()
    place[other] += [3.0, 1.0, 0.0]
    write_mcap(tmp_path / "odom.mcap", change(recording, position_world=place), metadata={})
    with pytest.raises(LogError, match=r"odom\.mcap: position \(topic /odom\).*two logs mixed"):
        list(read_log(tmp_path / "odom.mcap", load_topics("legtool"), robot))


@pytest.mark.parametrize("name", ["log.txt", "log.json", "log"])
def test_other_files_are_no_logs(tmp_path, robot, name):
    (tmp_path / name).write_text("x")
    with pytest.raises(LogError, match=r"expected \.bag, \.db3, \.mcap, \.csv"):
        list(read_log(tmp_path / name, load_topics("ros2_standard"), robot))


def test_a_directory_of_something_else_is_refused(tmp_path, robot):
    with pytest.raises(LogError, match="neither a ROS 2 bag"):
        list(read_log(tmp_path, load_topics("ros2_standard"), robot))
    (tmp_path / "walk.mcap").write_text("x")
    with pytest.raises(LogError, match=r"walk\.mcap: is not an MCAP file"):
        list(read_log(tmp_path, load_topics("ros2_standard"), robot))


def test_a_bag_is_not_read_by_columns(tmp_path, robot, motion, write_log):
    with pytest.raises(LogError, match="is a bag, but topics 'aliengo_csv' describe CSV columns"):
        list(read_log(write_log("mcap", tmp_path / "bag", motion), load_topics("aliengo_csv"), robot))
