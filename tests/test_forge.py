"""A short campaign of forged input; benchmarks/faults/forge.py runs long ones."""

import importlib.util
import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def test_forged_input_of_every_kind_is_refused_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = importlib.util.spec_from_file_location("forge", ROOT / "benchmarks" / "faults" / "forge.py")
    assert spec is not None and spec.loader is not None
    forge = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "forge", forge)
    spec.loader.exec_module(forge)
    monkeypatch.chdir(tmp_path)
    state = tmp_path / "state.json"
    forge.campaign(["settings"], 5, 1, state)
    found = forge.campaign(list(forge.KINDS), 40, 1, state)
    assert not any(found.values()), found
    assert json.loads(state.read_text())["done"] == dict.fromkeys(forge.KINDS, 40)
