import itertools
from pathlib import Path

import pytest

from legtool.configs.climbs import CLIMBS, scaled
from legtool.configs.courses import any_world
from legtool.configs.planner import SUITES, PlannerEvalSettings
from legtool.configs.robots import load_robot
from legtool.info import describe
from legtool.sim.worlds.build import build_world


@pytest.mark.parametrize("name", CLIMBS)
def test_each_climb_has_a_world_with_a_goal_and_a_robot_that_is_there(name: str) -> None:
    climb = CLIMBS[name]
    world = build_world(climb.settings(3))
    world.require_goal()
    assert world.name == name
    if climb.robot is not None:
        load_robot(climb.robot)


def test_the_suite_holds_the_worlds_of_the_papers_sections() -> None:
    assert SUITES["vital"] == (
        "stairs_02", "stairs_03", "stairs_04", "stairs_05", "stairs_crawl", "stairs_12cm", "stairs_14cm",
        "gapped_stairs", "rough", "stairs_sideways", "stairs_yawing", "hyqreal_stairs",
    )  # fmt: skip


def test_risers_are_as_high_as_the_names_say() -> None:
    def risers(name: str) -> set[float]:
        heights = [stretch.height for stretch in CLIMBS[name].settings().profile.stretches]  # type: ignore[union-attr]
        return {round(abs(b - a), 3) for a, b in itertools.pairwise(heights)}

    assert risers("stairs_02") == {0.1}
    assert risers("stairs_12cm") == {0.12}
    assert risers("stairs_14cm") == {0.14}


def test_speeds_go_round() -> None:
    climb = CLIMBS["hyqreal_stairs"]
    assert [climb.speed(n) for n in range(6)] == [0.2, 0.3, 0.4, 0.5, 0.75, 0.2]


def test_each_trial_has_its_own_cobbles() -> None:
    rough = CLIMBS["rough"]
    assert rough.settings(1) == rough.settings(1) != rough.settings(2)


def test_scaling_leaves_the_preset_as_it_is() -> None:
    assert scaled("vital_stairs", scale=1.4) != scaled("vital_stairs") == scaled("vital_stairs", scale=1.0)


def test_planners_of_poses_can_be_asked_for() -> None:
    settings = PlannerEvalSettings(suite="vital", planners="vital,tbr,blind", robot="hyq")
    assert settings.rows == ("vital", "tbr", "blind")


def test_the_world_of_a_climb_can_be_drawn_by_its_name() -> None:
    assert any_world("stairs_14cm") == CLIMBS["stairs_14cm"].settings()
    lines = describe(Path("stairs_14cm"))
    assert lines[0].startswith("stairs_14cm: 4.10 m to the goal") and "All heights times 1.4." in lines[1]
