"""How a learned policy sees and moves a robot: its observation and action, described in YAML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from legtool.configs.observation import (
    PHASE_TERMS,
    TERM_SIZES,
    GaitPhase,
    HeightSamples,
    NetworkSettings,
    ObservationTerm,
)
from legtool.configs.settings import Settings, build, read_yaml
from legtool.errors import SettingsError
from legtool_runtime.robot import JOINTS, LEGS

JOINT_NAMES = tuple(f"{leg}_{joint}" for leg in LEGS for joint in JOINTS)


def _per_joint(given: Any) -> Any:
    """One number, twelve, or one for each kind of joint."""
    kinds = isinstance(given, Mapping) and sorted(given) == sorted(JOINTS)
    twelve = isinstance(given, (list, tuple)) and len(given) == len(JOINT_NAMES)
    one = isinstance(given, (int, float)) and not isinstance(given, bool)
    if not (kinds or twelve or one):
        raise ValueError(
            f"expected one number, twelve in the order of joint_order, or a mapping of {', '.join(JOINTS)}"
        )
    return given


PerJoint = Annotated[float | tuple[float, ...] | dict[str, float], BeforeValidator(_per_joint)]


class AnymalPolicies(Settings):
    """Where the two public policies for ANYmal are that QuadPiPS compares with, and the robot that they walk."""

    em_rl: Path | None = Field(None, description="TorchScript file of EM-RL, which was trained on ANYmal C")
    em_dtc: Path | None = Field(None, description="TorchScript file of EM-DTC, which was trained on ANYmal D")
    robot: str | None = Field(
        "example_robot_data:anymal_c",
        description="model of the robot that they walk, as for mjcf; null: the suite's own",
    )


class EstimatorSettings(NetworkSettings):
    """A second network, whose output the policy is shown as the term estimate."""

    outputs: int = Field(ge=1, le=4096, description="numbers that it gives")


class PolicySettings(NetworkSettings):
    """A policy: a network, when it is asked, and what its twelve actions do."""

    rate_hz: float = Field(gt=0, description="rate at which the policy runs, at most that of the control loop [1/s]")
    estimator: EstimatorSettings | None = Field(
        None, description="a network that is asked first, for the term estimate"
    )
    joint_order: tuple[str, ...] = Field(description="joint names such as FL_hip, in the order of the network")
    leg_order: tuple[str, ...] | None = Field(
        None, description="legs in the order of foot_contacts; null: that in which joint_order first names them"
    )
    home: tuple[float, ...] = Field(
        description="joint angles that the zero action means, in the order of the network [rad]"
    )
    phase: GaitPhase | None = None
    heights: HeightSamples | None = None
    contact_force: float = Field(5.0, gt=0, description="a foot is in contact above this force [N]")
    action_clip: PerJoint = Field(100.0, description="actions are limited to ± this")
    action_filter: float = Field(
        1.0, gt=0, le=1, description="weight of the new action in a first-order filter; 1: no filter"
    )
    filter_previous: Literal["filtered", "raw"] = Field(
        "filtered",
        description="which previous action the filter adds: what it gave itself, or the network's own, clipped",
    )
    last_action: Literal["filtered", "raw"] = Field(
        "filtered",
        description="which action the term last_action is: what the filter gave, or the network's own, clipped",
    )
    action_scale: PerJoint = Field(description="target = home + scale × action [rad]")
    velocity_targets: tuple[str, ...] = Field(
        (), description="joints whose target is a velocity, scale × action [rad/s]: damping alone pulls them"
    )
    stiffness: PerJoint = Field(description="joint torque for each rad of angle error [Nm/rad]")
    damping: PerJoint = Field(description="joint torque for each rad/s of joint velocity [Nm s/rad]")
    torque_limit: PerJoint | None = Field(
        None, description="joint torques are limited to ± this [Nm]; null: they are not"
    )

    @model_validator(mode="after")
    def _check(self) -> PolicySettings:
        if sorted(self.joint_order) != sorted(JOINT_NAMES):
            raise ValueError(f"joint_order must name each of {', '.join(JOINT_NAMES)} once")
        if self.leg_order is not None and sorted(self.leg_order) != sorted(LEGS):
            raise ValueError(f"leg_order must name each of {', '.join(LEGS)} once")
        if len(self.home) != len(JOINT_NAMES):
            raise ValueError(f"home has {len(self.home)} angles, expected 12 in the order of joint_order")
        if unknown := [name for name in self.velocity_targets if name not in JOINT_NAMES]:
            raise ValueError(f"velocity_targets names {unknown[0]}, expected some of {', '.join(JOINT_NAMES)}")
        for name in ("action_clip", "stiffness", "torque_limit"):
            if getattr(self, name) is not None and (self.per_joint(name) <= 0).any():
                raise ValueError(f"{name} must be above 0 for every joint")
        if (self.per_joint("damping") < 0).any() or (self.per_joint("action_scale") == 0).any():
            raise ValueError("damping must be at least 0, and action_scale other than 0, for every joint")
        for network in (self, self.estimator):
            for term in () if network is None else network.observation:
                self._check_term(term, of_estimator=network is not self)
        return self

    def _check_term(self, term: ObservationTerm, *, of_estimator: bool) -> None:
        name = term.term
        if name in PHASE_TERMS and self.phase is None:
            raise ValueError(f"observation holds {name}: say how it runs under 'phase'")
        if name == "heights" and self.heights is None:
            raise ValueError("observation holds heights: say where they are under 'heights'")
        if name == "estimate" and (self.estimator is None or of_estimator):
            raise ValueError("observation holds estimate: describe the network that gives it under 'estimator'")
        size = self.size_of(term)
        for what in ("offset", "scale"):
            if (given := len(getattr(term, what))) not in (1, size):
                raise ValueError(f"observation: {what} of {name} has {given} numbers, expected 1 or {size}")

    def size_of(self, term: ObservationTerm) -> int:
        """Numbers that a term has at one tick."""
        if term.term == "estimate":
            return 0 if self.estimator is None else self.estimator.outputs
        if term.term == "heights":
            return 0 if self.heights is None else len(self.heights.x) * len(self.heights.y)
        if term.term in PHASE_TERMS:
            return 0 if self.phase is None else len(self.phase.start)
        return len(term.values) or TERM_SIZES[term.term]

    @property
    def frame_size(self) -> int:
        """Numbers that the policy is shown of one tick."""
        return sum(self.size_of(term) for term in self.observation)

    @property
    def legs(self) -> tuple[str, ...]:
        """Legs in the order of the network."""
        return self.leg_order or tuple(dict.fromkeys(name.partition("_")[0] for name in self.joint_order))

    def per_joint(self, name: str) -> NDArray[np.float64]:
        """(12,) a setting that may differ from joint to joint, in the order of the network."""
        given: float | Sequence[float] | Mapping[str, float] = getattr(self, name)
        if isinstance(given, Mapping):
            return np.array([given[joint.partition("_")[2]] for joint in self.joint_order])
        return np.broadcast_to(np.asarray(given, dtype=float), len(self.joint_order)).copy()


def load_policy_settings(path: Path) -> PolicySettings:
    """Read a policy's description.

    Raises:
        SettingsError: no such file, or a key is unknown, missing or out of range.
    """
    values = read_yaml(path)
    if not isinstance(values, dict) or not {"onnx", "torchscript"} & values.keys():
        raise SettingsError(
            f"{path}: expected a policy's description that names a network under onnx or torchscript; any other "
            "network is run by a Python class of yours, black_box=module:Class (docs/motion.md)"
        )
    return build(PolicySettings, _beside(path, values), source=str(path))


def _beside(path: Path, values: Mapping[str, Any]) -> dict[str, Any]:
    """The values with files of networks taken from the description's folder."""
    out = dict(values)
    for name in ("onnx", "torchscript"):
        if out.get(name) is not None:
            out[name] = path.parent / str(out[name])
    if isinstance(out.get("estimator"), Mapping):
        out["estimator"] = _beside(path, out["estimator"])
    return out
