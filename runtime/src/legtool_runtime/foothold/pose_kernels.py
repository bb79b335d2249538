"""The pose optimisation of ViTAL (equations 14 to 25) in compiled code: the objective.

The safe-foothold functions of all legs are tabulated over the hip height with their slopes and read by cubic
interpolation, so that an objective with its derivatives costs well under a microsecond.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.foothold.pose_stands import PENALTY, beyond_stands

Array = NDArray[np.float64]

SUM, PRODUCT, LEAST = 0, 1, 2
#: Floor of the shares in the cost LEAST: it tells poses apart even where one leg has nothing.
_FLOOR = 5e-3
#: Shares nearer to zero than this count as this where the cost PRODUCT divides by them.
_TINY = 1e-9


class Problem(NamedTuple):
    """One problem. Poses are (h, 3): height above each horizon's reference [m], roll, pitch (+ is nose down) [rad].

    ``hips`` (4, 3) base frame [m]; ``values``, ``slopes`` (h, 4, g) of the safe-foothold functions, as shares of the
    map, over hip heights ``first`` + k ``step`` [m]; ``low``, ``high`` (h, 3) bounds; ``references`` (h,) heights of
    the terrain [m]; ``change`` (3,) largest change between horizons; ``smoothness`` weight of its square; ``cost``;
    ``stands`` (m, 8) what standing legs allow in the first horizon, see :mod:`.pose_stands`.
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
    stands: Array


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
def curve(values: Array, slopes: Array, place: float, step: float) -> tuple[float, float, float]:
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
    return curve(values, slopes, place, step)[0]


@kernel
def hip_above(hip: Array, sb: float, cb: float, sg: float, cg: float) -> float:
    """How high a hip (3,) is above the trunk's origin [m] (equation 33); sines and cosines of roll and pitch."""
    return float(hip[1] * cg * sb + hip[2] * cg * cb - hip[0] * sg)


@kernel
def leg_part(cost: int, f: float, slope: float, curvature: float) -> tuple[float, float, float]:
    """A leg's part of a gain: what its share adds to the total (PRODUCT: multiplies it by), slope and curvature.

    Both by the hip height, still to be scaled by the total. What curves up is taken for straight, see
    ``pose_search._model``.
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
    sb, cb, sg, cg = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    total = 1.0 if problem.cost == PRODUCT else 0.0
    for leg in range(4):
        place = (height + hip_above(problem.hips[leg], sb, cb, sg, cg) - problem.first) / problem.step
        f = read(problem.values[horizon, leg], problem.slopes[horizon, leg], place, problem.step)
        part = leg_part(problem.cost, f, 0.0, 0.0)[0]
        total = total * part if problem.cost == PRODUCT else total + part
    return total if problem.cost != LEAST else 2.0 / np.sqrt(total)


@kernel
def change_to(problem: Problem, u: Array, j: int, k: int) -> float:
    """Change of coordinate ``k`` of the pose from the horizon before to horizon ``j``, of heights in the world."""
    change = u[j, k] - u[j - 1, k]
    return change + (problem.references[j] - problem.references[j - 1]) if k == 0 else change


@kernel
def beyond_limit(problem: Problem, u: Array, j: int, k: int) -> float:
    """By how much :func:`change_to` is beyond its limit, with its sign."""
    change = change_to(problem, u, j, k)
    return change - min(max(change, -problem.change[k]), problem.change[k])


@kernel
def objective(problem: Problem, u: Array) -> float:
    """Equation 23 for poses ``u`` (h, 3), smoothness squared, weighted and subtracted; -inf if out of bounds.

    Legs that stand beyond their bounds cost a penalty: where no pose keeps them, the least is wanted.
    """
    total = 0.0
    for j in range(u.shape[0]):
        for k in range(3):
            if not problem.low[j, k] <= u[j, k] <= problem.high[j, k]:
                return -np.inf
            if j > 0:
                change = change_to(problem, u, j, k)
                if abs(change) > problem.change[k] + 1e-12:
                    return -np.inf
                total -= problem.smoothness * change * change
    for j in range(u.shape[0]):
        total += gain(problem, j, u[j, 0], u[j, 1], u[j, 2])
    if problem.stands.shape[0] > 0:
        total -= PENALTY * beyond_stands(problem.stands, u[0])
    return total


@kernel
def solve(matrix: Array, vector: Array) -> None:
    """Solve with the lower half of a positive definite ``matrix`` (n, n), by Cholesky; ``vector`` (n,) becomes x."""
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
def levers_of(problem: Problem) -> tuple[float, float, float]:
    """By how much the hips move at most for a change of height, roll and pitch [1, m, m]."""
    x, y = 0.0, 0.0
    for leg in range(4):
        x, y = max(x, abs(problem.hips[leg, 0])), max(y, abs(problem.hips[leg, 1]))
    return 1.0, y, x
