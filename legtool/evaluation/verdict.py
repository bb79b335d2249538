"""A verdict on a measured model: green, amber or red by criteria that are stated, what it means, and what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

from legtool.evaluation.report.results import Metric

Level = Literal["green", "amber", "red"]
_ORDER: tuple[Level, ...] = ("green", "amber", "red")


class Finding(NamedTuple):
    """What one criterion says.

    Attributes:
        level: how good it is.
        text: what was measured, and what was expected.
        advice: what to do; empty where it is green.
    """

    level: Level
    text: str
    advice: str = ""


class Verdict(NamedTuple):
    """All findings on a model; its level is that of the worst."""

    findings: tuple[Finding, ...]

    @property
    def level(self) -> Level:
        """The level of the worst finding."""
        return max((finding.level for finding in self.findings), key=_ORDER.index, default="green")

    def lines(self) -> list[str]:
        """For a terminal: the verdict, then what is not green."""
        told = [finding for finding in self.findings if finding.level != "green"]
        means = {"green": "use it", "amber": "use it with care", "red": "do not use it"}[self.level]
        reasons = [f"  {finding.level}: {finding.text}; {finding.advice}" for finding in told]
        return [f"verdict: {self.level}, {means} ({len(self.findings)} criteria)", *reasons]

    def section(self) -> dict[str, Any]:
        """The first section of a report."""
        return {
            "title": f"Verdict: {self.level}",
            "text": "The worst of the criteria below. Green: use it. Amber: use it with care. Red: do not use it.",
            "table": {
                "head": ["criterion", "verdict", "what to do"],
                "rows": [
                    {
                        "name": finding.text,
                        "cells": [
                            {"value": finding.level, "note": "", "best": False},
                            {"value": finding.advice or "–", "note": "", "best": False},
                        ],
                    }
                    for finding in self.findings
                ],
            },
        }

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types, for ``results.json``."""
        return {"level": self.level, "findings": [finding._asdict() for finding in self.findings]}


#: Coverage of 90 % intervals that is green, and that is not yet red; the least and the largest share.
_HOLDS, _HOLDS_ROUGHLY = (0.85, 0.95), (0.75, 0.99)
#: RMSE on x as a share of that of the mean of all steps: below the first green, below the second amber.
_BETTER, _NO_BETTER = 0.5, 0.9
#: Steps for each of 25 parameters: ten are green, three amber.
_ENOUGH, _TOO_FEW = 250, 75


def judge_motion(metrics: Mapping[str, Metric], steps: int, constant: Sequence[str] = ()) -> Verdict:
    """Judge motion models by their held-out errors.

    Criteria: 90 % intervals hold 85 to 95 % of the steps on every axis (amber: 75 to 99 %); the error on x of FDM, CDM
    and CVM is below half that of the mean of all steps (amber: 0.9 of it); at least 250 steps (amber: 75); every
    command varies in the data (amber otherwise).

    Args:
        metrics: of ``evaluate_motion``.
        steps: that were measured on.
        constant: lines of ``constant_commands``.
    """
    findings = [_intervals(metrics), *(_error(metrics, model) for model in ("fdm", "cdm", "cvm")), _count(steps)]
    findings += [Finding("amber", *line.split("; ", 1)) for line in constant]
    return Verdict(tuple(findings))


def _intervals(metrics: Mapping[str, Metric]) -> Finding:
    shares = [entry["value"] for name, entry in metrics.items() if name.endswith(".coverage90")]
    low, high = min(shares), max(shares)
    text = f"90 % intervals hold {100 * low:.1f} to {100 * high:.1f} % of the steps, expected 85 to 95 % on every axis"
    level = _between(low, high, _HOLDS, _HOLDS_ROUGHLY)
    few = low < _HOLDS[0]
    advice = (
        "the intervals are too narrow: these steps differ from those of the fit; train on logs like them"
        if few
        else "the intervals are too wide: the planner will be too careful; train on cleaner or more data"
    )
    return Finding(level, text, "" if level == "green" else advice)


def _between(low: float, high: float, good: tuple[float, float], fair: tuple[float, float]) -> Level:
    if good[0] <= low and high <= good[1]:
        return "green"
    return "amber" if fair[0] <= low and high <= fair[1] else "red"


def _error(metrics: Mapping[str, Metric], model: str) -> Finding:
    error, naive = (metrics[f"{model}.{which}.x.rmse"]["value"] for which in ("bayesian", "naive"))
    share = error / naive if naive > 0 else float("inf")
    level: Level = "green" if share < _BETTER else "amber" if share < _NO_BETTER else "red"
    text = f"{model.upper()}: RMSE on x is {100 * share:.0f} % of that of the mean of all steps, expected below 50 %"
    advice = "the inputs tell little of the step: check the command's topic, the stamps and the feet, or vary the speed"
    return Finding(level, text, "" if level == "green" else advice)


def _count(steps: int) -> Finding:
    level: Level = "green" if steps >= _ENOUGH else "amber" if steps >= _TOO_FEW else "red"
    advice = "" if level == "green" else "collect more steps"
    return Finding(level, f"{steps} steps, expected at least {_ENOUGH}", advice)
