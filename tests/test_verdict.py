"""Verdicts by stated criteria, and what their exit code is."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from legtool.cli import CHECK, OUT
from legtool.command import Arguments, Command, call
from legtool.datasets.motion.excitation import constant_commands
from legtool.evaluation.judges import judge_motion
from legtool.evaluation.report.results import Metric, metric
from legtool.verdict import Finding, Verdict


def metrics(*, error: float = 0.01, naive: float = 0.1, holds: tuple[float, ...] = (0.9, 0.9)) -> dict[str, Metric]:
    found = {
        f"{model}.{which}.x.rmse": metric(value, None, 300, "m")
        for model in ("fdm", "cdm", "cvm")
        for which, value in (("bayesian", error), ("naive", naive))
    }
    return found | {f"fdm.bayesian.{k}.coverage90": metric(share, None, 300, "1") for k, share in enumerate(holds)}


def test_good_models_are_green_and_say_no_more() -> None:
    verdict = judge_motion(metrics(), 300)
    assert verdict.level == "green"
    assert verdict.lines() == ["verdict: green, use it (5 criteria)"]


@pytest.mark.parametrize(
    ("given", "steps", "level", "said"),
    [
        ({"holds": (0.84, 0.9)}, 300, "amber", "hold 84.0 to 90.0 %.* too narrow"),
        ({"holds": (0.0, 0.587)}, 300, "red", "hold 0.0 to 58.7 %.* too narrow"),
        ({"holds": (0.9, 0.97)}, 300, "amber", "too wide"),
        ({"error": 0.06}, 300, "amber", "FDM: RMSE on x is 60 % of that of the mean"),
        ({"error": 0.103}, 300, "red", "RMSE on x is 103 %"),
        ({"naive": 0.0}, 300, "red", "RMSE on x"),
        ({}, 249, "amber", "249 steps, expected at least 250; collect more steps"),
        ({}, 74, "red", "74 steps"),
    ],
)
def test_what_is_short_of_a_criterion_is_said_with_what_to_do(given, steps: int, level: str, said: str) -> None:
    verdict = judge_motion(metrics(**given), steps)
    assert verdict.level == level
    assert any(re.search(said, line) for line in verdict.lines())
    assert verdict.to_dict()["level"] == level
    assert verdict.section()["title"] == f"Verdict: {level}"


def test_commands_that_never_vary_are_named() -> None:
    rng = np.random.default_rng(0)
    command = np.column_stack([rng.uniform(0, 0.5, 200), np.zeros(200), rng.uniform(-0.01, 0.01, 200)])
    said = constant_commands(command)
    assert [line.partition(" is constant")[0] for line in said] == ["command vy", "command yaw rate"]
    assert "from 0.00 to 0.00 m/s" in said[0]
    # One odd command among two hundred is no excitation.
    command[0, 1] = 0.5
    assert len(constant_commands(command)) == 2
    assert constant_commands(rng.uniform(-0.3, 0.3, (200, 3))) == []
    assert constant_commands(np.empty((0, 3))) == []
    verdict = judge_motion(metrics(), 300, said)
    assert verdict.level == "amber" and "collect walks in which it changes" in verdict.lines()[1]


def test_check_makes_red_exit_1_and_nothing_else(tmp_path: Path) -> None:
    level = "red"

    def measure(given: Arguments) -> list[str]:
        """Measure."""
        verdict = Verdict((Finding(level, "a", "b"),))  # type: ignore[arg-type]
        (given.out / "results.json").write_text(json.dumps({"verdict": verdict.to_dict()}))
        return verdict.lines()

    table = (Command("measure", measure, (OUT, CHECK)), Command("other", measure, (OUT,)))
    words = ["measure", "--out", str(tmp_path)]
    assert call(table, {"": "Measures."}, words) == 0
    with pytest.raises(SystemExit) as ended:
        call(table, {"": "Measures."}, [*words, "--check"])
    assert ended.value.code == 1
    level = "amber"
    assert call(table, {"": "Measures."}, [*words, "--check"]) == 0
