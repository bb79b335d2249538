"""A short motion whose signals have their own rates, and writers that put it into every kind of log."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from legtool.configs.robots import load_robot
from legtool.configs.settings import build
from legtool.configs.topics import TopicSettings
from legtool_runtime.robot import JOINTS, LEGS, Robot

START_NS = 1_700_000_000_123_456_789
CUSTOM = "test_msgs/msg/FootReadings"
DEFINITION = "std_msgs/Header header\nstring source\nuint16[4] raw\nfloat64[] force\n"

Signal = tuple[np.ndarray, np.ndarray]


class Motion(NamedTuple):
    """Stamps (n,) [ns] and values of each signal; pose is x, y, z, w, x, y, z."""

    pose: Signal
    twist: Signal
    command: Signal
    joints: Signal
    force: Signal


@pytest.fixture(scope="session")
def robot() -> Robot:
    return load_robot("aliengo").geometry()


@pytest.fixture(scope="session")
def motion(robot: Robot) -> Motion:
    return make_motion(robot, 4.0)


@pytest.fixture(scope="session")
def topics() -> TopicSettings:
    """Of the logs that ``write_log`` writes, bags or CSV."""
    odometry = {"topic": "/odom"}
    return build(
        TopicSettings,
        {
            "name": "test",
            "position": odometry,
            "orientation": odometry,
            "velocity": odometry,
            "yaw_rate": odometry,
            "command": {"topic": "/cmd_vel"},
            "joints": {"topic": "/joint_states"},
            "contact": {"topic": "/foot_readings", "field": "force"},
        },
    )


@pytest.fixture(scope="session")
def write_log() -> Callable[..., Path]:
    return _write_log


def make_motion(robot: Robot, seconds: float) -> Motion:
    """A walk in a circle: odometry at 200 Hz, command at 20 Hz, joints at 125 Hz, forces at 250 Hz."""

    def clock(rate: float, offset_ns: int = 0) -> tuple[np.ndarray, np.ndarray]:
        stamps = START_NS + offset_ns + (np.arange(int(seconds * rate)) * (1e9 / rate)).astype(np.int64)
        return stamps, (stamps - START_NS) * 1e-9

    stamps, t = clock(200)
    yaw = 0.3 * t
    pose = np.stack([np.sin(yaw), 1 - np.cos(yaw), 0.38 + 0.01 * np.sin(9 * t)], axis=1)
    pose = np.concatenate([pose, np.stack([np.cos(yaw / 2), 0 * t, 0 * t, np.sin(yaw / 2)], axis=1)], axis=1)
    twist = np.stack([0.3 + 0 * t, 0 * t, 0.09 * np.cos(9 * t), 0 * t, 0 * t, 0.3 + 0 * t], axis=1)
    command_stamps, ct = clock(20)
    command = np.stack([np.where(ct < 3, 0.3, 0.5), 0 * ct, 0.3 + 0 * ct], axis=1)
    joint_stamps, jt = clock(125, -3_000_000)
    home = robot.joints(robot.stance)[0].reshape(12)
    joints = home + 0.05 * np.sin(9 * jt[:, None] + np.arange(12))
    force_stamps, ft = clock(250, 1_000_000)
    force = 60 + 50 * np.sin(9 * ft[:, None] + np.array([0, np.pi, np.pi, 0]))
    return Motion(
        (stamps, pose), (stamps, twist), (command_stamps, command), (joint_stamps, joints), (force_stamps, force)
    )


def _write_log(
    kind: str,
    folder: Path,
    motion: Motion,
    *,
    topics: set[str] | None = None,
    image: int = 0,
    define: bool = True,
    logged: dict[str, int] | None = None,
) -> Path:
    """Write a ``ros1``, ``db3`` or ``mcap`` bag.

    Args:
        kind: format.
        folder: new directory to write in.
        motion: the signals.
        topics: those that are written; all if None.
        image: bytes of an image on a topic of its own at 10 Hz; none if 0.
        define: whether the custom message's definition goes into the bag.
        logged: by topic, how much later than the others it is logged [ns].
    """
    ros1 = kind == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(DEFINITION, CUSTOM))
    events = [e for e in _events(store, motion, image, ros1) if topics is None or e[0] in topics]
    later = logged or {}
    events.sort(key=lambda e: e[2] + later.get(e[0], 0))
    folder.mkdir(parents=True)
    if ros1:
        path = folder / "walk.bag"
        writer: Any = Writer1(path)
    else:
        path = folder / "walk"
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
    serialise = store.serialize_ros1 if ros1 else store.serialize_cdr
    with writer:
        connections = {}
        for topic, msgtype, stamp, message in events:
            if topic not in connections:
                known: dict[str, Any] = {"typestore": store}
                if msgtype == CUSTOM and not define:
                    known = {"msgdef": "# gone\n", "rihs01": store.hash_rihs01(CUSTOM)}
                connections[topic] = writer.add_connection(topic, msgtype, **known)
            # Logged a little after it was stamped, as on a robot.
            writer.write(connections[topic], stamp + 400_000 + later.get(topic, 0), serialise(message, msgtype))
    return path


def _events(store: Any, motion: Motion, image: int, ros1: bool) -> list[tuple[str, str, int, Any]]:
    t = store.types
    vector, point, quaternion = (t[f"geometry_msgs/msg/{name}"] for name in ("Vector3", "Point", "Quaternion"))

    def header(stamp: int) -> Any:
        time = t["builtin_interfaces/msg/Time"](sec=int(stamp // 10**9), nanosec=int(stamp % 10**9))
        return t["std_msgs/msg/Header"](**({"seq": 7} if ros1 else {}), stamp=time, frame_id="odom")

    def twist(values: np.ndarray) -> Any:
        v, w = values[:3].tolist(), values[3:].tolist()
        linear, angular = vector(x=v[0], y=v[1], z=v[2]), vector(x=w[0], y=w[1], z=w[2])
        return t["geometry_msgs/msg/Twist"](linear=linear, angular=angular)

    out: list[tuple[str, str, int, Any]] = []
    odometry, posed, twisted = (
        t[name]
        for name in (
            "nav_msgs/msg/Odometry",
            "geometry_msgs/msg/PoseWithCovariance",
            "geometry_msgs/msg/TwistWithCovariance",
        )
    )
    for stamp, pose, rate in zip(motion.pose[0].tolist(), motion.pose[1], motion.twist[1], strict=True):
        x, y, z, qw, qx, qy, qz = pose.tolist()
        place = t["geometry_msgs/msg/Pose"](
            position=point(x=x, y=y, z=z), orientation=quaternion(x=qx, y=qy, z=qz, w=qw)
        )
        message = odometry(
            header=header(stamp),
            child_frame_id="trunk",
            pose=posed(pose=place, covariance=np.zeros(36)),
            twist=twisted(twist=twist(rate), covariance=np.zeros(36)),
        )
        out.append(("/odom", "nav_msgs/msg/Odometry", stamp, message))
    for stamp, (vx, vy, w) in zip(motion.command[0].tolist(), motion.command[1].tolist(), strict=True):
        # Twist has no header: its time is that of logging, 0.4 ms later.
        message = twist(np.array([vx, vy, 0, 0, 0, w]))
        out.append(("/cmd_vel", "geometry_msgs/msg/Twist", stamp - 400_000, message))
    names = [f"{leg}_{ {'knee': 'calf'}.get(joint, joint) }_joint" for leg in LEGS for joint in JOINTS]
    shuffle = np.random.default_rng(0).permutation(12)
    for stamp, angles in zip(motion.joints[0].tolist(), motion.joints[1], strict=True):
        message = t["sensor_msgs/msg/JointState"](
            header=header(stamp),
            name=[names[i] for i in shuffle],
            position=np.ascontiguousarray(angles[shuffle]),
            velocity=np.zeros(0),
            effort=np.zeros(0),
        )
        out.append(("/joint_states", "sensor_msgs/msg/JointState", stamp, message))
    for stamp, force in zip(motion.force[0].tolist(), motion.force[1], strict=True):
        message = t[CUSTOM](
            header=header(stamp), source="skin", raw=np.zeros(4, np.uint16), force=np.ascontiguousarray(force)
        )
        out.append(("/foot_readings", CUSTOM, stamp, message))
    if image:
        pixels = np.random.default_rng(1).integers(0, 256, image).astype(np.uint8)
        for stamp in motion.pose[0][::20].tolist():
            message = t["sensor_msgs/msg/Image"](
                header=header(stamp), height=1, width=image, encoding="mono8", is_bigendian=0, step=image, data=pixels
            )
            out.append(("/camera", "sensor_msgs/msg/Image", stamp, message))
    return out
