"""Suites of families: each trial walks a world of its own, and notes how far it came."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from legtool.configs.families import FAMILIES
from legtool.configs.planner import PlannerEvalSettings
from legtool.errors import SettingsError
from legtool.evaluation.suites.planner import eval_planner
from legtool.evaluation.suites.planner_metrics import cause_of, summarise
from legtool.evaluation.suites.planner_report import _losses
from legtool.evaluation.suites.suite import Suite
from legtool.evaluation.suites.suite_checks import check_regions
from legtool.evaluation.suites.suite_robot import suite_robot
from legtool.evaluation.suites.trial import _eyes, _spread, camera_of, sight_of
from legtool.evaluation.suites.walkers import Walker, _latency, world_settings
from legtool.sim.controllers.trot.trot import TrotController
from legtool.sim.walks.planners import BlindPlanner
from legtool.sim.walks.stages import StageLog
from legtool_runtime.perception.camera import Camera


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


def test_cameras_are_mounted_as_in_the_experiments_unless_the_suite_names_another() -> None:
    who = suite_robot(settings(), None)
    walker = Walker(BlindPlanner(0.1), TrotController(who.build()), sees=True, on_regions=True)
    flat, ramp, beams = FAMILIES["hw_flat"], FAMILIES["ramp"], FAMILIES["parallel_beams_axes"]
    seen = _eyes(who, flat, settings(regions="camera"), walker, None)
    assert seen is not None and seen.camera == who.camera.replace(pitch=np.radians(45.0))
    assert camera_of(who, ramp, settings()) == who.camera
    assert camera_of(who, ramp.settings(), settings()) == who.camera
    own = settings(camera=who.camera.replace(pitch=0.6))
    assert camera_of(suite_robot(own, None), flat, own).pitch == 0.6
    assert sight_of(who, flat, settings(regions="camera")) == pytest.approx(0.5 * who.camera.horizontal_view)
    assert sight_of(who, flat, settings(regions="truth")) is None
    assert sight_of(who, beams, settings(regions="camera")) is None  # it sees to both sides


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


@pytest.mark.parametrize(
    ("outcome", "told", "cause"),
    [
        ("fell", "perception", "perception"),
        ("stopped: FL has not touched down", "search", "search"),
        ("fell", "", "tracking"),
        ("goal", "tracking", ""),
        ("error: ValueError: no", "tracking", "error"),
    ],
)
def test_the_monitor_tells_what_a_fall_came_from(outcome: str, told: str, cause: str) -> None:
    assert cause_of(record(outcome, cause=told)) == cause


def test_the_first_event_before_the_end_that_speaks_against_a_stage_is_its_cause() -> None:
    log = StageLog(told=[(1.0, "slip", "tracking"), (8.0, "early", ""), (8.5, "region_lost", "perception"),
                         (8.9, "tilt", "tracking")])  # fmt: skip
    assert log.cause(6.0) == "perception" and log.cause(8.8) == "tracking" and log.cause(9.0) == ""


def test_the_page_says_why_a_robot_came_to_a_halt() -> None:
    why = "foothold search: nothing leads on; no foothold near the feet"
    lost = [record("stalled", reason=why), record("stalled", reason=why), record("fell", reason=why), record("goal")]
    table = _losses("stones", {("stones", "quadpips"): lost, ("ramp", "quadpips"): lost})
    assert len(table["rows"]) == 1
    assert f"2 stalled ({why}), 1 fell" in str(table["rows"][0]["cells"])


def test_plans_are_late_only_where_it_is_asked_for_and_alike_for_all_planners() -> None:
    assert _latency(settings(), 0) is None
    first, again, other = (_latency(settings(latency_s=0.2), number) for number in (0, 0, 1))
    assert first is not None and again is not None and other is not None
    drawn = [first.draw() for _ in range(50)]
    assert drawn == [again.draw() for _ in range(50)] and drawn[0] != other.draw()
    assert 0.0 <= min(drawn) < 0.05 and 0.15 < max(drawn) <= 0.2


def test_stages_have_times_counts_and_causes() -> None:
    found = summarise([record("goal"), record("stalled", blocked_by="search"), record("fell")], 0.01)
    assert found["torso_search_median_s"]["value"] == pytest.approx(0.002) and found["torso_search_median_s"]["n"] == 6
    assert found["torso_search_p99_s"]["value"] == pytest.approx(0.003)
    assert found["replans"]["value"] == 4.0 and found["progress"]["value"] == 0.5
    assert {cause: found[f"failed_{cause}"]["value"] for cause in ("search", "tracking", "perception")} == {
        "search": pytest.approx(1 / 3), "tracking": pytest.approx(1 / 3), "perception": 0.0
    }  # fmt: skip
    assert found["failed_search"]["n"] == 3


GAP = """
name: short_gap
floor: pit
pit_depth: 0.6
friction: 1
goal: [1.1, 0]
goal_radius: 0.25
boxes:
  - {center: [-0.6, 0, -0.1], size: [2.2, 2, 0.2]}
  - {center: [1.65, 0, -0.1], size: [2, 2, 0.2]}
"""


@pytest.mark.parametrize("regions", ["truth", "camera"])
def test_a_robot_plans_its_feet_over_a_gap_on_regions(regions: str, tmp_path: Path) -> None:
    world = tmp_path / "short_gap.yaml"
    world.write_text(GAP)
    suite = settings(
        suite=str(world), planners=("quadpips",), robot="anymal_c", regions=regions, noise=None, start_x=0.0,
        start_y=0.0, start_heading=0.0, camera_size=(160, 120),
    )  # fmt: skip
    out = tmp_path / "out"
    list(eval_planner(None, suite, out))
    metrics = json.loads((out / "results.json").read_text())["metrics"]
    row = "short_gap.quadpips"
    assert metrics[f"{row}.success"]["value"] == 1.0 and metrics[f"{row}.clean"]["value"] == 1.0
    for stage in ("candidates", "torso_search", "foothold_search"):
        assert 0 < metrics[f"{row}.{stage}_median_s"]["value"] <= metrics[f"{row}.{stage}_p99_s"]["value"]
    assert (f"{row}.perception_median_s" in metrics) == (regions == "camera")
    assert metrics[f"{row}.replans"]["value"] > 3 and metrics[f"{row}.failed_search"]["value"] == 0.0
    assert metrics[f"{row}.landing_error_mean_m"]["value"] < 0.005
    # The world from above, and below it three frames with their regions.
    assert next((out / "trials").glob("*.above.svg")).read_text().count('id="axes_') == 4


def test_planners_on_regions_refuse_courses_and_segmenters_of_other_cameras(tmp_path: Path) -> None:
    script = settings(suite="stones_trot", planners=("quadpips",), robot="anymal_c")
    with pytest.raises(SettingsError, match="its feet go by script; planners on regions expect other worlds"):
        list(eval_planner(None, script, tmp_path / "out"))
    other = SimpleNamespace(camera=Camera.from_field_of_view(640, 480, 1.2))
    bundle = SimpleNamespace(lines=("steppability",), steppability=SimpleNamespace(sensor=other))
    suite = Suite(settings(), None, suite_robot(settings(), None), {"ramp": FAMILIES["ramp"]})
    with pytest.raises(SettingsError, match=r"images of 640 x 480; set camera_size=\[640,480\]"):
        check_regions(suite, bundle)
    check_regions(suite._replace(settings=settings(regions="truth")), bundle)
