"""Recognise signals by the names of columns: pos_x, base_position.0, /odom/pose/pose/position/x, FL_foot_z, cmd_vx …"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from legtool.configs.topics import Csv
from legtool.datasets.logs.jointnames import joint_order
from legtool.datasets.logs.tablefiles import find_delimiter, has_header, open_table
from legtool_runtime.robot import LEGS

#: What a column's name must hold, and must not, to be part of a signal; names are lower case, words joined by _.
_WORDS = {
    "command": (r"(^|_)(cmd|command|commands|reference|ref)", r"joint|torque"),
    "yaw_rate": (r"yaw_?rate|yaw_?speed|(ang|angular)_?vel\w*_(z|2)$|(^|_)w_?z$|angular_z$", r"joint|foot|cmd|command"),
    "velocity": (r"(^|_)(v|vel|velocity|lin_vel|linear|speed)", r"joint|foot|feet|ang|cmd|command|yaw|leg"),
    "orientation": (r"quat|orientation|(^|_)(rot|q)_?[wxyz0-3]$|_rot$", r"joint|foot|cmd|command"),
    "position": (r"(^|_)(p|pos|position|trans|translation)", r"joint|foot|feet|cmd|command|leg"),
}
_COMPONENTS = {"position": "xyz", "velocity": "xyz", "orientation": "xyzw"}
_TIMES = ("__time", "time", "t", "stamp", "timestamp", "time_s", "sec", "seconds")


def guess_columns(names: Sequence[str]) -> tuple[dict[str, Any], str | None]:
    """Guess what columns hold.

    Args:
        names: of the columns, in order.

    Returns:
        settings of signals by name, as in a topics YAML, and the column of the time, None if there is none.
    """
    plain = {name: re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") for name in names}
    stamp = next((name for want in _TIMES for name in names if name.lower().strip() == want), None)
    left = [name for name in names if name != stamp]
    signals: dict[str, Any] = {}

    def take(signal: str, chosen: list[str], **more: Any) -> None:
        signals[signal] = {"columns": chosen, **more}
        for name in chosen:
            left.remove(name)

    joints = [name for name in left if re.search(r"joint|hip|thigh|calf|knee|haa|hfe|kfe", plain[name])]
    joints = [name for name in joints if not re.search(r"vel|torque|effort|tau|foot", plain[name])]
    order = joint_order([plain[name].removesuffix("_position").removesuffix("_pos") for name in joints], ())
    if order is not None:
        take("joints", [joints[index] for index in order])
    elif len(joints) == 12:
        take("joints", joints, order="joint" if re.search(r"^joint_pos", plain[joints[0]]) else "leg")
    _take_legs(left, plain, take)
    for signal, (wanted, unwanted) in _WORDS.items():
        found = [name for name in left if re.search(wanted, plain[name]) and not re.search(unwanted, plain[name])]
        if signal == "command":
            # without the unwanted words: a command's columns are vx, vy and the yaw rate, in this order
            found = [name for name in left if re.search(wanted, plain[name])]
        count = {"command": 3, "yaw_rate": 1, "orientation": 4}.get(signal, 3)
        if signal == "orientation" and len(found) == 4:
            letters = [plain[name][-1] for name in found]
            first_w = (letters[0] in "w0" and letters != list("0123")) or letters == list("0123")
            take(signal, found, order="wxyz" if first_w else "xyzw")
        elif len(found) >= count:
            take(signal, found[:count])
    return signals, stamp


def rate_of(path: Path, stamp: str) -> dict[str, float]:
    """Usual rate [Hz] and longest gap [s] of a table whose column ``stamp`` is its time in seconds; empty if it is not.

    Raises:
        LogError: the table is damaged.
    """
    table = open_table(path, Csv(files={path.name: None}, header=has_header(path), delimiter=find_delimiter(path)))
    column = table.names.index(stamp)
    texts = [cell for _, columns in table.blocks([column]) for cell in columns[column].to_pylist()]
    try:
        times = np.array([float(str(text).replace(",", ".")) for text in texts if str(text).strip()])
    except ValueError:
        return {}
    steps = np.diff(times)
    if not len(steps) or float(np.median(steps)) <= 0:
        return {}
    return {"rate_hz": 1.0 / float(np.median(steps)), "longest_gap_s": float(steps.max())}


def _take_legs(left: list[str], plain: dict[str, str], take: Any) -> None:
    """Columns that are named by legs: feet, three for each, and contact, one for each."""
    by_leg = {leg: [n for n in left if re.search(rf"(^|_){leg.lower()}(_|$)", plain[n])] for leg in LEGS}
    if all(len(columns) >= 3 for columns in by_leg.values()):
        feet = {leg: [n for n in columns if re.search(r"_[xyz]$", plain[n])][:3] for leg, columns in by_leg.items()}
        if all(len(columns) == 3 for columns in feet.values()):
            take("feet", [name for leg in LEGS for name in feet[leg]])
            by_leg = {leg: [n for n in columns if n in left] for leg, columns in by_leg.items()}
    forces = {leg: [n for n in columns if not re.search(r"vel", plain[n])][:1] for leg, columns in by_leg.items()}
    if all(len(columns) == 1 for columns in forces.values()):
        take("contact", [forces[leg][0] for leg in LEGS])
