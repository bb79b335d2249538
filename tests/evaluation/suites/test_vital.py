import json

import numpy as np
import pytest

from legtool.configs.robots import PRESETS, load_robot
from legtool.configs.vital import WALK_NAMES, VitalSettings
from legtool.errors import SettingsError
from legtool.evaluation.suites.vital import STRATEGIES, eval_vital, strategies, walk, walk_metrics
from legtool.sim.walks.trunk_path import PATHS, TrunkPath, vital_map, vital_world
from legtool_runtime.foothold import Criteria


@pytest.fixture(scope="module")
def criteria():
    return Criteria(load_robot("hyq").geometry())


def test_the_stairs_have_the_papers_rise_and_go():
    for name, go in (("stairs", 0.25), ("stairs_go28", 0.28)):
        profile = vital_map(vital_world(f"vital_{name}")).heights[:, 50]
        rises = np.flatnonzero(np.diff(profile) > 0.05)
        assert np.diff(profile)[rises] == pytest.approx(0.1)
        assert np.diff(rises) * 0.02 == pytest.approx(go, abs=0.02)
        assert profile[0] == profile[-1] == 0


def test_rough_ground_depends_on_the_seed_and_heights_on_the_scale():
    one, other = (vital_map(vital_world("vital_rough", seed=seed)).heights for seed in (0, 1))
    assert not np.array_equal(one, other)
    assert vital_map(vital_world("vital_rough", scale=0.5)).heights == pytest.approx(0.5 * one)


def test_settings_name_the_walks():
    assert tuple(PATHS) == WALK_NAMES
    with pytest.raises((SettingsError, ValueError), match="'moon' is unknown; expected some of stairs"):
        VitalSettings(walks=("moon",))


@pytest.mark.parametrize("name", PATHS)
def test_every_walk_stays_on_its_course(name):
    path = PATHS[name]
    course = vital_map(vital_world(path.world))
    reach = 0.8
    assert course.lower_corner[0] < path.begin - reach + 0.3
    assert course.lower_corner[0] + 0.02 * course.heights.shape[0] > path.end + reach
    assert np.isfinite(course.heights).all()
    assert path.gait.step_length_m * path.gait.step_frequency_hz == pytest.approx(path.speed)


def test_down_stairs_vpa_leaves_the_worst_leg_more_safe_footholds_than_the_baseline(criteria):
    part = TrunkPath("vital_stairs", 0.2, begin=1.0, end=1.5)
    course = vital_map(vital_world(part.world))
    vpa, tbr = (walk(criteria, part, STRATEGIES[name], course) for name in ("vpa", "tbr"))
    assert vpa.safe.min() > tbr.safe.min()
    metrics = walk_metrics("stairs", "vpa", vpa)
    assert metrics["stairs.vpa.min_safe"]["value"] == vpa.safe.min() > 0
    assert metrics["stairs.vpa.without_safe"]["value"] == 0


def test_results_name_every_strategy_and_carry_on(tmp_path, monkeypatch):
    monkeypatch.setitem(PATHS, "stairs", TrunkPath("vital_stairs", 0.2, begin=0.0, end=0.3))
    settings, out = VitalSettings(walks=("stairs",)), tmp_path / "out"
    lines = list(eval_vital(settings, out))
    held = json.loads((out / "results.json").read_text())
    names = ("min_safe", "collisions", "workspace_violations", "blind", "pitch_variation_rad_m")
    assert {f"stairs.{s}.{name}" for s in STRATEGIES for name in names} <= set(held["metrics"])
    assert held["metrics"]["stairs.vpa.collisions"]["n"] > 0
    assert lines[0].startswith("stairs: vpa at least")
    page = (out / "report.html").read_text()
    assert "filmstrip" in page and "Fig. 13" in page and page.count("<svg") >= 4
    # Walks that are there are not walked again.
    (one,) = (out / "trials").glob("stairs.vpa.*")
    one.unlink()
    before = written(out)
    list(eval_vital(settings, out))
    assert {name: before[name] for name in written(out) if name != one.name} == before
    assert json.loads((out / "results.json").read_text())["metrics"] == held["metrics"]


def written(out):
    return {path.name: path.stat().st_mtime_ns for path in (out / "trials").iterdir()}


@pytest.mark.parametrize("change", ["robot", "course", "walk"])
def test_a_robot_course_or_walk_that_changed_is_walked_anew_and_never_answered_from_old_trials(
    change, tmp_path, monkeypatch
):
    monkeypatch.setitem(PATHS, "rough", TrunkPath("vital_rough", 0.2, begin=0.0, end=0.05))
    yaml, text = tmp_path / "robot.yaml", (PRESETS / "hyq.yaml").read_text()
    yaml.write_text(text)
    settings, out = VitalSettings(robot=str(yaml), walks=("rough",)), tmp_path / "out"
    list(eval_vital(settings, out))
    first, before = json.loads((out / "results.json").read_text())["metrics"], written(out)
    if change == "robot":
        assert "foot_radius: 0.02\n" in text
        yaml.write_text(text.replace("foot_radius: 0.02\n", "foot_radius: 0.04\n"))
    elif change == "course":
        settings = settings.replace(scale=0.5)
    else:
        monkeypatch.setitem(PATHS, "rough", TrunkPath("vital_rough", 0.2, begin=0.3, end=0.35))
    list(eval_vital(settings, out))
    assert len(written(out)) == 2 * len(before)
    assert json.loads((out / "results.json").read_text())["metrics"] != first


def test_only_stairs_are_walked_by_every_strategy():
    assert set(strategies("stairs")) == set(STRATEGIES)
    assert strategies("rough") == ("vpa", "tbr")
