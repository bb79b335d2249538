"""Rigid-body dynamics of a four-legged robot: four legs of three joints each on one floating base.

Generalised velocities are ordered as in MuJoCo: linear velocity of the base, world frame (3) [m/s]; its angular
velocity, base frame (3) [rad/s]; joint velocities (12) [rad/s], legs FL, FR, RL, RR × hip, thigh, knee. The equation
of motion is M q̈ + h = S'τ + Σ J'f with the forces f that the ground exerts on the feet. The mass matrix comes from
the composite rigid-body algorithm, the bias from recursive Newton-Euler (Featherstone, Rigid Body Dynamics Algorithms,
chapters 5 and 6), written out in base axes for this one tree.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel

Array = NDArray[np.float64]

#: Acceleration of gravity, and the number of generalised velocities.
GRAVITY = 9.81
DOF = 18


class Model(NamedTuple):
    """What the kernels know of a robot, as in :class:`~legtool_runtime.tracking.model.TrackedRobot`.

    ``hips`` (4, 3) [m]; ``chain`` (4, 3) abduction offset, thigh and shank length [m]; ``foot_radius`` [m]; ``mass`` of
    the whole robot [kg]; trunk: mass [kg], centre (3,) [m], inertia (3, 3) [kg m²]; links: (4, 3), (4, 3, 3),
    (4, 3, 3, 3); ``armature`` (4, 3) [kg m²].
    """

    hips: Array
    chain: Array
    foot_radius: float
    mass: float
    trunk_mass: float
    trunk_com: Array
    trunk_inertia: Array
    link_mass: Array
    link_com: Array
    link_inertia: Array
    armature: Array


class FullState(NamedTuple):
    """Where a robot is and how it moves.

    ``position`` (3,) of the base, world [m]; ``orientation`` (4,) base to world, unit quaternion w, x, y, z;
    ``joints`` (4, 3) [rad]; ``velocity`` (18,) in the order above.
    """

    position: Array
    orientation: Array
    joints: Array
    velocity: Array


class Terms(NamedTuple):
    """The terms of the equation of motion at one state; positions, velocities and forces in world axes.

    ``rotation`` (3, 3) base to world; ``mass`` (18, 18) [kg, kg m, kg m²] with rotors; ``bias`` (18,) Coriolis,
    centrifugal and gravity forces [N, Nm]; ``feet``, ``feet_velocity`` (4, 3) centres of the foot spheres [m, m/s];
    ``jacobian`` (4, 3, 18) of the centres; ``drift`` (4, 3) their acceleration for q̈ = 0, J̇ q̇ [m/s²];
    ``contact_velocity``, ``contact_jacobian``, ``contact_drift`` the same of the shank's point that touches the ground,
    one radius below the centre along the contact normal. The normal stays where it is while the shank turns, as under a
    ball that rolls, so that a rolling foot has neither contact velocity nor contact acceleration.
    ``com``, ``com_velocity`` (3,) [m, m/s]; ``momentum`` (3,) angular, about the centre of mass [kg m²/s].
    """

    rotation: Array
    mass: Array
    bias: Array
    feet: Array
    feet_velocity: Array
    jacobian: Array
    drift: Array
    contact_velocity: Array
    contact_jacobian: Array
    contact_drift: Array
    com: Array
    com_velocity: Array
    momentum: Array


def make_terms() -> Terms:
    """Room for the terms; every entry that :func:`dynamics_terms` leaves alone is zero."""
    feet = (4, 3)
    jacobian = (4, 3, DOF)
    shapes = ((3, 3), (DOF, DOF), (DOF,), feet, feet, jacobian, feet, feet, jacobian, feet, (3,), (3,), (3,))
    return Terms(*(np.zeros(shape) for shape in shapes))


@kernel
def rotation_matrix(quaternion: Array, out: Array) -> None:
    """Write the rotation matrix (3, 3) of a quaternion w, x, y, z, of any length but 0."""
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    s = 2.0 / (w * w + x * x + y * y + z * z)
    out[0, 0], out[0, 1], out[0, 2] = 1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)
    out[1, 0], out[1, 1], out[1, 2] = s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)
    out[2, 0], out[2, 1], out[2, 2] = s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)


@kernel
def rotate(matrix: Array, vector: Array, out: Array) -> None:
    """Write ``matrix @ vector`` (3,)."""
    for i in range(3):
        out[i] = matrix[i, 0] * vector[0] + matrix[i, 1] * vector[1] + matrix[i, 2] * vector[2]


@kernel
def rotate_back(matrix: Array, vector: Array, out: Array) -> None:
    """Write ``matrix.T @ vector`` (3,)."""
    for i in range(3):
        out[i] = matrix[0, i] * vector[0] + matrix[1, i] * vector[1] + matrix[2, i] * vector[2]


@kernel
def add_cross(a: Array, b: Array, out: Array) -> None:
    """Add a × b to ``out`` (3,)."""
    out[0] += a[1] * b[2] - a[2] * b[1]
    out[1] += a[2] * b[0] - a[0] * b[2]
    out[2] += a[0] * b[1] - a[1] * b[0]


@kernel
def _add_turning(spin: Array, turning: Array, arm: Array, out: Array) -> None:
    """Add to ``out`` the acceleration across ``arm`` of a body that spins and turns faster: α × r + ω × (ω × r)."""
    add_cross(turning, arm, out)
    along = spin[0] * arm[0] + spin[1] * arm[1] + spin[2] * arm[2]
    square = spin[0] * spin[0] + spin[1] * spin[1] + spin[2] * spin[2]
    for i in range(3):
        out[i] += spin[i] * along - arm[i] * square


@kernel
def _body(
    mass: float, place: Array, inertia: Array, spin: Array, turning: Array, acceleration: Array,
    composite: Array, force: Array,
) -> None:  # fmt: skip
    """Add a body's mass, first moment and inertia about the base's origin, and the force and moment that move it.

    All in base axes. ``place`` (3,) its centre; ``inertia`` (3, 3) about the centre; ``composite`` (5, 3): mass in
    [0, 0], first moment in [1], inertia in [2:]; ``force`` (2, 3): force, moment about the base's origin.
    """
    composite[0, 0] += mass
    square = place[0] * place[0] + place[1] * place[1] + place[2] * place[2]
    for i in range(3):
        composite[1, i] += mass * place[i]
        for j in range(3):
            composite[2 + i, j] += inertia[i, j] - mass * place[i] * place[j]
        composite[2 + i, i] += mass * square
    fx, fy, fz = mass * acceleration[0], mass * acceleration[1], mass * acceleration[2]
    force[0, 0] += fx
    force[0, 1] += fy
    force[0, 2] += fz
    lx = inertia[0, 0] * spin[0] + inertia[0, 1] * spin[1] + inertia[0, 2] * spin[2]
    ly = inertia[1, 0] * spin[0] + inertia[1, 1] * spin[1] + inertia[1, 2] * spin[2]
    lz = inertia[2, 0] * spin[0] + inertia[2, 1] * spin[1] + inertia[2, 2] * spin[2]
    force[1, 0] += place[1] * fz - place[2] * fy + spin[1] * lz - spin[2] * ly
    force[1, 1] += place[2] * fx - place[0] * fz + spin[2] * lx - spin[0] * lz
    force[1, 2] += place[0] * fy - place[1] * fx + spin[0] * ly - spin[1] * lx
    for i in range(3):
        for j in range(3):
            force[1, i] += inertia[i, j] * turning[j]


@kernel
def turned_inertia(inertia: Array, turn: Array, half: Array, out: Array) -> None:
    """Write ``turn @ inertia @ turn.T``, all (3, 3)."""
    for i in range(3):
        for j in range(3):
            half[i, j] = turn[i, 0] * inertia[0, j] + turn[i, 1] * inertia[1, j] + turn[i, 2] * inertia[2, j]
    for i in range(3):
        for j in range(3):
            out[i, j] = half[i, 0] * turn[j, 0] + half[i, 1] * turn[j, 1] + half[i, 2] * turn[j, 2]


@kernel
def link_turn(c: float, s: float, pitch: float, out: Array) -> None:
    """Write a link's rotation (3, 3) to the base: by the hip, whose cosine and sine are given, then by ``pitch``."""
    sp, cp = np.sin(pitch), np.cos(pitch)
    out[0, 0], out[0, 1], out[0, 2] = cp, 0.0, sp
    out[1, 0], out[1, 1], out[1, 2] = s * sp, c, -s * cp
    out[2, 0], out[2, 1], out[2, 2] = -c * sp, s, c * cp


@kernel
def leg_anchors(hip: Array, chain: Array, angles: Array, axes: Array, anchors: Array) -> None:
    """Write a leg's joint axes (3, 3), and origins and foot centre (4, 3) [m], base frame."""
    c, s = np.cos(angles[0]), np.sin(angles[0])
    axes[0, 0], axes[0, 1], axes[0, 2] = 1.0, 0.0, 0.0
    axes[1, 0], axes[1, 1], axes[1, 2] = 0.0, c, s
    axes[2, 0], axes[2, 1], axes[2, 2] = 0.0, c, s
    anchors[0, 0], anchors[0, 1], anchors[0, 2] = hip[0], hip[1], hip[2]
    anchors[1, 0], anchors[1, 1], anchors[1, 2] = hip[0], hip[1] + c * chain[0], hip[2] + s * chain[0]
    pitch = 0.0
    for joint in range(1, 3):
        pitch += angles[joint]
        down = chain[joint] * np.cos(pitch)
        anchors[joint + 1, 0] = anchors[joint, 0] - chain[joint] * np.sin(pitch)
        anchors[joint + 1, 1] = anchors[joint, 1] + s * down
        anchors[joint + 1, 2] = anchors[joint, 2] - c * down


@kernel
def _leg(
    model: Model, state: FullState, leg: int, normal: Array, rest: Array, terms: Terms, composite: Array, force: Array,
    scratch: Array,
) -> None:  # fmt: skip
    """Write the rows and columns of one leg, and add its bodies to the base's ``composite`` and ``force``.

    ``rest`` (3,) is the acceleration of the base's origin that stands for gravity, base axes [m/s²].
    """
    rotation = terms.rotation
    axes, anchors, speeds, links = scratch[0:3], scratch[3:7], scratch[7:10], scratch[10:25].reshape(3, 5, 3)
    forces = scratch[25:31].reshape(3, 2, 3)
    spin, turning, acceleration, arm, place, moving = (
        scratch[31], scratch[32], scratch[33], scratch[34], scratch[35], scratch[36],
    )  # fmt: skip
    turn, half, inertia, velocity, column = scratch[37:40], scratch[40:43], scratch[43:46], scratch[46], scratch[47]
    angles = state.joints[leg]
    scratch[10:31] = 0.0
    leg_anchors(model.hips[leg], model.chain[leg], angles, axes, anchors)
    c, s = np.cos(angles[0]), np.sin(angles[0])
    rotate_back(rotation, state.velocity[0:3], velocity)
    for i in range(3):
        spin[i] = state.velocity[3 + i]
        turning[i] = 0.0
        acceleration[i] = rest[i]
        arm[i] = anchors[0, i]
    pitch = 0.0
    for link in range(3):
        add_cross(spin, arm, velocity)
        _add_turning(spin, turning, arm, acceleration)
        rate = state.velocity[6 + 3 * leg + link]
        for i in range(3):
            speeds[link, i] = axes[link, i] * rate
        add_cross(spin, speeds[link], turning)
        for i in range(3):
            spin[i] += speeds[link, i]
        if link > 0:
            pitch += angles[link]
        link_turn(c, s, pitch, turn)
        rotate(turn, model.link_com[leg, link], arm)
        for i in range(3):
            place[i] = anchors[link, i] + arm[i]
            moving[i] = acceleration[i]
        _add_turning(spin, turning, arm, moving)
        turned_inertia(model.link_inertia[leg, link], turn, half, inertia)
        _body(model.link_mass[leg, link], place, inertia, spin, turning, moving, links[link], forces[link])
        for i in range(3):
            arm[i] = anchors[link + 1, i] - anchors[link, i]
    add_cross(spin, arm, velocity)
    _add_turning(spin, turning, arm, acceleration)
    for i in range(3):
        acceleration[i] -= rest[i]
    _foot(model.foot_radius, state.position, leg, normal, scratch, terms)
    _gather(links, composite)
    _gather(forces, force)
    _leg_mass(leg, axes, anchors, links, forces, model.armature[leg], speeds, half, column, terms)


@kernel
def _gather(links: Array, base: Array) -> None:
    """Add to each link (3, k, 3) what it carries, and the whole leg to the base (k, 3)."""
    for i in range(base.shape[0]):
        for k in range(3):
            links[1, i, k] += links[2, i, k]
            links[0, i, k] += links[1, i, k]
            base[i, k] += links[0, i, k]


@kernel
def _leg_mass(
    leg: int, axes: Array, anchors: Array, links: Array, forces: Array, armature: Array, origins: Array, half: Array,
    column: Array, terms: Terms,
) -> None:  # fmt: skip
    """Write the leg's part of mass matrix and bias from its composite bodies and the forces that move them."""
    first = 6 + 3 * leg
    mass, bias = terms.mass, terms.bias
    for joint in range(3):
        # The velocity that a unit rate gives to the point of the leg at the base's origin.
        for i in range(3):
            origins[joint, i] = 0.0
        add_cross(anchors[joint], axes[joint], origins[joint])
    momentum, moment = half[0], half[1]
    for joint in range(3):
        axis, origin, body = axes[joint], origins[joint], links[joint]
        for i in range(3):
            momentum[i] = body[0, 0] * origin[i]
        add_cross(axis, body[1], momentum)
        rotate(body[2:5], axis, moment)
        add_cross(body[1], origin, moment)
        rotate(terms.rotation, momentum, column)
        row = first + joint
        for i in range(3):
            mass[i, row] = mass[row, i] = column[i]
            mass[3 + i, row] = mass[row, 3 + i] = moment[i]
        for other in range(joint + 1):
            value = 0.0
            for i in range(3):
                value += origins[other, i] * momentum[i] + axes[other, i] * moment[i]
            mass[first + other, row] = mass[row, first + other] = value
        mass[row, row] += armature[joint]
        bias[row] = 0.0
        for i in range(3):
            bias[row] += origin[i] * forces[joint, 0, i] + axis[i] * forces[joint, 1, i]


@kernel
def _foot(radius: float, position: Array, leg: int, normal: Array, scratch: Array, terms: Terms) -> None:
    """Write position, velocity, Jacobian and drift of a leg's foot centre and contact point."""
    rotation, axes, anchors = terms.rotation, scratch[0:3], scratch[3:7]
    spin, turning, acceleration, velocity = scratch[31], scratch[32], scratch[33], scratch[46]
    arm, below, column, turned = scratch[34], scratch[35], scratch[36], scratch[47]
    rotate(rotation, anchors[3], terms.feet[leg])
    rotate(rotation, velocity, terms.feet_velocity[leg])
    rotate(rotation, acceleration, terms.drift[leg])
    for i in range(3):
        terms.feet[leg, i] += position[i]
    rotate_back(rotation, normal, below)
    for point in range(2):
        jacobian = terms.jacobian[leg] if point == 0 else terms.contact_jacobian[leg]
        for i in range(3):
            jacobian[i, i] = 1.0
            arm[i] = anchors[3, i] - point * radius * below[i]
        # Columns of -R [p]×: R (e × p).
        for k in range(3):
            after, before = (k + 1) % 3, (k + 2) % 3
            for i in range(3):
                jacobian[i, 3 + k] = rotation[i, before] * arm[after] - rotation[i, after] * arm[before]
        for joint in range(3):
            for i in range(3):
                column[i] = 0.0
                turned[i] = arm[i] - anchors[joint, i]
            add_cross(axes[joint], turned, column)
            rotate(rotation, column, turned)
            for i in range(3):
                jacobian[i, 6 + 3 * leg + joint] = turned[i]
    for i in range(3):
        arm[i] = -radius * below[i]
        column[i] = 0.0
    add_cross(spin, arm, column)
    rotate(rotation, column, terms.contact_velocity[leg])
    for i in range(3):
        column[i] = 0.0
    add_cross(turning, arm, column)
    rotate(rotation, column, terms.contact_drift[leg])
    for i in range(3):
        terms.contact_velocity[leg, i] += terms.feet_velocity[leg, i]
        terms.contact_drift[leg, i] += terms.drift[leg, i]


@kernel
def dynamics_terms(model: Model, state: FullState, normals: Array, terms: Terms) -> None:
    """Write all terms of the equation of motion.

    Args:
        model: the robot.
        state: with a unit quaternion and finite values; nothing is checked here.
        normals: (4, 3) unit normal of the ground under each foot, world frame.
        terms: made by :func:`make_terms`.
    """
    rotation, mass, bias = terms.rotation, terms.mass, terms.bias
    scratch = np.empty((60, 3))
    composite, force = scratch[48:53], scratch[53:55]
    rest, spin, still, acceleration, linear = scratch[55], scratch[56], scratch[57], scratch[58], scratch[59]
    scratch[48:60] = 0.0
    rotation_matrix(state.orientation, rotation)
    for i in range(3):
        rest[i] = GRAVITY * rotation[2, i]
        spin[i] = state.velocity[3 + i]
        acceleration[i] = rest[i]
    _add_turning(spin, still, model.trunk_com, acceleration)
    _body(model.trunk_mass, model.trunk_com, model.trunk_inertia, spin, still, acceleration, composite, force)
    for leg in range(4):
        _leg(model, state, leg, normals[leg], rest, terms, composite, force, scratch)
    rotate(rotation, force[0], linear)
    for i in range(3):
        bias[i] = linear[i]
        bias[3 + i] = force[1, i]
        mass[i, i] = composite[0, 0]
        after, before = (i + 1) % 3, (i + 2) % 3
        for k in range(3):
            # Column i of -m R [c]×: R (e × m c).
            value = rotation[k, before] * composite[1, after] - rotation[k, after] * composite[1, before]
            mass[k, 3 + i] = mass[3 + i, k] = value
            mass[3 + i, 3 + k] = composite[2 + i, k]
    rotate(rotation, composite[1], terms.com)
    for i in range(3):
        terms.com[i] /= composite[0, 0]
        linear[i] = 0.0
        still[i] = 0.0
        for k in range(DOF):
            linear[i] += mass[i, k] * state.velocity[k]
            still[i] += mass[3 + i, k] * state.velocity[k]
        terms.com_velocity[i] = linear[i] / composite[0, 0]
    # Momentum about the base's origin, moved to the centre of mass.
    rotate(rotation, still, terms.momentum)
    add_cross(linear, terms.com, terms.momentum)
    for i in range(3):
        terms.com[i] += state.position[i]
