"""The pose optimisation of ViTAL (equations 14 to 25) in compiled code: objective, and a search that finds its maximum.

The safe-foothold functions of all legs are tabulated over the hip height with their slopes and read by cubic
interpolation, so that an objective costs well under a microsecond. That buys a search without derivatives: a coarse
grid over the poses of each horizon by itself, then pattern searches over all horizons together from its best points.
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
#: Grid over height, roll and pitch; best points kept of each horizon, pattern searches, their first step.
_HEIGHTS, _ROLLS, _PITCHES = 17, 5, 13
_KEPT, _SEARCHES, _STEP_M = 5, 8, 0.02
#: Of the searches so many go on from a quarter of that step.
_GO_ON = 3


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
def read(values: Array, slopes: Array, place: float, step: float) -> float:
    """Cubic interpolation at ``place`` (in steps) of a table; its end values beyond."""
    last = values.shape[0] - 1
    if not place > 0.0:
        return float(values[0])
    if place >= last:
        return float(values[last])
    k = int(place)
    t = place - k
    a, b = values[k], values[k + 1]
    p, q = slopes[k] * step, slopes[k + 1] * step
    return float(a + t * (p + t * (3.0 * (b - a) - 2.0 * p - q + t * (2.0 * (a - b) + p + q))))


@kernel
def gain(problem: Problem, horizon: int, height: float, roll: float, pitch: float) -> float:
    """The cost of one horizon (equations 18 to 22, 34) at a pose."""
    sb, cb, sg, cg = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    total = 1.0 if problem.cost == PRODUCT else 0.0
    for leg in range(4):
        x, y, z = problem.hips[leg, 0], problem.hips[leg, 1], problem.hips[leg, 2]
        hip = height - x * sg + y * cg * sb + z * cg * cb  # equation 33
        total = add_leg(problem, horizon, leg, hip, total)
    return total if problem.cost != LEAST else 2.0 / np.sqrt(total)


@kernel
def add_leg(problem: Problem, horizon: int, leg: int, hip: float, total: float) -> float:
    """The sum or product ``total`` of the legs before with one more, its hip at a height [m]."""
    place = (hip - problem.first) / problem.step
    f = read(problem.values[horizon, leg], problem.slopes[horizon, leg], place, problem.step)
    if problem.cost == SUM:
        return total + f * f
    if problem.cost == PRODUCT:
        return total * f * f
    share = max(f, 0.0) + _FLOOR
    return total + 1.0 / (share * share)


@kernel
def objective(problem: Problem, u: Array) -> float:
    """Equation 23 for poses ``u`` (h, 3), smoothness squared, weighted and subtracted; -inf if out of bounds."""
    total = _limits(problem, u)
    if total > -np.inf:
        for j in range(u.shape[0]):
            total += gain(problem, j, u[j, 0], u[j, 1], u[j, 2])
    return total


@kernel
def _limits(problem: Problem, u: Array) -> float:
    """The part of the objective that needs no safe-foothold function: -inf out of bounds, else minus the changes."""
    total = 0.0
    for j in range(u.shape[0]):
        for k in range(3):
            if not problem.low[j, k] <= u[j, k] <= problem.high[j, k]:
                return -np.inf
        if j > 0:
            for k in range(3):
                change = u[j, k] - u[j - 1, k]
                if k == 0:
                    change += problem.references[j] - problem.references[j - 1]
                if abs(change) > problem.change[k] + 1e-12:
                    return -np.inf
                total -= problem.smoothness * change * change
    return total


@kernel
def _grid(problem: Problem, horizon: int, kept: Array) -> None:
    """Write the best points of a coarse grid, apart from each other, into ``kept`` (m, 3)."""
    low, high = problem.low[horizon], problem.high[horizon]
    counts = (_HEIGHTS, _ROLLS, _PITCHES)
    score = np.empty(counts)
    for a in range(counts[0]):
        for b in range(counts[1]):
            for c in range(counts[2]):
                score[a, b, c] = gain(
                    problem, horizon,
                    low[0] + (high[0] - low[0]) * a / (counts[0] - 1),
                    low[1] + (high[1] - low[1]) * b / (counts[1] - 1),
                    low[2] + (high[2] - low[2]) * c / (counts[2] - 1),
                )  # fmt: skip
    for m in range(kept.shape[0]):
        best, at = -np.inf, (0, 0, 0)
        for a in range(counts[0]):
            for b in range(counts[1]):
                for c in range(counts[2]):
                    if score[a, b, c] > best:
                        best, at = score[a, b, c], (a, b, c)
        for k in range(3):
            kept[m, k] = low[k] + (high[k] - low[k]) * at[k] / (counts[k] - 1)
        # What lies around a kept point would lead to the same summit.
        for a in range(max(at[0] - 2, 0), min(at[0] + 3, counts[0])):
            for b in range(max(at[1] - 1, 0), min(at[1] + 2, counts[1])):
                for c in range(max(at[2] - 2, 0), min(at[2] + 3, counts[2])):
                    score[a, b, c] = -np.inf


@kernel
def _climb(problem: Problem, u: Array, ways: Array, first: float, finest: float, most: int) -> float:
    """Pattern search from ``u`` (h, 3), moved in place, along ``ways`` (w, 3) of one horizon and of all together.

    The ways are scaled by ``first``, then by half as long each time nothing improves, down to above ``finest``.
    """
    h = u.shape[0]
    trial, start = u.copy(), u.copy()
    gains, tried = np.empty(h), np.empty(h)
    best = _limits(problem, u)
    for i in range(h):
        gains[i] = gain(problem, i, u[i, 0], u[i, 1], u[i, 2])
        best += gains[i]
    scale, calls = first, 0
    while scale > finest and calls < most:
        start[:] = u
        improved = False
        # After the last direction, once more the way that all went together: it follows a ridge that no direction does.
        for j in range(h + 2 if h > 1 else 3):
            together = j == (h + 1 if h > 1 else 2)
            if (h == 1 and j == 1) or (together and not improved):
                continue
            for w in range(1 if together else 2 * ways.shape[0]):
                length = scale if w % 2 == 0 else -scale
                for i in range(h):
                    tried[i] = gains[i]
                    moves = together or j in (i, h)
                    for k in range(3):
                        # As far as the bounds allow, so that a bound can be reached.
                        value = u[i, k]
                        if together:
                            value = 2.0 * u[i, k] - start[i, k]
                        elif moves:
                            value += length * ways[w // 2, k]
                        trial[i, k] = min(max(value, problem.low[i, k]), problem.high[i, k])
                value = _limits(problem, trial)
                calls += 1
                if value == -np.inf:
                    continue
                for i in range(h):
                    # Only what moved is counted anew.
                    if together or j in (i, h):
                        tried[i] = gain(problem, i, trial[i, 0], trial[i, 1], trial[i, 2])
                    value += tried[i]
                if value > best:
                    best = value
                    u[:] = trial
                    gains[:] = tried
                    improved = True
        if not improved:
            scale *= 0.5
    return best


@kernel
def _near(problem: Problem, u: Array) -> None:
    """Bring each horizon's pose within the largest change of the one before, as far as the bounds allow."""
    for j in range(1, u.shape[0]):
        for k in range(3):
            shift = problem.references[j] - problem.references[j - 1] if k == 0 else 0.0
            middle = u[j - 1, k] - shift
            value = min(max(u[j, k], middle - problem.change[k]), middle + problem.change[k])
            u[j, k] = min(max(value, problem.low[j, k]), problem.high[j, k])


@kernel
def maximise(problem: Problem, guess: Array, out: Array) -> float:
    """Write the poses ``out`` (h, 3) of the greatest objective found; ``guess`` (h, 3) is one of the starts.

    Returns the objective; -inf if no poses fulfil all bounds.
    """
    h = guess.shape[0]
    kept = np.empty((h, _KEPT, 3))
    for j in range(h):
        _grid(problem, j, kept[j])
    starts = 1 + _KEPT * (_KEPT if h > 1 else 1) + h
    tries, values = np.empty((starts, h, 3)), np.empty(starts)
    n = 0
    for a in range(_KEPT):
        for b in range(_KEPT if h > 1 else 1):
            tries[n, 0] = kept[0, a]
            for j in range(1, h):
                tries[n, j] = kept[j, b]
            n += 1
    for j in range(h):
        # The best pose of one horizon kept up through all, and the guess.
        for i in range(h):
            tries[n, i] = kept[j, 0]
        n += 1
    tries[n] = guess
    for n in range(starts):
        for k in range(3):
            tries[n, 0, k] = min(max(tries[n, 0, k], problem.low[0, k]), problem.high[0, k])
        _near(problem, tries[n])
        values[n] = objective(problem, tries[n])
    # Along height, roll and pitch, and such that one end or one side of the robot keeps its hips' heights.
    x, y = np.abs(problem.hips[:, 0]).max(), np.abs(problem.hips[:, 1]).max()
    s = _STEP_M
    ways = np.array(
        [[s, 0, 0], [0, s / x, 0], [0, 0, s / x], [s, 0, s / x], [s, 0, -s / x], [s, s / y, 0], [s, -s / y, 0]]
    )
    order, reached = np.empty(_SEARCHES, np.int64), np.full(_SEARCHES, -np.inf)
    for k in range(min(_SEARCHES, starts)):
        order[k] = np.argmax(values)
        if values[order[k]] == -np.inf:
            break
        reached[k] = _climb(problem, tries[order[k]], ways, 1.0, 0.25, 2000)
        values[order[k]] = -np.inf
    best = -np.inf
    for _ in range(_GO_ON):
        k = int(np.argmax(reached))
        if reached[k] == -np.inf:
            break
        found = _climb(problem, tries[order[k]], ways, 0.25, 1.0 / 32.0, 2000)
        reached[k] = -np.inf
        if found > best:
            best = found
            out[:] = tries[order[k]]
    if best > -np.inf:
        best = _climb(problem, out, ways * (1.0 / 16.0), 1.0, 1e-4, 8000)
    return best
