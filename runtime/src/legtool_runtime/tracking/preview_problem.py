"""The preview's problem in compiled code: the horizon's nodes, what acts in each, and the solution in the world."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.tracking import riccati
from legtool_runtime.tracking.body_reference import spline_at, turning
from legtool_runtime.tracking.contact_plan import PlanTable, stance_at
from legtool_runtime.tracking.dynamics import GRAVITY

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


class Result(NamedTuple):
    """A solution in the world's frame: ``forces`` (n, 4, 3) [N], ``accelerations`` (n, 6) linear and angular [m/s²,
    rad/s²], ``states`` (n + 1, 9) centre of mass, its velocity, angular velocity [m, m/s, rad/s]."""

    forces: Array
    accelerations: Array
    states: Array


@kernel
def node_borders(table: PlanTable, now: float, node: float, times: Array) -> None:
    """Write the borders (n + 1,) of nodes that no touchdown or lift-off falls into, but for ones of a fifth of a node.

    With nodes of one length the same full stance is one node now and two a moment later, and the body drifts.
    """
    least = 0.2 * node
    times[0] = now
    k, last = 0, times.shape[0] - 1
    while k < last:
        event = np.inf
        for leg in range(4):
            for i in range(table.stances[leg]):
                for t in (table.begin[leg, i], table.end[leg, i]):
                    if t > times[k] + least and t < event:
                        event = t
        parts = last - k
        step = node
        if event < times[k] + (last - k + 1) * node:
            parts = min(max(int(np.ceil((event - times[k]) / node - 1e-6)), 1), last - k)
            step = (event - times[k]) / max(int(np.ceil((event - times[k]) / node - 1e-6)), 1)
        begin = times[k]
        for i in range(1, parts + 1):
            times[k + i] = begin + i * step
        k += parts


@kernel
def node_contacts(table: PlanTable, times: Array, now: Flags, late: Flags, out: Flags) -> None:
    """Write which feet carry in each node (n, 4): those that stand at its middle, see :meth:`Preview.solve`."""
    for k in range(out.shape[0]):
        for leg in range(4):
            stands = stance_at(table, leg, 0.5 * (times[k] + times[k + 1])) >= 0
            out[k, leg] = stands and (k > 0 or now[leg]) and (k > 1 or not late[leg])


@kernel
def _contact_axes(normal: Array, out: Array) -> None:
    """Write two tangents and the normal as columns (3, 3); the first tangent lies in the world's x-z plane."""
    x, y, z = normal[0], normal[1], normal[2]
    length = np.sqrt(x * x + z * z)
    tx, tz = z / length, -x / length
    out[0, 0], out[1, 0], out[2, 0] = tx, 0.0, tz
    out[0, 1], out[1, 1], out[2, 1] = y * tz, z * tx - x * tz, -y * tx
    out[0, 2], out[1, 2], out[2, 2] = x, y, z


@kernel
def rotation_vector(turn: Array, out: Array) -> None:
    """Write the rotation vector (3,) of a rotation matrix."""
    cosine = min(max(0.5 * (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0), -1.0), 1.0)
    angle = np.arccos(cosine)
    sine = np.sin(angle)
    factor = 0.5 if angle < 1e-6 else 0.5 * angle / max(sine, 1e-6)
    out[0] = factor * (turn[2, 1] - turn[1, 2])
    out[1] = factor * (turn[0, 2] - turn[2, 0])
    out[2] = factor * (turn[1, 0] - turn[0, 1])


@kernel
def assemble(
    problem: riccati.RiccatiProblem,
    table: PlanTable,
    control: Array,
    timing: tuple[float, float],
    times: Array,
    body: Array,
    places: Array,
    rigid: tuple[float, Array, tuple[float, float]],
    standing: Flags,
    axes: Array,
) -> None:
    """Fill ``problem``: ``timing`` start and step of the reference; ``body`` (6, 3) the state's rows."""
    start, step = timing
    now = times[0]
    mass, inertia, least = rigid
    n = problem.legs.shape[0]
    spline, following, middle = np.empty((3, 6)), np.empty((3, 6)), np.empty((3, 6))
    turn, unused = np.empty((3, 3)), np.empty((3, 3))
    rates, next_rates, other_rates = np.empty((2, 3)), np.empty((2, 3)), np.empty((2, 3))
    arm, push = np.empty(3), np.empty(3)
    spline_at(start, step, control, now, spline)
    turning(spline, turn, rates)
    off = body[2:5] @ turn.T
    for i in range(3):
        problem.start[i] = body[0, i] - spline[0, i]
        problem.start[i + 3] = body[1, i] - spline[1, i]
        problem.start[i + 9] = body[5, i] - rates[0, i]
    rotation_vector(off, problem.start[6:9])
    for k in range(n):
        dt, centre = problem.node_s[k], 0.5 * (times[k] + times[k + 1])
        spline_at(start, step, control, times[k + 1], following)
        spline_at(start, step, control, centre, middle)
        turning(following, unused, next_rates)
        turning(middle, turn, other_rates)
        world = turn @ inertia @ turn.T
        inverse = np.linalg.inv(world)
        momentum = world @ rates[0]
        spin = inverse @ np.array(
            [
                rates[0, 1] * momentum[2] - rates[0, 2] * momentum[1],
                rates[0, 2] * momentum[0] - rates[0, 0] * momentum[2],
                rates[0, 0] * momentum[1] - rates[0, 1] * momentum[0],
            ]
        )
        for i in range(3):
            wanted = (following[1, i] - spline[1, i]) / dt
            gravity = GRAVITY if i == 2 else 0.0
            push[i] = wanted + gravity
            problem.drift[k, i] = spline[0, i] - following[0, i] + dt * spline[1, i] - 0.5 * dt * dt * gravity
            problem.drift[k, i + 3] = -dt * push[i]
            turned = (next_rates[0, i] - rates[0, i]) / dt + spin[i]
            problem.drift[k, i + 6], problem.drift[k, i + 9] = -0.5 * dt * dt * turned, -dt * turned
        # Shifted by d, forces that sum up to m · push turn the body by -d × m · push.
        skew = np.array([[0.0, -push[2], push[1]], [push[2], 0.0, -push[0]], [-push[1], push[0], 0.0]])
        problem.shift[k] = mass * (inverse @ skew)
        count = 0
        for leg in range(4):
            if standing[k, leg]:
                count += 1
        column = 0
        for leg in range(4):
            if not standing[k, leg]:
                continue
            stance = max(stance_at(table, leg, centre), 0)
            _contact_axes(table.normal[leg, stance], axes[k, leg])
            place = table.place[leg, stance]
            if np.isfinite(places[leg, 0]) and stance == stance_at(table, leg, now):
                place = places[leg]
            for i in range(3):
                arm[i] = place[i] - middle[0, i]
            for j in range(3):
                x, y, z = axes[k, leg, 0, j], axes[k, leg, 1, j], axes[k, leg, 2, j]
                mx, my, mz = arm[1] * z - arm[2] * y, arm[2] * x - arm[0] * z, arm[0] * y - arm[1] * x
                for i in range(3):
                    problem.wrench[k, i, column] = GRAVITY * axes[k, leg, i, j]
                    problem.wrench[k, i + 3, column] = (
                        mass * GRAVITY * (inverse[i, 0] * mx + inverse[i, 1] * my + inverse[i, 2] * mz)
                    )
                problem.nominal[k, column] = (x * push[0] + y * push[1] + z * push[2]) / (GRAVITY * count)
                column += 1
        problem.legs[k] = count
        problem.least[k] = least[0] if count >= 3 else least[1]
        spline[:], rates[0] = following, next_rates[0]


@kernel
def guess(
    problem: riccati.RiccatiProblem,
    work: riccati.RiccatiWorkspace,
    before: Array,
    old: Array,
    times: Array,
    standing: Flags,
    axes: Array,
    weight: float,
) -> None:
    """Start from forces (n, 4, 3) of nodes with borders ``old`` where the same feet stand, else from nominal ones."""
    n = problem.legs.shape[0]
    node = 0
    work.states[0] = problem.start
    for k in range(n):
        centre = 0.5 * (times[k] + times[k + 1])
        while node < n - 1 and old[node + 1] <= centre:
            node += 1
        column, same = 0, centre < old[n]
        for leg in range(4):
            if standing[k, leg] != (before[node, leg, 2] != 0.0):
                same = False
        for leg in range(4):
            if not standing[k, leg]:
                continue
            for j in range(3):
                value = problem.nominal[k, column]
                if same:
                    value = 0.0
                    for i in range(3):
                        value += axes[k, leg, i, j] * before[node, leg, i] / weight
                work.forces[k, column] = value
                column += 1
        riccati.advance(problem, k, work.states[k], work.forces[k], work.states[k + 1])


@kernel
def read(
    problem: riccati.RiccatiProblem,
    work: riccati.RiccatiWorkspace,
    control: Array,
    timing: tuple[float, float],
    times: Array,
    standing: Flags,
    axes: Array,
    weight: float,
    out: Result,
) -> None:
    """Write the solution in the world's frame and units."""
    start, step = timing
    spline, turn, rates = np.empty((3, 6)), np.empty((3, 3)), np.empty((2, 3))
    n = problem.legs.shape[0]
    for k in range(n + 1):
        spline_at(start, step, control, times[k], spline)
        turning(spline, turn, rates)
        for i in range(3):
            out.states[k, i], out.states[k, i + 3] = (
                work.states[k, i] + spline[0, i],
                work.states[k, i + 3] + spline[1, i],
            )
            out.states[k, i + 6] = work.states[k, i + 9] + rates[0, i]
        if k == n:
            break
        column = 0
        for leg in range(4):
            if not standing[k, leg]:
                continue
            for i in range(3):
                for j in range(3):
                    out.forces[k, leg, i] += weight * axes[k, leg, i, j] * work.forces[k, column + j]
            column += 3
    for k in range(n):
        for i in range(6):
            out.accelerations[k, i] = (out.states[k + 1, i + 3] - out.states[k, i + 3]) / problem.node_s[k]
