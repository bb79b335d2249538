"""Sequential quadratic programming over knots: linearise, eliminate, Riccati recursion, line search by a filter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.search.swings.cost import STEP_S, input_cost, state_cost
from legtool_runtime.search.swings.motion import advance, feet_of, feet_slope, linearise, rotation_vector, turn_by
from legtool_runtime.search.swings.problem import SwingProblem, Workspace
from legtool_runtime.search.swings.recursion import backward, eliminate, forward
from legtool_runtime.tracking.dynamics import Model

Array = NDArray[np.float64]

#: What :func:`solve` ends with.
CONVERGED, PASSES, STALLED, SINGULAR = 0, 1, 2, 3
#: Steps are halved at most so often.
_HALVINGS = 6
#: Of a filter's entry: how much better than it a step must be in one of the two.
_BETTER = 1e-4
#: A violation that counts as none.
_HELD = 1e-6


@kernel
def evaluate(
    model: Model, problem: SwingProblem, work: Workspace, states: Array, rotations: Array, inputs: Array
) -> tuple[float, float]:
    """Cost and violation of an iterate; writes its gaps, feet, and the cost's quadratic model."""
    n = problem.step_s.shape[0]
    after, turned, cost, violation = np.empty(24), np.empty((3, 3)), 0.0, 0.0
    for k in range(n + 1):
        feet_of(model, states[k], rotations[k], work.tree, work.feet[k])
        feet_slope(rotations[k], work.tree, work.feet_slope[k])
        cost += state_cost(problem, work, k, states[k], rotations[k])
        if k > 0:
            for leg in range(4):
                for i in range(3):
                    off = work.feet[k, leg, i] - problem.target[k, leg, i]
                    if problem.fixed[k - 1, leg] or i == 2:
                        violation += off * off
                    else:
                        cost += 0.5 * problem.foot * problem.step_s[k - 1] / STEP_S * off * off
        if k == n:
            break
        cost += input_cost(problem, work, k, inputs[k], rotations[k])
        advance(
            model, states[k], rotations[k], inputs[k], problem.contact[k], problem.standing[k], problem.step_s[k],
            work.tree, after, turned,
        )  # fmt: skip
        for i in range(24):
            work.gap[k, i] = after[i] - states[k + 1, i]
        rotation_vector(rotations[k + 1], turned, work.gap[k, 9:12])
        for i in range(24):
            violation += work.gap[k, i] * work.gap[k, i]
    return cost, np.sqrt(violation)


@kernel
def _step(problem: SwingProblem, work: Workspace, length: float) -> None:
    """Write the iterate after a step of some length."""
    turn, small = np.empty(3), np.empty((3, 3))
    for k in range(problem.step_s.shape[0] + 1):
        for i in range(24):
            work.trial_states[k, i] = work.states[k, i] + length * work.move_x[k, i]
        for i in range(3):
            turn[i] = length * work.move_x[k, 9 + i]
            work.trial_states[k, 9 + i] = 0.0
        turn_by(work.rotations[k], turn, small, work.trial_rotations[k])
        if k < problem.step_s.shape[0]:
            for i in range(24):
                work.trial_inputs[k, i] = work.inputs[k, i] + length * work.move_u[k, i]


@kernel
def _acceptable(entries: Array, count: int, cost: float, violation: float) -> bool:
    """Whether no entry (cost, violation) of the filter is as good in both."""
    if not (np.isfinite(cost) and np.isfinite(violation)):
        return False
    for e in range(count):
        room = _BETTER * entries[e, 1]
        held = violation <= _HELD and entries[e, 1] <= _HELD
        if cost > entries[e, 0] - room and (held or violation > max(entries[e, 1] - room, _HELD)):
            return False
    return True


@kernel
def solve(
    model: Model, problem: SwingProblem, work: Workspace, passes: int, converged: float
) -> tuple[int, int, float, float]:
    """Solve from the iterate in ``work``, which is left at the last one that was accepted.

    Returns:
        how it ended, the number of passes, cost, and violation: the norm of all gaps and of feet off their places.
    """
    n = problem.step_s.shape[0]
    entries = np.empty((passes + 1, 2))
    cost, violation = evaluate(model, problem, work, work.states, work.rotations, work.inputs)
    for count in range(passes):
        entries[count, 0], entries[count, 1] = cost, violation
        for k in range(n):
            linearise(
                model, work.states[k], work.rotations[k], work.inputs[k], problem.contact[k], problem.standing[k],
                problem.step_s[k], work.tree, work.slope_x[k], work.slope_u[k],
            )  # fmt: skip
            if not eliminate(problem, work, k):
                return SINGULAR, count + 1, cost, violation
        if not backward(problem, work):
            return SINGULAR, count + 1, cost, violation
        forward(problem, work)
        length = 1.0
        for _ in range(_HALVINGS + 1):
            _step(problem, work, length)
            new_cost, new_violation = evaluate(
                model, problem, work, work.trial_states, work.trial_rotations, work.trial_inputs
            )
            found = _acceptable(entries, count + 1, new_cost, new_violation)
            if found:
                break
            length *= 0.5
        if not found:
            # The feet are those of the step that was refused: as before.
            cost, violation = evaluate(model, problem, work, work.states, work.rotations, work.inputs)
            return (CONVERGED if violation <= _HELD else STALLED), count + 1, cost, violation
        rest = max(cost, new_cost) - min(cost, new_cost) < converged * max(cost, 1.0)
        cost, violation = new_cost, new_violation
        work.states[: n + 1] = work.trial_states[: n + 1]
        work.rotations[: n + 1] = work.trial_rotations[: n + 1]
        work.inputs[:n] = work.trial_inputs[:n]
        if rest and violation <= _HELD:
            return CONVERGED, count + 1, cost, violation
    return PASSES, passes, cost, violation
