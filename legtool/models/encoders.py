"""Encoders of any width: a ResNet and a MobileNetV2, whose weights have the names that torchvision uses."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from legtool.errors import DatasetError

#: Blocks in each stage of the residual encoder.
_STAGES = {10: (1, 1, 1, 1), 18: (2, 2, 2, 2), 34: (3, 4, 6, 3), 50: (3, 4, 6, 3)}
#: MobileNetV2: expansion, channels, repeats, stride.
_INVERTED = ((1, 16, 1, 1), (6, 24, 2, 2), (6, 32, 3, 2), (6, 64, 4, 2), (6, 96, 3, 1), (6, 160, 3, 2), (6, 320, 1, 1))


def separable(inputs: int, outputs: int, *, dilation: int = 1) -> nn.Sequential:
    """Return a depthwise 3 × 3 and a pointwise convolution, both normalised, the second with an activation."""
    return nn.Sequential(
        nn.Conv2d(inputs, inputs, 3, padding=dilation, dilation=dilation, groups=inputs, bias=False),
        nn.BatchNorm2d(inputs),
        nn.Conv2d(inputs, outputs, 1, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(),
    )


class _Basic(nn.Module):
    expansion = 1

    def __init__(self, inputs: int, planes: int, stride: int, dilation: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, planes, 3, stride, dilation, dilation, bias=False)
        self.bn1 = nn.BatchNorm2d(planes)
        self.conv2 = nn.Conv2d(planes, planes, 3, 1, dilation, dilation, bias=False)
        self.bn2 = nn.BatchNorm2d(planes)
        self.relu = nn.ReLU()
        self.downsample = _shortcut(inputs, planes, stride)

    def forward(self, x: Tensor) -> Tensor:
        y = self.bn2(self.conv2(self.relu(self.bn1(self.conv1(x)))))
        return self.relu(y + self.downsample(x))


class _Bottleneck(nn.Module):
    expansion = 4

    def __init__(self, inputs: int, planes: int, stride: int, dilation: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, planes, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(planes)
        self.conv2 = nn.Conv2d(planes, planes, 3, stride, dilation, dilation, bias=False)
        self.bn2 = nn.BatchNorm2d(planes)
        self.conv3 = nn.Conv2d(planes, 4 * planes, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(4 * planes)
        self.relu = nn.ReLU()
        self.downsample = _shortcut(inputs, 4 * planes, stride)

    def forward(self, x: Tensor) -> Tensor:
        y = self.relu(self.bn2(self.conv2(self.relu(self.bn1(self.conv1(x))))))
        return self.relu(self.bn3(self.conv3(y)) + self.downsample(x))


def _shortcut(inputs: int, outputs: int, stride: int) -> nn.Module:
    if stride == 1 and inputs == outputs:
        return nn.Identity()
    return nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs))


class ResidualEncoder(nn.Module):
    """ResNet. Stages beyond the output stride keep their resolution and use dilated convolutions instead."""

    def __init__(self, depth: int, width: int, *, stem_stride: int, output_stride: int) -> None:
        """Build the encoder with random weights.

        Args:
            depth: number of layers, 10, 18, 34 or 50.
            width: channels of the first stage.
            stem_stride: 4 to pool after the first convolution, 2 not to.
            output_stride: stride of the deepest features.
        """
        super().__init__()
        block = _Bottleneck if depth == 50 else _Basic
        self.conv1 = nn.Conv2d(3, width, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.relu = nn.ReLU()
        self.maxpool = nn.MaxPool2d(3, 2, 1) if stem_stride == 4 else nn.Identity()
        inputs, reached, dilation = width, stem_stride, 1
        for number, repeats in enumerate(_STAGES[depth]):
            stride = 1 if number == 0 else 2
            if reached * stride > output_stride:
                dilation *= stride
                stride = 1
            reached *= stride
            planes = width * 2**number
            blocks = [block(inputs, planes, stride, dilation)]
            inputs = planes * block.expansion
            blocks += [block(inputs, planes, 1, dilation) for _ in range(repeats - 1)]
            self.add_module(f"layer{number + 1}", nn.Sequential(*blocks))
        #: Channels of the fine and of the deepest features.
        self.channels = (width * block.expansion, inputs)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Fine features, and the deepest ones."""
        # Layers are added by number, so that their types are lost.
        low = self.layer1(self.maxpool(self.relu(self.bn1(self.conv1(x)))))  # type: ignore[operator]
        return low, self.layer4(self.layer3(self.layer2(low)))  # type: ignore[operator]


class _InvertedResidual(nn.Module):
    def __init__(self, inputs: int, outputs: int, stride: int, expansion: int, dilation: int) -> None:
        super().__init__()
        hidden = inputs * expansion
        layers: list[nn.Module] = []
        if expansion != 1:
            layers.append(_normed(inputs, hidden, 1))
        layers += [_normed(hidden, hidden, 3, stride=stride, groups=hidden, dilation=dilation)]
        layers += [nn.Conv2d(hidden, outputs, 1, bias=False), nn.BatchNorm2d(outputs)]
        self.conv = nn.Sequential(*layers)
        self.residual = stride == 1 and inputs == outputs

    def forward(self, x: Tensor) -> Tensor:
        return x + self.conv(x) if self.residual else self.conv(x)


def _normed(
    inputs: int, outputs: int, kernel: int, *, stride: int = 1, groups: int = 1, dilation: int = 1
) -> nn.Sequential:
    padding = dilation * (kernel - 1) // 2
    convolution = nn.Conv2d(inputs, outputs, kernel, stride, padding, dilation, groups, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(outputs), nn.ReLU6())


class MobileEncoder(nn.Module):
    """MobileNetV2 up to its last inverted residual; fine features at stride 2."""

    def __init__(self, width: int, *, output_stride: int) -> None:
        """Build the encoder; ``width`` is the number of channels of the first convolution, usually 32."""
        super().__init__()

        def scaled(channels: int) -> int:
            return max(8, round(channels * width / 32 / 8) * 8)

        inputs, reached, dilation = scaled(32), 2, 1
        layers: list[nn.Module] = [_normed(3, inputs, 3, stride=2)]
        for expansion, channels, repeats, stage_stride in _INVERTED:
            stride = stage_stride
            if reached * stride > output_stride:
                dilation *= stride
                stride = 1
            reached *= stride
            for number in range(repeats):
                layers.append(
                    _InvertedResidual(inputs, scaled(channels), stride if number == 0 else 1, expansion, dilation)
                )
                inputs = scaled(channels)
        self.features: nn.Sequential = nn.Sequential(*layers)
        self.channels = (scaled(16), inputs)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Fine features, and the deepest ones."""
        low = self.features[1](self.features[0](x))
        return low, self.features[2:](low)


def load_encoder_weights(encoder: nn.Module, path: Path) -> int:
    """Load weights under torchvision's names from a local file; its classifier is left out.

    Returns:
        how many tensors were loaded.

    Raises:
        DatasetError: there is no such file, it is not a file of tensors, or its weights fit another encoder or width.
    """
    try:
        loaded = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise DatasetError(f"{path}: no such file of encoder weights") from error
    except Exception as error:
        raise DatasetError(f"{path}: not a PyTorch file of tensors; save a state_dict with torch.save") from error
    weights: Mapping[str, Tensor] = loaded.get("state_dict", loaded) if isinstance(loaded, dict) else {}
    own = encoder.state_dict()
    taken = {name: tensor for name, tensor in weights.items() if name in own}
    if missing := [name for name in own if name not in taken and not name.endswith("num_batches_tracked")]:
        raise DatasetError(
            f"{path}: lacks {missing[0]}; expected the weights of this encoder under torchvision's names"
        )
    for name, tensor in taken.items():
        if tensor.shape != own[name].shape:
            raise DatasetError(
                f"{path}: {name} has shape {tuple(tensor.shape)}, expected {tuple(own[name].shape)}; "
                "set network.depth and network.width to those of the file (usual width: 64, of the mobile one 32)"
            )
    encoder.load_state_dict(taken, strict=False)
    return len(taken)
