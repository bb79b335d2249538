"""What the documents show runs."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize("name", ["predict_step", "plan_walk"])
def test_an_example_runs(name: str, walking_bundle: Path) -> None:
    command = [sys.executable, str(ROOT / "examples" / f"{name}.py"), str(walking_bundle)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) >= 4


def test_the_plan_of_the_example_steps_over_its_gap(walking_bundle: Path) -> None:
    command = [sys.executable, str(ROOT / "examples" / "plan_walk.py"), str(walking_bundle)]
    shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    steps = [float(x) for x in re.findall(r"x (-?\d+\.\d+), (?:-?\d+\.\d+) m", shown)]
    assert steps
    assert not any(0.80 <= x <= 0.92 for x in steps)


def test_the_readme_s_runtime_code_runs(walking_bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert code is not None
    (tmp_path / "bundle").symlink_to(walking_bundle)
    (tmp_path / "snippet.py").write_text(code.group(1))
    monkeypatch.chdir(tmp_path)
    result = runpy.run_path("snippet.py")
    assert result["step"].foot_displacement.shape == (11, 4, 3)


def test_every_command_of_the_readme_exists() -> None:
    commands = set(
        re.findall(r"^legtool ([a-z]+(?: (?:sweep|log|motion|planner))?)", (ROOT / "README.md").read_text(), re.M)
    )
    assert {"collect log", "train motion", "eval motion", "export"} <= commands
    for command in commands:
        done = subprocess.run(
            [sys.executable, "-m", "legtool", *command.split(), "--help"], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
