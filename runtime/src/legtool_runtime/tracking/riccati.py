"""The preview's optimal control problem in compiled code: an interior point method on a Riccati recursion.

    minimise    Σₖ hₖ (½ xₖ₊₁ᵀ Q xₖ₊₁ + ½ r |uₖ - ūₖ|²)
    subject to  xₖ₊₁ = A₀ xₖ + M (Wₖ uₖ + Fₖ xₖ) + bₖ,   cone(uₖ) ≥ 0

x (12,) are the deviations of centre of mass, velocity, rotation vector and angular velocity from the reference. A₀ lets
the rates move position and rotation, M does the same with accelerations, and F holds one 3 × 3 block, the moment that a
shift of the centre of mass makes. u stacks the forces of the standing feet in the axes of their contacts (two tangents,
normal) as shares of the weight. A swinging foot has no columns, so that an interior always exists.

Predictor and corrector are Mehrotra's (1992). A step of the method solves the problem above with the cones in the
quadratic term, which is the recursion of Rao, Wright and Rawlings (1998, "Application of interior-point methods to
model predictive control"): the cones only fill blocks of 3 × 3 on the diagonal of its force weights.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STATES, CONES = 12, 6
#: A duality gap of a constraint, in units of the cost, and a violation in shares of the weight, that count as nothing.
TOLERANCE = 1e-9
ITERATIONS = 30
#: How far a step goes towards the border of the interior.
_STEP = 0.995


class RiccatiProblem(NamedTuple):
    """One problem over n nodes.

    ``node_s`` (n,) duration of each [s]; ``share`` (n,) h, its weight in the cost, the last state's aside; ``start``
    (12,) x₀; ``legs`` (n,) feet that stand; ``wrench`` (n, 6, 12) W, linear and angular acceleration for the forces
    [m/s², rad/s²], three columns a foot, those of standing feet first; ``shift`` (n, 3, 3) of F: angular acceleration
    by a shift of the centre of mass [rad/s²/m]; ``drift`` (n, 12) b; ``nominal`` (n, 12) ū; ``weights`` (2, 12) of the
    states on the way and at the end; ``effort`` r; ``friction`` of the pyramids; ``least`` (n,) and ``most`` normal
    force as shares of the weight.
    """

    node_s: Array
    share: Array
    start: Array
    legs: Index
    wrench: Array
    shift: Array
    drift: Array
    nominal: Array
    weights: Array
    effort: float
    friction: float
    least: Array
    most: float


class RiccatiWorkspace(NamedTuple):
    """Memory of the method for n nodes; ``forces``, ``states``, ``slack`` and ``dual`` are its iterate."""

    forces: Array  # (n, 12)
    states: Array  # (n + 1, 12)
    slack: Array  # (n, 4, 6)
    dual: Array  # (n, 4, 6)
    aim_forces: Array  # (n, 12) where a full step leads
    aim_states: Array  # (n + 1, 12)
    push_slack: Array  # (n, 4, 6)
    push_dual: Array  # (n, 4, 6)
    factor: Array  # (n, 12, 12) upper factor of the force weights
    gain: Array  # (n, 12, 12)
    offset: Array  # (n, 12)
    pull: Array  # (n, 12) value function's Hessian times the drift
    cost: Array  # (12, 12) value function's Hessian


def workspace(nodes: int) -> RiccatiWorkspace:
    """Memory for problems of ``nodes`` nodes."""
    n = nodes
    return RiccatiWorkspace(
        np.zeros((n, 12)), np.zeros((n + 1, 12)), np.ones((n, 4, 6)), np.ones((n, 4, 6)),
        np.zeros((n, 12)), np.zeros((n + 1, 12)), np.zeros((n, 4, 6)), np.zeros((n, 4, 6)),
        np.zeros((n, 12, 12)), np.zeros((n, 12, 12)), np.zeros((n, 12)), np.zeros((n, 12)), np.zeros((12, 12)),
    )  # fmt: skip


@kernel
def cone(friction: float, least: float, most: float, force: Array, out: Array) -> None:
    """Write how far a force (3,) is inside each side of its cone (6,): all positive inside."""
    across = friction * force[2]
    out[0], out[1] = across - force[0], across + force[0]
    out[2], out[3] = across - force[1], across + force[1]
    out[4], out[5] = force[2] - least, most - force[2]


@kernel
def advance(problem: RiccatiProblem, k: int, x: Array, u: Array, out: Array) -> None:
    """Write the state after node ``k``."""
    dt = problem.node_s[k]
    half = 0.5 * dt * dt
    m = 3 * problem.legs[k]
    for row in range(6):
        acceleration = 0.0
        for j in range(m):
            acceleration += problem.wrench[k, row, j] * u[j]
        if row >= 3:
            for j in range(3):
                acceleration += problem.shift[k, row - 3, j] * x[j]
        place = row if row < 3 else row + 3
        out[place] = x[place] + dt * x[place + 3] + half * acceleration + problem.drift[k, place]
        out[place + 3] = x[place + 3] + dt * acceleration + problem.drift[k, place + 3]


@kernel
def _rates_to_places(step: float, matrix: Array) -> None:
    """A₀ᵀ times a matrix of twelve rows, in place."""
    for row in range(3):
        for j in range(matrix.shape[1]):
            matrix[row + 3, j] += step * matrix[row, j]
            matrix[row + 9, j] += step * matrix[row + 6, j]


@kernel
def _cone_weights(problem: RiccatiProblem, work: RiccatiWorkspace, k: int, leg: int, out: Array) -> None:
    """Add what the cone of a foot adds to the weights (12, 12) of its forces."""
    mu = problem.friction
    d = work.dual[k, leg] / work.slack[k, leg]
    a = 3 * leg
    out[a, a] += d[0] + d[1]
    out[a + 1, a + 1] += d[2] + d[3]
    out[a, a + 2] += mu * (d[1] - d[0])
    out[a + 1, a + 2] += mu * (d[3] - d[2])
    out[a + 2, a + 2] += mu * mu * (d[0] + d[1] + d[2] + d[3]) + d[4] + d[5]


@kernel
def _push(problem: RiccatiProblem, work: RiccatiWorkspace, k: int, push: Array, inner: Array) -> None:
    """Write PM (12, 6) and MᵀPM (6, 6) of the value function after node ``k``, and its pull Pb."""
    dt, cost = problem.node_s[k], work.cost
    half = 0.5 * dt * dt
    for i in range(12):
        total = 0.0
        for j in range(12):
            total += cost[i, j] * problem.drift[k, j]
        work.pull[k, i] = total
        for j in range(3):
            push[i, j] = half * cost[i, j] + dt * cost[i, j + 3]
            push[i, j + 3] = half * cost[i, j + 6] + dt * cost[i, j + 9]
    for j in range(6):
        for i in range(3):
            inner[i, j] = half * push[i, j] + dt * push[i + 3, j]
            inner[i + 3, j] = half * push[i + 6, j] + dt * push[i + 9, j]


@kernel
def _carry(dt: float, cost: Array, push: Array, mixed: Array) -> None:
    """Take P to A₀ᵀPA₀ in place, and write MᵀPA₀ (6, 12) from PM, which it destroys."""
    _rates_to_places(dt, push)
    for i in range(6):
        for j in range(12):
            mixed[i, j] = push[j, i]
    _rates_to_places(dt, cost)
    for i in range(12):
        for j in range(3):
            cost[i, j + 3] += dt * cost[i, j]
            cost[i, j + 9] += dt * cost[i, j + 6]


@kernel
def _shift(shift: Array, inner: Array, cost: Array, mixed: Array) -> None:
    """Add what the moment of a shift does: FᵀN + NᵀF + FᵀΠF to the cost, ΠF to N = ``mixed``, with Π = ``inner``."""
    for i in range(3):
        for row in range(3):
            e = shift[row, i]
            for j in range(12):
                cost[i, j] += e * mixed[row + 3, j]
                cost[j, i] += e * mixed[row + 3, j]
    for i in range(6):
        for row in range(3):
            for j in range(3):
                mixed[i, j] += inner[i, row + 3] * shift[row, j]
    for i in range(3):
        for row in range(3):
            for l in range(3):
                for j in range(3):
                    cost[i, j] += shift[row, i] * inner[row + 3, l + 3] * shift[l, j]


@kernel
def _force_weights(
    wrench: Array, m: int, effort: float, inner: Array, mixed: Array, wide: Array, upper: Array, gain: Array
) -> None:
    """Write R + WᵀΠW (m, m) into ``upper`` and WᵀN (m, 12) into ``gain``."""
    for i in range(6):
        for j in range(m):
            wide[i, j] = 0.0
        for l in range(6):
            w = inner[i, l]
            for j in range(m):
                wide[i, j] += w * wrench[l, j]
    for i in range(m):
        for j in range(m):
            upper[i, j] = 0.0
        for j in range(12):
            gain[i, j] = 0.0
        for l in range(6):
            w = wrench[l, i]
            for j in range(m):
                upper[i, j] += w * wide[l, j]
            for j in range(12):
                gain[i, j] += w * mixed[l, j]
        upper[i, i] += effort


@kernel
def _eliminate(upper: Array, gain: Array, m: int, cost: Array) -> bool:
    """Factor ``upper`` = UᵀU, take ``gain`` to U⁻ᵀ gain, and its square off the cost; whether the factor exists."""
    for i in range(m):
        if not upper[i, i] > 0.0:
            return False
        inverse = 1.0 / np.sqrt(upper[i, i])
        for j in range(i, m):
            upper[i, j] *= inverse
        for j in range(12):
            gain[i, j] *= inverse
        for row in range(i + 1, m):
            w = upper[i, row]
            for j in range(row, m):
                upper[row, j] -= w * upper[i, j]
            for j in range(12):
                gain[row, j] -= w * gain[i, j]
    for l in range(m):
        for i in range(12):
            w = gain[l, i]
            for j in range(12):
                cost[i, j] -= w * gain[l, j]
    return True


@kernel
def _factorise(problem: RiccatiProblem, work: RiccatiWorkspace) -> bool:
    """The backward recursion's matrices; whether all factors exist."""
    n, cost = problem.legs.shape[0], work.cost
    push, inner = np.empty((12, 6)), np.empty((6, 6))
    mixed, wide = np.empty((6, 12)), np.empty((6, 12))
    cost[:] = 0.0
    for i in range(12):
        cost[i, i] = problem.weights[1, i]
    for k in range(n - 1, -1, -1):
        m, upper, gain = 3 * problem.legs[k], work.factor[k], work.gain[k]
        _push(problem, work, k, push, inner)
        _carry(problem.node_s[k], cost, push, mixed)
        _shift(problem.shift[k], inner, cost, mixed)
        if k > 0:
            for i in range(12):
                cost[i, i] += problem.share[k - 1] * problem.weights[0, i]
        _force_weights(problem.wrench[k], m, problem.share[k] * problem.effort, inner, mixed, wide, upper, gain)
        for leg in range(problem.legs[k]):
            _cone_weights(problem, work, k, leg, upper)
        if not _eliminate(upper, gain, m, cost):
            return False
    return True


@kernel
def _cone_slope(
    problem: RiccatiProblem, work: RiccatiWorkspace, k: int, centre: float, corrected: bool, slope: Array
) -> None:
    """Add what the cones of node ``k`` pull its forces (m,) by."""
    mu = problem.friction
    for leg in range(problem.legs[k]):
        a = 3 * leg
        for c in range(CONES):
            s, dual = work.slack[k, leg, c], work.dual[k, leg, c]
            target = centre
            if corrected:
                target -= work.push_slack[k, leg, c] * work.push_dual[k, leg, c]
            constant = -problem.least[k] if c == 4 else (problem.most if c == 5 else 0.0)
            pull = dual + (target - dual * constant) / s
            if c < 4:
                slope[a + c // 2] += pull if c % 2 == 0 else -pull
                slope[a + 2] -= mu * pull
            else:
                slope[a + 2] += pull if c == 5 else -pull


@kernel
def _back(problem: RiccatiProblem, work: RiccatiWorkspace, k: int, slope: Array, pushed: Array) -> None:
    """Take the value function's slope (12,) from after node ``k``, pull included, to before it."""
    dt = problem.node_s[k]
    for i in range(3):
        slope[i + 3] += dt * slope[i]
        slope[i + 9] += dt * slope[i + 6]
    for i in range(3):
        for row in range(3):
            slope[i] += problem.shift[k, row, i] * pushed[row + 3]
    for l in range(3 * problem.legs[k]):
        w = work.offset[k, l]
        for i in range(12):
            slope[i] -= w * work.gain[k, l, i]


@kernel
def _solve(problem: RiccatiProblem, work: RiccatiWorkspace, centre: float, corrected: bool) -> None:
    """Where a full step leads, aiming at complementarity ``centre``; by the factors at hand."""
    slope, pushed = np.zeros(12), np.empty(6)
    for k in range(problem.legs.shape[0] - 1, -1, -1):
        dt = problem.node_s[k]
        half, effort = 0.5 * dt * dt, problem.share[k] * problem.effort
        m, upper, offset = 3 * problem.legs[k], work.factor[k], work.offset[k]
        for i in range(12):
            slope[i] += work.pull[k, i]
        for i in range(3):
            pushed[i] = half * slope[i] + dt * slope[i + 3]
            pushed[i + 3] = half * slope[i + 6] + dt * slope[i + 9]
        for j in range(m):
            offset[j] = -effort * problem.nominal[k, j]
        for row in range(6):
            for j in range(m):
                offset[j] += problem.wrench[k, row, j] * pushed[row]
        _cone_slope(problem, work, k, centre, corrected, offset)
        for i in range(m):
            offset[i] /= upper[i, i]
            for row in range(i + 1, m):
                offset[row] -= upper[i, row] * offset[i]
        _back(problem, work, k, slope, pushed)
    _forward(problem, work)
    _pushes(problem, work, centre, corrected)


@kernel
def _forward(problem: RiccatiProblem, work: RiccatiWorkspace) -> None:
    """Write forces and states where a full step leads."""
    force = np.empty(12)
    work.aim_states[0] = problem.start
    for k in range(problem.legs.shape[0]):
        m = 3 * problem.legs[k]
        upper, x = work.factor[k], work.aim_states[k]
        for i in range(m):
            total = -work.offset[k, i]
            for j in range(12):
                total -= work.gain[k, i, j] * x[j]
            force[i] = total
        for i in range(m - 1, -1, -1):
            total = force[i]
            for j in range(i + 1, m):
                total -= upper[i, j] * work.aim_forces[k, j]
            work.aim_forces[k, i] = total / upper[i, i]
        advance(problem, k, x, work.aim_forces[k], work.aim_states[k + 1])


@kernel
def _pushes(problem: RiccatiProblem, work: RiccatiWorkspace, centre: float, corrected: bool) -> None:
    """Write the full step of slacks and duals."""
    inside = np.empty(CONES)
    for k in range(problem.legs.shape[0]):
        for leg in range(problem.legs[k]):
            force = work.aim_forces[k, 3 * leg : 3 * leg + 3]
            cone(problem.friction, problem.least[k], problem.most, force, inside)
            for c in range(CONES):
                s, dual = work.slack[k, leg, c], work.dual[k, leg, c]
                target = centre
                if corrected:
                    target -= work.push_slack[k, leg, c] * work.push_dual[k, leg, c]
                step = inside[c] - s
                work.push_slack[k, leg, c] = step
                work.push_dual[k, leg, c] = (target - s * dual - dual * step) / s


@kernel
def _longest(problem: RiccatiProblem, work: RiccatiWorkspace) -> float:
    """The longest step, up to 1, that keeps slacks and duals positive."""
    step = 1.0
    for k in range(problem.legs.shape[0]):
        for leg in range(problem.legs[k]):
            for c in range(CONES):
                ds, dd = work.push_slack[k, leg, c], work.push_dual[k, leg, c]
                if ds < 0.0:
                    step = min(step, -work.slack[k, leg, c] / ds)
                if dd < 0.0:
                    step = min(step, -work.dual[k, leg, c] / dd)
    return step


@kernel
def _gap(problem: RiccatiProblem, work: RiccatiWorkspace, step: float) -> float:
    """Mean complementarity after a step of this length."""
    total, count = 0.0, 0
    for k in range(problem.legs.shape[0]):
        for leg in range(problem.legs[k]):
            for c in range(CONES):
                s = work.slack[k, leg, c] + step * work.push_slack[k, leg, c]
                total += s * (work.dual[k, leg, c] + step * work.push_dual[k, leg, c])
                count += 1
    return total / max(count, 1)


@kernel
def value(problem: RiccatiProblem, forces: Array) -> float:
    """The cost of forces (n, 12), cones apart."""
    x, following = problem.start.copy(), np.empty(12)
    total = 0.0
    n = problem.legs.shape[0]
    for k in range(n):
        advance(problem, k, x, forces[k], following)
        x[:] = following
        share, row = (1.0, 1) if k == n - 1 else (problem.share[k], 0)
        for i in range(12):
            total += 0.5 * share * problem.weights[row, i] * x[i] * x[i]
        for j in range(3 * problem.legs[k]):
            off = forces[k, j] - problem.nominal[k, j]
            total += 0.5 * problem.share[k] * problem.effort * off * off
    return total


@kernel
def begin(problem: RiccatiProblem, work: RiccatiWorkspace, gap: float) -> None:
    """Make slacks and duals from the forces in ``work``: from a guess of another problem, or from the nominal ones.

    ``gap`` is their complementarity for costs up to 100; a body that falls costs thousands, and so do its duals.
    """
    inside = np.empty(CONES)
    gap *= max(1.0, 0.01 * value(problem, work.forces))
    for k in range(problem.legs.shape[0]):
        for leg in range(problem.legs[k]):
            force = work.forces[k, 3 * leg : 3 * leg + 3]
            cone(problem.friction, problem.least[k], problem.most, force, inside)
            for c in range(CONES):
                work.slack[k, leg, c] = max(inside[c], np.sqrt(gap))
                work.dual[k, leg, c] = gap / work.slack[k, leg, c]


@kernel
def solve(problem: RiccatiProblem, work: RiccatiWorkspace, tolerance: float) -> int:
    """Solve from the iterate in ``work``, which is left at the optimum; ``tolerance`` is for costs up to 100.

    Returns:
        the number of iterations; negative where the problem was not solved.
    """
    n = problem.legs.shape[0]
    work.push_slack[:], work.push_dual[:] = 0.0, 0.0
    untouched = 1.0  # what is left of the first iterate's dual infeasibility
    for iteration in range(ITERATIONS):
        gap = _gap(problem, work, 0.0)
        if not _factorise(problem, work):
            return -iteration - 1
        _solve(problem, work, 0.0, False)
        step = _longest(problem, work)
        aimed = _gap(problem, work, step)
        ratio = aimed / max(gap, 1e-300)
        _solve(problem, work, ratio * ratio * ratio * gap, True)
        step = min(1.0, _STEP * _longest(problem, work))
        violated = 0.0
        for k in range(n):
            for j in range(3 * problem.legs[k]):
                work.forces[k, j] += step * (work.aim_forces[k, j] - work.forces[k, j])
            for j in range(12):
                work.states[k + 1, j] += step * (work.aim_states[k + 1, j] - work.states[k + 1, j])
            for leg in range(problem.legs[k]):
                for c in range(CONES):
                    violated = max(violated, (1.0 - step) * abs(work.push_slack[k, leg, c]))
                    work.slack[k, leg, c] += step * work.push_slack[k, leg, c]
                    work.dual[k, leg, c] += step * work.push_dual[k, leg, c]
        untouched *= 1.0 - step
        gap = _gap(problem, work, 0.0)
        if not np.isfinite(gap):
            return -iteration - 1
        if untouched < 1e-4 and gap < tolerance * max(1.0, 0.01 * value(problem, work.forces)):
            return iteration + 1
    return -ITERATIONS - 1
