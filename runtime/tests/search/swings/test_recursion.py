"""The step of a pass against a dense solution of the same quadratic program."""

from __future__ import annotations

import numpy as np

from legtool_runtime.search.swings import optimiser as optimiser_module
from legtool_runtime.search.swings.optimiser import SwingOptimiser
from legtool_runtime.search.swings.problem import SwingProblem, Workspace
from legtool_runtime.search.swings.recursion import backward, eliminate, forward
from legtool_runtime.search.swings.solver import evaluate, linearise
from legtool_runtime.tracking.model import TrackedRobot


def dense_step(problem: SwingProblem, work: Workspace) -> np.ndarray:
    """Moves of states 1 to n and inputs 0 to n - 1, flat, by the whole system of optimality conditions."""
    n = len(problem.step_s)
    size = 24 * n
    x_at, u_at = (lambda k: slice(24 * (k - 1), 24 * k)), (lambda k: slice(size + 24 * k, size + 24 * (k + 1)))
    cost, pull = np.zeros((2 * size, 2 * size)), np.zeros(2 * size)
    rows, right = [], []
    for k in range(1, n + 1):
        cost[x_at(k), x_at(k)] = np.diag(work.cost_x[k])
        pull[x_at(k)] = work.pull_x[k]
    cost[x_at(n), x_at(n)] += np.outer(problem.steer, problem.steer)
    for k in range(n):
        a, b = np.zeros((24, 2 * size)), work.slope_u[k]
        heavy = np.diag(np.concatenate([np.zeros(12), work.cost_rate[k]]))
        for leg in range(4):
            heavy[3 * leg : 3 * leg + 3, 3 * leg : 3 * leg + 3] = work.cost_force[k, leg]
        cost[u_at(k), u_at(k)], pull[u_at(k)] = heavy, work.pull_u[k]
        a[:, x_at(k + 1)], a[:, u_at(k)] = np.eye(24), -b
        if k > 0:
            a[:, x_at(k)] = -work.slope_x[k]
        rows.append(a)
        right.append(work.gap[k])
        for leg in range(4):
            off = work.feet[k + 1, leg] - problem.target[k + 1, leg]
            slope = work.feet_slope[k + 1, 3 * leg : 3 * leg + 3]
            kept = [0, 1, 2] if problem.fixed[k, leg] else [2]
            row = np.zeros((len(kept), 2 * size))
            row[:, x_at(k + 1)] = slope[kept]
            rows.append(row)
            right.append(-off[kept])
            if not problem.fixed[k, leg]:
                weight = problem.foot * problem.step_s[k] / 0.02
                for i in range(2):
                    cost[x_at(k + 1), x_at(k + 1)] += weight * np.outer(slope[i], slope[i])
                    pull[x_at(k + 1)] += weight * off[i] * slope[i]
            if not problem.standing[k, leg]:
                row = np.zeros((3, 2 * size))
                row[:, u_at(k)][:, 3 * leg : 3 * leg + 3] = np.eye(3)
                rows.append(row)
                right.append(np.zeros(3))
    equalities = np.concatenate(rows)
    m = len(equalities)
    system = np.block([[cost, equalities.T], [equalities, np.zeros((m, m))]])
    return np.linalg.solve(system, np.concatenate([-pull, *right]))[: 2 * size]


def test_a_pass_is_the_solution_of_its_quadratic_program(walker: TrackedRobot, trot, monkeypatch) -> None:
    caught = {}

    def keep(model, problem, work, passes, converged):
        caught["problem"] = problem
        return real(model, problem, work, passes, converged)

    real = optimiser_module.solve
    monkeypatch.setattr(optimiser_module, "solve", keep)
    one = SwingOptimiser(walker)
    one.optimise(trot(), start_s=0.62)  # in mid-swing: landing, full stance
    problem, work, model = caught["problem"], one._work, walker.model()
    assert work is not None
    n = len(problem.step_s)
    assert set(problem.standing.sum(axis=1)) == {2, 4}
    rng = np.random.default_rng(0)
    work.states[1 : n + 1, :9] += 0.01 * rng.normal(size=(n, 9))
    work.states[1 : n + 1, 12:] += 0.02 * rng.normal(size=(n, 12))
    work.inputs[:n] += (
        0.1
        * rng.normal(size=(n, 24))
        * np.concatenate([np.repeat(problem.standing, 3, axis=1), np.ones((n, 12))], axis=1)
    )
    evaluate(model, problem, work, work.states, work.rotations, work.inputs)
    for k in range(n):
        linearise(
            model, work.states[k], work.rotations[k], work.inputs[k], problem.contact[k], problem.standing[k],
            problem.step_s[k], work.tree, work.slope_x[k], work.slope_u[k],
        )  # fmt: skip
        assert eliminate(problem, work, k)
    assert backward(problem, work)
    forward(problem, work)
    ours = np.concatenate([work.move_x[1 : n + 1].ravel(), work.move_u[:n].ravel()])
    theirs = dense_step(problem, work)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-7 * max(1.0, np.abs(theirs).max()))
