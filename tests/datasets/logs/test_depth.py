"""Depth images of a bag: encodings, cameras and transforms as recorders write them."""

import cv2
import numpy as np
import pytest

from legtool.configs.topics import load_topics
from legtool.datasets.logs import scene_messages as scene
from legtool.datasets.logs.depth import DepthLog
from legtool.datasets.logs.mcap_writer import message_types
from legtool.errors import LogError
from legtool_runtime.perception.camera import Camera
from legtool_runtime.rotations import from_angles
from legtool_runtime.terrain.costmap import FootCostmap
from legtool_runtime.terrain.elevation import HeightMap

CAMERA = Camera(8, 6, 9.0, 9.5, 3.5, 2.5)
STAMP = 1_700_000_000_250_000_000


def serialised(kind, **fields):
    t = message_types()
    return bytes(t.serialize_cdr(t.types[kind](**fields), kind, little_endian=True))


def image(depth, encoding, *, big=False, padding=0):
    t = message_types().types
    kind = np.dtype((">" if big else "<") + ("f4" if encoding == "32FC1" else "u2"))
    rows = depth.astype(kind).view(np.uint8).reshape(len(depth), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)))
    header = t["std_msgs/msg/Header"](
        stamp=t["builtin_interfaces/msg/Time"](sec=STAMP // 10**9, nanosec=STAMP % 10**9), frame_id="camera_optical"
    )
    return "sensor_msgs/msg/Image", serialised(
        "sensor_msgs/msg/Image", header=header, height=depth.shape[0], width=depth.shape[1], encoding=encoding,
        is_bigendian=int(big), step=rows.shape[1], data=rows.ravel(),
    )  # fmt: skip


def compressed(depth):
    t = message_types().types
    header = t["std_msgs/msg/Header"](
        stamp=t["builtin_interfaces/msg/Time"](sec=0, nanosec=0), frame_id="camera_optical"
    )
    data = np.concatenate([np.zeros(12, np.uint8), cv2.imencode(".png", depth.astype(np.uint16))[1].ravel()])
    kind = "sensor_msgs/msg/CompressedImage"
    return kind, serialised(kind, header=header, format="16UC1; compressedDepth png", data=data)


def write(path, images, transforms):
    from rosbags.rosbag2 import StoragePlugin, Writer

    mount = np.eye(4)
    info = scene.camera_info(STAMP, "/camera/depth/camera_info", CAMERA)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        made = {}
        events = [("/camera/depth/image", *one, STAMP + 10**6) for one in images]
        events += [(info.topic, info.msgtype, info.data, STAMP)]
        for child, parent, pose in transforms:
            static = scene.fixed_frame(STAMP, mount if pose is None else pose, child)
            text = static.data.replace(b"base\x00", parent.encode() + b"\x00") if parent != "base" else static.data
            events.append((static.topic, static.msgtype, text, STAMP))
        for topic, kind, data, stamp in events:
            if topic not in made:
                made[topic] = writer.add_connection(topic, kind, typestore=message_types())
            writer.write(made[topic], stamp, data)
    return path


TOPICS = load_topics("legtool")
ROTATED = np.eye(4)
ROTATED[:3, :3], ROTATED[:3, 3] = from_angles(0.1, 0.4, -0.2), (0.3, 0.02, 0.05)


@pytest.mark.parametrize("kind", ["32FC1", "16UC1", "mono16", "big", "padded", "png"])
def test_depth_is_metres_whatever_its_encoding(tmp_path, kind):
    depth = np.linspace(0.5, 4.0, 48).reshape(6, 8)
    depth[2, 3] = 0.0
    millimetres = (1e3 * depth).round()
    made = {
        "32FC1": lambda: image(np.where(depth > 0, depth, np.nan), "32FC1"),
        "16UC1": lambda: image(millimetres, "16UC1"),
        "mono16": lambda: image(millimetres, "mono16"),
        "big": lambda: image(millimetres, "16UC1", big=True),
        "padded": lambda: image(millimetres, "16UC1", padding=6),
        "png": lambda: compressed(millimetres),
    }[kind]()
    log = DepthLog([write(tmp_path / "bag", [made], [("camera_optical", "base", ROTATED)])], TOPICS)
    (frame,) = log.frames()
    assert frame.depth.dtype == np.float32 and frame.depth.flags.writeable
    assert np.isnan(frame.depth[2, 3]) and np.isnan(frame.depth).sum() == 1
    assert np.nanmax(np.abs(frame.depth - depth)[depth > 0]) < 6e-4
    assert frame.stamp_ns == (STAMP + 10**6 if kind == "png" else STAMP)  # without a header's stamp that of logging
    assert log.camera == CAMERA and np.allclose(log.transform_camera_to_base, ROTATED)


def test_the_camera_may_hang_on_other_frames(tmp_path):
    arm = np.eye(4)
    arm[:3, 3] = (0.0, 0.1, 0.2)
    links = [("camera_optical", "head", ROTATED), ("head", "base", arm)]
    log = DepthLog([write(tmp_path / "bag", [image(np.ones((6, 8)), "32FC1")], links)], TOPICS)
    assert np.allclose(log.transform_camera_to_base, arm @ ROTATED)


@pytest.mark.parametrize(
    ("images", "links", "expected"),
    [
        ([image(np.ones((6, 8)), "32FC1")], [], "no transform leads from its frame 'camera_optical' to base or"),
        (
            [image(np.ones((6, 8)), "32FC1")],
            [("camera_optical", "lost", ROTATED)],
            "transforms there are of: camera_o",
        ),
        ([image(np.ones((5, 8)), "32FC1")], [("camera_optical", "base", ROTATED)], "an image of 8 x 5 pixels"),
        ([], [], "no depth images on /camera/depth/image; image topics there: none"),
    ],
)
def test_what_is_lacking_is_named(tmp_path, images, links, expected):
    path = write(tmp_path / "bag", images, links)
    with pytest.raises(LogError, match=expected):
        list(DepthLog([path], TOPICS).frames())


def test_maps_have_the_axes_of_their_messages():
    heights = np.full((4, 3), np.nan, np.float32)
    heights[3, 0] = 0.5  # farthest ahead, on the right
    store = message_types()
    told = scene.grid_map(0, "/map", HeightMap(heights, 0.1, (1.0, 2.0)))
    grid = store.deserialize_cdr(told.data, told.msgtype)
    values = np.asarray(grid.data[0].data).reshape(3, 4).T  # columns one after the other
    # A grid map's cell (0, 0) is the one farthest in x and y; rows go backwards, columns to the right.
    assert values[0, 2] == np.float32(0.5) and np.isnan(values).sum() == 11
    assert (grid.info.length_x, grid.info.length_y) == pytest.approx((0.4, 0.3))
    distance = np.ones((4, 3), np.float32)
    distance[3, 0] = 0.0
    known = np.ones((4, 3), np.bool_)
    known[0, 2] = False
    told = scene.occupancy(0, "/map", FootCostmap(distance, known, 0.1, np.array([0.8, 1.85]), True))
    grid = store.deserialize_cdr(told.data, told.msgtype)
    cells = np.asarray(grid.data).reshape(grid.info.height, grid.info.width)  # rows of y, columns of x
    assert cells[0, 3] == 100 and cells[2, 0] == -1 and (cells == 0).sum() == 10
    assert (grid.info.origin.position.x, grid.info.origin.position.y) == (0.8, 1.85)
