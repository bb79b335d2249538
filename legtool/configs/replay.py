"""Settings of ``replay``."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from legtool.configs.settings import Settings
from legtool_runtime.motion.planning.plan import PlannerSettings
from legtool_runtime.terrain.settings import CostmapSettings, ElevationSettings


class ReplaySettings(Settings):
    """The runtime on a recorded walk. What a recording of ``eval planner`` says of itself holds if nothing is set."""

    robot: str | None = Field(None, description="preset or YAML file of the robot; null: that of the bundle")
    topics: str = Field("ros2_standard", description="preset or YAML file that says where the log holds each signal")
    msgs: Path | None = Field(None, description="directory of custom .msg definitions")
    goal: tuple[float, float] | None = Field(
        None, description="x and y of where the walk leads [m]; null: where the recorded commands lead"
    )
    horizon: int = Field(5, ge=1, le=20, description="steps that the planner looks ahead, and predictions reach")
    actions: Literal["forward", "reversing", "planar"] = Field(
        "reversing", description="commands to choose from, as for eval planner"
    )
    cruise_speed: float | None = Field(
        0.6, gt=0, le=3, description="faster commands are for where none else goes on [m/s]; null: for always"
    )
    planner: PlannerSettings = PlannerSettings()
    elevation: ElevationSettings = ElevationSettings()
    costmap: CostmapSettings = CostmapSettings()
    deadline_s: float = Field(0.01, gt=0, le=1, description="plans that took longer are counted as late [s]")
    contact_on: float | None = Field(
        None, gt=0, description="force with which a foot lands; null: by the range of the log's forces"
    )
    contact_off: float | None = Field(None, gt=0, description="force below which a foot lifts off")
    first_pair: Literal[0, 1] = Field(0, description="pair that swings first after a stand: 0 for FL+RR, 1 for FR+RL")

    def as_recorded(self, recorded: dict[str, Any]) -> ReplaySettings:
        """These settings, with those of a recording where nothing else was said."""
        known = {name: value for name, value in recorded.items() if name in type(self).model_fields}
        chosen = {name: value for name, value in known.items() if name not in self.model_fields_set}
        return self.replace(**chosen) if chosen else self
