"""Dynamics and feet of the swing problem from knot to knot, and their derivatives.

With forces and joint rates constant between knots, velocity, centre of mass, angular momentum and joints follow without
error; the rotation by the angular velocity at the interval's middle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.search.swings.centroidal import Tree, cross, fill_tree, momentum_slope
from legtool_runtime.tracking.dynamics import GRAVITY, Model

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


@kernel
def skew(vector: Array, out: Array) -> None:
    """Write the matrix (3, 3) of ``vector`` × ·."""
    out[0, 0], out[1, 1], out[2, 2] = 0.0, 0.0, 0.0
    out[2, 1], out[1, 2] = vector[0], -vector[0]
    out[0, 2], out[2, 0] = vector[1], -vector[1]
    out[1, 0], out[0, 1] = vector[2], -vector[2]


@kernel
def exponential(vector: Array, out: Array) -> None:
    """Write the rotation (3, 3) by a rotation vector [rad] (Rodrigues)."""
    square = vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]
    angle = np.sqrt(square)
    if angle < 1e-6:
        a, b = 1.0 - square / 6.0, 0.5 - square / 24.0
    else:
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / square
    skew(vector, out)
    for i in range(3):
        for j in range(3):
            out[i, j] = a * out[i, j] + b * vector[i] * vector[j]
        out[i, i] += 1.0 - b * square


@kernel
def rotation_vector(first: Array, second: Array, out: Array) -> None:
    """Write the rotation vector (3,) about ``first``'s own axes that leads from it to ``second`` (3, 3), below π."""
    trace = 0.0
    out[:] = 0.0
    for i in range(3):
        for l in range(3):
            trace += first[l, i] * second[l, i]
        after, before = (i + 1) % 3, (i + 2) % 3
        for l in range(3):
            out[i] += 0.5 * (first[l, before] * second[l, after] - first[l, after] * second[l, before])
    sine = np.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    angle = np.arctan2(sine, 0.5 * (trace - 1.0))
    factor = angle / sine if sine > 1e-9 else 1.0
    for i in range(3):
        out[i] *= factor


@kernel
def turn_by(rotation: Array, vector: Array, small: Array, out: Array) -> None:
    """Write ``rotation`` turned by a rotation vector about its own axes (3, 3); ``small`` (3, 3) is scratch."""
    exponential(vector, small)
    for i in range(3):
        for j in range(3):
            out[i, j] = rotation[i, 0] * small[0, j] + rotation[i, 1] * small[1, j] + rotation[i, 2] * small[2, j]


@kernel
def momentum_after(x: Array, u: Array, contact: Array, standing: Flags, step: float, out: Array) -> None:
    """Write velocity, angular momentum by mass, and centre of mass (9,) after a step, from a state and inputs."""
    total = np.zeros(3)
    for leg in range(4):
        if standing[leg]:
            for i in range(3):
                total[i] += GRAVITY * u[3 * leg + i]
    acceleration = total.copy()
    acceleration[2] -= GRAVITY
    arm, moment = np.empty(3), np.empty(3)
    for i in range(3):
        out[i] = x[i] + step * acceleration[i]
        out[3 + i] = x[3 + i]
        out[6 + i] = x[6 + i] + step * (x[i] + 0.5 * step * acceleration[i])
    for leg in range(4):
        if not standing[leg]:
            continue
        for i in range(3):
            mean = x[6 + i] + step * (0.5 * x[i] + step * acceleration[i] / 6.0)
            arm[i] = GRAVITY * step * (contact[leg, i] - mean)
        cross(arm, u[3 * leg : 3 * leg + 3], moment)
        for i in range(3):
            out[3 + i] += moment[i]


@kernel
def spin_of(model: Model, tree: Tree, rotation: Array, momentum: Array, rates: Array, out: Array) -> None:
    """Write the base's angular velocity (3,), base axes [rad/s], for an angular momentum by mass (3,), world frame."""
    turned = np.empty(3)
    for i in range(3):
        turned[i] = 0.0
        for j in range(3):
            turned[i] += model.mass * rotation[j, i] * momentum[j]
        for j in range(12):
            turned[i] -= tree.rate[j, i] * rates[j]
    for i in range(3):
        out[i] = tree.inverse[i, 0] * turned[0] + tree.inverse[i, 1] * turned[1] + tree.inverse[i, 2] * turned[2]


@kernel
def advance(
    model: Model, x: Array, rotation: Array, u: Array, contact: Array, standing: Flags, step: float, tree: Tree,
    after: Array, turned: Array,
) -> None:  # fmt: skip
    """Write state and rotation after a step; leaves the tree at its middle."""
    momentum_after(x, u, contact, standing, step, after)
    middle, joints, spin = np.empty(3), np.empty(12), np.empty(3)
    for i in range(3):
        middle[i] = 0.5 * (x[3 + i] + after[3 + i])
        after[9 + i] = 0.0
    for j in range(12):
        joints[j] = x[12 + j] + 0.5 * step * u[12 + j]
        after[12 + j] = x[12 + j] + step * u[12 + j]
    fill_tree(model, joints, tree)
    spin_of(model, tree, rotation, middle, u[12:24], spin)
    for i in range(3):
        spin[i] *= step
    turn_by(rotation, spin, tree.scratch[0:3], turned)


@kernel
def linearise(
    model: Model, x: Array, rotation: Array, u: Array, contact: Array, standing: Flags, step: float, tree: Tree,
    slope_x: Array, slope_u: Array,
) -> None:  # fmt: skip
    """Write derivatives (24, 24) of :func:`advance` by state and inputs; entries that are always zero stay as they are.

    Rotations turn about their own axes.
    """
    after, turned = np.empty(24), np.empty((3, 3))
    advance(model, x, rotation, u, contact, standing, step, tree, after, turned)
    middle, spin, total, arm = np.empty(3), np.empty(3), np.zeros(3), np.empty(3)
    square, sixth = np.empty((3, 3)), np.empty((3, 3))
    for i in range(3):
        middle[i] = 0.5 * (x[3 + i] + after[3 + i])
    spin_of(model, tree, rotation, middle, u[12:24], spin)
    for leg in range(4):
        if standing[leg]:
            for i in range(3):
                total[i] += u[3 * leg + i]
    skew(total, square)
    for i in range(3):
        slope_x[i, i], slope_x[3 + i, 3 + i], slope_x[6 + i, 6 + i] = 1.0, 1.0, 1.0
        slope_x[6 + i, i] = step
        for j in range(3):
            slope_x[3 + i, j] = 0.5 * step * step * GRAVITY * square[i, j]
            slope_x[3 + i, 6 + j] = step * GRAVITY * square[i, j]
    for leg in range(4):
        a = 3 * leg
        if not standing[leg]:
            for i in range(24):
                for j in range(3):
                    slope_u[i, a + j] = 0.0
            continue
        for i in range(3):
            mean = x[6 + i] + step * (0.5 * x[i] + step * (GRAVITY * total[i] - (GRAVITY if i == 2 else 0.0)) / 6.0)
            arm[i] = GRAVITY * step * (contact[leg, i] - mean)
            slope_u[i, a + i] = step * GRAVITY
            slope_u[6 + i, a + i] = 0.5 * step * step * GRAVITY
        skew(arm, sixth)
        for i in range(3):
            for j in range(3):
                slope_u[3 + i, a + j] = sixth[i, j] + GRAVITY * GRAVITY * step**3 / 6.0 * square[i, j]
    for j in range(12):
        slope_x[12 + j, 12 + j] = 1.0
        slope_u[12 + j, 12 + j] = step
    _turning(model, rotation, middle, spin, u[12:24], step, tree, slope_x, slope_u)


@kernel
def _right_slope(way: Array, inverse: Array, step: float, out: Array) -> None:
    """Write dt J_r(-``way``) I⁻¹ (3, 3), J_r(φ) = 1 - (1 - cos φ)/φ² φ× + (φ - sin φ)/φ³ φ×²."""
    square = way[0] * way[0] + way[1] * way[1] + way[2] * way[2]
    if square < 1e-8:
        first, second = 0.5 - square / 24.0, (1.0 - square / 20.0) / 6.0
    else:
        angle = np.sqrt(square)
        first, second = (1.0 - np.cos(angle)) / square, (angle - np.sin(angle)) / (square * angle)
    inner, right = np.empty((3, 3)), np.empty((3, 3))
    skew(way, inner)
    for i in range(3):
        for j in range(3):
            right[i, j] = first * inner[i, j] + (1.0 if i == j else 0.0)
            for l in range(3):
                right[i, j] += second * inner[i, l] * inner[l, j]
    for i in range(3):
        for j in range(3):
            out[i, j] = step * (right[i, 0] * inverse[0, j] + right[i, 1] * inverse[1, j] + right[i, 2] * inverse[2, j])


@kernel
def _turning(
    model: Model, rotation: Array, momentum: Array, spin: Array, rates: Array, step: float, tree: Tree, slope_x: Array,
    slope_u: Array,
) -> None:  # fmt: skip
    """Write the rows of the rotation: exp(-dt ω) δθ + dt J_r(dt ω) δω."""
    by_joint, turned, way = np.empty((12, 3)), np.empty(3), np.empty(3)
    held, back, inner = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    momentum_slope(model, tree, spin, rates, by_joint)
    for i in range(3):
        way[i] = -step * spin[i]
        turned[i] = 0.0
        for j in range(3):
            turned[i] += model.mass * rotation[j, i] * momentum[j]
    exponential(way, back)
    _right_slope(way, tree.inverse, step, inner)
    skew(turned, held)
    for i in range(3):
        row = 9 + i
        for j in range(12):
            by_q = -(inner[i, 0] * by_joint[j, 0] + inner[i, 1] * by_joint[j, 1] + inner[i, 2] * by_joint[j, 2])
            by_rate = -(inner[i, 0] * tree.rate[j, 0] + inner[i, 1] * tree.rate[j, 1] + inner[i, 2] * tree.rate[j, 2])
            slope_x[row, 12 + j] = by_q
            slope_u[row, 12 + j] = by_rate + 0.5 * step * by_q
        for j in range(3):
            slope_x[row, 9 + j] = back[i, j]
            turned[j] = 0.0
            for l in range(3):
                slope_x[row, 9 + j] += inner[i, l] * held[l, j]
                turned[j] += model.mass * inner[i, l] * rotation[j, l]
        _by_momentum(turned, row, slope_x, slope_u)


@kernel
def _by_momentum(by_momentum: Array, row: int, slope_x: Array, slope_u: Array) -> None:
    """Write a row of the rotation by what changes the momentum: that of the middle counts, half of the step's change
    belongs to it."""
    for j in range(9):
        total = 0.0
        for l in range(3):
            total += 0.5 * by_momentum[l] * (slope_x[3 + l, j] + (1.0 if j == 3 + l else 0.0))
        slope_x[row, j] = total
    for j in range(12):
        total = 0.0
        for l in range(3):
            total += 0.5 * by_momentum[l] * slope_u[3 + l, j]
        slope_u[row, j] = total


@kernel
def feet_of(model: Model, x: Array, rotation: Array, tree: Tree, feet: Array) -> None:
    """Write the centres of the feet (4, 3) [m], world frame, and the tree of the state."""
    fill_tree(model, x[12:24], tree)
    for leg in range(4):
        for i in range(3):
            feet[leg, i] = x[6 + i]
            for j in range(3):
                feet[leg, i] += rotation[i, j] * (tree.anchors[leg, 3, j] - tree.com[j])


@kernel
def feet_slope(rotation: Array, tree: Tree, out: Array) -> None:
    """Write the derivatives (12, 24) of the feet by the state whose tree it is."""
    arm, column, own = np.empty(3), np.empty(3), np.empty(3)
    for leg in range(4):
        for j in range(3):
            arm[j] = tree.anchors[leg, 3, j] - tree.com[j]
        for i in range(3):
            row = 3 * leg + i
            out[row, 6 + i] = 1.0
            for j in range(3):
                after, before = (j + 1) % 3, (j + 2) % 3
                out[row, 9 + j] = rotation[i, before] * arm[after] - rotation[i, after] * arm[before]
        for j in range(12):
            for i in range(3):
                column[i] = -tree.com_rate[j, i]
            if j // 3 == leg:
                joint = j - 3 * leg
                for i in range(3):
                    own[i] = tree.anchors[leg, 3, i] - tree.anchors[leg, joint, i]
                cross(tree.axes[leg, joint], own, own)
                for i in range(3):
                    column[i] += own[i]
            for i in range(3):
                out[3 * leg + i, 12 + j] = (
                    rotation[i, 0] * column[0] + rotation[i, 1] * column[1] + rotation[i, 2] * column[2]
                )


@kernel
def places(model: Model, states: Array, rotations: Array, tree: Tree, feet: Array, base: Array) -> None:
    """Write centres of the feet (n, 4, 3) and the base's origin (n, 3) of states (n, 24) [m], world frame."""
    for k in range(states.shape[0]):
        feet_of(model, states[k], rotations[k], tree, feet[k])
        for i in range(3):
            base[k, i] = states[k, 6 + i]
            for j in range(3):
                base[k, i] -= rotations[k, i, j] * tree.com[j]
