"""The arena: worlds of three papers, planners of the user's own, and rows with settings of their own."""

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from legtool.configs.courses import any_world
from legtool.configs.families import ARENA, FAMILIES
from legtool.configs.planner import PlannerEvalSettings
from legtool.datasets.work import digest
from legtool.errors import SettingsError
from legtool.evaluation.suites.suite import Suite, decides_of, worlds_of
from legtool.evaluation.suites.suite_checks import check
from legtool.evaluation.suites.suite_robot import suite_robot
from legtool.evaluation.suites.trial import _eyes
from legtool.evaluation.suites.walkers import Walker, make_walker, world_settings
from legtool.sim.controllers.tracked import TrackedController
from legtool.sim.controllers.trot.trot import TrotController
from legtool.sim.walks.planners import BlindPlanner
from legtool.sim.worlds.build import build_world

#: As much of a bundle with motion models as decides trials.
MOTION = SimpleNamespace(
    lines=("motion",),
    manifest={"robot": {}, "lines": {"motion": {"degree": 1}}, "files": []},
    motion=SimpleNamespace(covers=lambda commands: commands[:, 0] < 0.95),
)
EXAMPLES = Path(__file__).parents[3] / "examples" / "planners"
SHORT = "name: short\nlength: 1.6\ngoal_radius: 0.3\ngaps: [{x: 0.9, width: 0.08}]\n"


def settings(**changes: object) -> PlannerEvalSettings:
    return PlannerEvalSettings(**{"robot": "anymal_c", "planners": "blind", **changes})  # type: ignore[arg-type]


def suite(**changes: object) -> Suite:
    given = settings(**changes)
    return Suite(given, None, suite_robot(given, None), worlds_of(given))


def legtool(*options: str, cwd: Path) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "legtool", "eval", "planner", *options]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd)


def test_the_arena_has_the_worlds_of_three_papers() -> None:
    arena = suite(suite="arena")
    assert len(arena.worlds) == 18 and list(arena.worlds)[:12] == list(FAMILIES)[:10] + list(FAMILIES)[-2:]
    check(arena, None)


def test_scenarios_grow_with_the_robots_legs() -> None:
    worlds = {
        name: world_settings(ARENA["arena_scenario_2"], suite_robot(settings(robot=name), None), settings(), 0)
        for name in ("aliengo", "anymal_c")
    }
    small, large = worlds["aliengo"], worlds["anymal_c"]
    assert [gap.width for gap in small.gaps] == pytest.approx([0.15, 0.15])
    assert [gap.width for gap in large.gaps] == pytest.approx([0.15 * 0.6125 / 0.5] * 2, abs=1e-3)
    assert large.steps[0].height == pytest.approx(0.06 * 0.6125 / 0.5, abs=1e-3)
    assert any_world("arena_scenario_2") == large
    assert large.name == "arena_scenario_2" and large.goal_radius == 0.25
    assert build_world(large).goal[0] == pytest.approx(5.0 * 0.6125 / 0.5, abs=1e-3)


def test_rough_ground_is_drawn_by_the_trial() -> None:
    who, rough = suite_robot(settings(), None), ARENA["arena_rough"]
    seeds = [world_settings(rough, who, settings(), k).cobbles[0].seed for k in range(3)]
    assert seeds[0] == 0 and len(set(seeds)) == 3


def test_all_that_see_look_aside_where_a_family_has_side_cameras() -> None:
    """A map of the camera ahead alone lacks the beams beside a robot: every baseline with a map was blind there."""
    given, who = settings(), suite_robot(settings(), None)
    walker = Walker(BlindPlanner(0.0), TrotController(who.build()), sees=True)
    assert len(_eyes(who, FAMILIES["parallel_beams_axes"], given, walker, None).beside) == 2  # type: ignore[union-attr]
    assert not _eyes(who, FAMILIES["ramp"], given, walker, None).beside  # type: ignore[union-attr]


def test_a_changed_row_is_another_trial_and_leaves_its_neighbour_alone() -> None:
    def digests(planners: str) -> dict[str, str]:
        made = suite(suite="ramp", planners=planners)
        return {row: digest(decides) for (_, row), decides in decides_of(made, None).items()}

    alone = digests("quadpips")
    both = digests("quadpips,quadpips[pips.cost_to_go=false],quadpips[monitor=looks]")
    assert alone["quadpips"] == both["quadpips"] and len(set(both.values())) == 3


def test_a_bundle_leaves_the_trials_of_those_alone_who_do_not_use_it() -> None:
    made = suite(suite="ramp", planners="em_mpc,s_mpc,velocity", horizons="5")
    rows = [{row: decides for (_, row), decides in decides_of(made, given).items()} for given in (None, MOTION)]  # type: ignore[arg-type]
    assert rows[0]["em_mpc"] == rows[1]["em_mpc"] and rows[0]["s_mpc"] == rows[1]["s_mpc"]
    assert rows[0]["h5"] != rows[1]["h5"]
    # Commands that its models never saw are left out, and that decides; where none are, nothing is said of it.
    assert rows[1]["h5"]["left_out"] == [[1.0, 0.0, 0.0]]
    bold = Suite(made.settings.replace(extrapolate=True), None, made.robot, made.worlds)
    wanted = {row: decides for (_, row), decides in decides_of(bold, MOTION).items()}  # type: ignore[arg-type]
    assert {**rows[1]["h5"], "left_out": None} == {**wanted["h5"], "left_out": None}
    assert "left_out" not in wanted["h5"] and "left_out" not in wanted["em_mpc"]


def test_the_walk_of_ones_own_contact_plans_ends_at_the_goal_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A plan that is walked to its end somewhere else is no goal."""
    (tmp_path / "planned.py").write_text(
        "class Planner:\n    answers = 'contact plans'\n"
        "    def __init__(self, task):\n        self.task = task\n    act = print\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(TrackedController, "warm_up", lambda self: None)
    who, world = (
        suite_robot(settings(), None),
        world_settings(FAMILIES["ramp"], suite_robot(settings(), None), settings(), 0),
    )
    walker = make_walker(
        "planned:Planner", who.build(), build_world(world), where=FAMILIES["ramp"], number=0, settings=settings(),
        bundle=None, rng=np.random.default_rng(0),
    )  # fmt: skip
    assert walker.at_goal and not walker.on_regions and isinstance(walker.controller, TrackedController)
    assert walker.planner.task.tracker is None  # type: ignore[attr-defined]


def test_changes_of_searches_are_checked_before_the_first_walk() -> None:
    with pytest.raises(SettingsError, match=r"unknown setting 'pips\.feet\.gait'; expected one of: deadline_s"):
        check(suite(suite="ramp", planners="quadpips[pips.feet.gait=trot]"), None)


def test_a_policy_without_its_file_or_for_another_robot_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"policies\.em_rl is missing"):
        check(suite(suite="ramp", planners="em_rl", policies={"robot": None}), None)
    with pytest.raises(SettingsError, match="are ANYmal's"):
        check(suite(suite="ramp", planners="em_dtc", robot="go2", policies={"robot": None}), None)


def test_a_planner_of_ones_own_walks_beside_a_row_with_settings_of_its_own(tmp_path: Path) -> None:
    world = tmp_path / "short.yaml"
    world.write_text(SHORT)
    rows = "high_ground:HighGround,blind[blind_speed=0.0]"
    options = ("--suite", str(world), "--planners", rows, "--robot", "anymal_c", "--trials", "1", "--films", "0")
    done = legtool(
        *options, "--set", "start_x=0.0", "--set", "timeout_s=12", "--out", str(tmp_path / "out"), cwd=EXAMPLES
    )
    assert done.returncode == 0, done.stderr
    metrics = json.loads((tmp_path / "out" / "results.json").read_text())["metrics"]
    assert metrics["short.high_ground:HighGround.success"]["value"] == 1.0
    assert metrics["short.high_ground:HighGround.planning_time_median_s"]["value"] > 0.0
    assert 0.1 < metrics["short.high_ground:HighGround.cost_of_transport"]["value"] < 5.0
    assert metrics["short.blind[blind_speed=0.0].success"]["value"] == 0.0
    assert metrics["short.high_ground:HighGround-blind[blind_speed=0.0].success_difference"]["value"] == 1.0


@pytest.mark.parametrize(
    ("source", "name", "says"),
    [
        ("", "mine:Planner", "cannot be imported"),
        (
            "class Planner:\n    def __init__(self, task):\n        raise KeyError('no')\n",
            "mine:Planner",
            "cannot be made",
        ),
        ("class Planner:\n    def __init__(self, task):\n        pass\n", "mine:Planner", "has no act"),
        (
            "class Planner:\n    answers = 'songs'\n    def __init__(self, task):\n        pass\n    act = print\n",
            "mine:Planner",
            "answers is 'songs', expected one of velocity commands, contact plans, guided gaits",
        ),
        ("", "nowhere:Planner", "cannot be imported"),
    ],
)
def test_what_is_no_planner_ends_in_one_line(source: str, name: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(source)
    options = ("--suite", "ramp", "--planners", name, "--robot", "anymal_c", "--out", str(tmp_path / "out"))
    done = legtool(*options, cwd=tmp_path)
    assert done.returncode == 2 and says in done.stderr and len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert not (tmp_path / "out").exists()
