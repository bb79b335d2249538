import json
import shutil
import subprocess
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from legtool.configs.topics import load_topics
from legtool.datasets.logs.log import read_log
from legtool.datasets.logs.mcap_writer import PlanColumns, write_mcap
from legtool.datasets.logs.recording import Recording, concatenate
from legtool.errors import OutputError

SCRIPT = Path(__file__).parent / "mcap_core" / "read.mjs"


@pytest.fixture(scope="module")
def recording(robot) -> Recording:
    """Values with all their bits in use, over several chunks."""
    rng = np.random.default_rng(5)
    n = 1500
    orientation = rng.normal(scale=0.05, size=(n, 4)) + np.array([1.0, 0, 0, 0])
    orientation /= np.linalg.norm(orientation, axis=1, keepdims=True)
    return Recording(
        name="sweep.mcap",
        stamps_ns=1_700_000_000_000_000_001 + np.arange(n) * 5_000_003,
        position_world=np.cumsum(rng.normal(scale=1e-3, size=(n, 3)), axis=0),
        orientation=orientation,
        velocity_base=rng.normal(scale=0.3, size=(n, 3)),
        yaw_rate=rng.normal(size=n),
        command=rng.normal(scale=0.3, size=(n, 3)),
        feet_base=robot.stance + rng.normal(scale=0.01, size=(n, 4, 3)),
        contact_force=np.abs(rng.normal(scale=100, size=(n, 4))),
    )


@pytest.fixture(scope="module")
def joints(recording, robot) -> np.ndarray:
    return robot.joints(recording.feet_base)[0]


@pytest.fixture(scope="module")
def path(tmp_path_factory, recording, joints) -> Path:
    path = tmp_path_factory.mktemp("mcap") / "sweep.mcap"
    write_mcap(path, recording, joint_positions=joints, joint_velocities=joints * 2, metadata={"seed": "3"})
    return path


@pytest.mark.parametrize("chunk_s", [60.0, 1.3])
def test_reading_back_gives_the_same_bits(path, recording, robot, chunk_s):
    got = concatenate(list(read_log(path, load_topics("legtool"), robot, chunk_s=chunk_s)))
    for field in fields(recording):
        if field.name != "swing_pair":
            assert np.array_equal(getattr(recording, field.name), getattr(got, field.name)), field.name


def test_a_recording_without_contact_and_joints_reads_back_too(tmp_path, recording, robot):
    few = Recording(**{**{f.name: getattr(recording, f.name) for f in fields(recording)}, "contact_force": None})
    write_mcap(tmp_path / "few.mcap", few, metadata={})
    got = concatenate(list(read_log(tmp_path / "few.mcap", load_topics("legtool"), robot)))
    assert got.contact_force is None and np.array_equal(got.feet_base, few.feet_base)


def test_rosbags_reads_every_message(path, recording, joints):
    n = len(recording)
    with AnyReader([path]) as reader:
        assert reader.message_count == 8 * n
        assert {c.msgtype for c in reader.connections} == {
            "nav_msgs/msg/Odometry",
            "geometry_msgs/msg/TwistStamped",
            "geometry_msgs/msg/PoseArray",
            "sensor_msgs/msg/JointState",
            "geometry_msgs/msg/WrenchStamped",
        }
        row = dict.fromkeys((c.topic for c in reader.connections), 0)
        for connection, stamp, raw in reader.messages():
            i = row[connection.topic]
            row[connection.topic] += 1
            m = reader.deserialize(raw, connection.msgtype)
            assert stamp == m.header.stamp.sec * 10**9 + m.header.stamp.nanosec == recording.stamps_ns[i]
            if connection.topic == "/odom":
                q = m.pose.pose.orientation
                assert (q.w, q.x, q.y, q.z) == tuple(recording.orientation[i])
                assert m.twist.twist.angular.z == recording.yaw_rate[i] and m.child_frame_id == "base"
            elif connection.topic == "/joint_states":
                assert m.name[:4] == ["FL_hip", "FL_thigh", "FL_knee", "FR_hip"]
                assert np.array_equal(m.position, joints[i].ravel()) and np.array_equal(m.velocity, m.position * 2)
            elif connection.topic == "/feet":
                assert [p.position.z for p in m.poses] == recording.feet_base[i, :, 2].tolist()
                assert m.poses[0].orientation.w == 1.0
        assert set(row.values()) == {n}


def test_the_reference_reader_agrees_and_finds_the_metadata(path, recording):
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary.statistics.message_count == 8 * len(recording) == sum(1 for _ in reader.iter_messages())
        assert reader.get_header().profile == "ros2"
        assert [(m.name, m.metadata) for m in reader.iter_metadata()] == [("legtool", {"seed": "3"})]
        assert all(s.encoding == "ros2msg" for s in summary.schemas.values())


def test_the_same_recording_gives_the_same_bytes(tmp_path, path, recording, joints):
    write_mcap(
        tmp_path / "b.mcap", recording, joint_positions=joints, joint_velocities=joints * 2, metadata={"seed": "3"}
    )
    assert (tmp_path / "b.mcap").read_bytes() == path.read_bytes()


def test_a_place_that_cannot_be_written_leaves_nothing(tmp_path, recording):
    with pytest.raises(OutputError, match="cannot be written"):
        write_mcap(tmp_path / "none" / "b.mcap", recording, metadata={})
    with pytest.raises(ValueError, match="at least one sampled row"):
        write_mcap(tmp_path / "b.mcap", recording.rows(slice(0, 0)), metadata={})
    assert list(tmp_path.iterdir()) == []


def test_the_npm_reader_opens_it_and_decodes_the_same_values(tmp_path, path, recording, joints):
    """@mcap/core, with the schemas in the file as the only source of the messages' layout."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        pytest.skip("node and npm are not installed")
    shutil.copytree(SCRIPT.parent, tmp_path / "check")
    install = ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--silent"]
    done = subprocess.run(install, cwd=tmp_path / "check", capture_output=True, text=True, timeout=120)
    if done.returncode:
        pytest.skip(f"npm cannot install @mcap/core (no network?): {done.stderr.strip()[-200:]}")
    run = ["node", "read.mjs", str(path)]
    done = subprocess.run(run, cwd=tmp_path / "check", capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    got = json.loads(done.stdout)
    n = len(recording)
    assert got["profile"] == "ros2" and got["metadata"] == {"legtool": {"seed": "3"}}
    assert got["counts"] == {
        "/odom": n, "/command": n, "/feet": n, "/joint_states": n,
        "/contact/FL": n, "/contact/FR": n, "/contact/RL": n, "/contact/RR": n,
    }  # fmt: skip
    # The same doubles added in the same order: equal to the last bit.
    assert got["sums"] == {
        "/odom": sum(recording.position_world[:, 0].tolist()),
        "/command": sum(recording.command[:, 2].tolist()),
        "/feet": sum(recording.feet_base[:, 3, 2].tolist()),
        "/joint_states": sum(joints[:, 1, 0].tolist()),
        "/contact/RR": sum(recording.contact_force[:, 3].tolist()),
    }
    assert [int(stamp) for stamp in got["stamps"]] == [int(recording.stamps_ns[0]), int(recording.stamps_ns[-1])]


def test_a_plan_is_written_in_the_world_frame_beside_what_was_measured(tmp_path, recording):
    n = len(recording)
    rng = np.random.default_rng(5)
    body = np.concatenate([rng.normal(size=(n, 3)), np.tile([0.8, 0.0, 0.6, 0.0], (n, 1))], axis=1)
    plan = PlanColumns(rng.normal(size=(n, 4, 3)), body, rng.normal(size=(n, 4, 3)))
    path = tmp_path / "planned.mcap"
    write_mcap(path, recording, plan=plan, metadata={})
    with AnyReader([path]) as reader:
        found: dict[str, list] = {}
        for connection, _, raw in reader.messages():
            found.setdefault(connection.topic, []).append(reader.deserialize(raw, connection.msgtype))
    assert len(found["/plan/body"]) == len(found["/plan/footholds"]) == len(found["/plan/force/RR"]) == n
    footholds, pose, force = found["/plan/footholds"][3], found["/plan/body"][3], found["/plan/force/RL"][3]
    assert footholds.header.frame_id == pose.header.frame_id == "odom" and found["/feet"][3].header.frame_id == "base"
    place = footholds.poses[1].position
    np.testing.assert_array_equal([place.x, place.y, place.z], plan.footholds[3, 1])
    turn, at = pose.pose.orientation, pose.pose.position
    np.testing.assert_array_equal([at.x, at.y, at.z, turn.w, turn.x, turn.y, turn.z], plan.body[3])
    np.testing.assert_array_equal([force.wrench.force.x, force.wrench.force.y, force.wrench.force.z], plan.forces[3, 2])


def test_maps_of_some_rows_are_written_as_clouds_in_the_order_of_time(tmp_path, recording):
    n = len(recording)
    rng = np.random.default_rng(6)
    maps = [(row, rng.normal(size=(size, 3)).astype(np.float32)) for row, size in ((0, 7), (n // 2, 0), (n - 1, 5))]
    plan = PlanColumns(np.zeros((n, 4, 3)), np.zeros((n, 7)), np.zeros((n, 4, 3)), maps)
    path = tmp_path / "mapped.mcap"
    write_mcap(path, recording, plan=plan, metadata={})
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[])
        counts = reader.get_summary().statistics.channel_message_counts
        names = {channel.id: channel.topic for channel in reader.get_summary().channels.values()}
        assert {names[number]: count for number, count in counts.items()}["/plan/map"] == 3
        times = [message.log_time for _, _, message in reader.iter_messages()]
    assert times == sorted(times) and len(times) == sum(counts.values())
    with AnyReader([path]) as reader:
        connections = [c for c in reader.connections if c.topic == "/plan/map"]
        read = [(stamp, reader.deserialize(raw, c.msgtype)) for c, stamp, raw in reader.messages(connections)]
    assert [stamp for stamp, _ in read] == [int(recording.stamps_ns[row]) for row, _ in maps]
    for (_, cloud), (_, points) in zip(read, maps, strict=True):
        assert cloud.header.frame_id == "odom" and [field.name for field in cloud.fields] == ["x", "y", "z"]
        np.testing.assert_array_equal(cloud.data.view("<f4").reshape(-1, 3), points)
