"""Dense convex quadratic programs of a few dozen unknowns, solved by a primal-dual interior point method.

    minimise ½ z'Hz + g'z   subject to   low ≤ (z, Gz) ≤ high

Bounds may be infinite; equal or nearly equal bounds have no interior and are refused. A bound may give way: with
``give`` γ > 0 its violation v costs v²/(2γ), which only adds γ to a diagonal below, and keeps the program feasible.

The method is Mehrotra's predictor-corrector (Nocedal and Wright, Numerical Optimization, algorithm 16.4) from an
infeasible start. Each finite bound is one side sᵢ(cᵢ'z - bᵢ) + γᵢλᵢ - wᵢ = 0 with slack wᵢ > 0 and multiplier λᵢ > 0;
eliminating both leaves H + C'DC with D = λ/(w + γλ), factored by Cholesky.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel

Array = NDArray[np.float64]

#: Iterations after which a program counts as unsolved. Programs of whole-body control take 6 to 12.
MAX_ITERATIONS = 40
#: Largest residual of the bounds, relative to 1 + |bound|; of the gradient, relative to 1 + the largest of the parts
#: that cancel in it; and largest duality gap, relative to 1 + |objective|.
PRIMAL_TOLERANCE = 1e-8
DUAL_TOLERANCE = 1e-8
GAP_TOLERANCE = 1e-8
#: Share of the way to the nearest wall that a step goes.
_STEP = 0.995
#: Least slack at the start as a share of the worst violation, and multipliers there as a share of what the cost pulls
#: with across it; chosen for few iterations on the programs of whole-body control.
_INSIDE = 0.1
_PULL = 0.01
#: A gap narrower than this between two bounds, relative to their size, has no interior to speak of.
_NARROWEST = 1e-9
#: Rows of ``Room.sides``, one column for each finite bound.
_SIGN, _BOUND, _GIVE, _SLACK, _DUAL, _RESIDUAL, _TARGET, _SLACK_STEP, _DUAL_STEP, _WEIGHT = range(10)


class Program(NamedTuple):
    """A program with room for up to n unknowns and m rows; :func:`solve` is told how many are used.

    ``hessian`` (n, n), its upper triangle used; ``gradient`` (n,); ``rows`` (m, n); ``spans`` (m, 2) first column of
    each row that is not zero and the one after the last; ``low``, ``high``, ``give`` (n + m,): of the unknowns used
    first, then of the rows, without a gap between.
    """

    hessian: Array
    gradient: Array
    rows: Array
    spans: NDArray[np.int64]
    low: Array
    high: Array
    give: Array


class Room(NamedTuple):
    """What the solver works in; made once by :func:`make_room`."""

    factor: Array
    sides: Array
    bounded: NDArray[np.int64]
    values: Array
    vectors: Array


def make_program(unknowns: int, rows: int) -> Program:
    """An empty program: no cost, every row zero, nothing bounded."""
    both = unknowns + rows
    return Program(
        hessian=np.zeros((unknowns, unknowns)),
        gradient=np.zeros(unknowns),
        rows=np.zeros((rows, unknowns)),
        spans=np.tile(np.array([0, unknowns], dtype=np.int64), (rows, 1)),
        low=np.full(both, -np.inf),
        high=np.full(both, np.inf),
        give=np.zeros(both),
    )


def make_room(unknowns: int, rows: int) -> Room:
    """Room for programs of up to this size."""
    both = unknowns + rows
    return Room(
        factor=np.zeros((unknowns, unknowns)),
        sides=np.zeros((10, 2 * both)),
        bounded=np.zeros(2 * both, dtype=np.int64),
        values=np.zeros((2, both)),
        vectors=np.zeros((4, unknowns)),
    )


@kernel
def solve(program: Program, n: int, m: int, room: Room, out: Array) -> int:
    """Solve the program of the first ``n`` unknowns and ``m`` rows.

    Writes the unknowns into ``out`` (n,), only if they are a solution.

    Returns:
        The iterations it took; 0 if it is not solved: infeasible, not convex, not finite, or without an interior.
    """
    count = _sides(program, n + m, room)
    if count < 0:
        return 0
    sides = room.sides
    slack, dual = sides[_SLACK], sides[_DUAL]
    z, step = room.vectors[0], room.vectors[1]
    if not _start(program, n, m, count, room):
        return 0
    for iteration in range(1, MAX_ITERATIONS + 1):
        objective, dual_error, primal_error = _residuals(program, n, m, count, room)
        gap = 0.0
        for s in range(count):
            gap += slack[s] * dual[s]
        if not np.isfinite(objective + dual_error + primal_error + gap):
            return 0
        if (
            primal_error <= PRIMAL_TOLERANCE
            and dual_error <= DUAL_TOLERANCE
            and gap <= GAP_TOLERANCE * (1.0 + abs(objective))
        ):
            for i in range(n):
                out[i] = z[i]
            return iteration
        if not _factor_step(program, n, m, count, room):
            return 0
        mean = gap / max(count, 1)
        # Predictor: straight at complementarity.
        for s in range(count):
            sides[_TARGET, s] = slack[s] * dual[s]
        length = _direction(program, n, m, count, room)
        after = 0.0
        for s in range(count):
            after += (slack[s] + length * sides[_SLACK_STEP, s]) * (dual[s] + length * sides[_DUAL_STEP, s])
        centring = (after / gap) ** 3 * mean if gap > 0.0 else 0.0
        # Corrector: with what the predictor's linearisation left out, and back towards the centre.
        for s in range(count):
            second_order = sides[_SLACK_STEP, s] * sides[_DUAL_STEP, s]
            sides[_TARGET, s] = slack[s] * dual[s] + second_order - centring
        length = min(1.0, _STEP * _direction(program, n, m, count, room))
        for i in range(n):
            z[i] += length * step[i]
        for s in range(count):
            slack[s] += length * sides[_SLACK_STEP, s]
            dual[s] += length * sides[_DUAL_STEP, s]
    return 0


@kernel
def _sides(program: Program, total: int, room: Room) -> int:
    """List the finite bounds; their number, or -1 if two of them leave no room between."""
    sides, index = room.sides, room.bounded
    count = 0
    for i in range(total):
        low, high, give = program.low[i], program.high[i], program.give[i]
        if low == -np.inf and high == np.inf:
            continue
        if not high - low > _NARROWEST * (1.0 + min(abs(low), abs(high))) or not give >= 0.0:
            return -1
        if low > -np.inf:
            index[count], sides[_SIGN, count], sides[_BOUND, count], sides[_GIVE, count] = i, 1.0, low, give
            count += 1
        if high < np.inf:
            index[count], sides[_SIGN, count], sides[_BOUND, count], sides[_GIVE, count] = i, -1.0, high, give
            count += 1
    return count


@kernel
def _start(program: Program, n: int, m: int, count: int, room: Room) -> bool:
    """Begin at the minimum without bounds, slacks and multipliers well inside."""
    factor, sides, index = room.factor, room.sides, room.bounded
    z, value = room.vectors[0], room.values[0]
    for i in range(n):
        for j in range(i, n):
            factor[i, j] = program.hessian[i, j]
        z[i] = -program.gradient[i]
    if not _cholesky(factor, n):
        return False
    _solve_factored(factor, n, z)
    _evaluate(program, n, m, z, value)
    # Multipliers of the size of the pull that the bounds must balance.
    worst, pull = 0.0, 0.0
    for s in range(count):
        over = -sides[_SIGN, s] * (value[index[s]] - sides[_BOUND, s])
        worst = max(worst, over)
    for i in range(n):
        pull = max(pull, program.hessian[i, i])
    for s in range(count):
        inside = sides[_SIGN, s] * (value[index[s]] - sides[_BOUND, s])
        sides[_SLACK, s] = max(abs(inside), _INSIDE * max(1.0, worst))
        sides[_DUAL, s] = max(_PULL * worst * pull, 1e-3) / max(1.0, sides[_SLACK, s])
    return True


@kernel
def _evaluate(program: Program, n: int, m: int, z: Array, value: Array) -> None:
    """Write what is bounded, (z, Gz), into ``value`` (n + m,)."""
    for i in range(n):
        value[i] = z[i]
    for r in range(m):
        total = 0.0
        for i in range(program.spans[r, 0], program.spans[r, 1]):
            total += program.rows[r, i] * z[i]
        value[n + r] = total


@kernel
def _residuals(program: Program, n: int, m: int, count: int, room: Room) -> tuple[float, float, float]:
    """Write the gradient's residual into vectors[2], those of the sides into their row.

    Returns the objective, and the largest of both residuals, relative to what they are made of.
    """
    sides, index = room.sides, room.bounded
    z, right, value, push = room.vectors[0], room.vectors[2], room.values[0], room.values[1]
    _evaluate(program, n, m, z, value)
    for i in range(n + m):
        push[i] = 0.0
    primal, soft = 0.0, 0.0
    for s in range(count):
        i, sign, bound = index[s], sides[_SIGN, s], sides[_BOUND, s]
        residual = sign * (value[i] - bound) + sides[_GIVE, s] * sides[_DUAL, s] - sides[_SLACK, s]
        sides[_RESIDUAL, s] = residual
        primal = max(primal, abs(residual) / (1.0 + abs(bound)))
        push[i] += sign * sides[_DUAL, s]
        soft += 0.5 * sides[_GIVE, s] * sides[_DUAL, s] * sides[_DUAL, s]
    _hessian_times(program.hessian, n, z, right)
    objective = soft
    dual, scale = 0.0, 1.0
    for i in range(n):
        objective += z[i] * (0.5 * right[i] + program.gradient[i])
        scale = max(scale, abs(right[i]), abs(program.gradient[i]), abs(push[i]))
        right[i] += program.gradient[i] - push[i]
    for r in range(m):
        for i in range(program.spans[r, 0], program.spans[r, 1]):
            pull = program.rows[r, i] * push[n + r]
            scale = max(scale, abs(pull))
            right[i] -= pull
    for i in range(n):
        dual = max(dual, abs(right[i]))
    return objective, dual / scale, primal


@kernel
def _hessian_times(hessian: Array, n: int, z: Array, out: Array) -> None:
    """Write the product with a symmetric matrix of which the upper triangle is given."""
    for i in range(n):
        out[i] = 0.0
    for i in range(n):
        total = hessian[i, i] * z[i]
        for j in range(i + 1, n):
            total += hessian[i, j] * z[j]
            out[j] += hessian[i, j] * z[i]
        out[i] += total


@kernel
def _factor_step(program: Program, n: int, m: int, count: int, room: Room) -> bool:
    """Factor H + C'DC for the present slacks and multipliers."""
    sides, index, factor, weight = room.sides, room.bounded, room.factor, room.values[1]
    for i in range(n + m):
        weight[i] = 0.0
    for s in range(count):
        inverse = 1.0 / (sides[_SLACK, s] + sides[_GIVE, s] * sides[_DUAL, s])
        sides[_WEIGHT, s] = inverse
        weight[index[s]] += sides[_DUAL, s] * inverse
    for i in range(n):
        for j in range(i, n):
            factor[i, j] = program.hessian[i, j]
        factor[i, i] += weight[i]
    r = 0
    while r < m:
        r += _add_rows(program, n, m, r, weight, factor)
    return _cholesky(factor, n)


@kernel
def _add_rows(program: Program, n: int, m: int, r: int, weight: Array, factor: Array) -> int:
    """Add weight · row' row of the next rows to the upper triangle; how many: four of one span at once, else one."""
    spans = program.spans
    first, last = spans[r, 0], spans[r, 1]
    together = r + 3 < m
    for k in range(1, 4):
        together = together and spans[r + k, 0] == first and spans[r + k, 1] == last
    a = program.rows[r]
    if not together:
        for i in range(first, last):
            scaled = weight[n + r] * a[i]
            for j in range(i, last):
                factor[i, j] += scaled * a[j]
        return 1
    b, c, d = program.rows[r + 1], program.rows[r + 2], program.rows[r + 3]
    for i in range(first, last):
        at, bt = weight[n + r] * a[i], weight[n + r + 1] * b[i]
        ct, dt = weight[n + r + 2] * c[i], weight[n + r + 3] * d[i]
        for j in range(i, last):
            factor[i, j] += at * a[j] + bt * b[j] + ct * c[j] + dt * d[j]
    return 4


@kernel
def _direction(program: Program, n: int, m: int, count: int, room: Room) -> float:
    """Write the steps that bring all residuals to zero and slack × multiplier to its target; the way to the wall."""
    sides, index = room.sides, room.bounded
    step, right, value, push = room.vectors[1], room.vectors[2], room.values[0], room.values[1]
    slack, dual = sides[_SLACK], sides[_DUAL]
    for i in range(n + m):
        push[i] = 0.0
    for s in range(count):
        pull = (sides[_TARGET, s] + dual[s] * sides[_RESIDUAL, s]) * sides[_WEIGHT, s]
        push[index[s]] += sides[_SIGN, s] * pull
    for i in range(n):
        step[i] = -right[i] - push[i]
    for r in range(m):
        for i in range(program.spans[r, 0], program.spans[r, 1]):
            step[i] -= program.rows[r, i] * push[n + r]
    _solve_factored(room.factor, n, step)
    _evaluate(program, n, m, step, value)
    # The largest share, at least 1 being far enough.
    shrink = 0.0
    for s in range(count):
        moved = sides[_SIGN, s] * value[index[s]] + sides[_RESIDUAL, s]
        change = -(sides[_TARGET, s] + dual[s] * moved) * sides[_WEIGHT, s]
        sides[_DUAL_STEP, s] = change
        sides[_SLACK_STEP, s] = moved + sides[_GIVE, s] * change
        shrink = max(shrink, max(-change / dual[s], -sides[_SLACK_STEP, s] / slack[s]))
    return 1.0 / max(shrink, 1e-3)


@kernel
def _cholesky(upper: Array, n: int) -> bool:
    """Factor U'U in place of the upper triangle, its diagonal inverted; False if the matrix is not positive."""
    for k in range(n):
        pivot = upper[k, k]
        if not pivot > 0.0 or pivot == np.inf:
            return False
        inverse = 1.0 / np.sqrt(pivot)
        upper[k, k] = inverse
        for j in range(k + 1, n):
            upper[k, j] *= inverse
        for i in range(k + 1, n):
            scaled = upper[k, i]
            for j in range(i, n):
                upper[i, j] -= scaled * upper[k, j]
    return True


@kernel
def _solve_factored(upper: Array, n: int, x: Array) -> None:
    """Solve U'U x = b in place, for a factor of :func:`_cholesky`."""
    for k in range(n):
        x[k] *= upper[k, k]
        value = x[k]
        for j in range(k + 1, n):
            x[j] -= upper[k, j] * value
    for k in range(n - 1, -1, -1):
        value = x[k]
        for j in range(k + 1, n):
            value -= upper[k, j] * x[j]
        x[k] = value * upper[k, k]
