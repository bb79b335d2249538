"""Courses for walks by script: where feet go, step by step, and the ground that is laid under them.

Lengths are for ANYmal C and scaled to a robot's legs, so that one course asks the same of all.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from legtool.configs.climbs import CLIMBS
from legtool.configs.families import ARENA, member
from legtool.configs.robots import load_robot
from legtool.configs.settings import Settings
from legtool.configs.world_parts import Beam, Profile, Ramp, Stone, Stretch
from legtool.configs.worlds import WorldSettings, load_world
from legtool.errors import SettingsError
from legtool_runtime.robot import TROT_PAIRS, Robot

Array = NDArray[np.float64]
Rng = np.random.Generator

#: The straight leg of ANYmal C, for which lengths are written [m].
LEG_M = 0.6125
#: Floor behind the start, and beyond the end [m].
_RUN_IN_M = 1.5
#: The lowest and highest stones, from the floor [m], and the floor of the pit below them [m].
_HIGHEST_M, _PIT_M = 0.25, 0.6


class Course(Settings):
    """A walk by script."""

    name: str = Field(pattern=r"^[a-z0-9_]+$")
    ground: Literal["floor", "stones", "stairs", "ramp", "beam"] = "floor"
    gait: Literal["trot", "crawl"] = "trot"
    stride: tuple[float, float, float] = Field(
        (0.4, 0.0, 0.0), description="of every foot in each cycle: ahead, to the left [m], and turn [rad]"
    )
    cycles: int = Field(8, ge=1, le=200, description="of the gait")
    size: float = Field(0.2, gt=0, le=5, description="side of a stone, width of a beam, length of a slope [m]")
    rise: float = Field(0.0, ge=0, le=1, description="between neighbouring stones at most, of each step or slope [m]")
    track: float | None = Field(
        None, gt=0, le=1, description="distance of the feet off the middle; none: as they stand"
    )
    jitter: tuple[float, float] = Field((0.02, 0.02), description="of footholds, ahead and to the side, at most [m]")
    friction: tuple[float, float] = Field((0.6, 1.0), description="drawn between these")

    def scale(self, robot: Robot) -> float:
        """Of lengths, for a robot's legs."""
        return float((robot.thigh_length + robot.shank_length).max()) / LEG_M

    def footholds(self, robot: Robot) -> Array:
        """(4, cycles + 1, 2) where each foot goes, first where it stands, start at the origin, before jitter [m].

        On stones and stairs hind feet step where front feet stood: the stance is as long as so many strides. In a trot
        the first pair's first step is half a stride, so that the pairs are half a stride apart from then on: the feet
        that carry the body are then ahead of it by as much as behind it. Where both pairs take whole strides, they
        carry it behind its middle on one diagonal and ahead of it on the other, which only a body that leans 4 cm to
        one side balances. On stairs it must: each tread takes the feet of both sides.
        """
        scale = self.scale(robot)
        dx, dy, turn = 0.5 * self.stride[0] * scale, 0.5 * self.stride[1] * scale, 0.5 * self.stride[2]
        stance = robot.stance[:, :2].copy()
        walked = stance.copy()
        if self.ground in ("stones", "stairs"):
            walked[:, 0] = np.where(stance[:, 0] > 0, 0.5, -0.5) * self._length(robot)
        if self.track is not None:
            walked[:, 1] = np.sign(stance[:, 1]) * self.track * scale
        out = np.empty((4, self.cycles + 1, 2))
        out[:, 0] = stance
        place, yaw = np.zeros(2), 0.0
        for half in range(1, 2 * self.cycles + 1):
            c, s = math.cos(yaw + 0.5 * turn), math.sin(yaw + 0.5 * turn)
            place = place + np.array([c * dx - s * dy, s * dx + c * dy])
            yaw += turn
            c, s = math.cos(yaw), math.sin(yaw)
            k = (half + 1) // 2
            # Feet come to a track that is not theirs in two strides.
            feet = walked if k > 1 else 0.5 * (stance + walked) if self.track is not None else walked
            turned = place + feet @ np.array([[c, s], [-s, c]])
            first = list(TROT_PAIRS[0]) if self._staggered else []
            for leg in range(4):
                if (leg in first) == bool(half % 2):
                    out[leg, k] = turned[leg]
        return out

    @property
    def _staggered(self) -> bool:
        """Whether the pairs of a trot are half a stride apart."""
        return self.gait == "trot" and self.ground != "stairs"

    def _length(self, robot: Robot) -> float:
        """Of the stance on rows: a whole number of strides, and half a one where one foot of a row is ahead by that.

        A crawl's hind foot comes down before the front foot has left: two strides at least.
        """
        stride = self.stride[0] * self.scale(robot)
        natural = float(robot.stance[:2, 0].mean() - robot.stance[2:, 0].mean())
        half = 0.5 if self._staggered else 0.0
        least = 2 if self.gait == "crawl" else 0 if half else 1
        return stride * (max(round(natural / stride - half), least) + half)

    def world(self, robot: Robot, rng: Rng) -> WorldSettings:
        """The world, drawn.

        Args:
            robot: that is to walk there; its footholds are those of the course.
            rng: of heights and friction.
        """
        friction = round(float(rng.uniform(*self.friction)), 3)
        feet = self.footholds(robot)
        goal = feet[:, -1].mean(axis=0)
        common: dict[str, Any] = {"name": self.name, "friction": friction, "goal": goal.tolist(), "goal_radius": 0.1}
        scale = self.scale(robot)
        match self.ground:
            case "stones":
                return WorldSettings(
                    **common, floor="pit", pit_depth=_PIT_M, **self._platforms(feet, scale),
                    stones=self._stones(feet, scale, rng),
                )  # fmt: skip
            case "stairs":
                return WorldSettings(**common, profile=self._stairs(feet, scale))
            case "ramp":
                return WorldSettings(**common, ramps=self._ramps(feet, scale), **self._level(feet, scale))
            case "beam":
                begin, end = self._ends(feet)
                beam = Beam(start=(begin, 0.0), end=(end, 0.0), width=self.size * scale)
                return WorldSettings(
                    **common, floor="pit", pit_depth=0.4, beams=(beam,), **self._platforms(feet, scale)
                )
        return WorldSettings(**common)

    def _ends(self, feet: Array) -> tuple[float, float]:
        """Where the floor at the start ends, before the first foothold that is on the course, and where that at the
        end begins, before the last of the hind feet [m]."""
        stride = feet[0, 3, 0] - feet[0, 2, 0]
        first = 3 if self.track is not None else 2 if self.ground == "stones" and self._staggered else 1
        return float(feet[:2, first, 0].min() - 0.5 * stride), float(feet[2:, -1, 0].max() - 0.5 * stride)

    def _platforms(self, feet: Array, scale: float) -> dict[str, Any]:
        """Floors at both ends of what lies over a pit."""
        begin, end = self._ends(feet)
        gap = 0.0
        if self.ground == "stones":
            gap = (0.5 * self.size if self._staggered else 0.25 * (self.stride[0] - self.size)) * scale
        half, depth = 1.0, 0.3
        boxes = [
            {"center": [0.5 * (low + high), 0.0, -0.5 * depth], "size": [high - low, 2 * half, depth]}
            for low, high in (
                (begin - gap - _RUN_IN_M - float(feet[0, 0, 0] - feet[2, 0, 0]), begin - gap),
                (end + gap, end + gap + _RUN_IN_M + float(feet[0, 0, 0] - feet[2, 0, 0])),
            )
        ]
        return {"boxes": boxes}

    def _stones(self, feet: Array, scale: float, rng: Rng) -> tuple[Stone, ...]:
        """Left and right rows of their own, neighbours up to ``rise`` higher or lower, back to the floor at the end."""
        rise, highest = self.rise * scale, _HIGHEST_M * scale
        stones, (begin, end) = [], self._ends(feet)
        for leg in (0, 1):
            top, y = 0.0, float(feet[leg, 1, 1])
            places = np.unique(np.round(feet[[leg, leg + 2], 1:, 0], 9))
            places = places[(places > begin - 1e-6) & (places < end + 1e-6)]
            for k, x in enumerate(places.tolist()):
                most = min(highest, rise * (len(places) - k))
                top = float(np.clip(top + rng.uniform(-rise, rise), -most, most))
                stones.append(Stone(x=x, y=y, top=top, side=self.size * scale))
        return tuple(stones)

    def _stairs(self, feet: Array, scale: float) -> Profile:
        """As many steps up as down, each as deep as a stride, the highest a landing."""
        stride = float(feet[0, 2, 0] - feet[0, 1, 0])
        begin, end = self._ends(feet)
        count = round((end - begin) / stride)
        stretches = [Stretch(x=begin - 3.0, height=0.0)]
        for k in range(count):
            level = min(k + 1, count - k, 4)
            if level * self.rise * scale != stretches[-1].height:
                stretches.append(Stretch(x=begin + k * stride, height=level * self.rise * scale))
        stretches.append(Stretch(x=end, height=0.0))
        return Profile(stretches=tuple(stretches), end=end + 3.0)

    def _ramps(self, feet: Array, scale: float) -> tuple[Ramp, Ramp]:
        begin, end = self._ends(feet)
        length, height = self.size * scale, self.rise * scale
        return (
            Ramp(x=begin, length=length, height=height),
            Ramp(x=end, yaw=math.pi, length=length, height=height),
        )

    def _level(self, feet: Array, scale: float) -> dict[str, Any]:
        """The level between two ramps."""
        begin, end = self._ends(feet)
        length, height = self.size * scale, self.rise * scale
        low, high = begin + length, end - length
        return {"boxes": [{"center": [0.5 * (low + high), 0.0, 0.5 * height], "size": [high - low, 2.0, height]}]}


#: The courses of the suite ``tracking``.
COURSES: dict[str, Course] = {
    course.name: course
    for course in (
        Course(name="stones_trot", ground="stones", rise=0.10, cycles=10),
        Course(name="stones_crawl", ground="stones", gait="crawl", rise=0.10, cycles=10),
        Course(name="stairs_trot", ground="stairs", stride=(0.28, 0, 0), rise=0.10, cycles=14),
        Course(name="ramp_trot", ground="ramp", stride=(0.3, 0, 0), size=1.2, rise=0.3215, cycles=14),
        Course(
            name="beam_trot", ground="beam", stride=(0.3, 0, 0), size=0.25, track=0.08, jitter=(0.02, 0.01), cycles=10
        ),
        Course(name="sidesteps_trot", stride=(0, 0.2, 0), cycles=8),
        Course(name="turn_trot", stride=(0, 0, 0.35), cycles=10),
    )
}


def draw_course(name: str, seed: int, robot: Robot) -> WorldSettings:
    """The world of a course as a seed draws it.

    Raises:
        SettingsError: no such course, with the list of them.
    """
    if name not in COURSES:
        raise SettingsError(f"course {name!r}: expected one of {', '.join(COURSES)}")
    world = COURSES[name].world(robot, np.random.default_rng(seed))
    return world.replace(name=f"{name}_{seed}")


def is_walk(name: str) -> bool:
    """Whether a name means the world of a course or of a climb, of the arena, or a member of a family."""
    return name.startswith(("course:", "member:")) or name in CLIMBS or name in ARENA


def any_world(name_or_path: str) -> WorldSettings:
    """``course:NAME:SEED`` (for ANYmal C) or ``course:NAME:SEED:ROBOT``; ``member:NAME:SEED`` of a family; a climb; a
    world of the arena (for ANYmal C); else see :func:`.load_world`.

    Raises:
        SettingsError: no such world.
    """
    if name_or_path in CLIMBS:
        return CLIMBS[name_or_path].settings()
    if name_or_path in ARENA:
        return ARENA[name_or_path].settings(legs_m=LEG_M)
    if not is_walk(name_or_path):
        return load_world(name_or_path)
    kind, *parts = name_or_path.split(":")
    if kind == "member":
        if len(parts) != 2 or not parts[1].isdecimal():
            raise SettingsError(f"world {name_or_path!r}: expected member:NAME:SEED, like member:pegboard:3")
        return member(parts[0], int(parts[1]))
    if len(parts) not in (2, 3) or not parts[1].isdecimal():
        raise SettingsError(f"world {name_or_path!r}: expected course:NAME:SEED, like course:stones_trot:3")
    robot = load_robot(parts[2] if len(parts) == 3 else "anymal_c")
    return draw_course(parts[0], int(parts[1]), robot.geometry())
