"""The first plan compiles nothing that the warm-up has not."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

#: Counts the compiled signatures of all kernels before and after plans over stones that begin after the warm-up.
SCRIPT = """
import json, sys
sys.path[:0] = sys.argv[2:]
import numpy as np
from stones_and_bodies import BODIES
from true_regions import rectangle, regions_of
from legtool_runtime.search.pips import Pips
from legtool_runtime.search.settings import PipsSettings
from legtool_runtime.terrain.elevation import HeightMap

def compiled():
    kernels = {
        id(value): len(value.signatures)
        for name, module in list(sys.modules.items()) if name.startswith("legtool_runtime")
        for value in vars(module).values() if hasattr(value, "signatures")
    }
    return sum(kernels.values())

robot = BODIES["anymal_c"][0]
pips = Pips(robot, PipsSettings.of(robot, sys.argv[1]))
before = compiled()
pips.warm_up()
warm = compiled()
rng = np.random.default_rng(0)
tops = [rectangle((x, y, rng.uniform(-0.03, 0.03)), (0.15, 0.15))
        for x in np.arange(0.65, 2.0, 0.2) for y in np.arange(-0.9, 0.95, 0.2) if rng.random() < 0.75]
regions = regions_of([rectangle((-0.7, 0, 0), (2.4, 2.4)), *tops])
feet, plan, steps = robot.stance * [1.0, 1.0, 0.0], None, 0
ground = HeightMap(np.zeros((90, 80), np.float32), 0.04, np.zeros(2))
for frame in range(12):
    answer = pips.plan(
        regions, position=[0, 0, 0.55], yaw=0.0, feet=feet, goal=(3.0, 0.0), time_s=0.1 * frame, plan=plan,
        goal_yaw=0.0 if frame % 2 else None, elevation=ground if frame % 3 else None,
    )
    if answer.feet is not None and len(answer.feet):
        steps += 1
        pips.refuse(answer.feet.positions[0], answer.feet.positions[1], 0.1 * frame)
    plan = answer.plan
print(json.dumps([before, warm, compiled(), steps]))
"""


@pytest.mark.parametrize("mode", ["walkable", "paper"])
def test_a_plan_compiles_nothing_after_the_warm_up(mode):
    here = Path(__file__).parent
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, mode, str(here), str(here.parent / "tracking")],
        capture_output=True, text=True, timeout=600, check=True,
    )  # fmt: skip
    before, warm, after, steps = json.loads(done.stdout)
    assert before < warm == after
    assert steps > 0 or mode == "paper"
