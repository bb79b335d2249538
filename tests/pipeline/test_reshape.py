"""Datasets out of datasets."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from legtool.cli import COMMANDS, GROUPS
from legtool.command import call
from legtool.configs.motion import MotionTrainSettings
from legtool.configs.sweep import SweepSettings
from legtool.datasets.store import Store, data_hash, load_dataset, part_path, write_part
from legtool.errors import DatasetError, OutputError
from legtool.pipeline.reshape import keep_where, merge, split, statistics
from legtool.pipeline.sweep import collect_sweep
from legtool.training.motion import train_motion


@pytest.fixture(scope="module")
def walks(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two small sweeps of one robot."""
    root = tmp_path_factory.mktemp("walks")
    for seed in (0, 1):
        collect_sweep(SweepSettings(robot="go2", episodes=4, episode_s=6.0, seed=seed), root / str(seed))
    return root / "0", root / "1"


def test_merged_walks_stay_apart_and_name_their_parents(walks: tuple[Path, Path], tmp_path: Path) -> None:
    manifest = merge(walks, tmp_path / "both")
    first, second, both = (load_dataset(path, "motion") for path in (*walks, tmp_path / "both"))
    assert len(both.table) == len(first.table) + len(second.table)
    assert manifest["inputs"] == [
        {"name": path.name, "sha256": data_hash(dataset.manifest)}
        for path, dataset in zip(walks, (first, second), strict=True)
    ]
    assert set(both.table["episode"].to_pylist()) == {"0", "1", "2", "3", "1:0", "1:1", "1:2", "1:3"}
    lines = list(train_motion([tmp_path / "both"], MotionTrainSettings(min_steps=30), tmp_path / "run"))
    assert f"to {manifest['counts']['steps']:g} steps" in lines[0]
    assert merge(walks, tmp_path / "both") == manifest  # the same again is the same
    for parent in (first, second):
        assert all(finding in manifest["verdict"]["findings"] for finding in parent.manifest["verdict"]["findings"])
    with pytest.raises(OutputError, match="inputs"):
        merge((walks[1], walks[0]), tmp_path / "both")
    with pytest.raises(DatasetError, match="holds the same rows as"):
        merge((walks[0], walks[0]), tmp_path / "twice")
    with pytest.raises(DatasetError, match="two datasets or more"):
        merge(walks[:1], tmp_path / "one")


def test_scenes_are_numbered_apart_and_robots_not_mixed(tmp_path: Path) -> None:
    def scenes(name: str, robot: str, count: int) -> Path:
        header = {"kind": "scenes", "robot": {"name": robot}, "settings": {}, "seed": len(name), "inputs": []}
        with Store(tmp_path / name, header) as store:
            table = pa.table({"scene": pa.array(np.arange(count), pa.int32()), "depth": [b"x"] * count})
            write_part(part_path(store.path, 0), table, counts={"scenes": count, "frames": count})
            store.finish(1)
        return tmp_path / name

    a, b, c = scenes("a", "go2", 3), scenes("bb", "go2", 2), scenes("ccc", "spot", 2)
    manifest = merge([a, b], tmp_path / "both")
    assert load_dataset(tmp_path / "both").table["scene"].to_pylist() == [0, 1, 2, 3, 4]
    assert manifest["counts"] == {"scenes": 5, "frames": 5}
    with pytest.raises(DatasetError, match=f"{c}: has another robot than {a}"):
        merge([a, c], tmp_path / "mixed")


def test_what_goes_together_is_not_torn_apart(walks: tuple[Path, Path], tmp_path: Path) -> None:
    manifests = split(walks[0], [3, 1], tmp_path / "parts", seed=5)
    sides = [load_dataset(tmp_path / "parts" / str(k)).table for k in range(2)]
    episodes = [set(side["episode"].to_pylist()) for side in sides]
    assert [len(found) for found in episodes] == [3, 1] and not episodes[0] & episodes[1]
    assert sum(manifest["rows"] for manifest in manifests) == len(load_dataset(walks[0]).table)
    again = split(walks[0], [3, 1], tmp_path / "again", seed=5)
    assert [data_hash(m) for m in again] == [data_hash(m) for m in manifests]
    with pytest.raises(DatasetError, match="4 episodes, which are not torn apart; expected at least 5"):
        split(walks[0], [1] * 5, tmp_path / "many")
    for shares in ([1.0], [1.0, 0.0], [1.0, np.nan]):
        with pytest.raises(DatasetError, match="expected two or more above 0"):
            split(walks[0], shares, tmp_path / "wrong")


def test_rows_are_kept_by_a_condition(walks: tuple[Path, Path], tmp_path: Path) -> None:
    keep_where(walks[0], "velocity_x > 0.1 and status == 'ok'", tmp_path / "fast")
    kept = load_dataset(tmp_path / "fast")
    every = load_dataset(walks[0]).table.to_pandas()
    wanted = every[(every.velocity_x > 0.1) & (every.status == "ok")]
    assert kept.table["stamp_ns"].to_pylist() == wanted.stamp_ns.tolist()
    assert kept.manifest["settings"]["where"] == "velocity_x > 0.1 and status == 'ok'"
    for condition, said in (
        ("speed > 1", "name 'speed' is not defined; expected a condition on columns: recording"),
        ("velocity_x", "is no condition"),
        ("velocity_x >", "expected a condition"),
        ("velocity_x > 99", "holds for none of the"),
        ("__import__('os').system('true')", "expected a condition"),
    ):
        with pytest.raises(DatasetError, match=said):
            keep_where(walks[0], condition, tmp_path / "none")
    keep_where(walks[0], "velocity_x > 0", tmp_path / "none")  # what was refused is not in the way


def test_columns_are_described(walks: tuple[Path, Path], tmp_path: Path) -> None:
    found, table = statistics(walks[0]), load_dataset(walks[0]).table
    values = table["velocity_x"].to_numpy()
    assert found["velocity_x"]["n"] + found["velocity_x"]["missing"] == len(table)
    assert found["velocity_x"]["median"] == pytest.approx(np.nanmedian(values))
    assert sum(found["episode"].values()) == len(table)


def test_on_the_command_line(walks: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second, out = str(walks[0]), str(walks[1]), str(tmp_path / "out")
    for words, said in (
        (["data", "merge", first, second, "--out", f"{out}/both"], "wrote"),
        (["data", "split", first, "--shares", "0.5,0.5", "--out", f"{out}/parts"], "rows of go2 in 4 parts"),
        (["data", "filter", first, "--where", "velocity_x > 0", "--out", f"{out}/fast"], "wrote"),
        (["data", "stats", first], "velocity_x"),
        (["info", f"{out}/both"], "made by merge of 2 datasets"),
    ):
        assert call(COMMANDS, GROUPS, words) == 0
        assert said in capsys.readouterr().out
    assert call(COMMANDS, GROUPS, ["data", "stats", first, "--json"]) == 0
    assert "velocity_x" in json.loads(capsys.readouterr().out)
    for words, said in (
        (["data", "split", first, "--shares", "half", "--out", out], "expected numbers such as 0.8,0.2"),
        (["data", "filter", first, "--out", out], "--where is missing: name the rows to keep"),
        (["data", "stats", str(tmp_path)], "not a dataset"),
    ):
        assert call(COMMANDS, GROUPS, words) == 2
        assert said in capsys.readouterr().err
