"""Settings of ``collect log``."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from legtool.configs.motion import TransitionSettings
from legtool.configs.settings import Settings


class LogSettings(Settings):
    """A real robot's logs: whose they are, where the signals stand in them, how steps are cut."""

    robot: str = Field("aliengo", description="preset or YAML file of the robot that was logged")
    topics: str = Field("ros2_standard", description="preset or YAML file: which topic or column holds what")
    msgs: Path | None = Field(None, description="directory of custom .msg definitions")
    transitions: TransitionSettings = TransitionSettings()
