"""Random scenes: shapes scattered, clustered, as staircases, stepping stones, or written by hand (QuadPiPS, V-B3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legtool.configs.robots import SeeingRobot
from legtool.configs.scenes import Placement, SceneSettings
from legtool.configs.world_parts import NEEDED, Shape, WrittenShape
from legtool.configs.worlds import load_scene
from legtool.sim.worlds import raycast as rc
from legtool.sim.worlds.build import lowest_support
from legtool.sim.worlds.builder import Builder
from legtool.sim.worlds.floors import draw_floor
from legtool.sim.worlds.shapes import Piece, draw_piece, place, written_piece
from legtool.sim.worlds.world import CUBOID, CYLINDRIC, WALL, World

Array = NDArray[np.float64]

#: Where shapes go: ahead and beside of the start [m].
AHEAD, BESIDE = (0.45, 3.8), 1.8
#: Nothing higher than this above its support stands closer than KEEP_OUT to the camera's way [m].
WALKABLE, KEEP_OUT = 0.2, 0.45
#: What hangs over the way hangs higher than this [m].
HEADROOM = 1.2
_TRIES = 12


@dataclass(frozen=True, eq=False)
class DrawnScene:
    """A world and the way that is walked through it.

    Attributes:
        world: shapes with classes.
        placement: how they were placed.
        indoor: there are walls and a ceiling.
        heading: of the straight way from the origin [rad].
        length: of the way [m].
    """

    world: World
    placement: Placement
    indoor: bool
    heading: float
    length: float


def draw_scene(settings: SceneSettings, robot: SeeingRobot, rng: np.random.Generator) -> DrawnScene:
    """Draw a scene: the same bits for the same settings and generator.

    Raises:
        SettingsError: a layout that does not exist.
    """
    names = list(settings.placements)
    shares = np.array([settings.placements[name] for name in names])
    placement = names[int(rng.choice(len(names), p=shares / shares.sum()))]
    indoor = bool(rng.uniform() < settings.indoor)
    flat = rng.uniform() < settings.flat_floor
    heading = float(rng.uniform(-0.25, 0.25))
    length = float(rng.uniform(*settings.camera.speed)) * settings.camera.frame_s * (settings.frames - 1)
    builder = Builder(None if flat else draw_floor(rng, (1.5, 0.0)))
    drawer = _Drawer(builder, settings, robot.swing_height_max, heading, length, rng)
    if placement == "written":
        drawer.write(load_scene(str(rng.choice(list(settings.layouts)))).shapes)
    elif placement == "staircase":
        drawer.staircase()
    elif placement == "stepping_stones":
        drawer.stepping_stones()
    fewest, most = settings.shapes
    count = int(rng.integers(fewest, most + 1))
    if placement != "written":
        drawer.spread(
            count if placement in ("clustered", "scattered") else count // 3, clustered=placement == "clustered"
        )
    if indoor:
        drawer.walls()
    return DrawnScene(builder.world, placement, indoor, heading, length)


class _Drawer:
    """Places shapes into a world that is being built."""

    def __init__(
        self,
        builder: Builder,
        settings: SceneSettings,
        swing_height_max: float,
        heading: float,
        length: float,
        rng: np.random.Generator,
    ) -> None:
        self.builder, self.settings, self.rng = builder, settings, rng
        self.swing_height_max = swing_height_max
        self.length = length
        self.way = np.array([np.cos(heading), np.sin(heading)])
        self.taken: list[tuple[float, float, float]] = []
        self.carriers: list[tuple[float, float, float, float]] = []

    def put(
        self, piece: Piece, x: float, y: float, yaw: float, *, bottom: float | None = None, tilt: float = 0.0
    ) -> None:
        """Put a piece down where it is told; without ``bottom`` on the lowest support under it."""
        if bottom is None:
            bottom = lowest_support(self.builder.world, piece.reach, x, y)
        primitive, top = place(piece, x, y, bottom, yaw, tilt=tilt)
        self.builder.add(piece.number, primitive, top)
        self.taken.append((x, y, piece.reach))
        if piece.number in (CUBOID, CYLINDRIC):
            inner = piece.sizes.get("radius", 0.5 * min(piece.sizes.get("length", 0), piece.sizes.get("width", 0)))
            self.carriers.append((x, y, inner, top))

    def spread(self, count: int, *, clustered: bool) -> None:
        """Put down ``count`` random shapes, as far as they find room."""
        rng = self.rng
        centres = np.column_stack([rng.uniform(0.8, 3.5, 3), rng.uniform(-1.2, 1.2, 3)])[: int(rng.integers(1, 4))]
        shapes = list(NEEDED)
        for n in range(count):
            # Every class comes up equally often in a scene, so that none is rare.
            shape: Shape = shapes[(n + int(rng.integers(len(shapes)))) % len(shapes)]
            piece = draw_piece(rng, shape, swing_height_max=self.swing_height_max)
            yaw = float(rng.uniform(-np.pi, np.pi))
            if shape in ("pipe", "tube") and rng.uniform() < self.settings.hanging:
                self._hang(piece, yaw)
                continue
            if rng.uniform() < self.settings.stacked and self._stack(piece, yaw):
                continue
            for _ in range(_TRIES):
                if clustered:
                    x, y = centres[int(rng.integers(len(centres)))] + rng.normal(0, 0.35, 2)
                else:
                    x, y = rng.uniform(*AHEAD), rng.uniform(-BESIDE, BESIDE)
                if self._free(piece, x, y, closeness=0.75 if clustered else 1.0) and self._clear(piece, x, y, 0.0):
                    self.put(piece, float(x), float(y), yaw)
                    break

    def staircase(self) -> None:
        """Steps that go up ahead, or down from where the robot stands."""
        rng = self.rng
        steps = int(rng.integers(3, 8))
        riser = rng.uniform(0.05, 1.5 * self.swing_height_max)
        # No steeper than about 37°, or the camera would run into the steps ahead.
        tread = rng.uniform(max(0.22, 1.3 * riser), 0.42)
        width = rng.uniform(0.8, 2.5)
        yaw = float(np.arctan2(self.way[1], self.way[0]) + rng.normal(0, 0.1))
        start = rng.uniform(0.5, 1.2)
        up = bool(rng.uniform() < 0.65)
        along = np.array([np.cos(yaw), np.sin(yaw)])
        for i in range(steps):
            if up:
                near, far = start + i * tread, start + steps * tread + 1.5
            else:
                near, far = -1.5, start + (steps - 1 - i) * tread
            # Each step is a block that reaches from the ground to its tread: the next one stands behind or before it.
            middle = (near + far) / 2 * along
            piece = Piece("cuboid", {"length": far - near, "width": width, "height": (i + 1) * riser})
            self.put(piece, float(middle[0]), float(middle[1]), yaw, bottom=0.0)
        end = start + steps * tread + 1.5 if up else start + steps * tread
        self._occupy(along, -1.5 if not up else start, end, width / 2)

    def stepping_stones(self) -> None:
        """Rows of stones with gaps between them."""
        rng = self.rng
        yaw = float(np.arctan2(self.way[1], self.way[0]))
        rotation = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        rows, columns = int(rng.integers(4, 9)), int(rng.integers(2, 5))
        side = rng.uniform(0.15, 0.35)
        pitch = side + rng.uniform(0.04, 0.25, 2)
        height = rng.uniform(0.04, 1.8 * self.swing_height_max)
        uneven = rng.uniform(0.0, 0.04)
        start = rng.uniform(0.5, 1.0)
        round_stones = rng.uniform() < 0.3
        for i in range(rows):
            for j in range(columns):
                if rng.uniform() < 0.1:
                    continue
                local = np.array([start + i * pitch[0], (j - (columns - 1) / 2) * pitch[1]]) + rng.normal(0, 0.02, 2)
                x, y = rotation @ local
                rise = max(0.03, height + rng.normal(0, uneven))
                piece = (
                    Piece("cylinder", {"radius": side / 2, "height": rise})
                    if round_stones
                    else Piece("cuboid", {"length": side, "width": side, "height": rise})
                )
                self.put(piece, float(x), float(y), yaw + float(rng.normal(0, 0.1)))

    def write(self, shapes: Sequence[WrittenShape]) -> None:
        """Put down shapes as they are written, whatever lies in the way."""
        for shape in shapes:
            bottom = shape.z if shape.z > 0 else None
            self.put(written_piece(shape), shape.x, shape.y, shape.yaw, bottom=bottom)

    def walls(self) -> None:
        """Four walls and a ceiling that look inwards."""
        rng = self.rng
        front, back = rng.uniform(max(2.0, self.length + 1.2), 6.5), -rng.uniform(1.5, 3.0)
        left, right = rng.uniform(1.0, 3.5), -rng.uniform(1.0, 3.5)
        # Local z is a plane's front; the walls are endless, and hide each other outside the room.
        for position, normal in (
            ([front, 0, 0], [-1, 0, 0]),
            ([back, 0, 0], [1, 0, 0]),
            ([0, left, 0], [0, -1, 0]),
            ([0, right, 0], [0, 1, 0]),
            ([0, 0, rng.uniform(2.0, 3.0)], [0, 0, -1]),
        ):
            z = np.array(normal, dtype=float)
            x = np.array([0.0, 0.0, 1.0]) if normal[2] == 0 else np.array([1.0, 0.0, 0.0])
            rotation = np.column_stack([x, np.cross(z, x), z])
            self.builder.add(WALL, rc.plane(np.array(position, dtype=float), rotation), 0.0)

    def _hang(self, piece: Piece, yaw: float) -> None:
        rng = self.rng
        x, y, tilt = float(rng.uniform(0.8, 4.0)), float(rng.uniform(-1.5, 1.5)), float(rng.normal(0, 0.15))
        droop = abs(np.sin(tilt)) * piece.sizes["length"]
        lowest = HEADROOM if self._distance(x, y) < KEEP_OUT + piece.reach else 0.1
        self.put(piece, x, y, yaw, bottom=float(rng.uniform(lowest, 1.8)) + droop, tilt=tilt)

    def _stack(self, piece: Piece, yaw: float) -> bool:
        room = [c for c in self.carriers if c[2] >= piece.reach and self._clear(piece, c[0], c[1], c[3])]
        if not room:
            return False
        x, y, inner, top = room[int(self.rng.integers(len(room)))]
        slack = (inner - piece.reach) / np.sqrt(2)
        dx, dy = self.rng.uniform(-slack, slack, 2)
        self.carriers.remove((x, y, inner, top))
        self.put(piece, x + float(dx), y + float(dy), yaw, bottom=top)
        return True

    def _occupy(self, along: Array, near: float, far: float, half_width: float) -> None:
        for s in np.arange(near, far + half_width, max(half_width, 0.2)):
            self.taken.append((float(s * along[0]), float(s * along[1]), half_width * 1.1))

    def _free(self, piece: Piece, x: float, y: float, *, closeness: float) -> bool:
        return all(np.hypot(x - a, y - b) > closeness * (r + piece.reach) for a, b, r in self.taken)

    def _distance(self, x: float, y: float) -> float:
        """From the way, and a little more behind it and before it."""
        along = float(np.clip(np.array([x, y]) @ self.way, -0.6, self.length + 0.8))
        return float(np.hypot(*(np.array([x, y]) - along * self.way)))

    def _clear(self, piece: Piece, x: float, y: float, bottom: float) -> bool:
        return bottom + piece.height < WALKABLE or self._distance(x, y) > KEEP_OUT + piece.reach
