"""Whether a motion may be walked: every rule of the swing problem again, by the tracker's full dynamics.

Nothing here calls what the solver is made of. Between knots the continuous dynamics are integrated from the tracking
controller's mass matrix by fourth-order Runge-Kutta, feet come from its kinematics, torques at rest from
its Jacobians and gravity terms.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.rotations import write_matrix
from legtool_runtime.tracking.dynamics import GRAVITY, FullState, Model, Terms, dynamics_terms
from legtool_runtime.tracking.ground import Ground, lowest_centre

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Begin and end of a swing in which the foot may be near the ground, as shares, and so far into the map there. A foot
#: that stands less than its radius beside a higher stone is into its column: it may be as far into it there, and while
#: it is over its place to within so much [m].
_NEAR, _INTO_M, _OVER_M = 0.20, 0.01, 0.02


class Judged(NamedTuple):
    """A motion as it is judged, over n knots and the end, world frame.

    ``times`` (n + 1,) [s]; ``com``, ``velocity``, ``momentum`` by mass (n + 1, 3); ``rotations`` (n + 1, 3,
    3); ``wanted`` (n + 1, 3, 3) those of the reference; ``joints`` (n + 1, 12); ``forces`` (n, 4, 3) [N]; ``rates``
    (n, 12); ``standing`` (n, 4); ``contact`` (n, 4, 3); ``normals`` (n, 4, 3); ``phase`` (n + 1, 4) of swings, NaN on
    the ground; ``ends`` (n, 4, 2, 3) of the swing that a foot is in.
    """

    times: Array
    com: Array
    velocity: Array
    momentum: Array
    rotations: Array
    wanted: Array
    joints: Array
    forces: Array
    rates: Array
    standing: Flags
    contact: Array
    normals: Array
    phase: Array
    ends: Array


class Worst(NamedTuple):
    """The worst of each rule, in its unit, and the knot where it is: ``values`` (9,), ``knots`` (9,)."""

    values: Array
    knots: NDArray[np.int64]


#: Rules in the order of :class:`Worst`. A value is refused above its bound.
RULES = ("defect", "slip", "friction", "load", "joint limit", "joint speed", "torque", "clearance", "tilt")


@kernel
def _note(worst: Worst, rule: int, value: float, knot: int) -> None:
    if not value <= worst.values[rule]:  # NaN is the worst of all
        worst.values[rule], worst.knots[rule] = value, knot


@kernel
def _terms_at(model: Model, s: Array, normals: Array, terms: Terms) -> None:
    """Terms at a state (25,): velocity, momentum by mass, centre of mass, quaternion, joints; at rest, base at 0."""
    still = np.zeros(18)
    dynamics_terms(model, FullState(np.zeros(3), s[9:13], s[13:25].copy().reshape(4, 3), still), normals, terms)


@kernel
def _rate(model: Model, s: Array, judged: Judged, k: int, terms: Terms, out: Array) -> None:
    """Write the rate of a state (25,) under the forces and joint rates of knot k."""
    _terms_at(model, s, judged.normals[k], terms)
    moment = np.zeros(3)
    for i in range(3):
        out[i] = -GRAVITY if i == 2 else 0.0
        out[6 + i] = s[i]
    for leg in range(4):
        f = judged.forces[k, leg]
        x, y, z = (
            judged.contact[k, leg, 0] - s[6], judged.contact[k, leg, 1] - s[7], judged.contact[k, leg, 2] - s[8],
        )  # fmt: skip
        moment[0] += y * f[2] - z * f[1]
        moment[1] += z * f[0] - x * f[2]
        moment[2] += x * f[1] - y * f[0]
        for i in range(3):
            out[i] += f[i] / model.mass
    rotation, com = terms.rotation, np.zeros(3)
    inertia, left = np.zeros((3, 3)), np.zeros(3)
    for i in range(3):
        out[3 + i] = moment[i] / model.mass
        for l in range(3):
            com[i] += rotation[l, i] * terms.com[l]
            left[i] += model.mass * rotation[l, i] * s[3 + l]
    square = com[0] * com[0] + com[1] * com[1] + com[2] * com[2]
    for i in range(3):
        for j in range(3):
            inertia[i, j] = terms.mass[3 + i, 3 + j] + model.mass * com[i] * com[j]
        inertia[i, i] -= model.mass * square
    linear = np.empty(3)
    for j in range(12):
        rate = judged.rates[k, j]
        out[13 + j] = rate
        for i in range(3):
            linear[i] = 0.0
            for l in range(3):
                linear[i] += rotation[l, i] * terms.mass[l, 6 + j]
        for i in range(3):
            after, before = (i + 1) % 3, (i + 2) % 3
            about = terms.mass[3 + i, 6 + j] - (com[after] * linear[before] - com[before] * linear[after])
            left[i] -= rate * about
    spin = np.linalg.solve(inertia, left)
    w, x, y, z = s[9], s[10], s[11], s[12]
    out[9] = 0.5 * (-x * spin[0] - y * spin[1] - z * spin[2])
    out[10] = 0.5 * (w * spin[0] + y * spin[2] - z * spin[1])
    out[11] = 0.5 * (w * spin[1] + z * spin[0] - x * spin[2])
    out[12] = 0.5 * (w * spin[2] + x * spin[1] - y * spin[0])


@kernel
def _runge_kutta(model: Model, s: Array, judged: Judged, k: int, step: float, terms: Terms, half: Array) -> None:
    """Advance a state by one step, and write the state half-way, to second order, into ``half``."""
    first, second, third, fourth = np.empty(25), np.empty(25), np.empty(25), np.empty(25)
    _rate(model, s, judged, k, terms, first)
    _rate(model, s + 0.5 * step * first, judged, k, terms, second)
    half[:] = s + 0.5 * step * second
    _rate(model, half, judged, k, terms, third)
    _rate(model, s + step * third, judged, k, terms, fourth)
    for i in range(25):
        s[i] += step / 6.0 * (first[i] + 2.0 * second[i] + 2.0 * third[i] + fourth[i])
    size = np.sqrt(s[9] * s[9] + s[10] * s[10] + s[11] * s[11] + s[12] * s[12])
    for i in range(9, 13):
        s[i] /= size


@kernel
def _packed(judged: Judged, k: int, out: Array) -> None:
    """Write a knot's state (25,)."""
    out[0:3], out[3:6], out[6:9] = judged.velocity[k], judged.momentum[k], judged.com[k]
    out[13:25] = judged.joints[k]
    m, trace, big = judged.rotations[k], -1.0, 0
    for i in range(4):  # the largest of the four entries is found first (Shepperd 1978)
        value = m[0, 0] + m[1, 1] + m[2, 2] if i == 0 else 2.0 * m[i - 1, i - 1] - m[0, 0] - m[1, 1] - m[2, 2]
        if value > trace:
            trace, big = value, i
    root = np.sqrt(max(1.0 + trace, 0.0))
    half = 0.5 / root
    out[9 + big] = 0.5 * root
    for i in range(3):
        after, before = (i + 1) % 3, (i + 2) % 3
        if big == 0:
            out[10 + i] = half * (m[before, after] - m[after, before])
        elif big == 1 + i:
            out[9] = half * (m[before, after] - m[after, before])
        else:
            out[10 + i] = half * (m[i, big - 1] + m[big - 1, i])


@kernel
def _forces(judged: Judged, k: int, friction: float, weight: float, worst: Worst) -> None:
    for leg in range(4):
        force, normal = judged.forces[k, leg], judged.normals[k, leg]
        if not judged.standing[k, leg]:
            _note(worst, 3, np.abs(force).max() / weight, k)
            continue
        along = force[0] * normal[0] + force[1] * normal[1] + force[2] * normal[2]
        x, y, z = force[0] - along * normal[0], force[1] - along * normal[1], force[2] - along * normal[2]
        _note(worst, 2, (np.sqrt(x * x + y * y + z * z) - friction * along) / weight, k)


@kernel
def _feet(
    model: Model, s: Array, judged: Judged, k: int, phase: Array, ground: Ground, clearance: float, terms: Terms,
    worst: Worst,
) -> None:  # fmt: skip
    """Judge standing and swinging feet of knot k at a state (25,) whose terms are given; ``phase`` (4,) of swings."""
    for leg in range(4):
        place = np.empty(3)
        for i in range(3):
            place[i] = terms.feet[leg, i] - terms.com[i] + s[6 + i]
        if judged.standing[k, leg]:
            off = 0.0
            for i in range(3):
                difference = place[i] - model.foot_radius * judged.normals[k, leg, i] - judged.contact[k, leg, i]
                off += difference * difference
            _note(worst, 1, np.sqrt(off), k)
            continue
        lowest = lowest_centre(ground, place[0], place[1], model.foot_radius, True)
        room = 0.0
        near = not _NEAR + 1e-6 < phase[leg] < 1.0 - _NEAR - 1e-6
        end = judged.ends[k, leg, 0 if phase[leg] < 0.5 else 1]
        beside = lowest_centre(ground, end[0], end[1], model.foot_radius, True) - end[2]
        x, y = place[0] - end[0], place[1] - end[1]
        if near or (beside > 0.0 and x * x + y * y < _OVER_M * _OVER_M):
            room = clearance + _INTO_M + max(beside, 0.0)
        _note(worst, 7, lowest - place[2] - room, k)


@kernel
def _torques(model: Model, judged: Judged, knot: int, k: int, limits: Array, terms: Terms, worst: Worst) -> None:
    """Judge the torques that hold the forces of interval k at a knot, of which ``terms`` are."""
    for leg in range(4):
        for joint in range(3):
            j = 3 * leg + joint
            torque = terms.bias[6 + j]
            for i in range(3):
                torque -= terms.jacobian[leg, i, 6 + j] * judged.forces[k, leg, i]
            _note(worst, 6, abs(torque) / limits[j], knot)


@kernel
def judge(
    model: Model, judged: Judged, ground: Ground, bounds: Array, bounds_of: tuple[float, float, float],
    terms: Terms, worst: Worst,
) -> None:  # fmt: skip
    """Write the worst of each rule.

    Args:
        model: the robot.
        judged: the motion.
        ground: heights, NaN where unknown.
        bounds: (3, 12) lower and upper limits of the joints [rad], limits of torques [Nm].
        bounds_of: tan of the cones' half opening, limit of joint rates [rad/s], least height of swings [m].
        terms: scratch.
        worst: written.
    """
    friction, speed, clearance = bounds_of
    n, weight = judged.forces.shape[0], model.mass * GRAVITY
    worst.values[:], worst.knots[:] = -np.inf, 0
    s, there, half, phase, turned = np.empty(25), np.empty(25), np.empty(25), np.empty(4), np.empty((3, 3))
    for k in range(n + 1):
        _packed(judged, k, there)
        if k > 0:
            for i in range(25):
                difference = abs(s[i] - there[i])
                if 9 <= i < 13:  # a quaternion and its negative are one rotation
                    difference = 2.0 * min(difference, abs(s[i] + there[i]))
                _note(worst, 0, difference, k)
        for j in range(12):
            _note(worst, 4, max(bounds[0, j] - there[13 + j], there[13 + j] - bounds[1, j]), k)
        write_matrix(there[9], there[10], there[11], there[12], turned)
        trace = 0.0
        for i in range(3):
            for j in range(3):
                trace += turned[i, j] * judged.wanted[k, i, j]
        _note(worst, 8, np.arccos(min(max(0.5 * (trace - 1.0), -1.0), 1.0)), k)
        _terms_at(model, there, judged.normals[min(k, n - 1)], terms)
        _feet(model, there, judged, min(k, n - 1), judged.phase[k], ground, clearance, terms, worst)
        if k > 0:
            _torques(model, judged, k, k - 1, bounds[2], terms, worst)
            _feet(model, there, judged, k - 1, judged.phase[k], ground, clearance, terms, worst)
        if k == n:
            break
        _torques(model, judged, k, k, bounds[2], terms, worst)
        _forces(judged, k, friction, weight, worst)
        for j in range(12):
            _note(worst, 5, abs(judged.rates[k, j]) / speed, k)
        s[:] = there
        _runge_kutta(model, s, judged, k, judged.times[k + 1] - judged.times[k], terms, half)
        for leg in range(4):
            phase[leg] = 0.5 * (judged.phase[k, leg] + judged.phase[k + 1, leg])
        _terms_at(model, half, judged.normals[k], terms)
        _feet(model, half, judged, k, phase, ground, clearance, terms, worst)
