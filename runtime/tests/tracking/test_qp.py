from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from legtool_runtime.tracking.qp import Program, make_program, make_room, solve

UNKNOWNS, ROWS = 24, 28


def program_of(
    hessian: np.ndarray, gradient: np.ndarray, rows: np.ndarray, low: np.ndarray, high: np.ndarray
) -> Program:
    n, m = len(gradient), len(rows)
    program = make_program(UNKNOWNS, ROWS)
    program.hessian[:n, :n] = np.triu(hessian)
    program.gradient[:n] = gradient
    program.rows[:m, :n] = rows
    program.spans[:m, 1] = n
    program.low[: n + m], program.high[: n + m] = low, high
    return program


def random_program(rng: np.random.Generator) -> tuple[Program, int, int]:
    """Tasks of very different weight, and bounds around a point so that there is an answer."""
    n, m = int(rng.integers(3, UNKNOWNS + 1)), int(rng.integers(0, ROWS + 1))
    tasks = rng.normal(size=(n, n)) * 10 ** rng.uniform(-1, 1.5, size=(n, 1))
    rows, inside = rng.normal(size=(m, n)), rng.normal(size=n)
    value = np.concatenate([inside, rows @ inside])
    low, high = value - rng.exponential(size=n + m), value + rng.exponential(size=n + m)
    low[rng.random(n + m) < 0.5], high[rng.random(n + m) < 0.5] = -np.inf, np.inf
    return (
        program_of(tasks.T @ tasks + 1e-4 * np.eye(n), 10 * tasks.T @ rng.normal(size=n), rows, low, high), n, m
    )  # fmt: skip


def answer(program: Program, n: int, m: int) -> tuple[int, np.ndarray]:
    out = np.full(UNKNOWNS, np.nan)
    return solve(program, n, m, make_room(UNKNOWNS, ROWS), out), out[:n]


def objective(program: Program, z: np.ndarray) -> float:
    n = len(z)
    upper = np.triu(program.hessian[:n, :n])
    hessian = upper + upper.T - np.diag(np.diag(upper))
    return float(0.5 * z @ hessian @ z + program.gradient[:n] @ z)


def test_random_programs_are_solved_within_their_bounds() -> None:
    rng = np.random.default_rng(0)
    taken = []
    for _ in range(300):
        program, n, m = random_program(rng)
        iterations, z = answer(program, n, m)
        assert iterations > 0
        taken.append(iterations)
        value = np.concatenate([z, program.rows[:m, :n] @ z])
        assert (value >= program.low[: n + m] - 1e-6).all() and (value <= program.high[: n + m] + 1e-6).all()
    assert np.median(taken) <= 12


def by_least_distance(program: Program, n: int, m: int) -> np.ndarray:
    """The answer by SciPy's non-negative least squares (Lawson and Hanson, Solving Least Squares Problems, 23.27)."""
    upper = np.triu(program.hessian[:n, :n])
    root = np.linalg.cholesky(upper + upper.T - np.diag(np.diag(upper))).T
    sides, bounds = [], []
    for bound, sign in ((program.low, 1.0), (program.high, -1.0)):
        given = np.isfinite(bound[: n + m])
        sides.append(sign * np.vstack([np.eye(n), program.rows[:m, :n]])[given])
        bounds.append(sign * bound[: n + m][given])
    # Distances x = U z + U⁻ᵀ g from the minimum without bounds; least |x| with G x ≥ h.
    sides_of_x = solve_triangular(root, np.vstack(sides).T, trans=1).T
    shift = solve_triangular(root, program.gradient[:n], trans=1)
    reached = np.concatenate(bounds) + sides_of_x @ shift
    scale = np.linalg.norm(sides_of_x, axis=1)
    table = np.vstack([(sides_of_x / scale[:, None]).T, reached / scale])
    weights, _ = nnls(table, np.append(np.zeros(n), 1.0), maxiter=5000)
    residual = table @ weights - np.append(np.zeros(n), 1.0)
    return np.asarray(solve_triangular(root, -residual[:n] / residual[n] - shift))


def test_objective_is_that_of_scipy() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        program, n, m = random_program(rng)
        iterations, z = answer(program, n, m)
        assert iterations > 0
        expected = objective(program, by_least_distance(program, n, m))
        assert abs(objective(program, z) - expected) <= 1e-6 * (1 + abs(expected))


def test_without_bounds_it_is_a_linear_system() -> None:
    hessian, gradient = np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([1.0, -3.0])
    free = np.full(2, np.inf)
    iterations, z = answer(program_of(hessian, gradient, np.zeros((0, 2)), -free, free), 2, 0)
    assert iterations == 1
    np.testing.assert_allclose(z, np.linalg.solve(hessian, -gradient), atol=1e-9)


def test_soft_bound_gives_way_by_what_it_costs() -> None:
    # ½ (z - 3)² + v² / (2γ) with v = z - 1 over the bound: z = (3γ + 1) / (γ + 1).
    program = program_of(np.eye(1), np.array([-3.0]), np.zeros((0, 1)), np.array([-np.inf]), np.array([1.0]))
    program.give[0] = 0.25
    iterations, z = answer(program, 1, 0)
    assert iterations > 0
    assert np.isclose(z[0], 1.75 / 1.25, atol=1e-7)


def test_soft_bounds_make_contradictions_solvable() -> None:
    low, high = np.array([1.0, -np.inf]), np.array([np.inf, 0.0])
    program = program_of(1e-6 * np.eye(1), np.zeros(1), np.ones((1, 1)), low, high)
    assert answer(program, 1, 1)[0] == 0
    program.give[:2] = 1e-3
    iterations, z = answer(program, 1, 1)
    assert iterations > 0
    assert np.isclose(z[0], 0.5, atol=1e-6)


@pytest.mark.parametrize("broken", ["infeasible", "not convex", "nan", "infinite", "equal", "crossed"])
def test_what_has_no_answer_says_so_and_writes_nothing(broken: str) -> None:
    hessian, gradient, rows = np.eye(2), np.zeros(2), np.ones((1, 2))
    low, high = np.array([-1.0, -1.0, -np.inf]), np.array([1.0, 1.0, np.inf])
    if broken == "infeasible":
        low[2] = 3.0
    elif broken == "not convex":
        hessian[1, 1] = -1.0
    elif broken == "nan":
        gradient[0] = np.nan
    elif broken == "infinite":
        rows[0, 0] = np.inf
        low[2] = 0.0
    elif broken == "equal":
        low[0] = high[0] = 0.5
    else:
        low[0], high[0] = 1.0, -1.0
    iterations, z = answer(program_of(hessian, gradient, rows, low, high), 2, 1)
    assert iterations == 0
    assert np.isnan(z).all()


def test_room_of_a_larger_program_leaves_no_trace() -> None:
    rng = np.random.default_rng(2)
    room, out = make_room(UNKNOWNS, ROWS), np.zeros(UNKNOWNS)
    for _ in range(20):
        program, n, m = random_program(rng)
        solve(program, n, m, room, out)
        iterations, z = answer(program, n, m)
        assert iterations > 0
        np.testing.assert_array_equal(out[:n], z)
