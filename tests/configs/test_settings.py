import json
from pathlib import Path
from typing import Any, ClassVar

import pytest
import yaml
from pydantic import Field

from legtool.configs.planner import PlannerEvalSettings
from legtool.configs.settings import Settings, build, load
from legtool.configs.sweep import SweepSettings
from legtool.errors import SettingsError
from legtool_runtime.motion.planning.plan import PlannerSettings


class Inner(Settings):
    gain: float = Field(2.0, gt=0, description="a gain [1/s]")


class Outer(Settings):
    seed: int = Field(0, ge=0)
    name: str = "walk"
    inner: Inner = Inner()
    grid: tuple[float, ...] = (0.0, 0.5)


def test_later_sources_win(tmp_path: Path) -> None:
    config = tmp_path / "c.yaml"
    config.write_text("seed: 1\nname: trot\ninner: {gain: 3}\n")
    settings = load(Outer, config, ["inner.gain=4", "seed=2"], seed=5, name=None)
    assert (settings.seed, settings.name, settings.inner.gain) == (5, "trot", 4.0)


@pytest.mark.parametrize(
    ("file", "held"),
    [
        ("manifest.json", lambda settings: {"kind": "motion", "settings": settings}),
        ("run.json", lambda settings: {"settings": settings}),
        ("results.json", lambda settings: {"metrics": {}, "provenance": {"settings": settings}}),
    ],
)
def test_what_a_command_wrote_serves_as_its_settings(tmp_path: Path, file: str, held: Any) -> None:
    first = Outer(seed=3, grid=(1.0, 2.5), inner=Inner(gain=7.0))
    (tmp_path / file).write_text(json.dumps(held(first.to_dict())))
    assert load(Outer, tmp_path) == first
    assert load(Outer, tmp_path, ["seed=4"]).seed == 4
    (tmp_path / file).write_text(json.dumps(held({**first.to_dict(), "name": {"base": "odom"}})))
    with pytest.raises(SettingsError, match=r"holds the content of name, and not its name; give --name again"):
        load(Outer, tmp_path)
    assert load(Outer, tmp_path, name="trot") == first.replace(name="trot")


def test_a_directory_without_settings_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"holds none of manifest.json, run.json, results.json"):
        load(Outer, tmp_path)
    (tmp_path / "run.json").write_text("{}")
    with pytest.raises(SettingsError, match="expected a mapping of settings, got NoneType"):
        load(Outer, tmp_path)
    (tmp_path / "run.json").write_text('{"settings": {"width": 3}}')
    with pytest.raises(SettingsError, match="unknown setting 'width'"):
        load(Outer, tmp_path)


def test_the_shown_yaml_reads_back_to_the_same_settings() -> None:
    settings = Outer(seed=3, grid=(1.0, 2.5))
    assert build(Outer, yaml.safe_load(settings.to_yaml())) == settings
    assert "# a gain [1/s]" in settings.to_yaml()


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("sed=1", r"unknown setting 'sed'; expected one of: grid, inner, name, seed"),
        ("inner.gian=1", r"unknown setting 'inner.gian'; expected one of: gain"),
        ("inner.gain=-1", r"'inner.gain' is -1; should be greater than 0"),
        ("seed=fast", r"'seed' is 'fast'; should be a valid integer"),
        ("seed", r"--set seed: expected key=value"),
        ("seed.x=1", r"unknown|valid integer"),
        ("name=[", r"not valid YAML"),
        ("inner.gain=.nan", r"'inner.gain'"),
    ],
)
def test_a_wrong_override_is_refused_by_name(override: str, expected: str) -> None:
    with pytest.raises(SettingsError, match=expected):
        load(Outer, None, [override])


def test_unreadable_config_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="no such file"):
        load(Outer, tmp_path / "none.yaml")
    broken = tmp_path / "b.yaml"
    broken.write_text("a: [1,\nb: 2")
    with pytest.raises(SettingsError, match=r"not valid YAML at line"):
        load(Outer, broken)
    broken.write_text("- 1\n")
    with pytest.raises(SettingsError, match="expected a mapping"):
        load(Outer, broken)


class Suite(Settings):
    """Settings that nest a settings dataclass of the runtime, one of whose members is given elsewhere."""

    horizons: tuple[int, ...] = (3, 5)
    planner: PlannerSettings = PlannerSettings(d_max_m=0.1)
    renamed: ClassVar[dict[str, str]] = {"margin_m": "planner.margin_m", "planner.horizon": "horizons"}


def test_a_dataclass_of_the_runtime_nests_as_it_is(tmp_path: Path) -> None:
    config = tmp_path / "c.yaml"
    config.write_text("planner: {margin_m: 0.01, deadline_s: 0.02}\n")
    settings = load(Suite, config, ["planner.margin_m=0.02"])
    assert settings.planner == PlannerSettings(margin_m=0.02, deadline_s=0.02, d_max_m=0.1)


def test_a_nested_dataclass_is_shown_with_its_docstring_and_reads_back() -> None:
    settings = load(Suite, None, ["planner.margin_m=0.02"])
    shown = settings.to_yaml()
    assert "  # the goal is reached within this distance.\n  goal_tolerance_m: 0.1\n" in shown
    assert "horizon:" not in shown
    assert all(line.startswith(("#", " ", "planner:", "horizons:")) and len(line) <= 120 for line in shown.splitlines())
    assert build(Suite, yaml.safe_load(shown)) == settings
    assert settings.replace(horizons=(7,)).planner == settings.planner


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("planner.gian=1", r"unknown setting 'planner.gian'; expected one of: cell_m, d_max_m, (?!.*horizon)"),
        ("planner.margin_m=wide", r"'planner.margin_m' is 'wide'; should be a valid number"),
        ("planner.margin_m=9", r"planner settings: margin_m is 9.0, expected 0 to 0.5"),
        ("planner=3", r"'planner' is 3; should be a dictionary"),
        ("margin_m=0.02", r"setting 'margin_m' is now 'planner.margin_m'"),
        ("planner.horizon=3", r"setting 'planner.horizon' is now 'horizons'"),
    ],
)
def test_a_wrong_value_in_a_nested_dataclass_is_refused_by_name(override: str, expected: str) -> None:
    with pytest.raises(SettingsError, match=expected) as caught:
        load(Suite, None, [override])
    assert "\n" not in str(caught.value)


def test_a_file_names_no_code_unless_it_is_allowed(tmp_path: Path) -> None:
    file = tmp_path / "sweep.yaml"
    file.write_text("black_box: strange:Class\n")
    with pytest.raises(SettingsError, match=r"black_box names Python code, 'strange:Class'.*--allow-code"):
        load(SweepSettings, file)
    assert load(SweepSettings, file, allow_code=True).black_box == "strange:Class"
    assert load(SweepSettings, None, ["black_box=my:Class"]).black_box == "my:Class"  # the user's own word
    file.write_text("planners: [blind, 'strange:Class [deadline_s=1]']\n")
    with pytest.raises(SettingsError, match="planners names Python code"):
        load(PlannerEvalSettings, file)
    for hidden in ("blind,strange:Class", "quadpips[black_box=strange:Class]"):
        file.write_text(f"planners: '{hidden}'\n")
        with pytest.raises(SettingsError, match="planners names Python code"):
            load(PlannerEvalSettings, file)
    file.write_text("black_box: policy.yaml\nplanners: ['quadpips[regions=truth]']\n")
    assert load(PlannerEvalSettings, file).black_box == "policy.yaml"
