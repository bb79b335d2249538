"""How far predicted footholds stray, the further ahead the more: from the models' noise, propagated along the horizon.

Linear models carry an error e of (CoM velocity, previous velocity, feet relative to the CoM, CoM) from step to step as
e' = F·e + w, where F follows from equations 3-5 and w is the models' noise. Since F does not depend on the command,
the spread of a touchdown depends on the number of steps alone; by mirror symmetry not on the pair either. A
second-order model is linearised about standing. Errors of the heading itself are left out: over one step they move a
foot by millimetres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.motion import kernels
from legtool_runtime.motion.features import FEET, PREVIOUS_VELOCITY, VELOCITY
from legtool_runtime.motion.model import MotionModel
from legtool_runtime.robot import TROT_PAIRS

Array = NDArray[np.float64]

_INPUTS = np.r_[VELOCITY, PREVIOUS_VELOCITY, FEET]  # features that carry errors
_V, _PREVIOUS, _FEET, _COM = slice(0, 3), slice(3, 6), slice(6, 18), slice(18, 21)


def touchdown_variance(model: MotionModel, stance: Array, *, horizon: int) -> tuple[Array, Array]:
    """Variance of the touchdowns ahead, in the plane, in the direction in which it is greatest.

    Args:
        model: the motion models.
        stance: (4, 3) feet when standing, base frame [m]; only a second-order model depends on it.
        horizon: steps.

    Returns:
        (horizon, 2) of the front and hind foot that swings in each step, world position given today's state [m²];
        (2,) the same for the noise of one step alone [m²], which grows with the model's own uncertainty.
    """
    noise = [model.parameters[f"{name}.noise_covariance"] for name in ("fdm", "cdm", "cvm")]
    covariance = np.zeros((21, 21))
    spread = np.empty((horizon, 2))
    for step in range(horizon):
        pair = step % 2
        transition, disturbance = _error_step(model, stance, pair)
        sign = [_mirror(q.shape[0], pair) for q in noise]
        covariance = transition @ covariance @ transition.T
        for gain, q, s in zip(disturbance, noise, sign, strict=True):
            covariance += (
                gain @ (q[: gain.shape[1], : gain.shape[1]] * np.outer(s, s)[: gain.shape[1], : gain.shape[1]]) @ gain.T
            )
        for side, leg in enumerate(TROT_PAIRS[pair]):
            to_world = np.zeros((2, 21))
            to_world[:, _COM.start : _COM.start + 2] = np.eye(2)
            to_world[:, _FEET.start + 3 * leg : _FEET.start + 3 * leg + 2] = np.eye(2)
            spread[step, side] = np.linalg.eigvalsh(to_world @ covariance @ to_world.T)[-1]
    single = np.array(
        [np.linalg.eigvalsh(noise[0][3 * side : 3 * side + 2, 3 * side : 3 * side + 2])[-1] for side in (0, 1)]
    )
    return spread, single


def _mirror(outputs: int, pair: int) -> Array:
    sign = {6: [1, -1, 1, 1, -1, 1], 4: [1, -1, 1, -1], 3: [1, -1, -1]}[outputs]
    return np.array(sign, dtype=np.float64) if pair == 1 else np.ones(outputs)


def _error_step(model: MotionModel, stance: Array, pair: int) -> tuple[Array, tuple[Array, Array, Array]]:
    """F (21, 21), and the gains of the noise of FDM (21, 6), CDM (21, 3: yaw left out) and CVM (21, 3)."""
    feet, com, velocity = _jacobian(model, stance, pair)
    transition = np.zeros((21, 21))
    transition[_V, :18] = velocity
    transition[_PREVIOUS, _V] = np.eye(3)
    transition[_FEET, _FEET] = np.eye(12)
    transition[_COM, _COM] = np.eye(3)
    transition[_COM, :18] += com[:3]
    to_feet, to_com, to_velocity = np.zeros((21, 6)), np.zeros((21, 3)), np.zeros((21, 3))
    to_velocity[_V] = np.eye(3)
    to_com[_COM] = np.eye(3)
    for leg in range(4):
        rows = slice(_FEET.start + 3 * leg, _FEET.start + 3 * leg + 3)
        transition[rows, :18] += feet[leg] - com[:3]
        to_com[rows] = -np.eye(3)
        if leg in TROT_PAIRS[pair]:
            side = TROT_PAIRS[pair].index(leg)
            to_feet[rows, 3 * side : 3 * side + 3] = np.eye(3)
    return transition, (to_feet, to_com, to_velocity)


def _jacobian(model: MotionModel, stance: Array, pair: int) -> tuple[Array, Array, Array]:
    """Derivatives of foot displacement (4, 3, 18), CoM displacement (4, 18) and velocity (3, 18) about standing."""
    step = 1e-3
    out = np.zeros((4, 3, 18)), np.zeros((4, 18)), np.zeros((3, 18))
    command = np.zeros((1, 3))
    for column, index in enumerate(_INPUTS):
        values = []
        for change in (step, -step):
            features = np.zeros(24)
            features[FEET] = np.asarray(stance).ravel()
            features[index] += change
            feet, com, velocity = np.empty((1, 4, 3)), np.empty((1, 4)), np.empty((1, 3))
            kernels.predict_mean(model.packed[0], features, pair, command, feet, com, velocity)
            values.append((feet[0], com[0], velocity[0]))
        for derivative, plus, minus in zip(out, *values, strict=True):
            derivative[..., column] = (plus - minus) / (2 * step)
    return out
