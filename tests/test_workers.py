"""Work goes on when an item fails, when a worker is killed and when one hangs; shards and clusters do the same work."""

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from distributed import LocalCluster

from legtool.errors import PartsFailed, SettingsError
from legtool.workers import Workers, run_all


def work(root: str, item: int) -> None:
    """Leaves a file; items of some numbers fail, at first or always."""
    tries = Path(root) / f"tried-{item}"
    tries.write_text(tries.read_text() + "x" if tries.exists() else "x")
    if item == 1 and len(tries.read_text()) == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    if item == 2:
        raise KeyError("always")
    if item == 3:
        time.sleep(60)
    if item == 4 and len(tries.read_text()) < 3:
        raise ZeroDivisionError("twice")
    (Path(root) / f"done-{item}").touch()


class Work:
    """``work`` below a directory; picklable by name wherever this file is imported from."""

    def __init__(self, root: Path) -> None:
        self.root = str(root)

    def __call__(self, item: int) -> None:
        work(self.root, item)


def done(root: Path) -> set[int]:
    return {int(path.name.split("-")[1]) for path in root.glob("done-*")}


def test_what_fails_is_tried_again_and_then_left_behind(tmp_path: Path) -> None:
    with pytest.raises(PartsFailed) as told:
        run_all(Work(tmp_path), [0, 2, 4, 5], workers=1, description="work", unit="parts", done=3)
    assert str(told.value).startswith("6 of 7 parts are done; failed 3 times each: 2 (KeyError: 'always')")
    assert told.value.exit_code == 3
    assert done(tmp_path) == {0, 4, 5}


def test_a_shard_is_a_share_and_is_told_as_such() -> None:
    workers = Workers.parse(1, None, "1/3", None, None)
    assert [place for place in range(7) if workers.takes(place)] == [1, 4]
    assert Workers.parse(1, None, None, None, None).name is None
    for wrong in ("3/3", "1", "-1/2", "a/b", "1/0", "1/2/3", "²/3"):
        with pytest.raises(SettingsError, match="expected K/N"):
            Workers.parse(1, None, wrong, None, None)
    for wrong_limit in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(SettingsError, match="--limit"):
            Workers.parse(1, None, None, wrong_limit, None)


@pytest.fixture
def cluster(request: pytest.FixtureRequest) -> Iterator[str | None]:
    """What ``--cluster`` may be given: nothing, a cluster to start, or one that runs."""
    if request.param != "tcp":
        yield request.param
        return
    with LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None) as running:
        yield running.scheduler_address


@pytest.mark.parametrize("cluster", [None, "local:2", "tcp"], indirect=True)
def test_killed_and_hanging_workers_cost_their_item_alone(
    cluster: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    workers = Workers(2, cluster, limit_s=3.0, out=tmp_path)
    with pytest.raises(PartsFailed) as told:
        run_all(Work(tmp_path), range(8), workers=workers, description="work", unit="parts")
    message = str(told.value)
    assert message.startswith("6 of 8 parts are done")
    assert "2 (KeyError: 'always')" in message and "3 (took longer than 3 s)" in message
    assert done(tmp_path) == {0, 1, 4, 5, 6, 7}
    assert (tmp_path / "tried-1").read_text() == "xx"


def test_a_cluster_that_is_not_there_is_told(tmp_path: Path) -> None:
    for address in ("tcp://127.0.0.1:1", "local:0", "local:x", "nowhere"):
        with pytest.raises(SettingsError, match="--cluster"):
            run_all(Work(tmp_path), [0], workers=Workers(1, address), description="work", unit="parts")
