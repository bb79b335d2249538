"""Settings that name the trunk, joints and feet in a user's own MJCF file, where conventions do not find them."""

from __future__ import annotations

from pydantic import Field, model_validator

from legtool.configs.settings import Settings


class MjcfNames(Settings):
    """Names in an MJCF file. Those left out are found by convention, from leg names such as FL, LF or front_left."""

    trunk: str | None = Field(None, description="name of the trunk's body")
    joints: tuple[str, ...] | None = Field(
        None,
        description="names of the twelve joints in the order of legs FL, FR, RL, RR, each with abduction, thigh, knee",
    )
    feet: tuple[str, ...] | None = Field(
        None, description="names of the four feet FL, FR, RL, RR, which may be geoms, sites or bodies"
    )
    standing_height: float | None = Field(
        None, gt=0, description="height of the trunk above the ground at rest [m]; null: with slightly bent legs"
    )

    no_contact: tuple[str, ...] = Field(
        (),
        description="names of bodies or geoms that pass through the ground, such as shanks that reach below their "
        "feet; the feet's own shapes touch it all the same",
    )

    @model_validator(mode="after")
    def _check(self) -> MjcfNames:
        if self.joints is not None and len(set(self.joints)) != 12:
            raise ValueError(f"joints: expected 12 different names, got {len(set(self.joints))}")
        if self.feet is not None and len(set(self.feet)) != 4:
            raise ValueError(f"feet: expected 4 different names, got {len(set(self.feet))}")
        return self
