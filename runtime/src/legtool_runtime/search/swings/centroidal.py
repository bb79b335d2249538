"""Centroidal quantities of a robot of four legs in its base's axes, and their derivatives by the joints.

The angular momentum about the centre of mass is K = I ω + Σⱼ Aⱼ q̇ⱼ, with the locked inertia I about the centre of mass
and the momentum Aⱼ of a unit rate of joint j (Orin, Goswami and Lee 2013). A joint that turns a little carries all that
hangs on it around its axis; with spatial motions s and momenta H about the base's origin the momentum changes by
s ×* Hₛ - Iₛ (s × vₚ): Hₛ and Iₛ are of the part beyond the joint, vₚ is how the part before it moves.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.tracking.dynamics import Model, leg_anchors, link_turn, turned_inertia

Array = NDArray[np.float64]


class Tree(NamedTuple):
    """A robot at one set of joint angles; base axes, about the base's origin unless said otherwise.

    ``axes``, ``anchors`` (4, 4, 3) of the joints, the last anchor is the foot's centre [m] (the last axis is unused);
    ``mass`` (4, 3), ``moment`` (4, 3, 3), ``inertia`` (4, 3, 3, 3) of all that a joint carries; ``com`` (3,) of the
    robot [m]; ``com_rate`` (12, 3) its derivative by the joints; ``locked`` (3, 3) inertia about the centre of mass;
    ``rate`` (12, 3) A; ``inverse`` (3, 3) of ``locked``; ``scratch`` (24, 3).
    """

    axes: Array
    anchors: Array
    mass: Array
    moment: Array
    inertia: Array
    com: Array
    com_rate: Array
    locked: Array
    rate: Array
    inverse: Array
    scratch: Array


def make_tree() -> Tree:
    """Room for a tree."""
    shapes = ((4, 4, 3), (4, 4, 3), (4, 3), (4, 3, 3), (4, 3, 3, 3), (3,), (12, 3), (3, 3), (12, 3), (3, 3), (24, 3))
    return Tree(*(np.zeros(shape) for shape in shapes))


@kernel
def cross(a: Array, b: Array, out: Array) -> None:
    """Write a × b (3,)."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    out[0], out[1], out[2] = x, y, z


@kernel
def _carried(mass: float, place: Array, about: Array, leg: int, link: int, tree: Tree) -> None:
    """Add a link of inertia ``about`` (3, 3) its centre at ``place`` (3,) to what its leg's joints carry."""
    square = place[0] * place[0] + place[1] * place[1] + place[2] * place[2]
    for joint in range(link + 1):
        tree.mass[leg, joint] += mass
        for i in range(3):
            tree.moment[leg, joint, i] += mass * place[i]
            for j in range(3):
                tree.inertia[leg, joint, i, j] += about[i, j] - mass * place[i] * place[j]
            tree.inertia[leg, joint, i, i] += mass * square


@kernel
def _invert(matrix: Array, out: Array) -> None:
    """Write the inverse of a symmetric positive matrix (3, 3)."""
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 1], matrix[1, 2], matrix[2, 2]
    out[0, 0], out[0, 1], out[0, 2] = d * f - e * e, c * e - b * f, b * e - c * d
    out[1, 1], out[1, 2], out[2, 2] = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * out[0, 0] + b * out[0, 1] + c * out[0, 2]
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    for i in range(3):
        for j in range(3):
            out[i, j] /= determinant


@kernel
def fill_tree(model: Model, joints: Array, tree: Tree) -> None:
    """Write a tree for joint angles (12,) [rad]."""
    turn, half, about = tree.scratch[0:3], tree.scratch[3:6], tree.scratch[6:9]
    place = tree.scratch[9]
    tree.mass[:], tree.moment[:], tree.inertia[:] = 0.0, 0.0, 0.0
    for leg in range(4):
        angles = joints[3 * leg : 3 * leg + 3]
        leg_anchors(model.hips[leg], model.chain[leg], angles, tree.axes[leg], tree.anchors[leg])
        c, s = np.cos(angles[0]), np.sin(angles[0])
        pitch = 0.0
        for link in range(3):
            if link > 0:
                pitch += angles[link]
            link_turn(c, s, pitch, turn)
            for i in range(3):
                place[i] = tree.anchors[leg, link, i]
                for j in range(3):
                    place[i] += turn[i, j] * model.link_com[leg, link, j]
            turned_inertia(model.link_inertia[leg, link], turn, half, about)
            _carried(model.link_mass[leg, link], place, about, leg, link, tree)
    _whole(model, tree)


@kernel
def _whole(model: Model, tree: Tree) -> None:
    """Write what belongs to the robot as one."""
    com, locked = tree.com, tree.locked
    trunk = model.trunk_com
    square = trunk[0] * trunk[0] + trunk[1] * trunk[1] + trunk[2] * trunk[2]
    for i in range(3):
        com[i] = model.trunk_mass * trunk[i]
        for j in range(3):
            locked[i, j] = model.trunk_inertia[i, j] - model.trunk_mass * trunk[i] * trunk[j]
        locked[i, i] += model.trunk_mass * square
        for leg in range(4):
            com[i] += tree.moment[leg, 0, i]
            for j in range(3):
                locked[i, j] += tree.inertia[leg, 0, i, j]
    for i in range(3):
        com[i] /= model.mass
    square = com[0] * com[0] + com[1] * com[1] + com[2] * com[2]
    for i in range(3):
        for j in range(3):
            locked[i, j] += model.mass * com[i] * com[j]
        locked[i, i] -= model.mass * square
    _invert(locked, tree.inverse)
    arm, other = tree.scratch[0], tree.scratch[1]
    for leg in range(4):
        for joint in range(3):
            axis, moment = tree.axes[leg, joint], tree.moment[leg, joint]
            com_rate, rate = tree.com_rate[3 * leg + joint], tree.rate[3 * leg + joint]
            for i in range(3):
                arm[i] = moment[i] - tree.mass[leg, joint] * tree.anchors[leg, joint, i]
            cross(axis, arm, com_rate)
            cross(com, com_rate, other)
            cross(axis, tree.anchors[leg, joint], arm)
            cross(moment, arm, rate)
            for i in range(3):
                rate[i] = -rate[i] - other[i]
                for j in range(3):
                    rate[i] += tree.inertia[leg, joint, i, j] * axis[j]
                com_rate[i] /= model.mass


@kernel
def _momentum(tree: Tree, leg: int, joint: int, spin: Array, velocity: Array, out: Array) -> None:
    """Write linear and angular momentum (2, 3) of what a joint carries, moving as one body with a spatial velocity."""
    mass, moment, inertia = tree.mass[leg, joint], tree.moment[leg, joint], tree.inertia[leg, joint]
    cross(spin, moment, out[0])
    cross(moment, velocity, out[1])
    for i in range(3):
        out[0, i] += mass * velocity[i]
        for j in range(3):
            out[1, i] += inertia[i, j] * spin[j]


@kernel
def momentum_slope(model: Model, tree: Tree, spin: Array, rates: Array, out: Array) -> None:
    """Write ∂K/∂q (12, 3) at constant ``spin`` (3,) of the base, base axes [rad/s], and joint ``rates`` (12,)."""
    own, beyond, part = tree.scratch[0:6].reshape(3, 2, 3), tree.scratch[6:8], tree.scratch[8:10]
    spins, velocities = tree.scratch[10:14], tree.scratch[14:18]
    axis_velocity, alpha, nu, total, temporary = (
        tree.scratch[18], tree.scratch[19], tree.scratch[20], tree.scratch[21], tree.scratch[22],
    )  # fmt: skip
    for i in range(3):
        total[i] = tree.com[i]
    cross(spin, total, total)
    for j in range(12):
        for i in range(3):
            total[i] += rates[j] * tree.com_rate[j, i]
    for leg in range(4):
        spins[0], velocities[0] = spin, 0.0
        for joint in range(3):
            axis, rate = tree.axes[leg, joint], rates[3 * leg + joint]
            cross(tree.anchors[leg, joint], axis, axis_velocity)
            for i in range(3):
                alpha[i], nu[i] = rate * axis[i], rate * axis_velocity[i]
                spins[joint + 1, i] = spins[joint, i] + alpha[i]
                velocities[joint + 1, i] = velocities[joint, i] + nu[i]
            _momentum(tree, leg, joint, alpha, nu, own[joint])
        beyond[:] = 0.0
        for joint in range(2, -1, -1):
            axis, row = tree.axes[leg, joint], out[3 * leg + joint]
            cross(tree.anchors[leg, joint], axis, axis_velocity)
            _momentum(tree, leg, joint, spins[joint + 1], velocities[joint + 1], part)
            for i in range(3):
                part[0, i] += beyond[0, i]
                part[1, i] += beyond[1, i]
                beyond[0, i] += own[joint, 0, i]
                beyond[1, i] += own[joint, 1, i]
            # s ×* H, angular and linear.
            cross(axis, part[1], row)
            cross(axis_velocity, part[0], temporary)
            for i in range(3):
                row[i] += temporary[i]
            cross(axis, part[0], temporary)
            # s × v of the part before the joint, and its momentum.
            cross(axis, spins[joint], alpha)
            cross(axis, velocities[joint], nu)
            cross(axis_velocity, spins[joint], part[0])
            for i in range(3):
                nu[i] += part[0, i]
            _momentum(tree, leg, joint, alpha, nu, part)
            for i in range(3):
                row[i] -= part[1, i]
                temporary[i] -= part[0, i]
            # Moved to the centre of mass, which moves too.
            cross(tree.com, temporary, part[0])
            cross(tree.com_rate[3 * leg + joint], total, part[1])
            for i in range(3):
                row[i] -= part[0, i] + model.mass * part[1, i]
