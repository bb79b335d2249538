"""The public policies EM-RL and EM-DTC on flat ground, beside what a prototype and the tasks ask for.

    python benchmarks/anymal_policies.py --em-rl anymal_c_em_rl.pt --em-dtc anymal_d_dtc_stones.pt

Each stands (trots in place) for 60 s, walks at 0.4 m/s for 20 s and turns by 0.4 and -0.4 rad/s for 20 s, once with the
true state and once with the sweep's errors of it. Speeds and rates are means after the first 5 s. Nothing is searched
for: gains, clocks and lengths are those of docs/arena.md. Beside EM-DTC alone: EM-DTC with the held heading of its row.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from legtool.configs.mjcf import MjcfNames
from legtool.configs.robots import load_robot
from legtool.configs.sweep import CONTROL_RATE_HZ, Noise
from legtool.sim.controllers.anymal.em_dtc import EmDtcController
from legtool.sim.controllers.anymal.em_rl import EmRlController
from legtool.sim.robots.mjcf import find_mjcf, load_mjcf
from legtool.sim.robots.robot import SimRobot, build_robot
from legtool.sim.walks.simulation import Simulation
from legtool_runtime.rotations import rotation_of, yaw_of
from legtool_runtime.tracking.gait_tracker import Guidance
from legtool_runtime.tracking.selectors import any_place

TASKS = {
    "stand 60 s": ((0.0, 0.0, 0.0), 60.0),
    "0.4 m/s": ((0.4, 0.0, 0.0), 20.0),
    "turn 0.4": ((0.0, 0.0, 0.4), 20.0),
    "turn -0.4": ((0.0, 0.0, -0.4), 20.0),
}
#: What the prototype measured with the same policies in MuJoCo on ANYmal C, at 1 ms, without errors.
PROTOTYPE = {
    ("em_rl", "stand 60 s"): "drift 0.45 m, +0.30 rad, tilt <= 3.8 deg",
    ("em_rl", "0.4 m/s"): "0.401 m/s, sideways 0.010, 46 Nm",
    ("em_rl", "turn 0.4"): "0.41 rad/s",
    ("em_rl", "turn -0.4"): "-0.40 rad/s",
    ("em_dtc", "stand 60 s"): "-0.058 m/s, -0.095 rad/s",
    ("em_dtc", "0.4 m/s"): "0.445 m/s",
    ("em_dtc", "turn 0.4"): "0.335 rad/s",
}
FROM_S = 5.0


class Walked(NamedTuple):
    """What came of a task, in SI units but for ``tilt`` [deg] and ``tick_ms``, which is a tick with its physics."""

    fell_s: float
    drift: float
    turned: float
    velocity: np.ndarray
    rate: float
    height: float
    tilt: float
    most_nm: float
    tick_ms: float


def walk(robot: SimRobot, controller, command, duration_s: float, *, noise: Noise | None, held: bool) -> Walked:
    ticks = round(duration_s * CONTROL_RATE_HZ)
    simulation = Simulation(robot, controller, ticks=ticks, noise=noise, rng=np.random.default_rng(1000))
    simulation.begin()
    places, yaws, tilt, most, fell, integral, busy = [], [], 0.0, 0.0, np.inf, 0.0, 0.0
    for k in range(ticks):
        simulation.observe()
        rotation = rotation_of(simulation.state.orientation)
        yaws.append(float(yaw_of(rotation)))
        places.append(simulation.data.qpos[robot.base_qpos : robot.base_qpos + 3].copy())
        tilt = max(tilt, float(np.arccos(np.clip(rotation[2, 2], -1.0, 1.0))))
        vx, vy, rate = command
        if held:  # the gains of legtool.sim.walks.operators.HeldHeading
            off = float(np.angle(np.exp(1j * (rate * k / CONTROL_RATE_HZ - yaws[-1]))))
            integral = float(np.clip(integral + 0.1 * off / CONTROL_RATE_HZ, -0.2, 0.2))
            rate = rate + 0.5 * off + integral
        began = time.perf_counter()
        simulation.act(Guidance((vx, vy, rate), any_place(None)))
        busy += time.perf_counter() - began
        most = max(most, float(np.abs(simulation.torque).max()))
        if simulation.fallen():
            fell = k / CONTROL_RATE_HZ
            break
    at, yaw = np.array(places), np.unwrap(yaws)
    first = min(round(FROM_S * CONTROL_RATE_HZ), len(at) - 2)
    lasted = (len(at) - 1 - first) / CONTROL_RATE_HZ
    way = (at[-1] - at[first])[:2] / lasted
    rate = (yaw[-1] - yaw[first]) / lasted
    # In the heading of the middle of what is measured: a robot that turns as it walks walks an arc.
    middle = 0.5 * (yaw[-1] + yaw[first])
    c, s = np.cos(middle), np.sin(middle)
    velocity = np.array([c * way[0] + s * way[1], c * way[1] - s * way[0]])
    return Walked(
        fell, float(np.hypot(*(at[-1] - at[0])[:2])), float(yaw[-1] - yaw[0]), velocity, float(rate),
        float(at[first:, 2].mean()), float(np.degrees(tilt)), most, 1e3 * busy / len(at),
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--em-rl", type=Path)
    parser.add_argument("--em-dtc", type=Path)
    parser.add_argument("--robot", default="example_robot_data:anymal_c", help="as --mjcf; or 'primitives'")
    options = parser.parse_args()
    settings = load_robot("anymal_c")
    if options.robot == "primitives":
        robot = build_robot(settings)
    else:
        robot = load_mjcf(find_mjcf(options.robot), MjcfNames(standing_height=settings.standing_height))
    print(f"{options.robot}: {robot.mass:.1f} kg, flat ground, friction 0.8")
    rows = [("em_rl", EmRlController, options.em_rl, False), ("em_dtc", EmDtcController, options.em_dtc, False),
            ("em_dtc, held", EmDtcController, options.em_dtc, True)]  # fmt: skip
    for name, kind, path, held in rows:
        if path is None:
            continue
        controller = kind(robot, path)
        for task, (command, duration_s) in TASKS.items():
            for state, noise in (("true state", None), ("errors", Noise())):
                got = walk(robot, controller, command, duration_s, noise=noise, held=held)
                fell = "no fall" if np.isinf(got.fell_s) else f"fell at {got.fell_s:.1f} s"
                print(
                    f"{name:13} {task:10} {state:10}: {fell}, drift {got.drift:.2f} m {got.turned:+.2f} rad, "
                    f"v {got.velocity[0]:+.3f} {got.velocity[1]:+.3f} m/s, yaw {got.rate:+.3f} rad/s, height "
                    f"{got.height:.3f} m, tilt {got.tilt:.1f} deg, {got.most_nm:.0f} Nm, {got.tick_ms:.3f} ms a tick"
                    f" | prototype: {PROTOTYPE.get((name, task), '-')}"
                )


if __name__ == "__main__":
    main()
