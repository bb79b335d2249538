"""Robot parameters: geometry, masses and limits, from which the simulator builds a model and the runtime its Robot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
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

    mass: Positive = Field(description="[kg]")
    com: Vector3 = Field(
        (0.0, 0.0, 0.0), description="centre of mass in the body's frame, of the left front leg's links [m]"
    )
    inertia: tuple[Positive, Positive, Positive] | None = Field(
        None, description="about the centre of mass [kg m²]; none: from the primitive's shape"
    )
    size: Vector3 | None = Field(None, description="trunk: box edges [m]")
    radius: Positive | None = Field(None, description="links: capsule radius [m]")


class RobotSettings(Settings):
    """A four-legged robot, left-right symmetric, front and hind legs alike but for position and knee direction."""

    name: str = Field(pattern=r"^[a-z0-9_]+$")
    source: str = Field(description="where each figure comes from")
    hip_x: tuple[float, float] = Field(description="abduction axes ahead of the base, front and hind [m]")
    hip_y: Positive = Field(description="abduction axes beside the base [m]")
    hip_z: float = Field(0.0, description="abduction axes above the base [m]")
    abduction_offset: float = Field(ge=0, description="abduction axis to thigh axis, outward [m]")
    thigh_length: Positive = Field(description="[m]")
    shank_length: Positive = Field(description="knee to the foot sphere's centre [m]")
    knee_sign: tuple[int, int] = Field(description="front and hind: -1 knee behind the leg, +1 in front")
    foot_radius: Positive = Field(description="[m]")
    hip_limits: Limit = Field(description="abduction of a left leg, + outward is + about x [rad]")
    thigh_limits: tuple[Limit, Limit] = Field(description="front and hind [rad]")
    knee_limits: tuple[Limit, Limit] = Field(description="front and hind [rad]")
    torque_limits: tuple[Positive, Positive, Positive] = Field(description="hip, thigh, knee [Nm]")
    joint_damping: float = Field(ge=0, description="[Nm s/rad]")
    joint_friction: float = Field(ge=0, description="dry friction [Nm]")
    joint_armature: float = Field(ge=0, description="rotor inertia at the joint [kg m²]")
    standing_height: Positive = Field(description="base above ground when standing at rest [m]")
    stance_x: tuple[float, float] = Field((0.0, 0.0), description="feet ahead of their hips at rest, front, hind [m]")
    swing_height_max: Positive = Field(0.15, le=1, description="highest obstacle that a swing steps over [m]")
    camera: DepthCamera = Field(default_factory=DepthCamera)
    foot_mass: float = Field(0.0, ge=0, description="of the foot itself, at the end of the shank [kg]")
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
