"""Settings that tell which joints and bodies of a user's own MJCF file are which, where their names do not."""

from __future__ import annotations

from pydantic import Field, model_validator

from legtool.configs.settings import Settings


class MjcfNames(Settings):
    """Names in an MJCF file. What is left out is found by convention: leg names such as FL, LF or front_left."""

    trunk: str | None = Field(None, description="the trunk's body")
    joints: tuple[str, ...] | None = Field(
        None, description="twelve joints: legs FL, FR, RL, RR, each abduction, thigh, knee"
    )
    feet: tuple[str, ...] | None = Field(None, description="four feet FL, FR, RL, RR: geoms, sites or bodies")
    standing_height: float | None = Field(
        None, gt=0, description="trunk above ground at rest; none: legs bent a little"
    )

    @model_validator(mode="after")
    def _check(self) -> MjcfNames:
        if self.joints is not None and len(set(self.joints)) != 12:
            raise ValueError(f"joints: expected 12 different names, got {len(set(self.joints))}")
        if self.feet is not None and len(set(self.feet)) != 4:
            raise ValueError(f"feet: expected 4 different names, got {len(set(self.feet))}")
        return self
