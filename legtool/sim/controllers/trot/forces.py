"""Stance forces: the contact forces whose sum best gives the wanted force and moment on the trunk.

Minimise ‖W(Af − b)‖² + α‖f‖² over forces inside their friction cones, by ADMM: a fixed linear solve, then a projection
onto each cone. Forces are in units of the robot's weight, moments in weight × ``length``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel

Array = NDArray[np.float64]

#: Regularisation, and ADMM's step.
ALPHA = 1e-3
RHO = 0.05
ITERATIONS = 40
#: A stance foot pushes with at least this share of its limit, so that it stays on the ground.
LEAST = 0.05


@kernel
def stance_forces(
    arms: Array,
    wrench: Array,
    weights: Array,
    length: float,
    friction: float,
    limit: Array,
    forces: Array,
    dual: Array,
) -> None:
    """Find the contact forces.

    Args:
        arms: (4, 3) contact points from the centre of mass [m].
        wrench: (6,) wanted force [weights] and moment [weight × length].
        weights: (6,) of the errors in each.
        length: unit of moment arms [m].
        friction: coefficient of the friction cones about z.
        limit: (4,) largest normal force of each foot [weights]; 0 for a foot that does not push.
        forces: (4, 3) warm start, overwritten with the answer [weights].
        dual: (4, 3) warm start of the scaled multipliers, overwritten.
    """
    legs = _pushing(limit, forces, dual)
    if legs.size == 0:
        return
    inverse, linear = _normal_equations(_effect(arms, legs, length), weights, wrench)
    _iterate(inverse, linear, legs, friction, limit, forces, dual)


@kernel
def _pushing(limit: Array, forces: Array, dual: Array) -> NDArray[np.int64]:
    """(k,) the feet that push; the forces and multipliers of the others are set to 0."""
    legs = np.empty(4, np.int64)
    count = 0
    for leg in range(4):
        if limit[leg] > 0.0:
            legs[count] = leg
            count += 1
        else:
            for axis in range(3):
                forces[leg, axis] = 0.0
                dual[leg, axis] = 0.0
    return legs[:count]


@kernel
def _effect(arms: Array, legs: NDArray[np.int64], length: float) -> Array:
    """(6, 3k) A: the force and moment on the trunk of each component of the forces of ``legs`` (k,)."""
    matrix = np.zeros((6, 3 * legs.size))
    for k in range(legs.size):
        x, y, z = arms[legs[k], 0] / length, arms[legs[k], 1] / length, arms[legs[k], 2] / length
        for axis in range(3):
            matrix[axis, 3 * k + axis] = 1.0
        matrix[3, 3 * k + 1], matrix[3, 3 * k + 2] = -z, y
        matrix[4, 3 * k], matrix[4, 3 * k + 2] = z, -x
        matrix[5, 3 * k], matrix[5, 3 * k + 1] = -y, x
    return matrix


@kernel
def _normal_equations(matrix: Array, weights: Array, wrench: Array) -> tuple[Array, Array]:
    """(3k, 3k) inverse of A'WA + (α + ρ)I and (3k,) A'Wb, with the weights W (6,) of the squared errors and b (6,)."""
    n = matrix.shape[1]
    hessian = np.zeros((n, n))
    linear = np.zeros(n)
    for i in range(n):
        for row in range(6):
            scaled = weights[row] * matrix[row, i]
            if scaled != 0.0:
                linear[i] += scaled * wrench[row]
                for j in range(i + 1):
                    hessian[i, j] += scaled * matrix[row, j]
        hessian[i, i] += ALPHA + RHO
    return _inverse(hessian), linear


@kernel
def _iterate(
    inverse: Array,
    linear: Array,
    legs: NDArray[np.int64],
    friction: float,
    limit: Array,
    forces: Array,
    dual: Array,
) -> None:
    """ADMM from ``forces`` and ``dual`` (4, 3), which are overwritten, on the feet ``legs`` (k,)."""
    n = linear.size
    z = np.empty(n)
    u = np.empty(n)
    right = np.empty(n)
    for k in range(legs.size):
        for axis in range(3):
            z[3 * k + axis] = forces[legs[k], axis]
            u[3 * k + axis] = dual[legs[k], axis]
    for _ in range(ITERATIONS):
        for i in range(n):
            right[i] = linear[i] + RHO * (z[i] - u[i])
        for i in range(n):
            value = 0.0
            for j in range(n):
                value += inverse[i, j] * right[j]
            z[i] = value + u[i]  # the next point to project
        for k in range(legs.size):
            a, b, c = z[3 * k], z[3 * k + 1], z[3 * k + 2]
            x, y, v = _project(a, b, c, friction, limit[legs[k]])
            u[3 * k], u[3 * k + 1], u[3 * k + 2] = a - x, b - y, c - v
            z[3 * k], z[3 * k + 1], z[3 * k + 2] = x, y, v
    for k in range(legs.size):
        for axis in range(3):
            forces[legs[k], axis] = z[3 * k + axis]
            dual[legs[k], axis] = u[3 * k + axis]


@kernel
def _inverse(lower: Array) -> Array:
    """Inverse of a symmetric positive definite matrix whose lower triangle is given; Cholesky in place."""
    n = lower.shape[0]
    for j in range(n):
        for k in range(j):
            lower[j, j] -= lower[j, k] * lower[j, k]
        lower[j, j] = np.sqrt(lower[j, j])
        for i in range(j + 1, n):
            for k in range(j):
                lower[i, j] -= lower[i, k] * lower[j, k]
            lower[i, j] /= lower[j, j]
    inverse = np.zeros((n, n))
    for column in range(n):
        for i in range(column, n):
            value = 1.0 if i == column else 0.0
            for k in range(column, i):
                value -= lower[i, k] * inverse[k, column]
            inverse[i, column] = value / lower[i, i]
        for i in range(n - 1, -1, -1):
            value = inverse[i, column]
            for k in range(i + 1, n):
                value -= lower[k, i] * inverse[k, column]
            inverse[i, column] = value / lower[i, i]
    return inverse


@kernel
def _project(x: float, y: float, z: float, friction: float, limit: float) -> tuple[float, float, float]:
    """Nearest force in the cone ‖(x, y)‖ ≤ μz, cut at LEAST · limit ≤ z ≤ limit."""
    radial = np.sqrt(x * x + y * y)
    if radial > friction * z:
        if friction * radial <= -z:
            return 0.0, 0.0, LEAST * limit
        height = (z + friction * radial) / (1.0 + friction * friction)
        scale = friction * height / radial
        x, y, z = x * scale, y * scale, height
    bounded = min(limit, max(LEAST * limit, z))
    if bounded != z:
        z = bounded
        radial = np.sqrt(x * x + y * y)
        if radial > friction * z:
            x, y = x * friction * z / radial, y * friction * z / radial
    return x, y, z
