"""Robot parameters: geometry, masses and limits, from which the simulator builds a model and the runtime its Robot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from legtool.configs.camera import DepthCamera
from legtool.configs.settings import Settings, build, read_yaml
from legtool.errors import RobotError
from legtool_runtime.robot import LEGS, Robot

PRESETS = Path(__file__).parent / "robots"

Positive = Annotated[float, Field(gt=0)]
Vector3 = tuple[float, float, float]
Limit = tuple[float, float]


class Body(Settings):
    """One rigid body: mass, centre of mass and principal moments of inertia in its own frame."""

    mass: Positive = Field(description="mass [kg]")
    com: Vector3 = Field(
        (0.0, 0.0, 0.0), description="centre of mass in the body's frame; for links, those of the left front leg [m]"
    )
    inertia: tuple[Positive, Positive, Positive] | None = Field(
        None, description="principal moments of inertia about the centre of mass [kg m²]; null: from the shape"
    )
    size: Vector3 | None = Field(None, description="edges of the box, for the trunk [m]")
    radius: Positive | None = Field(None, description="radius of the capsule, for links [m]")


class RobotSettings(Settings):
    """A four-legged robot: left and right are symmetric, front and hind legs differ in position and knee direction."""

    name: str = Field(pattern=r"^[a-z0-9_]+$")
    source: str = Field(description="sources of the figures")
    hip_x: tuple[float, float] = Field(description="x of the abduction axes in the base frame, front and hind [m]")
    hip_y: Positive = Field(description="distance of the abduction axes from the middle plane [m]")
    hip_z: float = Field(0.0, description="z of the abduction axes in the base frame [m]")
    abduction_offset: float = Field(ge=0, description="distance from the abduction axis outward to the thigh axis [m]")
    thigh_length: Positive = Field(description="distance from the thigh axis to the knee [m]")
    shank_length: Positive = Field(description="distance from the knee to the centre of the foot's sphere [m]")
    knee_sign: tuple[int, int] = Field(description="front and hind: -1 for knees behind the leg, +1 for knees in front")
    knee_offset: tuple[float, float] = Field(
        (0.0, 0.0),
        description="our knee angle, at which 0 stretches the leg, minus the robot's own, front and hind: other than 0 "
        "where the foot lies beside the shank's axis [rad]",
    )
    foot_radius: Positive = Field(description="radius of the foot's sphere [m]")
    hip_limits: Limit = Field(description="abduction angles of a left leg, positive about x, which is outward [rad]")
    thigh_limits: tuple[Limit, Limit] = Field(description="thigh angles, front and hind [rad]")
    knee_limits: tuple[Limit, Limit] = Field(description="knee angles, front and hind [rad]")
    torque_limits: tuple[Positive, Positive, Positive] = Field(
        description="largest torques of hip, thigh and knee [Nm]"
    )
    joint_damping: float = Field(ge=0, description="viscous friction of a joint [Nm s/rad]")
    joint_friction: float = Field(ge=0, description="dry friction of a joint [Nm]")
    joint_armature: float = Field(ge=0, description="inertia of the rotor as seen at the joint [kg m²]")
    standing_height: Positive = Field(description="height of the base above the ground when standing at rest [m]")
    stance_x: tuple[float, float] = Field(
        (0.0, 0.0), description="distance of the feet ahead of their hips at rest, front and hind [m]"
    )
    swing_height_max: Positive = Field(
        0.15, le=1, description="height of the highest obstacle that a foot can swing over [m]"
    )
    camera: DepthCamera = Field(default_factory=DepthCamera)
    foot_mass: float = Field(0.0, ge=0, description="mass of the foot at the end of the shank [kg]")
    trunk: Body
    hip: Body
    thigh: Body
    shank: Body

    @model_validator(mode="after")
    def _check(self) -> RobotSettings:
        reach = self.thigh_length + self.shank_length
        if self.standing_height + self.hip_z - self.foot_radius >= reach:
            raise ValueError(f"standing_height {self.standing_height} m is beyond the legs' reach of {reach:.3f} m")
        return self

    @property
    def total_mass(self) -> float:
        """[kg]."""
        return self.trunk.mass + 4 * (self.hip.mass + self.thigh.mass + self.shank.mass + self.foot_mass)

    @property
    def joint_offset(self) -> NDArray[np.float64]:
        """What is added to the robot's own joint angles to get ours: (12,) [rad]."""
        offset = np.zeros((4, 3))
        offset[:, 2] = np.array(self.knee_offset)[[0, 0, 1, 1]]
        return offset.reshape(12)

    def geometry(self) -> Robot:
        """The runtime's description of this robot."""
        side = np.array([1.0, -1.0, 1.0, -1.0])
        hind = np.array([0, 0, 1, 1])
        hips = np.stack([np.array(self.hip_x)[hind], side * self.hip_y, np.full(4, self.hip_z)], axis=1)
        stance = hips.copy()
        stance[:, 0] += np.array(self.stance_x)[hind]
        stance[:, 1] += side * self.abduction_offset
        stance[:, 2] = self.foot_radius - self.standing_height
        limits = np.empty((4, 3, 2))
        for leg in range(len(LEGS)):
            low, high = self.hip_limits
            limits[leg, 0] = (low, high) if side[leg] > 0 else (-high, -low)
            limits[leg, 1] = self.thigh_limits[hind[leg]]
            limits[leg, 2] = self.knee_limits[hind[leg]]
        return Robot(
            name=self.name,
            hips=hips,
            abduction_offset=side * self.abduction_offset,
            thigh_length=np.full(4, self.thigh_length),
            shank_length=np.full(4, self.shank_length),
            knee_sign=np.array(self.knee_sign, dtype=float)[hind],
            joint_limits=limits,
            foot_radius=self.foot_radius,
            stance=stance,
        )


def load_robot(name_or_path: str) -> RobotSettings:
    """A preset by name, or the user's own YAML by path.

    Raises:
        RobotError: no such preset or file; the message lists the presets.
        SettingsError: a key is unknown, missing or out of range.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        path = PRESETS / f"{name_or_path}.yaml"
    if not path.is_file():
        presets = ", ".join(sorted(preset.stem for preset in PRESETS.glob("*.yaml")))
        raise RobotError(f"robot {name_or_path!r}: no such preset or YAML file; presets: {presets}")
    return build(RobotSettings, read_yaml(path) or {}, source=str(path))
