"""Walks by contact plans in MuJoCo: stones, a hole that no map shows, a push, and a plan without an end."""

from __future__ import annotations

import numpy as np
import pytest

from legtool.configs.courses import Course
from legtool.configs.robots import load_robot
from legtool.configs.sweep import CONTROL_RATE_HZ, Noise
from legtool.configs.worlds import WorldSettings
from legtool.errors import LegtoolError
from legtool.sim.controllers.blackbox import make_controller
from legtool.sim.controllers.tracked import TrackedController
from legtool.sim.robots.robot import build_robot
from legtool.sim.walks.environment import Answer, Observation
from legtool.sim.walks.loop import run
from legtool.sim.walks.missteps import Missteps
from legtool.sim.walks.planners import BlindPlanner
from legtool.sim.walks.scripted import ScriptedPlanner, Tracking
from legtool.sim.walks.simulated import SimulatedRobot, Until
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.mujoco_world import world_spec
from legtool_runtime.tracking.settings import TrackerSettings

STONES = Course(name="two_rows", ground="stones", rise=0.1, cycles=5)


class Push:
    """Changes the base's velocity once."""

    def __init__(self, environment: SimulatedRobot, at_s: float, change: tuple[float, float]) -> None:
        self.environment, self.at_s, self.change = environment, at_s, np.array(change)

    def begin(self) -> None: ...

    def tick(self, observation: Observation, answer: Answer) -> None:
        if abs(observation.time_s - self.at_s) < 1e-6:
            self.environment.simulation.push(self.change)

    def end(self) -> None: ...


def walk(
    course: Course, *, push: tuple[float, float] | None = None, drop_m: float = 0.0, noise: Noise | None = None,
    delay_s: float = 0.0,
):  # fmt: skip
    """Outcome, landings, missteps and the controller of ANYmal C on a course; the world may lie deeper than planned."""
    settings = load_robot("anymal_c")
    geometry = settings.geometry()
    drawn = course.world(geometry, np.random.default_rng(3))
    planned = build_world(drawn)
    if drop_m:
        first = drawn.stones[0]
        drawn = drawn.replace(stones=[{**first.to_dict(), "top": first.top - drop_m},
                                      *(stone.to_dict() for stone in drawn.stones[1:])])  # fmt: skip
    world = build_world(drawn)
    robot = build_robot(settings, world_spec(world))
    controller = TrackedController(robot, TrackerSettings(force_noise=0.0 if noise is None else noise.foot_force))
    planner = ScriptedPlanner(course, planned, controller.robot, np.random.default_rng(4))
    environment = SimulatedRobot(
        world, robot, controller, rng=np.random.default_rng(0), until=Until(15.0), noise=noise, delay_s=delay_s
    )
    tracking, missteps = Tracking(environment, controller), Missteps(environment)
    others = [] if push is None else [Push(environment, 2.0, push)]
    outcome = run(environment, planner, [tracking, missteps, *others])
    return outcome, tracking, missteps.found, controller


def test_feet_land_on_stones_where_they_were_planned() -> None:
    outcome, tracking, missteps, controller = walk(STONES)
    assert outcome == "goal"
    assert not missteps
    assert len(tracking.landings) == 4 * STONES.cycles
    errors = [error for _, _, error in tracking.landings]
    assert np.mean(errors) < 0.002 and max(errors) < 0.006
    # What the controller believes agrees with the truth where it measures the truth.
    believed = [landing.error_m for landing in controller.tracker.landings]
    np.testing.assert_allclose(believed, errors, atol=5e-4)
    assert tracking.saturated[0] < 0.02 * tracking.saturated[1]


def test_a_stone_that_lies_deeper_than_planned_is_found() -> None:
    outcome, tracking, _, controller = walk(STONES, drop_m=0.04)
    assert outcome == "goal"
    late = [landing for landing in controller.tracker.landings if landing.phase > 1.2]
    assert late and all(landing.leg in (0, 2) for landing in late)
    assert max(error for _, _, error in tracking.landings) < 0.01


def test_a_noisy_state_and_late_torques_are_walked_with() -> None:
    outcome, tracking, missteps, _ = walk(STONES, noise=Noise(), delay_s=0.005)
    assert outcome == "goal" and not missteps
    errors = [error for _, _, error in tracking.landings]
    assert np.mean(errors) < 0.007 and max(errors) < 0.02


@pytest.mark.parametrize("push", [(0.0, 0.5), (0.5, 0.0), (-0.4, 0.3), (-0.4, -0.3)])
def test_a_push_is_caught(push: tuple[float, float]) -> None:
    outcome, tracking, missteps, _ = walk(STONES, push=push)
    assert outcome == "goal" and not missteps
    assert max(error for _, _, error in tracking.landings) < 0.02


class Lean:
    """How far the base is ahead of the mean of the true feet, and to the left of it, at every tick [m]."""

    def __init__(self, environment: SimulatedRobot) -> None:
        self.environment, self.off = environment, []

    def begin(self) -> None: ...

    def tick(self, observation: Observation, answer: Answer) -> None:
        feet, _ = self.environment.feet()
        self.off.append(observation.state.position_world[:2] - feet[:, :2].mean(axis=0))

    def end(self) -> None: ...


@pytest.mark.parametrize("stride", [(0.3, 0.0, 0.0), (0.0, 0.2, 0.0)])
def test_the_body_trots_over_the_middle_of_its_feet(stride: tuple[float, float, float]) -> None:
    course = Course(name="level", stride=stride, cycles=6)
    geometry = load_robot("anymal_c").geometry()
    world = build_world(course.world(geometry, np.random.default_rng(0)))
    robot = build_robot(load_robot("anymal_c"), world_spec(world))
    controller = TrackedController(robot)
    planner = ScriptedPlanner(course, world, controller.robot, np.random.default_rng(0))
    environment = SimulatedRobot(world, robot, controller, rng=np.random.default_rng(0), until=Until(10.0))
    lean = Lean(environment)
    assert run(environment, planner, [lean]) == "goal"
    cycle = round(0.96 * CONTROL_RATE_HZ)
    np.testing.assert_allclose(np.mean(lean.off[2 * cycle : 5 * cycle], axis=0), 0.0, atol=0.015)


def test_planner_and_controller_that_do_not_go_together_are_refused_at_once() -> None:
    settings = load_robot("anymal_c")
    world = build_world(WorldSettings(name="flat", goal=(5.0, 0.0)))
    for tracked in (True, False):
        robot = build_robot(settings, world_spec(world))
        controller = TrackedController(robot) if tracked else make_controller(robot)
        course = Course(name="ahead", cycles=2)
        script = ScriptedPlanner(course, world, TrackedController(robot).robot, np.random.default_rng(0))
        environment = SimulatedRobot(world, robot, controller, rng=np.random.default_rng(0), until=Until(2.0))
        with pytest.raises(LegtoolError, match=r"the planner answers with .*, and the controller .* takes .*"):
            run(environment, BlindPlanner(0.3) if tracked else script)
        assert environment.time_s == 0.0
