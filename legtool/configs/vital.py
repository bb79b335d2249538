"""Settings of ViTAL's comparison of body poses."""

from __future__ import annotations

from pydantic import Field, model_validator

from legtool.configs.settings import Settings

#: The walks of the suite, defined in ``sim/walks/trunk_path.py``.
WALK_NAMES = (
    "stairs",
    "stairs_go28",
    "stairs_03",
    "stairs_04",
    "stairs_05",
    "stairs_075",
    "gapped_stairs",
    "rough",
    "stairs_sideways",
    "stairs_yawing",
)


class VitalSettings(Settings):
    """The robot moved through the paper's worlds, its poses planned by VPA and by the baseline TBR."""

    robot: str = Field("hyq", description="preset or path of a YAML with the robot's parameters")
    fast_robot: str = Field("hyqreal", description="robot of the walk at 0.75 m/s, as in the paper")
    seed: int = Field(0, ge=0, description="of the rough ground's stones")
    walks: tuple[str, ...] = Field(WALK_NAMES, min_length=1, description="which walks")
    scale: float = Field(1.0, gt=0, le=3, description="of the worlds' heights; below 1 for robots smaller than HyQ")

    @model_validator(mode="after")
    def _check(self) -> VitalSettings:
        unknown = sorted(set(self.walks) - set(WALK_NAMES))
        if unknown:
            raise ValueError(f"walks: {unknown[0]!r} is unknown; expected some of {', '.join(WALK_NAMES)}")
        return self
