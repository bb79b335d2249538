import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from legtool.configs.perception import PerceptionEvalSettings
from legtool.configs.robots import PRESETS, load_robot
from legtool.errors import RobotError, SettingsError
from legtool.evaluation.suites import region_scores as columns
from legtool.evaluation.suites.perception import eval_perception, perception_metrics
from legtool.evaluation.suites.plane_segmentation import segment_planes
from legtool.evaluation.suites.region_scores import covered, jitter, polygons, score
from legtool.sim.sensors.depth_camera import mount
from legtool.sim.worlds.faces import FaceMap
from legtool_runtime.errors import BundleError
from legtool_runtime.perception import NON_PASSABLE
from legtool_runtime.perception.steppability import Sensor
from legtool_runtime.terrain.elevation import HeightMap

RESOLUTION = 0.005
UP = np.array([[0.0, 0.0, 1.0]])


@pytest.fixture
def step():
    """Flat ground with a step of 10 cm from x = 0 on, and a post at (-0.3, 0)."""
    n = round(1.0 / RESOLUTION)
    heights, faces = np.zeros((n, n), np.float32), np.zeros((n, n), np.int16)
    heights[n // 2 :], faces[n // 2 :] = 0.1, 1
    centre = (np.arange(n) + 0.5) * RESOLUTION - 0.5
    free = np.hypot(centre[:, None] + 0.3, centre) > 0.03
    return FaceMap(heights, faces, free, np.array([-0.5, -0.5]), RESOLUTION, -1)


def square(x0, x1, y0, y1, z):
    return np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])


@pytest.mark.parametrize(
    ("x0", "x1", "z", "pure", "over"),
    [
        (0.1, 0.3, 0.1, 1, 0.0),  # on the step
        (0.1, 0.3, 0.108, 1, 0.0),  # within 1 cm of it
        (0.1, 0.3, 0.115, 0, 0.0),  # further, but over no edge
        (-0.008, 0.3, 0.1, 1, 0.008),  # beyond its rim by less than 1 cm
        (-0.05, 0.3, 0.1, 0, 0.05),  # by more
        (-0.15, 0.06, 0.0, 0, 0.06),  # floor that goes on where the step is
    ],
)
def test_a_region_is_pure_if_it_lies_on_one_face_and_what_hangs_over_is_its_area(step, x0, x1, z, pure, over):
    (found,) = score(polygons([square(x0, x1, 0.1, 0.3, z)], UP, step), step, 0.01)
    assert found[columns.PURE] == pure
    assert found[columns.CELLS] * RESOLUTION**2 == pytest.approx((x1 - x0) * 0.2, abs=0.0015)
    assert found[columns.OVER] * RESOLUTION**2 == pytest.approx(over * 0.2, abs=0.0008)
    main = 1 if z > 0.05 else 0
    assert found[columns.MAIN] == main
    assert found[columns.HEIGHT_ERROR] == pytest.approx(abs(z - 0.1 * main), abs=1e-6)


def test_a_post_on_a_region_hangs_over_nothing_and_yet_takes_its_place(step):
    (found,) = score(polygons([square(-0.4, -0.2, -0.1, 0.1, 0.0)], UP, step), step, 0.01)
    assert found[columns.PURE] == 0
    assert found[columns.OVER] * RESOLUTION**2 == pytest.approx(np.pi * 0.03**2, rel=0.1)


def test_the_angle_to_the_true_face_is_measured(step):
    tilt = 0.05
    corners = square(0.1, 0.14, 0.1, 0.14, 0.1)
    corners[:, 2] += np.tan(tilt) * (corners[:, 0] - 0.12)
    normal = np.array([[-np.sin(tilt), 0.0, np.cos(tilt)]])
    (found,) = score(polygons([corners], normal, step), step, 0.01)
    assert found[columns.PURE] == 1 and found[columns.NORMAL_ERROR] == pytest.approx(tilt, rel=1e-3)
    (clockwise,) = score(polygons([corners[::-1]], normal, step), step, 0.01)
    np.testing.assert_allclose(clockwise, found)


def test_what_is_covered_is_covered_at_the_right_height(step):
    over = covered(polygons([square(-0.1, 0.1, 0.1, 0.3, 0.1)], UP, step), step, 0.01)
    assert over.sum() * RESOLUTION**2 == pytest.approx(0.02, rel=0.1)
    assert not over[:100].any()


def test_jitter_is_the_way_to_the_patch_that_shares_most(step):
    before = polygons([square(0.1, 0.2, 0.1, 0.2, 0.1), square(0.4, 0.45, -0.4, -0.3, 0.1)], np.repeat(UP, 2, 0), step)
    after = polygons([square(0.19, 0.4, 0.1, 0.2, 0.1), square(0.12, 0.22, 0.1, 0.2, 0.1)], np.repeat(UP, 2, 0), step)
    moved, shared = jitter(before, after, step)
    np.testing.assert_allclose(moved, [0.02], atol=1e-9)  # the second has nothing to be compared with
    # Cells that both of the after-patches cover belong to the later one.
    np.testing.assert_allclose(shared, [0.08 / 0.12], rtol=0.05)


def test_the_baseline_cuts_a_map_into_its_faces(step):
    n = 50
    heights = np.zeros((n, n), np.float32)
    heights[n // 2 :] = 0.1
    heights[5:10, 5:10] = np.nan
    heights += np.random.default_rng(0).normal(0, 0.001, heights.shape).astype(np.float32)
    planes = segment_planes(HeightMap(heights, 0.02, np.zeros(2)), step, least_area=0.002)
    assert len(planes) == 2
    np.testing.assert_allclose(np.sort(planes.points[:, 2]), [0.0, 0.1], atol=0.001)
    assert (planes.normals[:, 2] > 0.999).all()
    found = score(planes, step, 0.01)
    ground = found[found[:, columns.MAIN] == 0][0]
    assert found[found[:, columns.MAIN] == 1, columns.PURE] == 1
    assert ground[columns.PURE] == 0 and ground[columns.OVER] * RESOLUTION**2 < 0.004  # the post alone


def test_a_piece_that_no_one_plane_fits_is_divided(step):
    x = np.arange(50) * 0.02
    ridge = np.minimum(0.3 * x, 0.3 * (1.0 - x)).astype(np.float32)
    # The bend is gentle enough for the two sides to be one piece.
    smooth = np.convolve(np.pad(ridge, 6, mode="edge"), np.ones(13) / 13, mode="valid").astype(np.float32)
    planes = segment_planes(HeightMap(np.repeat(smooth[:, None], 50, 1), 0.02, np.zeros(2)), step, least_area=0.002)
    slopes = np.rad2deg(np.arctan2(planes.normals[:, 0], planes.normals[:, 2]))
    assert np.abs(slopes - np.rad2deg(np.arctan(0.3))).min() < 1.5
    assert np.abs(slopes + np.rad2deg(np.arctan(0.3))).min() < 1.5


def test_metrics_are_ratios_of_sums_with_intervals_over_walks():
    def walk(pure):
        tally = {"planar.regions": 10, "planar.pure": pure, "planar.area": 1.0, "planar.over": 0.01}
        tally |= {"moved": 0.1, "matched": 10, "shared": 8}
        return {depth: dict.fromkeys(("warm", "cold", "baseline"), tally) for depth in ("exact", "noisy")}

    walks = [walk(pure) for pure in (10, 8, 9, 10, 8)]
    few = perception_metrics(walks[:3], PerceptionEvalSettings(sequences=3))["perception.region_purity"]
    assert few["value"] == pytest.approx(0.9) and few["ci95"] is None  # three walks say little of others
    metrics = perception_metrics(walks, PerceptionEvalSettings(sequences=5))
    purity = metrics["perception.region_purity"]
    assert purity["value"] == pytest.approx(0.9) and purity["n"] == 50
    assert 0.8 <= purity["ci95"][0] < 0.9 < purity["ci95"][1] <= 1.0
    assert metrics["perception.noisy.overhang"]["value"] == pytest.approx(0.01)
    assert metrics["perception.jitter_warm"]["value"] == pytest.approx(0.01)
    assert metrics["perception.jitter_warm"]["unit"] == "m"
    assert "perception.coverage" not in metrics  # nothing was to be covered


@pytest.fixture(scope="module")
def settings(tmp_path_factory):
    """Two short walks of a robot with a camera of a quarter of the usual size."""
    root = tmp_path_factory.mktemp("robot")
    text = (PRESETS / "go2.yaml").read_text().replace("pitch: 0.5}", "pitch: 0.5, width: 160, height: 120}")
    (root / "small.yaml").write_text(text)
    return PerceptionEvalSettings(robot=str(root / "small.yaml"), sequences=2, frames=9, settle=4, flat_floor=1.0)


def test_evaluating_writes_results_and_a_page_and_carries_on(settings, tmp_path, monkeypatch):
    lines = list(eval_perception(None, settings, tmp_path / "out"))
    assert lines[0].startswith("region_purity")
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    for name in ("region_purity", "coverage", "overhang", "height_error", "normal_error", "jitter_warm", "jitter_cold"):
        for prefix in ("", "noisy."):
            entry = results["metrics"][f"perception.{prefix}{name}"]
            assert entry["value"] >= 0 and entry["ci95"] is None, name  # of two walks
    assert results["metrics"]["perception.region_purity"]["value"] > 0.9
    assert results["metrics"]["perception.jitter_warm"]["value"] < results["metrics"]["perception.jitter_cold"]["value"]
    assert "perception.noisy.baseline.region_purity" in results["metrics"]
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("<svg") == 2 and "elevation map of 20 mm" in page

    # What is finished is kept, and gives the same figures.
    for path in (tmp_path / "out" / "trials").glob("scene.true_labels.0001-*"):
        path.unlink()
    walked = []
    from legtool.evaluation.suites import perception

    original = perception.score_walk
    monkeypatch.setattr(perception, "score_walk", lambda *a, **k: walked.append(a[2]) or original(*a, **k))
    assert list(eval_perception(None, settings, tmp_path / "out")) == lines
    assert walked == [1]
    # More walks of the same kind reuse what is there, so do other intervals; a robot that changed is walked anew.
    monkeypatch.setattr(perception, "score_walk", lambda *a, **k: walked.append(a[2]) or pytest.fail("walked"))
    list(eval_perception(None, settings.replace(bootstrap=100, sequences=1), tmp_path / "out"))
    with pytest.raises(pytest.fail.Exception):
        list(eval_perception(None, settings.replace(sequences=3), tmp_path / "out"))
    assert walked == [1, 2]
    robot = Path(settings.robot)
    robot.write_text(robot.read_text().replace("pitch: 0.5,", "pitch: 0.6,"))
    with pytest.raises(pytest.fail.Exception):
        list(eval_perception(None, settings, tmp_path / "out"))
    robot.write_text(robot.read_text().replace("pitch: 0.6,", "pitch: 0.5,"))
    assert walked == [1, 2, 0]


def test_a_bundle_without_a_segmenter_and_settings_that_make_no_sense_are_refused(settings, tmp_path):
    with pytest.raises(BundleError, match="no such directory"):
        list(eval_perception(tmp_path / "none", settings, tmp_path / "out"))
    with pytest.raises(SettingsError, match="settle 8"):
        settings.replace(settle=8)
    assert not (tmp_path / "out").exists()


def test_with_a_bundle_its_segmenter_says_where_feet_may_be_set(settings, tmp_path, monkeypatch):
    robot = load_robot(settings.robot)
    sensor = Sensor(robot.camera.camera(), mount(robot.camera), robot.standing_height)

    class Nowhere:
        def __init__(self, sensor):
            self.sensor = sensor

        def __call__(self, depth):
            return np.full(depth.shape, NON_PASSABLE, dtype=np.uint8)

    manifest = {"content_sha256": "x", "robot": {}, "lines": {}, "files": []}
    bundle = SimpleNamespace(robot=robot.geometry(), steppability=Nowhere(sensor), manifest=manifest)
    monkeypatch.setattr("legtool.evaluation.suites.perception.load_bundle", lambda path: bundle)
    short = settings.replace(sequences=1)
    list(eval_perception(tmp_path / "bundle", short, tmp_path / "out"))
    metrics = json.loads((tmp_path / "out" / "results.json").read_text())["metrics"]
    assert metrics["perception.coverage"]["value"] == 0 and metrics["perception.regions"]["value"] == 0
    with pytest.raises(RobotError, match="made for go2, asked for hyq"):
        list(eval_perception(tmp_path / "bundle", short.replace(robot="hyq"), tmp_path / "other"))
    with pytest.raises(RobotError, match="trained for another camera"):
        list(eval_perception(tmp_path / "bundle", short.replace(robot=None), tmp_path / "other"))
