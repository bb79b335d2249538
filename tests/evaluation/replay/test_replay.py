"""A log in the environment's place: the same plans from the same walk, and predictions against what happened."""

import json
import shutil

import numpy as np
import pytest

from legtool.configs.export import ExportSettings
from legtool.configs.log import LogSettings
from legtool.configs.motion import MotionTrainSettings
from legtool.configs.planner import PlannerEvalSettings
from legtool.configs.replay import ReplaySettings
from legtool.configs.worlds import load_world
from legtool.datasets.motion.run import FittedMotion, save_run
from legtool.datasets.motion.samples import load_transitions, motion_data
from legtool.errors import LegtoolError, LogError
from legtool.evaluation.replay import replay as module
from legtool.evaluation.replay.predictions import one_step, several_steps
from legtool.evaluation.suites.planner import write_recording
from legtool.evaluation.suites.suite_robot import suite_robot
from legtool.evaluation.suites.trial import walk_trial
from legtool.models.motion import build
from legtool.pipeline.log import collect_log
from legtool.training.export import export_bundle
from legtool_runtime import load_bundle
from legtool_runtime.motion.planning.plan import Plan


@pytest.fixture(scope="module")
def recorded(walking_bundle, tmp_path_factory):
    """A walk over a gap, and its recording with the camera."""
    settings = PlannerEvalSettings(
        suite="gap_10", planners=("velocity",), horizons=(3,), trials=1, films=0, record_images=True,
        camera_size=(160, 120),
    )  # fmt: skip
    bundle = load_bundle(walking_bundle)
    walked = walk_trial(bundle, suite_robot(settings, bundle), load_world("gap_10"), settings, "h3", 0, name="walk")
    path = tmp_path_factory.mktemp("recorded") / "walk.mcap"
    write_recording(path, walked, settings, world="gap_10", planner="h3")
    return walked, path


def played(monkeypatch, path, bundle, **settings):
    """Replay a log, and keep the planner."""
    kept = []
    make = module._planner
    monkeypatch.setattr(module, "_planner", lambda *given: kept.append(make(*given)) or kept[-1])
    given = module._given([path], bundle, ReplaySettings(topics="legtool", **settings))
    replayed, recording, messages = module.play(given)
    return kept[0], replayed, recording, messages


def test_the_same_plans_come_out_to_the_last_bit(monkeypatch, recorded, walking_bundle):
    walked, path = recorded
    planner, replayed, recording, _ = played(monkeypatch, path, walking_bundle)
    again, before = planner.velocity.history, walked.history
    assert len(before.executed) >= 8 and len(again.executed) == len(before.executed)
    for one, other in zip(before.executed, again.executed, strict=True):
        for name in set(Plan._fields) - {"planning_time_s"}:
            assert np.array_equal(getattr(one, name), getattr(other, name)), name
    assert len(again.planning_times_s) == len(before.planning_times_s)
    for (_, costmap, place), (_, other_map, other_place) in zip(before.snapshots, again.snapshots, strict=True):
        assert np.array_equal(costmap.distance, other_map.distance) and np.array_equal(place, other_place)
    assert np.array_equal(recording.position_world, walked.every_tick[0].position_world)
    assert replayed.answers.same == replayed.answers.ticks == len(recording)
    assert replayed.images == sum(m.topic == "/camera/depth/image" for m in walked.messages)


def test_another_horizon_plans_otherwise_on_the_same_maps(monkeypatch, recorded, walking_bundle):
    walked, path = recorded
    planner, replayed, _, _ = played(monkeypatch, path, walking_bundle, horizon=5)
    assert replayed.answers.same < replayed.answers.ticks
    costmaps = [costmap.distance for _, costmap, _ in walked.history.snapshots]
    assert all(
        np.array_equal(a, b.distance)
        for a, (_, b, _) in zip(costmaps, planner.velocity.history.snapshots, strict=False)
    )


def bare(path, target, *, left_out=("/tf_static",)):
    """A recording without what legtool knows of itself, as a robot's own recorder writes it."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    with path.open("rb") as source, target.open("wb") as file:
        reader, writer, channels = make_reader(source), Writer(file), {}
        writer.start("ros2", "a recorder")
        for schema, channel, message in reader.iter_messages():
            if channel.topic in left_out:
                continue
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, "cdr", number)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()
    return target


def test_a_robots_own_recording_goes_by_its_transforms_and_commands(monkeypatch, tmp_path, recorded, walking_bundle):
    _, path = recorded
    log = bare(path, tmp_path / "bare.mcap", left_out=())
    planner, replayed, _, messages = played(monkeypatch, log, walking_bundle, horizon=3)
    answers = replayed.answers
    assert answers.steps >= 8 and answers.planned > 0.5 * answers.steps and planner.velocity.goal is None
    said = [touchdown.said for touchdown in replayed.touchdowns]
    assert len(said) >= 16 and said.count("unsafe") <= 2 and said.count("unknown") < 0.5 * len(said)
    drawn = {message.topic for message in messages}
    assert {"/map/steppable", "/map/elevation", "/camera/points", "/plan", "/footsteps", "/times/plan"} <= drawn


def test_without_a_transform_the_log_is_refused_until_told(tmp_path, recorded, walking_bundle):
    import yaml

    _, path = recorded
    log = bare(path, tmp_path / "bare.mcap")
    with pytest.raises(LogError, match="no transform leads from its frame 'camera_optical' to base or"):
        list(module.replay([log], walking_bundle, ReplaySettings(topics="legtool"), tmp_path / "out"))
    from legtool.configs.topics import load_topics

    topics = {**load_topics("legtool").model_dump(mode="json", exclude_defaults=True)}
    topics["depth"] = {"topic": "/camera/depth/image", "position": [0.28, 0.0, 0.06], "pitch": 0.5}
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(topics))
    settings = ReplaySettings(topics=str(tmp_path / "mine.yaml"))
    lines = list(module.replay([log], walking_bundle, settings, tmp_path / "out"))
    assert any("steps with a whole plan" in line for line in lines), lines


def test_what_is_written_is_read_by_others(tmp_path, recorded, walking_bundle):
    from rosbags.highlevel import AnyReader

    _, path = recorded
    out = tmp_path / "out"
    lines = list(module.replay([path], walking_bundle, ReplaySettings(topics="legtool"), out))
    assert "ticks at which the plan is what was commanded: 100 %" in "\n".join(lines)
    results = json.loads((out / "results.json").read_text())["metrics"]
    assert results["plans.as_commanded"]["value"] == 1.0 and results["images"]["value"] > 20
    page = (out / "report.html").read_text()
    assert page.count("<svg") >= 2 and "steps that began with a whole plan" in page
    with AnyReader([out / "replay.mcap"]) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        assert kinds["/map/elevation"] == "grid_map_msgs/msg/GridMap"
        assert kinds["/map/steppable"] == "nav_msgs/msg/OccupancyGrid"
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            if connection.topic == "/footsteps":
                assert {marker.ns for marker in message.markers[1:]} == {"predicted", "actual", "error"}
    again = tmp_path / "again"
    list(module.replay([out / "replay.mcap"], walking_bundle, ReplaySettings(topics="legtool"), again))
    assert json.loads((again / "results.json").read_text())["metrics"]["fdm.mae"]["n"] > 5  # it is a log itself


@pytest.fixture(scope="module")
def aliengo_log(shared_data):
    return shared_data / "aliengo" / "real_continuous.csv"


@pytest.fixture(scope="module")
def aliengo_bundle(aliengo_log, tmp_path_factory):
    root = tmp_path_factory.mktemp("aliengo")
    collect_log([aliengo_log], LogSettings(robot="aliengo", topics="aliengo_csv"), root / "data")
    loaded = load_transitions([root / "data"])
    steps = motion_data(loaded.table)
    frozen = {
        name: build("bayesian", "full", folds=3).fit(steps.features, target).frozen()
        for name, target in steps.targets.items()
    }
    fitted = FittedMotion(
        robot=loaded.robot, instant=loaded.instant, formulation="full", estimator="bayesian",
        settings=MotionTrainSettings(folds=3).to_dict(), data={"steps": len(steps), **loaded.info}, scores={},
        models={"bayesian": {"full": frozen}},
    )  # fmt: skip
    save_run(fitted, root / "run")
    return export_bundle([root / "run"], root / "bundle", ExportSettings(states=1000))


def test_a_real_log_without_depth_is_predicted(tmp_path, aliengo_log, aliengo_bundle):
    settings = ReplaySettings(topics="aliengo_csv")
    lines = list(module.replay([aliengo_log], aliengo_bundle, settings, tmp_path / "out"))
    assert any("no plans: the log has no depth images" in line for line in lines)
    metrics = json.loads((tmp_path / "out" / "results.json").read_text())["metrics"]
    assert metrics["fdm.mae"]["n"] == 952 and metrics["fdm.mae"]["value"] < 0.012  # fitted to this very log
    assert 0.8 < metrics["fdm.coverage90"]["value"] < 0.98
    errors = [metrics[f"ahead.{k}.touchdown.mae"]["value"] for k in range(1, 6)]
    assert errors == sorted(errors) and errors[0] < 0.01


def test_one_step_of_several_is_the_single_step(aliengo_log, aliengo_bundle, tmp_path):
    collect_log([aliengo_log], LogSettings(robot="aliengo", topics="aliengo_csv"), tmp_path / "data")
    table = load_transitions([tmp_path / "data"]).table
    bundle = load_bundle(aliengo_bundle)
    one = one_step(table, bundle.motion)
    ahead = several_steps(table, bundle.motion, bundle.robot, 3)
    rows = np.searchsorted(one.steps.order, ahead.start)
    assert len(ahead.start) > 900
    # Turned and mirrored, and so of the same length.
    single = np.linalg.norm(one.error["cdm"][rows][:, :2], axis=1)
    assert np.allclose(np.linalg.norm(ahead.com[:, 0], axis=1), single, atol=1e-9)
    feet = np.linalg.norm(one.error["fdm"][rows].reshape(-1, 2, 3)[:, :, :2], axis=2)
    assert np.allclose(np.linalg.norm(ahead.feet[:, 0], axis=2), feet, atol=1e-9)


def test_mistakes_end_in_one_line(tmp_path, recorded, walking_bundle, aliengo_log):
    _, path = recorded
    out = tmp_path / "out"
    for paths, settings, expected in (
        ([], {}, "no log was given"),
        ([tmp_path / "none.mcap"], {}, "no such file"),
        ([aliengo_log], {"topics": "aliengo_csv"}, "rows are touchdowns, and the bundle's models take states at"),
        ([aliengo_log], {"topics": "legtool"}, "is a table"),
        ([path], {"topics": "legtool", "robot": "go2"}, "made for another robot"),
    ):
        with pytest.raises(LegtoolError, match=expected) as told:
            list(module.replay(paths, walking_bundle, ReplaySettings(**settings), out))
        assert "\n" not in str(told.value)
    shutil.rmtree(out, ignore_errors=True)
