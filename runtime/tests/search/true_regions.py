"""Worlds for the searches: rectangles as regions, and the tops of a world's boxes and cylinders."""

import json
from pathlib import Path

import numpy as np

from legtool_runtime.perception.regions import Regions

#: Floors of pits lie farther below than this [m].
DEEPEST_M = 0.3


def regions_of(faces, assumed=None):
    """Regions of faces: (pose (4, 4), corners (n, 2))."""
    faces = list(faces)
    n = len(faces)
    areas = np.array([_area(c) for _, c in faces])
    return Regions(
        np.array([p for p, _ in faces]).reshape(-1, 4, 4), tuple(c for _, c in faces), areas, np.zeros(n), np.zeros(n),
        np.zeros(n, bool) if assumed is None else np.asarray(assumed, bool), np.arange(n), np.arange(n),
    )  # fmt: skip


def _area(corners):
    x, y = corners.T
    return 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


def rectangle(center, size, rotation=None):
    """One face: its middle (3,), its sides (2,) [m], and the rotation of its plane."""
    pose = np.eye(4)
    pose[:3, 3] = center
    if rotation is not None:
        pose[:3, :3] = rotation
    x, y = 0.5 * np.asarray(size, float)
    return pose, np.array([[-x, -y], [x, -y], [x, y], [-x, y]])


def cut(face, side, shift=(0.0, 0.0)):
    """A rectangular face in pieces of at most ``side`` [m], cut along lines that are shifted."""
    pose, corners = face
    low, high = corners.min(axis=0), corners.max(axis=0)
    marks = []
    for k in range(2):
        inner = (
            np.arange(np.ceil((low[k] - shift[k]) / side), np.floor((high[k] - shift[k]) / side) + 1) * side + shift[k]
        )
        inner = inner[(inner > low[k] + 0.02) & (inner < high[k] - 0.02)]
        marks.append(np.concatenate([[low[k]], inner, [high[k]]]))
    for a, b in zip(marks[0][:-1], marks[0][1:], strict=True):
        for c, d in zip(marks[1][:-1], marks[1][1:], strict=True):
            piece = pose.copy()
            piece[:3, 3] += pose[:3, :2] @ [0.5 * (a + b), 0.5 * (c + d)]
            x, y = 0.5 * (b - a), 0.5 * (d - c)
            yield piece, np.array([[-x, -y], [x, -y], [x, y], [-x, y]])


def world(path, robot="go2", *, passable=False):
    """Faces of a world's tops, start (3,) x, y, yaw and goal (2,) for a robot's block of the file; ``passable``: with
    those that feet swing over and do not stand on."""
    values = json.loads(Path(path).read_text())
    way = values.get("anymal", values) if robot == "anymal_c" else values
    start, goal = way.get("start", values["start"]), way.get("goal", values["goal"])
    faces = []
    for part in values["boxes"]:
        stands = part.get("label", part.get("class", "steppable")) in ("steppable", "ground")
        if not (stands or passable) or part.get("ground") is False:
            continue
        roll, pitch, yaw = part.get("rpy", (0, 0, 0))
        turn = _rz(yaw) @ _ry(pitch) @ _rx(roll)
        if part.get("kind", "box") == "cylinder":
            pose, up = np.eye(4), turn[:, 2] * np.sign(turn[2, 2])
            pose[:3, :3] = np.stack([turn[:, 0], np.cross(up, turn[:, 0]), up], axis=1)
            pose[:3, 3] = np.array(part["center"]) + 0.5 * part["length"] * up
            angle = np.arange(16) * np.pi / 8
            faces.append((pose, part["radius"] * np.stack([np.cos(angle), np.sin(angle)], axis=1)))
            continue
        axis = int(np.argmax(np.abs(turn[2])))
        up = turn[:, axis] * np.sign(turn[2, axis])
        first = turn[:, (axis + 1) % 3]
        rotation = np.stack([first, np.cross(up, first), up], axis=1)
        size = np.array(part["size"])
        middle = np.array(part["center"]) + 0.5 * size[axis] * up
        faces.append(rectangle(middle, (size[(axis + 1) % 3], size[(axis + 2) % 3]), rotation))
    under = _under(faces, start["torso_xyz"][:2])
    deep = min(under, _under(faces, goal["torso_xyz"][:2])) - DEEPEST_M
    kept = [f for f in faces if _highest(f) > deep]
    return kept, np.array([*start["torso_xyz"][:2], start.get("yaw", 0.0)]), np.array(goal["torso_xyz"][:2])


def _highest(face):
    pose, corners = face
    return float((corners @ pose[2, :2] + pose[2, 3]).max())


def _under(faces, place):
    """Height of the highest face under a place; 0 where there is none."""
    best = -np.inf
    for pose, corners in faces:
        z = pose[2, 3] - (pose[0, 2] * (place[0] - pose[0, 3]) + pose[1, 2] * (place[1] - pose[1, 3])) / pose[2, 2]
        u, v = pose[:3, :2].T @ (np.array([*place, z]) - pose[:3, 3])
        ahead = np.roll(corners, -1, axis=0) - corners
        inside = ahead[:, 0] * (v - corners[:, 1]) - ahead[:, 1] * (u - corners[:, 0]) >= 0
        if inside.all():
            best = max(best, z)
    return best if np.isfinite(best) else 0.0


def standing(robot, faces, x, y, yaw):
    """(4, 3) contact points of a robot at rest at a place."""
    c, s = np.cos(yaw), np.sin(yaw)
    feet = robot.stance[:, :2] @ np.array([[c, s], [-s, c]]) + [x, y]
    return np.array([[*foot, _under(faces, foot)] for foot in feet])


def _rx(a):
    c, s = np.cos(a), np.sin(a)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def _ry(a):
    c, s = np.cos(a), np.sin(a)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def _rz(a):
    c, s = np.cos(a), np.sin(a)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
