"""The pose optimisation of ViTAL (equations 14 to 25) in compiled code: objective, and a search that finds its maximum.

The safe-foothold functions of all legs are tabulated over the hip height with their slopes and read by cubic
interpolation, so that an objective with its derivatives costs well under a microsecond. The search looks at each
horizon by itself first: a grid, and damped Newton ascents from its best points. From the best combinations of the
summits found there it ascends over all horizons together, and from the best of what that reaches to the end.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel

Array = NDArray[np.float64]

SUM, PRODUCT, LEAST = 0, 1, 2
#: Floor of the shares in the cost LEAST: it tells poses apart even where one leg has nothing.
_FLOOR = 5e-3
#: Shares nearer to zero than this count as this where the cost PRODUCT divides by them.
_TINY = 1e-9
#: Grid over height (about so many), roll and pitch; best points kept of each horizon.
_HEIGHTS, _ROLLS, _PITCHES, _KEPT = 33, 13, 21, 10
#: Ascents that only have to tell summits apart, and the last ones: most steps, least relative gain of a step.
_STEPS, _LEAST_GAIN = 12, 1e-4
_LAST_STEPS, _LAST_GAIN = 25, 1e-8
#: Summits of a horizon nearer to each other than this are one [m, rad].
_APART = 3e-3
#: Ascents of all horizons together, and how many of those go on to the end.
_ASCENTS, _GO_ON = 40, 4
#: The first step of an ascent moves the hips by about this at most.
_REACH_M = 5e-3
#: During ascents, weight of the square of what a change between horizons is beyond its limit.
_PENALTY = 1e5


class Problem(NamedTuple):
    """One problem. Poses are (h, 3): height above each horizon's reference [m], roll, pitch (+ is nose down) [rad].

    ``hips`` (4, 3) base frame [m]; ``values``, ``slopes`` (h, 4, g) of the safe-foothold functions, as shares of the
    map, over hip heights ``first`` + k ``step`` [m]; ``low``, ``high`` (h, 3) bounds; ``references`` (h,) heights of
    the terrain [m]; ``change`` (3,) largest change between horizons; ``smoothness`` weight of its square; ``cost``.
    """

    hips: Array
    values: Array
    slopes: Array
    first: float
    step: float
    low: Array
    high: Array
    references: Array
    change: Array
    smoothness: float
    cost: int


@kernel
def least_around(values: Array, reach: int, step: float, out: Array, slopes: Array) -> None:
    """Write the mean of ``values`` (h, 4, g) and of the least within ``reach`` steps into ``out``, and its slopes."""
    g = values.shape[2]
    for j in range(values.shape[0]):
        for leg in range(values.shape[1]):
            row, lowered, slope = values[j, leg], out[j, leg], slopes[j, leg]
            for k in range(g):
                least = row[k]
                for i in range(max(k - reach, 0), min(k + reach + 1, g)):
                    least = min(least, row[i])
                lowered[k] = 0.5 * (least + row[k])
            for k in range(g):
                low, high = max(k - 1, 0), min(k + 1, g - 1)
                slope[k] = (lowered[high] - lowered[low]) / ((high - low) * step)


@kernel
def _curve(values: Array, slopes: Array, place: float, step: float) -> tuple[float, float, float]:
    """Cubic interpolation at ``place`` (in steps) of a table, its slope and curvature; its end values beyond."""
    last = values.shape[0] - 1
    if not place > 0.0:
        return float(values[0]), 0.0, 0.0
    if place >= last:
        return float(values[last]), 0.0, 0.0
    k = int(place)
    t = place - k
    a, b = values[k], values[k + 1]
    p, q = slopes[k] * step, slopes[k + 1] * step
    c, d = 3.0 * (b - a) - 2.0 * p - q, 2.0 * (a - b) + p + q
    slope, curvature = p + t * (2.0 * c + 3.0 * t * d), 2.0 * c + 6.0 * t * d
    return a + t * (p + t * (c + t * d)), slope / step, curvature / (step * step)


@kernel
def read(values: Array, slopes: Array, place: float, step: float) -> float:
    """Cubic interpolation at ``place`` (in steps) of a table; its end values beyond."""
    return _curve(values, slopes, place, step)[0]


@kernel
def _above(hip: Array, roll: float, pitch: float) -> float:
    """How high a hip (3,) is above the trunk's origin [m] (equation 33)."""
    return hip[1] * np.cos(pitch) * np.sin(roll) + hip[2] * np.cos(pitch) * np.cos(roll) - hip[0] * np.sin(pitch)


@kernel
def _part(cost: int, f: float, slope: float, curvature: float) -> tuple[float, float, float]:
    """A leg's part of a gain: what its share adds to the total (PRODUCT: multiplies it by), slope and curvature.

    Both by the hip height, still to be scaled by the total. What curves up is taken for straight, see ``_model``.
    """
    if cost == SUM:
        return f * f, 2.0 * f * slope, min(2.0 * (slope * slope + f * curvature), 0.0)
    if cost == PRODUCT:
        divisor = f if abs(f) > _TINY else _TINY
        slope /= divisor
        return f * f, 2.0 * slope, 2.0 * (min(curvature / divisor, 0.0) - slope * slope)
    share = max(f, 0.0) + _FLOOR
    if f < 0.0:
        slope, curvature = 0.0, 0.0
    weight = 2.0 / (share * share * share)
    return 1.0 / (share * share), weight * slope, weight * (min(curvature, 0.0) - 3.0 * slope * slope / share)


@kernel
def gain(problem: Problem, horizon: int, height: float, roll: float, pitch: float) -> float:
    """The cost of one horizon (equations 18 to 22, 34) at a pose."""
    total = 1.0 if problem.cost == PRODUCT else 0.0
    for leg in range(4):
        place = (height + _above(problem.hips[leg], roll, pitch) - problem.first) / problem.step
        f = read(problem.values[horizon, leg], problem.slopes[horizon, leg], place, problem.step)
        part = _part(problem.cost, f, 0.0, 0.0)[0]
        total = total * part if problem.cost == PRODUCT else total + part
    return total if problem.cost != LEAST else 2.0 / np.sqrt(total)


@kernel
def _change(problem: Problem, u: Array, j: int, k: int) -> float:
    """Change of coordinate ``k`` of the pose from the horizon before to horizon ``j``, of heights in the world."""
    change = u[j, k] - u[j - 1, k]
    return change + (problem.references[j] - problem.references[j - 1]) if k == 0 else change


@kernel
def _excess(problem: Problem, u: Array, j: int, k: int) -> float:
    """By how much that change is beyond its limit, with its sign."""
    change = _change(problem, u, j, k)
    return change - min(max(change, -problem.change[k]), problem.change[k])


@kernel
def objective(problem: Problem, u: Array) -> float:
    """Equation 23 for poses ``u`` (h, 3), smoothness squared, weighted and subtracted; -inf if out of bounds."""
    total = 0.0
    for j in range(u.shape[0]):
        for k in range(3):
            if not problem.low[j, k] <= u[j, k] <= problem.high[j, k]:
                return -np.inf
            if j > 0:
                change = _change(problem, u, j, k)
                if abs(change) > problem.change[k] + 1e-12:
                    return -np.inf
                total -= problem.smoothness * change * change
    for j in range(u.shape[0]):
        total += gain(problem, j, u[j, 0], u[j, 1], u[j, 2])
    return total


@kernel
def _gain_model(problem: Problem, horizon: int, pose: Array, gradient: Array, matrix: Array) -> float:
    """The gain of a pose (3,); adds its ``gradient`` (3,) and ``matrix`` (3, 3), see ``_model``, to the zeros there."""
    sb, cb, sg, cg = np.sin(pose[1]), np.cos(pose[1]), np.sin(pose[2]), np.cos(pose[2])
    total = 1.0 if problem.cost == PRODUCT else 0.0
    for leg in range(4):
        x, y, z = problem.hips[leg, 0], problem.hips[leg, 1], problem.hips[leg, 2]
        hip = pose[0] - x * sg + y * cg * sb + z * cg * cb
        by_pose = (1.0, y * cg * cb - z * cg * sb, -x * cg - y * sg * sb - z * sg * cb)
        place = (hip - problem.first) / problem.step
        f, slope, curvature = _curve(problem.values[horizon, leg], problem.slopes[horizon, leg], place, problem.step)
        part, slope, curvature = _part(problem.cost, f, slope, curvature)
        total = total * part if problem.cost == PRODUCT else total + part
        for k in range(3):
            gradient[k] += slope * by_pose[k]
            for i in range(3):
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
        for i in range(3):
            matrix[k, i] = scale * matrix[k, i] - concave * gradient[k] * gradient[i]
    return value


@kernel
def _model(problem: Problem, u: Array, gradient: Array, matrix: Array) -> float:
    """The objective of poses ``u`` (h, 3) without bounds, with a penalty in place of the limits on the change.

    Writes its ``gradient`` (3h,) and ``matrix`` (3h, 3h): its second derivatives, negated, without those parts by
    which it could curve up and a step lead downwards. The matrix is positive semidefinite.
    """
    gradient[:] = 0.0
    matrix[:] = 0.0
    value = 0.0
    for j in range(u.shape[0]):
        a, b = 3 * j, 3 * j + 3
        value += _gain_model(problem, j, u[j], gradient[a:b], matrix[a:b, a:b])
    for j in range(1, u.shape[0]):
        for k in range(3):
            change, beyond = _change(problem, u, j, k), _excess(problem, u, j, k)
            value -= problem.smoothness * change * change + _PENALTY * beyond * beyond
            pull = 2.0 * (problem.smoothness * change + _PENALTY * beyond)
            bent = 2.0 * (problem.smoothness + (_PENALTY if beyond != 0.0 else 0.0))
            m, n = 3 * j - 3 + k, 3 * j + k
            gradient[m] += pull
            gradient[n] -= pull
            matrix[m, m] += bent
            matrix[n, n] += bent
            matrix[m, n] -= bent
            matrix[n, m] -= bent
    return value


@kernel
def _solve(matrix: Array, vector: Array) -> None:
    """Solve for a positive definite ``matrix`` (n, n) by Cholesky, in place; ``vector`` (n,) becomes the solution."""
    n = vector.shape[0]
    for i in range(n):
        for j in range(i + 1):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = np.sqrt(rest) if i == j else rest / matrix[j, j]
        for k in range(i):
            vector[i] -= matrix[i, k] * vector[k]
        vector[i] /= matrix[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            vector[i] -= matrix[k, i] * vector[k]
        vector[i] /= matrix[i, i]


@kernel
def _ascend(problem: Problem, u: Array, steps: int, least_gain: float) -> None:
    """Move ``u`` (h, 3) to a summit of the model within its bounds by damped Newton steps (Levenberg-Marquardt)."""
    n = 3 * u.shape[0]
    # Damping holds the hips rather than the coordinates: angles count by what they move the hips.
    levers = (1.0, np.abs(problem.hips[:, 1]).max(), np.abs(problem.hips[:, 0]).max())
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
        _solve(damped, step)
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
def _columns(problem: Problem, horizon: int, points: Array, scores: Array) -> None:
    """Write the best height for each roll and pitch of a grid as ``points`` (r, p, 3), and its ``scores`` (r, p)."""
    low, high = problem.low[horizon], problem.high[horizon]
    last = problem.values.shape[2] - 1
    parts = np.empty((4, last + 1))
    for leg in range(4):
        for k in range(last + 1):
            part = _part(problem.cost, problem.values[horizon, leg, k], 0.0, 0.0)[0]
            if problem.cost == PRODUCT:
                part = np.log(part + 1e-300)
            parts[leg, k] = part if problem.cost != LEAST else -part
    # Heights are whole steps of the table apart, so that all of a column are read without interpolation.
    reach = (high[0] - low[0]) / problem.step
    stride = max(int(reach / (_HEIGHTS - 1) + 0.5), 1)
    column = np.empty(int(reach / stride + 1e-6) + 1)
    for b in range(_ROLLS):
        for c in range(_PITCHES):
            roll = low[1] + (high[1] - low[1]) * b / (_ROLLS - 1)
            pitch = low[2] + (high[2] - low[2]) * c / (_PITCHES - 1)
            column[:] = 0.0
            for leg in range(4):
                hip = low[0] + _above(problem.hips[leg], roll, pitch)
                place = int(np.floor((hip - problem.first) / problem.step + 0.5))
                row = parts[leg]
                for a in range(column.shape[0]):
                    column[a] += row[min(max(place + a * stride, 0), last)]
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
        problem.smoothness, problem.cost,
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
            known = known or np.abs(found[i] - found[count]).max() <= _APART
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
            excess = _excess(problem, u, j, k)
            u[j - 1, k] += 0.5 * excess
            u[j, k] -= 0.5 * excess
        # Where a bound keeps one from meeting the other, the other has to come all the way.
        for j in range(h):
            value = u[j, k] - (_excess(problem, u, j, k) if j > 0 else 0.0)
            u[j, k] = min(max(value, low[j]), high[j])
        for j in range(h - 1, 0, -1):
            u[j - 1, k] = min(max(u[j - 1, k] + _excess(problem, u, j, k), low[j - 1]), high[j - 1])
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
def maximise(problem: Problem, guess: Array, out: Array) -> float:
    """Write the poses ``out`` (h, 3) of the greatest objective found; ``guess`` (h, 3) is one of the starts.

    Returns the objective; -inf if no poses fulfil all bounds.
    """
    h = guess.shape[0]
    tries = np.empty((1 + h * _KEPT + _KEPT * _KEPT, h, 3))
    values = np.empty(_starts(problem, guess, tries))
    for n in range(values.shape[0]):
        values[n] = _settle(problem, tries[n])
    values = _ascend_best(problem, tries, values, _ASCENTS, _STEPS, _LEAST_GAIN)
    values = _ascend_best(problem, tries, values, _GO_ON, _LAST_STEPS, _LAST_GAIN)
    n = int(np.argmax(values))
    if values[n] > -np.inf:
        out[:] = tries[n]
    return float(values[n])
