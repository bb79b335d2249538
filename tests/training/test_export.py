from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import torch

from legtool.configs.export import ExportSettings
from legtool.configs.motion import MotionTrainSettings
from legtool.configs.robots import load_robot
from legtool.configs.steppability import NetworkSettings, SteppabilityTrainSettings
from legtool.datasets import network_run
from legtool.datasets.files import write_json
from legtool.datasets.motion.run import FittedMotion, load_run, save_run
from legtool.datasets.motion.samples import load_transitions, motion_data
from legtool.datasets.motion.steps import NUMBERS, SCHEMA
from legtool.datasets.store import Store, part_path, write_part
from legtool.errors import DatasetError, OutputError
from legtool.evaluation.report.results import keep_with_run
from legtool.models.motion import build
from legtool.models.steppability_run import build_net, load_steppability_run
from legtool.training import export, freeze
from legtool.training.export import describe_export, export_bundle
from legtool_runtime import BundleError, MotionModel, load_bundle
from legtool_runtime.bundle import content_sha256
from legtool_runtime.motion.features import FEATURES
from legtool_runtime.perception.camera import as_metres
from legtool_runtime.perception.depth import prepare, prepared_camera

STEPS = 600
SETTINGS = ExportSettings(states=1000)


def write_dataset(path: Path, *, robot: str = "aliengo", instant: str = "full_stance_end", seed: int = 0) -> Path:
    """Steps of a made-up linear controller with noise: both pairs, all three axes."""
    rng = np.random.default_rng(seed)
    geometry = load_robot(robot).geometry()
    features = rng.normal(scale=0.2, size=(STEPS, len(FEATURES)))
    features[:, 12:] = geometry.stance.ravel() + rng.normal(scale=0.02, size=(STEPS, 12))
    rest = len(NUMBERS) - 1 - len(FEATURES)
    outputs = features @ rng.normal(scale=0.2, size=(len(FEATURES), rest)) + rng.normal(scale=0.01, size=(STEPS, rest))
    block = np.column_stack([np.full(STEPS, 0.3), features, outputs])
    columns = [
        pa.array(["made up"] * STEPS, pa.string()),
        pa.array(["0"] * STEPS, pa.string()),
        pa.array([0] * STEPS, pa.int32()),
        pa.array(["ok"] * STEPS, pa.string()),
        pa.array(np.arange(STEPS) * 300_000_000, pa.int64()),
        pa.array(np.arange(STEPS) % 2, pa.int8()),
        *(pa.array(column, pa.float64()) for column in block.T.copy()),
    ]
    header = {
        "kind": "motion",
        "robot": geometry.to_dict(),
        "instant": instant,
        "settings": {},
        "seed": seed,
        "inputs": [],
        "commit": None,
    }
    with Store(path, header) as store:
        write_part(part_path(path, 0), pa.Table.from_arrays(columns, schema=SCHEMA), counts={"steps": STEPS})
        store.finish(1)
    return path


def write_run(path: Path, data: Path, *, formulation: str = "full", estimator: str = "bayesian") -> Path:
    """A run as train motion writes it, with the chosen models alone: the others take most of the time."""
    loaded = load_transitions([data])
    steps = motion_data(loaded.table)
    folds = 3
    frozen = {
        name: build(estimator, formulation, folds=folds).fit(steps.features, target).frozen()
        for name, target in steps.targets.items()
    }
    fitted = FittedMotion(
        robot=loaded.robot,
        instant=loaded.instant,
        formulation=formulation,
        estimator=estimator,
        settings=MotionTrainSettings(formulation=formulation, estimator=estimator, folds=folds).to_dict(),
        data={"steps": len(steps), **loaded.info},
        scores={},
        models={estimator: {formulation: frozen}},
    )
    save_run(fitted, path, provenance={"commit": "abc", "versions": {}})
    return path


def write_segmenter_run(path: Path, *, robot: str = "aliengo") -> Path:
    """A run as train steppability writes it, its network as it was drawn."""
    settings = load_robot(robot)
    network = NetworkSettings(width=8, depth=10, pooling_channels=16, decoder_channels=16)
    net = build_net(network, settings, prepared_camera(settings.camera.camera()))
    description = {
        "kind": "steppability",
        "robot": settings.to_dict(),
        "settings": SteppabilityTrainSettings(network=network).to_dict(),
        "preparation": ["decimate", "fill_holes"],
        "data_hash": "d",
        "data": {"path": "/data/someone/scenes", "rows": 40, "counts": {}},
        "provenance": {"commit": "abc", "versions": {}},
    }
    with network_run.claim_run(path, description) as run:
        network_run.save_tensors(path / network_run.BEST, net.state_dict())
        write_json(path / "run.json", {**run, "best": {"epoch": 1, "miou": 0.5}, "complete": True})
    return path


@pytest.fixture(scope="session")
def data(tmp_path_factory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data") / "data")


@pytest.fixture(scope="session")
def run(tmp_path_factory, data) -> Path:
    return write_run(tmp_path_factory.mktemp("run") / "run", data)


@pytest.fixture(scope="session")
def bundle(tmp_path_factory, run) -> Path:
    return export_bundle([run], tmp_path_factory.mktemp("bundle") / "bundle", SETTINGS)


def test_the_bundle_holds_the_chosen_models_and_where_they_come_from(bundle, run):
    loaded = load_bundle(bundle)
    fitted = load_run(run)
    for model, frozen in fitted.frozen().items():
        for name in ("coefficients", "intercept", "noise_covariance", "weights_covariance"):
            np.testing.assert_array_equal(loaded.motion.parameters[f"{model}.{name}"], frozen[name])
    assert loaded.robot.to_dict() == fitted.robot.to_dict()
    assert loaded.motion.instant == "full_stance_end"
    line = loaded.manifest["lines"]["motion"]
    assert (line["formulation"], line["estimator"]) == ("full", "bayesian")
    assert line["provenance"]["data"]["hash"] == fitted.data["hash"]
    assert line["provenance"]["commit"] == "abc"
    assert sorted(item.name for item in bundle.iterdir()) == ["CARD.md", "bundle.json", "motion.npz"]


def test_no_path_of_the_machine_is_carried(bundle, data):
    assert str(data.parent) not in (bundle / "bundle.json").read_text() + (bundle / "CARD.md").read_text()


def test_the_agreement_with_the_trained_models_is_in_manifest_and_card(bundle):
    agreement = load_bundle(bundle).manifest["lines"]["motion"]["agreement"]
    differences = agreement["largest_difference"]
    assert agreement["states"] == 1000
    assert len(differences) == 2  # the run's parameters, and the estimators fitted again to the data
    assert 0 < max(differences.values()) < 1e-9
    card = (bundle / "CARD.md").read_text()
    for what, value in differences.items():
        assert f"{value:.1e} to {what}" in card


@pytest.mark.parametrize("settings", [{"formulation": "poly2"}, {"formulation": "no_feet", "estimator": "ols"}])
def test_other_formulations_are_frozen_as_they_were_trained(settings, data, tmp_path):
    out = export_bundle([write_run(tmp_path / "run", data, **settings)], tmp_path / "bundle", SETTINGS)
    assert load_bundle(out).motion.degree == (2 if settings["formulation"] == "poly2" else 1)


def test_the_example_on_the_card_runs_where_the_bundle_lies(bundle):
    code = re.search(r"```python\n(.*?)```", (bundle / "CARD.md").read_text(), re.DOTALL)
    assert code is not None
    done = subprocess.run(
        [sys.executable, "-c", code.group(1)], cwd=bundle.parent, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.replace("[", " ").replace("]", " ").split()) == 12  # six commands, mean and deviation


def test_without_its_data_a_run_is_compared_with_its_own_parameters(data, tmp_path):
    copy = tmp_path / "data"
    shutil.copytree(data, copy)
    run = write_run(tmp_path / "run", copy)
    shutil.rmtree(copy)
    line = load_bundle(export_bundle([run], tmp_path / "bundle", SETTINGS)).manifest["lines"]["motion"]
    assert len(line["agreement"]["largest_difference"]) == 1
    assert line["range_of"] == "a walking robot"


@pytest.mark.parametrize("part", ["coefficients", "weights_covariance"])
def test_a_model_that_was_frozen_wrongly_is_not_let_out(part, run, tmp_path, monkeypatch):
    def wrong(self, parameters, **kwargs):
        changed = dict(parameters)
        changed[f"cdm.{part}"] = np.asarray(changed[f"cdm.{part}"]) * (1 + 1e-6)
        original(self, changed, **kwargs)

    original = MotionModel.__init__
    monkeypatch.setattr(MotionModel, "__init__", wrong)
    with pytest.raises(OutputError, match="not exported: the frozen motion models differ from"):
        export_bundle([run], tmp_path / "bundle", SETTINGS)
    assert list(tmp_path.iterdir()) == []


def test_a_mirroring_mistake_is_not_let_out(run, tmp_path, monkeypatch):
    original = MotionModel.predict

    def unmirrored(self, state, commands):
        return original(self, replace(state, swing_pair=0), commands)

    monkeypatch.setattr(MotionModel, "predict", unmirrored)
    with pytest.raises(OutputError, match="differ from"):
        export_bundle([run], tmp_path / "bundle", SETTINGS)


def test_the_same_export_again_leaves_the_bundle_as_it_is(bundle, run, monkeypatch):
    before = {item.name: item.read_bytes() for item in bundle.iterdir()}
    export_bundle([run], bundle, SETTINGS)
    monkeypatch.setattr(export, "commit", lambda: "another commit")
    export_bundle([run], bundle, SETTINGS)
    assert {item.name: item.read_bytes() for item in bundle.iterdir()} == before
    assert not list(bundle.parent.glob(".*"))


def test_anything_else_at_out_is_refused_and_left_alone(bundle, run, data, tmp_path):
    other = write_run(tmp_path / "run", data, estimator="ols")
    with pytest.raises(OutputError, match=r'holds a bundle .*lines.motion.estimator is "bayesian" there, "ols" here'):
        export_bundle([other], bundle, SETTINGS)
    full = tmp_path / "full"
    full.mkdir()
    (full / "thesis.txt").write_text("dear")
    with pytest.raises(OutputError, match=r"holds something else \(thesis.txt"):
        export_bundle([run], full, SETTINGS)
    with pytest.raises(OutputError, match="is a file"):
        export_bundle([run], full / "thesis.txt", SETTINGS)
    damaged = tmp_path / "damaged"
    shutil.copytree(bundle, damaged)
    (damaged / "motion.npz").write_bytes(b"")
    with pytest.raises(OutputError, match="holds a damaged bundle"):
        export_bundle([run], damaged, SETTINGS)
    assert (full / "thesis.txt").read_text() == "dear"
    assert not list(tmp_path.glob(".*"))


def test_an_empty_directory_and_what_a_killed_export_left_are_used(run, tmp_path):
    out = tmp_path / "bundle"
    out.mkdir()
    leftover = tmp_path / ".bundle.4711.0123abcd.tmp"
    leftover.mkdir()
    (leftover / "motion.npz").write_bytes(b"half")
    assert load_bundle(export_bundle([run], out, SETTINGS)).lines == ("motion",)
    assert not leftover.exists()


def test_killed_before_it_takes_its_place_an_export_leaves_nothing_in_the_way(run, tmp_path, legtool):
    command = ("export", str(run), "--out", str(tmp_path / "bundle"), "--set", "states=1000")
    assert legtool(*command, kill_at_rename=1).returncode == -signal.SIGKILL
    assert not (tmp_path / "bundle").exists() and list(tmp_path.glob(".bundle.*.tmp"))
    done = legtool(*command)
    assert done.returncode == 0, done.stderr
    assert load_bundle(tmp_path / "bundle").lines == ("motion",)
    assert [item.name for item in tmp_path.iterdir()] == ["bundle"]


def test_of_two_exports_into_one_directory_one_is_refused_and_the_other_is_whole(run, tmp_path, legtool):
    command = ("export", str(run), "--out", str(tmp_path / "out" / "bundle"), "--set", "states=1000")
    with legtool.paused_at_rename(tmp_path / "go", *command) as first:
        second = legtool(*command)
        assert second.returncode == 2
        assert "another legtool process is writing here; wait for it to end" in second.stderr
    assert first.returncode == 0
    assert load_bundle(tmp_path / "out" / "bundle").lines == ("motion",)
    assert [item.name for item in (tmp_path / "out").iterdir()] == ["bundle"]


def test_the_motion_line_is_trained_measured_and_exported_without_torch_or_networks_of_other_lines(run, tmp_path):
    code = """
import sys
from pathlib import Path
import legtool.evaluation.motion, legtool.training.motion
from legtool.configs.export import ExportSettings
from legtool.evaluation.report.results import keep_with_run
from legtool.training.export import describe_export, export_bundle
export_bundle([Path(sys.argv[1])], Path(sys.argv[2]), ExportSettings(states=1000))
print(*(name for name in sys.modules if name in ("torch", "legtool.models.foothold", "legtool.models.steppability")))
"""
    command = [sys.executable, "-c", code, str(run), str(tmp_path / "bundle")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == ""


@pytest.fixture(scope="session")
def segmenter_run(tmp_path_factory) -> Path:
    return write_segmenter_run(tmp_path_factory.mktemp("segmenter") / "run")


@pytest.fixture(scope="session")
def two_lines(tmp_path_factory, run, segmenter_run) -> Path:
    return export_bundle([segmenter_run, run], tmp_path_factory.mktemp("bundle") / "two", SETTINGS)


def test_lines_go_into_one_bundle_together(two_lines, run, segmenter_run):
    bundle = load_bundle(two_lines)
    assert set(bundle.lines) == {"motion", "steppability"}
    assert bundle.motion.instant == "full_stance_end"
    agreement = bundle.manifest["lines"]["steppability"]["agreement"]
    assert agreement["images"] >= 4 and max(agreement["largest_difference"].values()) < 1e-3
    # What the runtime says of a raw image is what the network says of the prepared one.
    trained = load_steppability_run(segmenter_run)
    sensor = bundle.steppability.sensor
    assert sensor.camera == trained.robot.camera.camera() and sensor.standing_height == trained.robot.standing_height
    np.testing.assert_allclose(sensor.transform_camera_to_base[:3, 3], trained.robot.camera.position)
    depth = as_metres(np.random.default_rng(0).uniform(0.3, 4.0, (480, 640)).astype(np.float32), sensor.camera)
    with torch.no_grad():
        logits = trained.net(torch.from_numpy(prepare(depth))[None, None])[0].numpy()
    top = np.sort(logits, axis=0)
    clear = top[-1] - top[-2] > 1e-3
    said = bundle.steppability(depth)[::2, ::2]
    assert clear.mean() > 0.5
    np.testing.assert_array_equal(said[clear], logits.argmax(axis=0)[clear] + 1)
    assert "steppability of 320 × 240 depth images" in str(bundle)
    bundle.warm_up()


def test_the_manifest_is_as_the_published_schema_says(two_lines, check_manifest):
    check_manifest(two_lines)


def test_a_reader_without_our_packages_labels_as_the_runtime_does(two_lines, load_script):
    reader = load_script("examples/read_bundle.py")
    bundle = load_bundle(two_lines)
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.3, 4.0, (480, 640)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.4] = np.nan
    depth[100:200, 300:420] = np.nan
    line = reader.read_manifest(two_lines)["lines"]["steppability"]
    prepared = prepare(depth)
    np.testing.assert_array_equal(reader.prepare(depth, line["preparation"]), prepared)
    labels = reader.segment(two_lines, line, depth)
    assert 0.3 < (labels > 0).mean() < 1.0
    np.testing.assert_array_equal(labels, bundle.steppability.predict(prepared))


def test_a_card_tells_of_every_line_and_its_example_runs(two_lines):
    text = (two_lines / "CARD.md").read_text()
    assert "## Motion models" in text and "## Steppability" in text and "640 × 480 pixels" in text
    assert "/data/someone" not in text + (two_lines / "bundle.json").read_text()
    code = re.search(r"```python\n(.*?)```", text, re.DOTALL)
    assert code is not None
    done = subprocess.run(
        [sys.executable, "-c", code.group(1)], cwd=two_lines.parent, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].endswith("regions")


def test_a_segmenter_with_another_class_list_is_refused(two_lines, tmp_path):
    copy = shutil.copytree(two_lines, tmp_path / "copy")
    manifest = json.loads((copy / "bundle.json").read_text())
    manifest["lines"]["steppability"]["labels"] = ["unknown", "floor", "wall", "stairs"]
    manifest["content_sha256"] = content_sha256(manifest)
    (copy / "bundle.json").write_text(json.dumps(manifest))
    with pytest.raises(BundleError, match="its labels are not this runtime's"):
        load_bundle(copy)


def test_results_of_several_lines_each_find_their_own(run, segmenter_run, tmp_path):
    metrics = {"steppability.miou": {"value": 0.5, "ci95": [0.4, 0.6], "n": 9, "unit": "1"}}
    facts = {"trained_on": "d", "data_hash": "d", "seed": 0, "data": ["/data/someone/data"], "run": "/data/someone/run"}
    results = tmp_path / "results.json"
    results.write_text(json.dumps({"metrics": metrics, "provenance": facts}))
    bundle = load_bundle(
        export_bundle([run, segmenter_run], tmp_path / "bundle", SETTINGS.replace(results=[str(results)]))
    )
    assert bundle.metrics("steppability") == metrics and bundle.metrics("motion") == {}
    assert "/data/someone" not in (tmp_path / "bundle" / "bundle.json").read_text()
    results.write_text(json.dumps({"metrics": metrics, "provenance": {**facts, "trained_on": "other"}}))
    with pytest.raises(OutputError, match="measured for a run on other data"):
        export_bundle([segmenter_run], tmp_path / "other", SETTINGS.replace(results=[str(results)]))


def measured(run, value=0.01234):
    metrics = {"fdm.bayesian.x.rmse": {"value": value, "ci95": None, "n": 900, "unit": "m"}}
    provenance = {"trained_on": load_run(run).data["hash"], "data_hash": "d", "seed": 0, "data": [], "split": "folds"}
    return {"metrics": metrics, "provenance": provenance}


def test_results_that_eval_kept_with_a_run_are_found_by_themselves(run, tmp_path):
    copy = tmp_path / "run"
    shutil.copytree(run, copy)
    out = export_bundle([copy], tmp_path / "bundle", SETTINGS)
    assert describe_export(out) == [
        "motion: not measured; run legtool eval motion RUN --out REPORT, then the same export again"
    ]
    write_json(tmp_path / "results.json", measured(run))
    assert list(keep_with_run(tmp_path / "results.json", copy, "motion")) == []
    # The same models, measured since: the same place takes them.
    assert export_bundle([copy], out, SETTINGS) == out
    assert load_bundle(out).metrics("motion")["fdm.bayesian.x.rmse"]["value"] == 0.01234
    assert "12.34 mm" in (out / "CARD.md").read_text()
    assert describe_export(out) == ["motion: 1 figures on the card, measured by folds"]
    write_json(tmp_path / "results.json", measured(run, 0.02))
    list(keep_with_run(tmp_path / "results.json", copy, "motion"))
    export_bundle([copy], out, SETTINGS)
    assert load_bundle(out).metrics("motion")["fdm.bayesian.x.rmse"]["value"] == 0.02
    assert not list(tmp_path.glob(".*"))


def test_a_run_that_cannot_be_written_to_says_how_its_results_are_given(run, tmp_path):
    write_json(tmp_path / "results.json", measured(run))
    said = list(keep_with_run(tmp_path / "results.json", tmp_path / "absent", "motion"))
    assert len(said) == 1 and f"--set results={tmp_path / 'results.json'}" in said[0]


def test_runs_of_two_robots_are_refused_before_any_is_frozen(run, tmp_path, monkeypatch):
    other = write_run(tmp_path / "go2", write_dataset(tmp_path / "go2_data", robot="go2"))
    header = json.loads((other / "run.json").read_text())
    (other / "run.json").write_text(json.dumps({**header, "kind": "steppability"}))
    monkeypatch.setattr(export, "_freeze", lambda *_: pytest.fail("frozen"))
    with pytest.raises(DatasetError, match=r"made for go2, .* for aliengo; export them separately, or collect and"):
        export_bundle([run, other], tmp_path / "bundle", SETTINGS)


def test_models_of_touchdown_states_say_when_they_are_to_be_asked(tmp_path):
    run = write_run(tmp_path / "run", write_dataset(tmp_path / "data", instant="touchdown"))
    out = export_bundle([run], tmp_path / "bundle", SETTINGS)
    assert any("plans once a step, as a pair lands" in line for line in describe_export(out))


def test_a_full_disk_leaves_nothing_and_says_so(run, tmp_path, monkeypatch):
    def full(*_args, **_kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(export.os, "fsync", full)
    with pytest.raises(OutputError, match="no space left on the disk"):
        export_bundle([run], tmp_path / "bundle", SETTINGS)
    assert list(tmp_path.iterdir()) == []


def test_runs_that_do_not_go_together_are_refused(run, data, tmp_path):
    out = tmp_path / "bundle"
    with pytest.raises(DatasetError, match="no run was given"):
        export_bundle([], out, SETTINGS)
    with pytest.raises(DatasetError, match="are both runs of the motion line"):
        export_bundle([run, write_run(tmp_path / "again", data)], out, SETTINGS)
    line = freeze.freeze_motion(run, SETTINGS)
    other = write_run(tmp_path / "go2", write_dataset(tmp_path / "go2_data", robot="go2"))
    with pytest.raises(DatasetError, match=r"made for go2, .* for aliengo"):
        export._check_together([replace(line, name="foothold"), freeze.freeze_motion(other, SETTINGS)])
    with pytest.raises(DatasetError, match=r"states at full_stance_end, .* at touchdown"):
        export._check_together([replace(line, name="foothold", instant="touchdown"), line])


def test_what_is_no_run_is_refused(run, data, tmp_path):
    with pytest.raises(DatasetError, match="not a run"):
        export_bundle([data], tmp_path / "bundle", SETTINGS)
    copy = tmp_path / "copy"
    shutil.copytree(run, copy)
    models = copy / "models.npz"
    models.write_bytes(models.read_bytes()[:-1])
    with pytest.raises(DatasetError, match="SHA-256"):
        export_bundle([copy], tmp_path / "bundle", SETTINGS)
    header = json.loads((copy / "run.json").read_text())
    (copy / "run.json").write_text(json.dumps({**header, "kind": "opera"}))
    with pytest.raises(DatasetError, match="a run of kind 'opera', expected one of: motion"):
        export_bundle([copy], tmp_path / "bundle", SETTINGS)


def test_measured_figures_are_carried_and_only_those_of_this_run(run, tmp_path):
    metrics = {
        "fdm.bayesian.x.rmse": {"value": 0.01234, "ci95": [0.012, 0.013], "n": 900, "unit": "m"},
        "fdm.no_feet.x.rmse": {"value": 0.02, "ci95": None, "n": 900, "unit": "m"},
    }
    results = tmp_path / "results.json"
    provenance = {"trained_on": load_run(run).data["hash"], "data_hash": "d", "seed": 0, "data": ["/data/someone/data"]}
    results.write_text(json.dumps({"metrics": metrics, "provenance": provenance}))
    settings = SETTINGS.replace(results=str(results))
    loaded = load_bundle(export_bundle([run], tmp_path / "bundle", settings))
    assert loaded.metrics("motion") == {"fdm.bayesian.x.rmse": metrics["fdm.bayesian.x.rmse"]}
    card = (tmp_path / "bundle" / "CARD.md").read_text()
    assert "| fdm.bayesian.x.rmse | 12.34 mm | 12 to 13 | 900 |" in card
    assert "no_feet" not in card and "/data/someone" not in (tmp_path / "bundle" / "bundle.json").read_text()

    results.write_text(json.dumps({"metrics": metrics, "provenance": {**provenance, "trained_on": "other"}}))
    with pytest.raises(OutputError, match="measured for a run on other data"):
        export_bundle([run], tmp_path / "other", settings)
    results.write_text("{}")
    with pytest.raises(OutputError, match=r"not the results\.json of legtool eval"):
        export_bundle([run], tmp_path / "other", settings)
