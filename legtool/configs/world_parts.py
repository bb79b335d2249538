"""What a world is made of: single shapes, boxes and cylinders, and the short forms that stand for many of them."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from legtool.configs.settings import Settings

#: The classes of primitive shapes, in the order of their numbers in ``shape`` images (1, 2, …; 0 is no return).
SHAPES = ("cuboid", "ramp", "cylinder", "sphere", "semisphere", "pole", "pipe", "tube", "floor", "wall")
#: Shapes that stand on their own; floor and walls belong to the environment.
Shape = Literal["cuboid", "ramp", "cylinder", "sphere", "semisphere", "pole", "pipe", "tube"]
AnyShape = Literal["cuboid", "ramp", "cylinder", "sphere", "semisphere", "pole", "pipe", "tube", "floor", "wall"]
Side = Literal["both", "left", "right"]
Label = Literal["steppable", "passable", "non_passable"]

Length = Annotated[float, Field(gt=0, le=5)]
#: Sizes and places of what is written as single primitives, which may be a whole floor [m].
Size = Annotated[float, Field(gt=0, le=1000)]
Place = Annotated[float, Field(ge=-1000, le=1000)]
Angle = Annotated[float, Field(ge=-10, le=10)]
Point2 = tuple[Place, Place]
Point3 = tuple[Place, Place, Place]


class Part(Settings):
    """What every part may carry."""

    friction: float | None = Field(None, gt=0, le=1000, description="sliding friction; none: the world's")
    ground: bool | None = Field(
        None, description="whether a foot may stand on it; none: yes, unless it is labelled or lies too deep"
    )


class Gap(Settings):
    """A slot in the floor down to the pit; ``left`` or ``right`` cuts one half of the width only (asymmetric)."""

    x: float = Field(ge=0, description="near edge [m]")
    width: float = Field(gt=0, le=1, description="along x [m]")
    side: Side = "both"

    @property
    def end(self) -> float:
        """Far edge [m]."""
        return self.x + self.width


class Step(Settings):
    """A raised stretch of floor: a step up, and a step down at its end."""

    x: float = Field(ge=0, description="near edge [m]")
    length: float = Field(gt=0, le=20, description="along x [m]")
    height: float = Field(gt=0, le=0.5, description="above the stretch it stands on [m]")
    side: Side = "both"

    @property
    def end(self) -> float:
        """Far edge [m]."""
        return self.x + self.length


class Stretch(Settings):
    """A stretch of floor across the whole width, from its x to that of the next stretch."""

    x: Place = Field(description="where it begins [m]")
    height: float = Field(ge=-5, le=5, description="of its top [m]")
    ground: bool = Field(True, description="whether a foot may stand on it")


class Profile(Settings):
    """A floor of stretches, one behind the other along x: stairs, gaps with a bottom."""

    stretches: tuple[Stretch, ...] = Field(min_length=1, max_length=500)
    end: Place = Field(description="where the last stretch ends [m]")
    width: Size = Field(2.0, description="[m]")

    @model_validator(mode="after")
    def _check(self) -> Profile:
        edges = [stretch.x for stretch in self.stretches] + [self.end]
        if any(b <= a for a, b in pairwise(edges)):
            raise ValueError(f"stretches begin at {edges[:-1]} and end at {self.end}: expected ascending places")
        return self


class Cobbles(Part):
    """Flat stones side by side, of random sides and heights, that leave no ground between them."""

    x: tuple[Place, Place] = Field(description="from where to where they are seen [m]")
    y: tuple[Place, Place] = Field(description="likewise, across [m]")
    first: Point2 = Field(description="corner of the first stone, at or before the lowest x and y [m]")
    height: float = Field(0.12, gt=0, le=2, description="of the highest stones; the lowest are level [m]")
    seed: int = Field(0, ge=0)


class Stairs(Part):
    """A flight of steps up along its direction; each step is a block that stands on the floor."""

    x: Place = Field(description="middle of the lowest riser [m]")
    y: Place = 0.0
    yaw: Angle = Field(0.0, description="direction of the way up [rad]")
    steps: int = Field(ge=1, le=100)
    riser: Length = Field(description="height of each step [m]")
    tread: Length = Field(description="depth of each step [m]")
    width: Size = Field(2.0, description="[m]")
    landing: float = Field(0.0, ge=0, le=100, description="by how much the top step is deeper than the others [m]")


class Ramp(Part):
    """An inclined plane, solid down to what it stands on; ``x, y`` is the middle of its lower edge."""

    x: Place
    y: Place = 0.0
    z: float = Field(0.0, ge=-5, le=5, description="height of its lower edge [m]")
    yaw: Angle = Field(0.0, description="uphill [rad]")
    length: Size = Field(description="in the horizontal [m]")
    width: Size = Field(2.0, description="[m]")
    height: Length = Field(description="of its upper edge above the lower one [m]")


class Beam(Part):
    """A straight beam from one place to another, level on top."""

    start: Point2 = Field(description="middle of its near end [m]")
    end: Point2 = Field(description="middle of its far end [m]")
    top: float = Field(0.0, ge=-5, le=5, description="[m]")
    width: Length = Field(description="[m]")
    thickness: Length = Field(0.1, description="[m]")

    @model_validator(mode="after")
    def _check(self) -> Beam:
        if self.start == self.end:
            raise ValueError(f"a beam from {self.start} to {self.end}: expected two different places")
        return self


class Stone(Part):
    """One stepping stone, square or round, that stands on the floor."""

    x: Place
    y: Place = 0.0
    yaw: Angle = Field(0.0, description="[rad]")
    top: float = Field(ge=-5, le=5, description="[m]")
    side: Length | None = Field(None, description="of a square stone [m]")
    radius: Length | None = Field(None, description="of a round stone [m]")

    @model_validator(mode="after")
    def _check(self) -> Stone:
        if (self.side is None) == (self.radius is None):
            raise ValueError("a stone takes either its side (square) or its radius (round)")
        return self


class StoneGrid(Part):
    """Stepping stones in rows along x and columns along y, drawn by their seed."""

    x: Place = Field(description="of the middle of the first row's stones [m]")
    y: Place = Field(description="of the middle of the first column's stones [m]")
    rows: int = Field(ge=1, le=100, description="along x")
    columns: int = Field(ge=1, le=100, description="along y")
    pitch: tuple[Length, Length] = Field(description="from stone to stone along x and y [m]")
    side: Length | None = Field(None, description="of square stones [m]")
    radius: Length | None = Field(None, description="of round stones [m]")
    top: tuple[float, float] = Field((0.0, 0.0), description="lowest and highest top [m]")
    present: float = Field(1.0, gt=0, le=1, description="share of the stones that are there")
    shift: float = Field(0.0, ge=0, le=1, description="farthest that a stone is out of its place, along x and y [m]")
    seed: int = Field(0, ge=0)

    @model_validator(mode="after")
    def _check(self) -> StoneGrid:
        if (self.side is None) == (self.radius is None):
            raise ValueError("a grid of stones takes either their side (square) or their radius (round)")
        if not -5 <= self.top[0] <= self.top[1] <= 5:
            raise ValueError(f"top {list(self.top)}: expected the lowest top, then the highest, within ±5 m")
        return self


class Solid(Part):
    """A primitive that is written out; ``rpy`` turns it about the world's axes: R = Rz Ry Rx."""

    center: Point3 = Field(description="[m]")
    rpy: tuple[Angle, Angle, Angle] = Field((0.0, 0.0, 0.0), description="roll, pitch, yaw [rad]")
    shape: AnyShape | None = Field(None, description="its class; none: cuboid, cylinder, or pipe where it lies")
    label: Label | None = Field(None, description="of all its faces; none: each by its place")
    name: str = Field("", max_length=200)


class Box(Solid):
    """A box about its centre."""

    size: tuple[Size, Size, Size] = Field(description="full lengths of its sides [m]")


class Cylinder(Solid):
    """A solid cylinder about its centre, its axis along local z."""

    radius: Size = Field(description="[m]")
    length: Size = Field(description="[m]")


class WrittenShape(Settings):
    """One shape of a scene that is written by hand; its sizes mean what its class says."""

    shape: Shape
    x: float = Field(ge=-20, le=20, description="ahead of the start [m]")
    y: float = Field(ge=-20, le=20, description="left of the start [m]")
    z: float = Field(0.0, ge=0, le=5, description="its lowest point above the ground [m]")
    yaw: float = Field(0.0, description="[rad]")
    length: Length | None = Field(None, description="cuboid, ramp (uphill); pole, pipe, tube: axis [m]")
    width: Length | None = Field(None, description="cuboid, ramp [m]")
    height: Length | None = Field(None, description="cuboid, ramp, cylinder [m]")
    radius: Length | None = Field(None, description="cylinder, sphere, semisphere, pole, pipe, tube [m]")

    @model_validator(mode="after")
    def _check(self) -> WrittenShape:
        needed = NEEDED[self.shape]
        given = {name for name in ("length", "width", "height", "radius") if getattr(self, name) is not None}
        if given != set(needed):
            raise ValueError(f"a {self.shape} takes {', '.join(needed)}; given: {', '.join(sorted(given)) or 'none'}")
        return self


#: Parameters of each class (QuadPiPS, section V-B1).
NEEDED: dict[Shape, tuple[str, ...]] = {
    "cuboid": ("length", "width", "height"),
    "ramp": ("length", "width", "height"),
    "cylinder": ("radius", "height"),
    "sphere": ("radius",),
    "semisphere": ("radius",),
    "pole": ("length", "radius"),
    "pipe": ("length", "radius"),
    "tube": ("length", "radius"),
}
