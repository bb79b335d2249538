"""The cost of the swing problem: squares off the reference, and logarithmic barriers at its limits.

The barriers are relaxed: below a small distance they go on as parabolas (Feller and Ebenbauer 2017), so that they are
finite everywhere. What they let through is found when an answer is judged. A torque is what carries force and leg at
rest; its change with the joints is left out of the derivatives and comes in at the next pass.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.search.swings.centroidal import Tree, cross
from legtool_runtime.search.swings.motion import rotation_vector
from legtool_runtime.search.swings.problem import Limits, SwingProblem, Workspace

Array = NDArray[np.float64]

#: Weights are for steps of this length [s].
STEP_S = 0.02
#: The cone's tip is rounded over this share of the weight.
_TIP = 1e-3


@kernel
def barrier(limits: Limits, inside: float) -> tuple[float, float, float]:
    """Value, slope and curvature of the barrier, so far inside a bound."""
    height, smooth = limits.barrier, limits.smooth
    if inside > smooth:
        return -height * np.log(inside), -height / inside, height / (inside * inside)
    off = (inside - 2.0 * smooth) / smooth
    return 0.5 * height * (off * off - 1.0) - height * np.log(smooth), height * off / smooth, height / (smooth * smooth)


@kernel
def torque_rows(tree: Tree, rotation: Array, leg: int, rows: Array) -> None:
    """Write how a leg's static torques (3, 4) follow from its force, world frame, and by themselves, per weight [m]."""
    column, arm = np.empty(3), np.empty(3)
    for joint in range(3):
        for i in range(3):
            arm[i] = tree.anchors[leg, 3, i] - tree.anchors[leg, joint, i]
        cross(tree.axes[leg, joint], arm, column)
        rate = tree.com_rate[3 * leg + joint]
        rows[joint, 3] = rotation[2, 0] * rate[0] + rotation[2, 1] * rate[1] + rotation[2, 2] * rate[2]
        for i in range(3):
            rows[joint, i] = -(rotation[i, 0] * column[0] + rotation[i, 1] * column[1] + rotation[i, 2] * column[2])


@kernel
def _force(limits: Limits, axes: Array, force: Array, share: float, cost: Array, pull: Array) -> float:
    """Add the barriers of a contact force (3,) to its weights and slope; the value."""
    along, slope, local = np.zeros(3), np.zeros(3), np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            along[i] += axes[i, j] * force[j]
    across = np.sqrt(along[0] * along[0] + along[1] * along[1] + _TIP * _TIP)
    value, first, second = barrier(limits, limits.friction * along[2] - across)
    gradient = np.array([-along[0] / across, -along[1] / across, limits.friction])
    for i in range(3):
        slope[i] = first * gradient[i]
        for j in range(3):
            local[i, j] = second * gradient[i] * gradient[j]
    for i in range(2):
        for j in range(2):
            local[i, j] -= first * ((1.0 if i == j else 0.0) - along[i] * along[j] / (across * across)) / across
    low, first, second = barrier(limits, along[2] - limits.least)
    slope[2] += first
    local[2, 2] += second
    high, first, second = barrier(limits, limits.most - along[2])
    slope[2] -= first
    local[2, 2] += second
    for i in range(3):
        for j in range(3):
            pull[i] += share * axes[j, i] * slope[j]
            for a in range(3):
                for b in range(3):
                    cost[i, j] += share * axes[a, i] * local[a, b] * axes[b, j]
    return share * (value + low + high)


@kernel
def _torque(limits: Limits, rows: Array, leg: int, force: Array, share: float, cost: Array, pull: Array) -> float:
    """Add the barriers of a leg's torques; the value."""
    total = 0.0
    for joint in range(3):
        most = limits.torque[3 * leg + joint]
        torque = rows[joint, 3]
        for i in range(3):
            torque += rows[joint, i] * force[i]
        up, up_1, up_2 = barrier(limits, 1.0 - torque / most)
        down, down_1, down_2 = barrier(limits, 1.0 + torque / most)
        first, second = share * (down_1 - up_1) / most, share * (up_2 + down_2) / (most * most)
        total += share * (up + down)
        for i in range(3):
            pull[i] += first * rows[joint, i]
            for j in range(3):
                cost[i, j] += second * rows[joint, i] * rows[joint, j]
    return total


@kernel
def _joints(limits: Limits, x: Array, share: float, cost: Array, pull: Array) -> float:
    total = 0.0
    for j in range(12):
        low, low_1, low_2 = barrier(limits, x[12 + j] - limits.low[j])
        high, high_1, high_2 = barrier(limits, limits.high[j] - x[12 + j])
        total += share * (low + high)
        pull[12 + j] += share * (low_1 - high_1)
        cost[12 + j] += share * (low_2 + high_2)
    return total


@kernel
def _rates(limits: Limits, u: Array, share: float, cost: Array, pull: Array) -> float:
    total = 0.0
    for j in range(12):
        rate = u[12 + j] / limits.speed
        up, up_1, up_2 = barrier(limits, 1.0 - rate)
        down, down_1, down_2 = barrier(limits, 1.0 + rate)
        total += share * (up + down)
        pull[12 + j] += share * (down_1 - up_1) / limits.speed
        cost[j] += share * (up_2 + down_2) / (limits.speed * limits.speed)
    return total


@kernel
def state_cost(problem: SwingProblem, work: Workspace, k: int, x: Array, rotation: Array) -> float:
    """The cost of a state at knot k; its weights and slope are written into ``work``."""
    last = k == problem.step_s.shape[0]
    share = 1.0 if last else problem.step_s[k] / STEP_S
    weights, cost, pull = problem.weights[1 if last else 0], work.cost_x[k], work.pull_x[k]
    off, total = np.empty(3), 0.0
    rotation_vector(problem.rotations[k], rotation, off)
    for i in range(24):
        difference = off[i - 9] if 9 <= i < 12 else x[i] - problem.states[k, i]
        cost[i] = share * weights[i]
        pull[i] = cost[i] * difference
        total += 0.5 * pull[i] * difference
    if last:
        steered = 0.0
        for i in range(9):
            steered += problem.steer[i] * (x[i] - problem.states[k, i])
        for i in range(9):
            pull[i] += steered * problem.steer[i]
        total += 0.5 * steered * steered
    return total + _joints(problem.limits, x, share, cost, pull)


@kernel
def input_cost(problem: SwingProblem, work: Workspace, k: int, u: Array, rotation: Array) -> float:
    """The cost of the inputs at knot k, whose tree is in ``work``; weights and slope are written there."""
    share = problem.step_s[k] / STEP_S
    pull, total, rows = work.pull_u[k], 0.0, np.empty((3, 4))
    for j in range(24):
        weight, difference = share * problem.weights[2, j], u[j] - problem.inputs[k, j]
        pull[j] = weight * difference
        total += 0.5 * pull[j] * difference
        if j >= 12:
            work.cost_rate[k, j - 12] = weight
    for leg in range(4):
        a, cost = 3 * leg, work.cost_force[k, leg]
        cost[:] = 0.0
        if not problem.standing[k, leg]:
            continue
        for i in range(3):
            cost[i, i] = share * problem.weights[2, a + i]
        total += _force(problem.limits, problem.axes[k, leg], u[a : a + 3], share, cost, pull[a : a + 3])
        torque_rows(work.tree, rotation, leg, rows)
        total += _torque(problem.limits, rows, leg, u[a : a + 3], share, cost, pull[a : a + 3])
    return total + _rates(problem.limits, u, share, work.cost_rate[k], pull)
