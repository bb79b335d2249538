"""A film shows the robot on its terrain."""

import itertools

import numpy as np

from legtool.sim.walks.film import HEIGHT, RATE_HZ, WIDTH, Film
from legtool.sim.walks.loop import run_trial
from legtool.sim.walks.missteps import Missteps
from legtool.sim.walks.planners import BlindPlanner


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
