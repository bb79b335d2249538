"""DeepLabV3+ on depth images: what a foot may step on (QuadPiPS, section V-B7; Chen et al., ECCV 2018).

The network takes raw depth in metres, with zeros, NaN and infinities. Its first layer, which is exported with it, turns
depth into features and marks the pixels without a return.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from legtool.configs.steppability import NetworkSettings
from legtool.models.encoders import MobileEncoder, ResidualEncoder, separable
from legtool_runtime.perception import LABELS
from legtool_runtime.perception.camera import Camera

#: Labels that the network distinguishes; pixels without a return are unknown.
CLASSES = LABELS[1:]
#: Depths nearer or farther than these count as no return [m].
NEAREST, FARTHEST = 0.05, 50.0


class DepthFeatures(nn.Module):
    """Three channels from depth: 1/z, height, and how far up the surface faces.

    1/z is linear in the pixel over any plane, so that flat faces appear as straight lines. The height is measured above
    the ground on which the robot nominally stands, and up is defined by the nominal pitch; because of camera jitter,
    both are only approximate. The slope of 1/z is computed after a blur over the returns, to suppress noise.
    """

    def __init__(self, camera: Camera, *, pitch: float, height: float) -> None:
        """Store the camera.

        Args:
            camera: the camera of the images, after their preparation.
            pitch: nominal pitch, positive downwards [rad].
            height: nominal height above the ground [m].
        """
        super().__init__()
        self.rows: Tensor
        self.columns: Tensor
        self.blur: Tensor
        rows = (torch.arange(camera.height, dtype=torch.float32) - camera.cy) / camera.fy
        columns = (torch.arange(camera.width, dtype=torch.float32) - camera.cx) / camera.fx
        binomial = torch.tensor([1.0, 4.0, 6.0, 4.0, 1.0]) / 16
        self.register_buffer("rows", rows.reshape(1, 1, -1, 1), persistent=False)
        self.register_buffer("columns", columns.reshape(1, 1, 1, -1), persistent=False)
        self.register_buffer("blur", torch.outer(binomial, binomial).reshape(1, 1, 5, 5), persistent=False)
        self.focal = (float(camera.fx), float(camera.fy))
        self.down = (float(np.cos(pitch)), float(np.sin(pitch)))
        self.height = float(height)

    def forward(self, depth: Tensor) -> tuple[Tensor, Tensor]:
        """Return features (n, 3, h, w) and the mask (n, 1, h, w) of returns, for depth (n, 1, h, w) [m].

        The image may contain only every second, third, … row and column.
        """
        known = (depth > NEAREST) & (depth < FARTHEST)
        mask = known.to(depth.dtype)
        z = torch.where(known, depth, torch.ones_like(depth))
        step = self.rows.shape[2] // depth.shape[2]
        rows, columns = self.rows[:, :, ::step], self.columns[:, :, :, ::step]
        c, s = self.down
        height = torch.clamp((self.height - z * (rows * c + s)) * 2.0, -3.0, 3.0)
        up = torch.where(known, self._up(1.0 / z, mask, rows, columns, step), torch.full_like(depth, -1.5))
        return torch.cat([(1.0 / z - 0.6) * 2.0 * mask, height * mask, up], dim=1), known

    def _up(self, inverse: Tensor, mask: Tensor, rows: Tensor, columns: Tensor, step: int) -> Tensor:
        """Cosine of the angle between normal and up: equation 8 in slopes of 1/z, see ``perception.normals``."""
        sums = functional.conv2d(torch.cat([inverse * mask, mask]), self.blur, padding=2)
        total, weight = torch.chunk(sums, 2)
        smooth = functional.pad(total / torch.clamp(weight, min=1e-3), (1, 1, 1, 1), mode="replicate")
        # Where nothing is near the slope means nothing; the mask tells.
        middle = torch.clamp(smooth[:, :, 1:-1, 1:-1], min=1e-3)
        x = (smooth[:, :, 1:-1, 2:] - smooth[:, :, 1:-1, :-2]) * (0.5 / step * self.focal[0]) / middle
        y = (smooth[:, :, 2:, 1:-1] - smooth[:, :, :-2, 1:-1]) * (0.5 / step * self.focal[1]) / middle
        along = 1.0 - columns * x - rows * y
        c, s = self.down
        return (c * y + s * along) / torch.sqrt(x * x + y * y + along * along + 1e-6)


class AtrousPooling(nn.Module):
    """Context at several scales: dilated convolutions, and the mean of the whole image."""

    def __init__(self, inputs: int, channels: int, rates: Sequence[int]) -> None:
        super().__init__()
        self.point = nn.Sequential(nn.Conv2d(inputs, channels, 1, bias=False), nn.BatchNorm2d(channels), nn.ReLU())
        self.atrous = nn.ModuleList(separable(inputs, channels, dilation=rate) for rate in rates)
        self.whole = nn.Sequential(nn.Conv2d(inputs, channels, 1), nn.ReLU())
        self.project = nn.Sequential(
            nn.Conv2d(channels * (2 + len(rates)), channels, 1, bias=False), nn.BatchNorm2d(channels), nn.ReLU()
        )

    def forward(self, x: Tensor) -> Tensor:
        """Return (n, channels, h, w) for features (n, inputs, h, w)."""
        whole = self.whole(x.mean(dim=(2, 3), keepdim=True)).expand(-1, -1, x.shape[2], x.shape[3])
        return self.project(torch.cat([self.point(x), *(branch(x) for branch in self.atrous), whole], dim=1))


class SteppabilityNet(nn.Module):
    """The segmentation network: logits of the classes at every pixel."""

    def __init__(self, settings: NetworkSettings, camera: Camera, *, pitch: float, height: float) -> None:
        """Build the network with random weights.

        Args:
            settings: encoder and sizes.
            camera, pitch, height: of the images, as for DepthFeatures.
        """
        super().__init__()
        self.features = DepthFeatures(camera, pitch=pitch, height=height)
        if settings.encoder == "resnet":
            self.encoder: nn.Module = ResidualEncoder(
                settings.depth, settings.width, stem_stride=settings.stem_stride, output_stride=settings.output_stride
            )
        else:
            self.encoder = MobileEncoder(settings.width, output_stride=settings.output_stride)
        low, high = self.encoder.channels
        # A third of the paper's rates, which are for images of 513 pixels and would reach beyond ours.
        rates = [rate * 16 // settings.output_stride for rate in (2, 4, 8)]
        self.pooling = AtrousPooling(high, settings.pooling_channels, rates)
        fine = max(settings.decoder_channels // 3, 8)
        self.fine = nn.Sequential(nn.Conv2d(low, fine, 1, bias=False), nn.BatchNorm2d(fine), nn.ReLU())
        self.decoder = nn.Sequential(
            separable(settings.pooling_channels + fine, settings.decoder_channels),
            separable(settings.decoder_channels, settings.decoder_channels),
            nn.Conv2d(settings.decoder_channels, len(CLASSES), 1),
        )
        #: Added to the logits after training and chosen for IoU, whereas the class weights of the loss serve learning.
        self.offset: Tensor
        self.register_buffer("offset", torch.zeros(len(CLASSES)))

    def forward(self, depth: Tensor) -> Tensor:
        """Return logits (n, 3, h, w) of CLASSES for depth (n, 1, h, w) [m]; only evaluation mode adds the offset."""
        features, _ = self.features(depth)
        low, high = self.encoder(features)
        context = functional.interpolate(self.pooling(high), low.shape[2:], mode="bilinear", align_corners=False)
        logits = self.decoder(torch.cat([context, self.fine(low)], dim=1))
        if not self.training:
            logits = logits + self.offset.reshape(1, -1, 1, 1)
        return functional.interpolate(logits, depth.shape[2:], mode="bilinear", align_corners=False)


class SegmenterNet(nn.Module):
    """The network that is exported: it takes depth and returns labels and logits."""

    def __init__(self, net: SteppabilityNet) -> None:
        super().__init__()
        self.net = net

    def forward(self, depth: Tensor) -> tuple[Tensor, Tensor]:
        """Return labels (n, h, w) uint8, indices into LABELS and 0 without a return, and logits (n, 3, h, w)."""
        logits = self.net(depth)
        known = ((depth > NEAREST) & (depth < FARTHEST))[:, 0]
        labels = torch.argmax(logits, dim=1) + 1
        return torch.where(known, labels, torch.zeros_like(labels)).to(torch.uint8), logits
