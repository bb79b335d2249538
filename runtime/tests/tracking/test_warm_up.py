from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from legtool_runtime.tracking.model import TrackedRobot

#: Counts the compiled signatures of all kernels before and after a walk that begins after the warm-up.
SCRIPT = """
import json, sys
import numpy as np
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.gaits import GaitTiming, plan_from_gait
from legtool_runtime.tracking.model import TrackedRobot
from legtool_runtime.tracking.tracker import MeasuredState, Tracker
from legtool_runtime.tracking.warm_up import warm_up

def compiled():
    kernels = {
        id(value): len(value.signatures)
        for name, module in list(sys.modules.items()) if name.startswith("legtool_runtime")
        for value in vars(module).values() if hasattr(value, "signatures")
    }
    return sum(kernels.values())

robot = TrackedRobot.from_dict(json.load(open(sys.argv[1])))
before = compiled()
warm_up(robot)
warm = compiled()
angles, _ = robot.geometry.joints(robot.geometry.stance)
places = robot.geometry.stance - [0, 0, robot.geometry.stance[0, 2]]
footholds = [[np.add(place, (0.05 * k, 0, 0)) for k in range(3)] for place in places]
for elevation in (None, HeightMap(np.zeros((90, 80), np.float32), 0.04, np.zeros(2))):
    tracker = Tracker(robot, plan_from_gait(GaitTiming.crawl(), footholds, start_s=0.05), elevation=elevation)
    for tick in range(500):
        state = MeasuredState(
            np.array([0, 0, robot.geometry.standing_height]), np.array([1.0, 0, 0, 0]), angles, np.zeros(18),
            np.full(4, 40.0) if tick > 200 else np.array([40.0, 40.0, 0.0, 40.0]),
        )
        tracker.step(state, 0.0025 * tick)
print(json.dumps([before, warm, compiled(), len(tracker.landings)]))
"""


def test_a_walk_compiles_nothing_after_the_warm_up(tracked: TrackedRobot, tmp_path: Path) -> None:
    path = tmp_path / "robot.json"
    path.write_text(json.dumps(tracked.to_dict()))
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(path)], capture_output=True, text=True, timeout=300, check=True
    )
    before, warm, after, landings = json.loads(done.stdout)
    assert landings > 0
    assert before < warm == after
