"""Kernels are compiled once per user; each case runs in a process of its own, as on a robot."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import legtool_runtime

# Counts compilations (loads from the cache are none) before and after warm_up.
PROGRAM = """
import sys
import numpy as np
from numba.core import event
counter = event.RecordingListener()
event.register("numba:compile", counter)
from legtool_runtime import MotionState, load_bundle
bundle = load_bundle(sys.argv[1])
bundle.warm_up()
from legtool_runtime import robot
from legtool_runtime.motion import kernels
dispatchers = [kernels.predict, kernels.predict_scale, robot._feet_forward, robot._feet_inverse]
def state():
    return [len(d.signatures) for d in dispatchers], sum(sum(d.stats.cache_misses.values()) for d in dispatchers)
warm, events = state(), len(counter.buffer)
for pair in (0, 1):
    now = MotionState(np.zeros(3), np.zeros(3), np.zeros(3), bundle.robot.stance, pair)
    for commands in (np.zeros((11, 3)), [[0.1, 0, 0]], np.zeros((3, 11), np.float32).T):
        bundle.motion.predict(now, commands)
        bundle.motion.covariance(now, commands)
bundle.robot.joints(bundle.robot.feet(np.zeros((4, 3))))
assert (state(), len(counter.buffer)) == (warm, events), "something was compiled after warm_up"
print("compiled", warm[1])
"""


@pytest.fixture
def install(tmp_path):
    """A copy of the package as an installation, without anything compiled."""
    source = Path(legtool_runtime.__file__).parent
    target = tmp_path / "site" / "legtool_runtime"
    shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "site"


def run(install: Path, bundle: Path, **environment: str) -> int:
    """Number of kernels that had to be compiled."""
    kept = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "HOME")}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(bundle)],
        env={**kept, "PYTHONPATH": str(install), "PYTHONDONTWRITEBYTECODE": "1", **environment},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return int(done.stdout.split()[-1])


def test_nothing_is_compiled_after_warm_up_nor_by_the_next_process(install, write_bundle, tmp_path):
    bundle = write_bundle()
    home = tmp_path / "home"
    assert run(install, bundle, HOME=str(home)) == 4
    assert (home / ".cache" / "legtool-runtime").is_dir()
    assert run(install, bundle, HOME=str(home)) == 0

    # A power cut may leave anything in the files: they are compiled anew.
    for item in (home / ".cache" / "legtool-runtime").rglob("*.nb[ic]"):
        item.write_bytes(item.read_bytes()[: item.stat().st_size // 2])
    assert run(install, bundle, HOME=str(home)) == 4
    assert run(install, bundle, HOME=str(home)) == 0

    # A changed source outdates the kernels that can reach it, in whatever file, and no others.
    features = install / "legtool_runtime" / "motion" / "features.py"
    before = features.read_text()
    features.write_text(before + "\n")
    assert run(install, bundle, HOME=str(home)) == 2

    # A version that shares the home with another one, at the same path in another container, finds its own again.
    features.write_text(before)
    assert run(install, bundle, HOME=str(home)) == 0

    # What was not used for a month is removed by the next version.
    folders = set((home / ".cache" / "legtool-runtime").glob("*/*"))
    for folder in folders:
        os.utime(folder, (0, 0))
    features.write_text(before + "\n\n")
    assert run(install, bundle, HOME=str(home)) == 2
    kept = [item.name.split("-")[0] for item in (home / ".cache" / "legtool-runtime").glob("*/*")]
    assert len(kept) == len(set(kept))


def test_a_numba_of_another_make_keeps_no_kernels_and_works(install, write_bundle, tmp_path):
    (install / "sitecustomize.py").write_text("import numba.core.caching as c\ndel c.CompileResultCacheImpl\n")
    assert run(install, write_bundle(), HOME=str(tmp_path / "home")) == 4
    assert not list(tmp_path.rglob("*.nbi"))


def test_where_nothing_can_be_written_it_still_works(install, write_bundle, tmp_path):
    # A file where the directory should be: not even root can write there.
    (tmp_path / "cache").write_text("in the way")
    assert run(install, write_bundle(), XDG_CACHE_HOME=str(tmp_path / "cache")) == 4
    assert not list(install.rglob("*.nbi"))


def test_numbas_own_setting_is_heeded(install, write_bundle, tmp_path):
    run(install, write_bundle(), HOME=str(tmp_path / "home"), NUMBA_CACHE_DIR=str(tmp_path / "numba"))
    assert list((tmp_path / "numba").rglob("*.nbi"))
    assert not (tmp_path / "home").exists()
