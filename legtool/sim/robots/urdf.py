"""A robot from a URDF file, as a MuJoCo specification: links that are fixed to each other become one body.

MuJoCo refuses many public URDF files as they stand: links without mass, inertias of thin parts that break the triangle
inequality, meshes that are not there. Lumped, what moves as one has a mass and an inertia of its own. Shapes other than
boxes, cylinders and spheres are left out, but a link named foot or toe that has no sphere touches with one of 2 cm.
"""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import mujoco
import numpy as np
from numpy.typing import NDArray

from legtool.errors import RobotError
from legtool_runtime.rotations import from_angles, quaternion_of

Array = NDArray[np.float64]

#: Names of feet; one whose shape is no sphere is taken for one of this radius [m].
FOOT, FOOT_RADIUS_M = re.compile(r"foot|feet|toe", re.IGNORECASE), 0.02
#: What moves, by its name in URDF; a slide is no leg's, and is held where it is.
_MOVING = {
    "revolute": mujoco.mjtJoint.mjJNT_HINGE,
    "continuous": mujoco.mjtJoint.mjJNT_HINGE,
    "prismatic": mujoco.mjtJoint.mjJNT_SLIDE,
}


class _Joint(NamedTuple):
    """A joint: its element, type, links, and the child's frame in the parent's (4, 4)."""

    element: ElementTree.Element
    kind: str
    parent: str
    child: str
    frame: Array


class _Mass(NamedTuple):
    """A mass [kg], its centre (3,) [m] and its inertia (3, 3) about that centre [kg m²], in the body's axes."""

    mass: float
    centre: Array
    inertia: Array


def read_urdf(path: Path) -> mujoco.MjSpec:
    """The robot of a URDF file without a world around it: its root hangs in the world, without a joint.

    Raises:
        RobotError: it is no URDF file, or a joint is neither fixed nor a hinge or slide.
    """
    try:
        root = ElementTree.fromstring(path.read_bytes())
        links = {link.attrib["name"]: link for link in root.findall("link")}
        joints = [_joint(element) for element in root.findall("joint")]
    except (ElementTree.ParseError, OSError, KeyError, AttributeError, ValueError) as error:
        raise RobotError(f"{path}: not a URDF file that can be read ({error})") from error
    free = [joint for joint in joints if joint.kind == "floating" and links[joint.parent].find("inertial") is None]
    for joint in free:  # a robot in a world without mass: its trunk is free anyway
        joints.remove(joint)
        links.pop(joint.parent)
    children = {joint.child for joint in joints}
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        raise RobotError(f"{path}: expected one root link, found {', '.join(roots) or 'none'}")
    for joint in joints:
        if joint.kind not in ("fixed", *_MOVING):
            expected = ", ".join(("fixed", *_MOVING))
            raise RobotError(f"{path}: joint {joint.element.get('name')} is {joint.kind}; expected one of: {expected}")
    below: dict[str, list[_Joint]] = defaultdict(list)
    for joint in joints:
        below[joint.parent].append(joint)
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    _add(spec.worldbody, roots[0], np.eye(4), None, links, below)
    return spec


def _add(
    parent: mujoco.MjsBody, link: str, frame: Array, moving: _Joint | None,
    links: dict[str, ElementTree.Element], below: dict[str, list[_Joint]],
) -> None:  # fmt: skip
    """Add what moves with a link to its parent body, and all that hangs on it."""
    body = parent.add_body(name=link, pos=frame[:3, 3], quat=quaternion_of(frame[:3, :3]))
    if moving is not None:
        _add_joint(body, moving)
    parts: list[_Mass] = []
    left = [(link, np.eye(4))]
    while left:
        name, place = left.pop(0)
        if (part := _mass(links[name], place)) is not None:
            parts.append(part)
        _add_shapes(body, links[name], place)
        for joint in below[name]:
            if joint.kind == "fixed":
                left.append((joint.child, place @ joint.frame))
            else:
                _add(body, joint.child, place @ joint.frame, joint, links, below)
    if parts:
        whole = _lumped(parts)
        body.mass, body.ipos, body.explicitinertial = whole.mass, whole.centre, True
        i = _balanced(whole.inertia)
        body.fullinertia = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]


def _add_joint(body: mujoco.MjsBody, joint: _Joint) -> None:
    axis, limit, dynamics = (joint.element.find(key) for key in ("axis", "limit", "dynamics"))
    damping, friction = (0.0 if dynamics is None else float(dynamics.get(key, 0.0)) for key in ("damping", "friction"))
    made = body.add_joint(
        name=joint.element.attrib["name"],
        type=_MOVING[joint.kind],
        axis=[1.0, 0.0, 0.0] if axis is None else _numbers(axis, "xyz"),
        damping=damping,
        frictionloss=friction,
    )
    if limit is not None:
        if joint.kind != "continuous":
            made.range = [float(limit.get("lower", 0.0)), float(limit.get("upper", 0.0))]
            made.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        effort = float(limit.get("effort", 0.0))
        if effort > 0.0:
            made.actfrcrange, made.actfrclimited = [-effort, effort], mujoco.mjtLimited.mjLIMITED_TRUE


def _add_shapes(body: mujoco.MjsBody, link: ElementTree.Element, place: Array) -> None:
    """The boxes, cylinders and spheres that a link touches with; a link's first sphere has the link's name."""
    named = False
    for collision in link.findall("collision"):
        shape = next(iter(collision.find("geometry") or ()), None)
        if shape is None:
            continue
        frame = place @ _frame(collision.find("origin"))
        if shape.tag == "sphere":
            kind, size = mujoco.mjtGeom.mjGEOM_SPHERE, [float(shape.attrib["radius"]), 0.0, 0.0]
        elif shape.tag == "cylinder":
            kind = mujoco.mjtGeom.mjGEOM_CYLINDER
            size = [float(shape.attrib["radius"]), 0.5 * float(shape.attrib["length"]), 0.0]
        elif shape.tag == "box":
            kind, size = mujoco.mjtGeom.mjGEOM_BOX, [0.5 * side for side in _numbers(shape, "size")]
        else:
            continue
        geom = body.add_geom(type=kind, size=size, pos=frame[:3, 3], quat=quaternion_of(frame[:3, :3]))
        if shape.tag == "sphere" and not named:
            geom.name, named = link.attrib["name"], True
    touches = link.find("collision") is not None
    if touches and not named and FOOT.search(link.attrib["name"]):  # a foot drawn as a mesh
        body.add_geom(
            name=link.attrib["name"], type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[FOOT_RADIUS_M, 0, 0], pos=place[:3, 3]
        )


def _joint(element: ElementTree.Element) -> _Joint:
    parent, child = element.find("parent"), element.find("child")
    if parent is None or child is None:
        raise ValueError(f"joint {element.get('name')} has no parent or no child")
    frame = _frame(element.find("origin"))
    return _Joint(element, element.attrib["type"], parent.attrib["link"], child.attrib["link"], frame)


def _mass(link: ElementTree.Element, place: Array) -> _Mass | None:
    """A link's mass in its body's axes; None for a link without."""
    inertial = link.find("inertial")
    if inertial is None:
        return None
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None or inertia is None:
        return None
    frame = place @ _frame(inertial.find("origin"))
    xx, xy, xz, yy, yz, zz = (float(inertia.get(key, 0.0)) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    own = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    rotation = frame[:3, :3]
    return _Mass(float(mass.attrib["value"]), frame[:3, 3], rotation @ own @ rotation.T)


def _balanced(inertia: Array) -> Array:
    """An inertia (3, 3) whose smaller moments are raised by as much as they break the triangle inequality."""
    moments, axes = np.linalg.eigh(inertia)
    short = moments[2] - moments[0] - moments[1]
    if short <= 0.0:
        return inertia
    moments[:2] += 0.5 * short + 1e-6 * moments[2]
    return (axes * moments) @ axes.T


def _lumped(parts: list[_Mass]) -> _Mass:
    """Several masses as one."""
    mass = sum(part.mass for part in parts)
    centre = np.sum([part.mass * part.centre for part in parts], axis=0) / max(mass, 1e-12)
    inertia = np.zeros((3, 3))
    for part in parts:
        arm = part.centre - centre
        inertia += part.inertia + part.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return _Mass(mass, centre, inertia)


def _frame(origin: ElementTree.Element | None) -> Array:
    """(4, 4) of an origin: xyz, and rpy about fixed axes."""
    frame = np.eye(4)
    if origin is None:
        return frame
    frame[:3, :3] = from_angles(*_numbers(origin, "rpy"))
    frame[:3, 3] = _numbers(origin, "xyz")
    return frame


def _numbers(element: ElementTree.Element, key: str) -> list[float]:
    """Three numbers of an attribute; zeros where it is not there."""
    numbers = [float(part) for part in element.get(key, "0 0 0").split()]
    if len(numbers) != 3:
        raise ValueError(f"{key} has {len(numbers)} numbers, expected 3")
    return numbers
