import json
import shutil

import numpy as np
import onnxruntime
import pytest
import torch

from legtool.configs.export import ExportSettings
from legtool.configs.scenes import SceneSettings
from legtool.configs.steppability import NetworkSettings, SteppabilityTrainSettings
from legtool.datasets.steppability.images import commonest, load_scene_images
from legtool.errors import DatasetError, OutputError
from legtool.info import describe
from legtool.models.steppability_run import build_net, load_steppability_run
from legtool.pipeline.scenes import collect_scenes
from legtool.training import steppability as training
from legtool.training.freeze_steppability import freeze_steppability, random_images
from legtool.training.loop import layout_for
from legtool.training.steppability import augment, train_steppability
from legtool_runtime.perception import LABELS

NETWORK = NetworkSettings(width=8, depth=10, pooling_channels=16, decoder_channels=16)
SETTINGS = SteppabilityTrainSettings(network=NETWORK, epochs=3, coarse_epochs=1, batch=4, device="cpu")


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """Ten scenes seen by a camera of a quarter of the usual size."""
    from legtool.configs.robots import PRESETS

    root = tmp_path_factory.mktemp("scenes")
    text = (PRESETS / "go2.yaml").read_text().replace("pitch: 0.5}", "pitch: 0.5, width: 160, height: 120}")
    (root / "small.yaml").write_text(text)
    collect_scenes(SceneSettings(robot=str(root / "small.yaml"), scenes=10, frames=2), root / "data")
    return root / "data"


def train(data, settings, out):
    return list(train_steppability([data], settings, out, workers=1))


def weights(path):
    return torch.load(path / "best.pt", weights_only=True)


@pytest.fixture(scope="module")
def run(scenes, tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "run"
    assert "trained 3 epochs on 16 frames" in train(scenes, SETTINGS, out)[-1]
    return out


def test_a_run_tells_its_history_and_loads_its_best_weights(run):
    loaded = load_steppability_run(run)
    history = loaded.description["history"]
    assert [entry["epoch"] for entry in history] == [1, 2, 3]
    assert loaded.description["best"]["miou"] == max(entry["miou"] for entry in history)
    assert loaded.description["preparation"] == ["decimate", "fill_holes"]
    assert (loaded.camera.width, loaded.camera.height) == (80, 60)


def test_a_training_that_was_stopped_carries_on_to_the_same_weights(scenes, run, tmp_path, monkeypatch):
    class Stopped(Exception):
        pass

    original, calls = training.SegmenterLearner.update, []

    def stop(self, step):
        if step == 1:
            calls.append(self._epoch)
            if len(calls) == 2:
                raise Stopped
        return original(self, step)

    monkeypatch.setattr(training.SegmenterLearner, "update", stop)
    with pytest.raises(Stopped):
        train(scenes, SETTINGS, tmp_path / "run")
    train(scenes, SETTINGS, tmp_path / "run")
    assert calls == [0, 1, 1, 2]
    for name, tensor in weights(tmp_path / "run").items():
        assert torch.equal(tensor, weights(run)[name]), name


def test_the_same_training_writes_the_same_bytes(scenes, run, tmp_path):
    train(scenes, SETTINGS, tmp_path / "again")
    assert (tmp_path / "again" / "best.pt").read_bytes() == (run / "best.pt").read_bytes()


@pytest.mark.parametrize(("width", "layout"), [(12, torch.contiguous_format), (16, torch.channels_last)])
def test_a_narrow_network_is_trained_in_a_layout_that_does_not_crash(scenes, run, tmp_path, width, layout):
    """PyTorch ends with a segmentation fault in pointwise convolutions of stride 2 of 12 channels, channels last."""
    made = load_steppability_run(run)
    net = build_net(NETWORK.replace(width=width), made.robot, made.camera)
    assert layout_for(net, torch.device("cpu")) == layout
    if width == 12:
        settings = SETTINGS.replace(network=NETWORK.replace(width=12), epochs=1, coarse_epochs=0)
        assert "trained 1 epochs" in train(scenes, settings, tmp_path / "run")[-1]


def test_a_finished_run_is_left_alone_and_another_is_refused(scenes, run):
    before = (run / "best.pt").read_bytes()
    assert "finished" in train(scenes, SETTINGS, run)[0]
    assert (run / "best.pt").read_bytes() == before
    with pytest.raises(OutputError, match=r"settings\.seed is 0 there, 1 here"):
        train(scenes, SETTINGS.replace(seed=1), run)


def test_training_learns(scenes, tmp_path):
    settings = SETTINGS.replace(epochs=12, coarse_epochs=0, learning_rate=0.01)
    train(scenes, settings, tmp_path / "run")
    history = load_steppability_run(tmp_path / "run").description["history"]
    assert history[-1]["loss"] < 0.75 * history[0]["loss"]


def test_augmenting_repeats_with_its_seed_and_keeps_label_and_depth_together(scenes):
    data = load_scene_images(scenes, ["train"])
    depth, label = data.metres(np.arange(4)), data.label[:4]
    one, two = (augment(depth, label, np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(one[0], two[0])
    np.testing.assert_array_equal(one[1], two[1])
    assert (one[1][one[0] == 0] == 0).all()
    mirrored = 0
    for n in range(4):
        same, turned = (np.abs(one[0][n] - d)[one[0][n] > 0].mean() for d in (depth[n], depth[n][:, ::-1]))
        mirrored += turned < same
        truth = label[n][:, ::-1] if turned < same else label[n]
        known = one[1][n] > 0
        np.testing.assert_array_equal(one[1][n][known], truth[known])
    assert 0 < mirrored < 4


def test_a_pixel_without_return_has_no_label_and_a_block_its_commonest(scenes):
    data = load_scene_images(scenes, ["train", "validation", "test"])
    assert len(data) == 20 and (data.label[data.depth == 0] == 0).all()
    label = np.array([[1, 2, 0, 0, 3, 3], [2, 2, 0, 3, 1, 1]], dtype=np.uint8)
    np.testing.assert_array_equal(commonest(label, 2), [[2, 3, 1]])


def test_the_frozen_network_answers_as_the_trained_one_and_describes_itself(run):
    line = freeze_steppability(run, ExportSettings())
    assert line.description["labels"] == list(LABELS) and line.description["input"]["shape"] == [1, 1, 60, 80]
    json.dumps(line.description, allow_nan=False)
    session = onnxruntime.InferenceSession(line.files["steppability.onnx"], providers=["CPUExecutionProvider"])
    image = random_images(load_steppability_run(run), seed=5)[:1]
    label, logits = session.run(["label", "logits"], {"depth": image})
    with torch.no_grad():
        expected = load_steppability_run(run).net(torch.from_numpy(image)).numpy()
    np.testing.assert_allclose(logits, expected, atol=1e-4)
    missing = ~((image[:, 0] > 0.05) & (image[:, 0] < 50))
    assert (
        missing.any()
        and (label[missing] == 0).all()
        and (label[~missing] == 1 + expected.argmax(1)[~missing]).mean() > 0.999
    )


def test_damaged_and_foreign_runs_are_refused(run, tmp_path):
    with pytest.raises(DatasetError, match="not a run"):
        load_steppability_run(tmp_path)
    copy = shutil.copytree(run, tmp_path / "copy")
    (copy / "best.pt").write_bytes(b"nothing")
    with pytest.raises(DatasetError, match="damaged"):
        load_steppability_run(copy)
    description = json.loads((copy / "run.json").read_text())
    (copy / "run.json").write_text(json.dumps({**description, "kind": "motion"}))
    with pytest.raises(DatasetError, match="kind 'motion'"):
        load_steppability_run(copy)


def test_one_dataset_of_scenes_is_needed(scenes, tmp_path):
    with pytest.raises(DatasetError, match="0 datasets"):
        list(train_steppability([], SETTINGS, tmp_path / "run"))
    if not torch.cuda.is_available():
        with pytest.raises(DatasetError, match="no GPU"):
            train(scenes, SETTINGS.replace(device="cuda"), tmp_path / "run")


def test_a_run_says_how_far_it_came(run):
    lines = describe(run)
    assert "steppability run of go2" in lines[0]
    best = load_steppability_run(run).description["best"]
    assert f"best epoch {best['epoch']} of 3" in lines[-1] and f"miou {best['miou']:.4f}" in lines[-1]


def test_results_with_many_metrics_show_the_general_ones(tmp_path):
    metrics = {f"steppability.range.{n}m.miou": {"value": 0.5, "ci95": None, "n": 1, "unit": "1"} for n in range(50)}
    metrics["steppability.miou"] = {"value": 0.75, "ci95": [0.7, 0.8], "n": 9, "unit": "1"}
    (tmp_path / "results.json").write_text(json.dumps({"metrics": metrics}))
    lines = describe(tmp_path)
    assert len(lines) == 3 and "steppability.miou 0.75" in lines[1]
    assert lines[2] == "  50 metrics more: legtool info --all"
    assert len(describe(tmp_path, every=True)) == 52
