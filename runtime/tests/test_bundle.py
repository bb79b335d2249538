from __future__ import annotations

import io
import json
import os
import pickle
import resource
import shutil
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

import legtool_runtime
from legtool_runtime import Bundle, BundleError, load_bundle
from legtool_runtime.bundle import SCHEMA_VERSION, content_sha256
from legtool_runtime.motion.features import FEATURES


class Bomb:
    """Leaves a trace if it is ever unpickled."""

    def __reduce__(self):
        return os.mkdir, ("executed",)


def refusal(path) -> str:
    with pytest.raises(BundleError) as caught:
        load_bundle(path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    return message


def npz(arrays, *, compressed=False) -> bytes:
    buffer = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(buffer, **arrays)
    return buffer.getvalue()


def rewritten(data: bytes, change) -> bytes:
    """The archive with its members' bytes put through ``change``."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w") as new:
        for name in old.namelist():
            new.writestr(name, change(name, old.read(name)))
    return out.getvalue()


@pytest.mark.parametrize("degree", [1, 2])
def test_a_bundle_gives_back_what_was_frozen(degree, write_bundle, parameters, robot):
    bundle = load_bundle(str(write_bundle(degree=degree)))
    assert bundle.lines == ("motion",)
    assert bundle.motion.instant == "full_stance_end"
    assert bundle.motion.degree == degree
    assert bundle.robot.to_dict() == robot.to_dict()
    for name, value in parameters(degree).items():
        np.testing.assert_array_equal(bundle.motion.parameters[name], value)
    assert str(bundle) == f"bundle for testdog: motion models of degree {degree}, states at full_stance_end"


def test_a_bundle_is_found_through_a_link_to_its_directory(write_bundle, tmp_path):
    (tmp_path / "current").symlink_to(write_bundle())
    assert load_bundle(tmp_path / "current").lines == ("motion",)


def test_an_absent_line_says_which_lines_are_there(robot, tmp_path):
    bundle = Bundle(tmp_path, robot, {"foothold": object()}, {})
    with pytest.raises(BundleError, match="holds no motion line, only foothold; export a motion run"):
        _ = bundle.motion
    with pytest.raises(BundleError, match="holds no motion line"):
        bundle.metrics("motion")


def test_metrics_travel_with_the_bundle(write_bundle):
    metrics = {"fdm.full.x.rmse": {"value": 0.0125, "ci95": [0.012, 0.013], "n": 900, "unit": "m"}}
    assert load_bundle(write_bundle(motion={"metrics": metrics})).metrics("motion") == metrics


def test_other_places_are_named_for_what_they_are(tmp_path):
    assert "no such directory" in refusal(tmp_path / "nowhere")
    (tmp_path / "file").write_text("x")
    assert "is a file; expected a bundle" in refusal(tmp_path / "file")
    (tmp_path / "empty").mkdir()
    assert "is no bundle (it has no bundle.json)" in refusal(tmp_path / "empty")
    for marker, kind in (("manifest.json", "a dataset"), ("run.json", "a training run"), ("results.json", "results")):
        place = tmp_path / marker.removesuffix(".json")
        place.mkdir()
        (place / marker).write_text("{}")
        assert kind in refusal(place)


def test_another_kind_of_manifest_is_refused(write_bundle):
    assert "describes 'dataset', expected kind 'bundle'" in refusal(write_bundle(kind="dataset"))


def test_a_newer_schema_asks_for_an_upgrade(write_bundle):
    message = refusal(write_bundle(schema_version=SCHEMA_VERSION + 6))
    assert f"newer legtool: needs schema {SCHEMA_VERSION + 6}, this runtime reads {SCHEMA_VERSION}" in message
    assert "upgrade legtool-runtime" in message


@pytest.mark.parametrize("version", ["1", 1.0, True, 0, -1, None])
def test_a_schema_that_is_no_version_is_refused(version, write_bundle):
    assert "schema_version is" in refusal(write_bundle(schema_version=version))


@pytest.mark.parametrize("name", ["motion.npz", "CARD.md"])
def test_a_tampered_file_is_named(name, write_bundle):
    path = write_bundle()
    data = bytearray((path / name).read_bytes())
    data[len(data) // 2] ^= 1
    (path / name).write_bytes(data)
    assert f"{name}: its bytes differ from the SHA-256" in refusal(path)


@pytest.mark.parametrize("name", ["motion.npz", "CARD.md"])
def test_a_truncated_or_missing_file_is_named(name, write_bundle):
    path = write_bundle()
    (path / name).write_bytes((path / name).read_bytes()[:-1])
    assert f"{name}: has" in refusal(path)
    (path / name).unlink()
    assert f"{name}: missing" in refusal(path)


def test_an_edit_of_the_robot_in_the_manifest_is_noticed(write_bundle):
    path = write_bundle()
    text = (path / "bundle.json").read_text()
    assert "0.24" in text
    (path / "bundle.json").write_text(text.replace("0.24", "0.34", 1))
    assert "bundle.json: was altered" in refusal(path)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        '{"kind": "bundle", "kind": "bundle"}',
        '{"kind": NaN}',
        '{"kind": "bundle", "x": 1e999}',
        '{"kind": "bundle", "x": ' + "9" * 5000 + "}",
        "[" * 100_000,
        '{"a":' * 5_000 + "1" + "}" * 5_000,
        "\xff\xfe",
        "[1]",
        "null",
    ],
)
def test_a_manifest_that_is_no_manifest_is_refused(text, write_bundle):
    path = write_bundle()
    (path / "bundle.json").write_bytes(text.encode("latin-1"))
    assert "bundle.json" in refusal(path)


@pytest.mark.parametrize("key", ["robot", "lines", "provenance", "files"])
@pytest.mark.parametrize("value", [None, "text", 5])
def test_a_part_of_the_manifest_of_the_wrong_type_is_named(key, value, write_bundle):
    assert f"bundle.json: {key} is" in refusal(
        write_bundle(**{key: value} if key != "files" else {"files": value or 0})
    )


def test_a_robot_that_cannot_be_is_refused(write_bundle, robot):
    for change in ({"foot_radius": "x"}, {"hips": [[1]]}, {"foot_radius": 10**400}, {"hips": [[10**400] * 3] * 4}):
        assert refusal(write_bundle(robot={**robot.to_dict(), **change}))
    assert "missing" in refusal(write_bundle(robot={"name": "testdog"}))


@pytest.mark.parametrize(
    "name",
    [
        "../outside.npz",
        "/etc/hostname",
        "a/../../outside.npz",
        "sub/motion.npz",
        "..",
        ".",
        "",
        "a\\b",
        "a\0b",
        5,
        None,
    ],
)
def test_a_name_that_leaves_the_bundle_is_refused_unread(name, write_bundle, tmp_path):
    (tmp_path / "outside.npz").write_bytes(b"secret")
    message = refusal(write_bundle(files=[{"name": name, "bytes": 6, "sha256": "0" * 64}]))
    assert "expected a plain file name" in message


def test_links_pipes_and_directories_inside_a_bundle_are_refused(write_bundle, tmp_path):
    path = write_bundle()
    moved = tmp_path / "outside.npz"
    (path / "motion.npz").rename(moved)
    (path / "motion.npz").symlink_to(moved)
    assert "motion.npz: is a link" in refusal(path)
    (path / "motion.npz").unlink()
    os.mkfifo(path / "motion.npz")
    assert "is not a plain file" in refusal(path)
    (path / "motion.npz").unlink()
    (path / "motion.npz").mkdir()
    assert "motion.npz" in refusal(path)
    manifest = tmp_path / "manifest"
    (path / "bundle.json").rename(manifest)
    (path / "bundle.json").symlink_to(manifest)
    assert "bundle.json: is a link" in refusal(path)


def test_a_file_that_is_not_listed_is_refused_unless_hidden(write_bundle):
    path = write_bundle()
    (path / ".DS_Store").write_text("desktop")
    load_bundle(path)
    (path / "notes.txt").write_text("mine")
    assert "notes.txt: is not listed in bundle.json" in refusal(path)


def test_a_file_listed_twice_or_a_strange_entry_is_refused(write_bundle):
    path = write_bundle()
    files = json.loads((path / "bundle.json").read_text())["files"]
    assert "twice" in refusal(write_bundle(files=[*files, files[0]]))
    assert "files holds" in refusal(write_bundle(files=[*files, "motion.npz"]))
    assert "files holds" in refusal(write_bundle(files=[{"name": "motion.npz"}]))
    assert "lists bundle.json itself" in refusal(write_bundle(files=[{**files[0], "name": "bundle.json"}]))
    assert "motion.npz" in refusal(write_bundle(files=files[:1]))


def test_a_line_of_another_runtime_is_refused(write_bundle):
    assert "line 'flight'; this runtime reads motion" in refusal(write_bundle(lines={"flight": {}}))


@pytest.mark.parametrize(
    "change",
    [
        {"features": ["velocity_y", "velocity_x"]},
        {"feature_units": []},
        {"targets": None},
        {"degree": 3},
        {"degree": True},
        {"degree": "1"},
        {"degree": [1]},
        {"instant": "lift_off"},
        {"instant": None},
        {"metrics": None},
    ],
)
def test_a_motion_line_that_would_be_misread_is_refused(change, write_bundle):
    assert next(iter(change)).rstrip("s") in refusal(write_bundle(motion=change))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.full(6, np.nan), "not finite"),
        (np.full(6, np.inf), "not finite"),
        (np.zeros(6, np.float32), "fdm.intercept"),
        (np.zeros(6, np.int64), "float64"),
        (np.zeros(6, ">f8"), "float64"),
        (np.zeros((6, 1)), "shape (6, 1)"),
        (np.zeros(7), "fdm.intercept"),
        (np.zeros(1_000_000), "fdm.intercept"),
        (np.zeros(6, [("a", "f4"), ("b", "f4")]), "float64"),
    ],
)
def test_an_array_of_another_type_shape_or_value_is_refused(value, message, write_bundle):
    assert message in refusal(write_bundle(arrays={"fdm.intercept": value}))


def test_an_extra_array_is_refused(write_bundle):
    assert "'extra.npy' is unexpected" in refusal(write_bundle(arrays={"extra": np.zeros(3)}))


def test_a_pickle_is_never_executed(write_bundle, parameters, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bomb = np.empty(6, dtype=object)
    bomb[:] = [Bomb()] * 6
    refusal(write_bundle(npz=npz({**parameters(1), "fdm.intercept": bomb})))

    pickled = pickle.dumps(Bomb())
    arrays = npz(parameters(1))
    padded = rewritten(arrays, lambda name, data: pickled.ljust(len(data)) if name == "fdm.intercept.npy" else data)
    refusal(write_bundle(npz=padded))
    header = b"{'descr': '|O', 'fortran_order': False, 'shape': (6,), }".ljust(117) + b"\n"
    disguised = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + pickled
    forged = rewritten(arrays, lambda name, data: disguised[:140].ljust(140) if name == "fdm.intercept.npy" else data)
    assert "float64" in refusal(write_bundle(npz=forged))
    refusal(write_bundle(npz=pickled))
    assert not (tmp_path / "executed").exists()


def test_a_header_that_lies_about_its_size_is_refused(write_bundle, parameters):
    def lie(shape):
        header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".encode().ljust(117) + b"\n"
        start = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
        return rewritten(
            npz(parameters(1)), lambda name, data: start + bytes(48) if name == "fdm.intercept.npy" else data
        )

    load_bundle(write_bundle(npz=lie("(6,)")))
    for shape in ("(1000000000000,)", "(-6,)", "(6, 0)", "(5,)", "6", "(6.0,)", "__import__('os').mkdir('executed')"):
        refusal(write_bundle(npz=lie(shape)))


def test_a_compressed_bomb_is_refused_before_it_is_unpacked(write_bundle, parameters):
    huge = npz({**parameters(1), "fdm.intercept": np.zeros(20_000_000)}, compressed=True)
    assert len(huge) < 1_000_000
    assert "fdm.intercept has 160000128 bytes, expected 48" in refusal(write_bundle(npz=huge))


def test_a_compressed_archive_of_the_right_arrays_loads(write_bundle, parameters):
    assert load_bundle(write_bundle(npz=npz(parameters(1), compressed=True))).lines == ("motion",)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_doubled_members_and_names_that_climb_are_refused(write_bundle, parameters):
    data = io.BytesIO(npz(parameters(1)))
    with zipfile.ZipFile(data, "a") as archive:
        archive.writestr("fdm.intercept.npy", b"another")
    assert "'fdm.intercept.npy' is unexpected or doubled" in refusal(write_bundle(npz=data.getvalue()))
    data = io.BytesIO(npz(parameters(1)))
    with zipfile.ZipFile(data, "a") as archive:
        archive.writestr("../../evil.npy", b"evil")
    assert "unexpected" in refusal(write_bundle(npz=data.getvalue()))


@pytest.mark.filterwarnings("ignore:Reading `.npy`")
def test_random_damage_is_refused_or_harmless(write_bundle, tmp_path):
    """Flips and cuts in each file as it lies; nothing but a refusal or, for the manifest's white space, the same."""
    rng = np.random.default_rng(0)
    path = write_bundle()
    originals = {item.name: item.read_bytes() for item in path.iterdir()}
    loaded = 0
    for name, original in originals.items():
        for _ in range(150):
            data = bytearray(original)
            if rng.random() < 0.3:
                data = data[: rng.integers(len(data))]
            else:
                for _ in range(rng.integers(1, 4)):
                    data[rng.integers(len(data))] ^= 1 << rng.integers(8)
            (path / name).write_bytes(data)
            try:
                bundle = load_bundle(path)
            except BundleError as error:
                assert "\n" not in str(error)
            else:
                loaded += 1
                assert content_sha256(bundle.manifest) == bundle.manifest["content_sha256"]
                assert name == "bundle.json" or bytes(data) == original
        (path / name).write_bytes(original)
    assert loaded < 150


@pytest.mark.filterwarnings("ignore:Reading `.npy`")
def test_random_damage_whose_digests_were_made_to_fit_is_refused_or_loads(write_bundle, parameters):
    rng = np.random.default_rng(1)
    original = npz(parameters(1))
    directory = original.rindex(b"PK\x01\x02", 0, len(original))
    for _ in range(300):
        data = bytearray(original)
        if rng.random() < 0.3:
            data = data[: rng.integers(len(data))]
        else:
            for _ in range(rng.integers(1, 6)):
                low = 0 if rng.random() < 0.5 else directory
                data[rng.integers(low, len(data))] ^= 1 << rng.integers(8)
        try:
            load_bundle(write_bundle(npz=bytes(data)))
        except BundleError as error:
            assert "\n" not in str(error)


def test_a_place_that_cannot_be_read_is_refused_in_one_line(write_bundle):
    path = write_bundle()
    # A process out of file descriptors cannot open files, whoever its user is; permissions would not stop root.
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    with Path(os.devnull).open() as lowest_free:
        resource.setrlimit(resource.RLIMIT_NOFILE, (lowest_free.fileno() + 1, limits[1]))
        try:
            message = refusal(path)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert "cannot be read" in message


def test_a_bundle_is_not_held_open(write_bundle):
    path = write_bundle()
    bundle = load_bundle(path)
    shutil.rmtree(path)
    bundle.warm_up()
    assert bundle.motion.instant == "full_stance_end"


def test_names_are_loaded_when_used_and_unknown_ones_listed():
    for name in legtool_runtime.__all__:
        assert getattr(legtool_runtime, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'load'; it has Bundle"):
        _ = legtool_runtime.load


def test_a_bundle_without_networks_is_loaded_without_onnxruntime(write_bundle, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    assert load_bundle(write_bundle(), providers=["CUDAExecutionProvider"]).lines == ("motion",)


def test_a_bundle_tells_its_models_the_range_of_their_data_and_one_of_before_does_not(write_bundle):
    limits = {name: [-0.1, 0.1] for name in FEATURES}
    known = load_bundle(write_bundle(motion={"range": limits, "range_of": "training data"})).motion
    assert known.covers([[0.1, 0, 0], [0.5, 0, 0]]).tolist() == [True, False]
    for before in ({"range": limits, "range_of": "a walking robot"}, {"range_of": "training data"}, {}):
        assert load_bundle(write_bundle(motion=before)).motion.limits is None
    assert "limits" in refusal(write_bundle(motion={"range": {}, "range_of": "training data"}))
