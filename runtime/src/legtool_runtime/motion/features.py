"""Inputs and outputs of the motion models, in one order for training and robot (motion paper, equations 1-5).

One model serves both swing pairs: a step of the pair FR+RL is mirrored left-right into a step of FL+RR, the canonical
pair. Mirroring swaps left and right legs and changes the sign of every y and yaw component.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.robot import LEGS, MIRROR, TROT_PAIRS
from legtool_runtime.rotations import about_z, yaw_of

Array = NDArray[np.float64]

_PLANAR = ("x", "y", "yaw")
#: x_FDM of equation 2, in order: CoM velocity at t and t-1, reference at t and t-1, feet relative to the CoM.
FEATURES = (
    *(
        f"{group}_{axis}"
        for group in ("velocity", "previous_velocity", "reference", "previous_reference")
        for axis in _PLANAR
    ),
    *(f"foot_{leg.lower()}_{axis}" for leg in LEGS for axis in "xyz"),
)
FEATURE_UNITS = tuple(
    "m" if name.startswith("foot") else "rad/s" if name.endswith("yaw") else "m/s" for name in FEATURES
)
VELOCITY, PREVIOUS_VELOCITY, REFERENCE, PREVIOUS_REFERENCE = (slice(3 * i, 3 * i + 3) for i in range(4))
FEET = slice(12, 24)

#: Outputs of each model for the canonical pair, base frame at t.
TARGETS = {
    "fdm": tuple(f"{foot}_{axis}" for foot in ("front", "hind") for axis in "xyz"),  # swing feet, equation 3
    "cdm": ("x", "y", "z", "yaw"),  # CoM displacement, equation 4, and the change of yaw
    "cvm": _PLANAR,  # CoM velocity at t+1
}
TARGET_UNITS = {
    "fdm": ("m",) * 6,
    "cdm": ("m", "m", "m", "rad"),
    "cvm": ("m/s", "m/s", "rad/s"),
}

_PLANAR_SIGN = np.array([1.0, -1.0, -1.0])
_POINT_SIGN = np.array([1.0, -1.0, 1.0])
#: Multiplying a feature vector by this, after swapping its legs, mirrors it.
FEATURE_SIGN = np.concatenate([np.tile(_PLANAR_SIGN, 4), np.tile(_POINT_SIGN, 4)])
#: Index that swaps the legs of a feature vector.
FEATURE_SWAP = np.concatenate([np.arange(12), *(12 + 3 * leg + np.arange(3) for leg in MIRROR)])
TARGET_SIGN = {
    "fdm": np.tile(_POINT_SIGN, 2),
    "cdm": np.array([1.0, -1.0, 1.0, -1.0]),
    "cvm": _PLANAR_SIGN,
}


#: Feet whose heights differ by more than this stand on uneven ground [m]; a trot on flat ground stays well below.
UNEVEN_M = 0.03


def as_on_level_ground(feet_base: Array, rotation: Array) -> tuple[Array, Array]:
    """Describe feet on uneven ground as if the ground were level, and return the rotation that belongs to them.

    Models learned on flat ground have only seen a trunk that is nearly level: a trunk that follows the slope of a step
    moves all feet by centimetres in its own frame, and a foot on a step looks like a tilted trunk. On uneven ground the
    feet are therefore expressed in the horizontal frame, at their mean height; on flat ground they are left unchanged.

    Args:
        feet_base: (n, 4, 3) relative to the CoM, base frame [m].
        rotation: (n, 3, 3) base to world.

    Returns:
        Feet (n, 4, 3), and the rotation (n, 3, 3) from their frame to the world.
    """
    feet_level = np.einsum("nij,nlj->nli", rotation, feet_base)
    uneven = np.ptp(feet_level[..., 2], axis=1) > UNEVEN_M
    heading = about_z(yaw_of(rotation))
    feet_level = np.einsum("nji,nlj->nli", heading, feet_level)
    feet_level[..., 2] = feet_level[..., 2].mean(axis=1, keepdims=True)
    return (
        np.where(uneven[:, None, None], feet_level, feet_base),
        np.where(uneven[:, None, None], heading, rotation),
    )


def canonical_features(features: Array, swing_pair: NDArray[np.int8]) -> Array:
    """Mirror the rows in which FR+RL swings.

    Args:
        features: (n, 24) in the order of FEATURES, as measured.
        swing_pair: (n,) index into TROT_PAIRS of the pair that swings from t to t+1.

    Returns:
        (n, 24) as if FL+RR swung in every row.
    """
    mirrored = features[:, FEATURE_SWAP] * FEATURE_SIGN
    return np.where((swing_pair == 1)[:, None], mirrored, features)


def canonical_targets(
    foot_displacement: Array, com_displacement: Array, next_velocity: Array, swing_pair: NDArray[np.int8]
) -> dict[str, Array]:
    """Return the targets of the three models for the canonical pair.

    Args:
        foot_displacement: (n, 4, 3) of every foot, base frame at t [m] (equation 3).
        com_displacement: (n, 4) x, y, z [m] (equation 4) and yaw [rad], base frame at t.
        next_velocity: (n, 3) vx, vy [m/s], yaw rate [rad/s], base frame at t+1.
        swing_pair: (n,) index into TROT_PAIRS.

    Returns:
        Model name to (n, outputs), with columns as in TARGETS.
    """
    legs = np.array(TROT_PAIRS)[swing_pair]  # (n, 2) front, hind
    swing = np.take_along_axis(foot_displacement, legs[:, :, None], axis=1).reshape(-1, 6)
    raw = {"fdm": swing, "cdm": com_displacement, "cvm": next_velocity}
    mirror = (swing_pair == 1)[:, None]
    return {name: np.where(mirror, value * TARGET_SIGN[name], value) for name, value in raw.items()}
