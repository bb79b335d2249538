"""HyQ in closed loop with footholds that are chosen on the way: small walks, on the true state."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from legtool.configs.robots import load_robot
from legtool.configs.worlds import WorldSettings
from legtool.sim.controllers.tracked import GuidedController
from legtool.sim.controllers.trot.trot import TrotController
from legtool.sim.robots.robot import build_robot
from legtool.sim.robots.state import RobotState
from legtool.sim.walks.contacts import LinkContacts
from legtool.sim.walks.environment import GuidedGait, Observation
from legtool.sim.walks.loop import run, run_trial
from legtool.sim.walks.missteps import Missteps
from legtool.sim.walks.operators import OperatedPlanner, Route
from legtool.sim.walks.postures import Postures
from legtool.sim.walks.simulated import Eyes, SimulatedRobot, Until
from legtool.sim.walks.vital import VitalPlanner
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.mujoco_world import world_spec
from legtool_runtime.foothold import Criteria
from legtool_runtime.foothold.pose_settings import PoseSettings
from legtool_runtime.foothold.selection import FootholdSelector
from legtool_runtime.terrain.settings import ElevationSettings
from legtool_runtime.tracking.gaits import GaitTiming

VPA = PoseSettings()
STEP = {"profile": {"end": 4.0, "stretches": [{"x": -2.0, "height": 0.0}, {"x": 0.7, "height": 0.1}]}}
PIT = {
    "profile": {
        "end": 4.0,
        "stretches": [
            {"x": -2.0, "height": 0.0}, {"x": 0.6, "height": -0.3, "ground": False}, {"x": 0.7, "height": 0.0},
        ],
    }
}  # fmt: skip


def made(parts: dict, *, pose: PoseSettings | None, goal: float, speed: float, timeout_s: float, truth: bool = True):
    world = build_world(WorldSettings(name="short", goal=(goal, 0.0), **parts))
    settings = load_robot("hyq")
    robot = build_robot(settings, world_spec(world))
    timing = GaitTiming.trot_at(speed)
    controller = GuidedController(robot, timing)
    planner = VitalPlanner(
        Route(np.zeros(3), goal, speed), timing, FootholdSelector(Criteria(robot.geometry)),
        pose=pose, elevation=ElevationSettings(),
    )  # fmt: skip
    camera = settings.camera
    assert camera is not None
    environment = SimulatedRobot(
        world, robot, controller, rng=np.random.default_rng(0),
        eyes=Eyes(camera, ElevationSettings() if truth else None), until=Until(timeout_s),
    )  # fmt: skip
    return planner, environment, controller


def walk(
    parts: dict, *, pose: PoseSettings | None = VPA, goal: float = 1.0, speed: float = 0.4, timeout_s: float = 8.0
):
    planner, environment, controller = made(parts, pose=pose, goal=goal, speed=speed, timeout_s=timeout_s)
    missteps, contacts = Missteps(environment), LinkContacts(environment, controller)
    postures = Postures(environment, controller, planner, Criteria(environment.simulation.robot.geometry))
    outcome = run(environment, planner, [missteps, contacts, postures])
    return outcome, environment, controller, missteps, contacts, postures


@pytest.mark.parametrize("pose", [VPA, None], ids=["vital", "tbr"])
def test_a_step_is_climbed_with_feet_where_they_were_chosen(pose: PoseSettings | None) -> None:
    outcome, environment, controller, missteps, contacts, postures = walk(STEP, pose=pose, goal=1.1)
    assert outcome == "goal"
    assert not missteps.found and not contacts.found
    assert environment.simulation.data.qpos[2] > 0.68
    errors = [landing.error_m for landing in controller.tracker.landings]
    assert len(errors) > 8 and np.mean(errors) < 0.005
    assert all(one.choice.by == "safe" for one in controller.gait.chosen if one.phase == 0.0)
    assert min(moment.safe for moment in postures.moments) > 0
    assert any(moment.climbs for moment in postures.moments) and not postures.moments[0].climbs


def test_feet_step_over_a_gap() -> None:
    outcome, _, controller, missteps, _, _ = walk(PIT, goal=1.2)
    assert outcome == "goal" and not missteps.found
    chosen = np.array([one.choice.place.point for one in controller.gait.chosen])
    assert not ((chosen[:, 0] > 0.59) & (chosen[:, 0] < 0.71)).any()


@pytest.mark.parametrize("edge", [0.6, 1.2], ids=["at once", "on the way"])
def test_the_robot_stops_before_a_pit_that_no_foot_steps_over(edge: float) -> None:
    pit = {"x": edge, "height": -0.8, "ground": False}
    wide = {"end": 4.0, "stretches": [{"x": -2.0, "height": 0.0}, pit, {"x": edge + 1.2, "height": 0.0}]}
    outcome, environment, controller, missteps, _, _ = walk({"profile": wide}, goal=edge + 1.8)
    assert outcome == "timeout" and not missteps.found and not controller.tracker.fault
    x, _, z = environment.simulation.data.qpos[:3]
    assert edge - 0.6 < x < edge - 0.3 and z > 0.6


def test_a_controller_of_velocities_refuses_guidance() -> None:
    world = build_world(WorldSettings(name="short", goal=(1.0, 0.0), **STEP))
    robot = build_robot(load_robot("hyq"), world_spec(world))
    timing = GaitTiming.trot_at(0.3)
    planner = VitalPlanner(
        Route(np.zeros(3), 1.0, 0.3), timing, FootholdSelector(Criteria(robot.geometry)), pose=None,
        elevation=ElevationSettings(),
    )  # fmt: skip
    environment = SimulatedRobot(world, robot, TrotController(robot), rng=np.random.default_rng(0))
    assert "guided gaits" in run_trial(environment, planner) and isinstance(
        planner.act(Observation(0.0, RobotState())), GuidedGait
    )


@pytest.mark.parametrize(
    ("position", "yaw", "expected"),
    [
        ((0.0, 0.0), 0.0, (0.3, 0.0, 0.0)),
        ((0.5, 0.1), 0.0, (0.3, -0.06, 0.0)),
        ((0.5, 0.0), 0.1, (0.3 * np.cos(0.1), -0.3 * np.sin(0.1), -0.1)),
        ((0.5, 1.0), 0.0, (0.3, -0.1, 0.0)),
    ],
)
def test_an_operator_holds_the_way_and_the_heading(position, yaw, expected) -> None:
    command = Route(np.zeros(3), 2.0, 0.3).command(np.array([*position, 0.6]), yaw)
    np.testing.assert_allclose(command, expected, atol=1e-12)


def test_an_operator_turns_along_the_way() -> None:
    route = Route(np.zeros(3), 2.0, 0.2, heading=-0.4, turn=0.8)
    vx, vy, rate = route.command(np.array([1.0, 0.0, 0.6]), 0.0)
    np.testing.assert_allclose([vx, vy, rate], [0.2, 0.0, 0.08], atol=1e-12)


def test_a_route_is_walked_without_eyes_by_velocity_commands() -> None:
    state = RobotState()
    state.values[:] = 0.0
    state.values[3] = 1.0
    command = OperatedPlanner(Route(np.zeros(3), 2.0, 0.3)).act(Observation(0.0, state)).values
    np.testing.assert_allclose(command, [0.3, 0.0, 0.0])


#: Counts the compiled signatures of all kernels before and after a walk with eyes that begins after the warm-up.
COMPILED = """
import sys
sys.path.insert(0, sys.argv[1])
import test_vital as t

def compiled():
    kernels = {
        id(value): len(value.signatures)
        for name, module in list(sys.modules.items()) if name.startswith("legtool")
        for value in vars(module).values() if hasattr(value, "signatures")
    }
    return sum(kernels.values())

planner, environment, controller = t.made(t.STEP, pose=t.VPA, goal=1.0, speed=0.4, timeout_s=1.5, truth=False)
for part in (controller, planner, environment):
    part.warm_up()
warm = compiled()
t.run(environment, planner, [])
assert len(controller.tracker.landings) > 3
print(compiled() - warm)
"""


def test_a_walk_with_eyes_compiles_nothing_after_the_warm_up() -> None:
    done = subprocess.run(
        [sys.executable, "-c", COMPILED, str(Path(__file__).parent)], capture_output=True, text=True, timeout=300
    )
    assert done.stdout.split() == ["0"], done.stdout + done.stderr
