from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from legtool.configs.topics import load_topics
from legtool.datasets.logs import bag
from legtool.datasets.logs.log import LogReader, describe_log, read_log
from legtool.datasets.logs.mcap_writer import write_mcap
from legtool.datasets.logs.recording import Recording, concatenate
from legtool.errors import LogError
from legtool_runtime.robot import LEGS

KINDS = ("ros1", "db3", "mcap")


def read(path, topics, robot, **options) -> Recording:
    return concatenate(list(read_log(path, topics, robot, **options)))


def assert_same(a: Recording, b: Recording) -> None:
    for field in fields(a):
        if field.name != "name":
            assert np.array_equal(getattr(a, field.name), getattr(b, field.name)), field.name


def storage(path: Path) -> Path:
    """The one storage file of a bag."""
    return path if path.is_file() else next(p for p in path.iterdir() if p.suffix in (".db3", ".mcap"))


@pytest.fixture(scope="module")
def logs(tmp_path_factory, motion, write_log) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("bags")
    return {kind: write_log(kind, folder / kind, motion, image=5000) for kind in KINDS}


def test_every_format_gives_the_same_recording(logs, topics, robot):
    ros1 = read(logs["ros1"], topics, robot)
    assert len(ros1) > 700
    for path in (logs["db3"], logs["mcap"], storage(logs["db3"]), storage(logs["mcap"])):
        assert_same(ros1, read(path, topics, robot))


def test_the_recording_is_the_motion(logs, topics, robot, motion):
    got = read(logs["mcap"], topics, robot)
    stamps, pose = motion.pose
    row = np.searchsorted(stamps, got.stamps_ns)
    assert np.array_equal(stamps[row], got.stamps_ns)
    assert np.array_equal(got.position_world, pose[row, :3])
    assert np.array_equal(got.orientation, pose[row, 3:])
    assert np.array_equal(got.velocity_base, motion.twist[1][row, :3])
    held = np.searchsorted(motion.command[0], got.stamps_ns, side="right") - 1
    assert np.array_equal(got.command, motion.command[1][held])
    t = (got.stamps_ns - stamps[0]) * 1e-9
    home = robot.joints(robot.stance)[0].reshape(12)
    joints = home + 0.05 * np.sin(9 * t[:, None] + np.arange(12))
    # Linear between samples 8 ms apart: the sine's curvature is all that is lost.
    assert np.abs(got.feet_base - robot.feet(joints)).max() < 1e-4
    force = 60 + 50 * np.sin(9 * t[:, None] + np.array([0, np.pi, np.pi, 0]))
    assert np.abs(got.contact_force - force).max() < 0.02


def test_values_are_those_of_rosbags_own_decoder(logs, topics, robot):
    got = read(logs["db3"], topics, robot)
    with AnyReader([logs["db3"]]) as reader:
        odometry = [c for c in reader.connections if c.topic == "/odom"]
        expected = {}
        for connection, _, raw in reader.messages(odometry):
            m = reader.deserialize(raw, connection.msgtype)
            p = m.pose.pose.position
            expected[m.header.stamp.sec * 10**9 + m.header.stamp.nanosec] = (p.x, p.y, p.z)
    assert all(expected[s] == tuple(p) for s, p in zip(got.stamps_ns.tolist(), got.position_world, strict=True))


@pytest.mark.parametrize("kind", KINDS)
def test_pieces_make_the_same_whole(logs, topics, robot, kind):
    derived = topics.replace(velocity=None, yaw_rate=None)
    whole = read(logs[kind], derived, robot)
    parts = list(read_log(logs[kind], derived, robot, chunk_s=0.7))
    assert len(parts) > 5
    assert_same(whole, concatenate(parts))
    # vx is 0.3, and the heave 9 rad/s of 1 cm
    assert np.abs(whole.velocity_base[20:-20, 0] - 0.3).max() < 2e-3
    assert np.abs(whole.yaw_rate - 0.3).max() < 1e-6


def test_topics_that_are_not_wanted_are_never_decoded(logs, topics, robot, monkeypatch):
    seen = set()
    plain = bag.groups

    def spy(raws, types, name, **options):
        seen.add(name)
        return plain(raws, types, name, **options)

    monkeypatch.setattr(bag, "groups", spy)
    read(logs["mcap"], topics, robot)
    assert "nav_msgs/msg/Odometry" in seen and "sensor_msgs/msg/Image" not in seen


def test_a_custom_definition_comes_from_the_users_directory(tmp_path, topics, robot, motion, write_log, logs):
    path = write_log("db3", tmp_path / "bag", motion)
    # An older bag: the storage holds no definitions at all.
    import sqlite3

    with sqlite3.connect(storage(path)) as database:
        database.execute("DELETE FROM message_definitions")
    with pytest.raises(LogError, match=r"/foot_readings holds test_msgs/msg/FootReadings.*--msgs DIR"):
        read(path, topics, robot)
    messages = tmp_path / "test_msgs" / "msg"
    messages.mkdir(parents=True)
    (messages / "FootReadings.msg").write_text(
        "std_msgs/Header header\nstring source\nuint16[4] raw\nfloat64[] force\n"
    )
    assert_same(read(logs["ros1"], topics, robot), read(path, topics, robot, messages=tmp_path / "test_msgs"))


def test_wrenches_of_each_leg_give_the_magnitude(tmp_path, topics, robot, motion, write_log):
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    source = write_log("mcap", tmp_path / "a", motion, topics={"/odom", "/cmd_vel", "/joint_states"})
    store = get_typestore(Stores.ROS2_HUMBLE)
    t = store.types
    with AnyReader([source]) as reader, Writer(tmp_path / "b", version=9) as writer:
        made = {c.id: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections}
        for connection, stamp, raw in reader.messages():
            writer.write(made[connection.id], stamp, raw)
        zero = t["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
        for number, leg in enumerate(LEGS):
            made_leg = writer.add_connection(f"/{leg}", "geometry_msgs/msg/Wrench", typestore=store)
            force = t["geometry_msgs/msg/Vector3"](x=3.0 * (number + 1), y=0.0, z=-4.0 * (number + 1))
            message = t["geometry_msgs/msg/Wrench"](force=force, torque=zero)
            for stamp in motion.pose[0][::3].tolist():
                writer.write(made_leg, stamp, store.serialize_cdr(message, "geometry_msgs/msg/Wrench"))
    # Swapped on purpose: the settings say whose topic is whose.
    contact = {"topic": ["/FR", "/FL", "/RL", "/RR"], "legs": ["FR", "FL", "RL", "RR"]}
    got = read(tmp_path / "b", topics.replace(contact=contact), robot)
    assert np.allclose(got.contact_force, [5.0, 10.0, 15.0, 20.0])


@pytest.mark.parametrize("kind", ["geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Vector3"])
def test_a_command_may_be_of_several_types(tmp_path, robot, motion, write_log, kind):
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    source = write_log("mcap", tmp_path / "a", motion, topics={"/odom", "/joint_states"})
    store = get_typestore(Stores.ROS2_HUMBLE)
    t = store.types
    vector = t["geometry_msgs/msg/Vector3"]
    time = t["builtin_interfaces/msg/Time"](sec=1_700_000_000, nanosec=0)
    message = vector(x=0.4, y=0.1, z=-0.2)
    if kind.endswith("TwistStamped"):
        twist = t["geometry_msgs/msg/Twist"](linear=vector(x=0.4, y=0.1, z=9.0), angular=vector(x=9.0, y=9.0, z=-0.2))
        message = t[kind](header=t["std_msgs/msg/Header"](stamp=time, frame_id=""), twist=twist)
    with AnyReader([source]) as reader, Writer(tmp_path / "b", version=9) as writer:
        made = {c.id: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections}
        command = writer.add_connection("/cmd_vel", kind, typestore=store)
        writer.write(command, int(motion.pose[0][0]), store.serialize_cdr(message, kind))
        for connection, stamp, raw in reader.messages():
            writer.write(made[connection.id], stamp, raw)
    got = read(tmp_path / "b", load_topics("ros2_standard"), robot)
    assert len(got) > 700 and np.array_equal(np.unique(got.command, axis=0), [[0.4, 0.1, -0.2]])


@pytest.mark.parametrize("kind", KINDS)
def test_info_tells_topics_and_counts(logs, motion, kind):
    told = describe_log(logs[kind])
    assert told["topics"]["/odom"] == {"type": "nav_msgs/msg/Odometry", "messages": len(motion.pose[0])}
    assert told["duration_s"] == pytest.approx(4.0, abs=0.05)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.999])
@pytest.mark.parametrize("directory", [False, True])
def test_a_truncated_mcap_is_refused_and_says_what_can_be_saved(logs, topics, robot, tmp_path, share, directory):
    whole = storage(logs["mcap"]).read_bytes()
    path = tmp_path / "cut.mcap"
    if directory:
        (tmp_path / "walk").mkdir()
        (tmp_path / "walk/metadata.yaml").write_bytes((logs["mcap"] / "metadata.yaml").read_bytes())
        path = tmp_path / "walk/walk.mcap"
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(LogError, match=r"is truncated.*: \d+ messages are readable.*mcap recover") as caught:
        read(path.parent if directory else path, topics, robot)
    assert "\n" not in str(caught.value)


def test_the_count_of_what_can_be_saved_is_right(tmp_path, logs, topics, robot):
    from mcap.reader import make_reader

    source = storage(logs["mcap"])
    with source.open("rb") as file:
        summary = make_reader(file).get_summary()
    path = tmp_path / "cut.mcap"
    path.write_bytes(source.read_bytes()[:-40])  # all messages, no footer
    with pytest.raises(LogError, match=rf": {summary.statistics.message_count} messages are readable"):
        read(path, topics, robot)


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_with_damage_inside_is_refused(tmp_path, logs, topics, robot, kind):
    source = storage(logs[kind])
    if kind == "mcap":  # rosbags writes no checksums, we do
        source, topics = tmp_path / "ours.mcap", load_topics("legtool")
        write_mcap(source, read(logs["mcap"], load_topics("ros2_standard"), robot), metadata={})
    data = bytearray(source.read_bytes())
    at = len(data) // (8 if kind == "mcap" else 2)  # in the first chunk's messages; its index is not needed to read
    data[at : at + 4000] = bytes(b ^ 0x5A for b in data[at : at + 4000])
    path = tmp_path / f"bad{source.suffix}"
    path.write_bytes(bytes(data))
    with pytest.raises(LogError, match=r"bad\.") as caught:
        read(path, topics, robot)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", [".bag", ".db3", ".mcap"])
@pytest.mark.parametrize("content", [b"", b"this is no bag, whatever its name says\n" * 100])
def test_an_empty_or_foreign_file_is_refused(tmp_path, topics, robot, suffix, content):
    path = tmp_path / f"x{suffix}"
    path.write_bytes(content)
    expected = "cannot be opened|is not an MCAP file" if content else r"is empty \(0 bytes\)"
    with pytest.raises(LogError, match=expected):
        read(path, topics, robot)


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_without_messages_is_refused(tmp_path, motion, topics, robot, write_log, kind):
    path = write_log(kind, tmp_path / "bag", motion, topics=set())
    with pytest.raises(LogError, match="holds no messages"):
        read(path, topics, robot)


def test_a_bag_with_none_of_the_topics_says_which_are_there(tmp_path, robot, motion, write_log):
    path = write_log("mcap", tmp_path / "bag", motion, topics={"/foot_readings", "/camera"}, image=10)
    with pytest.raises(LogError) as caught:
        read(path, load_topics("ros2_standard"), robot)
    message = str(caught.value)
    assert "position (/odom)" in message and "command (/cmd_vel)" in message and "joints (/joint_states)" in message
    assert "/camera (sensor_msgs/msg/Image, 40 messages), /foot_readings (test_msgs/msg/FootReadings, 1000" in message


def test_a_signal_that_cannot_be_derived_is_named(tmp_path, topics, robot, motion, write_log):
    path = write_log("mcap", tmp_path / "bag", motion, topics={"/odom", "/cmd_vel", "/foot_readings"})
    with pytest.raises(LogError, match=r"nothing on a topic for joints \(/joint_states\); topics there: /cmd_vel"):
        read(path, topics, robot)
    optional = topics.replace(joints={"topic": "/joint_states", "optional": True})
    with pytest.raises(LogError, match="nothing on a topic for feet or joints"):
        read(path, optional, robot)


def test_an_mcap_whose_index_leaves_messages_out_is_refused(tmp_path, logs, topics, robot):
    from mcap.reader import make_reader
    from mcap.writer import IndexType, Writer

    path = tmp_path / "noindex.mcap"
    with storage(logs["mcap"]).open("rb") as source, path.open("wb") as file:
        writer = Writer(file, index_types=IndexType.CHUNK)
        writer.start("ros2")
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.id not in channels:
                made = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, "cdr", made)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()
    with pytest.raises(LogError, match=r"0 messages can be reached, the summary counts \d+.*mcap recover"):
        read(path, topics, robot)


def test_an_optional_topic_without_messages_counts_as_absent(tmp_path, robot, motion, write_log):
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    source = write_log("mcap", tmp_path / "a", motion, topics={"/odom", "/cmd_vel", "/joint_states"})
    store = get_typestore(Stores.ROS2_HUMBLE)
    with AnyReader([source]) as reader, Writer(tmp_path / "b", version=9) as writer:
        made = {c.id: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections}
        writer.add_connection("/contact_forces", "std_msgs/msg/Float64MultiArray", typestore=store)
        for connection, stamp, raw in reader.messages():
            writer.write(made[connection.id], stamp, raw)
    assert read(tmp_path / "b", load_topics("ros2_standard"), robot).contact_force is None


def test_contact_may_be_absent(tmp_path, robot, motion, write_log):
    path = write_log("ros1", tmp_path / "bag", motion, topics={"/odom", "/cmd_vel", "/joint_states"})
    assert read(path, load_topics("ros2_standard"), robot).contact_force is None


def test_a_message_of_unknown_type_needs_its_field_named(logs, topics, robot):
    with pytest.raises(LogError, match=r"/foot_readings.*give the field.*raw, force"):
        read(logs["mcap"], topics.replace(contact={"topic": "/foot_readings"}), robot)
    with pytest.raises(LogError, match="has no field forces"):
        read(logs["mcap"], topics.replace(contact={"topic": "/foot_readings", "field": "forces"}), robot)


def test_joints_that_are_not_named_as_usual_need_their_names(logs, topics, robot):
    names = [f"joint_{i}" for i in range(12)]
    with pytest.raises(LogError, match=r"no message names the robot's 12 joints.*names there: .*FL_hip_joint"):
        read(logs["mcap"], topics.replace(joints={"topic": "/joint_states", "names": names}), robot)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("signal", "value"), [("joints", np.nan), ("pose", np.nan), ("pose", 0.0)])
def test_what_a_sensor_lost_is_a_gap_and_is_counted(tmp_path, topics, robot, motion, write_log, kind, signal, value):
    stamps, values = getattr(motion, signal)
    broken = values.copy()
    broken[300:320] = value  # a lost body has no place either: zeros in all of its pose
    path = write_log(kind, tmp_path / "bag", motion._replace(**{signal: (stamps, broken)}))
    reader = LogReader(path, topics, robot)
    got = concatenate(list(reader.recordings()))
    facts = reader.facts.streams["position" if signal == "pose" else signal]
    assert facts.lost == 20
    assert np.diff(got.stamps_ns).max() > 0.09e9 and np.isfinite(got.feet_base).all()
    assert np.linalg.norm(np.diff(got.position_world, axis=0), axis=1).max() < 0.1


def test_infinity_names_topic_and_stamp(tmp_path, topics, robot, motion, write_log):
    stamps, joints = motion.joints
    broken = joints.copy()
    broken[100, 5] = np.inf
    path = write_log("mcap", tmp_path / "bag", motion._replace(joints=(stamps, broken)))
    with pytest.raises(LogError, match=rf"topic /joint_states\), stamp {stamps[100] / 1e9:.6f} s: holds inf"):
        read(path, topics, robot)


def test_a_quaternion_that_is_not_unit_is_refused(tmp_path, topics, robot, motion, write_log):
    stamps, pose = motion.pose
    broken = pose.copy()
    broken[10, 3:] *= 0.5
    path = write_log("mcap", tmp_path / "bag", motion._replace(pose=(stamps, broken)))
    with pytest.raises(LogError, match=r"/odom.*quaternion has length 0.5, expected 1"):
        read(path, topics, robot)


@pytest.mark.parametrize(
    ("shift", "expected"), [(-2 * 10**9, "goes back by"), (24 * 3600 * 10**9, "jumps ahead by 86400")]
)
def test_stamps_that_go_back_or_jump_by_a_day_are_refused(tmp_path, topics, robot, motion, write_log, shift, expected):
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    source = write_log("mcap", tmp_path / "a", motion)
    store = get_typestore(Stores.ROS2_HUMBLE)
    with AnyReader([source]) as reader, Writer(tmp_path / "b", version=9) as writer:
        made = {
            c.id: writer.add_connection(c.topic, c.msgtype, msgdef=c.msgdef.data, rihs01=c.digest or "RIHS01_0")
            for c in reader.connections
        }
        middle = motion.pose[0][600]
        for connection, stamp, raw in reader.messages():
            if connection.topic == "/odom" and stamp > middle:
                message = reader.deserialize(raw, connection.msgtype)
                message.header.stamp.sec += shift // 10**9
                raw = store.serialize_cdr(message, connection.msgtype)
            writer.write(made[connection.id], stamp, raw)
    with pytest.raises(LogError, match=rf"\(topic /odom\), stamp .*{expected}"):
        read(storage(tmp_path / "b"), topics, robot)


def test_header_stamps_of_another_clock_are_refused_until_told(tmp_path, topics, robot, motion, write_log):
    """A robot that stamps since boot, and a command without header that has the time of logging only."""
    boot = 1_699_999_000 * 10**9
    shifted = motion._replace(**{n: (getattr(motion, n)[0] - boot, getattr(motion, n)[1]) for n in motion._fields})
    bag_path = write_log("mcap", tmp_path / "a", shifted)

    from rosbags.rosbag2 import Writer

    with AnyReader([bag_path]) as reader, Writer(tmp_path / "b", version=9) as writer:
        made = {
            c.id: writer.add_connection(c.topic, c.msgtype, msgdef=c.msgdef.data, rihs01=c.digest or "RIHS01_0")
            for c in reader.connections
        }
        for connection, stamp, raw in reader.messages():
            writer.write(made[connection.id], stamp + boot, raw)
    path = storage(tmp_path / "b")
    with pytest.raises(LogError, match=r"spans .*do they share one clock"):
        read(path, topics, robot)
    assert len(read(path, topics.replace(stamps="log"), robot)) > 700


def test_a_gap_ends_a_stretch(tmp_path, topics, robot, motion, write_log):
    stamps, joints = motion.joints
    keep = (stamps < stamps[200]) | (stamps > stamps[230])
    path = write_log("mcap", tmp_path / "bag", motion._replace(joints=(stamps[keep], joints[keep])))
    stretches = list(read_log(path, topics, robot))
    assert all(np.diff(stretch.stamps_ns).max() == 5_000_000 for stretch in stretches)
    assert np.sum(np.diff(concatenate(stretches).stamps_ns) > 0.2e9) == 1


def test_samples_too_far_apart_are_refused_with_their_distance(tmp_path, topics, robot, motion, write_log):
    stamps, joints = motion.joints
    path = write_log("mcap", tmp_path / "bag", motion._replace(joints=(stamps[::20], joints[::20])))
    with pytest.raises(
        LogError, match=r"joints \(topic /joint_states\): samples are 160\.0 ms apart.*max_gap_s = 50 ms"
    ):
        read(path, topics.replace(velocity=None), robot)
