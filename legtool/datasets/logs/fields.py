"""Find the fields of a message that contain a signal: by its type if that is a standard one, else as the user says."""

from __future__ import annotations

import json
from typing import Any, NamedTuple

from legtool.configs.topics import Contact, Signal
from legtool.datasets.logs.layout import Layout
from legtool.datasets.logs.signals import WIDTH
from legtool.errors import LogError

_Paths = dict[str, tuple[str, ...]]
_POSE: _Paths = {"position": ("pose.position",), "orientation": ("pose.orientation",)}
_POSE_COVARIANCE: _Paths = {"position": ("pose.pose.position",), "orientation": ("pose.pose.orientation",)}
_NUMBERS: _Paths = {name: ("data",) for name in WIDTH}


def _twist(path: str) -> _Paths:
    linear, angular = f"{path}linear", f"{path}angular"
    return {
        "velocity": (linear,),
        "yaw_rate": (f"{angular}.z",),
        "command": (f"{linear}.x", f"{linear}.y", f"{angular}.z"),
    }


#: Signals of standard messages. A command in a Vector3 is vx, vy, yaw rate.
STANDARD: dict[str, _Paths] = {
    "nav_msgs/msg/Odometry": {**_POSE_COVARIANCE, **_twist("twist.twist.")},
    "geometry_msgs/msg/PoseStamped": _POSE,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _POSE_COVARIANCE,
    "geometry_msgs/msg/TransformStamped": {
        "position": ("transform.translation",),
        "orientation": ("transform.rotation",),
    },
    "geometry_msgs/msg/Twist": _twist(""),
    "geometry_msgs/msg/TwistStamped": _twist("twist."),
    "geometry_msgs/msg/TwistWithCovarianceStamped": _twist("twist.twist."),
    "geometry_msgs/msg/Vector3": {"command": ("x", "y", "z"), "velocity": ("x", "y", "z")},
    "geometry_msgs/msg/Vector3Stamped": {"command": ("vector",), "velocity": ("vector",)},
    "geometry_msgs/msg/PointStamped": {"position": ("point",), "feet": ("point",)},
    "geometry_msgs/msg/PoseArray": {"feet": ("poses.*.position",)},
    "geometry_msgs/msg/Wrench": {"contact": ("force",)},
    "geometry_msgs/msg/WrenchStamped": {"contact": ("wrench.force",)},
    "gazebo_msgs/msg/ContactsState": {"contact": ("states.*.total_wrench.force",)},
    "sensor_msgs/msg/Imu": {"orientation": ("orientation",), "yaw_rate": ("angular_velocity.z",)},
    "sensor_msgs/msg/JointState": {"joints": ("position",)},
    "unitree_go/msg/LowState": {"joints": ("motor_state.0-11.q",), "contact": ("foot_force",)},
    "vicon_receiver/msg/Position": {
        "position": ("x_trans", "y_trans", "z_trans"),
        "orientation": ("x_rot", "y_rot", "z_rot", "w"),
    },
    "std_msgs/msg/Float32MultiArray": _NUMBERS,
    "std_msgs/msg/Float64MultiArray": _NUMBERS,
    "std_msgs/msg/Float32": _NUMBERS,
    "std_msgs/msg/Float64": _NUMBERS,
}


class Place(NamedTuple):
    """Where a signal is in messages of one layout.

    Attributes:
        paths: leaves, side by side.
        json: (path of a string, keys in the JSON text that it holds), for signals that are sent as text.
        absent: whether it lies in a sequence that is empty here: no contact, no force.
    """

    paths: tuple[str, ...] = ()
    json: tuple[tuple[str, tuple[str, ...]], ...] = ()
    absent: bool = False


def find_signal(name: str, signal: Signal, msgtype: str, layout: Layout, where: str) -> Place:
    """Find a signal in a message.

    Args:
        name: name of the signal.
        signal: its settings; ``field`` may name the place.
        msgtype: type of the message.
        layout: layout of the message.
        where: topic and type, for error messages.

    Raises:
        LogError: the type is not a standard one and no field is given, or there is no such field.
    """
    given = (signal.field,) if isinstance(signal.field, str) else signal.field
    wanted = given if given is not None else STANDARD.get(msgtype, {}).get(name)
    if wanted is None:
        raise LogError(
            f"{where}: this type does not say where {name} is; give the field ({name}: {{field: …}}), such as one "
            f"of: {_some(layout)}"
        )
    paths: list[str] = []
    texts: list[tuple[str, tuple[str, ...]]] = []
    for path in wanted:
        if found := layout.find(path):
            paths += found
        elif text := _text_of(path, layout):
            texts.append(text)
        elif isinstance(signal, Contact) and any(path.startswith(f"{empty}.") for empty in layout.empty):
            return Place(absent=True)
        else:
            named = f"; elements there: {', '.join(layout.names.values())}" if layout.names else ""
            raise LogError(f"{where}: has no field {path} for {name}; fields there: {_some(layout)}{named}")
    return Place(tuple(paths), tuple(texts))


def _text_of(path: str, layout: Layout) -> tuple[str, tuple[str, ...]] | None:
    """The string that a path leads into, and the keys beyond it."""
    parts = path.split(".")
    for number in range(len(parts) - 1, 0, -1):
        if (place := ".".join(parts[:number])) in layout.strings:
            return place, tuple(parts[number:])
    return None


def json_number(text: str, keys: tuple[str, ...]) -> float:
    """A number in JSON text; NaN if there is none of that key."""
    try:
        value: Any = json.loads(text)
        for key in keys:
            value = value[int(key) if isinstance(value, list) else key]
        return float(value)
    except (ValueError, KeyError, IndexError, TypeError):
        return float("nan")


def _some(layout: Layout) -> str:
    names = list(layout.leaves)
    return ", ".join(names[:12]) + (", …" if len(names) > 12 else "")
