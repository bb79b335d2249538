import json

import numpy as np
import pytest
import torch

from legtool.configs.robots import PRESETS
from legtool.configs.scenes import SceneSettings
from legtool.configs.steppability import NetworkSettings, SteppabilityEvalSettings, SteppabilityTrainSettings
from legtool.datasets.steppability.images import SceneImages
from legtool.datasets.steppability.real_frames import read_real_frames
from legtool.errors import DatasetError
from legtool.evaluation.segmentation_scores import (
    measure,
    slice_masks,
    slice_names,
    steppability_metrics,
    worst_frames,
)
from legtool.evaluation.steppability import eval_steppability
from legtool.models.scores import confusion, iou_of
from legtool.pipeline.scenes import collect_scenes
from legtool.training.steppability import train_steppability

SETTINGS = SteppabilityEvalSettings(bootstrap=200)


class Oracle(torch.nn.Module):
    """Says the label that is written into the depth's millimetres, wrong on its left half where told."""

    def __init__(self, *, wrong=False):
        super().__init__()
        self.wrong = wrong

    def forward(self, depth):
        label = torch.round(depth[:, 0] * 1000).long() % 10
        label = torch.clamp(label, 1, 3) - 1
        if self.wrong:
            label[:, :, :8] = (label[:, :, :8] + 1) % 3
        return torch.nn.functional.one_hot(label, 3).permute(0, 3, 1, 2).float()


def images(scenes=4, seed=0):
    rng = np.random.default_rng(seed)
    label = rng.integers(1, 4, (2 * scenes, 6, 8)).repeat(2, 1).repeat(2, 2).astype(np.uint8)
    depth = (rng.integers(1, 500, label.shape) * 10 + label).astype(np.uint16)
    label[:, 0] = 0
    shape = rng.integers(1, 11, label.shape).astype(np.uint8)
    return SceneImages(depth, label, shape, np.arange(2 * scenes, dtype=np.int32) // 2, np.arange(2 * scenes) % 2)


def test_intersection_over_union_is_that_of_the_sets():
    rng = np.random.default_rng(0)
    truth, said = rng.integers(0, 4, (2, 50, 60)).astype(np.uint8)
    iou = iou_of(confusion(said, truth))
    known = (truth > 0) & (said > 0)
    for c in range(3):
        a, b = (truth == c + 1) & known, (said == c + 1) & known
        assert iou[c] == pytest.approx((a & b).sum() / (a | b).sum())
    assert np.isnan(iou_of(confusion(np.full((2, 2), 1), np.full((2, 2), 1)))[1:]).all()


def test_a_perfect_segmenter_measures_one_and_unknown_pixels_do_not_count():
    metrics = steppability_metrics(measure(Oracle(), images(), SETTINGS), SETTINGS)
    miou = metrics["steppability.miou"]
    assert miou["value"] == 1.0 and miou["ci95"] is None  # never a width of 0
    assert metrics["steppability.accuracy"]["n"] == 8 * 11 * 16
    assert metrics["steppability.scenes"]["value"] == 4


def test_slices_divide_the_image_and_the_worst_frame_comes_first():
    data = images()
    masks = list(slice_masks(data.metres(0), data.label[0], data.shape[0], SETTINGS))
    assert len(masks) == len(slice_names(SETTINGS))
    names = dict(zip(slice_names(SETTINGS), masks, strict=True))
    assert (names["boundary"] ^ names["interior"]).all()
    shapes = sum(mask.astype(int) for name, mask in names.items() if name.startswith("shape."))
    assert (shapes == 1).all()
    measured = measure(Oracle(wrong=True), data, SETTINGS)
    metrics = steppability_metrics(measured, SETTINGS)
    assert metrics["steppability.accuracy"]["value"] == pytest.approx(0.5)
    rows = [
        metrics[f"steppability.confusion.passable.{said}"]["value"]
        for said in ("steppable", "passable", "non_passable")
    ]
    assert sum(rows) == pytest.approx(1) and rows[0] == 0
    worst = worst_frames(measured, 3)
    assert measured.frame_iou[worst[0]] == measured.frame_iou.min()
    assert len(set(data.scene[worst])) == 3


def test_boundary_is_within_reach_of_another_label_and_unknown_is_no_label():
    label = np.ones((20, 30), dtype=np.uint8)
    label[:, 15:] = 3
    label[15:] = 0
    boundary = list(slice_masks(np.ones(label.shape, np.float32), label, label, SETTINGS))[1]
    assert boundary[5, 11:19].all() and not boundary[5, :11].any() and not boundary[5, 19:].any()
    assert not boundary[14, 5]


def test_evaluating_a_run_writes_results_and_a_page_with_real_frames(tmp_path):
    import cv2

    text = (PRESETS / "go2.yaml").read_text().replace("pitch: 0.5}", "pitch: 0.5, width: 160, height: 120}")
    (tmp_path / "small.yaml").write_text(text)
    scenes = SceneSettings(robot=str(tmp_path / "small.yaml"), scenes=10, frames=1)
    collect_scenes(scenes, tmp_path / "data")
    network = NetworkSettings(width=8, depth=10, pooling_channels=16, decoder_channels=16)
    training = SteppabilityTrainSettings(network=network, epochs=1, coarse_epochs=0, batch=4, device="cpu")
    list(train_steppability([tmp_path / "data"], training, tmp_path / "run", workers=1))
    real = tmp_path / "real"
    real.mkdir()
    cv2.imwrite(str(real / "0.png"), np.full((48, 64), 1500, np.uint16))
    (real / "camera.json").write_text(
        json.dumps({"width": 64, "height": 48, "intrinsic_matrix": [60, 0, 0, 0, 60, 0, 31, 23, 1]})
    )
    settings = SETTINGS.replace(real_frames=str(real))
    lines = list(eval_steppability(tmp_path / "run", settings, tmp_path / "out"))
    assert lines[0].startswith("miou")
    results = json.loads((tmp_path / "out/results.json").read_text())
    assert results["metrics"]["steppability.frames"]["value"] == 1
    page = (tmp_path / "out/report.html").read_text()
    assert "Worst frames" in page and "Real frames" in page
    assert 'src="http' not in page and 'href="http' not in page
    other = scenes.replace(seed=1)
    collect_scenes(other, tmp_path / "other")
    list(eval_steppability(tmp_path / "run", SETTINGS, tmp_path / "out2", data=tmp_path / "other"))
    results = json.loads((tmp_path / "out2/results.json").read_text())
    assert results["metrics"]["steppability.frames"]["value"] == 10


def test_real_frames_that_cannot_be_read_are_refused(tmp_path):
    import cv2

    with pytest.raises(DatasetError, match="0 PNG and 0 JSON"):
        read_real_frames(tmp_path)
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((48, 64), np.uint8))
    (tmp_path / "camera.json").write_text("{}")
    with pytest.raises(DatasetError, match="intrinsic_matrix"):
        read_real_frames(tmp_path)
    (tmp_path / "camera.json").write_text(
        json.dumps({"width": 64, "height": 48, "intrinsic_matrix": [60, 0, 0, 0, 60, 0, 31, 23, 1]})
    )
    with pytest.raises(DatasetError, match="16-bit"):
        read_real_frames(tmp_path)
