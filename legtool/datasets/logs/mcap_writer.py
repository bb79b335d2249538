"""Write recordings as MCAP with standard ROS 2 messages, a whole chunk of messages at a time.

One message of each topic is serialised by rosbags as a template; all others differ from it in numbers at known bytes
only, so that a chunk is a byte matrix with one row for each instant.
"""

from __future__ import annotations

import functools
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

from legtool.datasets.files import replacing
from legtool.datasets.logs.layout import Layout, walk
from legtool.datasets.logs.recording import Recording
from legtool_runtime.robot import JOINTS, LEGS

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
MAGIC = b"\x89MCAP0\r\n"
#: Instants in one chunk: about a megabyte before compression.
ROWS = 512
#: A message's record: opcode, length, channel, sequence, time of logging and of publishing.
_RECORD = struct.Struct("<BQHIQQ")
#: Where the stamp stands in a message: most have one header, transforms each their own.
_STAMP, _TRANSFORM = "header.stamp.", "transforms.0."
#: Maps are clouds of points: every viewer draws these.
_CLOUD = "sensor_msgs/msg/PointCloud2"
#: Bytes of messages in one chunk, about.
_CHUNK = 4 * 2**20
#: Types that ROS itself does not have: what a grid map holds.
_GRID_MAP = {
    "grid_map_msgs/msg/GridMapInfo": (
        "float64 resolution\nfloat64 length_x\nfloat64 length_y\ngeometry_msgs/Pose pose\n"
    ),
    "grid_map_msgs/msg/GridMap": (
        "std_msgs/Header header\ngrid_map_msgs/GridMapInfo info\nstring[] layers\nstring[] basic_layers\n"
        "std_msgs/Float32MultiArray[] data\nuint16 outer_start_index\nuint16 inner_start_index\n"
    ),
}


@dataclass(frozen=True)
class _Topic:
    """What is written on one topic: the template of its message, and the columns that go into it."""

    name: str
    msgtype: str
    template: bytes
    layout: Layout
    columns: dict[str, Array]


@dataclass(frozen=True, eq=False)
class PlanColumns:
    """What a robot was to do at each row of a recording, world frame.

    Attributes:
        footholds: (n, 4, 3) where each foot stands or goes to stand [m].
        body: (n, 7) place of the centre of mass [m] and orientation of the trunk (quaternion w, x, y, z) wanted.
        forces: (n, 4, 3) wanted of each foot [N].
        maps: of some rows, in order: which, and points (m, 3) of the ground as the robot knew it then [m].
    """

    footholds: Array
    body: Array
    forces: Array
    maps: Sequence[tuple[int, NDArray[np.float32]]] = ()


class Message(NamedTuple):
    """One more message of a recording, at any time.

    Attributes:
        stamp_ns: time of logging [ns].
        topic: that it is written on; one type of messages on each.
        msgtype: such as ``visualization_msgs/msg/MarkerArray``.
        data: serialised as CDR, or what makes that when it is written.
    """

    stamp_ns: int
    topic: str
    msgtype: str
    data: bytes | Callable[[], bytes]


@dataclass(frozen=True, eq=False)
class NamedColumns:
    """Values with names at each row of a recording.

    Attributes:
        topic: that they are written on.
        names: of the k values of a row.
        values: (n, k).
    """

    topic: str
    names: tuple[str, ...]
    values: Array


def write_mcap(
    path: Path,
    recording: Recording,
    *,
    joint_positions: Array | None = None,
    joint_velocities: Array | None = None,
    plan: PlanColumns | None = None,
    beside: Sequence[NamedColumns] = (),
    frames: bool = False,
    more: Sequence[Message] = (),
    metadata: Mapping[str, str],
) -> None:
    """Write a recording that Foxglove, PlotJuggler, rosbags and ``ros2 bag`` open, and ``read_log`` reads back exactly.

    Topics: ``/odom`` (Odometry, twist in the base frame), ``/command`` (TwistStamped), ``/feet`` (PoseArray in the base
    frame), and where there is any ``/joint_states`` (JointState) and ``/contact/FL`` … (WrenchStamped, the force in z).
    Of a plan, in the world frame, ``/plan/footholds`` (PoseArray), ``/plan/body`` (PoseStamped), ``/plan/force/FL`` …
    (WrenchStamped) and, at some rows, ``/plan/map`` (PointCloud2). Named values are the positions of a JointState.
    The same recording gives the same bytes.

    Args:
        path: the file; it appears under this name once it is complete and on the disk.
        recording: sampled, not step events.
        joint_positions: (n, 4, 3) or (n, 12) [rad].
        joint_velocities: the same shape [rad/s].
        plan: what the robot was to do.
        beside: other values at the same rows, each on its topic.
        frames: whether to write ``/tf`` (TFMessage, odom to base) too, which a viewer needs to place the feet.
        more: other messages, such as maps and images.
        metadata: written as a record named ``legtool``.

    Raises:
        OutputError: the disk is full, or the file cannot be written.
        ValueError: the recording is empty, or is one of step events.
    """
    if not len(recording) or recording.events:
        raise ValueError("expected a recording of at least one sampled row")
    topics = _topics(recording, joint_positions, joint_velocities, frames=frames)
    if plan is not None:
        topics += _plan_topics(plan)
    topics += [_named_topic(one) for one in beside]
    stamps = recording.stamps_ns
    maps = [] if plan is None else plan.maps
    clouds = [
        Message(int(stamps[row]), "/plan/map", _CLOUD, functools.partial(cloud, int(stamps[row]), p)) for row, p in maps
    ]
    with replacing(path) as temporary, temporary.open("wb") as file:
        _write(file, stamps, topics, [*clouds, *more], metadata)


def _write(
    file: BinaryIO, stamps: Stamps, topics: list[_Topic], more: Sequence[Message], metadata: Mapping[str, str]
) -> None:
    file.write(MAGIC)
    _put(file, Header("ros2", "legtool"))
    kinds = {message.topic: message.msgtype for message in more}
    written = [(topic.name, topic.msgtype) for topic in topics] + list(kinds.items())
    names = list(dict.fromkeys(msgtype for _, msgtype in written))
    schemas = [Schema(i + 1, definition(name).encode(), "ros2msg", name) for i, name in enumerate(names)]
    channels = [
        Channel(i + 1, name, "cdr", {"offered_qos_profiles": ""}, names.index(msgtype) + 1)
        for i, (name, msgtype) in enumerate(written)
    ]
    number = {topic: len(topics) + 1 + k for k, topic in enumerate(kinds)}
    done = dict.fromkeys(kinds, 0)
    ordered = sorted(more, key=lambda message: message.stamp_ns)
    head = b"".join(_bytes(record) for record in [*schemas, *channels])
    chunks, at_message = [], 0
    for start in range(0, len(stamps), ROWS):
        rows = slice(start, start + ROWS)
        chunks.append(_write_chunk(file, stamps[rows], topics, rows, head if start == 0 else b""))
        here = at_message
        last = start + ROWS >= len(stamps)
        while here < len(ordered) and (last or ordered[here].stamp_ns < stamps[start + ROWS]):
            here += 1
        for some in _by_size(ordered[at_message:here]):
            chunks.append(_write_messages(file, some, number, done))
        at_message = here
    counts = {channel.id: len(stamps) for channel in channels[: len(topics)]}
    counts |= {number[topic]: count for topic, count in done.items()}
    at = file.tell()
    size = _put(file, Metadata("legtool", dict(metadata)))
    _put(file, DataEnd(0))
    statistics = Statistics(
        attachment_count=0,
        channel_count=len(channels),
        channel_message_counts=counts,
        chunk_count=len(chunks),
        message_count=sum(counts.values()),
        message_end_time=max(int(stamps[-1]), ordered[-1].stamp_ns if ordered else 0),
        message_start_time=min([int(stamps[0]), *(message.stamp_ns for message in ordered[:1])]),
        metadata_count=1,
        schema_count=len(schemas),
    )
    groups: list[tuple[Opcode, list[Any]]] = [
        (Opcode.SCHEMA, schemas),
        (Opcode.CHANNEL, channels),
        (Opcode.STATISTICS, [statistics]),
        (Opcode.CHUNK_INDEX, chunks),
        (Opcode.METADATA_INDEX, [MetadataIndex(at, size, "legtool")]),
    ]
    start = file.tell()
    summary, offsets = b"", b""
    for opcode, records in groups:
        group = b"".join(_bytes(record) for record in records)
        offsets += _bytes(SummaryOffset(opcode, start + len(summary), len(group)))
        summary += group
    offset_start = start + len(summary)
    footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
    file.write(summary + offsets)
    _put(file, Footer(start, offset_start, zlib.crc32(summary + offsets + footer)))
    file.write(MAGIC)


def _write_chunk(file: BinaryIO, stamps: Stamps, topics: list[_Topic], rows: slice, head: bytes) -> ChunkIndex:
    """One chunk with its message indices: each instant's messages, topic by topic."""
    n = len(stamps)
    sizes = [_RECORD.size + len(topic.template) for topic in topics]
    starts = np.concatenate([[0], np.cumsum(sizes)])
    matrix = np.empty((n, int(starts[-1])), dtype=np.uint8)
    for number, topic in enumerate(topics):
        record = matrix[:, starts[number] : starts[number + 1]]
        prefix = _RECORD.pack(Opcode.MESSAGE, sizes[number] - 9, number + 1, 0, 0, 0)
        record[:] = np.frombuffer(prefix + topic.template, dtype=np.uint8)
        _fill(record, 11, np.arange(rows.start, rows.start + n, dtype="<u4"))
        _fill(record, 15, np.repeat(stamps.astype("<u8")[:, None], 2, axis=1))
        message = record[:, _RECORD.size :]
        leaves = topic.layout.leaves
        stamp = _STAMP if f"{_STAMP}sec" in leaves else _TRANSFORM + _STAMP
        _fill(message, leaves[f"{stamp}sec"].offset, (stamps // 10**9).astype("<i4"))
        _fill(message, leaves[f"{stamp}nanosec"].offset, (stamps % 10**9).astype("<u4"))
        for path, values in topic.columns.items():
            _fill(message, leaves[path].offset, values[rows].astype("<f8"))
    lines = len(head) + np.arange(n, dtype=np.int64) * starts[-1]
    index = {number + 1: np.stack([stamps, lines + starts[number]], axis=1) for number in range(len(topics))}
    return _put_chunk(file, head + matrix.tobytes(), index)


def _by_size(messages: Sequence[Message]) -> Iterator[list[tuple[Message, bytes]]]:
    """Messages with their bytes, in pieces of some megabytes."""
    held: list[tuple[Message, bytes]] = []
    for message in messages:
        held.append((message, message.data if isinstance(message.data, bytes) else message.data()))
        if sum(len(data) for _, data in held) > _CHUNK:
            yield held
            held = []
    if held:
        yield held


def _write_messages(
    file: BinaryIO, messages: Sequence[tuple[Message, bytes]], channels: Mapping[str, int], done: dict[str, int]
) -> ChunkIndex:
    """One chunk of messages; ``done`` counts those on each topic."""
    body = bytearray()
    entries: dict[int, list[tuple[int, int]]] = {}
    for message, data in messages:
        channel, stamp = channels[message.topic], message.stamp_ns
        entries.setdefault(channel, []).append((stamp, len(body)))
        body += _RECORD.pack(Opcode.MESSAGE, _RECORD.size - 9 + len(data), channel, done[message.topic], stamp, stamp)
        body += data
        done[message.topic] += 1
    return _put_chunk(file, bytes(body), {channel: np.array(held, np.int64) for channel, held in entries.items()})


def _put_chunk(file: BinaryIO, body: bytes, index: Mapping[int, NDArray[np.int64]]) -> ChunkIndex:
    """Write a chunk of records and its message indices: (n, 2) stamp [ns] and place in ``body``, of each channel."""
    stamps = np.concatenate([entries[:, 0] for entries in index.values()])
    packed = zstandard.ZstdCompressor(level=1).compress(body)
    chunk = Chunk("zstd", packed, int(stamps.max()), int(stamps.min()), zlib.crc32(body), len(body))
    at = file.tell()
    length = _put(file, chunk)
    index_start = file.tell()
    offsets: dict[int, int] = {}
    for channel, entries in index.items():
        offsets[channel] = file.tell()
        raw = entries.astype("<u8").tobytes()
        file.write(struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + len(raw), channel, len(raw)))
        file.write(raw)
    return ChunkIndex(
        chunk_length=length,
        chunk_start_offset=at,
        compression="zstd",
        compressed_size=len(packed),
        message_end_time=chunk.message_end_time,
        message_index_length=file.tell() - index_start,
        message_index_offsets=offsets,
        message_start_time=chunk.message_start_time,
        uncompressed_size=len(body),
    )


def _fill(matrix: NDArray[np.uint8], offset: int, values: NDArray[Any]) -> None:
    raw = np.ascontiguousarray(values).view(np.uint8).reshape(len(matrix), -1)
    matrix[:, offset : offset + raw.shape[1]] = raw


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def _put(file: BinaryIO, record: McapRecord) -> int:
    return file.write(_bytes(record))


def _topics(recording: Recording, positions: Array | None, velocities: Array | None, *, frames: bool) -> list[_Topic]:
    n = len(recording)
    pose, twist = "pose.pose.", "twist.twist."
    odometry: dict[str, Array] = {
        f"{pose}position.x": recording.position_world,
        f"{pose}orientation.x": recording.orientation[:, [1, 2, 3, 0]],
        f"{twist}linear.x": recording.velocity_base,
        f"{twist}angular.z": recording.yaw_rate,
    }
    command = {"twist.linear.x": recording.command[:, :2], "twist.angular.z": recording.command[:, 2]}
    feet = {f"poses.{leg}.position.x": recording.feet_base[:, leg] for leg in range(len(LEGS))}
    topics = [
        _topic("/odom", "nav_msgs/msg/Odometry", odometry),
        _topic("/command", "geometry_msgs/msg/TwistStamped", command),
        _topic("/feet", "geometry_msgs/msg/PoseArray", feet),
    ]
    if frames:
        transform = {
            f"{_TRANSFORM}transform.translation.x": recording.position_world,
            f"{_TRANSFORM}transform.rotation.x": odometry[f"{pose}orientation.x"],
        }
        topics.append(_topic("/tf", "tf2_msgs/msg/TFMessage", transform))
    if positions is not None:
        rates = np.zeros((n, 12)) if velocities is None else velocities
        joints = {"position": positions.reshape(n, 12), "velocity": rates.reshape(n, 12)}
        topics.append(_topic("/joint_states", "sensor_msgs/msg/JointState", joints))
    if recording.contact_force is not None:
        for number, leg in enumerate(LEGS):
            force = {"wrench.force.z": recording.contact_force[:, number]}
            topics.append(_topic(f"/contact/{leg}", "geometry_msgs/msg/WrenchStamped", force))
    return topics


def _plan_topics(plan: PlanColumns) -> list[_Topic]:
    footholds = {f"poses.{leg}.position.x": plan.footholds[:, leg] for leg in range(len(LEGS))}
    body = {"pose.position.x": plan.body[:, :3], "pose.orientation.x": plan.body[:, [4, 5, 6, 3]]}
    topics = [
        _topic("/plan/footholds", "geometry_msgs/msg/PoseArray", footholds, frame="odom"),
        _topic("/plan/body", "geometry_msgs/msg/PoseStamped", body),
    ]
    for number, leg in enumerate(LEGS):
        force = {"wrench.force.x": plan.forces[:, number]}
        topics.append(_topic(f"/plan/force/{leg}", "geometry_msgs/msg/WrenchStamped", force))
    return topics


def _named_topic(named: NamedColumns) -> _Topic:
    msgtype, store = "sensor_msgs/msg/JointState", message_types()
    t = store.types
    stamp = t["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    message = t[msgtype](
        header=t["std_msgs/msg/Header"](stamp=stamp, frame_id=""), name=list(named.names),
        position=np.zeros(len(named.names)), velocity=np.zeros(0), effort=np.zeros(0),
    )  # fmt: skip
    template = bytes(store.serialize_cdr(message, msgtype, little_endian=True))
    layout = walk(template, store.fielddefs, msgtype, ros1=False)
    return _Topic(named.topic, msgtype, template, layout, {"position": named.values})


def cloud(stamp: int, points: NDArray[np.float32]) -> bytes:
    """A serialised point cloud (m, 3) in the world frame, with its stamp [ns]."""
    store = message_types()
    t = store.types
    field, header = t["sensor_msgs/msg/PointField"], t["std_msgs/msg/Header"]
    when = t["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    axes = [field(name=axis, offset=4 * k, datatype=field.FLOAT32, count=1) for k, axis in enumerate("xyz")]
    data = np.ascontiguousarray(points, dtype="<f4").view(np.uint8).reshape(-1)
    message = t[_CLOUD](
        header=header(stamp=when, frame_id="odom"), height=1, width=len(points), fields=axes, is_bigendian=False,
        point_step=12, row_step=12 * len(points), data=data, is_dense=True,
    )  # fmt: skip
    return bytes(store.serialize_cdr(message, _CLOUD, little_endian=True))


def _topic(name: str, msgtype: str, columns: dict[str, Array], *, frame: str | None = None) -> _Topic:
    template = _template(msgtype, frame)
    return _Topic(name, msgtype, template, walk(template, message_types().fielddefs, msgtype, ros1=False), columns)


@functools.cache
def message_types() -> Any:
    """The types of messages that are written, as rosbags holds them."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in _GRID_MAP.items():
        store.register(get_types_from_msg(text, name))
    return store


@functools.cache
def definition(msgtype: str) -> str:
    """Return the definition of a message type with all its dependencies, in the form of the MCAP schema ``ros2msg``."""
    return str(message_types().generate_msgdef(msgtype, ros_version=2)[0])


@functools.cache
def _template(msgtype: str, other_frame: str | None = None) -> bytes:
    """A serialised message whose numbers are zero, with its names and lengths in place; in another frame than usual."""
    store = message_types()
    t = store.types
    vector, point = t["geometry_msgs/msg/Vector3"], t["geometry_msgs/msg/Point"]
    zero = vector(x=0.0, y=0.0, z=0.0)
    upright = t["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    pose = t["geometry_msgs/msg/Pose"](position=point(x=0.0, y=0.0, z=0.0), orientation=upright)
    twist = t["geometry_msgs/msg/Twist"](linear=zero, angular=zero)
    numbers = np.zeros(12)

    def header(frame: str) -> Any:
        stamp = t["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
        return t["std_msgs/msg/Header"](stamp=stamp, frame_id=other_frame or frame)

    fields: dict[str, dict[str, Any]] = {
        "nav_msgs/msg/Odometry": {
            "header": header("odom"),
            "child_frame_id": "base",
            "pose": t["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36)),
            "twist": t["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36)),
        },
        "tf2_msgs/msg/TFMessage": {
            "transforms": [
                t["geometry_msgs/msg/TransformStamped"](
                    header=header("odom"),
                    child_frame_id="base",
                    transform=t["geometry_msgs/msg/Transform"](translation=zero, rotation=upright),
                )
            ]
        },
        "geometry_msgs/msg/TwistStamped": {"header": header("base"), "twist": twist},
        "geometry_msgs/msg/PoseArray": {"header": header("base"), "poses": [pose] * len(LEGS)},
        "geometry_msgs/msg/PoseStamped": {"header": header("odom"), "pose": pose},
        "geometry_msgs/msg/WrenchStamped": {
            "header": header("odom"),
            "wrench": t["geometry_msgs/msg/Wrench"](force=zero, torque=zero),
        },
        "sensor_msgs/msg/JointState": {
            "header": header(""),
            "name": [f"{leg}_{joint}" for leg in LEGS for joint in JOINTS],
            "position": numbers,
            "velocity": numbers,
            "effort": np.zeros(0),
        },
    }
    return bytes(store.serialize_cdr(t[msgtype](**fields[msgtype]), msgtype, little_endian=True))
