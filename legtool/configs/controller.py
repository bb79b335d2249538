"""Settings of the built-in trotting controller, written for a robot that stands 0.39 m tall."""

from __future__ import annotations

from pydantic import Field

from legtool.configs.settings import Settings


class TrotSettings(Settings):
    """Gait, footholds, swing and stance of the built-in controller.

    Times scale with the root of the standing height, lengths with the height (Froude similarity), so that one set of
    numbers trots a 15 kg and a 90 kg robot.
    """

    swing_s: float = Field(0.26, gt=0.1, le=0.6, description="duration of a swing [s]")
    full_stance_s: float = Field(0.08, ge=0.02, le=0.4, description="duration of full stance [s]")
    stretch_s: float = Field(0.15, ge=0, le=1, description="full stance is stretched by up to this for a late foot [s]")
    swing_height: float = Field(0.12, gt=0.02, le=0.3, description="[m]")
    search_speed: float = Field(
        0.5, gt=0, le=2, description="of a foot that touches down, and of one that finds no ground [m/s]"
    )
    search_depth: float = Field(0.15, ge=0, le=0.5, description="how far below the ground a foot searches [m]")
    early_contact: float = Field(
        0.8, ge=0.3, le=1, description="share of the swing before which contact is not accepted"
    )
    arrival: float = Field(
        0.8, ge=0.5, le=1, description="share of the swing after which the foot is above its foothold, then fixed"
    )
    foothold_neutral: float = Field(
        0.42, ge=0, le=1, description="foothold ahead by this share of stance time × velocity command"
    )
    foothold_gain_s: float = Field(0.25, ge=0, le=1, description="foothold ahead by this × velocity error [s]")
    foothold_reach: float = Field(0.32, gt=0, le=1, description="largest foothold from below the hip [m]")
    swing_stiffness: float = Field(1600.0, gt=0, description="of the swing foot [1/s²]")
    swing_damping: float = Field(70.0, gt=0, description="of the swing foot [1/s]")
    velocity_gain: float = Field(4.0, ge=0, description="horizontal acceleration per velocity error [1/s]")
    velocity_trim: float = Field(
        1.085,
        ge=0.5,
        le=1.5,
        description="velocity command is scaled by this, against what joints and impacts take away",
    )
    acceleration_limit: float = Field(4.0, gt=0, description="horizontal [m/s²]")
    height_stiffness: float = Field(100.0, gt=0, description="[1/s²]")
    height_damping: float = Field(18.0, ge=0, description="[1/s]")
    attitude_stiffness: float = Field(200.0, gt=0, description="[1/s²]")
    attitude_damping: float = Field(30.0, ge=0, description="[1/s]")
    yaw_gain: float = Field(15.0, ge=0, description="yaw acceleration per yaw-rate error [1/s]")
    hold_stiffness: float = Field(25.0, ge=0, description="pull of the trunk to between its feet while standing [1/s²]")
    moment_weight: float = Field(
        10.0, gt=0, description="roll and pitch moment in the stance problem; vertical force is 2, horizontal 1"
    )
    stance_friction: float = Field(0.6, gt=0, le=1.5, description="friction cone of the stance problem")
    friction_compensation: float = Field(
        0.8, ge=0, le=1, description="share of the joints' dry friction that is fed forward"
    )
    load_s: float = Field(0.03, ge=0, le=0.2, description="time over which a foot that touched down takes load [s]")
