"""How the robot is moved over the worlds of ViTAL's simulations: the trunk's path, without dynamics."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from legtool.configs.climbs import scaled
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.heights import elevation_map
from legtool.sim.worlds.world import World
from legtool_runtime.foothold import Gait
from legtool_runtime.terrain.elevation import HeightMap

#: Side of the maps' cells, and the part of the worlds that is mapped: its centre and sides [m].
CELL_M, _CENTRE, _SIDES_M = 0.02, (1.25, 0.0), (6.5, 2.0)
#: Step frequency of a robot that hardly moves [Hz], and by how much it rises with the speed [1/m].
_FREQUENCY, _RISE = 1.2, 1.0


@dataclass(frozen=True)
class TrunkPath:
    """A trunk's path through a world, along x.

    Attributes:
        world: a preset's name.
        speed: along x [m/s].
        heading: of the trunk against the path's direction, at its start [rad]: 0 forwards, π/2 sideways.
        turn: of the trunk over the whole path [rad].
        begin: x of the trunk's origin at the start [m].
        end: x at the end [m].
    """

    world: str
    speed: float
    heading: float = 0.0
    turn: float = 0.0
    begin: float = -0.9
    end: float = 3.2

    def yaw(self, x: float) -> float:
        """Yaw of the trunk at ``x`` [rad]."""
        return self.heading + self.turn * (x - self.begin) / (self.end - self.begin)

    def twist(self, x: float) -> tuple[float, ...]:
        """(6,) base twist at ``x``, horizontal frame."""
        yaw = self.yaw(x)
        rate = self.turn * self.speed / (self.end - self.begin)
        return (self.speed * math.cos(yaw), -self.speed * math.sin(yaw), 0.0, 0.0, 0.0, rate)

    @property
    def gait(self) -> Gait:
        """A trot whose steps get quicker and longer with the speed: 1.4 Hz at 0.2 m/s, 1.95 Hz at 0.75 m/s."""
        frequency = _FREQUENCY + _RISE * self.speed
        return Gait(self.speed / frequency, frequency, 0.55)


#: The paper's simulations (sections VI-A to VI-J): world, speed, and the lateral and yawing climbs.
PATHS = {
    "stairs": TrunkPath("vital_stairs", 0.2),
    "stairs_go28": TrunkPath("vital_stairs_go28", 0.25),
    "stairs_03": TrunkPath("vital_stairs", 0.3),
    "stairs_04": TrunkPath("vital_stairs", 0.4),
    "stairs_05": TrunkPath("vital_stairs", 0.5),
    "stairs_075": TrunkPath("vital_stairs", 0.75),
    "gapped_stairs": TrunkPath("vital_gapped_stairs", 0.4),
    "rough": TrunkPath("vital_rough", 0.2),
    "stairs_sideways": TrunkPath("vital_low_stairs", 0.2, heading=np.pi / 2),
    "stairs_yawing": TrunkPath("vital_stairs", 0.2, heading=-0.4, turn=0.8),
}


def vital_world(name: str, *, seed: int = 0, scale: float = 1.0) -> World:
    """A world of ViTAL's, with other stones or lower steps.

    Args:
        name: a preset that is made of a profile and cobbles.
        seed: of the cobbles.
        scale: of all heights.

    Raises:
        SettingsError: no such preset.
    """
    return build_world(scaled(name, scale=scale, seed=seed))


def vital_map(world: World) -> HeightMap:
    """The true heights of a world of ViTAL's, from x = -2 to 4.5 m, y within ±1 m, in cells of 2 cm."""
    return elevation_map(world, _CENTRE, _SIDES_M, CELL_M)
