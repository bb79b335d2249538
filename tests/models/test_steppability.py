import numpy as np
import pytest
import torch

from legtool.configs.steppability import NetworkSettings
from legtool.errors import DatasetError
from legtool.models.encoders import load_encoder_weights
from legtool.models.scores import best_offset
from legtool.models.steppability import DepthFeatures, SegmenterNet, SteppabilityNet
from legtool_runtime.perception.camera import Camera

CAMERA = Camera.from_field_of_view(80, 64, 1.4)


def net(**settings):
    torch.manual_seed(0)
    return SteppabilityNet(NetworkSettings(**{"width": 8, **settings}), CAMERA, pitch=0.5, height=0.4).eval()


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"stem_stride": 4, "output_stride": 32},
        {"depth": 50, "output_stride": 8},
        {"depth": 10},
        {"encoder": "mobile", "width": 16},
        {"encoder": "mobile", "width": 16, "output_stride": 8},
    ],
)
def test_every_encoder_gives_logits_at_every_pixel_and_keeps_its_output_stride(settings):
    model = net(**settings)
    depth = torch.rand(2, 1, 64, 80) * 4 + 0.3
    with torch.no_grad():
        assert model(depth).shape == (2, 3, 64, 80)
        low, high = model.encoder(model.features(depth)[0])
    stride = NetworkSettings(**settings).output_stride
    assert (high.shape[2], high.shape[3]) == (-(-64 // stride), -(-80 // stride))
    assert low.shape[2] == 64 // NetworkSettings(**settings).stem_stride
    assert (low.shape[1], high.shape[1]) == model.encoder.channels


def test_zero_nan_and_infinite_depth_are_all_the_same_missing_return():
    model = SegmenterNet(net())
    depth = torch.rand(1, 1, 64, 80) * 4 + 0.3
    hole = torch.rand(1, 1, 64, 80) < 0.2
    outputs = []
    for value in (0.0, float("nan"), float("inf"), -1.0):
        with torch.no_grad():
            outputs.append(model(torch.where(hole, torch.tensor(value), depth)))
    for label, logits in outputs:
        assert torch.isfinite(logits).all()
        torch.testing.assert_close(logits, outputs[0][1])
        assert (label[hole[:, 0]] == 0).all()
        assert ((label[~hole[:, 0]] >= 1) & (label[~hole[:, 0]] <= 3)).all() and label.dtype == torch.uint8


def test_features_are_linear_over_a_plane_zero_height_on_the_ground_and_know_up():
    pitch, height = 0.5, 0.4
    features = DepthFeatures(CAMERA, pitch=pitch, height=height)
    rows = (np.arange(64) - CAMERA.cy) / CAMERA.fy
    below = rows * np.cos(pitch) + np.sin(pitch)
    z = np.where(below > 0.05, height / np.maximum(below, 0.05), 0.0)
    depth = torch.from_numpy(np.repeat(z[:, None], 80, axis=1)[None, None].astype(np.float32))
    values, known = features(depth)
    ground = known[0, 0, :, 0].numpy()
    near = values[0, 0, :, 0].numpy()[ground]
    assert np.abs(np.diff(near, 2)).max() < 1e-4
    assert np.abs(values[0, 1].numpy()[ground]).max() < 1e-5
    assert np.abs(values[0, 2].numpy()[ground][3:-3] - 1).max() < 1e-3
    missing = ~torch.from_numpy(ground)
    assert not values[0, :2, missing].any() and (values[0, 2, missing] == -1.5).all()


@pytest.mark.parametrize("slope", (-0.6, 0.0, 0.3, np.pi / 2 - 0.5))
def test_up_is_the_cosine_of_a_planes_slope_without_and_with_holes(slope):
    features = DepthFeatures(CAMERA, pitch=0.5, height=0.4)
    # A plane whose normal, optical frame, is that of level ground turned about the camera's x axis.
    up = np.array([0.0, -np.cos(0.5 + slope), -np.sin(0.5 + slope)])
    v, u = np.meshgrid(np.arange(64), np.arange(80), indexing="ij")
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1)
    z = np.where(rays @ up < -0.1, -0.5 / np.minimum(rays @ up, -0.1), 0.0).astype(np.float32)
    seen = z > 0
    inner = seen.copy()
    inner[3:-3, 3:-3] &= np.stack([np.roll(seen, (i, j), (0, 1)) for i in (-3, 3) for j in (-3, 3)]).all(0)[3:-3, 3:-3]
    inner[:3], inner[-3:], inner[:, :3], inner[:, -3:] = False, False, False, False
    values = features(torch.from_numpy(z)[None, None])[0][0, 2].numpy()
    assert inner.sum() > 500
    assert np.abs(values[inner] - np.cos(slope)).max() < 2e-3
    holes = np.random.default_rng(0).uniform(size=z.shape) < 0.05
    values = features(torch.from_numpy(np.where(holes, 0, z))[None, None])[0][0, 2].numpy()
    assert np.median(np.abs(values[inner & ~holes] - np.cos(slope))) < 0.1


def test_encoder_weights_are_loaded_by_their_usual_names(tmp_path):
    for settings, name in (({}, "layer3.0.conv2.weight"), ({"encoder": "mobile"}, "features.2.conv.1.0.weight")):
        source, target = net(**settings).encoder, net(**settings).encoder
        for parameter in source.parameters():
            parameter.data.normal_()
        torch.save({**source.state_dict(), "fc.weight": torch.zeros(10, 4)}, tmp_path / "w.pt")
        assert load_encoder_weights(target, tmp_path / "w.pt") == len(source.state_dict())
        torch.testing.assert_close(target.state_dict()[name], source.state_dict()[name])


def test_weights_that_do_not_fit_are_refused_with_the_reason(tmp_path):
    encoder = net().encoder
    with pytest.raises(DatasetError, match="no such file"):
        load_encoder_weights(encoder, tmp_path / "none.pt")
    (tmp_path / "text.pt").write_text("hello")
    with pytest.raises(DatasetError, match="not a PyTorch file"):
        load_encoder_weights(encoder, tmp_path / "text.pt")
    torch.save(net(width=12).encoder.state_dict(), tmp_path / "wide.pt")
    with pytest.raises(DatasetError, match=r"conv1.weight has shape .*12.*network\.width"):
        load_encoder_weights(encoder, tmp_path / "wide.pt")
    torch.save({"layer9": torch.zeros(1)}, tmp_path / "other.pt")
    with pytest.raises(DatasetError, match=r"lacks conv1\.weight"):
        load_encoder_weights(encoder, tmp_path / "other.pt")


def test_an_image_of_every_second_pixel_has_the_features_of_those_pixels():
    features = DepthFeatures(CAMERA, pitch=0.5, height=0.4)
    rows = (torch.arange(64) - CAMERA.cy) / CAMERA.fy
    depth = (0.4 / torch.clamp(rows * np.cos(0.5) + np.sin(0.5), min=0.1)).reshape(1, 1, -1, 1).expand(1, 1, 64, 80)
    whole, coarse = features(depth)[0], features(depth[:, :, ::2, ::2])[0]
    torch.testing.assert_close(coarse[:, :2], whole[:, :2, ::2, ::2])
    inner = (slice(None), slice(2), slice(12, -4), slice(4, -4))
    torch.testing.assert_close(coarse[:, 2:][inner], whole[:, 2:, ::2, ::2][inner], atol=0.01, rtol=0)


def test_the_offset_moves_decisions_in_evaluation_only():
    model = net()
    depth = torch.rand(2, 1, 64, 80) * 4 + 0.3
    with torch.no_grad():
        plain = model(depth)
        model.offset.copy_(torch.tensor([0.0, 1.0, -2.0]))
        torch.testing.assert_close(model(depth), plain + model.offset.reshape(1, 3, 1, 1), rtol=1e-4, atol=1e-4)
        model.train()
        trained = model(depth)
        model.offset.zero_()
        torch.testing.assert_close(model(depth), trained)


def test_the_best_offset_undoes_a_bias_and_is_none_where_none_is_needed():
    rng = np.random.default_rng(0)
    truth = rng.integers(0, 4, (5, 40, 50)).astype(np.uint8)
    logits = np.stack([(truth == c + 1) * 2.0 for c in range(3)], axis=1) + rng.normal(0, 0.5, (5, 3, 40, 50))
    assert not best_offset(logits.astype(np.float32), truth).any()
    biased = logits + np.array([0.0, 1.5, -1.0])[:, None, None]
    np.testing.assert_allclose(best_offset(biased.astype(np.float32), truth), [0.0, -1.5, 1.0])
