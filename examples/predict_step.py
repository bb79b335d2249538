"""Predict what the robot will do in its next step, for many commands at once.

python examples/predict_step.py [BUNDLE]      # by default a small one of Go2 under the built-in trot, beside this file
"""

import sys
from pathlib import Path

import numpy as np

import legtool_runtime


def main(path: str) -> None:
    """Print where the front left foot of a standing robot will land, for eleven forward commands."""
    bundle = legtool_runtime.load_bundle(path)
    bundle.warm_up()
    rest = np.zeros(3)
    state = legtool_runtime.MotionState(
        velocity=rest, previous_velocity=rest, previous_reference=rest, feet_base=bundle.robot.stance, swing_pair=0
    )
    commands = [[vx, 0.0, 0.0] for vx in np.arange(0.0, 1.01, 0.1)]
    step = bundle.motion.predict(state, commands)
    print(f"{bundle}\nvx [m/s]  foot [m]  ± 90 %  CoM [m]  next vx [m/s]")
    for index, (vx, _, _) in enumerate(commands):
        foot, spread = step.foot_displacement[index, 0, 0], 1.645 * step.foot_displacement_std[index, 0, 0]
        com, speed = step.com_displacement[index, 0], step.velocity[index, 0]
        print(f"{vx:8.1f}  {foot:8.3f}  {spread:6.3f}  {com:7.3f}  {speed:13.3f}")


if __name__ == "__main__":
    try:
        main(sys.argv[1] if len(sys.argv) > 1 else str(Path(__file__).parent / "bundle"))
    except legtool_runtime.errors.LegtoolError as error:
        sys.exit(f"error: {error}")
