"""Climbs: ViTAL's simulations and experiments with dynamics: a world, a gait, and the velocity through it."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field

from legtool.configs.settings import Settings, build
from legtool.configs.worlds import WorldSettings, load_world


class Climb(Settings):
    """A walk along the way from a world's start to its goal, at a commanded velocity."""

    name: str = Field(pattern=r"^[a-z0-9_]+$")
    world: str = Field(description="preset that is walked through")
    scale: float = Field(1.0, gt=0, le=3, description="of the world's heights")
    speeds: tuple[float, ...] = Field((0.2,), min_length=1, description="along the way; of each trial in turn [m/s]")
    gait: Literal["trot", "crawl"] = "trot"
    heading: float = Field(0.0, ge=-math.pi, le=math.pi, description="of the trunk off the way, at its start [rad]")
    turn: float = Field(0.0, ge=-math.pi, le=math.pi, description="of the trunk over the whole way [rad]")
    robot: str | None = Field(None, description="who walks it; none: the suite's robot")
    surveyed: bool = Field(
        False, description="whether the true heights are given: a camera that looks ahead sees nothing of a way aside"
    )

    def speed(self, number: int) -> float:
        """Of a trial [m/s]."""
        return self.speeds[number % len(self.speeds)]

    def settings(self, seed: int = 0) -> WorldSettings:
        """The world; ``seed`` draws its cobbles."""
        return scaled(self.world, scale=self.scale, seed=seed, name=self.name)


def scaled(world: str, *, scale: float = 1.0, seed: int = 0, name: str | None = None) -> WorldSettings:
    """A preset that is made of a profile and cobbles, with other stones or other heights.

    Args:
        world: the preset.
        scale: of all heights.
        seed: of the cobbles.
        name: of the new world; None: the preset's.

    Raises:
        SettingsError: no such preset.
    """
    values = load_world(world).to_dict()
    for stretch in (values["profile"] or {"stretches": ()})["stretches"]:
        stretch["height"] *= scale
    for cobbles in values["cobbles"]:
        cobbles["height"] *= scale
        cobbles["seed"] = seed
    if scale != 1.0:
        values["source"] = f"{values['source']} All heights times {scale:g}.".strip()
    if name is not None:
        values["name"] = name
    return build(WorldSettings, values, source=world)


_STAIRS = "vital_stairs"
#: The climbs of the suite ``vital`` (ViTAL, sections VI-A to VI-J).
CLIMBS: dict[str, Climb] = {
    climb.name: climb
    for climb in (
        *(Climb(name=f"stairs_0{k}", world=_STAIRS, speeds=(k / 10,)) for k in (2, 3, 4, 5)),
        Climb(name="stairs_crawl", world="vital_stairs_go28", speeds=(0.1,), gait="crawl"),
        Climb(name="stairs_12cm", world=_STAIRS, scale=1.2),
        Climb(name="stairs_14cm", world=_STAIRS, scale=1.4),
        Climb(name="gapped_stairs", world="vital_gapped_stairs", speeds=(0.4,)),
        Climb(name="rough", world="vital_rough"),
        Climb(name="stairs_sideways", world="vital_low_stairs", heading=round(math.pi / 2, 6), surveyed=True),
        Climb(name="stairs_yawing", world=_STAIRS, heading=-0.4, turn=0.8),
        Climb(name="hyqreal_stairs", world=_STAIRS, speeds=(0.2, 0.3, 0.4, 0.5, 0.75), robot="hyqreal"),
    )
}
