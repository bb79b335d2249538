"""Courses: what is laid carries every foothold, for every robot and seed."""

from __future__ import annotations

import numpy as np
import pytest

from legtool.configs.courses import COURSES, Course, any_world, draw_course
from legtool.configs.robots import load_robot
from legtool.errors import SettingsError
from legtool.sim.worlds.build import build_world


@pytest.mark.parametrize("course", COURSES.values(), ids=lambda course: course.name)
@pytest.mark.parametrize("robot", ["anymal_c", "go2", "aliengo", "hyq"])
def test_every_foothold_is_on_ground(course: Course, robot: str) -> None:
    geometry = load_robot(robot).geometry()
    for seed in range(3):
        world = build_world(course.world(geometry, np.random.default_rng(seed)))
        places = course.footholds(geometry)
        jitter = np.array(course.jitter) * course.scale(geometry)
        for corner in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            xy = places.copy()
            xy[:, 1:] += jitter * corner
            points = np.concatenate([xy.reshape(-1, 2), world.height(xy[..., 0], xy[..., 1]).reshape(-1, 1)], axis=1)
            assert world.on_ground(points).all()
        assert (world.friction >= course.friction[0]).all() and (world.friction <= course.friction[1]).all()


def test_neighbouring_stones_differ_by_the_rise_at_most() -> None:
    course = COURSES["stones_trot"]
    geometry = load_robot("anymal_c").geometry()
    for seed in range(20):
        stones = course.world(geometry, np.random.default_rng(seed)).stones
        for side in (1, -1):
            row = [stone for stone in stones if side * stone.y > 0]
            tops = np.array([0.0, *(stone.top for stone in row), 0.0])
            assert np.abs(np.diff(tops)).max() <= course.rise + 1e-9
            np.testing.assert_allclose(np.diff([stone.x for stone in row]), 0.4, atol=1e-9)


@pytest.mark.parametrize("course", COURSES.values(), ids=lambda course: course.name)
def test_the_pairs_of_a_trot_are_half_a_stride_apart(course: Course) -> None:
    geometry = load_robot("anymal_c").geometry()
    places = course.footholds(geometry)
    first, second = 0.5 * (places[0] + places[3]), 0.5 * (places[1] + places[2])
    whole, ahead = second[4] - second[3], second[4] - first[4]
    staggered = course.gait == "trot" and course.ground != "stairs"
    np.testing.assert_allclose(ahead, 0.5 * whole if staggered else np.zeros(2), atol=1e-9)


def test_a_seed_draws_one_world_and_says_so_in_its_name() -> None:
    first, again = any_world("course:stones_trot:3"), any_world("course:stones_trot:3")
    assert first == again != any_world("course:stones_trot:4")
    assert any_world("course:stones_trot:3:go2").stones[0].side == pytest.approx(0.2 * 0.426 / 0.6125)
    with pytest.raises(SettingsError, match="expected one of stones_trot"):
        draw_course("stilts", 0, load_robot("go2").geometry())
    with pytest.raises(SettingsError, match="course:NAME:SEED"):
        any_world("course:stones_trot:x")
