"""Shared by all tests: where the real data lies, and a bundle learned from a short real sweep."""

import importlib.util
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import mujoco
import pytest
from jsonschema import Draft202012Validator

from legtool.configs.robots import load_robot
from legtool.sim.robots.physics import empty_world
from legtool.sim.robots.robot import add_robot

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real logs beside the repository; absent in a plain clone."""
    if not SHARED.is_dir():
        pytest.skip("real robot logs are not beside this checkout (../shared/data)")
    return SHARED


@pytest.fixture(scope="session")
def load_script() -> Callable[[str], ModuleType]:
    """A Python file that is in no package, such as an example, as a module: called with its path in the repository."""

    def load(name: str) -> ModuleType:
        path = ROOT / name
        spec = importlib.util.spec_from_file_location(path.stem, path)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load


@pytest.fixture(scope="session")
def check_manifest() -> Callable[[Path], None]:
    """Raises where the manifest of a bundle is not as the published schema says."""
    schema = json.loads((ROOT / "docs" / "bundle.schema.json").read_text())
    return lambda bundle: Draft202012Validator(schema).validate(json.loads((bundle / "bundle.json").read_text()))


#: Code that is killed or waits just before a certain rename: files take their places by one.
_AT_RENAME = """
import os, signal, sys, time
left, go = int(sys.argv[1]), sys.argv[2]

def hook(event, _):
    global left
    if event == "os.rename":
        left -= 1
        if left == 0 and not go:
            os.kill(os.getpid(), signal.SIGKILL)
        elif left == 0:
            open(go + ".reached", "w").close()
            while not os.path.exists(go):
                time.sleep(0.01)

sys.addaudithook(hook)
code, sys.argv = sys.argv[3], ["legtool", *sys.argv[4:]]
exec(code)
"""
_COMMAND = "from legtool.cli import main; main()"


class Legtool:
    """Runs legtool commands, or other code, in processes of their own."""

    def __call__(
        self, *arguments: str, kill_at_rename: int = 0, code: str = _COMMAND
    ) -> subprocess.CompletedProcess[str]:
        """Run a command to its end, or until SIGKILL meets it just before its n-th rename."""
        command = [sys.executable, "-c", _AT_RENAME, str(kill_at_rename), "", code, *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)

    @contextmanager
    def paused_at_rename(self, go: Path, *arguments: str, number: int = 1) -> Iterator[subprocess.Popen[bytes]]:
        """A command that waits just before its n-th rename, and goes on when the block ends."""
        command = [sys.executable, "-c", _AT_RENAME, str(number), str(go), _COMMAND, *arguments]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            while not Path(f"{go}.reached").exists():
                assert process.poll() is None, "the command ended before it was to wait"
                time.sleep(0.02)
            yield process
            go.touch()
            process.wait(timeout=300)
        finally:
            process.kill()
            process.wait()


@pytest.fixture(scope="session")
def legtool() -> Legtool:
    """Runs legtool commands in processes of their own, some of which are killed or wait at a certain moment."""
    return Legtool()


@pytest.fixture(scope="session")
def walking_bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two simulated minutes, forward commands alone, the chosen model alone: the others take most of a fit's time."""
    from legtool.configs.export import ExportSettings
    from legtool.configs.motion import MotionTrainSettings
    from legtool.configs.sweep import SweepSettings
    from legtool.datasets.motion.run import FittedMotion, save_run
    from legtool.datasets.motion.samples import load_transitions, motion_data
    from legtool.models.motion import build
    from legtool.pipeline.sweep import collect_sweep
    from legtool.training.export import export_bundle

    root = tmp_path_factory.mktemp("walking")
    collect_sweep(SweepSettings(episodes=6, episode_s=20, seed=3), root / "data")
    loaded = load_transitions([root / "data"])
    steps = motion_data(loaded.table)
    frozen = {
        name: build("bayesian", "full", folds=3).fit(steps.features, target).frozen()
        for name, target in steps.targets.items()
    }
    fitted = FittedMotion(
        robot=loaded.robot,
        instant=loaded.instant,
        formulation="full",
        estimator="bayesian",
        settings=MotionTrainSettings(folds=3).to_dict(),
        data={"steps": len(steps), **loaded.info},
        scores={},
        models={"bayesian": {"full": frozen}},
    )
    save_run(fitted, root / "run")
    return export_bundle([root / "run"], root / "bundle", ExportSettings(states=1000))


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., Path]:
    """Writes the built-in Aliengo as a user's own MJCF file, changed before it is written."""

    def write(change: Callable[[mujoco.MjSpec], object] = lambda spec: None, name: str = "dog.xml") -> Path:
        spec = empty_world()
        add_robot(spec, load_robot("aliengo"))
        change(spec)
        spec.compile()
        (tmp_path / name).write_text(spec.to_xml(), encoding="utf-8")
        return tmp_path / name

    return write
