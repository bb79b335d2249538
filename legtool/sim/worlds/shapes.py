"""The primitive shape classes as primitives of the ray caster, standing on a support or hanging (QuadPiPS, V-B1)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool.configs.world_parts import NEEDED, SHAPES, Shape, WrittenShape
from legtool.sim.worlds import raycast as rc
from legtool_runtime.rotations import about_z

Array = NDArray[np.float64]

#: A tube's wall, as a share of its radius.
WALL_SHARE = 0.12
#: Ramps are no steeper than this, so that their top face is steppable.
STEEPEST_RAMP = np.tan(np.deg2rad(25.0))


class Piece(NamedTuple):
    """A shape with its sizes, not placed yet: ``sizes`` by the names of NEEDED [m]."""

    shape: Shape
    sizes: dict[str, float]

    @property
    def number(self) -> int:
        """Its class's number in SHAPES."""
        return SHAPES.index(self.shape)

    @property
    def reach(self) -> float:
        """Radius of a circle around its footprint [m]."""
        s = self.sizes
        match self.shape:
            case "cuboid" | "ramp":
                return 0.5 * float(np.hypot(s["length"], s["width"]))
            case "pipe" | "tube":
                return 0.5 * s["length"] + s["radius"]
        return s["radius"]

    @property
    def height(self) -> float:
        """From its lowest point to its top, standing or lying [m]."""
        s = self.sizes
        match self.shape:
            case "cuboid" | "ramp" | "cylinder":
                return s["height"]
            case "pole":
                return s["length"]
            case "semisphere":
                return s["radius"]
        return 2 * s["radius"]


def place(
    piece: Piece, x: float, y: float, bottom: float, yaw: float, *, tilt: float = 0.0
) -> tuple[rc.Primitive, float]:
    """The primitive, and the height of its top.

    Args:
        piece: what.
        x, y: of its middle, world frame [m].
        bottom: its lowest point [m].
        yaw: its direction: of a ramp uphill, of pipe and tube the axis [rad].
        tilt: of pipe and tube, its far end up [rad]; others stand upright.
    """
    s, rotation = piece.sizes, about_z(yaw)
    height = piece.height
    middle = [x, y, bottom + height / 2]
    match piece.shape:
        case "cuboid":
            return rc.box(middle, rotation, (s["length"] / 2, s["width"] / 2, height / 2)), bottom + height
        case "ramp":
            return rc.wedge(middle, rotation, (s["length"] / 2, s["width"] / 2, height / 2)), bottom + height
        case "cylinder":
            return rc.cylinder(middle, rotation, s["radius"], height / 2), bottom + height
        case "sphere":
            return rc.sphere(middle, s["radius"]), bottom + height
        case "semisphere":
            return rc.semisphere([x, y, bottom], rotation, s["radius"]), bottom + height
        case "pole":
            # The round lower end is sunk: only the upper one is seen.
            half = (height - s["radius"]) / 2
            return rc.capsule([x, y, bottom + half], rotation, s["radius"], half), bottom + height
    rise = abs(np.sin(tilt)) * s["length"] / 2 + np.cos(tilt) * s["radius"]
    middle[2] = bottom + rise
    # Local z, the axis, along yaw and up by the tilt.
    c, t = np.cos(tilt), np.sin(tilt)
    lying = rotation @ np.array([[t, 0.0, c], [0.0, 1.0, 0.0], [-c, 0.0, t]])
    if piece.shape == "pipe":
        primitive = rc.cylinder(middle, lying, s["radius"], s["length"] / 2)
    else:
        primitive = rc.tube(middle, lying, s["radius"], (1 - WALL_SHARE) * s["radius"], s["length"] / 2)
    return primitive, bottom + 2 * rise


def draw_piece(rng: np.random.Generator, shape: Shape, *, swing_height_max: float) -> Piece:
    """A shape of random size; half of each class is low enough to step over.

    Args:
        rng: draws the sizes.
        shape: its class.
        swing_height_max: highest obstacle that a swing steps over [m].
    """
    low = rng.uniform() < 0.5
    rise = rng.uniform(0.03, swing_height_max) if low else rng.uniform(swing_height_max, 4 * swing_height_max)
    sizes: dict[str, float]
    match shape:
        case "cuboid":
            sizes = {"length": rng.uniform(0.1, 0.9), "width": rng.uniform(0.1, 0.9), "height": rise}
        case "ramp":
            shortest = rise / STEEPEST_RAMP
            sizes = {"length": rng.uniform(shortest, shortest + 0.8), "width": rng.uniform(0.3, 1.0), "height": rise}
        case "cylinder":
            sizes = {"radius": rng.uniform(0.06, 0.4), "height": rise}
        case "sphere":
            sizes = {"radius": rise / 2}
        case "semisphere":
            sizes = {"radius": min(rise, 0.45)}
        case "pole":
            length = rise if low else rng.uniform(swing_height_max, 1.6)
            sizes = {"length": max(length, 0.05), "radius": rng.uniform(0.012, min(0.05, 0.4 * max(length, 0.05)))}
        case "pipe" | "tube":
            thinnest = 0.015 if shape == "pipe" else 0.04
            radius = rng.uniform(thinnest, swing_height_max / 2) if low else rise / 2
            sizes = {"length": rng.uniform(0.3, 1.6), "radius": min(radius, 0.2)}
    return Piece(shape, sizes)


def written_piece(written: WrittenShape) -> Piece:
    """A shape that was written by hand."""
    return Piece(written.shape, {name: float(getattr(written, name)) for name in NEEDED[written.shape]})
