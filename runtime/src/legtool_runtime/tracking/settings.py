"""Settings of tracking; they are read without numba."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.errors import TrackingError

#: ``planned``: up early, across while high, down onto the foothold at a speed. ``judged``: what the foothold criteria
#: judge (:class:`legtool_runtime.foothold.swing.Swing`), at rest at both ends.
Profile = Literal["planned", "judged"]
Held = Literal["trunk", "mass"]

#: Height of the centre of mass over the feet that the weights of the preview are for [m].
_SIZE_M = 0.50


@dataclass(frozen=True)
class TrackerSettings:
    """How plans are tracked; lengths are for ANYmal C's size and scaled to the robot's.

    Attributes:
        friction: of the ground, to be counted on. Pyramids allow √2 times as much along their diagonals.
        replan_s: between previews, where no foot lifts or lands.
        swing_height_m: of a swing's apex above the higher of its ends.
        search_speed: at which feet come down, and go on down when late [m/s].
        search_depth_m: how far a late foot goes on down.
        force_noise: standard deviation of the measured forces on the feet, as a share of the weight; touchdowns are
            told by what stands out of it.
        crawls: weights of the preview for gaits that swing one leg at a time; None: by the plan.
        swing_profile: path of the feet: ``planned`` comes down slowly, for places that are known to a millimetre;
            ``judged`` is the one that the foothold criteria judge.
        aim_below_m: so far below the ground swings end, for grounds that are known less well.
        held: what is kept at the planned height: the ``trunk``, or the ``mass``, the centre of mass of the whole robot,
            which swinging legs lift off the trunk, so that the trunk sags, and legs reach farther.
        reassign_m: a body whose c + v/ω is off its reference by more lets feet in the air land elsewhere, where other
            footholds are known; None: feet go where they are to.
    """

    friction: float = 0.45
    replan_s: float = 0.02
    swing_height_m: float = 0.08
    search_speed: float = 0.15
    search_depth_m: float = 0.06
    force_noise: float = 0.0
    crawls: bool | None = None
    swing_profile: Profile = "planned"
    aim_below_m: float = 0.0
    held: Held = "trunk"
    reassign_m: float | None = 0.12

    def __post_init__(self) -> None:
        limits = (
            ("friction", 0.1, 1.5), ("replan_s", 0.0025, 0.2), ("swing_height_m", 0.01, 0.5),
            ("search_speed", 0.0, 2.0), ("search_depth_m", 0.0, 0.5),
            ("force_noise", 0.0, 0.05), ("aim_below_m", 0.0, 0.05),
        )  # fmt: skip
        for name, low, high in limits:
            if not low <= getattr(self, name) <= high:
                raise TrackingError(f"tracker: {name} is {getattr(self, name)}, expected {low:g} to {high:g}")
        if self.reassign_m is not None and not 0.0 < self.reassign_m <= 1.0:
            raise TrackingError(f"tracker: reassign_m is {self.reassign_m}, expected more than 0 to 1, or none")
        if self.swing_profile not in get_args(Profile):
            raise TrackingError(f"tracker: swing_profile is {self.swing_profile!r}, expected planned or judged")
        if self.held not in get_args(Held):
            raise TrackingError(f"tracker: held is {self.held!r}, expected trunk or mass")


@dataclass(frozen=True)
class PreviewSettings:
    """What is wanted, for a centre of mass at 0.5 m; :meth:`weights` scale with size and so with time.

    Attributes:
        nodes: of the horizon.
        node_s: duration of each; nodes are cut at lift-offs and touchdowns, and the horizon is as much shorter.
        place: weights of the centre of mass, x, y, z [1/m²].
        velocity: of its velocity [s²/m²].
        tilt: of the rotation vector off the reference [1/rad²].
        turning: of the angular velocity [s²/rad²].
        final: factor of the weights of x and y at the horizon's end.
        effort: of forces off the nominal ones, as shares of the weight.
        friction: of the pyramids about the contact normals; keep some below the ground's.
        least: normal force of a foot as share of the weight, with three or four feet on the ground and with fewer: the
            margin of the centre of pressure.
        most: largest normal force of a foot as share of the weight.
    """

    nodes: int = 20
    node_s: float = 0.05
    place: tuple[float, float, float] = (10.0, 10.0, 200.0)
    velocity: tuple[float, float, float] = (4.0, 4.0, 10.0)
    tilt: float = 200.0
    turning: float = 4.0
    final: float = 5.0
    effort: float = 0.02
    friction: float = 0.54
    least: tuple[float, float] = (0.10, 0.15)
    most: float = 2.0

    def __post_init__(self) -> None:
        numbers = (*self.place, *self.velocity, self.tilt, self.turning, self.final)
        if not (2 <= self.nodes <= 100 and 0.005 <= self.node_s <= 0.2):
            raise TrackingError(f"preview: {self.nodes} nodes of {self.node_s} s, expected 2 to 100 of 0.005 to 0.2 s")
        if not all(math.isfinite(value) and value >= 0.0 for value in numbers) or not 0.0 < self.effort < 1e6:
            raise TrackingError("preview: weights must be finite, none negative, and effort more than 0")
        if not (0.05 <= self.friction <= 2.0 and all(0.0 <= v < 0.25 for v in self.least) and self.most >= 0.5):
            raise TrackingError(
                f"preview: friction {self.friction}, least {self.least}, most {self.most}; expected 0.05 to 2, "
                "shares of 0 to below 0.25, and 0.5 or more"
            )

    @classmethod
    def level(cls) -> PreviewSettings:
        """For trunks that are held at their height: a body that is off its way is neither thrown up, for the friction
        that this gains, nor dropped, for the time."""
        return cls(place=(10.0, 10.0, 1000.0), velocity=(4.0, 4.0, 50.0))

    @classmethod
    def crawl(cls) -> PreviewSettings:
        """For gaits that shift the centre of mass into triangles: its place counts more."""
        return cls(place=(80.0, 80.0, 200.0), velocity=(8.0, 8.0, 10.0))

    def weights(self, height: float) -> NDArray[np.float64]:
        """(2, 12) of the states on the way and at the end, for a centre of mass ``height`` over the feet [m]."""
        size = height / _SIZE_M
        row = np.array([*self.place, *self.velocity, *[self.tilt] * 3, *[self.turning] * 3])
        row[:3] /= size * size
        row[3:6] /= size  # velocities grow with √size, times too
        row[9:] *= size
        # The cost is the sum of squares, not half of it.
        rows = 2.0 * np.array([row, row])
        rows[1, [0, 1, 3, 4]] *= self.final
        return rows
