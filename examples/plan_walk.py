"""Plan velocity commands over a gap, on a map that the caller provides.

python examples/plan_walk.py [BUNDLE]      # by default a small one of Go2 under the built-in trot, beside this file
"""

import sys
from pathlib import Path

import numpy as np

import legtool_runtime
from legtool_runtime.motion.planning.planner import Goal, Planner, PlannerSettings
from legtool_runtime.terrain import HeightMap, foot_costmap


def main(path: str) -> None:
    """Plan for a robot that walks at 0.4 m/s towards a gap of 12 cm, half a metre ahead, and print the plan."""
    bundle = legtool_runtime.load_bundle(path)
    heights = np.zeros((200, 100), np.float32)  # 4 m × 2 m at 2 cm; x forward, y left
    heights[140:146] = -0.5
    costmap = foot_costmap(HeightMap(heights, 0.02, (0.0, 0.0)))
    planner = Planner(bundle.motion, bundle.robot, settings=PlannerSettings(horizon=5))
    planner.warm_up()
    walking = [0.4, 0.0, 0.0]
    state = legtool_runtime.MotionState(
        velocity=walking,
        previous_velocity=walking,
        previous_reference=walking,
        feet_base=bundle.robot.stance,
        swing_pair=0,
    )
    plan = planner.plan(
        state,
        costmap,
        position=[0.3, 0.0, bundle.robot.standing_height],
        rotation=np.eye(3),
        goal=Goal(1.8, 0.0),
    )
    print(f"{plan.status} {plan.reason} in {1e3 * plan.planning_time_s:.2f} ms")
    for command, feet, clearance in zip(plan.commands, plan.touchdowns, plan.clearance, strict=True):
        where = f"touchdowns at x {feet[0, 0]:.2f}, {feet[1, 0]:.2f} m"
        print(f"vx {command[0]:.1f} m/s  {where}, clear by {clearance.min():.2f} m")


if __name__ == "__main__":
    try:
        main(sys.argv[1] if len(sys.argv) > 1 else str(Path(__file__).parent / "bundle"))
    except legtool_runtime.errors.LegtoolError as error:
        sys.exit(f"error: {error}")
