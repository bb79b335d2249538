"""A folder holds one log, or several."""

import shutil
from pathlib import Path

import pytest

from legtool.configs.sweep import SweepSettings
from legtool.configs.topics import load_topics
from legtool.errors import LogError
from legtool.pipeline.folders import inner_logs, logs_in
from legtool.pipeline.sweep import RECORDINGS, collect_sweep


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two walks, recorded from the same moment on."""
    out = tmp_path_factory.mktemp("folders") / "data"
    collect_sweep(SweepSettings(episodes=2, episode_s=12, seed=5), out)
    return out / RECORDINGS


def test_walks_of_the_same_time_are_logs_of_their_own(recordings: Path) -> None:
    assert logs_in(recordings, load_topics("legtool")) == sorted(recordings.glob("*.mcap"))


def test_folders_of_logs_are_looked_into_and_others_left_out(recordings: Path, tmp_path: Path) -> None:
    first, second = sorted(recordings.glob("*.mcap"))
    for name, file in (("day_10/b", second), ("day_2", first)):
        (tmp_path / name).mkdir(parents=True)
        shutil.copy(file, tmp_path / name)
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "weather.txt").write_text("rain")
    assert logs_in(tmp_path, load_topics("legtool")) == [tmp_path / "day_2", tmp_path / "day_10" / "b"]
    assert inner_logs(tmp_path) == logs_in(tmp_path, load_topics("legtool"))
    assert inner_logs(first.parent) == []


def test_tables_that_hold_all_are_logs_of_their_own(tmp_path: Path) -> None:
    for name in ("monday.csv", "tuesday.csv"):
        (tmp_path / name).write_text("1,2\n")
    assert [log.name for log in logs_in(tmp_path, load_topics("aliengo_csv"))] == ["monday.csv", "tuesday.csv"]
    assert logs_in(tmp_path, load_topics("go2_csv")) == [tmp_path]


def test_a_folder_without_logs_and_a_missing_one_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="holds neither"):
        logs_in(tmp_path, load_topics("legtool"))
    with pytest.raises(LogError, match="no such log"):
        logs_in(tmp_path / "none", load_topics("legtool"))
