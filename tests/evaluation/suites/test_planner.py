"""The suite in closed loop: real physics, a camera's map, real plans."""

import itertools
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import pytest
from rosbags.highlevel import AnyReader

from legtool.configs.planner import PlannerEvalSettings
from legtool.configs.robots import PRESETS, load_robot
from legtool.errors import LegtoolError
from legtool.evaluation.suites.planner import eval_planner
from legtool.evaluation.suites.planner_metrics import summarise
from legtool.evaluation.suites.trial import _model_errors
from legtool.sim.robots.physics import empty_world
from legtool.sim.robots.robot import add_robot


@pytest.fixture(scope="module")
def results(walking_bundle: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("suite") / "out"
    command = [sys.executable, "-m", "legtool", "eval", "planner", "--bundle", str(walking_bundle), "--out", str(out)]
    options = ["--suite", "gap_10", "--trials", "2", "--horizons", "5"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return out


def test_a_planned_robot_crosses_a_gap_on_its_own_map(results: Path) -> None:
    metrics = json.loads((results / "results.json").read_text())["metrics"]
    assert metrics["gap_10.h5.success"]["value"] == 1.0
    assert metrics["gap_10.h5.success"]["n"] == 2
    low, high = metrics["gap_10.h5.success"]["ci95"]
    assert 0.3 < low < high <= 1.0
    for name in ("planning_time_median_s", "planning_time_p99_s", "cumulative_cost", "cdm_mae", "fdm_mae", "cvm_mae"):
        assert metrics[f"gap_10.h5.{name}"]["value"] > 0
    assert "gap_10.blind.success" in metrics
    assert "gap_10.blind.planning_time_median_s" not in metrics


def test_the_report_stands_alone_and_draws_the_walks(results: Path) -> None:
    page = (results / "report.html").read_text()
    assert page.count("<svg") == 4
    assert page.count("data:image/webp;base64,") == 2
    assert not re.findall(r"""(?:src|href|url)\s*[=(]\s*["']?https?:""", page)


def test_a_course_that_is_named_by_its_seed_has_its_figures_in_the_report(walking_bundle: Path, tmp_path: Path) -> None:
    lines = list(eval_planner(walking_bundle, settings(suite="random:3:0.1", trials=1), tmp_path / "out"))
    metrics = json.loads((tmp_path / "out" / "results.json").read_text())["metrics"]
    page = (tmp_path / "out" / "report.html").read_text()
    assert f">{1e3 * metrics['random_3_010.h5.planning_time_median_s']['value']:.3f}<" in page
    assert any(line.startswith("random_3_010 h5: success") for line in lines)


def test_a_walk_is_recorded_in_ros_messages(results: Path) -> None:
    with AnyReader([results / "recordings" / "gap_10.h5.mcap"]) as reader:
        assert {"/odom", "/command", "/joint_states", "/feet"} <= set(reader.topics)


def test_the_first_trial_of_each_row_is_filmed(results: Path) -> None:
    for row in ("blind", "h5"):
        film = cv2.VideoCapture(str(results / "films" / f"gap_10.{row}.mp4"))
        frames = int(film.get(cv2.CAP_PROP_FRAME_COUNT))
        assert frames > 20
        assert film.read()[1].shape == (300, 400, 3)
    assert len(list((results / "trials").glob("*.mp4"))) == 2


def test_trials_that_are_done_are_not_walked_again(results: Path, walking_bundle: Path) -> None:
    trial = next((results / "trials").glob("gap_10.h5.0001-*.json"))
    record = {**json.loads(trial.read_text()), "success": False, "outcome": "changed by hand"}
    before = trial.read_text()
    try:
        trial.write_text(json.dumps(record))
        lines = list(eval_planner(walking_bundle, settings(), results))
        assert any("success 1/2" in line for line in lines)
    finally:
        trial.write_text(before)


def settings(**changes: object) -> PlannerEvalSettings:
    return PlannerEvalSettings(suite="gap_10", trials=2, horizons=(5,)).replace(**changes)


def test_more_trials_and_planners_carry_on_with_those_that_are_there(
    results: Path, walking_bundle: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(results, out)
    before = {path.name: path.read_bytes() for path in (out / "trials").glob("*.json")}
    lines = list(eval_planner(walking_bundle, settings(trials=3), out))
    assert any(line.startswith("gap_10 blind: success") and "/3" in line for line in lines)
    after = {path.name: path.read_bytes() for path in (out / "trials").glob("*.json")}
    assert len(after) == len(before) + 2 and before.items() <= after.items()


GAP = "name: mine\nlength: 2.0\ngaps:\n  - {{x: 1.0, width: {}}}\n"


def blind(**changes: object) -> PlannerEvalSettings:
    values = {"planners": ("blind",), "robot": "aliengo", "trials": 1, "films": 0, "timeout_s": 2.0, "blind_speed": 0.0}
    return PlannerEvalSettings(**{**values, **changes})


def rows(lines: Iterable[str]) -> list[str]:
    """The lines of the table, without the verdict after it."""
    return list(itertools.takewhile(lambda line: not line.startswith("verdict"), lines))


def trial_files(out: Path) -> set[str]:
    return {path.name for path in (out / "trials").glob("*.json")}


def test_a_changed_world_robot_or_policy_is_never_answered_from_old_trials(tmp_path: Path) -> None:
    world, robot, policy = tmp_path / "mine.yaml", tmp_path / "robot.yaml", tmp_path / "policy_of_mine.py"
    world.write_text(GAP.format(0.1))
    robot.write_text((PRESETS / "aliengo.yaml").read_text())
    code = "import numpy\nclass Mine:\n    def __init__(self, robot): pass\n    def reset(self, state): pass\n"
    code += "    def accepts_command(self): return True\n    def step(self, state, command): return numpy.zeros(12)\n"
    policy.write_text(code)
    sys.path.insert(0, str(tmp_path))
    try:
        suite = blind(suite=str(world), robot=str(robot), black_box="policy_of_mine:Mine")
        out = tmp_path / "out"
        list(eval_planner(None, suite, out))
        files = trial_files(out)
        list(eval_planner(None, suite, out))
        assert trial_files(out) == files and len(files) == 1
        for path, text in (
            (world, GAP.format(0.2)),
            (robot, robot.read_text().replace("standing_height: 0.39", "standing_height: 0.38")),
            (policy, code + "# another version\n"),
        ):
            assert path.read_text() != text
            path.write_text(text)
            list(eval_planner(None, suite, out))
            assert len(trial_files(out)) == len(files) + 1
            files = trial_files(out)
    finally:
        sys.path.remove(str(tmp_path))


def test_worlds_whose_files_have_one_name_share_no_trials(tmp_path: Path) -> None:
    paths = []
    for folder, width in (("a", 0.1), ("b", 0.2)):
        (tmp_path / folder).mkdir()
        paths.append(tmp_path / folder / "mine.yaml")
        paths[-1].write_text(GAP.format(width))
    lines = rows(eval_planner(None, blind(suite=f"{paths[0]},{paths[1]}"), tmp_path / "out"))
    assert [line.split(":")[0] for line in lines] == ["mine blind", "mine_2 blind"]
    assert len(trial_files(tmp_path / "out")) == 2


def test_worlds_of_near_difficulties_share_neither_names_nor_trials(tmp_path: Path) -> None:
    suite = "random:3:0.5,random:3:0.9,random:3:0.501,random:3:0.504"
    lines = rows(eval_planner(None, blind(suite=suite, timeout_s=1.1), tmp_path / "out"))
    assert len({line.split(" ")[0] for line in lines}) == 4
    assert lines[0].startswith("random_3_050 blind")
    assert len(trial_files(tmp_path / "out")) == 4


def test_json_worlds_yaml_worlds_and_presets_are_walked_in_one_suite(tmp_path: Path) -> None:
    slab = {"kind": "box", "center": [1, 0, -0.05], "size": [6, 3, 0.1], "rpy": [0, 0, 0], "mu": 0.8, "name": "slab"}
    ends = {"start": {"torso_xyz": [0, 0, 0.4], "yaw": 0}, "goal": {"torso_xyz": [2, 0, 0.4]}}
    (tmp_path / "slab.json").write_text(json.dumps({"name": "slab", "boxes": [slab], **ends}))
    (tmp_path / "mine.yaml").write_text(GAP.format(0.1))
    suite = f"{tmp_path / 'slab.json'},{tmp_path / 'mine.yaml'},stairs"
    lines = rows(eval_planner(None, blind(suite=suite), tmp_path / "out"))
    assert [line.split(" ")[0] for line in lines] == ["slab", "mine", "stairs"]


def test_a_trial_is_the_same_while_the_machine_is_busy(results: Path, walking_bundle: Path, tmp_path: Path) -> None:
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(os.cpu_count() or 2)]
    try:
        list(eval_planner(walking_bundle, settings(films=0), tmp_path / "out"))
    finally:
        for process in busy:
            process.kill()
            process.wait()
    timed = ("planning_times_s", "real_time_factor")
    for path in (tmp_path / "out" / "trials").glob("*.json"):
        one, other = (json.loads((root / "trials" / path.name).read_text()) for root in (results, tmp_path / "out"))
        for name in timed:
            del one[name], other[name]
        assert one == other


def test_the_robot_of_an_mjcf_file_comes_with_the_bundle_and_needs_no_preset(
    walking_bundle: Path, tmp_path: Path
) -> None:
    """The model is the built-in Aliengo written out under a name that no preset has."""
    spec = empty_world()
    add_robot(spec, load_robot("aliengo"))
    spec.modelname = "nobody"
    spec.compile()
    (tmp_path / "nobody.xml").write_text(spec.to_xml())
    suite = settings(mjcf=str(tmp_path / "nobody.xml"), trials=1, films=0, timeout_s=3.0)
    lines = list(eval_planner(walking_bundle, suite, tmp_path / "out"))
    assert any(line.startswith("gap_10 h5") for line in lines)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"robot": "go2"}, "made for aliengo, the suite walks go2"),
        ({"suite": "staircase"}, "has no goal"),
        ({"suite": "moon"}, "'moon': no such preset"),
        ({"black_box": "nothing"}, "expected a policy's YAML file, or module:Class"),
    ],
)
def test_what_cannot_be_walked_is_refused_before_the_first_step(
    walking_bundle: Path, tmp_path: Path, changes: dict, expected: str
) -> None:
    with pytest.raises(LegtoolError, match=expected):
        list(eval_planner(walking_bundle, settings(**changes), tmp_path / "out"))
    assert not (tmp_path / "out" / "results.json").exists()


def test_a_controller_that_throws_loses_its_trial_not_the_suite(walking_bundle: Path, tmp_path: Path) -> None:
    module = tmp_path / "broken_controller.py"
    module.write_text(
        "class Broken:\n"
        "    def __init__(self, robot): self.ticks = 0\n"
        "    def reset(self, state): pass\n"
        "    def accepts_command(self): return True\n"
        "    def step(self, state, command):\n"
        "        self.ticks += 1\n"
        "        if self.ticks > 20: raise ValueError('lost a packet')\n"
        "        import numpy; return numpy.zeros(12)\n"
    )
    command = [sys.executable, "-m", "legtool", "eval", "planner", "--bundle", str(walking_bundle)]
    options = ["--suite", "gap_10", "--trials", "1", "--horizons", "5", "--set", "black_box=broken_controller:Broken"]
    done = subprocess.run(
        [*command, *options, "--out", "out"], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert done.returncode == 0, done.stderr
    record = json.loads(next((tmp_path / "out" / "trials").glob("*.h5.0000-*.json")).read_text())
    assert record["outcome"] == "error: ValueError: lost a packet"


def test_shares_have_wilson_intervals() -> None:
    record = {
        "success": True,
        "clean": False,
        "duration_s": 1.0,
        "real_time_factor": 2.0,
        "errors": {},
        "planning_times_s": [],
    }
    found = summarise([record] * 20, 0.01)
    assert found["success"]["ci95"] == pytest.approx([0.8389, 1.0], abs=1e-4)
    assert found["clean"]["ci95"] == pytest.approx([0.0, 0.1611], abs=1e-4)


def test_a_scripted_walk_tells_where_feet_landed(tmp_path: Path) -> None:
    out = tmp_path / "out"
    suite = PlannerEvalSettings(
        suite="sidesteps_trot", planners=("scripted",), robot="anymal_c", trials=1, films=0, noise=None
    )
    lines = list(eval_planner(None, suite, out))
    assert any("sidesteps_trot scripted: success 1/1, clean 1/1, landing error mean" in line for line in lines)
    metrics = json.loads((out / "results.json").read_text())["metrics"]
    row = "sidesteps_trot.scripted"
    middle, worst = (metrics[f"{row}.landing_error_{key}_m"] for key in ("mean", "worst"))
    assert middle["n"] == worst["n"] == 32
    assert 0 < middle["value"] < worst["value"] < 0.005
    assert metrics[f"{row}.torque_saturation"]["value"] < 0.05
    assert metrics[f"{row}.real_time_factor"]["value"] > 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"suite": "gap_10"}, "world gap_10 has no script; expected courses, any of stones_trot"),
        ({"black_box": "some.module:Class"}, "plans feet, which the controller some.module:Class does not take"),
        ({"suite": "course:stilts:1"}, "course 'stilts': expected one of"),
    ],
)
def test_a_script_that_cannot_be_walked_is_refused_at_once(
    tmp_path: Path, changes: dict[str, str], message: str
) -> None:
    suite = PlannerEvalSettings(suite="stones_trot", planners=("scripted",), robot="anymal_c").replace(**changes)
    with pytest.raises(LegtoolError, match=message):
        list(eval_planner(None, suite, tmp_path / "out"))


STEP = """
name: low_step
goal: [0.9, 0]
profile: {end: 4.0, stretches: [{x: -2.0, height: 0.0}, {x: 0.7, height: 0.08}]}
"""


def test_feet_and_poses_chosen_on_the_way_have_their_figures(tmp_path: Path) -> None:
    world, out = tmp_path / "low_step.yaml", tmp_path / "out"
    world.write_text(STEP)
    suite = PlannerEvalSettings(
        suite=str(world), planners=("vital", "tbr"), robot="hyq", trials=1, films=0, speed=0.4, start_x=0.0
    )
    lines = rows(eval_planner(None, suite, out))
    assert [line.split(",")[0] for line in lines] == ["low_step vital: success 1/1", "low_step tbr: success 1/1"]
    metrics = json.loads((out / "results.json").read_text())["metrics"]
    for row in ("low_step.vital", "low_step.tbr"):
        value = {key.removeprefix(f"{row}."): m["value"] for key, m in metrics.items() if key.startswith(row)}
        assert value["success"] == 1.0 and value["link_contacts"] == 0.0 and value["blind_steps"] < 0.2
        assert 0.0 < value["height_error_m_filtered"] < value["height_error_m"] < 0.1
        assert 0.0 < value["pitch_error_rad"] < 0.1 and value["pitch_error_rad_filtered"] < 0.05
        assert value["min_safe"] >= 0 and value["foot_hits"] >= 0 and value["ankle_contacts"] >= 0
        assert 0.0 < value["landing_error_mean_m"] < value["landing_error_p95_m"] < 0.03
        assert 0.0 <= value["torque_saturation"] < 0.1 and value["real_time_factor"] > 0.0
    page = (out / "report.html").read_text()
    assert "low_step: poses" in page and "low_step: safe footholds and errors" in page
    with AnyReader([out / "recordings" / "low_step.vital.mcap"]) as reader:
        assert {"/plan/footholds", "/plan/body", "/plan/force/FL", "/plan/map"} <= set(reader.topics)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"suite": "stones_trot"}, "its feet go by script; planners that choose footholds expect climbs"),
        ({"black_box": "some.module:Class"}, "plans feet, which the controller some.module:Class does not take"),
        ({"criteria": "networks"}, "--bundle is missing: criteria=networks needs a bundle"),
        ({"suite": "stairs_15cm"}, "world 'stairs_15cm': no such preset"),
        ({"suite": "stairs_15cm", "planners": ("velocity",)}, "world 'stairs_15cm': no such preset"),
    ],
)
def test_a_climb_that_cannot_be_walked_is_refused_at_once(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    suite = PlannerEvalSettings(suite="stairs_02", planners=("vital",), robot="hyq").replace(**changes)
    with pytest.raises(LegtoolError, match=message):
        list(eval_planner(None, suite, tmp_path / "out"))


def test_a_bundle_without_motion_models_has_no_errors_of_them() -> None:
    assert _model_errors(SimpleNamespace(lines=("vfa", "vpa")), None) == {}
