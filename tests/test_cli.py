"""The command line's contract: help at once, one clear line and exit code 2 for a user's mistake."""

import importlib
import json
import os
import shlex
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml

from legtool import progress
from legtool.cli import COMMANDS, GROUPS, JSON, OUT
from legtool.command import Arguments, Command, call, parse

ROOT = Path(__file__).resolve().parents[1]


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


def names(command: Command) -> list[str]:
    return [option.name for option in command.options]


def by_name(command: Command) -> str:
    return command.name


#: The words of every command with settings; one of them has two classes of settings.
CONFIGURED = [command.name for command in COMMANDS if "--show-config" in names(command)] + ["eval vpa --suite vital"]


@pytest.mark.parametrize("command", COMMANDS, ids=by_name)
def test_help_says_what_a_command_does_and_takes(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(COMMANDS, GROUPS, [*command.name.split(), "--help"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert command.help in shown
    for option in command.options:
        assert option.name.strip(".") in shown
        assert option.help in shown


@pytest.mark.parametrize("words", CONFIGURED)
def test_shown_settings_are_accepted_as_a_config_file(
    words: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def shown(*more: str) -> str:
        with pytest.raises(SystemExit) as ended:
            call(COMMANDS, GROUPS, [*words.split(), *more, "--show-config"])
        assert ended.value.code == 0
        return capsys.readouterr().out

    config = tmp_path / "settings.yaml"
    config.write_text(shown())
    assert isinstance(yaml.safe_load(config.read_text()), dict)
    assert shown("--config", str(config)) == config.read_text()


@pytest.mark.parametrize("words", CONFIGURED)
def test_an_option_that_gives_a_setting_gives_it(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    command = next(command for command in COMMANDS if words.startswith(command.name))
    given = [option for option in command.options if option.setting]
    given = [option for option in given if option.name != "--planners"]  # which takes names
    if words == "eval vpa":
        given = [option for option in given if option.name != "--robot"]  # of --suite vital alone
    with pytest.raises(SystemExit):
        more = [word for option in given for word in (option.name, "4")]
        call(COMMANDS, GROUPS, [*words.split(), *more, "--show-config"])
    settings = yaml.safe_load(capsys.readouterr().out)
    assert [settings[option.key] in (4, "4", [4]) for option in given] == [True] * len(given)


@pytest.mark.parametrize("command", COMMANDS, ids=by_name)
def test_what_a_command_says_in_the_end_names_options_it_has(command: Command) -> None:
    known = {option.key: "x" for option in command.options} | {"task": "x"}
    for text in (command.writes, command.then):
        assert "{" not in text.format_map(known)


@pytest.mark.parametrize("command", COMMANDS, ids=by_name)
def test_the_example_of_a_command_is_one_of_it(command: Command) -> None:
    given = parse(COMMANDS, GROUPS, shlex.split(command.example))
    assert given is not None and given.command is command
    for option in command.options:
        assert not option.needed or given.values[option.key], option.name


@pytest.mark.parametrize(
    ("typed", "offered"),
    [("legtool eval pl", ["planner"]), ("legtool collect sweep --robot al", ["aliengo"]), ("legtool da", ["data"])],
)
def test_a_shell_completes_commands_and_presets(typed: str, offered: list[str]) -> None:
    asked = {"_LEGTOOL_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(len(typed.split()) - 1)}
    code = "import sys; sys.argv = ['legtool']; from legtool.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env={**os.environ, **asked}
    )
    assert done.stdout.split() == offered, done.stderr


def test_settings_are_shown_without_what_the_command_runs_on() -> None:
    code = (
        "import sys; from legtool.cli import COMMANDS, GROUPS, call\n"
        "try: call(COMMANDS, GROUPS, ['collect', 'sweep', '--show-config'])\n"
        "except SystemExit: print(sorted({'torch', 'mujoco', 'numpy', 'pandas', 'scipy'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_options_may_stand_between_arguments() -> None:
    words = ["a.bag", "--robot=go2", "b.bag", "--out", "data", "--set", "x=1", "c.bag", "--set", "y=-2"]
    given = parse(COMMANDS, GROUPS, ["collect", "log", *words])
    assert given is not None
    assert [str(path) for path in given.log] == ["a.bag", "b.bag", "c.bag"]
    assert (given.robot, given.out, given.set) == ("go2", Path("data"), ["x=1", "y=-2"])


@pytest.mark.parametrize(
    ("words", "option"),
    [
        ("collect log", "--seed"),  # cutting steps draws nothing
        ("train motion", "--seed"),  # nor do fits
        ("train motion", "--workers"),
        ("eval motion", "--workers"),
        ("export", "--workers"),
        ("demo", "--config"),
        ("demo", "--set"),
        ("demo", "--show-config"),
        ("info scenario_1", "--out"),
        ("info scenario_1", "--workers"),
        ("info scenario_1", "--show-config"),
        ("collect sweep", "--sed"),  # no abbreviations: a new option must not change what an old command means
    ],
)
def test_an_option_that_a_command_does_not_use_is_refused(
    words: str, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(COMMANDS, GROUPS, [*words.split(), option, "1", "--out", "x"]) == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert f"does not take '{option}'; it takes " in said


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("collect", "sweep"), "--out is missing"),
        (("colect", "sweep"), "no such command 'colect'; expected one of: collect, "),
        (("collect", "swep"), "no such command 'swep'; expected one of: footholds, log"),
        (("collect", "sweep", "--out"), "--out"),
        (("collect", "sweep", "--out", "x", "--workers", "0"), "--workers"),
        (("demo", "--out", "x", "--seed", "-1"), "--seed"),
        (("collect", "log", "a.csv", "--out", "x", "--set", "seed=1"), "unknown setting 'seed'"),
        (("eval", "planner", "--out", "x"), "--bundle is missing: the planner velocity"),
        (("eval", "planner", "--bundle", "b", "--out", "x", "--trials", "0"), "'trials' is 0; should be greater"),
        (("eval", "vfa", "--out", "x"), "RUN is missing: name a run of train vfa"),
        (("eval", "vpa", "run", "--robot", "hyq", "--out", "x"), "--robot is for --suite vital"),
        (("eval", "vpa", "run", "--suite", "vital", "--out", "x"), "leave out RUN and --data"),
        (("eval", "vpa", "--suite", "stairs", "--out", "x"), "'stairs' is not one of 'vital'"),
        (("info",), "PATH is missing"),
        (("collect", "sweep", "--out", "x", "--set", "robbot=go2"), "unknown setting 'robbot'; expected one of:"),
        (("collect", "sweep", "--out", "x", "--set", "seed=-1"), "'seed' is -1; should be greater than or equal to 0"),
        (("collect", "sweep", "--out", "x", "--robot", "cheetah"), "robot 'cheetah': no such preset or YAML file"),
        (("collect", "log", "--out", "x"), "no log was given"),
        (("collect", "log", "none.mcap", "--out", "x"), "none.mcap"),
        (("collect", "log", "x.csv", "--out", "x", "--topics", "nope"), "presets:"),
        (("train", "motion", "none", "--out", "x"), "not a dataset"),
        (("eval", "motion", "none", "--out", "x"), "none"),
        (("export", "none", "--out", "x"), "none"),
        (("info", "none"), "no such file or directory"),
    ],
)
def test_a_mistake_ends_in_one_line_and_code_2(
    arguments: tuple[str, ...],
    expected: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert call(COMMANDS, GROUPS, arguments) == 2
    said = capsys.readouterr().err
    assert expected in said
    assert len(said.strip().splitlines()) == 1
    assert said.startswith("error: ")
    assert not list(tmp_path.iterdir())


def test_the_program_passes_the_exit_code_on() -> None:
    done = legtool("collect", "sweep")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "error: --out is missing: name the directory to write\n"


def test_debug_shows_the_traceback(tmp_path: Path) -> None:
    done = legtool("collect", "sweep", "--out", tmp_path / "x", "--robot", "cheetah", "--debug")
    assert "Traceback" in done.stderr
    assert "RobotError" in done.stderr


@pytest.mark.parametrize("words", [[], ["collect"]])
def test_no_command_shows_the_commands_to_choose_from(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert call(COMMANDS, GROUPS, words) == 2
    assert "sweep" in capsys.readouterr().err or not words
    assert call(COMMANDS, GROUPS, [*words, "--help"]) == 0
    assert "collect" in capsys.readouterr().out


def test_the_version_is_that_of_the_installed_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert call(COMMANDS, GROUPS, ["--version"]) == 0
    assert capsys.readouterr().out == f"legtool {version('legtool')}\n"


@pytest.mark.parametrize("words", [[], ["collect"], ["collect", "sweep"], ["info"]])
def test_h_is_help(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert call(COMMANDS, GROUPS, [*words, "--help"]) == 0
    shown = capsys.readouterr().out
    assert call(COMMANDS, GROUPS, [*words, "-h"]) == 0
    assert capsys.readouterr().out == shown


def test_help_shows_presets_and_defaults(capsys: pytest.CaptureFixture[str]) -> None:
    call(COMMANDS, GROUPS, ["collect", "scenes", "--help"])
    shown = " ".join(capsys.readouterr().out.split())
    for preset in ("aliengo", "anymal_c", "go2", "hyq"):
        assert preset in shown
    assert "[default: go2]" in shown and "[default: 600]" in shown
    call(COMMANDS, GROUPS, ["eval", "planner", "-h"])
    assert "[default: 3,5,7]" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("command", COMMANDS, ids=by_name)
def test_the_settings_of_the_table_are_those_that_the_command_shows(
    command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    if not command.settings:
        assert "--show-config" not in names(command)
        return
    module, _, name = command.settings.partition(":")
    with pytest.raises(SystemExit):
        call(COMMANDS, GROUPS, [*command.name.split(), "--show-config"])
    assert capsys.readouterr().out == getattr(importlib.import_module(module), name)().to_yaml()


def test_quiet_prints_nothing_and_json_prints_results(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def measure(given: Arguments) -> list[str]:
        """Measure."""
        (given.out / "results.json").write_text('{"metrics": {}}\n')
        return ["a figure"]

    monkeypatch.setattr(progress, "_silent", False)
    table = (Command("measure", measure, (OUT, JSON), "{out}", "look"),)
    words = ["measure", "--out", str(tmp_path)]
    groups = {"": "Measures."}
    # Typer makes no command of a single one.
    table = (*table, Command("other", measure, (OUT,)))
    assert call(table, groups, words) == 0
    assert capsys.readouterr().out == f"a figure\nwrote {tmp_path}\nnext: look\n"
    assert call(table, groups, [*words, "--json"]) == 0
    assert capsys.readouterr().out == '{"metrics": {}}\n'
    assert call(table, groups, [*words, "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    with progress.progress("work", 1, "parts") as advance:
        advance(1)
    assert capsys.readouterr().err == ""


def test_info_describes_all_that_a_directory_holds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, level in (("walk", "green"), ("stones/walk", "amber")):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "results.json").write_text(json.dumps({"metrics": {}, "verdict": {"level": level}}))
    assert call(COMMANDS, GROUPS, ["info", str(tmp_path)]) == 0
    walk, stones = capsys.readouterr().out.splitlines()
    assert walk.endswith("results, 0 metrics, verdict green") and "stones/walk" in stones and stones.endswith("amber")


def test_info_prints_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    metrics = {"a.full.x": {"value": 1.0, "ci95": None, "n": 3, "unit": "m"}}
    (tmp_path / "results.json").write_text(json.dumps({"metrics": metrics}))
    assert call(COMMANDS, GROUPS, ["info", str(tmp_path), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["kind"] == "results" and said["content"]["metrics"] == metrics
    assert said["text"][0].endswith("results, 1 metrics")
