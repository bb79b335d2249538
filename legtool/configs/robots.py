"""Robot parameters: geometry, from which the runtime's Robot is made, and masses and limits for the simulator."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from legtool.configs.camera import DepthCamera
from legtool.configs.settings import Settings, build, read_yaml
from legtool.errors import RobotError
from legtool_runtime.robot import LEGS, Robot

PRESETS = Path(__file__).parent / "robots"

Positive = Annotated[float, Field(gt=0)]
#: Bounds of what a four-legged robot can be: beyond them a figure was given in another unit.
Length = Annotated[float, Field(gt=0, le=1.5)]
Radius = Annotated[float, Field(gt=0, le=0.2)]
Place = Annotated[float, Field(ge=-1.5, le=1.5)]
Mass = Annotated[float, Field(gt=0, le=300)]
Torque = Annotated[float, Field(gt=0, le=2000)]
Angle = Annotated[float, Field(ge=-6.3, le=6.3)]
Vector3 = tuple[float, float, float]
Limit = tuple[Angle, Angle]
#: Limits of a joint whose range plays no part, or is not known [rad].
_FREE: Limit = (-3.1416, 3.1416)
#: Height of the hips above the feet at rest where it is not given, as a share of the leg's length.
_STANDING = 0.75


class Body(Settings):
    """One rigid body: mass, centre of mass and principal moments of inertia in its own frame."""

    mass: Mass = Field(description="mass [kg]")
    com: Vector3 = Field(
        (0.0, 0.0, 0.0), description="centre of mass in the body's frame; for links, those of the left front leg [m]"
    )
    inertia: tuple[Positive, Positive, Positive] | None = Field(
        None, description="principal moments of inertia about the centre of mass [kg m²]; null: from the shape"
    )
    size: Vector3 | None = Field(None, description="edges of the box, for the trunk [m]")
    radius: Positive | None = Field(None, description="radius of the capsule, for links [m]")


class RobotGeometry(Settings):
    """Lengths of a four-legged robot: all that its logs are read with. Left and right are symmetric."""

    name: str = Field(pattern=r"^[a-z0-9_]+$")
    source: str = Field("", description="sources of the figures")
    hip_x: tuple[Place, Place] = Field(description="x of the abduction axes in the base frame, front and hind [m]")
    hip_y: Length = Field(description="distance of the abduction axes from the middle plane [m]")
    hip_z: Place = Field(0.0, description="z of the abduction axes in the base frame [m]")
    abduction_offset: float = Field(
        ge=0, le=1, description="distance from the abduction axis outward to the thigh axis [m]"
    )
    thigh_length: Length = Field(description="distance from the thigh axis to the knee [m]")
    shank_length: Length = Field(description="distance from the knee to the centre of the foot's sphere [m]")
    knee_sign: tuple[int, int] = Field(description="front and hind: -1 for knees behind the leg, +1 for knees in front")
    knee_offset: tuple[float, float] = Field(
        (0.0, 0.0),
        description="our knee angle, at which 0 stretches the leg, minus the robot's own, front and hind: other than 0 "
        "where the foot lies beside the shank's axis [rad]",
    )
    foot_radius: Radius = Field(0.02, description="radius of the foot's sphere [m]")
    hip_limits: Limit = Field(
        _FREE, description="abduction angles of a left leg, positive about x, which is outward [rad]"
    )
    thigh_limits: tuple[Limit, Limit] = Field((_FREE, _FREE), description="thigh angles, front and hind [rad]")
    knee_limits: tuple[Limit, Limit] = Field((_FREE, _FREE), description="knee angles, front and hind [rad]")
    standing_height: Length | None = Field(
        None, description="height of the base above the ground when standing at rest [m]; null: from the legs' length"
    )
    stance_x: tuple[float, float] = Field(
        (0.0, 0.0), description="distance of the feet ahead of their hips at rest, front and hind [m]"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        reach = self.thigh_length + self.shank_length
        if self._height + self.hip_z - self.foot_radius >= reach:
            raise ValueError(f"standing_height {self.standing_height} m is beyond the legs' reach of {reach:.3f} m")
        return self

    @property
    def _height(self) -> float:
        if self.standing_height is not None:
            return self.standing_height
        return _STANDING * (self.thigh_length + self.shank_length) - self.hip_z + self.foot_radius

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
        stance[:, 2] = self.foot_radius - self._height
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


class RobotSettings(RobotGeometry):
    """A four-legged robot as it is simulated: lengths, masses, limits, friction, and its camera."""

    source: str = Field(description="sources of the figures")
    foot_radius: Radius = Field(description="radius of the foot's sphere [m]")
    hip_limits: Limit = Field(description="abduction angles of a left leg, positive about x, which is outward [rad]")
    thigh_limits: tuple[Limit, Limit] = Field(description="thigh angles, front and hind [rad]")
    knee_limits: tuple[Limit, Limit] = Field(description="knee angles, front and hind [rad]")
    torque_limits: tuple[Torque, Torque, Torque] = Field(description="largest torques of hip, thigh and knee [Nm]")
    joint_damping: float = Field(ge=0, description="viscous friction of a joint [Nm s/rad]")
    joint_friction: float = Field(ge=0, description="dry friction of a joint [Nm]")
    joint_armature: float = Field(ge=0, description="inertia of the rotor as seen at the joint [kg m²]")
    standing_height: Length = Field(description="height of the base above the ground when standing at rest [m]")
    swing_height_max: Positive = Field(
        0.15, le=1, description="height of the highest obstacle that a foot can swing over [m]"
    )
    camera: DepthCamera = Field(default_factory=DepthCamera)
    foot_mass: float = Field(0.0, ge=0, description="mass of the foot at the end of the shank [kg]")
    trunk: Body
    hip: Body
    thigh: Body
    shank: Body

    @property
    def total_mass(self) -> float:
        """[kg]."""
        return self.trunk.mass + 4 * (self.hip.mass + self.thigh.mass + self.shank.mass + self.foot_mass)


class MeasuredRobot(Settings):
    """A robot whose lengths were measured on its MJCF file, and the camera that it is given.

    It stands in place of :class:`RobotSettings` where scenes are seen: heights, hips, camera, highest swing.
    """

    name: str = Field(description="name of the robot")
    measured: dict[str, Any] = Field(description="its geometry, as the runtime's Robot writes it")
    swing_height_max: Positive = Field(
        0.15, le=1, description="height of the highest obstacle that a foot can swing over [m]"
    )
    camera: DepthCamera

    def geometry(self) -> Robot:
        """The runtime's description of this robot."""
        return Robot.from_dict(self.measured)

    @property
    def standing_height(self) -> float:
        """Height of the base above the ground when standing at rest [m]."""
        return self.geometry().standing_height

    @property
    def hip_x(self) -> tuple[float, float]:
        """Mean x of the hips in the base frame, front and hind [m]."""
        x = self.geometry().hips[:, 0]
        return float(x[:2].mean()), float(x[2:].mean())

    @property
    def hip_y(self) -> float:
        """Mean distance of the hips from the middle plane [m]."""
        return float(np.abs(self.geometry().hips[:, 1]).mean())

    @property
    def abduction_offset(self) -> float:
        """Mean distance from the abduction axis outward to the thigh axis [m]."""
        return float(np.abs(self.geometry().abduction_offset).mean())


#: A robot as scenes are seen by it.
SeeingRobot = RobotSettings | MeasuredRobot


def read_seeing_robot(description: Mapping[str, Any], source: str) -> SeeingRobot:
    """The robot that a dataset of scenes, or a run of them, was made with.

    Args:
        description: what :meth:`to_dict` of either class gave.
        source: where it stands, for messages.

    Raises:
        SettingsError: a key is unknown, missing or out of range.
    """
    if "measured" in description:
        return build(MeasuredRobot, description, source=source)
    return build(RobotSettings, description, source=source)


def load_robot(name_or_path: str) -> RobotSettings:
    """A preset by name, or the user's own YAML by path.

    Raises:
        RobotError: no such preset or file; the message lists the presets.
        SettingsError: a key is unknown, missing or out of range.
    """
    path = _find(name_or_path)
    return build(RobotSettings, read_yaml(path) or {}, source=str(path))


def load_geometry(name_or_path: str) -> RobotGeometry:
    """The lengths of a preset by name, or of the user's own YAML by path, which need not hold anything else.

    Raises:
        RobotError: no such preset or file; the message lists the presets.
        SettingsError: a key is unknown, missing or out of range.
    """
    path = _find(name_or_path)
    simulated = RobotSettings.model_fields.keys() - RobotGeometry.model_fields.keys()
    values = {name: value for name, value in (read_yaml(path) or {}).items() if name not in simulated}
    return build(RobotGeometry, values, source=str(path))


def _find(name_or_path: str) -> Path:
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        path = PRESETS / f"{name_or_path}.yaml"
    if not path.is_file():
        presets = ", ".join(sorted(preset.stem for preset in PRESETS.glob("*.yaml")))
        raise RobotError(f"robot {name_or_path!r}: no such preset or YAML file; presets: {presets}")
    return path
