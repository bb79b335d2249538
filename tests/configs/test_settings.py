from pathlib import Path

import pytest
import yaml
from pydantic import Field

from legtool.configs.settings import Settings, build, load
from legtool.errors import SettingsError


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
