"""One pass of the swing problem's solver: equalities are eliminated, a Riccati recursion gives the step.

At each knot the positions of all feet at the next one are linear in the joint rates, by a matrix (12, 12) that has an
inverse as long as no leg is singular. With it the rates of the joints follow from state, forces, and those coordinates
of feet that are free: the equalities are met to first order, whatever the recursion chooses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.search.swings.cost import STEP_S
from legtool_runtime.search.swings.problem import FREE, SwingProblem, Workspace

Array = NDArray[np.float64]


@kernel
def _pivot(matrix: Array, right: Array, c: int, columns: int) -> bool:
    """Bring the largest entry of column ``c`` to its diagonal; whether it is large enough to divide by."""
    pivot = c
    for r in range(c + 1, matrix.shape[0]):
        if abs(matrix[r, c]) > abs(matrix[pivot, c]):
            pivot = r
    if not abs(matrix[pivot, c]) > 1e-9:
        return False
    if pivot != c:
        for j in range(c, matrix.shape[0]):
            matrix[c, j], matrix[pivot, j] = matrix[pivot, j], matrix[c, j]
        for j in range(columns):
            right[c, j], right[pivot, j] = right[pivot, j], right[c, j]
    return True


@kernel
def _take(row: Array, other: Array, factor: float, first: int, last: int) -> None:
    """Take ``factor`` times another row from a row, from its first to before its last entry."""
    for j in range(first, last):
        row[j] -= factor * other[j]


@kernel
def solve_in_place(matrix: Array, right: Array, columns: int) -> bool:
    """Write ``matrix``⁻¹ times ``right`` into it, by elimination with pivots; whether the matrix has an inverse."""
    n = matrix.shape[0]
    for c in range(n):
        if not _pivot(matrix, right, c, columns):
            return False
        for r in range(c + 1, n):
            factor = matrix[r, c] / matrix[c, c]
            if factor != 0.0:
                _take(matrix[r], matrix[c], factor, c + 1, n)
                _take(right[r], right[c], factor, 0, columns)
    for c in range(n - 1, -1, -1):
        for j in range(columns):
            right[c, j] /= matrix[c, c]
        for r in range(c):
            if matrix[r, c] != 0.0:
                _take(right[r], right[c], matrix[r, c], 0, columns)
    return True


@kernel
def _equations(problem: SwingProblem, work: Workspace, k: int, across: int, free: int) -> None:
    """Write the equations for the joint rates: by the state (24 columns), by what is free, and what is given."""
    matrix, right = work.matrix, work.right
    slope, a, b = work.feet_slope[k + 1], work.slope_x[k], work.slope_u[k]
    matrix[:], right[:] = 0.0, 0.0
    for r in range(12):
        right[r, 24 + free] = problem.target[k + 1, r // 3, r % 3] - work.feet[k + 1, r // 3, r % 3]
        for i in range(6, 24):
            value = slope[r, i]
            if value == 0.0:
                continue
            right[r, 24 + free] -= value * work.gap[k, i]
            _take(right[r], a[i], value, 0, 24)
            for j in range(12):
                matrix[r, j] += value * b[i, 12 + j]
            column = 24
            for leg in range(4):
                if problem.standing[k, leg]:
                    for j in range(3):
                        right[r, column + j] -= value * b[i, 3 * leg + j]
                    column += 3
    for leg in range(4):
        if not problem.fixed[k, leg]:
            right[3 * leg, 24 + across] = 1.0
            right[3 * leg + 1, 24 + across + 1] = 1.0
            across += 2


@kernel
def eliminate(problem: SwingProblem, work: Workspace, k: int) -> bool:
    """Write rates and dynamics of knot k as functions of the state and of what is free; whether they exist."""
    across, free = 0, 0
    for leg in range(4):
        across += 3 * problem.standing[k, leg]
        free += 3 * problem.standing[k, leg] + (0 if problem.fixed[k, leg] else 2)
    _equations(problem, work, k, across, free)
    if not solve_in_place(work.matrix, work.right, 24 + free + 1):
        return False
    work.free[k] = free
    for r in range(12):
        for j in range(24):
            work.rate_x[k, r, j] = work.right[r, j]
        for j in range(free):
            work.rate_u[k, r, j] = work.right[r, 24 + j]
        work.rate_0[k, r] = work.right[r, 24 + free]
    _dynamics(problem, work, k, free)
    return True


@kernel
def _dynamics(problem: SwingProblem, work: Workspace, k: int, free: int) -> None:
    """Write the dynamics of knot k with the rates put in."""
    a, b = work.slope_x[k], work.slope_u[k]
    next_x, next_u, next_0 = work.next_x[k], work.next_u[k], work.next_0[k]
    for i in range(24):
        for j in range(24):
            next_x[i, j] = a[i, j]
        for j in range(free):
            next_u[i, j] = 0.0
        next_0[i] = work.gap[k, i]
    column = 0
    for leg in range(4):
        if problem.standing[k, leg]:
            for i in range(12):
                for j in range(3):
                    next_u[i, column + j] = b[i, 3 * leg + j]
            column += 3
    for i in range(9, 24):
        for r in range(12):
            value = b[i, 12 + r]
            if value == 0.0:
                continue
            for j in range(24):
                next_x[i, j] += value * work.rate_x[k, r, j]
            for j in range(free):
                next_u[i, j] += value * work.rate_u[k, r, j]
            next_0[i] += value * work.rate_0[k, r]


@kernel
def _add_wide(left: Array, right: Array, rows: int, out: Array) -> None:
    """Add leftᵀ right to ``out`` (rows, 24); zeros on the left are passed over."""
    for l in range(left.shape[0]):
        for i in range(rows):
            value = left[l, i]
            if value != 0.0:
                for j in range(24):
                    out[i, j] += value * right[l, j]


@kernel
def _add_product(left: Array, right: Array, rows: int, columns: int, out: Array) -> None:
    """Add leftᵀ right to ``out`` (rows, columns); zeros on the left are passed over."""
    for l in range(left.shape[0]):
        for i in range(rows):
            value = left[l, i]
            if value != 0.0:
                for j in range(columns):
                    out[i, j] += value * right[l, j]


@kernel
def _input_model(
    problem: SwingProblem, work: Workspace, k: int, heavy: Array, cross_terms: Array, slope: Array
) -> None:
    """Write weights of the free inputs (m, m), their product with the state (m, 24), and their slope (m,)."""
    free = work.free[k]
    heavy[:free], cross_terms[:free], slope[:free] = 0.0, 0.0, 0.0
    column = 0
    for leg in range(4):
        if problem.standing[k, leg]:
            for i in range(3):
                slope[column + i] = work.pull_u[k, 3 * leg + i]
                for j in range(3):
                    heavy[column + i, column + j] = work.cost_force[k, leg, i, j]
            column += 3
    for i in range(column, free):
        heavy[i, i] = problem.foot * problem.step_s[k] / STEP_S
    for r in range(12):
        weight = work.cost_rate[k, r]
        pull = work.pull_u[k, 12 + r] + weight * work.rate_0[k, r]
        for i in range(free):
            value = work.rate_u[k, r, i]
            slope[i] += value * pull
            for j in range(free):
                heavy[i, j] += weight * value * work.rate_u[k, r, j]
            for j in range(24):
                cross_terms[i, j] += weight * value * work.rate_x[k, r, j]


@kernel
def _factor(matrix: Array, n: int) -> bool:
    """Write the lower Cholesky factor in place; whether the matrix is positive."""
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for l in range(j):
                total -= matrix[i, l] * matrix[j, l]
            if i == j:
                if not total > 1e-12:
                    return False
                matrix[i, i] = np.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    return True


@kernel
def _back_substitute(factor: Array, wide: Array, single: Array, n: int) -> None:
    """Write (L Lᵀ)⁻¹ times ``wide`` (n, 24) and ``single`` (n,) into them."""
    for i in range(n):
        for l in range(i):
            value = factor[i, l]
            single[i] -= value * single[l]
            for j in range(24):
                wide[i, j] -= value * wide[l, j]
        inverse = 1.0 / factor[i, i]
        single[i] *= inverse
        for j in range(24):
            wide[i, j] *= inverse
    for i in range(n - 1, -1, -1):
        for l in range(i + 1, n):
            value = factor[l, i]
            single[i] -= value * single[l]
            for j in range(24):
                wide[i, j] -= value * wide[l, j]
        inverse = 1.0 / factor[i, i]
        single[i] *= inverse
        for j in range(24):
            wide[i, j] *= inverse


@kernel
def _state_model(work: Workspace, k: int, ahead: Array, ahead_0: Array, before: Array, pull: Array) -> None:
    """Write weights (24, 24) and slope (24,) of the state at knot k as they are if nothing that is free moves."""
    before[:] = 0.0
    _add_wide(work.next_x[k], ahead, 24, before)
    for i in range(24):
        pull[i] = work.pull_x[k, i]
        before[i, i] += work.cost_x[k, i]
        for j in range(24):
            pull[i] += work.next_x[k, j, i] * ahead_0[j]
    for r in range(12):
        weight = work.cost_rate[k, r]
        own = work.pull_u[k, 12 + r] + weight * work.rate_0[k, r]
        for i in range(24):
            rate = work.rate_x[k, r, i]
            pull[i] += rate * own
            _take(before[i], work.rate_x[k, r], -weight * rate, 0, 24)


@kernel
def _answer(work: Workspace, k: int, heavy: Array, mixed: Array, slope: Array, before: Array, pull: Array) -> bool:
    """Write how what is free answers the state, and take what it saves from weights and slope; whether it can."""
    free, gain, offset = work.free[k], work.gain[k], work.offset[k]
    if not _factor(heavy, free):
        return False
    for i in range(free):
        for j in range(24):
            gain[i, j] = mixed[i, j]
    _back_substitute(heavy, mixed, slope, free)
    for l in range(free):
        offset[l] = -slope[l]
        for i in range(24):
            product = gain[l, i]
            pull[i] += product * offset[l]
            _take(before[i], mixed[l], product, 0, 24)
    for l in range(free):
        for j in range(24):
            gain[l, j] = -mixed[l, j]
    return True


@kernel
def backward(problem: SwingProblem, work: Workspace) -> bool:
    """Write gains and offsets of all knots; whether the problem is convex enough to have them."""
    n = problem.step_s.shape[0]
    value, ahead, pull = np.zeros((24, 24)), np.empty((24, 24)), work.pull_x[n].copy()
    heavy, mixed, slope = np.empty((FREE, FREE)), np.empty((FREE, 24)), np.empty(FREE)
    ahead_u, ahead_0, before = np.empty((24, FREE)), np.empty(24), np.empty((24, 24))
    for i in range(24):
        value[i, i] = work.cost_x[n, i]
        for j in range(9):
            value[i, j] += problem.steer[i] * problem.steer[j]
    for k in range(n - 1, -1, -1):
        free, next_u = work.free[k], work.next_u[k]
        ahead[:], ahead_u[:] = 0.0, 0.0
        _add_wide(value, work.next_x[k], 24, ahead)
        _add_product(value, next_u, 24, free, ahead_u)
        for i in range(24):
            ahead_0[i] = pull[i]
            for j in range(24):
                ahead_0[i] += value[i, j] * work.next_0[k, j]
        _input_model(problem, work, k, heavy, mixed, slope)
        _add_product(next_u, ahead_u, free, free, heavy)
        _add_wide(next_u, ahead, free, mixed)
        for i in range(free):
            for j in range(24):
                slope[i] += next_u[j, i] * ahead_0[j]
        _state_model(work, k, ahead, ahead_0, before, pull)
        if not _answer(work, k, heavy, mixed, slope, before, pull):
            return False
        for i in range(24):
            for j in range(24):
                value[i, j] = 0.5 * (before[i, j] + before[j, i])
    return True


@kernel
def forward(problem: SwingProblem, work: Workspace) -> None:
    """Write the full step of states and inputs."""
    free_move = np.empty(FREE)
    work.move_x[0] = 0.0
    for k in range(problem.step_s.shape[0]):
        x, after, u, free = work.move_x[k], work.move_x[k + 1], work.move_u[k], work.free[k]
        for i in range(free):
            free_move[i] = work.offset[k, i]
            for j in range(24):
                free_move[i] += work.gain[k, i, j] * x[j]
        column = 0
        for leg in range(4):
            for i in range(3):
                u[3 * leg + i] = free_move[column + i] if problem.standing[k, leg] else 0.0
            column += 3 * problem.standing[k, leg]
        for r in range(12):
            u[12 + r] = work.rate_0[k, r]
            for j in range(24):
                u[12 + r] += work.rate_x[k, r, j] * x[j]
            for j in range(free):
                u[12 + r] += work.rate_u[k, r, j] * free_move[j]
        for i in range(24):
            after[i] = work.next_0[k, i]
            for j in range(24):
                after[i] += work.next_x[k, i, j] * x[j]
            for j in range(free):
                after[i] += work.next_u[k, i, j] * free_move[j]
