"""The planner and the range of commands that its models were fitted to."""

import numpy as np
import walker

from legtool_runtime.motion.features import FEATURES, REFERENCE
from legtool_runtime.motion.model import MotionModel
from legtool_runtime.motion.planning.planner import Planner


def test_the_planner_leaves_out_commands_that_the_models_never_saw():
    limits = np.tile([-1.0, 1.0], (len(FEATURES), 1))
    limits[REFERENCE] = [[0.1, 0.5], [0.0, 0.0], [0.0, 0.0]]
    known = MotionModel(walker.parameters(), degree=1, instant="full_stance_end", limits=limits)
    planner = Planner(known, walker.ROBOT)
    assert planner.commands[:, 0].round(1).tolist() == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]  # to stand is always allowed
    assert planner.left_out[:, 0].round(1).tolist() == [0.6, 0.7, 0.8, 0.9, 1.0]
    bold = Planner(known, walker.ROBOT, extrapolate=True)
    assert len(bold.commands) == 11 and len(bold.left_out) == 0
    unknown = MotionModel(walker.parameters(), degree=1, instant="full_stance_end")
    assert len(Planner(unknown, walker.ROBOT).commands) == 11
