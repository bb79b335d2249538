"""The searches of QuadPiPS in closed loop, on short ways."""

from collections.abc import Callable

import numpy as np
import pytest

from legtool.configs.camera import DepthCamera
from legtool.configs.robots import load_robot
from legtool.configs.worlds import WorldSettings
from legtool.sim.controllers.tracked import TrackedController
from legtool.sim.robots.robot import build_robot
from legtool.sim.walks.loop import run
from legtool.sim.walks.missteps import Missteps
from legtool.sim.walks.pips import PipsPlanner, pips_for
from legtool.sim.walks.region_finder import RegionFinder
from legtool.sim.walks.simulated import Eyes, SimulatedRobot, Until
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.mujoco_world import world_spec
from legtool.sim.worlds.steppable_regions import near
from legtool_runtime.perception.chain import PerceptionSettings
from legtool_runtime.perception.regions import Regions
from legtool_runtime.search.swings.walked_references import Refusal, transition_ahead
from legtool_runtime.terrain.settings import ElevationSettings

Walk = Callable[..., tuple[SimulatedRobot, PipsPlanner]]
GAP = {
    "name": "gap", "floor": "pit", "pit_depth": 0.6, "goal": (1.3, 0.0), "goal_radius": 0.25, "friction": 1.0,
    "boxes": [
        {"center": [-0.6, 0.0, -0.1], "size": [2.4, 2.0, 0.2]}, {"center": [1.75, 0.0, -0.1], "size": [1.9, 2.0, 0.2]}
    ],
}  # fmt: skip


class Blindfold(RegionFinder):
    """Finds nothing from a time on."""

    def __init__(self, finder: RegionFinder, from_s: float) -> None:
        self.times_s, self._finder, self._from_s = [], finder, from_s

    def see(self, observation) -> Regions | None:
        found = self._finder.see(observation)
        return near(found, [1e3, 1e3], 1.0) if found is not None and observation.time_s >= self._from_s else found


@pytest.fixture(scope="module")
def walk() -> Walk:
    world = build_world(WorldSettings(**GAP))
    robot = build_robot(load_robot("anymal_c"), world_spec(world))

    def make(
        blind_from_s: float = np.inf, expansions: int | None = None, optimised: bool = False, **until: float
    ) -> tuple[SimulatedRobot, PipsPlanner]:
        controller = TrackedController(robot, optimised=optimised)
        geometry = controller.robot.geometry
        pips = pips_for(controller.robot, world, expansions=expansions)
        finder = Blindfold(RegionFinder(geometry, PerceptionSettings()), blind_from_s)
        elevation = ElevationSettings()
        environment = SimulatedRobot(
            world, robot, controller, rng=np.random.default_rng(0),
            eyes=Eyes(DepthCamera(rate_hz=10.0), elevation, regions_m=2.0), until=Until(at_goal=True, **until),
        )  # fmt: skip
        return environment, PipsPlanner(pips, world, controller, finder, elevation)

    return make


def test_a_robot_steps_over_a_gap_to_the_goal_and_stands_there(walk: Walk) -> None:
    environment, planner = walk(expansions=30, timeout_s=25.0)  # the same walk on every machine
    missteps = Missteps(environment)
    assert run(environment, planner, [missteps]) == "goal"
    assert missteps.found == []
    assert np.hypot(*(environment.simulation.state.position_world[:2] - [1.3, 0.0])) <= 0.25
    feet, forces = environment.feet()
    assert (forces > 0.0).all() and (feet[:, 2] < 0.02).all()
    stages = planner.stages
    assert stages.counts["replans"] > 3
    frames = len(planner.history.planning_times_s)
    found, planned = (len(stages.times_s[stage]) for stage in ("candidates", "foothold_search"))
    assert 0 < planned <= found <= frames
    assert len(planner.frames) == -(-frames // 15)
    assert "swing" not in stages.times_s


def test_a_body_that_follows_optimised_motions_gets_there_too(walk: Walk) -> None:
    environment, planner = walk(expansions=30, optimised=True, timeout_s=25.0)
    missteps = Missteps(environment)
    assert run(environment, planner, [missteps]) == "goal"
    assert missteps.found == []
    assert len(planner.stages.times_s["swing"]) > 5
    assert planner.stages.counts["swings_refused"] == 0
    assert {"walking"} <= {frame.answer.status for frame in planner.frames}


def test_a_transition_that_the_optimisation_refuses_is_taken_out_of_the_plan(walk: Walk) -> None:
    environment, planner = walk(expansions=30, optimised=True, timeout_s=25.0)
    controller = environment.simulation.controller
    assert isinstance(controller, TrackedController) and controller.references is not None
    refusals = controller.references.refusals
    environment.begin()
    refused: Refusal | None = None
    for _ in range(1000):  # until a plan of several transitions is walked
        environment.apply(planner.act(environment.observe()))
        tracker = controller.tracker
        ahead = None if tracker is None else transition_ahead(tracker.plan, tracker.clock_s + 0.3, 2)
        if ahead is not None:
            refused = Refusal("torque", *ahead)
            refusals.append(refused)
            break
    assert refused is not None
    environment.apply(planner.act(environment.observe()))
    assert refusals == [] and planner.stages.counts["swing_refused_torque"] == 1
    tracker = controller.tracker
    assert tracker is not None
    found = (transition_ahead(tracker.plan, tracker.clock_s, k) for k in range(1, 30))
    held = [(before, after) for before, after in (pair for pair in found if pair is not None)]
    assert held and not any(np.array_equal(pair, refused[1:]) for pair in held)


def test_no_clock_decides_a_walk_where_expansions_end_the_searches(walk: Walk) -> None:
    ends = []
    for _ in range(2):
        environment, planner = walk(expansions=8, timeout_s=2.0)
        run(environment, planner)
        ends.append(environment.simulation.data.qpos.copy())
    assert ends[0][0] > 0.2
    np.testing.assert_array_equal(ends[0], ends[1])


def test_a_robot_that_is_shown_no_regions_stands_and_perception_is_to_blame(walk: Walk) -> None:
    environment, planner = walk(blind_from_s=0.0, timeout_s=10.0, stall_s=1.0)
    start = environment.simulation.state.position_world.copy()
    assert run(environment, planner) == "stalled"
    assert planner.stages.blocked_by == "perception" and planner.stages.counts["exhausted"] > 5
    assert planner.stages.reason and "\n" not in planner.stages.reason
    np.testing.assert_allclose(environment.simulation.state.position_world, start, atol=0.02)


def test_a_robot_that_sees_no_more_in_mid_walk_comes_to_a_stand(walk: Walk) -> None:
    environment, planner = walk(blind_from_s=2.0, timeout_s=20.0, stall_s=3.0)
    assert run(environment, planner) == "stalled"
    assert environment.simulation.state.position_world[0] > 0.05  # it had walked
    tracker = planner._controller.tracker
    assert tracker is not None and tracker.contact.all() and not tracker.fault
