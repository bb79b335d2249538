import numpy as np
import pytest

from legtool.configs.scenes import SceneSettings
from legtool.configs.settings import build
from legtool.datasets.steppability.contact_sheet import contact_sheet, describe_scenes
from legtool.datasets.steppability.scenes import (
    check_scenes,
    decode_depth,
    encode_depth,
    read_frames,
    split_scenes,
)
from legtool.errors import DatasetError, OutputError, SettingsError
from legtool.pipeline.scenes import collect_scenes, scene_frames

SETTINGS = SceneSettings(scenes=12, frames=2, seed=4)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenes") / "d"
    return path, collect_scenes(SETTINGS, path)


def test_what_is_read_is_what_was_drawn(dataset):
    path, manifest = dataset
    assert manifest["counts"]["scenes"] == 12 and manifest["rows"] == 24
    frames = list(read_frames(path))
    assert [(f["scene"], f["frame"]) for f in frames] == [(s, f) for s in range(12) for f in range(2)]
    drawn = scene_frames(SETTINGS, 5)[1]
    read = frames[11]
    np.testing.assert_array_equal(read["label"], drawn.label)
    np.testing.assert_array_equal(read["shape"], drawn.shape)
    np.testing.assert_array_equal(read["colour"], drawn.colour)
    np.testing.assert_array_equal(read["pose"], drawn.pose)
    np.testing.assert_array_equal(np.isnan(read["depth"]), np.isnan(drawn.depth))
    assert np.nanmax(np.abs(read["depth"] - drawn.depth)) <= 0.00051
    pixels = sum(np.bincount(f["label"].ravel(), minlength=4) for f in frames)
    assert [manifest["counts"][f"pixels_{n}"] for n in ("unknown", "steppable", "passable", "non_passable")] == list(
        pixels
    )
    assert (pixels[1:] > 0).all()


def test_a_scene_keeps_all_its_frames_in_one_split(dataset):
    path, _ = dataset
    splits = {}
    for frame in read_frames(path, columns=["scene", "split"]):
        splits.setdefault(frame["scene"], set()).add(frame["split"])
    assert all(len(found) == 1 for found in splits.values())
    assert sorted(s for found in splits.values() for s in found) == ["test", *["train"] * 10, "validation"]


def test_scenes_are_split_80_10_10():
    splits = split_scenes(600, 0)
    assert [splits.count(name) for name in ("train", "validation", "test")] == [480, 60, 60]
    assert split_scenes(600, 0) == splits != split_scenes(600, 1)


@pytest.mark.slow
def test_the_dataset_is_the_same_bytes_with_two_workers(dataset, tmp_path):
    _, manifest = dataset
    assert collect_scenes(SETTINGS, tmp_path / "d", workers=2)["parts"] == manifest["parts"]


def test_an_interrupted_collection_carries_on_and_another_is_refused(dataset, tmp_path):
    path, manifest = dataset
    copy = tmp_path / "d"
    copy.mkdir()
    text = (path / "manifest.json").read_text().replace('"complete": true', '"complete": false')
    (copy / "manifest.json").write_text(text)
    (copy / "part-00001.parquet").write_bytes((path / "part-00001.parquet").read_bytes())
    with pytest.raises(DatasetError, match="not finished"):
        check_scenes(copy)
    assert collect_scenes(SETTINGS, copy)["parts"] == manifest["parts"]
    with pytest.raises(OutputError, match=r"settings\.scenes is 12 there, 13 here"):
        collect_scenes(SETTINGS.replace(scenes=13), copy)


def test_a_contact_sheet_shows_colour_depth_and_labels(dataset):
    sheet = contact_sheet(dataset[0], scenes=3, width=64)
    assert sheet.shape == (3 * 48, 2 * 3 * 64, 3)
    labels = sheet[:, 128:192].reshape(-1, 3)
    assert {tuple(c) for c in np.unique(labels, axis=0).tolist()} <= {
        (0, 0, 0),
        (60, 170, 70),
        (235, 200, 40),
        (215, 50, 50),
    }


def test_a_dataset_describes_itself_and_draws_its_contact_sheet(dataset):
    path, _ = dataset
    lines = describe_scenes(path)
    assert "24 frames of 12 scenes" in lines[1] and "steppable" in lines[2]
    assert (path / "contact_sheet.png").is_file()


def test_depth_survives_to_the_millimetre_and_no_return_stays():
    depth = np.array([[0.2, 5.9994], [np.nan, 1.0]], dtype=np.float32)
    back = decode_depth(encode_depth(depth))
    assert np.isnan(back[1, 0]) and np.nanmax(np.abs(back - depth)) <= 0.00051
    with pytest.raises(DatasetError):
        decode_depth(b"no picture")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"shapes": [9, 3]}, "fewest"),
        ({"placements": {"written": 1}}, "layouts"),
        ({"placements": {"piled": 1}}, "placements"),
        ({"corruptions": ["rain"]}, "corruptions"),
        ({"camera": {"speed": [2, 1]}}, "slowest"),
    ],
)
def test_settings_that_make_no_sense_are_refused_in_one_line(values, message):
    with pytest.raises(SettingsError, match=message):
        build(SceneSettings, values)


def test_an_unknown_layout_names_those_there_are(tmp_path):
    settings = SceneSettings(scenes=1, frames=1, placements={"written": 1}, layouts=("maze",))
    with pytest.raises(SettingsError, match=r"no such preset.*staircase, .*stepping_stones"):
        collect_scenes(settings, tmp_path / "d")


def test_a_written_shape_with_the_wrong_sizes_is_refused(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("name: mine\nshapes: [{shape: sphere, x: 1, y: 0, height: 0.2}]\n")
    settings = SceneSettings(scenes=1, frames=1, placements={"written": 1}, layouts=(str(path),))
    with pytest.raises(SettingsError, match="a sphere takes radius; given: height"):
        collect_scenes(settings, tmp_path / "d")
