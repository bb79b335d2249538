"""The search for the best pose (ViTAL, equations 14 to 25) in compiled code.

It looks at each horizon by itself first: a grid, and damped Newton ascents from its best points. From the best
combinations of the summits found there it ascends over all horizons together, from the best of those to the end, and
again from around it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.foothold.pose_kernels import (
    LEAST,
    PRODUCT,
    Problem,
    beyond_limit,
    change_to,
    curve,
    hip_above,
    leg_part,
    levers_of,
    objective,
    solve,
)
from legtool_runtime.foothold.pose_stands import lower_column, model_stands

Array = NDArray[np.float64]

#: Grid over height (about so many), roll and pitch; best points kept of each horizon.
_HEIGHTS, _ROLLS, _PITCHES, _KEPT = 33, 13, 21, 10
#: Ascents that only have to tell summits apart, and the last ones: most steps, least relative gain of a step.
_STEPS, _LEAST_GAIN = 12, 1e-4
_LAST_STEPS, _LAST_GAIN = 25, 1e-8
#: Summits of a horizon nearer to each other than this are one [m, rad].
_APART = 3e-3
#: Ascents of all horizons together, how many of those go on to the end, and how many start from around the best, whose
#: hips' heights they leave by so much: the functions ripple.
_ASCENTS, _GO_ON, _AROUND, _AROUND_M = 40, 2, 6, 0.02
#: The first step of an ascent moves the hips by about this at most.
_REACH_M = 5e-3
#: During ascents, weight of the square of what a change between horizons is beyond its limit.
_PENALTY = 1e5


@kernel
def _gain_model(problem: Problem, horizon: int, pose: Array, gradient: Array, matrix: Array) -> float:
    """The gain of a pose (3,); adds its ``gradient`` (3,) and ``matrix`` (3, 3), see ``_model``, to the zeros there."""
    sb, cb, sg, cg = np.sin(pose[1]), np.cos(pose[1]), np.sin(pose[2]), np.cos(pose[2])
    total = 1.0 if problem.cost == PRODUCT else 0.0
    for leg in range(4):
        x, y, z = problem.hips[leg, 0], problem.hips[leg, 1], problem.hips[leg, 2]
        by_pose = (1.0, y * cg * cb - z * cg * sb, -x * cg - y * sg * sb - z * sg * cb)
        place = (pose[0] + hip_above(problem.hips[leg], sb, cb, sg, cg) - problem.first) / problem.step
        f, slope, curvature = curve(problem.values[horizon, leg], problem.slopes[horizon, leg], place, problem.step)
        part, slope, curvature = leg_part(problem.cost, f, slope, curvature)
        total = total * part if problem.cost == PRODUCT else total + part
        for k in range(3):
            gradient[k] += slope * by_pose[k]
            for i in range(k + 1):
                matrix[k, i] -= curvature * by_pose[k] * by_pose[i]
    value, scale, concave = total, 1.0, 0.0
    if problem.cost == PRODUCT:
        scale = total
    elif problem.cost == LEAST:
        value = 2.0 / np.sqrt(total)
        # A power mean is concave in the shares: what is taken off leaves the matrix positive semidefinite.
        scale, concave = 0.5 * value / total, 3.0 / value
    for k in range(3):
        gradient[k] *= scale
    for k in range(3):
        for i in range(k + 1):
            matrix[k, i] = scale * matrix[k, i] - concave * gradient[k] * gradient[i]
    return value


@kernel
def _model(problem: Problem, u: Array, gradient: Array, matrix: Array) -> float:
    """The objective of poses ``u`` (h, 3) without bounds, with a penalty in place of the limits on the change too.

    Writes its ``gradient`` (3h,) and ``matrix`` (3h, 3h): its second derivatives, negated, without those parts by
    which it could curve up and a step lead downwards. The matrix is positive semidefinite, its upper half is left out.
    """
    gradient[:] = 0.0
    matrix[:] = 0.0
    value = 0.0
    for j in range(u.shape[0]):
        a, b = 3 * j, 3 * j + 3
        value += _gain_model(problem, j, u[j], gradient[a:b], matrix[a:b, a:b])
    if problem.stands.shape[0] > 0:
        value -= model_stands(problem.stands, u[0], gradient[:3], matrix[:3, :3])
    for j in range(1, u.shape[0]):
        for k in range(3):
            change, beyond = change_to(problem, u, j, k), beyond_limit(problem, u, j, k)
            value -= problem.smoothness * change * change + _PENALTY * beyond * beyond
            pull = 2.0 * (problem.smoothness * change + _PENALTY * beyond)
            bent = 2.0 * (problem.smoothness + (_PENALTY if beyond != 0.0 else 0.0))
            m, n = 3 * j - 3 + k, 3 * j + k
            gradient[m] += pull
            gradient[n] -= pull
            matrix[m, m] += bent
            matrix[n, n] += bent
            matrix[n, m] = -bent
    return value


@kernel
def _ascend(problem: Problem, u: Array, steps: int, least_gain: float) -> None:
    """Move ``u`` (h, 3) to a summit of the model within its bounds by damped Newton steps (Levenberg-Marquardt)."""
    n = 3 * u.shape[0]
    # Damping holds the hips rather than the coordinates: angles count by what they move the hips.
    levers = levers_of(problem)
    gradient, matrix, step, damped = np.empty(n), np.empty((n, n)), np.empty(n), np.empty((n, n))
    trial, gradient_there, matrix_there = u.copy(), np.empty(n), np.empty((n, n))
    best = _model(problem, u, gradient, matrix)
    damping = 1e-12
    for i in range(n):
        damping = max(damping, abs(gradient[i]) / (levers[i % 3] * _REACH_M))
    for _ in range(steps):
        step[:] = gradient
        damped[:] = matrix
        for i in range(n):
            j, k = i // 3, i % 3
            at_low, at_high = u[j, k] <= problem.low[j, k], u[j, k] >= problem.high[j, k]
            if (at_low and gradient[i] < 0.0) or (at_high and gradient[i] > 0.0):
                step[i], damped[i, :], damped[:, i] = 0.0, 0.0, 0.0
            damped[i, i] += damping * levers[k] ** 2
        solve(damped, step)
        promised = 0.0
        for i in range(n):
            j, k = i // 3, i % 3
            promised += 0.5 * gradient[i] * step[i]
            trial[j, k] = min(max(u[j, k] + step[i], problem.low[j, k]), problem.high[j, k])
        if promised <= least_gain * abs(best):
            break
        value = _model(problem, trial, gradient_there, matrix_there)
        gained = value - best
        # The better the model foretold the gain, the farther it is trusted.
        if gained > 0.75 * promised:
            damping *= 0.1
        elif gained < 0.25 * promised:
            damping *= 3.0 if gained > 0.0 else 8.0
        if gained > 0.0:
            best = value
            u[:] = trial
            gradient[:] = gradient_there
            matrix[:] = matrix_there


@kernel
def _parts(problem: Problem, horizon: int, lowest: int, parts: Array) -> None:
    """Write legs' parts of a score for hips at places ``lowest`` + i of the table, its end values beyond.

    ``parts`` (4, stride, m) holds them at [leg, i % stride, i // stride]: those a stride apart are neighbours there.
    """
    stride, last = parts.shape[1], problem.values.shape[2] - 1
    row = np.empty(last + 1)
    for leg in range(4):
        for k in range(last + 1):
            part = leg_part(problem.cost, problem.values[horizon, leg, k], 0.0, 0.0)[0]
            if problem.cost == PRODUCT:
                part = np.log(part + 1e-300)
            row[k] = part if problem.cost != LEAST else -part
        for i in range(stride * parts.shape[2]):
            parts[leg, i % stride, i // stride] = row[min(max(lowest + i, 0), last)]


@kernel
def _columns(problem: Problem, horizon: int, points: Array, scores: Array) -> None:
    """Write the best height for each roll and pitch of a grid as ``points`` (r, p, 3), and its ``scores`` (r, p)."""
    low, high = problem.low[horizon], problem.high[horizon]
    # Heights are whole steps of the table apart, so that all hips of a column are read without interpolation.
    reach = (high[0] - low[0]) / problem.step
    stride = max(int(reach / (_HEIGHTS - 1) + 0.5), 1)
    column = np.empty(int(reach / stride + 1e-6) + 1)
    span = np.sqrt((problem.hips**2).sum(axis=1).max()) / problem.step
    lowest = int(np.floor((low[0] - problem.first) / problem.step - span))
    parts = np.empty((4, stride, int(2.0 * span) // stride + column.shape[0] + 2))
    _parts(problem, horizon, lowest, parts)
    for b in range(_ROLLS):
        roll = low[1] + (high[1] - low[1]) * b / (_ROLLS - 1)
        sb, cb = np.sin(roll), np.cos(roll)
        for c in range(_PITCHES):
            pitch = low[2] + (high[2] - low[2]) * c / (_PITCHES - 1)
            sg, cg = np.sin(pitch), np.cos(pitch)
            column[:] = 0.0
            for leg in range(4):
                hip = low[0] + hip_above(problem.hips[leg], sb, cb, sg, cg)
                i = int(np.floor((hip - problem.first) / problem.step + 0.5)) - lowest
                row = parts[leg, i % stride, i // stride :]
                for a in range(column.shape[0]):
                    column[a] += row[a]
            if problem.stands.shape[0] > 0:
                lower_column(problem.stands, roll, pitch, low[0], stride * problem.step, column)
            a = int(np.argmax(column))
            scores[b, c] = column[a]
            points[b, c, 0] = min(low[0] + a * stride * problem.step, high[0])
            points[b, c, 1], points[b, c, 2] = roll, pitch


@kernel
def _summits(problem: Problem, j: int, found: Array) -> int:
    """Write the summits of horizon ``j`` by itself, found from a grid, into ``found`` (m, 3); returns how many."""
    alone = Problem(
        problem.hips, problem.values[j : j + 1], problem.slopes[j : j + 1], problem.first, problem.step,
        problem.low[j : j + 1], problem.high[j : j + 1], problem.references[j : j + 1], problem.change,
        problem.smoothness, problem.cost, problem.stands if j == 0 else problem.stands[:0],
    )  # fmt: skip
    points, scores = np.empty((_ROLLS, _PITCHES, 3)), np.empty((_ROLLS, _PITCHES))
    _columns(problem, j, points, scores)
    count = 0
    for _ in range(_KEPT):
        b, c = divmod(int(np.argmax(scores)), _PITCHES)
        # What lies around would mostly lead to the same summit.
        scores[max(b - 1, 0) : b + 2, max(c - 1, 0) : c + 2] = -np.inf
        found[count] = points[b, c]
        _ascend(alone, found[count : count + 1], _STEPS, _LEAST_GAIN)
        known = False
        for i in range(count):
            gap = 0.0
            for k in range(3):
                gap = max(gap, abs(found[i, k] - found[count, k]))
            known = known or gap <= _APART
        count += 0 if known else 1
    return count


@kernel
def _starts(problem: Problem, guess: Array, tries: Array) -> int:
    """Write poses to ascend from into ``tries`` (n, h, 3): the guess and combined summits; returns how many."""
    h = guess.shape[0]
    kept, counts = np.empty((h, _KEPT, 3)), np.empty(h, np.int64)
    tries[0] = guess
    n = 1
    for j in range(h):
        counts[j] = _summits(problem, j, kept[j])
        for a in range(counts[j]):
            # One pose kept up through all horizons, as it is in the world: without any change.
            tries[n] = kept[j, a]
            tries[n, :, 0] += problem.references[j] - problem.references
            n += 1
    for a in range(counts[0]):
        for b in range(counts[1:].max() if h > 1 else 0):
            tries[n, 0] = kept[0, a]
            for j in range(1, h):
                tries[n, j] = kept[j, min(b, counts[j] - 1)]
            n += 1
    return n


@kernel
def _settle(problem: Problem, u: Array) -> float:
    """Bring poses ``u`` (h, 3) within the bounds and the limits on the change; returns the objective."""
    h = u.shape[0]
    for k in range(3):
        low, high = problem.low[:, k], problem.high[:, k]
        for j in range(1, h):
            excess = beyond_limit(problem, u, j, k)
            u[j - 1, k] += 0.5 * excess
            u[j, k] -= 0.5 * excess
        # Where a bound keeps one from meeting the other, the other has to come all the way.
        for j in range(h):
            value = u[j, k] - (beyond_limit(problem, u, j, k) if j > 0 else 0.0)
            u[j, k] = min(max(value, low[j]), high[j])
        for j in range(h - 1, 0, -1):
            u[j - 1, k] = min(max(u[j - 1, k] + beyond_limit(problem, u, j, k), low[j - 1]), high[j - 1])
    return objective(problem, u)


@kernel
def _ascend_best(problem: Problem, tries: Array, values: Array, count: int, steps: int, least_gain: float) -> Array:
    """Ascend from the ``count`` best of ``tries`` (n, h, 3) by their ``values`` (n,); returns new ones, else -inf."""
    reached = np.full(values.shape[0], -np.inf)
    for _ in range(count):
        n = int(np.argmax(values))
        if values[n] == -np.inf:
            break
        values[n] = -np.inf
        _ascend(problem, tries[n], steps, least_gain)
        reached[n] = _settle(problem, tries[n])
    return reached


@kernel
def _around(problem: Problem, u: Array, tries: Array) -> None:
    """Write poses to either side of ``u`` (h, 3) along each coordinate into ``tries`` (6h, h, 3)."""
    levers = levers_of(problem)
    n = 0
    for j in range(u.shape[0]):
        for k in range(3):
            for side in (-1.0, 1.0):
                tries[n] = u
                tries[n, j, k] += side * _AROUND_M / levers[k]
                n += 1


@kernel
def _values(problem: Problem, tries: Array) -> Array:
    """Settle all ``tries`` (n, h, 3); returns their objectives (n,)."""
    values = np.empty(tries.shape[0])
    for n in range(tries.shape[0]):
        values[n] = _settle(problem, tries[n])
    return values


@kernel
def maximise(problem: Problem, guess: Array, out: Array) -> float:
    """Write the poses ``out`` (h, 3) of the greatest objective found; ``guess`` (h, 3) is one of the starts.

    Returns the objective; -inf if no poses fulfil all bounds.
    """
    h = guess.shape[0]
    tries = np.empty((1 + h * _KEPT + _KEPT * _KEPT, h, 3))
    tries = tries[: _starts(problem, guess, tries)]
    values = _ascend_best(problem, tries, _values(problem, tries), _ASCENTS, _STEPS, _LEAST_GAIN)
    values = _ascend_best(problem, tries, values, _GO_ON, _LAST_STEPS, _LAST_GAIN)
    n = int(np.argmax(values))
    best = float(values[n])
    if best > -np.inf:
        out[:] = tries[n]
        tries = np.empty((6 * h, h, 3))
        _around(problem, out, tries)
        values = _ascend_best(problem, tries, _values(problem, tries), _AROUND, _LAST_STEPS, _LAST_GAIN)
        n = int(np.argmax(values))
        if values[n] > best:
            best = float(values[n])
            out[:] = tries[n]
    return best
