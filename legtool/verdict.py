"""A verdict on what was measured: green, amber or red by criteria that are stated, what it means, and what to do."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

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
        """Plain JSON types, for ``results.json`` and ``manifest.json``."""
        return {"level": self.level, "findings": [finding._asdict() for finding in self.findings]}

    @classmethod
    def from_dict(cls, said: Mapping[str, Any]) -> Verdict:
        """The verdict of :meth:`to_dict`."""
        return cls(tuple(Finding(**finding) for finding in said["findings"]))


def graded(green: bool, amber: bool, text: str, advice: str) -> Finding:
    """A finding: green, else amber, else red; its advice is left out where it is green."""
    level: Level = "green" if green else "amber" if amber else "red"
    return Finding(level, text, "" if level == "green" else advice)
