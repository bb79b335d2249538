"""Suites of families: each trial walks a world of its own, and notes how far it came."""

import json
from pathlib import Path

import numpy as np
import pytest

from legtool.configs.families import FAMILIES
from legtool.configs.planner import PlannerEvalSettings
from legtool.evaluation.suites.planner import eval_planner
from legtool.evaluation.suites.planner_metrics import cause_of, summarise
from legtool.evaluation.suites.suite_robot import suite_robot
from legtool.evaluation.suites.trial import _eyes, _spread
from legtool.evaluation.suites.walkers import Walker, world_settings
from legtool.sim.controllers.trot.trot import TrotController
from legtool.sim.walks.planners import BlindPlanner


def settings(**changes: object) -> PlannerEvalSettings:
    given = {"suite": "quadpips_hardware", "planners": ("blind",), "robot": "go2", "trials": 1, "films": 0}
    return PlannerEvalSettings(**{**given, **changes})


def test_trial_0_walks_the_published_world_and_later_ones_members() -> None:
    robot = suite_robot(settings(), None)
    family = FAMILIES["pegboard"]
    worlds = [world_settings(family, robot, settings(), number) for number in range(3)]
    assert worlds[0] == family.settings()
    assert worlds[0] != worlds[1] != worlds[2] and worlds[1] == world_settings(family, robot, settings(), 1)
    published = settings(members="published")
    assert world_settings(family, robot, published, 2) == family.settings()


def test_starts_are_no_farther_off_than_the_familys() -> None:
    assert _spread(FAMILIES["ramp"], settings()) == (0.03, 0.03, 0.05)
    assert _spread(FAMILIES["ramp"], settings(start_x=0.0)) == (0.0, 0.03, 0.05)
    assert _spread(FAMILIES["ramp"].settings(), settings()) == (0.3, 0.1, 0.05)


def test_a_walker_on_regions_is_given_them_or_labelled_images() -> None:
    who = suite_robot(settings(), None)
    walker = Walker(BlindPlanner(0.1), TrotController(who.build()), sees=True, on_regions=True)
    beams, ramp = FAMILIES["parallel_beams_axes"], FAMILIES["ramp"]
    truth = _eyes(who, ramp, settings(regions="truth"), walker, None)
    assert truth is not None and truth.regions_m == 2.0 and truth.truth is not None and not truth.images
    camera = _eyes(who, ramp, settings(regions="camera"), walker, None)
    assert camera is not None and camera.regions_m is None and camera.images and camera.truth is None
    assert camera.labelled_m == who.swing_height_max and camera.beside == ()
    both = _eyes(who, beams, settings(regions="camera"), walker, None)
    assert both is not None and len(both.beside) == 2


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("families") / "out"
    suite = settings(suite="sparse_stepping_stones,hw_flat", blind_speed=0.4)
    assert any(line.startswith("sparse_stepping_stones blind: success 0/1") for line in eval_planner(None, suite, out))
    return out


def test_results_say_how_far_a_walk_came(walked: Path) -> None:
    metrics = json.loads((walked / "results.json").read_text())["metrics"]
    name = "sparse_stepping_stones.blind"
    # It falls in between the first stones, 1.5 m from the start, of a way of 5 m.
    assert 0.2 < metrics[f"{name}.progress"]["value"] < 0.6
    assert metrics[f"{name}.success"]["value"] == 0.0
    assert f"{name}.failed_tracking" not in metrics  # only planners in stages tell causes apart
    record = json.loads(next((walked / "trials").glob(f"{name}.0000-*.json")).read_text())
    times, shares = np.array(record["progress"]).T
    assert (np.diff(times) > 0).all() and (np.diff(shares) >= 0).all()
    assert shares[-1] == pytest.approx(metrics[f"{name}.progress"]["value"])
    page = (walked / "report.html").read_text()
    assert "sparse_stepping_stones: progress" in page and "hw_flat: progress" in page


def record(outcome: str, **stages: object) -> dict[str, object]:
    return {
        "success": outcome == "goal", "clean": False, "outcome": outcome, "duration_s": 10.0, "real_time_factor": 1.0,
        "planning_times_s": [], "errors": {}, "cumulative_cost": 0.0, "progress": [(0.0, 0.0), (10.0, 0.5)],
        "stages": {"times_s": {"torso_search": [0.001, 0.003]}, "counts": {"replans": 4}, "blocked_by": "", **stages},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("outcome", "blocked_by", "cause"),
    [
        ("goal", "search", ""),
        ("fell", "search", "tracking"),
        ("stopped: FL has not touched down", "", "tracking"),
        ("stalled", "search", "search"),
        ("timeout", "perception", "perception"),
        ("stalled", "", "tracking"),
        ("error: ValueError: no", "search", "error"),
    ],
)
def test_trials_are_lost_by_a_stage(outcome: str, blocked_by: str, cause: str) -> None:
    assert cause_of(record(outcome, blocked_by=blocked_by)) == cause


def test_stages_have_times_counts_and_causes() -> None:
    found = summarise([record("goal"), record("stalled", blocked_by="search"), record("fell")], 0.01)
    assert found["torso_search_median_s"]["value"] == pytest.approx(0.002) and found["torso_search_median_s"]["n"] == 6
    assert found["torso_search_p99_s"]["value"] == pytest.approx(0.003)
    assert found["replans"]["value"] == 4.0 and found["progress"]["value"] == 0.5
    assert {cause: found[f"failed_{cause}"]["value"] for cause in ("search", "tracking", "perception")} == {
        "search": pytest.approx(1 / 3), "tracking": pytest.approx(1 / 3), "perception": 0.0
    }  # fmt: skip
    assert found["failed_search"]["n"] == 3
