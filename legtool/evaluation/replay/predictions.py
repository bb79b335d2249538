"""What motion models predicted of a recorded walk against what happened: one step ahead, and several."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from legtool.datasets.motion.samples import MotionData, motion_data
from legtool.datasets.motion.steps import COM_DISPLACEMENT, FOOT_DISPLACEMENT, OK, POSE
from legtool.models.motion import Z90, predict_frozen
from legtool_runtime.motion.features import FEATURES, FEET, PREVIOUS_REFERENCE, PREVIOUS_VELOCITY, REFERENCE, TARGETS
from legtool_runtime.motion.features import VELOCITY as NOW
from legtool_runtime.motion.model import MotionModel, MotionState
from legtool_runtime.motion.planning.uncertainty import touchdown_variance
from legtool_runtime.robot import TROT_PAIRS, Robot
from legtool_runtime.rotations import about_z

Array = NDArray[np.float64]

#: Steps follow each other if one begins within this of the end of the one before [ns].
_NEXT_NS = 1_000_000


@dataclass(frozen=True, eq=False)
class OneStep:
    """Predictions of single steps, for the canonical pair.

    Attributes:
        steps: that were predicted.
        error: by model, prediction minus measurement (n, k), units of TARGETS.
        inside: by model, whether the measurement lies in the prediction's 90 % interval (n, k).
    """

    steps: MotionData
    error: dict[str, Array]
    inside: dict[str, NDArray[np.bool_]]


@dataclass(frozen=True, eq=False)
class Ahead:
    """Predictions of the h-th step after a state, from that state and the commands alone.

    Attributes:
        start: (n,) rows of the table at which they begin.
        com: (n, h, 2) error of the CoM's place, along and across the heading at the start [m].
        feet: (n, h, 2, 2) the same of the touchdowns of the front and hind swing foot.
        spread: (h, 2) standard deviation of these by the models, in the direction in which it is greatest [m].
        predicted: (n, 2, 3) touchdowns of the first step, world frame [m].
        actual: (n, 2, 3) where these feet came down.
        legs: (n, 2) which feet.
        stamps_ns: (n,) when, about.
    """

    start: NDArray[np.intp]
    com: Array
    feet: Array
    spread: Array
    predicted: Array
    actual: Array
    legs: NDArray[np.intp]
    stamps_ns: NDArray[np.int64]


def one_step(table: pa.Table, model: MotionModel) -> OneStep:
    """Predict each usable step of a table of transitions from its own state."""
    steps = motion_data(table)
    error, inside = {}, {}
    for name in TARGETS:
        mean, std = predict_frozen(frozen_of(model, name), steps.features)
        error[name] = mean - steps.targets[name]
        inside[name] = np.abs(error[name]) <= Z90 * std
    return OneStep(steps, error, inside)


def frozen_of(model: MotionModel, name: str) -> dict[str, Any]:
    """The parameters of one of a bundle's models, as :func:`.predict_frozen` takes them."""
    prefix = f"{name}."
    frozen: dict[str, Any] = {
        key.removeprefix(prefix): value for key, value in model.parameters.items() if key.startswith(prefix)
    }
    return {**frozen, "degree": np.array(model.degree)}


def several_steps(table: pa.Table, model: MotionModel, robot: Robot, horizon: int) -> Ahead:
    """Predict ``horizon`` steps from each state that so many usable steps follow, by the commands that were given."""
    usable = np.asarray(table["status"].to_pylist(), dtype=object) == OK
    stamps = table["stamp_ns"].to_numpy().astype(np.int64)
    block = {name: np.asarray(table[name].to_numpy(), dtype=np.float64) for name in (*FEATURES, *POSE, "duration_s")}
    ends = stamps + np.round(np.nan_to_num(block["duration_s"]) * 1e9).astype(np.int64)
    episode = np.array(table["episode"].to_pylist(), dtype=object)
    follows = np.zeros(len(stamps), dtype=np.bool_)
    follows[:-1] = usable[1:] & (np.abs(stamps[1:] - ends[:-1]) <= _NEXT_NS) & (episode[1:] == episode[:-1])
    whole = usable.copy()
    for k in range(1, horizon):
        whole[: len(whole) - k] &= follows[k - 1 : len(follows) - 1]
        whole[max(len(whole) - k, 0) :] = False
    start = np.flatnonzero(whole)
    features = np.column_stack([block[name] for name in FEATURES])
    pose = np.column_stack([block[name] for name in POSE])
    moved = _columns(table, FOOT_DISPLACEMENT).reshape(-1, 4, 3)
    com = _columns(table, COM_DISPLACEMENT)
    pair = table["swing_pair"].to_numpy().astype(int)
    errors_com, errors_feet = np.empty((len(start), horizon, 2)), np.empty((len(start), horizon, 2, 2))
    predicted, actual = np.empty((len(start), 2, 3)), np.empty((len(start), 2, 3))
    for n, row in enumerate(start):
        place, yaw = pose[row, :3].copy(), float(pose[row, 3])
        back = about_z(-yaw)
        state = MotionState(
            features[row, NOW], features[row, PREVIOUS_VELOCITY], features[row, PREVIOUS_REFERENCE],
            features[row, FEET].reshape(4, 3), int(pair[row]),
        )  # fmt: skip
        for k in range(horizon):
            here, legs = row + k, list(TROT_PAIRS[pair[row + k]])
            command = features[here, REFERENCE]
            step = model.predict(state, command[None])
            down = place + (state.feet_base[legs] + step.foot_displacement[0, legs]) @ about_z(yaw).T
            true_turn = about_z(pose[here, 3])
            true_down = pose[here, :3] + (features[here, FEET].reshape(4, 3)[legs] + moved[here, legs]) @ true_turn.T
            if k == 0:
                predicted[n], actual[n] = down, true_down
            errors_feet[n, k] = ((down - true_down) @ back.T)[:, :2]
            shift, turn = step.com_displacement[0, :3], float(step.com_displacement[0, 3])
            place, was = place + about_z(yaw) @ shift, yaw
            yaw += turn
            there = pose[here, :3] + true_turn @ com[here, :3]
            errors_com[n, k] = (back @ (place - there))[:2]
            feet = (state.feet_base + step.foot_displacement[0] - shift) @ about_z(was - yaw).T
            state = MotionState(step.velocity[0], state.velocity, command, feet, 1 - state.swing_pair)
    feet_of = np.array(TROT_PAIRS)
    variance, _ = touchdown_variance(model, robot.stance, horizon=horizon)
    return Ahead(
        start, errors_com, errors_feet, np.sqrt(variance), predicted, actual, feet_of[pair[start]], ends[start]
    )


def _columns(table: pa.Table, names: tuple[str, ...]) -> Array:
    return np.column_stack([np.asarray(table[name].to_numpy(), dtype=np.float64) for name in names])
