import dataclasses
import json
import signal

import numpy as np
import pyarrow as pa
import pytest

from legtool.configs.export import ExportSettings
from legtool.configs.motion import MotionTrainSettings, TransitionSettings
from legtool.configs.robots import load_robot
from legtool.datasets.logs.recording import Recording
from legtool.datasets.motion.samples import load_transitions, motion_data
from legtool.datasets.motion.transitions import cut_transitions
from legtool.datasets.store import Store, part_path, write_part
from legtool.errors import DatasetError, OutputError
from legtool.models.motion import Z90, predict_frozen
from legtool.training.export import export_bundle
from legtool.training.motion import fit_motion, load_run, save_run, train_motion
from legtool.verdict import Finding, Verdict
from legtool_runtime import load_bundle
from legtool_runtime.motion.features import TARGETS
from legtool_runtime.robot import TROT_PAIRS

ROBOT = load_robot("aliengo").geometry()
STANCE = ROBOT.stance


def walk(n=120, seed=0, noise=1.0):
    """Step events of a robot whose velocity follows its command linearly, with a step's delay."""
    rng = np.random.default_rng(seed)
    command = np.repeat(rng.uniform(-0.3, 0.6, (n // 4 + 1, 3)), 4, axis=0)[:n]
    velocity, position, feet = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 4, 3))
    position[:, 2] = 0.37 + 0.002 * rng.standard_normal(n)
    feet[0] = STANCE * [1, 1, 0]
    for i in range(1, n):
        previous = velocity[max(i - 2, 0)]
        velocity[i] = (
            0.2 * velocity[i - 1] + 0.3 * previous + 0.5 * command[i - 1] + noise * 0.02 * rng.standard_normal(3)
        )
        position[i, :2] = position[i - 1, :2] + 0.3 * velocity[i, :2] + noise * 0.003 * rng.standard_normal(2)
        feet[i] = feet[i - 1]
        for leg in TROT_PAIRS[i % 2]:
            feet[i, leg, :2] = (
                position[i, :2] + STANCE[leg, :2] + 0.15 * velocity[i, :2] + noise * 0.02 * rng.standard_normal(2)
            )
            feet[i, leg, 2] = 0.001 * rng.standard_normal()
    return Recording(
        name="walk",
        stamps_ns=300_000_000 * np.arange(n),
        position_world=position,
        orientation=np.tile([1.0, 0, 0, 0], (n, 1)),
        velocity_base=np.column_stack([velocity[:, :2], np.zeros(n)]),
        yaw_rate=velocity[:, 2],
        command=command,
        feet_base=feet - position[:, None],
        swing_pair=(np.arange(n) % 2).astype(np.int8),
    )


def table(n=120, seed=0, noise=1.0):
    return cut_transitions([walk(n, seed, noise)], TransitionSettings())[0]


def dataset(path, n=120, *, robot=ROBOT, instant="touchdown", seed=0, noise=1.0, verdict=None):
    header = {
        "kind": "motion",
        "robot": robot.to_dict(),
        "settings": {},
        "seed": seed,
        "inputs": [],
        "instant": instant,
    }
    with Store(path, header) as store:
        rows, counts = cut_transitions([walk(n, seed, noise)], TransitionSettings())
        write_part(part_path(path, 0), rows, counts=counts)
        store.finish(1, None if verdict is None else lambda manifest: verdict.to_dict())
    return path


def fit(rows, **settings):
    return fit_motion(rows, MotionTrainSettings(**settings), robot=ROBOT, instant="touchdown")


def test_every_formulation_is_fitted_by_every_estimator():
    fitted = fit(table())
    assert set(fitted.models) == {"ols", "bayesian"}
    assert all(set(models) == {"full", "no_history", "no_feet", "poly2"} for models in fitted.models.values())
    assert {name: len(model["intercept"]) for name, model in fitted.frozen().items()} == {
        name: len(targets) for name, targets in TARGETS.items()
    }
    data = motion_data(table(seed=7))
    error = predict_frozen(fitted.frozen()["cvm"], data.features)[0] - data.targets["cvm"]
    assert np.abs(error).mean() < 0.03


def test_the_best_formulation_is_chosen_by_held_out_error_where_asked():
    fitted = fit(table(200), formulation="best", folds=4)
    assert fitted.formulation == min(fitted.scores, key=fitted.scores.get)
    assert fitted.scores["no_feet"] > fitted.scores["full"]
    assert fit(table(), estimator="ols").estimator == "ols"


def test_a_run_reads_back_as_it_was_written(tmp_path):
    fitted = fit(table())
    save_run(fitted, tmp_path / "run")
    loaded = load_run(tmp_path / "run")
    assert (loaded.formulation, loaded.estimator, loaded.instant) == ("full", "bayesian", "touchdown")
    assert loaded.robot.name == "aliengo" and loaded.data == {"steps": 118}
    for name, model in fitted.frozen("poly2", "ols").items():
        for key, value in model.items():
            np.testing.assert_array_equal(loaded.frozen("poly2", "ols")[name][key], value)


def test_the_same_fit_writes_the_same_bytes(tmp_path):
    save_run(fit(table()), tmp_path / "a")
    save_run(fit(table()), tmp_path / "b")
    for name in ("run.json", "models.npz"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_another_run_is_never_overwritten(tmp_path):
    save_run(fit(table()), tmp_path)
    save_run(fit(table()), tmp_path)
    with pytest.raises(OutputError, match=r"settings\.folds is 10 there, 5 here"):
        save_run(fit(table(), folds=5), tmp_path)


def test_an_altered_run_is_refused(tmp_path):
    save_run(fit(table()), tmp_path)
    models = tmp_path / "models.npz"
    models.write_bytes(models.read_bytes()[:-1] + b"x")
    with pytest.raises(DatasetError, match="SHA-256"):
        load_run(tmp_path)
    run = json.loads((tmp_path / "run.json").read_text())
    (tmp_path / "run.json").write_text(json.dumps({**run, "schema_version": 99}))
    with pytest.raises(DatasetError, match="newer"):
        load_run(tmp_path)
    with pytest.raises(DatasetError, match="not a run"):
        load_run(tmp_path / "nothing")


def test_three_steps_are_refused_with_how_many_are_needed():
    with pytest.raises(DatasetError, match=r"^3 usable steps, expected at least 30 \(min_steps\)"):
        fit(table(5))


def test_a_value_that_is_not_finite_is_refused_by_column():
    rows = table()
    values = rows["foot_fl_x"].to_numpy().copy()
    values[9] = np.nan
    rows = rows.set_column(rows.column_names.index("foot_fl_x"), "foot_fl_x", pa.array(values))
    with pytest.raises(DatasetError, match="step 9 of walk: foot_fl_x is nan"):
        fit(rows)
    with pytest.raises(DatasetError, match="column 'duration_s' is missing"):
        fit(rows.drop_columns(["duration_s"]))


def test_training_loads_datasets_and_writes_a_run(tmp_path):
    paths = [dataset(tmp_path / "a"), dataset(tmp_path / "b", seed=1)]
    lines = list(train_motion(paths, MotionTrainSettings(), tmp_path / "run"))
    assert "236 steps" in lines[0]
    run = load_run(tmp_path / "run")
    assert run.data["paths"] == [str(path) for path in paths] and run.data["counts"]["steps"] == 236
    assert len(set(motion_data(load_transitions(paths).table).group)) == 2


def test_training_on_a_robot_that_fell_says_so(tmp_path):
    fell = Verdict((Finding("red", "the robot fell in 3 of 6 episodes, expected none", "likely because of a shank"),))
    paths = [dataset(tmp_path / "a"), dataset(tmp_path / "b", seed=1, verdict=fell)]
    lines = list(train_motion(paths, MotionTrainSettings(), tmp_path / "run"))
    assert [line for line in lines if "verdict" in line] == [
        f"the verdict on {paths[1]} is red: its robot does not walk as it is told; see legtool info {paths[1]}"
    ]


def test_intervals_are_scaled_by_logs_that_the_models_never_saw(tmp_path):
    """Another day's steps scatter more: intervals hold 90 % of its other steps only after they are scaled by some."""
    data, day = dataset(tmp_path / "data", 400), dataset(tmp_path / "day", 400, seed=5, noise=2.5)
    lines = list(train_motion([data], MotionTrainSettings(), tmp_path / "run", calibrate=day))
    assert "hold 90 % of 398 steps" in lines[1] and "split conformal" in lines[1]
    list(train_motion([data], MotionTrainSettings(), tmp_path / "plain"))
    later = motion_data(table(400, seed=6, noise=2.5))
    held = {}
    for name in ("run", "plain"):
        models = load_run(tmp_path / name).frozen()
        inside = []
        for model, target in later.targets.items():
            mean, std = predict_frozen(models[model], later.features)
            inside.append((np.abs(target - mean) <= Z90 * std + 1e-12).mean())  # one output never varies
        held[name] = np.mean(inside)
    assert held["plain"] < 0.7 and 0.86 < held["run"] < 0.94
    bundle = load_bundle(export_bundle([tmp_path / "run"], tmp_path / "bundle", ExportSettings()))
    assert "Intervals were scaled to hold 90 % of the steps of other logs" in (bundle.path / "CARD.md").read_text()
    with pytest.raises(DatasetError, match="the data that the models are fitted to"):
        list(train_motion([data], MotionTrainSettings(), tmp_path / "same", calibrate=data))
    with pytest.raises(OutputError, match="recalibrated_on"):
        list(train_motion([data], MotionTrainSettings(), tmp_path / "run", calibrate=dataset(tmp_path / "c", seed=7)))
    with pytest.raises(DatasetError, match="robot 'go2'"):
        go2 = dataset(tmp_path / "go2", robot=load_robot("go2").geometry())
        list(train_motion([data], MotionTrainSettings(), tmp_path / "other", calibrate=go2))


#: What the last lines of train motion do, with the models of a run that is there.
_SAVE = """
import sys
from pathlib import Path
from legtool.training.motion import load_run, save_run
save_run(load_run(Path(sys.argv[1])), Path(sys.argv[2]))
"""


@pytest.fixture(scope="module")
def fitted():
    return fit(table(40), folds=3)


@pytest.mark.parametrize("moment", [1, 2, 3])
def test_killed_while_it_writes_a_run_is_written_whole_by_the_same_command(moment, fitted, tmp_path, legtool):
    save_run(fitted, tmp_path / "whole")
    names = (str(tmp_path / "whole"), str(tmp_path / "run"))
    killed = legtool(*names, code=_SAVE, kill_at_rename=moment)
    assert killed.returncode == -signal.SIGKILL, "the run was written by fewer renames"
    with pytest.raises(DatasetError, match=r"not a run|not finished"):
        load_run(tmp_path / "run")
    done = legtool(*names, code=_SAVE)
    assert done.returncode == 0, done.stderr
    files = {name: {item.name: item.read_bytes() for item in (tmp_path / name).iterdir()} for name in ("run", "whole")}
    assert files["run"] == files["whole"] and sorted(files["run"]) == ["models.npz", "run.json"]


def test_a_run_that_came_to_nothing_does_not_stand_in_the_way_of_other_settings(fitted, tmp_path, legtool):
    save_run(fitted, tmp_path / "whole")
    legtool(str(tmp_path / "whole"), str(tmp_path / "run"), code=_SAVE, kill_at_rename=2)
    assert [item.name for item in (tmp_path / "run").glob("[!.]*")] == ["run.json"]
    save_run(dataclasses.replace(fitted, settings={**fitted.settings, "folds": 4}), tmp_path / "run")
    assert load_run(tmp_path / "run").settings["folds"] == 4


def test_data_that_was_moved_is_the_same_data_and_other_data_is_not(fitted, tmp_path):
    first, moved, other = (
        dataclasses.replace(fitted, data={"hash": hashed, "paths": [path]})
        for hashed, path in (("a", "here"), ("a", "there"), ("b", "here"))
    )
    save_run(first, tmp_path)
    save_run(moved, tmp_path)
    assert load_run(tmp_path).data["paths"] == ["there"]
    with pytest.raises(OutputError, match='data_hash is "a" there, "b" here'):
        save_run(other, tmp_path)


def test_mixed_robots_and_instants_are_refused(tmp_path):
    first = dataset(tmp_path / "a")
    go2 = dataset(tmp_path / "b", robot=load_robot("go2").geometry())
    taller = dataset(tmp_path / "c", robot=dataclasses.replace(ROBOT, thigh_length=ROBOT.thigh_length + 0.01))
    other_instant = dataset(tmp_path / "d", instant="full_stance_end")
    for other, message in ((go2, "robot 'go2'"), (taller, "other dimensions"), (other_instant, "full_stance_end")):
        with pytest.raises(DatasetError, match=message):
            list(train_motion([first, other], MotionTrainSettings(), tmp_path / "run"))
    with pytest.raises(DatasetError, match="no dataset was given"):
        list(train_motion([], MotionTrainSettings(), tmp_path / "run"))
    assert not (tmp_path / "run").exists()
