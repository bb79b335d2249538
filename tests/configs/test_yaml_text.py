"""YAML is read within bounds, whatever it holds, and refused in one short line."""

import time

import pytest

from legtool.configs.planner import PlannerEvalSettings
from legtool.configs.settings import load
from legtool.configs.yaml_text import parse_yaml
from legtool.errors import SettingsError

BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
FORGED = {
    "a number of 5,000 digits": "a: " + "9" * 5000,
    "a number of 5,000 hexadecimal digits": "a: 0x" + "f" * 5000,
    "no date": "a: !!timestamp x",
    "a nesting": "[" * 600 + "]" * 600,
    "a bomb of anchors": BOMB,
    "a list in itself": "a: &a [*a]",
    "a Python object": "a: !!python/object/apply:os.system [true]",
    "no number": "a: !!int x",
    "no binary": "a: !!binary x",
    "a list as a key": "? [1]\n: 2",
    "no end": "{" * 50,
    "control characters": "a: \x00",
}


@pytest.mark.parametrize("text", FORGED.values(), ids=FORGED)
def test_forged_yaml_is_refused_at_once_in_one_line(text: str) -> None:
    begin = time.monotonic()
    with pytest.raises(ValueError, match="not valid YAML") as told:
        parse_yaml(text)
    assert len(str(told.value)) < 160 and "\n" not in str(told.value)
    assert time.monotonic() - begin < 5


def test_plain_values_and_anchors_are_read() -> None:
    text = "a: &a {x: 1, y: [0x10, -2, 1e3, 1.5, yes, null]}\nb: *a\nday: 2024-01-02\n"
    value = {"x": 1, "y": [16, -2, "1e3", 1.5, True, None]}
    assert parse_yaml(text) == {"a": value, "b": value, "day": "2024-01-02"}


def test_a_long_setting_is_not_told_in_full() -> None:
    for override in ("trials=" + "x" * 10_000, "y" * 10_000 + "=1", "z" * 10_000, "planner={a: " + "b" * 9999 + "}"):
        with pytest.raises(SettingsError) as told:
            load(PlannerEvalSettings, None, [override])
        assert len(str(told.value)) < 2000 and "xxxxxxxxxx" * 20 not in str(told.value)
