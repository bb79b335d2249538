"""The foothold evaluation criteria of ViTAL (section II): which cells of a heightmap one leg can safely step on.

A cell is safe if its surroundings are smooth enough (terrain roughness, TR), and if over the whole gait cycle to it,
from lift-off through swing, touchdown and stance to the next lift-off, the leg stays clear of the terrain (leg
collision, LC) and within its workspace and joint limits (kinematic feasibility, KF), and the swing path clear of the
terrain (foot trajectory collision, FC); and if all cells within an uncertainty radius are so too (Remark 1).

The tuple T = (H, z_h, v_b, α) is read so: H is a heightmap in the *horizontal frame* at touchdown (levelled, x forward,
y left), z_h the hip's height then, in the same vertical frame as the heights. Before and after, the hip moves with the
base twist, the leg turns with the yaw rate, and the trunk is level, for T has no attitude. The lift-off point lies one
step length behind the nominal foothold, against the hip's motion, on the nearest smooth cell from which the leg can
lift off: the foot stands where these criteria let it. Where there is none, nothing is safe. Unknown cells
are unsafe, and so is the border of the map; legs and feet passing over unknown cells must clear the highest known
ground beside them; off the map nothing is checked. LC means little where KF fails: there the leg is bent towards the
foothold as far as lengths allow.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.errors import MapError, RobotError, StateError
from legtool_runtime.foothold.criteria import coarse, dilation, judge
from legtool_runtime.foothold.criteria.gait_cycle import Cycle
from legtool_runtime.foothold.criteria.judge import FC, KF, LC, MARGIN, TR, UNKNOWN
from legtool_runtime.foothold.criteria.leg import chain
from legtool_runtime.foothold.gait import Gait, hip_velocity, nominal_foothold
from legtool_runtime.foothold.settings import RESOLUTION_M, SIZE, CriteriaSettings
from legtool_runtime.robot import LEGS, Robot

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Flags = NDArray[np.uint8]

_SAYS = {
    UNKNOWN: "its height is unknown",
    TR: "the terrain around it is too rough (TR)",
    LC: "the leg would collide with the terrain (LC)",
    KF: "the leg cannot reach it throughout the gait cycle (KF)",
    FC: "the swing foot would collide with the terrain (FC)",
    MARGIN: "an unsafe cell lies within the uncertainty radius",
}
#: Sub-cells a side of the tables for foot and leg.
_FINE_FOOT, _FINE_LEG = 3, 2
#: Instants of the cycle that are looked at, and those at a glance, at one hip height and over many: see
#: :class:`.verdict.Rules`. Networks are trained on what the glances see.
_INSTANTS, GLANCE, GLANCE_COUNTS = (24, 18, 5), (8, 6, 3), (3, 4, 2)


@dataclass(frozen=True, eq=False)
class Footholds:
    """The criteria's verdict on every cell.

    Attributes:
        reasons: (33, 33) why a cell is unsafe, as the sum of TR, LC, KF, FC, UNKNOWN and MARGIN; 0: it is safe.
    """

    reasons: Flags

    @property
    def safe(self) -> NDArray[np.bool_]:
        """(33, 33) μ_safe, equation 2, after the erosion of Remark 1."""
        return self.reasons == 0

    @property
    def count(self) -> int:
        """Number of safe footholds n_sf (equation 5)."""
        return int(self.safe.sum())

    def mask(self, criterion: int) -> NDArray[np.bool_]:
        """(33, 33) where a criterion (TR, LC, KF or FC) alone is fulfilled; never at an unknown cell."""
        return (self.reasons & (criterion | UNKNOWN)) == 0

    def explain(self, ix: int, iy: int) -> str:
        """Why cell (ix, iy) is unsafe, in words."""
        bits = int(self.reasons[ix, iy])
        return "; ".join(text for bit, text in _SAYS.items() if bits & bit) or "it is safe"


class Criteria:
    """The criteria for the legs of one robot. Not changed by use, so that threads can share it."""

    def __init__(self, robot: Robot, settings: CriteriaSettings | None = None) -> None:
        """Take the robot's geometry; settings default to those that fit the length of its legs."""
        self.robot = robot
        self.settings = settings or CriteriaSettings.for_robot(robot)
        s = self.settings
        thin = (*dilation.ball(robot.foot_radius, RESOLUTION_M, _FINE_FOOT), _FINE_FOOT)
        thick = (*dilation.ball(s.leg_radius_m, RESOLUTION_M, _FINE_LEG), _FINE_LEG)
        around = dilation.disc(s.uncertainty_m, RESOLUTION_M)
        self._reach = int(around.max())
        self._rules = [
            judge.Rules(
                chain(robot, leg), robot.foot_radius, _points(robot, leg, s), thin, thick,
                (s.slope_mean, s.slope_deviation), s.contact_phase, around, _INSTANTS, False,
            )
            for leg in range(4)
        ]  # fmt: skip
        self._few = [rules._replace(instants=GLANCE, glance=True) for rules in self._rules]
        box = dilation.disc(1.5 * RESOLUTION_M, RESOLUTION_M)
        self._fewest = [
            rules._replace(
                # Of the shank every other point; the thigh hardly ever touches first.
                points=np.ascontiguousarray(rules.points[rules.points[:, 0] > 0.5][::2]),
                around=np.unique(np.concatenate([around, box]), axis=0),
                instants=GLANCE_COUNTS,
            )
            for rules in self._rules
        ]

    def evaluate(
        self,
        heights: ArrayLike,
        *,
        leg: int,
        hip_height: float,
        base_twist: Sequence[float],
        gait: Gait,
        nominal: Sequence[float] | None = None,
        resolution_m: float = RESOLUTION_M,
    ) -> Footholds:
        """Judge every cell of a heightmap (equation 2).

        Args:
            heights: (33, 33) H [m], indexed [ix, iy], x forward and y left in the horizontal frame; NaN where unknown.
            leg: index into FL, FR, RL, RR.
            hip_height: z_h of the abduction axis at touchdown [m], in the vertical frame of the heights.
            base_twist: (6,) v_b, linear then angular velocity, horizontal frame [m/s, rad/s].
            gait: α.
            nominal: (2,) the map's centre from below the hip at touchdown [m], where the map lies around a nominal
                foothold (VFA); None: it lies below the hip (VPA).
            resolution_m: side of the map's cells; anything but 0.02 m is refused.

        Raises:
            MapError: the map has another size or resolution, or an infinite height.
            StateError: a twist, nominal foothold or hip height that cannot be, such as a hip below the ground.
        """
        h = _heights(heights, resolution_m)
        cycle = self._cycle(leg, base_twist, gait, nominal)
        return Footholds(self._judge(h, leg, cycle, hip_height, (0, SIZE, 0, SIZE)))

    def is_safe(
        self,
        cell: tuple[int, int],
        heights: ArrayLike,
        *,
        leg: int,
        hip_height: float,
        base_twist: Sequence[float],
        gait: Gait,
        nominal: Sequence[float] | None = None,
        resolution_m: float = RESOLUTION_M,
    ) -> bool:
        """Whether one cell is safe, as :meth:`evaluate` would say, in a fraction of its time.

        Args:
            cell: ix, iy.
            heights: as in :meth:`evaluate`, as all that follow.
            leg: as there.
            hip_height: as there.
            base_twist: as there.
            gait: as there.
            nominal: as there.
            resolution_m: as there.
        """
        h = _heights(heights, resolution_m)
        cycle = self._cycle(leg, base_twist, gait, nominal)
        reach = self._reach
        (ix, iy), last = cell, SIZE - 1
        if not (reach <= ix <= last - reach and reach <= iy <= last - reach):
            return False
        box = (ix - reach, ix + reach + 1, iy - reach, iy + reach + 1)
        return bool(self._judge(h, leg, cycle, hip_height, box)[ix, iy] == 0)

    def counts(
        self,
        heights: ArrayLike,
        *,
        leg: int,
        hip_heights: ArrayLike,
        base_twist: Sequence[float],
        gait: Gait,
        nominal: Sequence[float] | None = None,
        resolution_m: float = RESOLUTION_M,
    ) -> NDArray[np.int64]:
        """Numbers of safe footholds n_sf over hip heights (equation 9); what no hip height changes is computed once.

        Args:
            heights: as in :meth:`evaluate`.
            leg: as there.
            hip_heights: (n,) [m], in the vertical frame of the heights; below the ground there is no safe foothold.
            base_twist: as there.
            gait: as there.
            nominal: as there.
            resolution_m: as there.

        Raises:
            MapError: as there.
            StateError: as there, but for the hip heights.
        """
        h, cycle, hips = self._over(heights, leg, hip_heights, base_twist, gait, nominal, resolution_m)
        out, safe = np.zeros(len(hips), np.int64), np.empty((SIZE, SIZE), np.uint8)
        judge.count(h, self._rules[leg], cycle, hips, out, safe)
        return out

    def glance(
        self,
        heights: ArrayLike,
        *,
        leg: int,
        hip_height: float,
        base_twist: Sequence[float],
        gait: Gait,
        nominal: Sequence[float] | None = None,
        resolution_m: float = RESOLUTION_M,
    ) -> NDArray[np.bool_]:
        """(33, 33) cells that seem safe at a glance: the criteria at a third of the instants that they are judged at.

        It takes half the time of :meth:`evaluate`, and sees some cells as safe that are not: what the leg runs into
        between the instants. For a hip below the ground, or where the leg can lift off from nowhere, there are none.

        Args:
            heights: as in :meth:`evaluate`.
            leg: as there.
            hip_height: as there.
            base_twist: as there.
            gait: as there.
            nominal: as there.
            resolution_m: as there.
        """
        h, cycle, hips = self._over(heights, leg, [hip_height], base_twist, gait, nominal, resolution_m)
        out, safe = np.zeros(1, np.int64), np.empty((SIZE, SIZE), np.uint8)
        judge.count(h, self._few[leg], cycle, hips, out, safe)
        return safe.view(np.bool_)

    def glance_counts(
        self,
        heights: ArrayLike,
        *,
        leg: int,
        hip_heights: ArrayLike,
        base_twist: Sequence[float],
        gait: Gait,
        nominal: Sequence[float] | None = None,
        resolution_m: float = RESOLUTION_M,
    ) -> NDArray[np.float32]:
        """About how many footholds are safe over hip heights, at a glance: (2, n), after the erosion, and before it.

        Every other cell and, away from where footholds become safe or unsafe, every other hip height is judged, at a
        fifth of the instants and by the shank alone; before the erosion the judged cells are counted. It takes a tenth
        of the time of :meth:`counts`.

        Args:
            heights: as in :meth:`evaluate`.
            leg: as there.
            hip_heights: as in :meth:`counts`, ascending.
            base_twist: as there.
            gait: as there.
            nominal: as there.
            resolution_m: as there.
        """
        h, cycle, hips = self._over(heights, leg, hip_heights, base_twist, gait, nominal, resolution_m)
        out = np.empty((2, len(hips)), np.float32)
        coarse.count(h, self._fewest[leg], cycle, hips, out)
        return out

    def lift_off(
        self,
        heights: ArrayLike,
        *,
        leg: int,
        hip_height: float,
        base_twist: Sequence[float],
        gait: Gait,
        nominal: Sequence[float] | None = None,
        resolution_m: float = RESOLUTION_M,
    ) -> Array:
        """Where the foot's centre is at lift-off, as :meth:`evaluate` takes it: (3,) x, y from the map's centre, z [m].

        Args:
            heights: as in :meth:`evaluate`.
            leg: as there.
            hip_height: as there.
            base_twist: as there.
            gait: as there.
            nominal: as there.
            resolution_m: as there.
        """
        h = _heights(heights, resolution_m)
        cycle = self._cycle(leg, base_twist, gait, nominal)
        out = np.zeros(3)
        judge.lift_off(h, self._rules[leg], cycle, float(hip_height), out)
        return out

    def refuse_other(self, robot: Robot, what: object) -> None:
        """Raise a :class:`.errors.RobotError` if ``what``, such as a network, was made for another robot."""
        if robot.to_dict() != self.robot.to_dict():
            raise RobotError(
                f"{what}: made for {robot.name}, the criteria are for {self.robot.name} or for legs of other lengths; "
                "take the robot of the bundle: Criteria(bundle.robot)"
            )

    def warm_up(self) -> None:
        """Compile all kernels, or load them from the user's cache."""
        flat, twist, gait = np.zeros((SIZE, SIZE), np.float32), (0.1, 0, 0, 0, 0, 0), Gait()
        self.evaluate(flat, leg=0, hip_height=0.5, base_twist=twist, gait=gait)
        self.counts(flat, leg=0, hip_heights=[0.5], base_twist=twist, gait=gait)
        self.glance(flat, leg=0, hip_height=0.5, base_twist=twist, gait=gait)
        self.glance_counts(flat, leg=0, hip_heights=[0.5], base_twist=twist, gait=gait)
        self.lift_off(flat, leg=0, hip_height=0.5, base_twist=twist, gait=gait)

    def _over(
        self,
        heights: ArrayLike,
        leg: int,
        hip_heights: ArrayLike,
        base_twist: Sequence[float],
        gait: Gait,
        nominal: Sequence[float] | None,
        resolution_m: float,
    ) -> tuple[Array32, Cycle, Array]:
        """The map, the gait cycle, and the hip heights (n,), checked."""
        h = _heights(heights, resolution_m)
        cycle = self._cycle(leg, base_twist, gait, nominal)
        hips = np.array(hip_heights, dtype=np.float64).reshape(-1)
        if not np.isfinite(hips).all():
            raise StateError("hip heights: one is not finite")
        return h, cycle, hips

    def _judge(self, h: Array32, leg: int, cycle: Cycle, hip_height: float, box: tuple[int, int, int, int]) -> Flags:
        ground = h[_cell(cycle.hip_x), _cell(cycle.hip_y)]
        if not math.isfinite(hip_height) or hip_height <= ground:
            raise StateError(
                f"hip height {hip_height:.3f} m: expected above the ground below the hip, at {ground:.3f} m; "
                "heights and hip must be given in one vertical frame"
            )
        reasons = np.empty((SIZE, SIZE), np.uint8)
        judge.evaluate(h, self._rules[leg], cycle, float(hip_height), box, reasons)
        return reasons

    def _cycle(self, leg: int, base_twist: Sequence[float], gait: Gait, nominal: Sequence[float] | None) -> Cycle:
        if leg not in range(4):
            raise StateError(f"leg is {leg!r}, expected 0 to 3 for {', '.join(LEGS)}")
        v = hip_velocity(self.robot, leg, base_twist)
        if nominal is None:
            hip_x, hip_y = 0.0, 0.0
            nominal_x, nominal_y = nominal_foothold(self.robot, leg, v, gait)
        else:
            hip_x, hip_y = -float(nominal[0]), -float(nominal[1])
            nominal_x, nominal_y = 0.0, 0.0
            if not math.hypot(hip_x, hip_y) < 2.0:
                raise StateError(f"nominal foothold {tuple(nominal)} m from the hip: expected finite, within 2 m")
        speed = math.hypot(v[0], v[1])
        back = gait.step_length_m / speed if speed > 1e-3 else 0.0
        return Cycle(
            hip_x, hip_y, v[0], v[1], v[2], float(base_twist[5]),
            nominal_x - back * v[0], nominal_y - back * v[1], nominal_x, nominal_y,
            gait.swing_s, gait.stance_s, gait.swing_phase, self.settings.swing_height_m,
        )  # fmt: skip


def _heights(heights: ArrayLike, resolution_m: float) -> Array32:
    h = np.asarray(heights)
    if h.shape != (SIZE, SIZE) or abs(resolution_m - RESOLUTION_M) > 1e-6:
        raise MapError(
            f"heightmap of shape {h.shape} at {resolution_m:g} m: expected ({SIZE}, {SIZE}) at {RESOLUTION_M} m; "
            "cut one with extract_heightmap, which resamples if asked to"
        )
    if h.dtype.kind not in "fiu":
        raise MapError(f"heightmap of {h.dtype}: expected numbers [m], NaN where unknown")
    h = np.ascontiguousarray(h, dtype=np.float32)
    if np.isinf(h).any():
        raise MapError("heightmap: a height is infinite; mark unknown cells by NaN")
    return h


def _cell(x: float) -> int:
    return min(max(round(x / RESOLUTION_M) + SIZE // 2, 0), SIZE - 1)


def _points(robot: Robot, leg: int, s: CriteriaSettings) -> Array32:
    """Points along the leg at which its clearance is looked up: (p, 3) link, share, 1 where thick."""
    shank, thigh = float(robot.shank_length[leg]), float(robot.thigh_length[leg])
    if s.ankle_m >= shank:
        raise RobotError(f"criteria: ankle_m {s.ankle_m} m is beyond the shank of {shank} m")
    step = 1.15 * s.leg_radius_m
    thin = math.ceil(s.ankle_m / (1.75 * robot.foot_radius))
    out = [(1, 1 - s.ankle_m * k / thin / shank, 0) for k in range(1, thin)]
    thick = math.ceil((shank - s.ankle_m) / step)
    out += [(1, (1 - k / thick) * (1 - s.ankle_m / shank), 1) for k in range(thick + 1)]
    upper = math.ceil(thigh / step)
    out += [(0, k / upper, 1) for k in range(upper)]
    return np.array(out, np.float32)
