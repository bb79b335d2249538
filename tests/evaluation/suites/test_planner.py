"""The suite in closed loop: real physics, a camera's map, real plans."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from legtool.configs.planner import PlannerEvalSettings
from legtool.errors import LegtoolError, OutputError
from legtool.evaluation.suites.planner import eval_planner, summarise


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


def test_trials_that_are_done_are_not_walked_again(results: Path, walking_bundle: Path) -> None:
    trial = next((results / "trials").glob("gap_10.h5.0001.json"))
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


def test_another_suite_does_not_mix_with_the_trials_there(results: Path, walking_bundle: Path) -> None:
    with pytest.raises(OutputError, match="another suite, bundle or settings"):
        list(eval_planner(walking_bundle, settings(trials=3), results))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"robot": "go2"}, "made for aliengo, the suite walks go2"),
        ({"suite": "moon"}, "world 'moon': no such preset"),
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
    record = json.loads(next((tmp_path / "out" / "trials").glob("*.h5.0000.json")).read_text())
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
    found = summarise([record] * 20)
    assert found["success"]["ci95"] == pytest.approx([0.8389, 1.0], abs=1e-4)
    assert found["clean"]["ci95"] == pytest.approx([0.0, 0.1611], abs=1e-4)
