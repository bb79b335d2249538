"""Two results beside each other."""

import json
from pathlib import Path

import pytest

from legtool.cli import COMMANDS, GROUPS
from legtool.command import call
from legtool.errors import DatasetError
from legtool.evaluation.compare import compare_results, describe
from legtool.evaluation.report.intervals import difference, share
from legtool.evaluation.report.results import Metric, metric, provenance, write_results


def results(path: Path, metrics: dict[str, Metric], *, seed: int = 0) -> Path:
    write_results(path / "results.json", metrics, provenance({}, seed=seed, data_hash="0" * 64))
    return path


@pytest.fixture
def two(tmp_path: Path) -> tuple[Path, Path]:
    first = {
        "gap.h3.success": share(10, 20), "fdm.bayesian.x.rmse": metric(0.02, (0.018, 0.022), 200, "m"),
        "gap.h3.duration_s": metric(10.0, (9.0, 11.0), 20, "s"), "steps": metric(200, None, 200, "1"),
        "gap.h3.clean": share(9, 20), "only.here": share(1, 2),
    }  # fmt: skip
    second = {
        "gap.h3.success": share(20, 20), "fdm.bayesian.x.rmse": metric(0.03, (0.027, 0.033), 200, "m"),
        "gap.h3.duration_s": metric(20.0, (19.0, 21.0), 20, "s"), "steps": metric(210, None, 210, "1"),
        "gap.h3.clean": share(10, 20),
    }  # fmt: skip
    return results(tmp_path / "a", first), results(tmp_path / "b", second, seed=1)


def test_the_interval_of_two_shares_is_newcombes() -> None:
    """56 of 70 and 48 of 80, from Newcombe, Statistics in Medicine 17, 1998, table II, method 10."""
    value, interval = difference(share(48, 80), share(56, 70))
    assert value == pytest.approx(0.2)
    assert interval == pytest.approx((0.0524, 0.3339), abs=1e-4)
    assert difference(metric(1.0, None, 5, "m"), share(1, 2)) == (-0.5, None)


def test_what_differs_is_better_or_worse_by_what_the_metric_means(two: tuple[Path, Path]) -> None:
    found, told = compare_results(*two)
    sides = {entry.name: entry.side for entry in found}
    assert sides == {
        "gap.h3.success": "better", "fdm.bayesian.x.rmse": "worse", "gap.h3.duration_s": "differs", "steps": "unknown",
        "gap.h3.clean": "same",
    }  # fmt: skip
    assert told == ["seed differs: 0 and 1"]
    lines = list(describe(found, told, every=False))
    assert lines[1].startswith("gap.h3.success: 0.5 and 1 1, +0.5 [") and lines[1].endswith("better")
    assert len(lines) == 5 and "better in 1, worse in 1, otherwise different in 1; 1 do not" in lines[-1]
    assert len(list(describe(found, told, every=True))) == 7


def test_on_the_command_line(two: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    first, second = map(str, two)
    assert call(COMMANDS, GROUPS, ["compare", first, second]) == 0
    assert "worse in 1" in capsys.readouterr().out
    assert call(COMMANDS, GROUPS, ["compare", f"{first}/results.json", second, "--json"]) == 0
    held = json.loads(capsys.readouterr().out)
    assert held["differences"]["gap.h3.success"]["side"] == "better"
    with pytest.raises(SystemExit) as ended:
        call(COMMANDS, GROUPS, ["compare", first, second, "--check"])
    assert ended.value.code == 1
    assert call(COMMANDS, GROUPS, ["compare", first, first, "--check"]) == 0
    capsys.readouterr()
    assert call(COMMANDS, GROUPS, ["compare", first]) == 2
    assert "SECOND is missing: name two results" in capsys.readouterr().err


def test_results_of_other_commands_are_refused(two: tuple[Path, Path], tmp_path: Path) -> None:
    other = results(tmp_path / "c", {"vfa.paper.safe": share(1, 2)})
    with pytest.raises(DatasetError, match=r"no metric in common, such as gap.h3.success and vfa.paper.safe"):
        compare_results(two[0], other)
    with pytest.raises(DatasetError, match="no such file"):
        compare_results(two[0], tmp_path / "none")
    (tmp_path / "results.json").write_text("{}")
    with pytest.raises(DatasetError, match="holds no metrics"):
        compare_results(two[0], tmp_path)
