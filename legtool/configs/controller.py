"""Settings of the built-in trotting controller, written for a robot that stands 0.39 m tall."""

from __future__ import annotations

from pydantic import Field

from legtool.configs.settings import Settings


class TrotSettings(Settings):
    """Gait, footholds, swing and stance of the built-in controller.

    Times scale with the square root of the standing height and lengths with the height (Froude similarity), so that
    one set of numbers makes both a 15 kg and a 90 kg robot trot.
    """

    swing_s: float = Field(0.26, gt=0.1, le=0.6, description="duration of a swing [s]")
    full_stance_s: float = Field(0.08, ge=0.02, le=0.4, description="duration of full stance [s]")
    stretch_s: float = Field(0.15, ge=0, le=1, description="longest wait in full stance for a foot that lands late [s]")
    swing_height: float = Field(0.12, gt=0.02, le=0.3, description="height of the swing's apex above the ground [m]")
    search_speed: float = Field(
        0.5, gt=0, le=2, description="speed at which a foot touches down, and at which it searches for the ground [m/s]"
    )
    search_depth: float = Field(0.15, ge=0, le=0.5, description="how far below the expected ground a foot searches [m]")
    early_contact: float = Field(
        0.8, ge=0.3, le=1, description="share of the swing before which a contact is not taken for a touchdown"
    )
    arrival: float = Field(
        0.8,
        ge=0.5,
        le=1,
        description="share of the swing after which the foot is above its foothold and the foothold is fixed",
    )
    foothold_neutral: float = Field(
        0.42, ge=0, le=1, description="foothold is placed ahead by this share of stance time × velocity command"
    )
    foothold_gain_s: float = Field(
        0.25, ge=0, le=1, description="foothold is placed ahead by this × velocity error [s]"
    )
    foothold_reach: float = Field(
        0.32, gt=0, le=1, description="largest distance of a foothold from the point below the hip [m]"
    )
    swing_stiffness: float = Field(1600.0, gt=0, description="stiffness of the swing foot's tracking [1/s²]")
    swing_damping: float = Field(70.0, gt=0, description="damping of the swing foot's tracking [1/s]")
    velocity_gain: float = Field(4.0, ge=0, description="horizontal acceleration for each m/s of velocity error [1/s]")
    velocity_trim: float = Field(
        1.085,
        ge=0.5,
        le=1.5,
        description="factor on the velocity command, to make up for losses in joints and impacts",
    )
    acceleration_limit: float = Field(4.0, gt=0, description="largest horizontal acceleration [m/s²]")
    height_stiffness: float = Field(100.0, gt=0, description="stiffness of the trunk's height [1/s²]")
    height_damping: float = Field(18.0, ge=0, description="damping of the trunk's height [1/s]")
    attitude_stiffness: float = Field(200.0, gt=0, description="stiffness of roll and pitch [1/s²]")
    attitude_damping: float = Field(30.0, ge=0, description="damping of roll and pitch [1/s]")
    yaw_gain: float = Field(15.0, ge=0, description="yaw acceleration for each rad/s of yaw-rate error [1/s]")
    hold_stiffness: float = Field(
        25.0, ge=0, description="stiffness that pulls the trunk to the centre of its feet while standing [1/s²]"
    )
    moment_weight: float = Field(
        10.0,
        gt=0,
        description="weight of roll and pitch moments in the distribution of contact forces; forces have 1, vertical 2",
    )
    stance_friction: float = Field(0.6, gt=0, le=1.5, description="friction coefficient of the contact forces' cone")
    friction_compensation: float = Field(
        0.8, ge=0, le=1, description="share of the joints' dry friction that is compensated by feedforward"
    )
    load_s: float = Field(0.03, ge=0, le=0.2, description="time in which a foot that touched down takes up load [s]")
