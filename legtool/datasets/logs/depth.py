"""Depth images of a log, with the camera that took them and where it sits on the trunk."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_typestore

from legtool.configs.topics import DepthSignal, TopicSettings
from legtool.datasets.logs.bagfile import guarded, is_ros1, opened
from legtool.errors import LogError
from legtool_runtime.errors import PerceptionError
from legtool_runtime.perception.camera import Camera
from legtool_runtime.rotations import from_angles, rotation_of

Array = NDArray[np.float64]

#: Frames that are the trunk's, where the topics do not name one.
TRUNKS = ("base", "base_link", "trunk", "body")
#: From an optical frame (x right, y down) to a body's that looks the same way (x ahead, y left).
_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
#: What stands before the picture in a message of compressedDepth [bytes].
_COMPRESSED_HEADER = 12
#: Messages of moving transforms that are read: a camera's joints have all told of themselves by then.
_MOVING = 500
_IMAGE, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


class DepthFrame(NamedTuple):
    """One depth image: its stamp [ns], and depth (h, w) along the optical axis [m], NaN without return."""

    stamp_ns: int
    depth: NDArray[np.float32]


class DepthLog:
    """The depth images of a bag.

    Attributes:
        camera: that took them.
        transform_camera_to_base: (4, 4) optical frame to trunk.
        count: of the images.
    """

    def __init__(self, paths: Sequence[Path], topics: TopicSettings) -> None:
        """Find camera and transforms.

        Raises:
            LogError: no images on the topic, no camera info, or no transform that leads to the trunk.
        """
        assert topics.depth is not None
        self._paths, self._signal, self._stamps = tuple(paths), topics.depth, topics.depth.stamps or topics.stamps
        signal, path = topics.depth, paths[0]
        with opened(*paths) as bag:
            images = [c for c in bag.connections if c.topic == signal.topic and c.msgcount]
            if not images:
                there = [c.topic for c in bag.connections if c.msgtype in (_IMAGE, _COMPRESSED)]
                raise LogError(f"{path}: no depth images on {signal.topic}; image topics there: {_listed(there)}")
            if images[0].msgtype not in (_IMAGE, _COMPRESSED):
                raise LogError(f"{path}: topic {signal.topic} holds {images[0].msgtype}, expected depth images")
            self.count = sum(c.msgcount for c in images)
            first = _first(bag, images, path)
            info = _first(bag, [c for c in bag.connections if c.topic == signal.camera_info and c.msgcount], path)
            if info is None:
                raise LogError(f"{path}: no camera info on {signal.camera_info}; set depth: {{info: …}}")
            self.camera = _camera(info, f"{path}: topic {signal.camera_info}")
            self.transform_camera_to_base = (
                _mount(signal) if signal.position is not None else _chain(bag, first.header.frame_id, signal, path)
            )

    def frames(self) -> Iterator[DepthFrame]:
        """Yield the images in the order of the log.

        Raises:
            LogError: an image is damaged, of another encoding, or of another size than the camera's.
        """
        path, where = self._paths[0], f"{self._paths[0]}: topic {self._signal.topic}"
        with opened(*self._paths) as bag:
            wanted = [c for c in bag.connections if c.topic == self._signal.topic]
            for connection, stamp, raw in guarded(path, bag.messages(wanted)):
                message = _decode(connection, raw)
                header = int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)
                depth = _metres(message, where)
                if depth.shape != (self.camera.height, self.camera.width):
                    raise LogError(
                        f"{where}: an image of {depth.shape[1]} x {depth.shape[0]} pixels, the camera info is for "
                        f"{self.camera.width} x {self.camera.height}; set depth: {{info: …}} to that of this image"
                    )
                yield DepthFrame(header if header and self._stamps == "header" else int(stamp), depth)


def _first(bag: Any, connections: Sequence[Connection], path: Path) -> Any:
    """The first message on some connections, None where there are none."""
    for connection, _, raw in guarded(path, bag.messages(connections) if connections else iter(())):
        return _decode(connection, raw)
    return None


def _decode(connection: Connection, raw: Any) -> Any:
    if is_ros1(connection):
        return _types(Stores.ROS1_NOETIC).deserialize_ros1(raw, connection.msgtype)
    return _types(Stores.ROS2_HUMBLE).deserialize_cdr(raw, connection.msgtype)


@functools.cache
def _types(kind: Stores) -> Any:
    """Types of messages: making them takes longer than reading hundreds of messages."""
    return get_typestore(kind)


def _camera(info: Any, where: str) -> Camera:
    k = info.k if hasattr(info, "k") else info.K
    try:
        return Camera(int(info.width), int(info.height), float(k[0]), float(k[4]), float(k[2]), float(k[5]))
    except PerceptionError as error:
        raise LogError(f"{where}: {error}") from error


def _metres(message: Any, where: str) -> NDArray[np.float32]:
    """Depth (h, w) of an image message."""
    if hasattr(message, "format"):
        picture = cv2.imdecode(np.asarray(message.data)[_COMPRESSED_HEADER:], cv2.IMREAD_UNCHANGED)
        if picture is None or picture.dtype != np.uint16:
            raise LogError(f"{where}: a picture in {message.format!r}, expected 16UC1; compressedDepth png")
        return _from_millimetres(picture)
    order, data = ">" if message.is_bigendian else "<", np.ascontiguousarray(message.data).view(np.uint8)
    kinds = {"32FC1": "f4", "16UC1": "u2", "mono16": "u2"}
    if message.encoding not in kinds:
        raise LogError(f"{where}: images are encoded as {message.encoding}, expected depth: {', '.join(kinds)}")
    dtype = np.dtype(order + kinds[message.encoding])
    if data.size != message.step * message.height or message.step < message.width * dtype.itemsize:
        raise LogError(f"{where}: an image holds {data.size} bytes, expected {message.height} rows of {message.step}")
    rows = data.reshape(message.height, message.step)[:, : message.width * dtype.itemsize]
    pixels = np.ascontiguousarray(rows).view(dtype)
    if dtype.kind == "u":
        return _from_millimetres(pixels)
    return np.array(pixels, dtype=np.float32)  # a copy that can be written: kernels are compiled for one kind of array


def _from_millimetres(pixels: NDArray[Any]) -> NDArray[np.float32]:
    return np.where(pixels > 0, pixels * np.float32(1e-3), np.float32(np.nan)).astype(np.float32)


def _mount(signal: DepthSignal) -> Array:
    pose = np.eye(4)
    pose[:3, :3] = from_angles(0.0, signal.pitch, 0.0) @ _OPTICAL
    pose[:3, 3] = signal.position
    return pose


def _chain(bag: Any, frame: str, signal: DepthSignal, path: Path) -> Array:
    """The transform from a frame up to the trunk's."""
    parents: dict[str, tuple[str, Array]] = {}
    for ending, most in (("/tf_static", None), ("/tf", _MOVING)):
        wanted = [c for c in bag.connections if c.topic.endswith(ending) and c.msgcount]
        messages = guarded(path, bag.messages(wanted)) if wanted else iter(())
        for connection, _, raw in itertools.islice(messages, most):
            for one in _decode(connection, raw).transforms:
                parents.setdefault(_plain(one.child_frame_id), (_plain(one.header.frame_id), _pose(one.transform)))
    trunks = (signal.base,) if signal.base is not None else TRUNKS
    pose, at, seen = np.eye(4), _plain(frame), set[str]()
    while at not in trunks:
        if at not in parents or at in seen:
            raise LogError(
                f"{path}: topic {signal.topic}: no transform leads from its frame {frame!r} to {' or '.join(trunks)}; "
                f"transforms there are of: {_listed(sorted(parents))}; set depth: {{base: …}}, or position and pitch"
            )
        seen.add(at)
        at, step = parents[at]
        pose = step @ pose
    return pose


def _plain(frame: str) -> str:
    return frame.lstrip("/")


def _pose(transform: Any) -> Array:
    pose, q, t = np.eye(4), transform.rotation, transform.translation
    pose[:3, :3], pose[:3, 3] = rotation_of([q.w, q.x, q.y, q.z]), (t.x, t.y, t.z)
    return pose


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"


def metadata_of(path: Path) -> Mapping[str, str]:
    """What legtool wrote into an MCAP recording beside its messages; empty of any other log."""
    if not path.is_file() or path.suffix.lower() != ".mcap":
        return {}
    from mcap.reader import make_reader

    try:
        with path.open("rb") as file:
            for record in make_reader(file).iter_metadata():
                if record.name == "legtool":
                    return dict(record.metadata)
    except Exception:  # a damaged file: what reads its messages explains it
        return {}
    return {}
