"""A simulated sweep and a log of it take the same path to the same transitions."""

from pathlib import Path

import pytest

from legtool.configs.log import LogSettings
from legtool.configs.sweep import SweepSettings
from legtool.datasets.store import load_dataset
from legtool.errors import DatasetError, LogError, OutputError
from legtool.pipeline.log import collect_log
from legtool.pipeline.sweep import RECORDINGS, collect_sweep


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sweep") / "data"
    collect_sweep(SweepSettings(episodes=2, episode_s=12, seed=5), out)
    return out


def test_a_recording_reads_back_to_the_sweep_s_own_transitions(sweep: Path, tmp_path: Path) -> None:
    recordings = sorted((sweep / RECORDINGS).glob("*.mcap"))
    collect_log(recordings, LogSettings(topics="legtool"), tmp_path / "log")
    own, read = load_dataset(sweep).table, load_dataset(tmp_path / "log").table
    names = [name for name in own.column_names if name != "recording"]
    assert own.num_rows > 40
    assert read.select(names).equals(own.select(names))


def test_a_log_is_carried_on_and_another_one_refused(sweep: Path, tmp_path: Path) -> None:
    recordings = sorted((sweep / RECORDINGS).glob("*.mcap"))
    out = tmp_path / "log"
    first = collect_log(recordings, LogSettings(topics="legtool"), out)
    (out / "part-00001.parquet").unlink()
    assert collect_log(recordings, LogSettings(topics="legtool"), out) == first
    with pytest.raises(OutputError, match="inputs"):
        collect_log(recordings[:1], LogSettings(topics="legtool"), out)


def test_real_touchdowns_become_steps_in_which_stance_feet_stand(shared_data: Path, tmp_path: Path) -> None:
    log = shared_data / "aliengo" / "real_continuous.csv"
    manifest = collect_log([log], LogSettings(topics="aliengo_csv"), tmp_path / "log")
    assert manifest["instant"] == "touchdown"
    assert manifest["counts"]["steps"] == 952
    assert manifest["inputs"][0]["name"] == "real_continuous.csv"


def test_no_log_a_missing_log_and_a_log_without_steps_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no log was given"):
        collect_log([], LogSettings(), tmp_path / "a")
    with pytest.raises(LogError, match=r"none\.mcap: no such log"):
        collect_log([tmp_path / "none.mcap"], LogSettings(), tmp_path / "a")
    assert not (tmp_path / "a").exists()


def test_a_robot_that_only_stands_gives_no_dataset(tmp_path: Path) -> None:
    settings = SweepSettings(episodes=1, episode_s=6, vx=(0.0,), vy=(0.0,), yaw_rate=(0.0,), push_rate_hz=0)
    with pytest.raises(DatasetError, match="regular steps were found"):
        collect_sweep(settings, tmp_path / "still")
