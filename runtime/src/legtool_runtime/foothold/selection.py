"""Foothold selection, VFA (ViTAL, section III): the safe foothold nearest to the nominal one."""

from __future__ import annotations

import math
import numbers
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from legtool_runtime import checks
from legtool_runtime.errors import StateError, shown
from legtool_runtime.foothold import heightmap
from legtool_runtime.foothold.criteria.criteria import Criteria
from legtool_runtime.foothold.gait import Gait, checked_twist, hip_velocity, nominal_foothold
from legtool_runtime.foothold.heightmap import extract_heightmap, nearest_safe
from legtool_runtime.foothold.settings import RESOLUTION_M, SIZE
from legtool_runtime.foothold.tuples import Tuple
from legtool_runtime.robot import LEGS, Robot
from legtool_runtime.rotations import place
from legtool_runtime.terrain.elevation import HeightMap

Array = NDArray[np.float64]
Method = Literal["exact", "cnn", "verified"]
METHODS: tuple[Method, ...] = ("exact", "cnn", "verified")


class Proposer(Protocol):
    """A network that proposes a foothold, for the legs of its robot."""

    robot: Robot

    def propose(self, t: Tuple) -> tuple[int, int] | None:
        """The cell ix, iy to step on; None: no cell is safe."""


@dataclass(frozen=True)
class Selection:
    """A chosen foothold.

    Attributes:
        cell: ix, iy in the heightmap; None: no cell is safe, or the network saw none.
        by: who answered: ``exact`` or ``cnn``.
        verified: whether the cell was found safe by the exact criteria.
    """

    cell: tuple[int, int] | None
    by: Literal["exact", "cnn"]
    verified: bool

    def __str__(self) -> str:
        if self.cell is None:
            return "no safe foothold" + ("" if self.verified else " seen by the network")
        return f"foothold at cell {self.cell}" + (", safe" if self.verified else ", not verified")


@dataclass(frozen=True, eq=False)
class Foothold:
    """A foothold in the world.

    Attributes:
        selection: how it was chosen.
        nominal: (2,) nominal foothold p_n, world frame [m].
        position: (3,) the foot's centre on the chosen cell p*, world frame [m]; None where there is none.
        heights: (33, 33) the heightmap around p_n, world heights [m].
        hip_height: of the leg's hip at touchdown, world frame [m].
    """

    selection: Selection
    nominal: Array
    position: Array | None
    heights: NDArray[np.float32]
    hip_height: float


class FootholdSelector:
    """Selects footholds for one robot."""

    def __init__(self, criteria: Criteria, *, method: Method = "exact", network: Proposer | None = None) -> None:
        """Take the exact criteria, and the network for the methods that use one.

        ``exact`` searches with the criteria alone; ``cnn`` takes what the network proposes; ``verified`` checks the
        proposal exactly and searches exactly where it fails, so that it never returns an unsafe cell, and none only
        where none is safe.

        Raises:
            StateError: no such method, or no network for it.
            RobotError: the network is for another robot.
        """
        if method not in METHODS:
            raise StateError(f"foothold selection {method!r}: expected one of {', '.join(METHODS)}")
        if method != "exact" and network is None:
            raise StateError(f"foothold selection {method!r} needs a network; load a bundle with a foothold line")
        if network is not None:
            criteria.refuse_other(network.robot, network)
        self.criteria, self.method, self.network = criteria, method, network

    def warm_up(self) -> None:
        """Compile all kernels, or load them from the user's cache."""
        heightmap.warm_up()
        self.criteria.warm_up()

    def select(self, t: Tuple, *, sideways: float = 1.0, most_sideways_m: float = math.inf) -> Selection:
        """Select a cell of a heightmap around the nominal foothold (equations 3 and 4).

        Args:
            t: the tuple, with a hip height.
            sideways: factor of distances along y in the exact search.
            most_sideways_m: cells farther along y are refused by the exact search, and by the check of a proposal.

        Raises:
            StateError: the tuple has no hip height, or one below the ground.
        """
        if self.network is not None and self.method != "exact":
            cell = self.network.propose(t)
            if self.method == "cnn":
                return Selection(cell, "cnn", verified=False)
            inside = cell is not None and abs(cell[1] - SIZE // 2) * RESOLUTION_M <= most_sideways_m
            if cell is not None and inside and self.criteria.is_safe(t, cell):
                return Selection(cell, "cnn", verified=True)
        safe = self.criteria.evaluate(t).safe
        direction = hip_velocity(self.criteria.robot, t.leg, t.base_twist, roll=t.roll, pitch=t.pitch)
        cell = nearest_safe(safe, direction, sideways=sideways, most_sideways_m=most_sideways_m)
        return Selection(cell, "exact", verified=True)

    def select_in(
        self,
        elevation: HeightMap,
        *,
        leg: int,
        base_position: Sequence[float],
        attitude: Sequence[float],
        base_twist: Sequence[float],
        gait: Gait,
    ) -> Foothold:
        """Select a foothold in the world: nominal foothold, heightmap extraction, evaluation.

        Args:
            elevation: the map.
            leg: index into FL, FR, RL, RR.
            base_position: (3,) of the trunk's origin, world frame [m].
            attitude: (3,) roll, pitch, yaw of the trunk [rad]: roll and pitch as planned for touchdown, for the legs
                are judged below a trunk that keeps them.
            base_twist: (6,) horizontal frame [m/s, rad/s].
            gait: α.

        Raises:
            MapError: the nominal foothold lies outside of the map, or the map has another resolution.
            StateError: the rest cannot be used, such as a hip below the ground.
        """
        robot = self.criteria.robot
        checks.instance("select: elevation", elevation, HeightMap, StateError)
        checks.instance("select: gait", gait, Gait, StateError)
        if isinstance(leg, bool) or not isinstance(leg, numbers.Integral) or not 0 <= leg < len(LEGS):
            raise StateError(f"select: leg is {shown(leg)}, expected an index into {', '.join(LEGS)}")
        leg = int(leg)
        base_position = checks.finite("select: base_position", base_position, (3,), StateError)
        roll, pitch, yaw = checks.finite("select: attitude", attitude, (3,), StateError).tolist()
        twist = checked_twist(base_twist)
        velocity = hip_velocity(robot, leg, twist, roll=roll, pitch=pitch)
        ahead = min(gait.time_to_touchdown_s, gait.swing_s + gait.stance_s)
        turned = yaw + twist[5] * ahead
        hip = place(robot.hips[leg], roll, pitch, yaw, base_position)
        c, s = math.cos(yaw), math.sin(yaw)
        x = float(hip[0]) + (c * velocity[0] - s * velocity[1]) * ahead
        y = float(hip[1]) + (s * velocity[0] + c * velocity[1]) * ahead
        hip_height = float(hip[2]) + velocity[2] * ahead
        nominal = nominal_foothold(robot, leg, velocity, gait)
        c, s = math.cos(turned), math.sin(turned)
        center = np.array([x + c * nominal[0] - s * nominal[1], y + s * nominal[0] + c * nominal[1]])
        heights = extract_heightmap(elevation, center, yaw=turned)
        judged = Tuple(
            heights,
            leg=leg,
            hip_height=hip_height,
            base_twist=twist,
            gait=gait,
            nominal=nominal,
            roll=roll,
            pitch=pitch,
        )
        selection = self.select(judged)
        position = None
        if selection.cell is not None:
            ix, iy = selection.cell
            dx, dy = (ix - SIZE // 2) * RESOLUTION_M, (iy - SIZE // 2) * RESOLUTION_M
            ground = float(heights[ix, iy])
            position = np.array([center[0] + c * dx - s * dy, center[1] + s * dx + c * dy, ground + robot.foot_radius])
        return Foothold(selection, center, position, heights, hip_height)
