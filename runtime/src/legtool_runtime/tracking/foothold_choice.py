"""Footholds chosen on the way: nominal ones that keep the balance, safe ones near them, and what follows of both."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime.errors import MapError, StateError, TrackingError
from legtool_runtime.foothold.gait import Gait
from legtool_runtime.foothold.heightmap import extract_heightmap
from legtool_runtime.foothold.selection import FootholdSelector
from legtool_runtime.foothold.settings import RESOLUTION_M, SIZE, leg_length
from legtool_runtime.foothold.tuples import Tuple
from legtool_runtime.robot import Robot
from legtool_runtime.rotations import place as place_in
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.gaits import GaitTiming
from legtool_runtime.tracking.ground import ground_of, height_at
from legtool_runtime.tracking.pendulum import Planar, about_line, feedback, frequency

Array = NDArray[np.float64]

#: Phases of the swing at which a foothold is chosen again.
AGAIN = (0.2, 0.4, 0.6)
#: A foot bends in mid-swing only to a place on the same level, and not for less than this [m].
_LEVEL_M, _LEAST_M = 0.03, 0.015
#: Distances to the side count so much more; what is farther to the side is refused in a crawl: its triangle collapses.
SIDEWAYS, MOST_SIDEWAYS_M = 2.5, 0.08
#: Legs for which lengths below are written; feet that land so far behind their nominal footholds slow the trunk down,
#: and stop it, or where there is ground halve its velocity; heights by which legs step up or down in a cycle, and how
#: far around a place its ground is looked for [m].
_LEG_M, _BEHIND_M, _SLOWEST, _FOLLOWED_M, _AROUND_M = 0.68, (0.12, 0.20), 0.5, 0.35, 0.08
#: Share of a stance's way that a foot of a trot lands ahead of its rest: it pushes a little longer than it brakes.
_AHEAD = 0.45
#: Metres of foothold for a metre that the divergent component is off at touchdown, in a crawl.
_CRAWL_FEEDBACK = 0.7


class Trunk(NamedTuple):
    """The trunk as measured and planned: ``com`` (3,) centre of mass [m], ``velocity`` (3,) [m/s], ``yaw`` [rad]; for
    the pose planned at touchdown ``height`` of its origin [m], ``roll``, ``pitch`` [rad]. World frame."""

    com: Array
    velocity: Array
    yaw: float
    height: float
    roll: float = 0.0
    pitch: float = 0.0


class Wish(NamedTuple):
    """What a selector is asked for.

    ``leg``; ``nominal`` (2,) place wanted, world frame [m]; ``yaw`` at touchdown [rad]; ``hip`` (3,) of the leg at
    touchdown, world frame [m]; ``twist`` (6,) in the horizontal frame [m/s, rad/s]; ``gait``; ``most_sideways_m``;
    ``roll``, ``pitch`` of the trunk at touchdown [rad].
    """

    leg: int
    nominal: Array
    yaw: float
    hip: Array
    twist: tuple[float, ...]
    gait: Gait
    most_sideways_m: float
    roll: float = 0.0
    pitch: float = 0.0


class Place(NamedTuple):
    """A contact point (3,) and the ground's normal (3,) there, world frame [m]."""

    point: Array
    normal: Array


Selector = Callable[[Wish], Place | None]


@dataclass(frozen=True, eq=False)
class Choice:
    """A foothold that was chosen.

    Attributes:
        place: where the foot goes.
        nominal: (2,) where it would go on even ground, world frame [m].
        by: ``safe``: chosen for the command; ``in_place``: chosen for standing still; ``back``: none is safe, the foot
            goes back to where it stood.
    """

    place: Place
    nominal: Array
    by: str


def trot_nominal(
    robot: Robot,
    leg: int,
    trunk: Trunk,
    *,
    diagonal: ArrayLike,
    command: Sequence[float],
    timing: GaitTiming,
    left_s: float,
    com_offset: ArrayLike = (0.0, 0.0, 0.0),
) -> tuple[Array, Planar, float]:
    """The foothold that keeps a trot's balance.

    Args:
        robot: geometry.
        leg: that swings.
        trunk: now.
        diagonal: (2, 3) the two feet that stand meanwhile, world frame [m].
        command: (3,) forward, left [m/s], yaw rate [rad/s], heading's frame.
        timing: of the gait.
        left_s: until touchdown.
        com_offset: (3,) centre of mass, base frame [m].

    Returns:
        p = c' + stance offset + 0.45 T_stance v_cmd + k (v' - v_cmd) (2,) [m], where c', v' are the trunk's at
        touchdown as an inverted pendulum about the line between the standing feet, k = 1 / (ω tanh(ω T_swing));
        the trunk then, and its yaw.
    """
    feet = np.asarray(diagonal, dtype=np.float64)
    omega = frequency(float(trunk.com[2] - feet[:, 2].mean()))
    wanted = _turned(command[:2], trunk.yaw + 0.5 * float(command[2]) * left_s)
    then = about_line(
        Planar(trunk.com[:2], trunk.velocity[:2]), feet[0, :2], feet[1, :2], omega=omega, wanted=wanted, time_s=left_s
    )
    yaw = trunk.yaw + float(command[2]) * left_s
    offset = _turned((robot.stance[leg] - np.asarray(com_offset))[:2], yaw)
    hip = wanted + float(command[2]) * np.array([-offset[1], offset[0]])
    nominal = then.position + offset + _AHEAD * timing.stance_s * hip
    return nominal + feedback(omega, timing.swing_s) * (then.velocity - wanted), then, yaw


def crawl_nominal(
    robot: Robot,
    leg: int,
    *,
    implied: Sequence[float],
    command: Sequence[float],
    timing: GaitTiming,
    left_s: float,
    divergence: ArrayLike = (0.0, 0.0),
    com_offset: ArrayLike = (0.0, 0.0, 0.0),
) -> tuple[Array, Array, float]:
    """The foothold that keeps a crawl's balance: it answers the divergent component's error at touchdown.

    Args:
        robot: geometry.
        leg: that swings.
        implied: (3,) x, y [m], yaw [rad] of the trunk that the feet imply: their mean.
        command: (3,) forward, left [m/s], yaw rate [rad/s], heading's frame.
        timing: of the gait.
        left_s: until touchdown.
        divergence: (2,) ξ at touchdown as the preview has it, less the reference's, world frame [m].
        com_offset: (3,) centre of mass, base frame [m].

    Returns:
        the foothold (2,), the trunk's place (2,) at touchdown, and its yaw.
    """
    yaw = float(implied[2]) + float(command[2]) * left_s
    velocity = _turned(command[:2], float(implied[2]) + 0.5 * float(command[2]) * left_s)
    trunk = np.asarray(implied[:2], dtype=np.float64) + velocity * left_s
    offset = _turned((robot.stance[leg] - np.asarray(com_offset))[:2], yaw)
    hip = velocity + float(command[2]) * np.array([-offset[1], offset[0]])
    nominal = trunk + offset + 0.5 * timing.stance_s * hip + _CRAWL_FEEDBACK * np.asarray(divergence, np.float64)
    return nominal, trunk, yaw


class FootholdChooser:
    """Chooses footholds at lift-off and again in mid-swing, without hysteresis: that would stop the feedback.

    Attributes:
        robot: geometry.
        timing: of the gait; may be replaced at any time.
        select: finds the safe place nearest to a nominal one; may be replaced at any time.
        elevation: the ground as it is known, to look ahead by; None: nothing is known of it.
        crawls: whether far steps to the side are refused.
        held: whether the last foot to lift found no safe place.
    """

    def __init__(
        self,
        robot: Robot,
        timing: GaitTiming,
        select: Selector,
        *,
        com_offset: ArrayLike = (0.0, 0.0, 0.0),
        crawls: bool | None = None,
    ) -> None:
        """Take the robot, its gait and what finds the safe place nearest to a nominal one.

        Args:
            robot: geometry.
            timing: of the gait; may be replaced at any time (:attr:`timing`).
            select: such as :func:`safe_places` or :func:`any_place`.
            com_offset: (3,) centre of mass, base frame [m].
            crawls: whether far steps to the side are refused; None: where one leg swings at a time.
        """
        self.robot, self.timing, self.select = robot, timing, select
        self.elevation: HeightMap | None = None
        self.com_offset = np.array(com_offset, dtype=np.float64)
        self._size = leg_length(robot) / _LEG_M
        self.crawls = all(len(group) == 1 for group in timing.groups) if crawls is None else crawls
        self.held = False
        #: Of each leg's foothold, and of the one a cycle later: off its nominal place, world frame [m], and whether
        #: there is ground at that place.
        self._moved, self._grounded = np.zeros((2, 4, 2)), np.ones((2, 4), np.bool_)
        self._asked = np.zeros(4, np.int64)

    def lift_off(
        self,
        leg: int,
        trunk: Trunk,
        *,
        stood: Place,
        command: Sequence[float],
        asked: Sequence[float] | None = None,
        **others: object,
    ) -> Choice:
        """The foothold of a swing that begins.

        Args:
            leg: that lifts off.
            trunk: measured and planned.
            stood: where the leg stood.
            command: (3,) forward, left [m/s], yaw rate [rad/s], heading's frame.
            asked: what is commanded when the trunk is slowed down to ``command`` (:meth:`pace`), to look ahead by;
                None: the same.
            others: ``diagonal`` as of :func:`trot_nominal`, or ``implied`` and ``divergence`` as of
                :func:`crawl_nominal`.

        Raises:
            TrackingError: a trunk or command that is not finite.
        """
        _refuse(trunk, command)
        self._asked[leg] = 0
        wish = self._wish(leg, trunk, command, self.timing.swing_s, others)
        place, by = self.select(wish), "safe"
        if place is None:
            still = self._wish(leg, trunk, (0.0, 0.0, 0.0), self.timing.swing_s, others)
            place, by = self.select(still), "in_place"
        self.held = place is None
        if place is None:
            place, by = stood, "back"
        self._moved[0, leg] = place.point[:2] - wish.nominal
        self._grounded[0, leg] = self._rise(wish.nominal, place) is not None
        self._moved[1, leg], self._grounded[1, leg] = self._later(wish, place, command if asked is None else asked)
        return Choice(place, wish.nominal, by)

    def again(
        self, leg: int, trunk: Trunk, *, phase: float, aimed: Place, command: Sequence[float], **others: object
    ) -> Choice | None:
        """A better foothold in mid-swing; None: go on as aimed. To be asked at every tick: it answers at its phases.

        Args:
            leg: that swings.
            trunk: measured and planned.
            phase: of the swing.
            aimed: where the foot goes now.
            command: as of :meth:`lift_off`.
            others: as of :meth:`lift_off`.
        """
        if not self.due(leg, phase):
            return None
        self._asked[leg] = _times(phase)
        if not _finite(trunk, command):
            return None
        wish = self._wish(leg, trunk, command, (1.0 - phase) * self.timing.swing_s, others)
        place = self.select(wish)
        if place is None or abs(place.point[2] - aimed.point[2]) > _LEVEL_M:
            return None
        if float(np.hypot(*(place.point - aimed.point)[:2])) <= _LEAST_M:
            return None
        self._moved[0, leg] = place.point[:2] - wish.nominal
        return Choice(place, wish.nominal, "safe")

    def due(self, leg: int, phase: float) -> bool:
        """Whether a foothold is to be chosen again at a phase of its swing."""
        return bool(_times(phase) > self._asked[leg])

    def pace(self, command: Sequence[float], yaw: float) -> float:
        """Share of a command's velocity at which the trunk follows its footholds: less than 1 where these stay behind.

        Where the ground ends they stay behind, ever farther: the trunk slows down and stops, before it is out over
        them. Where there is ground, but none of it safe now, a trot slows down to a half, so that it comes to where
        there is; a crawl does not, for its trunk is where its feet are.

        Args:
            command: as of :meth:`lift_off`.
            yaw: of the heading [rad].
        """
        if self.held:
            return 0.0
        speed = math.hypot(float(command[0]), float(command[1]))
        if speed < 1e-6:
            return 1.0
        behind = -(self._moved @ (_turned(command[:2], yaw) / speed)) / self._size
        share = np.clip((_BEHIND_M[1] - behind) / (_BEHIND_M[1] - _BEHIND_M[0]), 0.0, 1.0)
        slowest = 1.0 if self.crawls else _SLOWEST
        return float(np.where(self._grounded, np.maximum(share, slowest), share).min())

    def _later(self, wish: Wish, place: Place, command: Sequence[float]) -> tuple[Array, bool]:
        """How far (2,) the foothold a cycle after one is off its nominal place [m]; and whether there is ground."""
        turn = float(command[2]) * self.timing.cycle_s
        way = _turned(command[:2], wish.yaw + 0.5 * turn) * self.timing.cycle_s
        nominal = wish.nominal + way
        rise = self._rise(nominal, place)
        # The trunk follows the ground; not into a pit.
        hip = wish.hip + np.array([way[0], way[1], rise or 0.0])
        found = self.select(wish._replace(nominal=nominal, yaw=wish.yaw + turn, hip=hip))
        if found is not None:
            return np.asarray(found.point[:2] - nominal, dtype=np.float64), rise is not None
        # Off the map of the criteria, against the way.
        return -way / max(float(np.hypot(*way)), 1e-9) * (0.5 * SIZE * RESOLUTION_M), rise is not None

    def _rise(self, nominal: Array, place: Place) -> float | None:
        """How much the highest ground around (2,) a place is above a foothold [m]; None: no leg steps so far."""
        reach = _AROUND_M * self._size
        around = [(x, y) for x in (-reach, 0.0, reach) for y in (-reach, 0.0, reach)]
        ground = ground_of(self.elevation)
        heights = [height_at(ground, float(nominal[0]) + x, float(nominal[1]) + y) for x, y in around]
        known = [height for height in heights if math.isfinite(height)]
        rise = max(known) - float(place.point[2]) if known else 0.0
        return rise if abs(rise) < _FOLLOWED_M * self._size else None

    def _wish(self, leg: int, trunk: Trunk, command: Sequence[float], left_s: float, others: dict[str, object]) -> Wish:
        given = {"timing": self.timing, "left_s": left_s, "com_offset": self.com_offset, "command": command, **others}
        if "implied" in others:
            nominal, place, yaw = crawl_nominal(self.robot, leg, **given)  # type: ignore[arg-type]
        else:
            nominal, then, yaw = trot_nominal(self.robot, leg, trunk, **given)  # type: ignore[arg-type]
            place = then.position
        com = place_in(self.com_offset, trunk.roll, trunk.pitch, yaw, (0.0, 0.0, 0.0))
        base = (float(place[0] - com[0]), float(place[1] - com[1]), trunk.height)
        hip = place_in(self.robot.hips[leg], trunk.roll, trunk.pitch, yaw, base)
        speed = math.hypot(float(command[0]), float(command[1]))
        cycle = self.timing.cycle_s
        gait = Gait(min(speed * cycle, 2.0), 1.0 / cycle, self.timing.stance_s / cycle, max(left_s, 0.0))
        twist = (float(command[0]), float(command[1]), 0.0, 0.0, 0.0, float(command[2]))
        most_sideways_m = MOST_SIDEWAYS_M if self.crawls else math.inf
        return Wish(leg, nominal, yaw, hip, twist, gait, most_sideways_m, trunk.roll, trunk.pitch)


def any_place(elevation: HeightMap | None) -> Selector:
    """A selector that takes every nominal place, at the map's height (0 where unknown, or without a map)."""

    def select(wish: Wish) -> Place | None:
        return place_at(elevation, float(wish.nominal[0]), float(wish.nominal[1]))

    return select


def place_at(elevation: HeightMap | None, x: float, y: float) -> Place:
    """The ground at a place [m]: at height 0 and level where it is not known."""
    height = height_at(ground_of(elevation), x, y)
    return Place(np.array([x, y, height if math.isfinite(height) else 0.0]), ground_normal(elevation, x, y))


def safe_places(selector: FootholdSelector, elevation: HeightMap) -> Selector:
    """A selector by the foothold criteria (ViTAL): the safe cell nearest to the nominal one, the way aside weighted.

    Legs are judged below the trunk as it is planned at touchdown, roll and pitch included.
    """

    def select(wish: Wish) -> Place | None:
        below = _turned(wish.nominal - wish.hip[:2], -wish.yaw)
        try:
            heights = extract_heightmap(elevation, wish.nominal, yaw=wish.yaw, resample=True, outside=True)
            judged = Tuple(
                heights, leg=wish.leg, hip_height=float(wish.hip[2]), base_twist=wish.twist, gait=wish.gait,
                nominal=(float(below[0]), float(below[1])), roll=wish.roll, pitch=wish.pitch,
            )  # fmt: skip
            found = selector.select(judged, sideways=SIDEWAYS, most_sideways_m=wish.most_sideways_m)
        except (MapError, StateError):  # a robot that stumbles may ask for anything: there is no safe place then
            return None
        if found.cell is None:
            return None
        ix, iy = found.cell
        way = ((ix - SIZE // 2) * RESOLUTION_M, (iy - SIZE // 2) * RESOLUTION_M)
        x, y = (float(value) for value in wish.nominal + _turned(way, wish.yaw))
        return Place(np.array([x, y, float(heights[ix, iy])]), ground_normal(elevation, x, y))

    return select


def ground_normal(elevation: HeightMap | None, x: float, y: float) -> Array:
    """(3,) normal of the plane through the map's cells around a place; straight up beside edges and unknown cells."""
    up = np.array([0.0, 0.0, 1.0])
    if elevation is None:
        return up
    cell = elevation.resolution_m
    i, j = (np.floor((np.array([x, y]) - elevation.lower_corner) / cell)).astype(int)
    if not (1 <= i < elevation.heights.shape[0] - 1 and 1 <= j < elevation.heights.shape[1] - 1):
        return up
    z = elevation.heights[i - 1 : i + 2, j - 1 : j + 2].astype(np.float64)
    slope_x, slope_y = (z[2] - z[0]).mean() / (2 * cell), (z[:, 2] - z[:, 0]).mean() / (2 * cell)
    i3 = np.arange(-1, 2) * cell
    off = z - z.mean() - slope_x * i3[:, None] - slope_y * i3[None, :]
    if not np.isfinite(off).all() or np.abs(off).max() > 0.01 or math.hypot(slope_x, slope_y) > 1.0:
        return up
    normal = np.array([-slope_x, -slope_y, 1.0])
    return normal / float(np.linalg.norm(normal))


def _times(phase: float) -> int:
    """How often a foothold is to have been chosen again by a phase."""
    return sum(phase >= begin for begin in AGAIN)


def _turned(way: ArrayLike, yaw: float) -> Array:
    x, y = (float(value) for value in np.asarray(way, dtype=np.float64))
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([c * x - s * y, s * x + c * y])


def _finite(trunk: Trunk, command: Sequence[float]) -> bool:
    numbers = np.array([*trunk.com, *trunk.velocity, *trunk[2:], *command], dtype=np.float64)
    return bool(np.isfinite(numbers).all())


def _refuse(trunk: Trunk, command: Sequence[float]) -> None:
    if len(command) != 3 or not _finite(trunk, command):
        raise TrackingError(f"foothold choice: trunk {trunk}, command {tuple(command)}; expected finite numbers")
