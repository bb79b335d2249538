"""Settings of ``collect log``."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from legtool.configs.motion import TransitionSettings
from legtool.configs.settings import Settings


class LogSettings(Settings):
    """The logs of a real robot: which robot, where the logs hold each signal, and how steps are cut."""

    robot: str = Field("aliengo", description="preset or YAML file of the robot that was logged")
    topics: str = Field(
        "ros2_standard", description="preset or YAML file that says which topic or column holds each signal"
    )
    msgs: Path | None = Field(None, description="directory of custom .msg definitions")
    split_at_jumps: bool = Field(
        False, description="whether a log whose stamps jump by hours is taken as several recordings, instead of refused"
    )
    transitions: TransitionSettings = TransitionSettings()
