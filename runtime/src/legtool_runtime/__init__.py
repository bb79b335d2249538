"""The part of legtool that runs on the robot: it loads a bundle and plans, without torch.

bundle = legtool_runtime.load_bundle("bundle")
bundle.warm_up()
prediction = bundle.motion.predict(state, commands)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from legtool_runtime.errors import BundleError, LegtoolError, RobotError, StateError
from legtool_runtime.lazy import attributes

if TYPE_CHECKING:
    from legtool_runtime.bundle import Bundle, load_bundle
    from legtool_runtime.motion.model import MotionCovariance, MotionModel, MotionPrediction, MotionState
    from legtool_runtime.robot import Robot

__all__ = [
    "Bundle",
    "BundleError",
    "LegtoolError",
    "MotionCovariance",
    "MotionModel",
    "MotionPrediction",
    "MotionState",
    "Robot",
    "RobotError",
    "StateError",
    "load_bundle",
]

#: Loaded on first use: whoever needs only the errors (the command line's help) does not wait for numba.
_HOMES = {
    "Bundle": "bundle",
    "load_bundle": "bundle",
    "MotionCovariance": "motion.model",
    "MotionModel": "motion.model",
    "MotionPrediction": "motion.model",
    "MotionState": "motion.model",
    "Robot": "robot",
}

__getattr__ = attributes(__name__, _HOMES)
