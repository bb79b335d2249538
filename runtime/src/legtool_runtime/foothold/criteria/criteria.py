"""The foothold evaluation criteria of ViTAL (section II): which cells of a heightmap one leg can safely step on.

A cell is safe if its surroundings are smooth enough (terrain roughness, TR), and if over the whole gait cycle to it,
from lift-off through swing, touchdown and stance to the next lift-off, the leg stays clear of the terrain (leg
collision, LC) and within its workspace and joint limits (kinematic feasibility, KF), and the swing path clear of the
terrain (foot trajectory collision, FC); and if all cells within an uncertainty radius are so too (Remark 1).

The tuple T = (H, z_h, v_b, α) is read so: H is a heightmap in the *horizontal frame* at touchdown (levelled, x forward,
y left), z_h the hip's height then, in the same vertical frame as the heights. Before and after, the hip moves with the
base twist and the leg turns with the yaw rate, while the trunk keeps the tuple's roll and pitch, which turn the leg
about its hip: Rz(yaw rate · τ) Ry(pitch) Rx(roll). (The paper's T has no attitude. A trunk pitched by 20° uses up as
much of the thigh's range.) The lift-off point lies one step length behind the nominal foothold, against the hip's
motion, on the nearest smooth cell from which the leg can lift off: the foot stands where these criteria let it. Where
there is none, nothing is safe. Unknown cells are unsafe, and so is the border of the map; legs and feet passing over
unknown cells must clear the highest known ground beside them; off the map nothing is checked. LC means little where KF
fails: there the leg is bent towards the foothold as far as lengths allow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime import checks
from legtool_runtime.errors import RobotError, StateError
from legtool_runtime.foothold.criteria import coarse, judge
from legtool_runtime.foothold.criteria.gait_cycle import Cycle, cycle_of
from legtool_runtime.foothold.criteria.judge import FC, KF, LC, MARGIN, TR, UNKNOWN
from legtool_runtime.foothold.criteria.rules import coarse_count_rules, coarse_rules, exact_rules
from legtool_runtime.foothold.gait import Gait
from legtool_runtime.foothold.settings import SIZE, CriteriaSettings
from legtool_runtime.foothold.tuples import Tuple
from legtool_runtime.robot import Robot

Array = NDArray[np.float64]
Flags = NDArray[np.uint8]

_SAYS = {
    UNKNOWN: "its height is unknown",
    TR: "the terrain around it is too rough (TR)",
    LC: "the leg would collide with the terrain (LC)",
    KF: "the leg cannot reach it throughout the gait cycle (KF)",
    FC: "the swing foot would collide with the terrain (FC)",
    MARGIN: "an unsafe cell lies within the uncertainty radius",
}


@dataclass(frozen=True, eq=False)
class Footholds:
    """What the criteria say of every cell.

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
        """Take the robot's geometry; settings default to those that fit the length of its legs.

        Raises:
            StateError: no robot, or no settings.
        """
        checks.instance("robot", robot, Robot, StateError)
        if settings is not None:
            checks.instance("settings", settings, CriteriaSettings, StateError)
        self.robot = robot
        self.settings = settings or CriteriaSettings.for_robot(robot)
        self._rules = [exact_rules(robot, leg, self.settings) for leg in range(4)]
        self._reach = int(self._rules[0].around.max())
        self._coarse_rules = [[coarse_rules(rules, tilted=tilted) for rules in self._rules] for tilted in (False, True)]
        self._coarse_count_rules = [coarse_count_rules(rules) for rules in self._rules]

    def evaluate(self, t: Tuple) -> Footholds:
        """Judge every cell of the heightmap (equation 2).

        Raises:
            StateError: the tuple has no hip height, or one below the ground.
        """
        return Footholds(self._judge(t, (0, SIZE, 0, SIZE)))

    def is_safe(self, t: Tuple, cell: tuple[int, int]) -> bool:
        """Whether the cell ix, iy is safe, as :meth:`evaluate` would say, in a fraction of its time.

        Raises:
            StateError: as :meth:`evaluate`.
        """
        (ix, iy), reach, last = cell, self._reach, SIZE - 1
        if not (reach <= ix <= last - reach and reach <= iy <= last - reach):
            return False
        return bool(self._judge(t, (ix - reach, ix + reach + 1, iy - reach, iy + reach + 1))[ix, iy] == 0)

    def counts(self, t: Tuple, hip_heights: ArrayLike) -> NDArray[np.int64]:
        """Numbers of safe footholds n_sf over hip heights (equation 9); what no hip height changes is computed once.

        Args:
            t: the tuple; its own hip height is not looked at.
            hip_heights: (n,) [m], in the vertical frame of the heights; below the ground there is no safe foothold.

        Raises:
            StateError: a hip height that is not finite.
        """
        hips = _finite(hip_heights)
        out, safe = np.zeros(len(hips), np.int64), np.empty((SIZE, SIZE), np.uint8)
        judge.count(t.heights, self._rules[t.leg], self._cycle(t), hips, out, safe)
        return out

    def coarse(self, t: Tuple) -> NDArray[np.bool_]:
        """(33, 33) cells that seem safe: a coarse check, at a third of the instants that cells are judged at.

        Below a tilted trunk, whose joints are nearer to their limits, it is two thirds of those of the leg's swing.

        It takes half the time of :meth:`evaluate`, and sees some cells as safe that are not: what the leg runs into
        between the instants. For a hip below the ground, or where the leg can lift off from nowhere, there are none.

        Raises:
            StateError: the tuple has no hip height.
        """
        out, safe = np.zeros(1, np.int64), np.empty((SIZE, SIZE), np.uint8)
        hips = np.array([_hip_height(t)])
        rules = self._coarse_rules[t.tilted][t.leg]
        judge.count(t.heights, rules, self._cycle(t), hips, out, safe)
        return safe.view(np.bool_)

    def coarse_counts(self, t: Tuple, hip_heights: ArrayLike) -> NDArray[np.float32]:
        """About how many footholds are safe over hip heights: (2, n), after the erosion, and before it.

        Every other cell and, away from where footholds become safe or unsafe, every other hip height is judged, at a
        fifth of the instants and by the shank alone; before the erosion the judged cells are counted. It takes a tenth
        of the time of :meth:`counts`.

        Args:
            t: as there.
            hip_heights: as there, ascending.

        Raises:
            StateError: as there.
        """
        hips = _finite(hip_heights)
        out = np.empty((2, len(hips)), np.float32)
        coarse.count(t.heights, self._coarse_count_rules[t.leg], self._cycle(t), hips, out)
        return out

    def lift_off(self, t: Tuple) -> Array:
        """Where the foot's centre is at lift-off, as :meth:`evaluate` takes it: (3,) x, y from the map's centre, z [m].

        Raises:
            StateError: the tuple has no hip height.
        """
        out = np.zeros(3)
        judge.lift_off(t.heights, self._rules[t.leg], self._cycle(t), _hip_height(t), out)
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
        flat, twist = np.zeros((SIZE, SIZE), np.float32), (0.1, 0.0, 0.0, 0.0, 0.0, 0.0)
        t = Tuple(flat, leg=0, hip_height=0.5, base_twist=twist, gait=Gait())
        self.evaluate(t)
        self.counts(t, [0.5])
        self.coarse(t)
        self.coarse_counts(t, [0.5])
        self.lift_off(t)

    def _judge(self, t: Tuple, box: tuple[int, int, int, int]) -> Flags:
        hip_height, ground = _hip_height(t), t.ground
        if hip_height <= ground:
            raise StateError(
                f"hip height {hip_height:.3f} m: expected above the ground below the hip, at {ground:.3f} m; "
                "heights and hip must be given in one vertical frame"
            )
        reasons = np.empty((SIZE, SIZE), np.uint8)
        judge.evaluate(t.heights, self._rules[t.leg], self._cycle(t), hip_height, box, reasons)
        return reasons

    def _cycle(self, t: Tuple) -> Cycle:
        return cycle_of(self.robot, t, self.settings.swing_height_m)


def _hip_height(t: Tuple) -> float:
    if t.hip_height is None:
        raise StateError("the tuple has no hip height: give it one, or count footholds over hip heights")
    return t.hip_height


def _finite(hip_heights: ArrayLike) -> Array:
    hips = np.array(hip_heights, dtype=np.float64).reshape(-1)
    if not np.isfinite(hips).all():
        raise StateError("hip heights: one is not finite")
    return hips
