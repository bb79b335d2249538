"""Settings of the steppability segmenter: its network, its training, its evaluation. The defaults suit a CPU."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from legtool.configs.settings import Settings

#: Presets for ``--config``: ``full.yaml`` is meant for a GPU.
PRESETS = Path(__file__).parent / "steppability"


class NetworkSettings(Settings):
    """DeepLabV3+: an encoder, atrous pooling, and a decoder that brings back fine features."""

    encoder: Literal["resnet", "mobile"] = Field("resnet", description="residual, or inverted residual (MobileNetV2)")
    depth: Literal[10, 18, 34, 50] = Field(10, description="layers of the residual encoder")
    width: int = Field(16, ge=8, le=128, multiple_of=4, description="channels of its first stage; 64 is the usual one")
    stem_stride: Literal[2, 4] = Field(2, description="4: with the usual pooling after the first convolution")
    output_stride: Literal[8, 16, 32] = Field(16, description="input pixels to one pixel of the deepest features")
    pooling_channels: int = Field(48, ge=16, le=512, description="of the atrous pooling")
    decoder_channels: int = Field(32, ge=16, le=512)

    @model_validator(mode="after")
    def _check(self) -> NetworkSettings:
        if self.encoder == "mobile" and self.stem_stride == 4:
            raise ValueError("stem_stride 4 is for the residual encoder; the mobile one takes 2")
        return self


class SteppabilityTrainSettings(Settings):
    """Training of the segmenter."""

    seed: int = Field(0, ge=0)
    network: NetworkSettings = Field(default_factory=NetworkSettings)
    encoder_weights: str | None = Field(None, description="file of encoder weights under torchvision's names (.pt)")
    epochs: int = Field(12, ge=1, le=10_000)
    coarse_epochs: int = Field(4, ge=0, le=10_000, description="first epochs on every second pixel")
    batch: int = Field(8, ge=1, le=1024)
    learning_rate: float = Field(3e-3, gt=0, le=1, description="at the start; falls as (1 - t)^0.9 (poly)")
    weight_decay: float = Field(1e-2, ge=0, le=1)
    loss: Literal["class_weighted", "hard_pixels"] = Field("class_weighted")
    hard_share: float = Field(0.3, gt=0, le=1, description="hard_pixels: share of a batch's pixels that count")
    augment: bool = Field(True, description="mirror, scale, add noise and voids")
    bf16: bool | None = Field(None, description="train in bfloat16; none: where the device has it")
    device: Literal["auto", "cpu", "cuda"] = "auto"

    @model_validator(mode="after")
    def _check(self) -> SteppabilityTrainSettings:
        if self.coarse_epochs >= self.epochs and self.coarse_epochs > 0:
            raise ValueError(f"coarse_epochs {self.coarse_epochs}: expected fewer than the {self.epochs} epochs in all")
        return self


class SteppabilityEvalSettings(Settings):
    """Evaluation of the segmenter on the test scenes."""

    seed: int = Field(0, ge=0)
    bootstrap: int = Field(1000, ge=100, le=100_000, description="resamples of scenes for 95 % intervals")
    boundary: int = Field(4, ge=1, le=50, description="pixels within this of another label are boundary")
    worst: int = Field(6, ge=1, le=50, description="worst frames to show")
    real_frames: str | None = Field(
        None, description="directory of 16-bit depth PNGs and their intrinsics, to be drawn"
    )
    ranges_m: tuple[float, ...] = Field((0.0, 1.0, 2.0, 3.0, 4.0, 6.0), min_length=2, description="edges [m]")
