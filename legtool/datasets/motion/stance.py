"""How feet that should stand move all the same: rolling, slip, or lengths, legs and clocks that do not fit the log."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from legtool.datasets.logs.checks.stance import StanceMotion
from legtool_runtime.robot import LEGS, TROT_PAIRS

Array = NDArray[np.float64]

#: Steps shorter than this [m], and with less turning than this [rad], say nothing.
TRAVEL, TURN = 0.03, 0.04
#: By pair that stands: its left foot and its right one, its front foot and its hind one, as places in the pair.
_LEFT_RIGHT = ((0, 1), (1, 0))
_FRONT_HIND = ((0, 1), (0, 1))


def stance_motion(table: pa.Table) -> StanceMotion:
    """Measure the motion of stance feet over all steps of a table of transitions, whatever their status."""
    if not table.num_rows:
        return StanceMotion(0, 0.0, 0.0, 0, 0.0, 0.0)
    swing = table.column("swing_pair").to_numpy()
    feet = np.stack(
        [
            np.stack([table.column(f"foot_{leg.lower()}_displacement_{axis}").to_numpy() for axis in "xy"], axis=1)
            for leg in LEGS
        ],
        axis=1,
    )
    travel = np.stack([table.column(f"com_displacement_{axis}").to_numpy() for axis in "xy"], axis=1)
    turn = table.column("com_displacement_yaw").to_numpy()
    stands = 1 - swing  # the pair that did not swing
    moved = feet[np.arange(len(feet))[:, None], np.array(TROT_PAIRS)[stands]]
    far = np.linalg.norm(travel, axis=1) > TRAVEL
    along = (moved.mean(axis=1)[far] * travel[far]).sum(axis=1) / (travel[far] ** 2).sum(axis=1)
    turns = np.abs(turn) > TURN
    rows = np.arange(len(feet))
    sides, ends = np.array(_LEFT_RIGHT)[stands], np.array(_FRONT_HIND)[stands]
    apart_x = moved[rows, sides[:, 0], 0] - moved[rows, sides[:, 1], 0]
    apart_y = moved[rows, ends[:, 0], 1] - moved[rows, ends[:, 1], 1]
    middle = float(np.median(along)) if far.any() else 0.0
    return StanceMotion(
        int(far.sum()),
        middle,
        float(np.median(np.abs(along - middle))) if far.any() else 0.0,
        int(turns.sum()),
        float(np.median(apart_x[turns] / turn[turns])) if turns.any() else 0.0,
        float(np.median(apart_y[turns] / turn[turns])) if turns.any() else 0.0,
    )
