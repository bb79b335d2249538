"""What a robot saw and planned as ROS 2 messages that Foxglove, RViz and Rerun draw; all in the frame ``odom``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool.datasets.logs.mcap_writer import Message, cloud, message_types
from legtool_runtime.perception.camera import Camera
from legtool_runtime.perception.regions import Regions
from legtool_runtime.rotations import quaternion_of
from legtool_runtime.terrain.costmap import FootCostmap
from legtool_runtime.terrain.elevation import HeightMap

Array = NDArray[np.float64]
#: Red, green, blue and opacity.
Colour = tuple[float, float, float, float]

BLUE, ORANGE, GREEN, RED, GREY, VIOLET = (
    (0.12, 0.37, 0.66, 1.0), (0.77, 0.32, 0.11, 1.0), (0.17, 0.49, 0.31, 1.0), (0.71, 0.14, 0.18, 1.0),
    (0.45, 0.48, 0.52, 0.6), (0.49, 0.23, 0.93, 1.0),
)  # fmt: skip
#: The frames of recordings: the world, the trunk, and the camera's optical one.
WORLD, BASE, OPTICAL = "odom", "base", "camera_optical"
_MARKERS, _GRID, _MAP = "visualization_msgs/msg/MarkerArray", "nav_msgs/msg/OccupancyGrid", "grid_map_msgs/msg/GridMap"
_IMAGE, _INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
#: Kinds of markers, as visualization_msgs numbers them.
LINE_STRIP, LINE_LIST, SPHERE_LIST, TRIANGLE_LIST = 4, 5, 7, 11


class Shape(NamedTuple):
    """One marker: points (n, 3) in the world frame [m] that are drawn as spheres, lines or triangles.

    Attributes:
        space: name under which a viewer lists it; with ``number`` it takes the place of the one before.
        kind: ``LINE_STRIP``, ``LINE_LIST``, ``SPHERE_LIST`` or ``TRIANGLE_LIST``.
        points: (n, 3) [m].
        colour: of all points, or (n, 4) of each.
        size: diameter of spheres, width of lines [m].
    """

    space: str
    kind: int
    points: Array
    colour: Colour | Array
    size: float


def markers(stamp_ns: int, topic: str, shapes: Sequence[Shape]) -> Message:
    """Shapes as one message, which replaces all that the topic showed before."""
    t = message_types().types
    clear = _marker(stamp_ns, Shape("", SPHERE_LIST, np.empty((0, 3)), GREY, 0.0), 0, action=3)
    drawn = [_marker(stamp_ns, shape, number) for number, shape in enumerate(shapes) if len(shape.points)]
    return _message(stamp_ns, topic, _MARKERS, t[_MARKERS](markers=[clear, *drawn]))


def occupancy(stamp_ns: int, topic: str, costmap: FootCostmap) -> Message:
    """Where feet may not stand: 100 unsafe, 0 safe, -1 never seen."""
    t = message_types().types
    values = np.where(costmap.known, np.where(costmap.unsafe, 100, 0), -1).astype(np.int8)
    corner = costmap.lower_corner
    info = t["nav_msgs/msg/MapMetaData"](
        map_load_time=_time(stamp_ns), resolution=float(costmap.resolution_m), width=values.shape[0],
        height=values.shape[1], origin=_pose([corner[0], corner[1], 0.0]),
    )  # fmt: skip
    grid = t[_GRID](header=_header(stamp_ns), info=info, data=np.ascontiguousarray(values.T).ravel())
    return _message(stamp_ns, topic, _GRID, grid)


def grid_map(stamp_ns: int, topic: str, terrain: HeightMap) -> Message:
    """Heights as the layer ``elevation``, NaN where unknown."""
    t = message_types().types
    n_x, n_y = terrain.heights.shape
    # Its cells count from the far left corner back and to the right, column after column.
    data = np.ascontiguousarray(terrain.heights[::-1, ::-1].T).ravel().astype(np.float32)
    dimension, layout = t["std_msgs/msg/MultiArrayDimension"], t["std_msgs/msg/MultiArrayLayout"]
    dims = [
        dimension(label="column_index", size=n_y, stride=n_x * n_y),
        dimension(label="row_index", size=n_x, stride=n_x),
    ]
    info = t["grid_map_msgs/msg/GridMapInfo"](
        resolution=float(terrain.resolution_m), length_x=n_x * terrain.resolution_m,
        length_y=n_y * terrain.resolution_m, pose=_pose([*terrain.center, 0.0]),
    )  # fmt: skip
    message = t[_MAP](
        header=_header(stamp_ns), info=info, layers=["elevation"], basic_layers=["elevation"],
        data=[t["std_msgs/msg/Float32MultiArray"](layout=layout(dim=dims, data_offset=0), data=data)],
        outer_start_index=0, inner_start_index=0,
    )  # fmt: skip
    return _message(stamp_ns, topic, _MAP, message)


def points(stamp_ns: int, topic: str, at: NDArray[np.float32]) -> Message:
    """A cloud of points (n, 3), world frame [m]."""
    return Message(stamp_ns, topic, "sensor_msgs/msg/PointCloud2", cloud(stamp_ns, at))


def outlines(regions: Regions, colour: Colour = GREEN) -> list[Shape]:
    """The outlines of planar regions."""
    out = []
    for index in range(len(regions)):
        corners = regions.corners_world(index)
        out.append(Shape("regions", LINE_STRIP, np.vstack([corners, corners[:1]]), colour, 0.01))
    return out


def image(stamp_ns: int, topic: str, pixels: NDArray[Any], frame: str = OPTICAL) -> Message:
    """An image of depth [m] (float32), or of labels (uint8)."""
    t = message_types().types
    pixels = np.ascontiguousarray(pixels)
    message = t[_IMAGE](
        header=_header(stamp_ns, frame), height=pixels.shape[0], width=pixels.shape[1],
        encoding="32FC1" if pixels.dtype == np.float32 else "mono8", is_bigendian=0, step=pixels.strides[0],
        data=pixels.view(np.uint8).ravel(),
    )  # fmt: skip
    return _message(stamp_ns, topic, _IMAGE, message)


def camera_info(stamp_ns: int, topic: str, camera: Camera, frame: str = OPTICAL) -> Message:
    """The intrinsics of a camera without distortion."""
    t = message_types().types
    k = np.array([camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0])
    window = t["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    message = t[_INFO](
        header=_header(stamp_ns, frame), height=camera.height, width=camera.width, distortion_model="plumb_bob",
        d=np.zeros(5), k=k, r=np.eye(3).ravel(), p=np.insert(k, [3, 6, 9], 0.0), binning_x=0, binning_y=0, roi=window,
    )  # fmt: skip
    return _message(stamp_ns, topic, _INFO, message)


def fixed_frame(stamp_ns: int, transform: ArrayLike, child: str = OPTICAL) -> Message:
    """Where a frame is in the trunk's, (4, 4), for good: a message on ``/tf_static``."""
    t, pose = message_types().types, np.asarray(transform, dtype=np.float64)
    w, x, y, z = (float(value) for value in quaternion_of(pose[:3, :3]))
    a, b, c = (float(value) for value in pose[:3, 3])
    moved = t["geometry_msgs/msg/Transform"](
        translation=t["geometry_msgs/msg/Vector3"](x=a, y=b, z=c),
        rotation=t["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
    )
    one = t["geometry_msgs/msg/TransformStamped"](header=_header(stamp_ns, BASE), child_frame_id=child, transform=moved)
    return _message(stamp_ns, "/tf_static", "tf2_msgs/msg/TFMessage", t["tf2_msgs/msg/TFMessage"](transforms=[one]))


def number(stamp_ns: int, topic: str, value: float) -> Message:
    """A number, such as a time [s]."""
    kind = "std_msgs/msg/Float64"
    return _message(stamp_ns, topic, kind, message_types().types[kind](data=float(value)))


def _message(stamp_ns: int, topic: str, msgtype: str, message: Any) -> Message:
    data = bytes(message_types().serialize_cdr(message, msgtype, little_endian=True))
    return Message(stamp_ns, topic, msgtype, data)


def _time(stamp_ns: int) -> Any:
    return message_types().types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)


def _header(stamp_ns: int, frame: str = WORLD) -> Any:
    return message_types().types["std_msgs/msg/Header"](stamp=_time(stamp_ns), frame_id=frame)


def _pose(position: ArrayLike) -> Any:
    t = message_types().types
    x, y, z = (float(value) for value in np.asarray(position))
    upright = t["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    return t["geometry_msgs/msg/Pose"](position=t["geometry_msgs/msg/Point"](x=x, y=y, z=z), orientation=upright)


def _marker(stamp_ns: int, shape: Shape, count: int, *, action: int = 0) -> Any:
    t = message_types().types
    point, tint, vector = t["geometry_msgs/msg/Point"], t["std_msgs/msg/ColorRGBA"], t["geometry_msgs/msg/Vector3"]
    colours = np.asarray(shape.colour, dtype=np.float64)
    first = colours if colours.ndim == 1 else (*GREY[:3], 1.0)
    each = [tint(r=r, g=g, b=b, a=a) for r, g, b, a in colours.tolist()] if colours.ndim == 2 else []
    kind = "visualization_msgs/msg/Marker"
    given = {
        "header": _header(stamp_ns), "ns": shape.space, "id": count, "type": shape.kind, "action": action,
        "pose": _pose(np.zeros(3)), "scale": vector(x=shape.size or 1.0, y=shape.size or 1.0, z=shape.size or 1.0),
        "color": tint(*(float(value) for value in first)),
        "lifetime": t["builtin_interfaces/msg/Duration"](sec=0, nanosec=0), "frame_locked": False,
        "points": [point(x=x, y=y, z=z) for x, y, z in np.asarray(shape.points, dtype=np.float64).tolist()],
        "colors": each, "texture_resource": "", "text": "", "mesh_resource": "", "mesh_use_embedded_materials": False,
        "texture": t["sensor_msgs/msg/CompressedImage"](
            header=_header(stamp_ns), format="", data=np.zeros(0, dtype=np.uint8)
        ),
        "uv_coordinates": [],
        "mesh_file": t["visualization_msgs/msg/MeshFile"](filename="", data=np.zeros(0, dtype=np.uint8)),
    }  # fmt: skip
    return t[kind](**given)
