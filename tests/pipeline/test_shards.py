"""Shards, a cluster and one process write the same bytes."""

import subprocess
import sys
from pathlib import Path

import pytest

from legtool.configs.sweep import SweepSettings
from legtool.datasets.store import Store, load_dataset, verify
from legtool.errors import OutputError
from legtool.pipeline.sweep import collect_sweep
from legtool.workers import LeftToOthers, Workers

SETTINGS = SweepSettings(episodes=3, episode_s=12, seed=5)


def content(path: Path) -> dict[str, bytes]:
    return {str(file.relative_to(path)): file.read_bytes() for file in sorted(path.rglob("*")) if file.is_file()}


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("alone") / "data"
    collect_sweep(SETTINGS, out)
    return out


def test_shards_write_the_same_bytes_and_the_last_one_sums_up(alone: Path, tmp_path: Path) -> None:
    out = tmp_path / "data"
    with pytest.raises(LeftToOthers, match="shard 1-of-2: its 1 episodes are done; 2 of 3 are left to others"):
        collect_sweep(SETTINGS, out, workers=Workers(shard=(1, 2)))
    collect_sweep(SETTINGS, out, workers=Workers(shard=(0, 2)))
    assert content(out) == content(alone)


def test_a_cluster_writes_the_same_bytes(alone: Path, tmp_path: Path) -> None:
    out = tmp_path / "data"
    collect_sweep(SETTINGS, out, workers=Workers(cluster="local:2", out=out))
    assert content(out) == content(alone)
    verify(out, load_dataset(out).manifest["files"])


def test_shards_hold_a_directory_together_each_but_once_and_others_wait(tmp_path: Path) -> None:
    header = {"kind": "motion", "robot": {"name": "go2"}, "settings": {}, "seed": 0, "inputs": []}
    path = tmp_path / "d"
    with Store(path, header, shard="0-of-2"):
        with Store(path, header, shard="1-of-2"):
            pass
        with pytest.raises(OutputError, match="another legtool process"):
            Store(path, header, shard="0-of-2")
        with pytest.raises(OutputError, match="another legtool process"):
            Store(path, header)
        with pytest.raises(OutputError, match="other settings"):
            Store(path, {**header, "seed": 1}, shard="1-of-2")
    assert [item.name for item in path.iterdir()] == ["manifest.json"]
    Store(path, header).close()


def test_a_shard_of_the_command_line_ends_well_and_says_what_is_left(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "legtool", "collect", "sweep", "--out", str(tmp_path / "d"), "--seed", "5"]
    command += ["--set", "episodes=2", "--set", "episode_s=12", "--shard", "0/2", "--workers", "1"]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout == "shard 0-of-2: its 1 episodes are done; 1 of 2 are left to others\n"
