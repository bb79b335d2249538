"""Worlds as JSON: oriented boxes and cylinders, a start and a goal, as the QuadPiPS environments are described."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from legtool.errors import SettingsError

#: The radius of the benchmark's goals, for files that give none [m].
GOAL_RADIUS_M = 0.25
#: What lies farther than this below the ground under both start and goal is a pit's floor, off the course [m].
DEEPEST_M = 0.3
#: What describes a file or a part of it without changing the world.
_REMARKS = {"source", "provenance", "frame", "paper", "note", "note_spawn"}
_PART_REMARKS = {"kind", "cropped"}
_RENAMED = {"mu": "friction", "class": "shape"}
_WAY = {"start", "goal", "goal_radius_xy"}


def read_world_json(path: Path) -> dict[str, Any]:
    """The settings of a world that a JSON file describes, not yet checked.

    The file holds ``boxes``: boxes (``center``, full ``size``, ``rpy`` with R = Rz Ry Rx, ``mu``, ``name``) and, with
    ``kind: cylinder``, cylinders (``radius``, ``length`` along local z); ``start`` and ``goal`` with ``torso_xyz`` [m]
    and ``yaw`` [rad]; the radius of the goal in ``goal_radius_xy``, 0.25 m where none is given. A block ``anymal``
    holds another start, goal and radius for that robot.

    These files do not say what is off the course: it is what lies more than 0.3 m below the ground under both start
    and goal, such as the floor of a pit, and what is labelled passable or non-passable; ``ground`` on a box decides
    otherwise.

    Raises:
        SettingsError: not JSON, not an object, or with keys that mean nothing here.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path}: cannot be read as text ({error})") from error
    except json.JSONDecodeError as error:
        raise SettingsError(f"{path}: not valid JSON at line {error.lineno}") from error
    if not isinstance(values, dict):
        raise SettingsError(f"{path}: expected a JSON object with boxes, start and goal, got {type(values).__name__}")
    known = {"name", "boxes", "anymal", *_WAY}
    _refuse(path, values, known | _REMARKS)
    parts = values.get("boxes")
    if not isinstance(parts, list) or not all(isinstance(part, dict) for part in parts):
        raise SettingsError(f"{path}: boxes: expected a list of boxes and cylinders")
    out: dict[str, Any] = {
        "name": str(values.get("name") or re.sub(r"[^a-z0-9]+", "_", path.stem.lower()).strip("_")),
        "source": str(values.get("source", "")),
        "floor": "none",
        "deepest": DEEPEST_M,
        "boxes": [],
        "cylinders": [],
        **_way(path, values),
    }
    for number, part in enumerate(parts):
        kind = part.get("kind", "box")
        if kind not in ("box", "cylinder"):
            raise SettingsError(f"{path}: boxes.{number}: kind is {kind!r}, expected box or cylinder")
        kept = {_RENAMED.get(key, key): value for key, value in part.items() if key not in _PART_REMARKS}
        out["boxes" if kind == "box" else "cylinders"].append(kept)
    if "anymal" in values:
        if not isinstance(values["anymal"], dict):
            raise SettingsError(f"{path}: anymal: expected an object with start and goal")
        _refuse(path, values["anymal"], _WAY | _REMARKS, "anymal.")
        out["robots"] = {"anymal": _way(path, values["anymal"], "anymal.")}
    return out


def _way(path: Path, values: dict[str, Any], where: str = "") -> dict[str, Any]:
    out: dict[str, Any] = {"goal_radius": values.get("goal_radius_xy", GOAL_RADIUS_M)}
    for key in ("start", "goal"):
        pose = values.get(key)
        if pose is None and key == "goal":
            continue
        if not isinstance(pose, dict) or not isinstance(pose.get("torso_xyz"), list) or len(pose["torso_xyz"]) != 3:
            raise SettingsError(f"{path}: {where}{key}: expected an object with torso_xyz, three numbers, and yaw")
        _refuse(path, pose, {"torso_xyz", "yaw"}, f"{where}{key}.")
        x, y, _ = pose["torso_xyz"]
        out[key] = [x, y, pose.get("yaw", 0.0)] if key == "start" else [x, y]
    return out


def _refuse(path: Path, values: dict[str, Any], known: set[str], where: str = "") -> None:
    unknown = sorted(set(values) - known)
    if unknown:
        raise SettingsError(f"{path}: unknown key {where + unknown[0]!r}; expected one of: {', '.join(sorted(known))}")
