"""Settings of ``eval perception``."""

from __future__ import annotations

from pydantic import Field, model_validator

from legtool.configs.scenes import CameraMotion, Placement, Range, SceneSettings
from legtool.configs.settings import Settings


class PerceptionEvalSettings(Settings):
    """Rendered walks with ground truth, processed by perception and by its baseline."""

    robot: str | None = Field(
        None, description="preset or YAML file of the robot; null: the robot of the bundle, or go2"
    )
    seed: int = Field(0, ge=0, description="seed of the scenes, none of which is in a dataset of collect scenes")
    sequences: int = Field(24, ge=1, le=10_000, description="number of walks, each through a different scene")
    frames: int = Field(30, ge=4, le=1000, description="number of frames in each walk")
    frame_s: float = Field(0.1, gt=0, le=2, description="time between frames [s]")
    settle: int = Field(6, ge=1, le=900, description="number of frames before the first one that is scored")
    every: int = Field(4, ge=1, le=100, description="every how many frames one is scored")
    speed: Range = Field((0.2, 0.8), description="lowest and highest speed of a walk [m/s]")
    placements: dict[Placement, float] = Field(
        {"clustered": 0.25, "scattered": 0.25, "staircase": 0.25, "stepping_stones": 0.25},
        min_length=1,
        description="share of walks with each placement",
    )
    flat_floor: float = Field(0.75, ge=0, le=1, description="share of walks on a flat floor")
    lift: float = Field(0.3, ge=0, le=2, description="height of the egocan's origin above the base [m]")
    tolerance: float = Field(
        0.01, gt=0, le=0.1, description="largest distance of a region from the face that it lies on [m]"
    )
    resolution_m: float = Field(
        0.005, gt=0.001, le=0.02, description="cell size of the grid on which areas are measured [m]"
    )
    baseline_resolution_m: float = Field(
        0.02, ge=0.005, le=0.1, description="cell size of the baseline's elevation map [m]"
    )
    bootstrap: int = Field(1000, ge=100, le=100_000, description="resamples of walks for the 95 % intervals")

    @model_validator(mode="after")
    def _check(self) -> PerceptionEvalSettings:
        if self.settle + 2 > self.frames:
            raise ValueError(f"settle {self.settle}: expected at most frames - 2, {self.frames - 2}")
        return self

    def scenes(self) -> SceneSettings:
        """The scenes and walks: the camera sits where the robot's YAML says, and jitters as in training."""
        camera = CameraMotion(frame_s=self.frame_s, speed=self.speed, height_spread=0, pitch_spread=0)
        return SceneSettings(
            seed=self.seed + 1_000_000,
            scenes=self.sequences,
            frames=self.frames,
            placements=self.placements,
            flat_floor=self.flat_floor,
            camera=camera,
        )
