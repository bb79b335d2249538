"""What whole-body control must know of a robot: geometry, masses, inertias, friction and limits of its joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.errors import RobotError
from legtool_runtime.robot import JOINTS, LEGS, Robot
from legtool_runtime.tracking.dynamics import FullState, Model, Terms, dynamics_terms, make_terms

Array = NDArray[np.float64]

_SHAPES = {
    "trunk_com": (3,),
    "trunk_inertia": (3, 3),
    "link_mass": (4, 3),
    "link_com": (4, 3, 3),
    "link_inertia": (4, 3, 3, 3),
    "armature": (4, 3),
    "joint_friction": (4, 3),
    "joint_damping": (4, 3),
    "torque_limit": (4, 3),
}
_NOT_NEGATIVE = ("link_mass", "armature", "joint_friction", "joint_damping")


@dataclass(frozen=True, eq=False)
class TrackedRobot:
    """A robot as whole-body control knows it. Joint limits are those of ``geometry``.

    Attributes:
        geometry: kinematics, joint limits and the stance at rest.
        trunk_mass: without legs [kg].
        trunk_com: (3,) base frame [m].
        trunk_inertia: (3, 3) about its centre of mass, base frame [kg m²].
        link_mass: (4, 3) hip, thigh and shank with foot [kg].
        link_com: (4, 3, 3) from the link's joint, link axes (base axes when all joints are 0) [m].
        link_inertia: (4, 3, 3, 3) about the centre of mass, link axes [kg m²].
        armature: (4, 3) rotor inertia at the joint [kg m²].
        joint_friction: (4, 3) dry friction [Nm].
        joint_damping: (4, 3) [Nm s/rad].
        torque_limit: (4, 3) [Nm].
    """

    geometry: Robot
    trunk_mass: float
    trunk_com: Array
    trunk_inertia: Array
    link_mass: Array
    link_com: Array
    link_inertia: Array
    armature: Array
    joint_friction: Array
    joint_damping: Array
    torque_limit: Array

    def __post_init__(self) -> None:
        name = self.geometry.name
        for field, shape in _SHAPES.items():
            value = np.array(getattr(self, field), dtype=np.float64, order="C")
            if value.shape != shape:
                raise RobotError(f"robot {name!r}: {field} has shape {value.shape}, expected {shape}")
            if field == "torque_limit":
                _check_torque_limits(name, value)
            if not np.isfinite(value).all():
                raise RobotError(f"robot {name!r}: {field} holds a value that is not finite")
            if field in _NOT_NEGATIVE and (value < 0).any():
                raise RobotError(f"robot {name!r}: {field} holds a negative value")
            value.setflags(write=False)
            object.__setattr__(self, field, value)
        object.__setattr__(self, "trunk_mass", float(self.trunk_mass))
        if not (np.isfinite(self.trunk_mass) and self.trunk_mass > 0):
            raise RobotError(f"robot {name!r}: trunk_mass is {self.trunk_mass} kg, expected a positive mass")
        for field in ("trunk_inertia", "link_inertia"):
            inertia = getattr(self, field)
            turned = np.swapaxes(inertia, -1, -2)
            if np.abs(inertia - turned).max() > 1e-9 or np.linalg.eigvalsh(inertia).min() < -1e-9:
                raise RobotError(f"robot {name!r}: {field} must be symmetric and not negative")
        if not np.linalg.eigvalsh(self.trunk_inertia).min() > 0:
            raise RobotError(f"robot {name!r}: trunk_inertia must be positive about every axis")

    @property
    def mass(self) -> float:
        """Of the whole robot [kg]."""
        return float(self.trunk_mass + self.link_mass.sum())

    @property
    def com(self) -> Array:
        """(3,) centre of mass of the whole robot standing at rest, base frame [m]."""
        return self._at_rest.com.copy()

    @property
    def inertia(self) -> Array:
        """(3, 3) of the whole robot standing at rest, about its centre of mass, base frame [kg m²]."""
        about_base, com = self._at_rest.mass[3:6, 3:6], self._at_rest.com
        inertia: Array = about_base - self.mass * (com @ com * np.eye(3) - np.outer(com, com))
        return inertia

    @cached_property
    def _at_rest(self) -> Terms:
        angles, _ = self.geometry.joints(self.geometry.stance)
        terms = make_terms()
        state = FullState(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), angles, np.zeros(18))
        dynamics_terms(self.model(), state, np.tile([0.0, 0.0, 1.0], (4, 1)), terms)
        return terms

    def model(self) -> Model:
        """The robot as the compiled kernels take it."""
        geometry = self.geometry
        chain = np.stack([geometry.abduction_offset, geometry.thigh_length, geometry.shank_length], axis=1)
        return Model(
            hips=geometry.hips.copy(),
            chain=chain,
            foot_radius=float(geometry.foot_radius),
            mass=self.mass,
            trunk_mass=self.trunk_mass,
            trunk_com=self.trunk_com.copy(),
            trunk_inertia=self.trunk_inertia.copy(),
            link_mass=self.link_mass.copy(),
            link_com=self.link_com.copy(),
            link_inertia=self.link_inertia.copy(),
            armature=self.armature.copy(),
        )

    def to_dict(self) -> dict[str, Any]:
        """The description as plain JSON types; :meth:`from_dict` reads it back."""
        out: dict[str, Any] = {"geometry": self.geometry.to_dict(), "trunk_mass": self.trunk_mass}
        for field in _SHAPES:
            out[field] = getattr(self, field).tolist()
        return out

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> TrackedRobot:
        """Build from plain types.

        Raises:
            RobotError: a field is missing, unknown, of the wrong shape or out of bounds.
        """
        expected = [field.name for field in fields(cls)]
        missing = [name for name in expected if name not in data]
        unknown = sorted(set(data) - set(expected))
        if missing or unknown:
            raise RobotError(
                f"tracked robot: missing {missing or 'nothing'}, unknown {unknown or 'nothing'}; "
                f"expected {', '.join(expected)}"
            )
        try:
            return cls(**{**data, "geometry": Robot.from_dict(data["geometry"])})
        except (TypeError, ValueError) as error:
            raise RobotError(f"tracked robot: {error}") from error


def _check_torque_limits(name: str, limits: Array) -> None:
    bad = ~(np.isfinite(limits) & (limits > 0))
    if bad.any():
        leg, joint = np.argwhere(bad)[0]
        raise RobotError(
            f"robot {name!r}: the torque limit of {LEGS[leg]} {JOINTS[joint]} is {limits[leg, joint]} Nm, expected a "
            "positive torque; whole-body control needs every joint's limit"
        )
