"""Settings of the steppability segmenter: its network, training and evaluation. The defaults suit a CPU."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from legtool.configs.settings import Settings

#: Presets for ``--config``: ``full.yaml`` is meant for a GPU.
PRESETS = Path(__file__).parent / "steppability"


class NetworkSettings(Settings):
    """DeepLabV3+: an encoder, atrous pooling, and a decoder that brings back fine features."""

    encoder: Literal["resnet", "mobile"] = Field(
        "resnet", description="resnet: residual blocks; mobile: inverted residual blocks (MobileNetV2)"
    )
    depth: Literal[10, 18, 34, 50] = Field(10, description="number of layers of the residual encoder")
    width: int = Field(16, ge=8, le=128, multiple_of=4, description="channels of the first stage; usually 64")
    stem_stride: Literal[2, 4] = Field(
        2, description="stride of the first stage; 4 includes the usual pooling after the first convolution"
    )
    output_stride: Literal[8, 16, 32] = Field(
        16, description="input pixels along one side of a pixel of the deepest features"
    )
    pooling_channels: int = Field(48, ge=16, le=512, description="channels of the atrous pooling")
    decoder_channels: int = Field(32, ge=16, le=512, description="channels of the decoder")

    @model_validator(mode="after")
    def _check(self) -> NetworkSettings:
        if self.encoder == "mobile" and self.stem_stride == 4:
            raise ValueError("stem_stride 4 is for the residual encoder; the mobile one takes 2")
        return self


class SteppabilityTrainSettings(Settings):
    """Training of the segmenter."""

    seed: int = Field(0, ge=0, description="seed of everything random")
    network: NetworkSettings = Field(default_factory=NetworkSettings)
    encoder_weights: str | None = Field(
        None, description="file of encoder weights with the names of torchvision (.pt); null: random weights"
    )
    epochs: int = Field(12, ge=1, le=10_000, description="number of epochs")
    coarse_epochs: int = Field(
        4, ge=0, le=10_000, description="number of epochs at the beginning that use every second pixel"
    )
    batch: int = Field(8, ge=1, le=1024, description="images in a batch")
    learning_rate: float = Field(
        3e-3, gt=0, le=1, description="learning rate at the start, which falls as (1 - t)^0.9 (poly)"
    )
    weight_decay: float = Field(1e-2, ge=0, le=1, description="weight decay")
    loss: Literal["class_weighted", "hard_pixels"] = Field(
        "class_weighted", description="all pixels weighted by class, or only those with the largest losses"
    )
    hard_share: float = Field(0.3, gt=0, le=1, description="share of the pixels of a batch that count, for hard_pixels")
    augment: bool = Field(True, description="whether images are mirrored and scaled and given noise and voids")
    bf16: bool | None = Field(None, description="whether to train in bfloat16; null: if the device supports it")
    device: Literal["auto", "cpu", "cuda"] = "auto"

    @model_validator(mode="after")
    def _check(self) -> SteppabilityTrainSettings:
        if self.coarse_epochs >= self.epochs and self.coarse_epochs > 0:
            raise ValueError(f"coarse_epochs {self.coarse_epochs}: expected fewer than the {self.epochs} epochs in all")
        return self


class SteppabilityEvalSettings(Settings):
    """Evaluation of the segmenter on the test scenes."""

    seed: int = Field(0, ge=0, description="seed of everything random")
    bootstrap: int = Field(1000, ge=100, le=100_000, description="resamples of scenes for the 95 % intervals")
    boundary: int = Field(4, ge=1, le=50, description="pixels this close to another label count as boundary [pixel]")
    worst: int = Field(6, ge=1, le=50, description="number of worst frames to show")
    real_frames: str | None = Field(
        None, description="directory of 16-bit depth PNGs and their intrinsics, whose labels are drawn"
    )
    ranges_m: tuple[float, ...] = Field(
        (0.0, 1.0, 2.0, 3.0, 4.0, 6.0), min_length=2, description="edges of the ranges by which figures are listed [m]"
    )
