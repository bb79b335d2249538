"""The command line's contract: help at once, one clear line and exit code 2 for a user's mistake."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml


def legtool(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "legtool", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_help_names_every_command() -> None:
    shown = legtool("--help").stdout
    for name in ("collect", "train", "eval", "export", "info", "demo"):
        assert name in shown


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys, legtool.cli\n"
        "heavy = {'torch', 'mujoco', 'sklearn', 'pandas', 'numba', 'matplotlib', 'pyarrow', 'pydantic', 'scipy'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    "arguments",
    [("collect", "sweep"), ("collect", "log"), ("train", "motion"), ("eval", "motion", "run"), ("export", "run")],
)
def test_show_config_prints_yaml_and_writes_nothing(arguments: tuple[str, ...], tmp_path: Path) -> None:
    done = legtool(*arguments, "--show-config")
    assert done.returncode == 0, done.stderr
    assert isinstance(yaml.safe_load(done.stdout), dict)


def test_shown_settings_are_accepted_as_a_config_file(tmp_path: Path) -> None:
    config = tmp_path / "sweep.yaml"
    config.write_text(legtool("collect", "sweep", "--robot", "go2", "--show-config").stdout)
    again = legtool("collect", "sweep", "--config", config, "--show-config")
    assert again.stdout == config.read_text()
    assert yaml.safe_load(again.stdout)["robot"] == "go2"


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("collect", "sweep"), "--out is missing"),
        (("collect", "sweep", "--out", "x", "--set", "robbot=go2"), "unknown setting 'robbot'; expected one of:"),
        (("collect", "sweep", "--out", "x", "--set", "seed=-1"), "'seed' is -1; should be greater than or equal to 0"),
        (("collect", "sweep", "--out", "x", "--robot", "spot"), "robot 'spot': no such preset or YAML file; presets:"),
        (("collect", "log", "--out", "x"), "no log was given"),
        (("collect", "log", "none.mcap", "--out", "x"), "none.mcap"),
        (("collect", "log", "x.csv", "--out", "x", "--topics", "nope"), "presets:"),
        (("train", "motion", "none", "--out", "x"), "not a dataset"),
        (("eval", "motion", "none", "--out", "x"), "none"),
        (("export", "none", "--out", "x"), "none"),
        (("info", "none"), "no such file or directory"),
    ],
)
def test_a_mistake_ends_in_one_line_and_code_2(arguments: tuple[str, ...], expected: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "legtool", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 2, done.stderr
    assert expected in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert done.stderr.startswith("error: ")
    assert not list(tmp_path.iterdir())


def test_debug_shows_the_traceback(tmp_path: Path) -> None:
    done = legtool("collect", "sweep", "--out", tmp_path / "x", "--robot", "spot", "--debug")
    assert "Traceback" in done.stderr
    assert "RobotError" in done.stderr
