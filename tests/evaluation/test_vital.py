import json

import numpy as np
import pytest

from legtool.configs.robots import load_robot
from legtool.evaluation.vital import STRATEGIES, eval_vital, walk, walk_metrics
from legtool.sim.foothold_courses import WALKS, Walk, course_heights
from legtool_runtime.foothold import Criteria


@pytest.fixture(scope="module")
def criteria():
    return Criteria(load_robot("hyq").geometry())


def test_the_stairs_have_the_papers_rise_and_go():
    course = course_heights("stairs")
    profile = course.heights[:, 50]
    rises = np.flatnonzero(np.diff(profile) > 0.05)
    assert np.diff(profile)[rises] == pytest.approx(0.1)
    assert np.diff(rises) * 0.02 == pytest.approx(0.25, abs=0.02)
    assert profile[0] == profile[-1] == 0


@pytest.mark.parametrize("name", WALKS)
def test_every_walk_stays_on_its_course(name):
    course, path = course_heights(WALKS[name].course), WALKS[name]
    reach = 0.8
    assert course.lower_corner[0] < path.begin - reach + 0.3
    assert course.lower_corner[0] + 0.02 * course.heights.shape[0] > path.end + reach
    assert np.isfinite(course.heights).all()


def test_down_stairs_vpa_leaves_the_worst_leg_more_safe_footholds_than_the_baseline(criteria):
    part = Walk("stairs", 0.2, begin=1.0, end=1.5)
    vpa, tbr = (walk(criteria, part, STRATEGIES[name]) for name in ("vpa", "tbr"))
    assert vpa.safe.min() > 0
    assert vpa.safe.min() > tbr.safe.min()
    metrics = walk_metrics("stairs", "vpa", vpa)
    assert metrics["stairs.vpa.min_safe"]["value"] == vpa.safe.min()
    assert metrics["stairs.vpa.without_safe"]["value"] == 0


def test_results_name_every_strategy(criteria, tmp_path, monkeypatch):
    monkeypatch.setitem(WALKS, "short", Walk("stairs", 0.2, begin=0.0, end=0.1))
    lines = list(eval_vital("hyq", tmp_path / "out", walks=("short",)))
    metrics = json.loads((tmp_path / "out" / "results.json").read_text())["metrics"]
    assert {f"short.{name}.min_safe" for name in STRATEGIES} <= set(metrics)
    assert lines[0].startswith("short: least safe footholds")
    page = (tmp_path / "out" / "report.html").read_text()
    assert "worst leg" in page and "<svg" in page
