import mujoco
import numpy as np
import pytest

from legtool.configs.world_parts import Gap, Step
from legtool.configs.worlds import WorldSettings, is_world, load_world, random_world
from legtool.errors import SettingsError
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.drawing import draw_world
from legtool.sim.worlds.mujoco_world import world_spec

NAMES = ("scenario_1", "scenario_2", "scenario_3", "gap_10", "gap_20", "stairs")


def test_a_gap_on_one_side_leaves_the_other_side_whole() -> None:
    course = build_world(WorldSettings(name="c", length=3, gaps=(Gap(x=1, width=0.15, side="left"),)))
    assert course.height(1.07, 0.2) == pytest.approx(-0.3)
    assert course.height(1.07, -0.2) == pytest.approx(0.0)
    assert course.height(0.99, 0.2) == pytest.approx(0.0)
    assert course.height(1.16, 0.2) == pytest.approx(0.0)


def test_steps_stack() -> None:
    steps = (Step(x=1, length=1, height=0.06), Step(x=1.5, length=0.5, height=0.04))
    course = build_world(WorldSettings(name="c", length=3, steps=steps))
    np.testing.assert_allclose(course.height([0.5, 1.2, 1.7, 2.2], [0.1, -0.1, 0.1, -0.1]), [0, 0.06, 0.1, 0])


@pytest.mark.parametrize("name", [*NAMES, "random:3:0.0", "random:3:1.0"])
def test_the_simulated_floor_is_where_the_course_says(name: str) -> None:
    course = build_world(load_world(name))
    model = world_spec(course).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rng = np.random.default_rng(0)
    hit = np.zeros(1, dtype=np.int32)
    for _ in range(500):
        x = rng.uniform(-1, course.settings.length + 1)
        y = rng.uniform(-0.9, 0.9)
        start = np.array([x, y, 2.0])
        distance = mujoco.mj_ray(model, data, start, np.array([0.0, 0.0, -1.0]), None, 1, -1, hit, None)
        assert 2.0 - distance == pytest.approx(float(course.height(x, y)), abs=1e-9)


def test_random_worlds_repeat_and_grow_with_difficulty() -> None:
    assert random_world(5, 0.5) == random_world(5, 0.5)
    easy = [gap.width for seed in range(20) for gap in random_world(seed, 0.0).gaps]
    hard = [gap.width for seed in range(20) for gap in random_world(seed, 1.0).gaps]
    assert max(easy) <= 0.061
    assert np.mean(hard) > 0.1
    assert len(hard) > len(easy)


def test_unknown_courses_and_obstacles_beyond_the_goal_are_refused() -> None:
    with pytest.raises(SettingsError, match=r"presets: .*scenario_1"):
        load_world("scenario_9")
    with pytest.raises(SettingsError, match="expected random:SEED:DIFFICULTY"):
        load_world("random:x")
    with pytest.raises(ValueError, match="beyond the course"):
        WorldSettings(name="c", length=1, gaps=(Gap(x=0.95, width=0.1),))


def test_a_course_is_drawn_with_its_gaps_where_they_are() -> None:
    course = build_world(WorldSettings(name="c", length=3, gaps=(Gap(x=1, width=0.15, side="left"),)))
    drawn = draw_world(course, columns=81)  # 5 cm each, from -0.5 m
    assert "gap  x 1.00 to 1.15 m, 15 cm, left" in "\n".join(drawn)
    left, right = drawn[-10], drawn[-1]
    assert left[2 + 31] == " " and left[2 + 28] == "." and right[2 + 31] == "."


def test_names_of_courses_are_told_from_paths() -> None:
    assert is_world("scenario_1") and is_world("random:3:0.5") and not is_world("nowhere")
