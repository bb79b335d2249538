"""A film shows the robot on its terrain."""

import itertools
import warnings

import numpy as np
import pytest

from legtool.configs.courses import Course
from legtool.configs.robots import load_robot
from legtool.sim.controllers.tracked import TrackedController
from legtool.sim.robots.robot import build_robot
from legtool.sim.walks.film import HEIGHT, RATE_HZ, WIDTH, Film
from legtool.sim.walks.loop import run_trial
from legtool.sim.walks.missteps import Missteps
from legtool.sim.walks.planners import BlindPlanner
from legtool.sim.walks.scripted import ScriptedPlanner
from legtool.sim.walks.simulated import SimulatedRobot, Until
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.mujoco_world import world_spec


def test_a_film_has_frames_at_its_rate_and_shows_the_robot(make) -> None:
    environment, planner = make(timeout_s=0.5), BlindPlanner(0.4)
    missteps = Missteps(environment)
    film = Film(environment, missteps, planner)
    run_trial(environment, planner, [missteps, film])
    frames = list(film.frames(swing_height_max=0.15))
    assert len(frames) == round(0.5 * RATE_HZ)
    assert all(frame.shape == (HEIGHT, WIDTH, 3) and frame.dtype == np.uint8 for frame in frames)
    middle = frames[-1][HEIGHT // 4 : 3 * HEIGHT // 4, WIDTH // 4 : 3 * WIDTH // 4].reshape(-1, 3).astype(int)
    blue = (middle[:, 2] > middle[:, 0] + 40).mean()
    orange = (middle[:, 0] > middle[:, 2] + 60).mean()
    assert blue > 0.005 and orange > 0.005  # left and right legs
    assert any((one != other).any() for one, other in itertools.pairwise(frames))


@pytest.mark.parametrize("name", ["anymal_c", "hyq"])  # HyQ's abduction axis meets its thigh's: a link without length
def test_a_film_of_a_contact_plan_shows_where_feet_are_to_go(name: str) -> None:
    settings = load_robot(name)
    course = Course(name="level", stride=(0.3, 0.0, 0.0), cycles=2)
    world = build_world(course.world(settings.geometry(), np.random.default_rng(0)))
    robot = build_robot(settings, world_spec(world))
    controller = TrackedController(robot)
    planner = ScriptedPlanner(course, world, controller.robot, np.random.default_rng(0))
    environment = SimulatedRobot(world, robot, controller, rng=np.random.default_rng(0), until=Until(0.1))
    missteps = Missteps(environment)
    film = Film(environment, missteps, planner)
    run_trial(environment, planner, [missteps, film])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        frame = next(iter(film.frames(swing_height_max=0.15))).astype(int)
    green = (frame[..., 1] > frame[..., 0] + 40) & (frame[..., 1] > frame[..., 2] + 20)
    assert green.sum() > 20
