"""Killed at any moment and carried on by the same command: the same bytes. Real processes, signals and a full disk."""

import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

KILLS = 20
COMMAND = [sys.executable, "-m", "legtool", "collect", "sweep", "--robot", "aliengo", "--seed", "4"]
SMALL = ["--set", "episodes=8", "--set", "episode_s=6"]


def sweep(out: Path, *options: str) -> list[str]:
    return [*COMMAND, *SMALL, "--out", str(out), *options]


def contents(path: Path) -> dict[str, bytes]:
    """All bytes, but for the commit of the code, which a developer may change while this runs."""
    found = {str(p.relative_to(path)): p.read_bytes() for p in sorted(path.rglob("*")) if p.is_file()}
    found["manifest.json"] = re.sub(rb'"commit": "[^"]*"', b'"commit": ""', found["manifest.json"])
    return found


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("unbroken") / "data"
    subprocess.run(sweep(out, "--workers", "1"), check=True, capture_output=True)
    return out


def test_two_workers_write_the_same_bytes_as_one(unbroken: Path, tmp_path: Path) -> None:
    subprocess.run(sweep(tmp_path / "data", "--workers", "2"), check=True, capture_output=True)
    assert contents(tmp_path / "data") == contents(unbroken)


def test_a_finished_sweep_is_left_as_it_is(unbroken: Path) -> None:
    before = contents(unbroken)
    subprocess.run(sweep(unbroken), check=True, capture_output=True)
    assert contents(unbroken) == before


def test_killed_twenty_times_it_ends_with_the_same_bytes(unbroken: Path, tmp_path: Path) -> None:
    rng = random.Random(0)
    out = tmp_path / "data"
    killed = 0
    for attempt in range(KILLS):
        process = subprocess.Popen(sweep(out, "--workers", str(1 + attempt % 2)), stderr=subprocess.DEVNULL)
        time.sleep(rng.uniform(0.1, 2.5))
        killed += process.poll() is None
        process.kill()
        process.wait()
    assert killed >= 3, "the sweep was never caught at work: make it longer"
    done = subprocess.run(sweep(out), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert contents(out) == contents(unbroken)


def test_ctrl_c_ends_in_one_line_and_nothing_finished_is_lost(unbroken: Path, tmp_path: Path) -> None:
    out = tmp_path / "data"
    # A shell that runs these tests in the background has them ignore SIGINT, and what they start with them.
    process = subprocess.Popen(
        sweep(out, "--workers", "2"),
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    deadline = time.monotonic() + 60
    while not list(out.glob("part-*.parquet")) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130
    assert errors.strip().splitlines()[-1].startswith("interrupted: finished work is kept")
    assert "Traceback" not in errors
    subprocess.run(sweep(out), check=True, capture_output=True)
    assert contents(out) == contents(unbroken)


def test_a_full_disk_is_named_and_the_sweep_carries_on_when_there_is_room(unbroken: Path, tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    size = sum(len(data) for data in contents(unbroken).values()) // 2
    mount = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(disk)], capture_output=True, check=False
    )
    if mount.returncode != 0:
        pytest.skip("mounting a small tmpfs needs root")
    try:
        done = subprocess.run(sweep(disk / "data", "--workers", "1"), capture_output=True, text=True, check=False)
        assert done.returncode == 2
        assert "no space left on the disk" in done.stderr
        assert "Traceback" not in done.stderr
        assert list((disk / "data").glob("part-*.parquet"))
        assert not list((disk / "data").rglob(".*.tmp"))
        subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True, capture_output=True)
        subprocess.run(sweep(disk / "data"), check=True, capture_output=True)
        assert contents(disk / "data") == contents(unbroken)
    finally:
        subprocess.run(["umount", str(disk)], check=True, capture_output=True)


def test_workers_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    process = subprocess.Popen(sweep(tmp_path / "data", "--workers", "2"), stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    children: list[int] = []
    while len(children) < 2 and time.monotonic() < deadline:
        children = _children(process.pid)
        time.sleep(0.05)
    process.kill()
    process.wait()
    while any(map(_alive, children)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert children
    assert not any(map(_alive, children))


def _children(pid: int) -> list[int]:
    path = Path(f"/proc/{pid}/task/{pid}/children")
    return [int(child) for child in path.read_text().split()] if path.exists() else []


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return "Z" not in Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
