"""Robot geometry and leg kinematics: the one description that training and robot share.

Legs are ordered ``FL, FR, RL, RR`` and joints ``hip (abduction), thigh, knee`` everywhere. A leg is a chain
``Rx(hip) · [0, abduction_offset, 0] · Ry(thigh) · [0, 0, -thigh_length] · Ry(knee) · [0, 0, -shank_length]``
from its hip's abduction axis to the centre of its foot sphere.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.checks import Bounds, array, finite, within
from legtool_runtime.errors import RobotError, shown

LEGS = ("FL", "FR", "RL", "RR")
JOINTS = ("hip", "thigh", "knee")
#: The two diagonal pairs of a trot as leg indices; a swing pair is named by its index here.
TROT_PAIRS = ((0, 3), (1, 2))
TROT_PAIR_NAMES = ("FL+RR", "FR+RL")
#: Left-right mirrored leg order.
MIRROR = (1, 0, 3, 2)

Array = NDArray[np.float64]

#: Robots that walk lie well within: from the size of a hand to that of a truck.
_SHORTEST_M, _LONGEST_M, _FARTHEST_M, _WIDEST_RAD = 0.005, 5.0, 10.0, 4.0 * np.pi
_FOOT_RADIUS = Bounds(1e-4, 0.5, "m")
_NAME = re.compile(r"[\w][\w .+()-]{0,63}")
_SHAPES = {
    "hips": (4, 3),
    "abduction_offset": (4,),
    "thigh_length": (4,),
    "shank_length": (4,),
    "knee_sign": (4,),
    "joint_limits": (4, 3, 2),
    "stance": (4, 3),
}


@kernel
def leg_forward(hip: Array, abduction_offset: float, thigh: float, shank: float, angles: Array, foot: Array) -> None:
    """Write the foot's position into ``foot``: (3,) base frame [m], for joint ``angles`` (3,) [rad]."""
    x = -thigh * np.sin(angles[1]) - shank * np.sin(angles[1] + angles[2])
    z = -thigh * np.cos(angles[1]) - shank * np.cos(angles[1] + angles[2])
    c, s = np.cos(angles[0]), np.sin(angles[0])
    foot[0] = hip[0] + x
    foot[1] = hip[1] + c * abduction_offset - s * z
    foot[2] = hip[2] + s * abduction_offset + c * z


@kernel
def leg_jacobian(abduction_offset: float, thigh: float, shank: float, angles: Array, jacobian: Array) -> None:
    """Write the foot's Jacobian ∂p/∂q into ``jacobian``: (3, 3), rows x, y, z in the base frame [m/rad]."""
    s1, c1 = np.sin(angles[1]), np.cos(angles[1])
    s12, c12 = np.sin(angles[1] + angles[2]), np.cos(angles[1] + angles[2])
    c, s = np.cos(angles[0]), np.sin(angles[0])
    z = -thigh * c1 - shank * c12
    dx1, dx2 = -thigh * c1 - shank * c12, -shank * c12
    dz1, dz2 = thigh * s1 + shank * s12, shank * s12
    jacobian[0, 0], jacobian[0, 1], jacobian[0, 2] = 0.0, dx1, dx2
    jacobian[1, 0], jacobian[1, 1], jacobian[1, 2] = -s * abduction_offset - c * z, -s * dz1, -s * dz2
    jacobian[2, 0], jacobian[2, 1], jacobian[2, 2] = c * abduction_offset - s * z, c * dz1, c * dz2


@kernel
def leg_inverse(
    hip: Array,
    abduction_offset: float,
    thigh: float,
    shank: float,
    knee_sign: float,
    foot: Array,
    angles: Array,
) -> bool:
    """Write the joint angles [rad] that put the foot at ``foot`` (3,) base frame [m]; the nearest ones if none do.

    Returns whether the position is within reach (joint limits apart).
    """
    x, y, z = foot[0] - hip[0], foot[1] - hip[1], foot[2] - hip[2]
    lateral = y * y + z * z - abduction_offset * abduction_offset
    reachable = lateral >= 0.0
    height = np.sqrt(max(lateral, 0.0))
    angles[0] = np.arctan2(y * height + z * abduction_offset, y * abduction_offset - z * height)
    length2 = x * x + height * height
    cosine = (length2 - thigh * thigh - shank * shank) / (2.0 * thigh * shank)
    if cosine > 1.0 or cosine < -1.0:
        reachable = False
        cosine = min(1.0, max(-1.0, cosine))
    knee = knee_sign * np.arccos(cosine)
    angles[2] = knee
    angles[1] = np.arctan2(-x, height) - np.arctan2(shank * np.sin(knee), thigh + shank * np.cos(knee))
    return reachable


@kernel
def _feet_forward(hips: Array, offset: Array, thigh: Array, shank: Array, q: Array, feet: Array) -> None:
    for n in range(q.shape[0]):
        for leg in range(4):
            leg_forward(hips[leg], offset[leg], thigh[leg], shank[leg], q[n, leg], feet[n, leg])


@kernel
def _feet_inverse(
    hips: Array,
    offset: Array,
    thigh: Array,
    shank: Array,
    knee_sign: Array,
    feet: Array,
    q: Array,
    ok: NDArray,
) -> None:
    for n in range(feet.shape[0]):
        for leg in range(4):
            ok[n, leg] = leg_inverse(
                hips[leg], offset[leg], thigh[leg], shank[leg], knee_sign[leg], feet[n, leg], q[n, leg]
            )


@dataclass(frozen=True, eq=False)
class Robot:
    """The geometry of a four-legged robot.

    Attributes:
        name: the robot's name; a bundle made for one robot is refused for another.
        hips: (4, 3) origin of each abduction axis, base frame [m].
        abduction_offset: (4,) signed lateral distance from abduction axis to thigh axis, + to the left [m].
        thigh_length: (4,) [m].
        shank_length: (4,) knee to the centre of the foot sphere [m].
        knee_sign: (4,) sign of the knee angle: -1 knee behind the hip-foot line, +1 in front of it.
        joint_limits: (4, 3, 2) lower and upper limit of each joint [rad].
        foot_radius: [m].
        stance: (4, 3) feet when standing at rest, base frame [m].
    """

    name: str
    hips: Array
    abduction_offset: Array
    thigh_length: Array
    shank_length: Array
    knee_sign: Array
    joint_limits: Array
    foot_radius: float
    stance: Array

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not _NAME.fullmatch(self.name):
            raise RobotError(
                f"robot {shown(self.name)}: expected a name of 1 to 64 letters, digits, and _ . + - or spaces"
            )
        for name, shape in _SHAPES.items():
            advice = "; where a joint has no limit, give -3.1416 and 3.1416" if name == "joint_limits" else ""
            value = finite(f"robot {self.name!r}: {name}", getattr(self, name), shape, RobotError, advice=advice)
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        for name in ("thigh_length", "shank_length"):
            value = getattr(self, name)
            if not ((value >= _SHORTEST_M) & (value <= _LONGEST_M)).all():
                raise RobotError(
                    f"robot {self.name!r}: {name} is {value.tolist()} m, expected {_SHORTEST_M} to {_LONGEST_M:g} m; "
                    "lengths are in metres"
                )
        for name in ("hips", "abduction_offset", "stance"):
            if np.abs(getattr(self, name)).max() > _FARTHEST_M:
                raise RobotError(f"robot {self.name!r}: {name} reaches beyond {_FARTHEST_M:g} m; lengths are in metres")
        if np.abs(self.joint_limits).max() > _WIDEST_RAD:
            raise RobotError(
                f"robot {self.name!r}: joint_limits go beyond ±{_WIDEST_RAD:.2f} rad; angles are in radians"
            )
        if not (self.stance[:, 2] < 0).all():
            raise RobotError(f"robot {self.name!r}: stance has feet above the base; z points up in the base frame")
        if not (np.abs(self.knee_sign) == 1).all():
            raise RobotError(f"robot {self.name!r}: knee_sign must be -1 or +1 for each leg")
        if not (self.joint_limits[..., 0] < self.joint_limits[..., 1]).all():
            raise RobotError(f"robot {self.name!r}: each joint's lower limit must be below its upper limit")
        within(f"robot {self.name!r}", self, {"foot_radius": _FOOT_RADIUS}, RobotError)

    @property
    def standing_height(self) -> float:
        """Height of the base above the ground when standing at rest [m]."""
        return float(self.foot_radius - self.stance[:, 2].mean())

    def feet(self, joint_positions: ArrayLike) -> Array:
        """Forward kinematics.

        Args:
            joint_positions: (..., 4, 3) or (..., 12) [rad].

        Returns:
            (..., 4, 3) foot centres relative to the base, base frame [m].

        Raises:
            RobotError: another shape, or no numbers.
        """
        q = array("joint_positions", joint_positions, RobotError)  # always writable: one kind, one compiled kernel
        flat = q.shape[-1:] == (12,)
        if not flat and q.shape[-2:] != (4, 3):
            raise RobotError(f"joint_positions has shape {q.shape}, expected (..., 4, 3) or (..., 12)")
        lead = q.shape[:-1] if flat else q.shape[:-2]
        q = q.reshape(-1, 4, 3)
        out = np.empty_like(q)
        _feet_forward(self.hips, self.abduction_offset, self.thigh_length, self.shank_length, q, out)
        return out.reshape(*lead, 4, 3)

    def joints(self, feet_base: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        """Inverse kinematics.

        Args:
            feet_base: (..., 4, 3) foot centres, base frame [m].

        Returns:
            (..., 4, 3) joint angles [rad], and (..., 4) whether each foot is within reach (joint limits apart).

        Raises:
            RobotError: another shape, or no numbers.
        """
        feet = array("feet_base", feet_base, RobotError)
        if feet.shape[-2:] != (4, 3):
            raise RobotError(f"feet_base has shape {feet.shape}, expected (..., 4, 3)")
        lead = feet.shape[:-2]
        feet = feet.reshape(-1, 4, 3)
        q = np.empty_like(feet)
        ok = np.empty(feet.shape[:2], dtype=np.bool_)
        _feet_inverse(
            self.hips,
            self.abduction_offset,
            self.thigh_length,
            self.shank_length,
            self.knee_sign,
            feet,
            q,
            ok,
        )
        return q.reshape(*lead, 4, 3), ok.reshape(*lead, 4)

    def to_dict(self) -> dict[str, Any]:
        """The description as plain JSON types; :meth:`from_dict` reads it back."""
        out: dict[str, Any] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            out[field.name] = value.tolist() if isinstance(value, np.ndarray) else value
        return out

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Robot:
        """Build from plain types.

        Raises:
            RobotError: a field is missing, unknown, of the wrong shape or out of bounds.
        """
        expected = [field.name for field in fields(cls)]
        missing = [name for name in expected if name not in data]
        unknown = sorted(set(data) - set(expected))
        if missing or unknown:
            raise RobotError(
                f"robot description: missing {missing or 'nothing'}, unknown {unknown or 'nothing'}; "
                f"expected {', '.join(expected)}"
            )
        try:
            return cls(**data)
        except (TypeError, ValueError) as error:
            raise RobotError(f"robot description: {shown(error)}") from error
