"""Planners beside each other: pairs of trials, and what trials were lost by."""

from typing import Any

import pytest

from legtool.evaluation.suites.comparison import causes_of, compare, comparison_sections, lost_by


def record(
    outcome: str = "goal", *, progress: float = 1.0, missteps: tuple[float, ...] = (), **more: Any
) -> dict[str, Any]:
    return {
        "outcome": outcome,
        "success": outcome == "goal",
        "clean": outcome == "goal" and not missteps,
        "duration_s": 20.0,
        "missteps": [(when, 0.0, 0.0, 0) for when in missteps],
        "progress": [(0.0, 0.0), (20.0, progress)],
        **more,
    }


@pytest.mark.parametrize(
    ("one", "cause"),
    [
        (record(), ""),
        (record("fell", missteps=(18.0,)), "misstep"),
        (record("fell", missteps=(3.0,)), "balance"),
        (record("fell"), "balance"),
        (record("stalled"), "stuck"),
        (record("timeout", stages={"blocked_by": "search"}), "search"),
        (record("stalled", stages={"blocked_by": ""}), "stuck"),
        (record("stopped: torques"), "stopped"),
        (record("error: ValueError: no"), "error"),
    ],
)
def test_a_trial_is_lost_by_one_cause(one: dict[str, Any], cause: str) -> None:
    assert lost_by(one) == cause


def test_shares_are_those_of_all_trials() -> None:
    shares = causes_of([record(), record("fell"), record("fell"), record("stalled")])
    assert {name: entry["value"] for name, entry in shares.items()} == {"lost_balance": 0.5, "lost_stuck": 0.25}


def test_differences_are_of_the_same_trials_and_of_all_worlds_together() -> None:
    lost = record("fell", progress=0.4)
    records = {
        ("beam", "a"): [record()] * 4, ("beam", "b"): [lost, lost, record(), lost],
        ("ramp", "a"): [record()] * 3, ("ramp", "b"): [record()] * 4,
    }  # fmt: skip
    found = compare(records)
    beam, ramp, both = (found[f"{world}.a-b.success_difference"] for world in ("beam", "ramp", "all"))
    assert (beam["value"], beam["n"]) == (0.75, 4) and (ramp["value"], ramp["n"]) == (0.0, 3)
    assert both["value"] == pytest.approx(3 / 7) and both["n"] == 7
    assert found["beam.a-b.success_p"]["value"] == pytest.approx(2 * 0.5**3)
    assert found["beam.a-b.progress_difference"]["value"] == pytest.approx(0.45)
    assert "beam.b-a.success_difference" not in found
    unlike = compare({("beam", "a"): [record(progress=1.0)], ("beam", "b"): [{**record(), "progress": []}]})
    assert "beam.a-b.progress_difference" not in unlike and "all.a-b.success_p" not in unlike


def test_the_page_shows_counts_differences_and_causes() -> None:
    records = {
        ("beam", "a"): [record()] * 2,
        ("beam", "b"): [record("fell", missteps=(19.0,)), record(missteps=(1.0,))],
    }
    reached, differences, causes = comparison_sections(records, compare(records))
    assert [cell["value"] for cell in reached["table"]["rows"][0]["cells"]] == ["2/2", "1/2"]
    assert reached["table"]["rows"][0]["cells"][1]["note"].endswith("0 clean")
    assert differences["table"]["rows"][0]["cells"][0]["value"] == "+50"
    assert causes["table"]["head"] == ["", "trials", "reached", "misstep"]
    assert [cell["value"] for cell in causes["table"]["rows"][1]["cells"]] == ["2", "1", "1"]
    assert comparison_sections({("beam", "a"): [record()]}, {}) == []
