"""Verdicts on networks, perception and planners."""

import re

import pytest

from legtool.evaluation.judges import (
    judge_foothold,
    judge_perception,
    judge_planner,
    judge_poses,
    judge_steppability,
)
from legtool.evaluation.report.results import Metric, metric


def metrics(values: dict[str, float], *, n: int = 1000, interval: bool = True) -> dict[str, Metric]:
    return {name: metric(value, (value, value) if interval else None, n, "1") for name, value in values.items()}


def said(verdict, level: str, pattern: str) -> None:
    assert verdict.level == level, verdict.lines()
    assert any(re.search(pattern, line) for line in verdict.lines()), verdict.lines()


VFA = {"vfa.paper.safe": 0.99, "vfa.paper.perfect": 0.98, "vfa.guess.perfect": 0.97}
VPA = {"vpa.dense.regret": 0.01, "vpa.dense.median_error": 0.03, "vpa.guess.median_error": 0.06}


@pytest.mark.parametrize(
    ("given", "network", "level", "pattern"),
    [
        (VFA, "paper", "green", "verdict: green, use it \\(3 criteria\\)"),
        (VFA | {"vfa.paper.safe": 0.95}, "paper", "amber", "safe footholds: 95 %, expected at least 98 %"),
        (VFA | {"vfa.paper.safe": 0.90}, "paper", "red", "by the exact criteria"),
        (
            VFA | {"vfa.guess.perfect": 0.98},
            "paper",
            "amber",
            "starts from 98 %, expected more; the network adds",
        ),
        (VPA, "dense", "green", "4 criteria"),
        (VPA | {"vpa.dense.regret": 0.06}, "dense", "red", "regret.*6 %, expected at most 2 %"),
        (VPA | {"vpa.dense.median_error": 0.07}, "dense", "amber", "starts from 6 %, expected less"),
    ],
)
def test_a_foothold_network_is_judged_beside_what_it_starts_from(given, network, level, pattern) -> None:
    said(judge_foothold(metrics(given), network), level, pattern)
    assert judge_foothold(metrics(given, interval=False), network).level in ("amber", "red")


def segmenter(**changes: float) -> dict[str, Metric]:
    values = {"miou": 0.9, "accuracy": 0.98, "confusion.non_passable.steppable": 0.005, "scenes": 60} | changes
    found = metrics({f"steppability.{name}": value for name, value in values.items()})
    pixels = {"steppable": 600, "passable": 100, "non_passable": 300}
    return found | {f"steppability.iou.{label}": metric(0.9, None, n, "1") for label, n in pixels.items()}


@pytest.mark.parametrize(
    ("changes", "level", "pattern"),
    [
        ({}, "green", "4 criteria"),
        ({"miou": 0.8}, "amber", "mean IoU: 0.8, expected at least 0.85"),
        ({"accuracy": 0.7}, "red", "75 % of those of the most frequent label"),
        ({"confusion.non_passable.steppable": 0.1}, "red", "called steppable: 10 %"),
        ({"scenes": 12}, "amber", "12 scenes, expected at least 30; measure on more scenes"),
    ],
)
def test_a_segmenter_is_judged_by_what_feet_would_step_into(changes, level, pattern) -> None:
    said(judge_steppability(segmenter(**changes)), level, pattern)


REGIONS = {"noisy.region_purity": 0.97, "noisy.overhang": 0.001, "noisy.coverage": 0.8, "walks": 20}


@pytest.mark.parametrize(
    ("changes", "level", "pattern"),
    [
        ({}, "green", "4 criteria"),
        ({"noisy.overhang": 0.02}, "red", "area over edges: 2 %"),
        ({"noisy.baseline.region_purity": 0.99}, "amber", "elevation map: 99.0 %"),
        ({"walks": 4}, "amber", "4 walks"),
    ],
)
def test_regions_are_judged_on_noisy_depth(changes, level, pattern) -> None:
    given = metrics({f"perception.{name}": value for name, value in (REGIONS | changes).items()})
    said(judge_perception(given), level, pattern)


def test_perception_without_regions_is_red() -> None:
    said(judge_perception(metrics({"perception.walks": 20})), "red", "no region was found")


def test_poses_are_judged_beside_those_of_the_terrain_plane() -> None:
    good = {"vpa.without_safe": 0.0, "vpa.collisions": 0.0, "vpa.workspace_violations": 0.005, "vpa.mean_safe": 300.0}
    walk = {f"rough.{name}": value for name, value in {**good, "tbr.mean_safe": 200.0}.items()}
    assert judge_poses(metrics(walk), ["rough"]).level == "green"
    said(judge_poses(metrics(walk | {"rough.vpa.without_safe": 0.2}), ["rough"]), "red", "no safe foothold: 20 %")
    said(judge_poses(metrics(walk | {"rough.tbr.mean_safe": 301.0}), ["rough"]), "amber", "by TBR 301")


def test_planners_are_judged_over_all_worlds_and_the_blind_one_by_itself_only() -> None:
    def given(reached: dict[str, float], *, n: int = 20, late: float = 0.0) -> dict[str, Metric]:
        found = {f"gap.{row}.success": metric(value, None, n, "1") for row, value in reached.items()}
        return found | {"gap.velocity.planning_late": metric(late, None, 500, "1")}

    both = ["blind", "velocity"]
    assert judge_planner(given({"blind": 0.2, "velocity": 1.0}), ["gap"], both).level == "green"
    said(judge_planner(given({"blind": 0.2}), ["gap"], ["blind"]), "red", "blind: 20 % of 20 trials")
    said(judge_planner(given({"velocity": 0.5}), ["gap"], ["velocity"]), "red", "walks of gap, where 50 % did")
    said(judge_planner(given({"velocity": 1.0}, late=0.02), ["gap"], ["velocity"]), "amber", "2 % of 500 plans were")
    said(judge_planner(given({"velocity": 1.0}, n=3), ["gap"], ["velocity"]), "amber", "3 trials of each")
