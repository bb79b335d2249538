"""The quadratic program of whole-body control: its unknowns, its tasks as weighted squares, and its bounds.

The unknowns are the joint accelerations (12) [rad/s²] and, for each standing foot, its force along two tangents and the
normal of its contact, divided by the robot's mass [m/s²], so that one set of weights does for robots of every mass.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.tracking.dynamics import GRAVITY, FullState, Model, Terms, add_cross, rotate_back
from legtool_runtime.tracking.qp import Program

Array = NDArray[np.float64]

#: Most unknowns; and rows: 4 sides of each foot's friction pyramid, and the torques.
UNKNOWNS = 12 + 4 * 3
ROWS = 4 * 4 + 12
#: Speed at which dry friction is taken to act in full [rad/s]: below it changes sign without a jump.
_SLIPPING = 0.1


class Gains(NamedTuple):
    """Weights and gains; the defaults are for ANYmal C and are scaled to a robot by :func:`scaled`.

    Weights are per square of an acceleration; rates in 1/s, stiffnesses in 1/s². ``acceleration_limit`` bounds what is
    asked of the centre of mass [m/s²]; ``least_force`` is the least normal force as a share of the weight;
    ``joint_limit_rate`` is that of the exponential at which a joint may close in on its limit,
    ``joint_limit_weight`` that of what it falls short of this, and ``letting_go`` the acceleration away from a limit
    [rad/s²] at which a standing foot counts half.
    """

    stance_weight: float = 1000.0
    stance_damping: float = 30.0
    swing_weight: float = 1.0
    swing_stiffness: float = 600.0
    swing_damping: float = 50.0
    orientation_weight: float = 10.0
    orientation_stiffness: float = 150.0
    orientation_damping: float = 25.0
    com_weight: float = 10.0
    com_stiffness: float = 40.0
    com_damping: float = 12.0
    height_stiffness: float = 100.0
    height_damping: float = 20.0
    acceleration_limit: float = 6.0
    force_weight: float = 0.03
    joint_weight: float = 1e-4
    least_force: float = 0.016
    joint_limit_rate: float = 30.0
    joint_limit_weight: float = 1e3
    letting_go: float = 20.0


class Limits(NamedTuple):
    """What the joints can do, (4, 3) each: range [rad], torque [Nm], dry friction [Nm] and damping [Nm s/rad]."""

    low: Array
    high: Array
    torque: Array
    friction: Array
    damping: Array


class References(NamedTuple):
    """What the robot is wanted to do at this tick, in world axes.

    ``com`` (3, 3) position, velocity and acceleration of the centre of mass [m, m/s, m/s²]; ``orientation`` (4,) base
    to world, w, x, y, z; ``turning`` (2, 3) angular velocity and acceleration [rad/s, rad/s²]; ``stance`` (4,) bool:
    stands, else swings; ``swing`` (4, 3, 3) position, velocity and acceleration of each foot's centre, of swinging
    feet read only; ``forces`` (4, 3) on standing feet by the preview [N]; ``normals`` (4, 3) unit, of the ground under
    each foot; ``friction`` (4,) coefficient to be counted on: a tangent force is at most this share of the normal one
    along each of two tangents, so that along the diagonal it may be √2 times as large.
    """

    com: Array
    orientation: Array
    turning: Array
    stance: NDArray[np.bool_]
    swing: Array
    forces: Array
    normals: Array
    friction: Array


class Scratch(NamedTuple):
    """What :func:`assemble` finds on the way, for a program of n unknowns z.

    ``base`` (6, 24), ``base_free`` (6,): base acceleration = base z + base_free; ``torque`` (12, 24), ``torque_free``
    (12,): motor torques in the same way [Nm]; ``frames`` (4, 3, 3) two tangents and the normal of each contact as
    columns; ``first`` (4,) first unknown of each standing foot's force, -1 of a swinging one; ``row`` (24,); ``rates``
    (4, 3) wanted joint velocities [rad/s]; ``solved_forces`` (4, 3) of the last tick that was solved [N]; ``firm`` (4,)
    how firmly each foot was held to its place, 1 to 0; ``unknowns`` (24,).
    """

    base: Array
    base_free: Array
    torque: Array
    torque_free: Array
    frames: Array
    first: NDArray[np.int64]
    row: Array
    rates: Array
    solved_forces: Array
    firm: Array
    unknowns: Array


def make_scratch() -> Scratch:
    """Room for one tick."""
    return Scratch(
        np.zeros((6, UNKNOWNS)), np.zeros(6), np.zeros((12, UNKNOWNS)), np.zeros(12), np.zeros((4, 3, 3)),
        np.full(4, -1, dtype=np.int64), np.zeros(UNKNOWNS), np.zeros((4, 3)), np.zeros((4, 3)), np.ones(4),
        np.zeros(UNKNOWNS),
    )  # fmt: skip


def scaled(gains: Gains, size: float) -> Gains:
    """Gains for a robot ``size`` times as high: lengths grow with it, times with its root, accelerations stay."""
    time = np.sqrt(size)
    values = gains._asdict()
    for name in values:
        if name.endswith(("_damping", "_rate")):
            values[name] /= time
        elif name.endswith("_stiffness"):
            values[name] /= time**2
    # Angular accelerations grow as the lengths shrink: their weights keep them at par with linear ones.
    for name in ("orientation_weight", "joint_weight", "joint_limit_weight"):
        values[name] *= size**2
    values["letting_go"] /= size
    return Gains(**{name: float(value) for name, value in values.items()})


@kernel
def assemble(
    model: Model, limits: Limits, gains: Gains, state: FullState, wanted: References, terms: Terms, scratch: Scratch,
    program: Program,
) -> int:  # fmt: skip
    """Write the program of one tick; the number of its unknowns n. It has (n - 12) / 3 · 4 + 12 rows."""
    n = _contacts(wanted, scratch)
    _base_acceleration(model.mass, terms, wanted, scratch, n)
    for i in range(n):
        program.gradient[i] = 0.0
        for j in range(i, n):
            program.hessian[i, j] = 0.0
    _feet_tasks(gains, limits, state, wanted, terms, scratch, program, n)
    if n > 12:
        _trunk_tasks(gains, state, wanted, terms, scratch, program, n)
    _small_tasks(model.mass, gains, wanted, scratch, program)
    _wanted_rates(gains, state, wanted, terms, scratch.rates)
    _bounds(gains, limits, state, wanted, scratch, program, n)
    _torques(model.mass, limits, state, terms, scratch, program, n)
    return n


@kernel
def _contacts(wanted: References, scratch: Scratch) -> int:
    """Number the unknowns of standing feet, and span each contact's tangents; the count of all unknowns."""
    n = 12
    for leg in range(4):
        scratch.first[leg] = -1
        if not wanted.stance[leg]:
            continue
        scratch.first[leg] = n
        n += 3
        frame, normal = scratch.frames[leg], wanted.normals[leg]
        # The first tangent along the world's x axis, or y where the normal is nearly x itself.
        axis = 0 if abs(normal[0]) < 0.9 else 1
        length = np.sqrt(1.0 - normal[axis] * normal[axis])
        for i in range(3):
            along = 1.0 if i == axis else 0.0
            frame[i, 0] = (along - normal[axis] * normal[i]) / length
            frame[i, 2] = normal[i]
        for i in range(3):
            after, before = (i + 1) % 3, (i + 2) % 3
            frame[i, 1] = normal[after] * frame[before, 0] - normal[before] * frame[after, 0]
    return n


@kernel
def _base_acceleration(mass: float, terms: Terms, wanted: References, scratch: Scratch, n: int) -> None:
    """Solve the first six rows of the equation of motion for the base's acceleration.

    Those rows are [[m, B], [B', I]]; without the linear part, what is left is the inertia about the centre of mass.
    """
    big, base = terms.mass, scratch.base
    inertia, inverse = np.empty((3, 3)), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            inertia[i, j] = big[3 + i, 3 + j]
            for k in range(3):
                inertia[i, j] -= big[k, 3 + i] * big[k, 3 + j] / mass
    _invert(inertia, inverse)
    right = np.empty(6)
    for column in range(13):
        for i in range(6):
            right[i] = -big[i, 6 + column] if column < 12 else -terms.bias[i]
        _solve_base(mass, big, inverse, right)
        for i in range(6):
            if column < 12:
                base[i, column] = right[i]
            else:
                scratch.base_free[i] = right[i]
    for leg in range(4):
        first = scratch.first[leg]
        if first < 0:
            continue
        jacobian = terms.contact_jacobian[leg]
        for axis in range(3):
            for i in range(3):
                right[i] = mass * scratch.frames[leg, i, axis]
                right[3 + i] = 0.0
            for k in range(3):
                for i in range(3):
                    right[3 + i] += jacobian[k, 3 + i] * right[k]
            _solve_base(mass, big, inverse, right)
            for i in range(6):
                base[i, first + axis] = right[i]


@kernel
def _solve_base(mass: float, big: Array, inverse: Array, right: Array) -> None:
    """Solve for the base's acceleration (6,) in place of the force and moment ``right``."""
    moment0 = right[3] - (big[0, 3] * right[0] + big[1, 3] * right[1] + big[2, 3] * right[2]) / mass
    moment1 = right[4] - (big[0, 4] * right[0] + big[1, 4] * right[1] + big[2, 4] * right[2]) / mass
    moment2 = right[5] - (big[0, 5] * right[0] + big[1, 5] * right[1] + big[2, 5] * right[2]) / mass
    for i in range(3):
        right[3 + i] = inverse[i, 0] * moment0 + inverse[i, 1] * moment1 + inverse[i, 2] * moment2
    for i in range(3):
        right[i] = (right[i] - big[i, 3] * right[3] - big[i, 4] * right[4] - big[i, 5] * right[5]) / mass


@kernel
def _invert(a: Array, out: Array) -> None:
    """Write the inverse of a symmetric (3, 3) matrix."""
    for i in range(3):
        for j in range(3):
            i1, i2, j1, j2 = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            out[j, i] = a[i1, j1] * a[i2, j2] - a[i1, j2] * a[i2, j1]
    determinant = a[0, 0] * out[0, 0] + a[0, 1] * out[1, 0] + a[0, 2] * out[2, 0]
    for i in range(3):
        for j in range(3):
            out[i, j] /= determinant


@kernel
def _add_task(program: Program, row: Array, first: int, n: int, weight: float, target: float) -> None:
    """Add weight · (row z - target)² / 2 to the cost; ``row`` is zero before ``first``."""
    for i in range(first, n):
        scale = weight * row[i]
        program.gradient[i] -= scale * target
        for j in range(i, n):
            program.hessian[i, j] += scale * row[j]


@kernel
def _away_from_limit(gains: Gains, limits: Limits, state: FullState, leg: int, joint: int) -> tuple[float, float]:
    """Least and largest acceleration of a joint that keeps off its limits [rad/s²].

    Its distance d to either obeys d̈ + 2 k ḋ + k² d ≥ 0: it may close in, but ever more slowly.
    """
    rate, angle = gains.joint_limit_rate, state.joints[leg, joint]
    coast = -2.0 * rate * state.velocity[6 + 3 * leg + joint]
    low = coast + rate * rate * (limits.low[leg, joint] - angle)
    return low, coast + rate * rate * (limits.high[leg, joint] - angle)


@kernel
def _holds(gains: Gains, limits: Limits, state: FullState, leg: int) -> float:
    """How firmly a foot stands, 1 to 0: a leg that runs against its limit lets its foot go.

    A foot that were held would pull the trunk along: to bend a knee that is nearly straight faster than gravity
    bends it, all feet would have to give up the weight that they carry.
    """
    most = 0.0
    for joint in range(3):
        low, high = _away_from_limit(gains, limits, state, leg, joint)
        most = max(most, low, -high)
    return 1.0 / (1.0 + (most / gains.letting_go) ** 4)


@kernel
def _feet_tasks(
    gains: Gains, limits: Limits, state: FullState, wanted: References, terms: Terms, scratch: Scratch,
    program: Program, n: int,
) -> None:  # fmt: skip
    """Standing feet at rest, swinging feet on their path."""
    base, free, row = scratch.base, scratch.base_free, scratch.row
    for leg in range(4):
        stands = scratch.first[leg] >= 0
        scratch.firm[leg] = _holds(gains, limits, state, leg)
        weight = gains.stance_weight * scratch.firm[leg] if stands else gains.swing_weight
        jacobian = terms.contact_jacobian[leg] if stands else terms.jacobian[leg]
        joints = 6 + 3 * leg
        for i in range(3):
            if stands:
                target = -gains.stance_damping * terms.contact_velocity[leg, i] - terms.contact_drift[leg, i]
            else:
                path = wanted.swing[leg]
                target = path[2, i] - terms.drift[leg, i]
                target += gains.swing_stiffness * (path[0, i] - terms.feet[leg, i])
                target += gains.swing_damping * (path[1, i] - terms.feet_velocity[leg, i])
            j3, j4, j5 = jacobian[i, 3], jacobian[i, 4], jacobian[i, 5]
            target -= free[i] + j3 * free[3] + j4 * free[4] + j5 * free[5]
            for k in range(n):
                row[k] = base[i, k] + j3 * base[3, k] + j4 * base[4, k] + j5 * base[5, k]
            for k in range(3):
                row[3 * leg + k] += jacobian[i, joints + k]
            _add_task(program, row, 0, n, weight, target)


@kernel
def _trunk_tasks(
    gains: Gains, state: FullState, wanted: References, terms: Terms, scratch: Scratch, program: Program, n: int
) -> None:
    """Orientation by the base's angular acceleration, centre of mass by the sum of the forces."""
    row, turn, local, error = scratch.row, np.empty(3), np.empty(3), np.empty(3)
    orientation_error(state.orientation, wanted.orientation, error)
    rotate_back(terms.rotation, wanted.turning[0], local)
    for i in range(3):
        turn[i] = wanted.turning[1, i] + gains.orientation_stiffness * error[i]
        local[i] = gains.orientation_damping * (local[i] - state.velocity[3 + i])
    rotate_back(terms.rotation, turn, error)
    for i in range(3):
        target = error[i] + local[i] - scratch.base_free[3 + i]
        _add_task(program, scratch.base[3 + i], 0, n, gains.orientation_weight, target)
    square = 0.0
    for i in range(3):
        stiffness = gains.height_stiffness if i == 2 else gains.com_stiffness
        damping = gains.height_damping if i == 2 else gains.com_damping
        turn[i] = wanted.com[2, i] + stiffness * (wanted.com[0, i] - terms.com[i])
        turn[i] += damping * (wanted.com[1, i] - terms.com_velocity[i])
        square += turn[i] * turn[i]
    shrink = min(1.0, gains.acceleration_limit / max(np.sqrt(square), 1e-9))
    for i in range(3):
        for leg in range(4):
            first = scratch.first[leg]
            if first >= 0:
                for axis in range(3):
                    row[first + axis] = scratch.frames[leg, i, axis]
        target = shrink * turn[i] + (GRAVITY if i == 2 else 0.0)
        _add_task(program, row, 12, n, gains.com_weight, target)


@kernel
def orientation_error(measured: Array, wanted: Array, out: Array) -> None:
    """Write the rotation vector (3,) [rad], world axes, that turns orientation ``measured`` into ``wanted``."""
    w, x, y, z = measured[0], -measured[1], -measured[2], -measured[3]
    a, b, c, d = wanted[0], wanted[1], wanted[2], wanted[3]
    real = a * w - b * x - c * y - d * z
    out[0] = a * x + b * w + c * z - d * y
    out[1] = a * y - b * z + c * w + d * x
    out[2] = a * z + b * y - c * x + d * w
    sine = np.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    sign = 1.0 if real >= 0.0 else -1.0
    scale = 2.0 * sign * np.arctan2(sine, abs(real)) / sine if sine > 1e-12 else 2.0 * sign
    for i in range(3):
        out[i] *= scale


@kernel
def _small_tasks(mass: float, gains: Gains, wanted: References, scratch: Scratch, program: Program) -> None:
    """The preview's forces, and small joint accelerations."""
    for i in range(12):
        program.hessian[i, i] += gains.joint_weight
    for leg in range(4):
        first = scratch.first[leg]
        if first < 0:
            continue
        for axis in range(3):
            share = 0.0
            for i in range(3):
                share += scratch.frames[leg, i, axis] * wanted.forces[leg, i] / mass
            program.hessian[first + axis, first + axis] += gains.force_weight
            program.gradient[first + axis] -= gains.force_weight * share


@kernel
def _bounds(
    gains: Gains, limits: Limits, state: FullState, wanted: References, scratch: Scratch, program: Program, n: int
) -> None:
    """Joint limits, least normal force, and friction pyramids."""
    for leg in range(4):
        for joint in range(3):
            i = 3 * leg + joint
            program.low[i], program.high[i] = _away_from_limit(gains, limits, state, leg, joint)
            program.give[i] = 1.0 / gains.joint_limit_weight
    row = 0
    for leg in range(4):
        first = scratch.first[leg]
        if first < 0:
            continue
        for axis in range(3):
            program.low[first + axis] = gains.least_force * GRAVITY if axis == 2 else -np.inf
            program.high[first + axis] = np.inf
            program.give[first + axis] = 0.0
        for side in range(4):
            for axis in range(3):
                program.rows[row, first + axis] = 0.0
            program.rows[row, first + side // 2] = 1.0 - 2.0 * (side % 2)
            program.rows[row, first + 2] = -wanted.friction[leg]
            program.spans[row, 0], program.spans[row, 1] = first, first + 3
            program.low[n + row], program.high[n + row], program.give[n + row] = -np.inf, 0.0, 0.0
            row += 1


@kernel
def _torques(
    mass: float, limits: Limits, state: FullState, terms: Terms, scratch: Scratch, program: Program, n: int
) -> None:
    """Motor torques as functions of the unknowns, and their limits, as shares of them."""
    big, base, free = terms.mass, scratch.base, scratch.base_free
    pyramids = (n - 12) // 3 * 4
    for leg in range(4):
        first = scratch.first[leg]
        jacobian = terms.contact_jacobian[leg]
        for joint in range(3):
            i = 3 * leg + joint
            line, out = big[6 + i], scratch.torque[i]
            for k in range(n):
                out[k] = line[0] * base[0, k] + line[1] * base[1, k] + line[2] * base[2, k]
            for k in range(n):
                out[k] += line[3] * base[3, k] + line[4] * base[4, k] + line[5] * base[5, k]
            for k in range(3):
                out[3 * leg + k] += line[6 + 3 * leg + k]
            if first >= 0:
                for axis in range(3):
                    for k in range(3):
                        out[first + axis] -= mass * jacobian[k, 6 + i] * scratch.frames[leg, k, axis]
            value = terms.bias[6 + i] + joint_drag(limits, state, scratch.rates, leg, joint)
            for k in range(6):
                value += line[k] * free[k]
            scratch.torque_free[i] = value
            row, most = pyramids + i, limits.torque[leg, joint]
            for k in range(n):
                program.rows[row, k] = out[k] / most
            program.spans[row, 0], program.spans[row, 1] = 0, n
            program.low[n + row], program.high[n + row] = -1.0 - value / most, 1.0 - value / most
            program.give[n + row] = 0.0


@kernel
def _wanted_rates(gains: Gains, state: FullState, wanted: References, terms: Terms, rates: Array) -> None:
    """Write the joint velocities (4, 3) [rad/s] at which trunk and feet would close in on their references.

    They tell which way a joint is to move, which its measured velocity does not once it sticks. Errors count with
    stiffness / damping, the rate at which the tasks let them decay.
    """
    error, turn, move, arm, speed = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    orientation_error(state.orientation, wanted.orientation, error)
    for i in range(3):
        turn[i] = wanted.turning[0, i] + _decay(gains.orientation_stiffness, gains.orientation_damping) * error[i]
        stiffness = gains.height_stiffness if i == 2 else gains.com_stiffness
        damping = gains.height_damping if i == 2 else gains.com_damping
        move[i] = wanted.com[1, i] + _decay(stiffness, damping) * (wanted.com[0, i] - terms.com[i])
    for leg in range(4):
        for i in range(3):
            arm[i] = terms.com[i] - terms.feet[leg, i]
            speed[i] = -move[i]
            if not wanted.stance[leg]:
                path = wanted.swing[leg]
                speed[i] += path[1, i]
                speed[i] += _decay(gains.swing_stiffness, gains.swing_damping) * (path[0, i] - terms.feet[leg, i])
        add_cross(turn, arm, speed)
        _damped_solve(terms.jacobian[leg], 6 + 3 * leg, speed, rates[leg])


@kernel
def _decay(stiffness: float, damping: float) -> float:
    return stiffness / damping if damping > 0.0 else 0.0


@kernel
def _damped_solve(jacobian: Array, first: int, right: Array, out: Array) -> None:
    """Write J'(JJ' + λ)⁻¹ b for the three columns from ``first``: bounded where the leg is straight."""
    square, inverse = np.empty((3, 3)), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            square[i, j] = 1e-4 if i == j else 0.0
            for k in range(3):
                square[i, j] += jacobian[i, first + k] * jacobian[j, first + k]
    _invert(square, inverse)
    for k in range(3):
        out[k] = 0.0
        for i in range(3):
            for j in range(3):
                out[k] += jacobian[i, first + k] * inverse[i, j] * right[j]


@kernel
def joint_drag(limits: Limits, state: FullState, rates: Array, leg: int, joint: int) -> float:
    """The torque [Nm] that a joint's damping takes at its speed, and its dry friction at the speed it should have."""
    measured = state.velocity[6 + 3 * leg + joint]
    dry = limits.friction[leg, joint] * np.tanh(rates[leg, joint] / _SLIPPING)
    return dry + limits.damping[leg, joint] * measured
