"""Motion prediction in compiled code, for one state and many commands: what the Python API and the planner call.

Among the inputs only the reference r of the step varies with the command. The design vector [1, φ(x)] of either degree
is therefore linear in the monomials of r, m = (1, r₁, r₂, r₃) or, of degree 2, (1, r₁, r₂, r₃, r₁², r₁r₂, …, r₃²), with
weights that only the state sets. What the state sets is summed once: the mean is T·m and the spread mᵀ·V·m with small T
and V. The design is ordered by monomial for this (:func:`design_order`); the weights of each monomial are then a prefix
of z = (1, s, s⊗s), s being the 21 inputs other than r.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.motion.features import FEATURE_SIGN, FEATURE_SWAP, FEATURES, REFERENCE, TARGET_SIGN, TARGETS
from legtool_runtime.robot import TROT_PAIRS

Array = NDArray[np.float64]

_INPUTS = len(FEATURES)
_FIXED = np.array([i for i in range(_INPUTS) if not REFERENCE.start <= i < REFERENCE.stop])
_STATE = len(_FIXED)
_LINEAR = 1 + _STATE
_FULL = _LINEAR + _STATE * (_STATE + 1) // 2
_R = REFERENCE.start
_MODELS = ("fdm", "cdm", "cvm")
#: Columns of the three models' outputs side by side.
_ENDS = np.cumsum([len(TARGETS[name]) for name in _MODELS])
OUTPUTS = int(_ENDS[-1])
#: Where those of the CDM and of the CVM begin; the FDM's come first.
COM, VELOCITY = int(_ENDS[0]), int(_ENDS[1])
#: Monomials of the reference that a model of degree 2 has; one of degree 1 has the first four.
MONOMIALS = 10
_OUTPUT_SIGN = np.concatenate([TARGET_SIGN[name] for name in _MODELS])
_PAIRS = np.array(TROT_PAIRS)


def design_size(degree: int) -> int:
    """Length of [1, φ(x)]: 25 for degree 1, 325 for degree 2."""
    return 1 + _INPUTS if degree == 1 else 1 + _INPUTS + _INPUTS * (_INPUTS + 1) // 2


def design(features: Array, degree: int) -> Array:
    """The design matrix in its published order.

    Args:
        features: (n, 24) in the order of FEATURES.
        degree: 1, or 2 for the second-order polynomial.

    Returns:
        (n, 25) columns 1, x; or (n, 325) columns 1, x, x_i·x_j for i ≤ j, row by row of the upper triangle.
    """
    columns = [np.ones((len(features), 1)), features]
    if degree == 2:
        i, j = np.triu_indices(_INPUTS)
        columns.append(features[:, i] * features[:, j])
    return np.concatenate(columns, axis=1)


def design_order(degree: int) -> NDArray[np.intp]:
    """Index into the published order of the design that sorts it by monomial of the reference."""
    pair = np.zeros((_INPUTS, _INPUTS), dtype=np.intp)
    upper = np.triu_indices(_INPUTS)
    pair[upper] = 1 + _INPUTS + np.arange(len(upper[0]))
    pair = np.maximum(pair, pair.T)
    reference = np.arange(REFERENCE.start, REFERENCE.stop)
    if degree == 1:
        return np.concatenate([[0], 1 + _FIXED, 1 + reference])
    i, j = np.triu_indices(_STATE)
    a, b = np.triu_indices(3)
    parts = [np.zeros(1, np.intp), 1 + _FIXED, pair[_FIXED[i], _FIXED[j]]]
    for r in reference:
        parts += [np.array([1 + r]), pair[r, _FIXED]]
    parts.append(pair[reference[a], reference[b]])
    return np.concatenate(parts)


@kernel
def _state_terms(state: Array, swing_pair: int, degree: int) -> Array:
    """z = (1, s, s⊗s) of the canonical pair."""
    z = np.empty(_FULL if degree == 2 else _LINEAR)
    z[0] = 1.0
    for i in range(_STATE):
        f = _FIXED[i]
        z[1 + i] = state[FEATURE_SWAP[f]] * FEATURE_SIGN[f] if swing_pair == 1 else state[f]
    if degree == 2:
        n = _LINEAR
        for i in range(_STATE):
            for j in range(i, _STATE):
                z[n] = z[1 + i] * z[1 + j]
                n += 1
    return z


@kernel
def _monomials(commands: Array, n: int, swing_pair: int, count: int, m: Array) -> None:
    m[0] = 1.0
    for i in range(3):
        m[1 + i] = commands[n, i] * FEATURE_SIGN[_R + i] if swing_pair == 1 else commands[n, i]
    if count == MONOMIALS:
        k = 4
        for i in range(3):
            for j in range(i, 3):
                m[k] = m[1 + i] * m[1 + j]
                k += 1


@kernel
def _segment(monomial: int, degree: int) -> int:
    """How many design columns carry a monomial."""
    if monomial == 0:
        return _FULL if degree == 2 else _LINEAR
    if monomial < 4 and degree == 2:
        return _LINEAR
    return 1


@kernel
def mean_table(weights: Array, state: Array, swing_pair: int, table: Array) -> int:
    """Write T, what the state makes of the weights of each monomial.

    Args:
        weights: (25 or 325, 13) of MotionModel, design sorted by :func:`design_order`.
        state: (24,) in the order of FEATURES, as measured; its reference entries are not read.
        swing_pair: index into TROT_PAIRS of the pair that swings next.
        table: (MONOMIALS, 13); its first rows are written.

    Returns:
        The number of monomials: 4 for degree 1, 10 for degree 2.
    """
    degree = 1 if weights.shape[0] == 1 + _INPUTS else 2
    count = 4 if degree == 1 else MONOMIALS
    z = _state_terms(state, swing_pair, degree)
    row = 0
    for c in range(count):
        for o in range(OUTPUTS):
            table[c, o] = 0.0
        for i in range(_segment(c, degree)):
            for o in range(OUTPUTS):
                table[c, o] += z[i] * weights[row, o]
            row += 1
    return count


@kernel
def mean(table: Array, count: int, commands: Array, n: int, swing_pair: int, m: Array, out: Array) -> None:
    """Write the monomials (count,) of one command, and the models' outputs (13,) for it.

    ``table`` and ``count`` are of :func:`mean_table`. Outputs: front x, y, z and hind x, y, z of the feet that swing,
    then those of the CDM from COM on and of the CVM from VELOCITY on.
    """
    _monomials(commands, n, swing_pair, count, m)
    m0, m1, m2, m3 = m[0], m[1], m[2], m[3]
    for o in range(OUTPUTS):  # four at once: the compiler does not know that out is no part of the table
        out[o] = m0 * table[0, o] + m1 * table[1, o] + m2 * table[2, o] + m3 * table[3, o]
    for c in range(4, count):
        factor = m[c]
        for o in range(OUTPUTS):
            out[o] += factor * table[c, o]
    if swing_pair == 1:
        for o in range(OUTPUTS):
            out[o] *= _OUTPUT_SIGN[o]


@kernel
def predict_mean(
    weights: Array,
    state: Array,
    swing_pair: int,
    commands: Array,
    feet: Array,
    com: Array,
    velocity: Array,
) -> None:
    """Write the expected step for each command.

    Args:
        weights, state, swing_pair: as for :func:`mean_table`.
        commands: (m, 3) vx, vy [m/s], yaw rate [rad/s].
        feet: (m, 4, 3) written: displacement of each foot, base frame [m], zero for stance feet.
        com: (m, 4) written: x, y, z [m] and yaw [rad], base frame.
        velocity: (m, 3) written: vx, vy [m/s], yaw rate [rad/s] after the step.
    """
    table, m, out = np.empty((MONOMIALS, OUTPUTS)), np.empty(MONOMIALS), np.empty(OUTPUTS)
    count = mean_table(weights, state, swing_pair, table)
    front, hind = _PAIRS[swing_pair, 0], _PAIRS[swing_pair, 1]
    for n in range(commands.shape[0]):
        mean(table, count, commands, n, swing_pair, m, out)
        feet[n] = 0.0
        for axis in range(3):
            feet[n, front, axis] = out[axis]
            feet[n, hind, axis] = out[3 + axis]
            velocity[n, axis] = out[VELOCITY + axis]
        for axis in range(4):
            com[n, axis] = out[COM + axis]


@kernel
def scale_table(covariance: Array, model: int, state: Array, swing_pair: int, table: Array) -> None:
    """Write V of one model, what the state makes of the covariance of each two monomials' weights.

    Args:
        covariance: (k, 25 or 325, 25 or 325) of the first k models of MotionModel: FDM, CDM, CVM; design sorted by
            :func:`design_order`.
        model: index of the model.
        state, swing_pair: as for :func:`mean_table`.
        table: (MONOMIALS, MONOMIALS); for degree 1 the first four rows and columns are written.
    """
    size = covariance.shape[1]
    degree = 1 if size == 1 + _INPUTS else 2
    count = 4 if degree == 1 else MONOMIALS
    z = _state_terms(state, swing_pair, degree)
    product = np.empty(size)
    row = 0
    for c in range(count):
        product[:] = 0.0
        for i in range(_segment(c, degree)):
            for g in range(size):
                product[g] += z[i] * covariance[model, row, g]
            row += 1
        g = 0
        for k in range(count):
            total = 0.0
            for i in range(_segment(k, degree)):
                total += product[g] * z[i]
                g += 1
            table[c, k] = total


@kernel
def scale(table: Array, count: int, m: Array) -> float:
    """By how much a model's noise covariance is to be multiplied, 1 + mᵀ·V·m."""
    spread = 0.0
    for c in range(count):
        inner = 0.0
        for k in range(count):
            inner += table[c, k] * m[k]
        spread += m[c] * inner
    return 1.0 + max(spread, 0.0)  # rounding may take a zero below zero


@kernel
def predict_scale(covariance: Array, state: Array, swing_pair: int, commands: Array, scales: Array) -> None:
    """Write by how much the noise covariance of each model is to be multiplied, 1 + [1, φ]ᵀ·Σ·[1, φ].

    Args:
        covariance, state, swing_pair: as for :func:`scale_table`.
        commands: (m, 3) as for :func:`predict_mean`.
        scales: (m, ≥ k) written.
    """
    models = covariance.shape[0]
    count = 4 if covariance.shape[1] == 1 + _INPUTS else MONOMIALS
    table, m = np.empty((models, MONOMIALS, MONOMIALS)), np.empty(MONOMIALS)
    for model in range(models):
        scale_table(covariance, model, state, swing_pair, table[model])
    for n in range(commands.shape[0]):
        _monomials(commands, n, swing_pair, count, m)
        for model in range(models):
            scales[n, model] = scale(table[model], count, m)


@kernel
def predict_std(
    covariance: Array,
    noise_std: Array,
    state: Array,
    swing_pair: int,
    commands: Array,
    feet_std: Array,
    com_std: Array,
    velocity_std: Array,
) -> None:
    """Write the standard deviations that belong to :func:`predict_mean`, in the same shapes and units.

    ``noise_std`` is (13,), the other inputs are as for :func:`predict_scale`.
    """
    scales = np.empty((commands.shape[0], 3))
    predict_scale(covariance, state, swing_pair, commands, scales)
    front, hind = _PAIRS[swing_pair, 0], _PAIRS[swing_pair, 1]
    for n in range(commands.shape[0]):
        foot, com, velocity = np.sqrt(scales[n, 0]), np.sqrt(scales[n, 1]), np.sqrt(scales[n, 2])
        feet_std[n] = 0.0
        for axis in range(3):
            feet_std[n, front, axis] = noise_std[axis] * foot
            feet_std[n, hind, axis] = noise_std[3 + axis] * foot
            velocity_std[n, axis] = noise_std[VELOCITY + axis] * velocity
        for axis in range(4):
            com_std[n, axis] = noise_std[COM + axis] * com


@kernel
def predict(
    weights: Array,
    covariance: Array,
    noise_std: Array,
    state: Array,
    swing_pair: int,
    commands: Array,
    feet: Array,
    com: Array,
    velocity: Array,
) -> bool:
    """Write means and standard deviations at once; False, and nothing written, where a command is not finite.

    The last three are as for :func:`predict_mean`, each with an axis before the others: 0 mean, 1 standard deviation.
    """
    for n in range(commands.shape[0]):
        for axis in range(3):
            if not np.isfinite(commands[n, axis]):
                return False
    predict_mean(weights, state, swing_pair, commands, feet[0], com[0], velocity[0])
    predict_std(covariance, noise_std, state, swing_pair, commands, feet[1], com[1], velocity[1])
    return True
