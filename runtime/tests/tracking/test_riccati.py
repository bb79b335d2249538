"""The interior point method against an active set method on the dense problem."""

import numpy as np
import pytest
from scipy.optimize import nnls

from legtool_runtime.tracking import riccati


def random_problem(rng, nodes):
    legs = rng.integers(1, 5, nodes)
    mass, size = rng.uniform(10, 90), rng.uniform(0.3, 0.6)
    wrench, shift = np.zeros((nodes, 6, 12)), np.zeros((nodes, 3, 3))
    inverse = np.linalg.inv(mass * size**2 * np.diag(rng.uniform(0.1, 0.4, 3)))
    nominal = np.zeros((nodes, 12))
    for k in range(nodes):
        shift[k] = inverse @ np.array([[0, -9.81, 0], [9.81, 0, 0], [0, 0, 0]]) * mass
        for leg in range(legs[k]):
            axes = np.linalg.qr(np.eye(3) + 0.3 * rng.normal(size=(3, 3)))[0]
            axes[:, 2] *= np.sign(axes[2, 2])
            arm = rng.normal(size=3) * [0.4, 0.3, 0.1] - [0, 0, size]
            block = slice(3 * leg, 3 * leg + 3)
            wrench[k, :3, block] = 9.81 * axes
            wrench[k, 3:, block] = mass * 9.81 * inverse @ np.cross(arm, axes.T).T
            nominal[k, block] = axes.T @ [0, 0, 1 / legs[k]]
    drift = rng.normal(size=(nodes, 12)) * 0.01
    drift[:, 2] -= 0.5 * 0.05**2 * 9.81
    drift[:, 5] -= 0.05 * 9.81
    weights = 2 * np.tile([10, 10, 200, 4, 4, 10, 200, 200, 200, 4, 4, 4.0], (2, 1)) * rng.uniform(0.5, 2, (2, 12))
    start = rng.normal(size=12) * np.repeat([0.05, 0.3, 0.1, 0.4], 3)
    share = rng.uniform(0.2, 1.0, nodes)
    return riccati.RiccatiProblem(
        0.05 * share, share, start, legs, wrench, shift, drift, nominal, weights, 0.04, rng.uniform(0.3, 0.8),
        np.where(legs >= 3, 0.1, 0.15), 2.0,
    )  # fmt: skip


def dense(problem):
    """H, q of ½ uᵀHu + qᵀu + c and G, h of Gu ≥ h, by plain matrices."""
    n = len(problem.legs)
    columns = [3 * int(legs) for legs in problem.legs]
    total = sum(columns)
    x, free = np.zeros((12, total)), problem.start.copy()
    hessian, slope, constant = np.zeros((total, total)), np.zeros(total), 0.0
    rows, limits, at = [], [], 0
    for k in range(n):
        dt, share = problem.node_s[k], problem.share[k]
        a0 = np.eye(12)
        a0[0:3, 3:6] = a0[6:9, 9:12] = dt * np.eye(3)
        m = np.zeros((12, 6))
        m[0:3, 0:3] = m[6:9, 3:6] = 0.5 * dt * dt * np.eye(3)
        m[3:6, 0:3] = m[9:12, 3:6] = dt * np.eye(3)
        f = np.zeros((6, 12))
        f[3:, :3] = problem.shift[k]
        a = a0 + m @ f
        b = np.zeros((12, total))
        b[:, at : at + columns[k]] = m @ problem.wrench[k][:, : columns[k]]
        x, free = a @ x + b, a @ free + problem.drift[k]
        q = np.diag(problem.weights[1] if k == n - 1 else share * problem.weights[0])
        hessian += x.T @ q @ x
        slope += x.T @ q @ free
        constant += 0.5 * free @ q @ free
        for j in range(columns[k]):
            hessian[at + j, at + j] += share * problem.effort
            slope[at + j] -= share * problem.effort * problem.nominal[k, j]
            constant += 0.5 * share * problem.effort * problem.nominal[k, j] ** 2
        for leg in range(problem.legs[k]):
            for t1, t2, nn, h in [
                (-1, 0, problem.friction, 0), (1, 0, problem.friction, 0), (0, -1, problem.friction, 0),
                (0, 1, problem.friction, 0), (0, 0, 1, problem.least[k]), (0, 0, -1, -problem.most),
            ]:  # fmt: skip
                row = np.zeros(total)
                row[at + 3 * leg : at + 3 * leg + 3] = t1, t2, nn
                rows.append(row)
                limits.append(h)
        at += columns[k]
    return hessian, slope, constant, np.array(rows), np.array(limits)


def active_set(hessian, slope, constant, rows, limits):
    """The optimum by Lawson and Hanson's least distance programming (1974, chapter 23)."""
    lower = np.linalg.cholesky(hessian)
    centre = -np.linalg.solve(hessian, slope)
    g = np.linalg.solve(lower, rows.T).T
    h = limits - rows @ centre
    target = np.zeros(g.shape[1] + 1)
    target[-1] = 1.0
    stacked = np.vstack([g.T, h[None]])
    dual, _ = nnls(stacked, target, maxiter=100 * stacked.shape[1])
    residual = stacked @ dual - target
    z = -residual[:-1] / residual[-1]
    u = centre + np.linalg.solve(lower.T, z)
    return u, 0.5 * u @ hessian @ u + slope @ u + constant


@pytest.mark.parametrize("seed", range(12))
def test_the_optimum_is_that_of_an_active_set_method(seed):
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, int(rng.integers(2, 7)))
    expected, value = active_set(*dense(problem))
    work = riccati.workspace(len(problem.legs))
    work.forces[:] = problem.nominal
    riccati.begin(problem, work, 0.1)
    assert riccati.solve(problem, work, riccati.TOLERANCE) > 0
    found = np.concatenate([row[: 3 * legs] for row, legs in zip(work.forces, problem.legs, strict=True)])
    assert riccati.value(problem, work.forces) == pytest.approx(value, rel=1e-6, abs=1e-6)
    assert np.abs(found - expected).max() < 1e-3
    inside = np.empty(6)
    for k in range(len(problem.legs)):
        for leg in range(problem.legs[k]):
            force = work.forces[k, 3 * leg : 3 * leg + 3]
            riccati.cone(problem.friction, problem.least[k], problem.most, force, inside)
            assert inside.min() > -1e-7


def test_a_horizon_with_flight_is_solved():
    problem = random_problem(np.random.default_rng(3), 6)
    legs = problem.legs.copy()
    legs[2:4] = 0
    problem = problem._replace(legs=legs)
    work = riccati.workspace(6)
    work.forces[:] = problem.nominal
    riccati.begin(problem, work, 0.1)
    assert riccati.solve(problem, work, riccati.TOLERANCE) > 0
