import json
import re
from html.parser import HTMLParser

import numpy as np
import pyarrow as pa
import pytest

from legtool.configs.motion import MotionEvalSettings, MotionTrainSettings, TransitionSettings
from legtool.configs.robots import load_robot
from legtool.datasets.logs.recording import Recording
from legtool.datasets.motion.transitions import cut_transitions
from legtool.datasets.store import Store, part_path, write_part
from legtool.errors import DatasetError
from legtool.evaluation.held_out import AXES
from legtool.evaluation.motion import eval_motion, evaluate_motion, summary
from legtool.evaluation.report.results import metric, provenance, write_results
from legtool.training.motion import fit_motion, train_motion

ROBOT = load_robot("aliengo").geometry()
FAST = MotionEvalSettings(bootstrap=200, folds=5)


def walk(n=150, seed=0, name="walk"):
    """Step events of a robot that follows its command with a step's delay, feet where its velocity asks for them."""
    rng = np.random.default_rng(seed)
    command = np.repeat(rng.uniform(-0.3, 0.6, (n // 4 + 1, 3)), 4, axis=0)[:n]
    velocity, position, feet = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 4, 3))
    position[:, 2] = 0.37 + 0.002 * rng.standard_normal(n)
    feet[0] = ROBOT.stance * [1, 1, 0]
    for i in range(1, n):
        slow = 0.2 * velocity[i - 1] + 0.3 * velocity[max(i - 2, 0)]
        velocity[i] = slow + 0.5 * command[i - 1] + 0.02 * rng.standard_normal(3)
        position[i, :2] = position[i - 1, :2] + 0.3 * velocity[i, :2] + 0.003 * rng.standard_normal(2)
        feet[i] = feet[i - 1]
        swing = [0, 3] if i % 2 == 0 else [1, 2]
        feet[i, swing, :2] = position[i, :2] + ROBOT.stance[swing, :2] + 0.15 * velocity[i, :2]
        feet[i, swing, :2] += 0.02 * rng.standard_normal((2, 2))
    return Recording(
        name=name,
        stamps_ns=300_000_000 * np.arange(n),
        position_world=position,
        orientation=np.tile([1.0, 0, 0, 0], (n, 1)),
        velocity_base=np.column_stack([velocity[:, :2], np.zeros(n)]),
        yaw_rate=velocity[:, 2],
        command=command,
        feet_base=feet - position[:, None],
        swing_pair=(np.arange(n) % 2).astype(np.int8),
    )


def table(n=400, seed=0, episode=0):
    return cut_transitions([walk(n, seed)], TransitionSettings(), episode=episode)[0]


def dataset(path, *, instant="touchdown", robot=ROBOT, seed=0):
    header = {
        "kind": "motion",
        "robot": robot.to_dict(),
        "settings": {},
        "seed": seed,
        "inputs": [],
        "instant": instant,
    }
    with Store(path, header) as store:
        rows, counts = cut_transitions([walk(120, seed)], TransitionSettings())
        write_part(part_path(path, 0), rows, counts=counts)
        store.finish(1)
    return path


def test_metrics_have_the_names_units_and_intervals_that_results_promise():
    metrics, held_out = evaluate_motion(table(), FAST)
    for model, axes in AXES.items():
        for which in ("full", "no_history", "no_feet", "poly2", "bayesian"):
            for axis in axes:
                for kind in ("rmse", "mae"):
                    entry = metrics[f"{model}.{which}.{axis}.{kind}"]
                    low, high = entry["ci95"] or (entry["value"], entry["value"])  # none where all errors are alike
                    assert low <= entry["value"] <= high
                    assert entry["ci95"] is not None or axis not in "xy"
            assert f"{model}.{which}.mae" in metrics
    assert metrics["fdm.full.x.rmse"]["n"] == 2 * len(held_out.steps)  # both swing feet
    assert metrics["cdm.full.yaw.mae"]["unit"] == "rad" and metrics["cvm.full.yaw.mae"]["unit"] == "rad/s"
    assert "fdm.full.yaw.rmse" not in metrics
    pooled = np.abs(held_out.error("full", "fdm")[:, [0, 1, 3, 4]]).mean()
    assert metrics["fdm.full.mae"]["value"] == pytest.approx(pooled)
    assert metrics["stance.foot_motion.x.std"]["value"] < 1e-12


def test_what_the_robot_depends_on_is_missed_when_left_out():
    metrics, _ = evaluate_motion(table(), FAST)
    full, no_history = (metrics[f"cvm.{which}.x.rmse"]["value"] for which in ("full", "no_history"))
    assert no_history > 1.2 * full
    assert full == pytest.approx(0.02, rel=0.15)  # the noise that was put in


def test_ninety_percent_intervals_cover_what_was_held_out():
    metrics, _ = evaluate_motion(table(600), FAST)
    covered = [metrics[f"{m}.bayesian.{axis}.coverage90"]["value"] for m in ("fdm", "cvm") for axis in "xy"]
    assert min(covered) > 0.85 and max(covered) < 0.95


def test_folds_are_contiguous_in_a_log_and_whole_episodes_in_a_sweep():
    _, log = evaluate_motion(table(120), FAST)
    assert "contiguous" in log.split
    sweep = pa.concat_tables([table(20, seed=i, episode=i) for i in range(8)])
    _, held_out = evaluate_motion(sweep, FAST)
    assert "episodes" in held_out.split
    assert (held_out.block == held_out.steps.group).all()
    with pytest.raises(DatasetError, match="1 episodes, expected at least one for each of 5 folds"):
        evaluate_motion(table(120), FAST.replace(split="episode"))


def test_of_several_logs_each_is_held_out_as_a_whole():
    logs = pa.concat_tables([table(120, seed=i, episode=i) for i in range(3)])
    _, held_out = evaluate_motion(logs, FAST)
    assert held_out.split == "3-fold cross-validation, whole logs held out"
    # Nothing of a log may be known where it is predicted: what is changed at its end changes nothing at its beginning.
    column = logs.column_names.index("next_velocity_x")
    changed = logs["next_velocity_x"].to_numpy().copy()
    last = np.flatnonzero(held_out.steps.group == 0)[-1]
    changed[held_out.steps.order[last]] += 1.0
    _, after = evaluate_motion(logs.set_column(column, "next_velocity_x", pa.array(changed)), FAST)
    same = held_out.means["full"]["cvm"][:, 0] == after.means["full"]["cvm"][:, 0]
    assert same[held_out.steps.group == 0].all() and not same[held_out.steps.group == 1].any()
    _, contiguous = evaluate_motion(logs, FAST.replace(split="contiguous"))
    assert "contiguous" in contiguous.split


def test_a_log_too_long_to_be_held_out_is_divided():
    _, held_out = evaluate_motion(pa.concat_tables([table(200, episode=0), table(40, seed=1, episode=1)]), FAST)
    assert "contiguous" in held_out.split


def test_the_verdict_stands_in_results_and_report_and_is_said(tmp_path):
    dataset(tmp_path / "data")
    settings = MotionTrainSettings(folds=3)
    list(train_motion([tmp_path / "data"], settings, tmp_path / "run"))
    said = list(eval_motion(tmp_path / "run", FAST, tmp_path / "out"))
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert any(line.startswith(f"verdict: {results['verdict']['level']}") for line in said)
    assert said[-1].endswith("measure on another log with --data")
    assert f"Verdict: {results['verdict']['level']}" in (tmp_path / "out" / "report.html").read_text()
    naive = results["metrics"]["cvm.naive.x.rmse"]["value"]
    assert naive > results["metrics"]["cvm.bayesian.x.rmse"]["value"]
    assert json.loads((tmp_path / "run" / "results_motion.json").read_text()) == results


def test_no_step_is_predicted_by_a_model_that_saw_it():
    rows = table(200)
    _, before = evaluate_motion(rows, FAST)
    column = rows.column_names.index("next_velocity_x")
    changed = rows["next_velocity_x"].to_numpy().copy()
    changed[100] += 1.0
    _, after = evaluate_motion(rows.set_column(column, "next_velocity_x", pa.array(changed)), FAST)
    same = before.means["full"]["cvm"][:, 0] == after.means["full"]["cvm"][:, 0]
    assert same[99] and not same.all()


def test_another_dataset_is_measured_with_the_runs_own_models():
    run = fit_motion(table(300), MotionTrainSettings(), robot=ROBOT, instant="touchdown")
    metrics, held_out = evaluate_motion(table(5), FAST, model=run)
    assert len(held_out.steps) == 3 and "never saw" in held_out.split
    assert metrics["cvm.full.x.mae"]["value"] < 0.1


def test_too_few_steps_for_the_folds_are_refused():
    with pytest.raises(DatasetError, match=r"13 usable steps, expected at least 15 for 5 folds"):
        evaluate_motion(table(15), FAST)


def test_results_are_finite_numbers_with_their_provenance(tmp_path):
    where = provenance({"folds": 3}, seed=4, data_hash="ab", split="x")
    write_results(tmp_path / "out" / "results.json", {"a.b": metric(1.0, (0.5, 1.5), 7, "m")}, where)
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert results["metrics"]["a.b"] == {"value": 1.0, "ci95": [0.5, 1.5], "n": 7, "unit": "m"}
    assert results["provenance"]["seed"] == 4 and "numpy" in results["provenance"]["versions"]
    with pytest.raises(ValueError, match=r"a\.b is not finite"):
        write_results(tmp_path / "out" / "results.json", {"a.b": metric(np.nan, None, 7, "m")}, where)


class _Page(HTMLParser):
    def __init__(self):
        super().__init__()
        self.tags, self.links = [], []

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.links += [
            v for k, v in attributes if k in ("src", "href", "xlink:href") and not v.startswith(("#", "data:"))
        ]


def test_a_run_is_measured_from_its_own_data_and_the_page_stands_alone(tmp_path):
    list(train_motion([dataset(tmp_path / "data")], MotionTrainSettings(), tmp_path / "run"))
    lines = list(eval_motion(tmp_path / "run", FAST, tmp_path / "out"))
    assert "cross-validation" in lines[0]
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert results["provenance"]["data_hash"] == results["provenance"]["trained_on"]
    assert summary(results["metrics"]) == lines[1:4]
    assert lines[4].startswith("verdict") and len(lines) > 5
    text = (tmp_path / "out" / "report.html").read_text()
    page = _Page()
    page.feed(text)
    assert page.links == [] and "script" not in page.tags
    assert page.tags.count("svg") == 5 and page.tags.count("table") == 5  # one of them the verdict
    value = 1e3 * results["metrics"]["fdm.no_history.x.rmse"]["value"]
    assert re.search(rf"without t−1.*{value:.1f}", text)


def test_other_robots_other_instants_and_changed_data_are_refused(tmp_path):
    list(train_motion([dataset(tmp_path / "data")], MotionTrainSettings(), tmp_path / "run"))
    instant = dataset(tmp_path / "b", instant="full_stance_end")
    robot = dataset(tmp_path / "c", robot=load_robot("go2").geometry())
    for other, message in ((instant, "taken at full_stance_end, but at touchdown"), (robot, "robot 'go2'")):
        with pytest.raises(DatasetError, match=message):
            list(eval_motion(tmp_path / "run", FAST, tmp_path / "out", data=other))
    for path in (tmp_path / "data").iterdir():
        path.unlink()
    dataset(tmp_path / "data", seed=5)
    with pytest.raises(DatasetError, match="changed since"):
        list(eval_motion(tmp_path / "run", FAST, tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_the_real_aliengo_log_reaches_its_figures(shared_data):
    from legtool.configs.topics import load_topics
    from legtool.datasets.logs.log import read_log

    chunks = read_log(shared_data / "aliengo" / "real_continuous.csv", load_topics("aliengo_csv"), ROBOT)
    rows, _ = cut_transitions(chunks, TransitionSettings())
    metrics, _ = evaluate_motion(rows, MotionEvalSettings(bootstrap=200))

    def value(name):
        return metrics[name]["value"]

    assert value("fdm.full.x.rmse") <= 0.0125
    assert value("cdm.full.x.rmse") <= 0.0068
    assert value("cvm.full.x.rmse") <= 0.033
    for model in ("cdm", "cvm"):  # the paper: no history is the worst of the linear formulations
        assert value(f"{model}.no_history.x.rmse") > value(f"{model}.no_feet.x.rmse") > value(f"{model}.full.x.rmse")
    covered = [value(f"{model}.bayesian.{axis}.coverage90") for model in AXES for axis in AXES[model]]
    assert min(covered) >= 0.85 and max(covered) <= 0.95
