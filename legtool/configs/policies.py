"""How a learned policy sees and moves a robot: its observation and action, described in YAML."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from legtool.configs.settings import Settings, build, read_yaml
from legtool.errors import SettingsError
from legtool_runtime.robot import JOINTS, LEGS

Term = Literal[
    "base_linear_velocity",
    "base_angular_velocity",
    "gravity",
    "command",
    "joint_positions",
    "joint_velocities",
    "last_action",
    "gait_phase",
]
#: Numbers that each term adds to a frame of the observation.
TERM_SIZES: dict[str, int] = {
    "base_linear_velocity": 3,
    "base_angular_velocity": 3,
    "gravity": 3,
    "command": 3,
    "joint_positions": 12,
    "joint_velocities": 12,
    "last_action": 12,
    "gait_phase": 4,
}
JOINT_NAMES = tuple(f"{leg}_{joint}" for leg in LEGS for joint in JOINTS)
Scale = Annotated[float, Field(gt=0)]


class GaitPhase(Settings):
    """The gait clock that the policy was trained with, which has one phase for each leg."""

    start: tuple[float, float, float, float] = Field(description="phases of FL, FR, RL, RR at the start [cycles]")
    frequency_hz: float = Field(gt=0, le=10, description="cycles in a second [1/s]")
    idle: float = Field(-1.0, description="value of every phase while the command is zero")


class AnymalPolicies(Settings):
    """Where the two public policies for ANYmal are that QuadPiPS compares with, and the robot that they walk."""

    em_rl: Path | None = Field(None, description="TorchScript file of EM-RL, which was trained on ANYmal C")
    em_dtc: Path | None = Field(None, description="TorchScript file of EM-DTC, which was trained on ANYmal D")
    robot: str | None = Field(
        "example_robot_data:anymal_c",
        description="model of the robot that they walk, as for mjcf; null: the suite's own",
    )


class PolicySettings(Settings):
    """A policy in ONNX with one input and one output."""

    onnx: Path = Field(description="file of the network; a relative path starts at the directory of this file")
    rate_hz: float = Field(gt=0, le=1000, description="rate at which the policy runs [1/s]")
    history: int = Field(1, ge=1, le=100, description="number of frames in an observation, oldest first")
    observation: tuple[Term, ...] = Field(min_length=1, description="terms of one frame, in order")
    joint_order: tuple[str, ...] = Field(description="joint names such as FL_hip, in the order of the network")
    home: tuple[float, ...] = Field(
        description="joint angles that the zero action means, in the order of the network [rad]"
    )
    phase: GaitPhase | None = None
    action_clip: float = Field(100.0, gt=0, description="actions are limited to ± this")
    action_filter: float = Field(
        1.0, gt=0, le=1, description="weight of the new action in a first-order filter; 1: no filter"
    )
    action_scale: Scale = Field(description="target = home + scale × action [rad]")
    stiffness: float = Field(gt=0, description="joint torque for each rad of angle error [Nm/rad]")
    damping: float = Field(ge=0, description="joint torque for each rad/s of joint velocity [Nm s/rad]")

    @model_validator(mode="after")
    def _check(self) -> PolicySettings:
        if sorted(self.joint_order) != sorted(JOINT_NAMES):
            raise ValueError(f"joint_order must name each of {', '.join(JOINT_NAMES)} once")
        if len(self.home) != len(JOINT_NAMES):
            raise ValueError(f"home has {len(self.home)} angles, expected 12 in the order of joint_order")
        if "gait_phase" in self.observation and self.phase is None:
            raise ValueError("observation holds gait_phase: say how it runs under 'phase'")
        return self

    @property
    def frame_size(self) -> int:
        """Numbers in one frame."""
        return sum(TERM_SIZES[term] for term in self.observation)


def load_policy_settings(path: Path) -> PolicySettings:
    """Read a policy's description.

    Raises:
        SettingsError: no such file, or a key is unknown, missing or out of range.
    """
    values = read_yaml(path)
    if not isinstance(values, dict) or "onnx" not in values:
        raise SettingsError(f"{path}: expected a policy's description with at least the key onnx")
    return build(PolicySettings, {**values, "onnx": path.parent / str(values["onnx"])}, source=str(path))
