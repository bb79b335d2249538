"""Networks of the foothold line: the paper's two CNNs, and a dense one that predicts the safe map for every hip height.

All take the heights (n, 1, 33, 33) above the map's median [m], NaN where unknown, and the vector (n, 26) of
:mod:`legtool_runtime.foothold.features`, unscaled.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from legtool_runtime.foothold.basis import RadialBasis
from legtool_runtime.foothold.features import FEATURES, PAPER, cell_centers
from legtool_runtime.foothold.settings import SIZE

CELLS = SIZE * SIZE
#: By which heights are divided [m], and to how many of these they are clipped.
_HEIGHT, _CLIP = 0.15, 4.0


class Prepare(nn.Module):
    """Heights into two channels, height and whether it is known; the vector to size one."""

    scale: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("scale", torch.tensor([size for _, size in FEATURES]))

    def forward(self, heights: Tensor, vector: Tensor) -> tuple[Tensor, Tensor]:
        """(n, 2, 33, 33) and (n, 26)."""
        unknown = torch.isnan(heights)
        scaled = torch.where(unknown, 0.0, heights).div(_HEIGHT).clamp(-_CLIP, _CLIP)
        return torch.cat([scaled, (~unknown).to(heights.dtype)], dim=1), vector / self.scale


def _trunk(width: int) -> nn.Sequential:
    """Three 5 × 5 convolutions, padding 2, Leaky ReLU, 2 × 2 max-pooling each (appendix A)."""
    layers: list[nn.Module] = []
    channels = [2, width, 2 * width, 4 * width]
    for before, after in pairwise(channels):
        layers += [nn.Conv2d(before, after, 5, padding=2), nn.LeakyReLU(), nn.MaxPool2d(2)]
    return nn.Sequential(*layers, nn.Flatten())


class PaperVfa(nn.Module):
    """The paper's VFA: which cell is the optimal foothold; one class more says that none is safe."""

    def __init__(self, width: int = 16) -> None:
        super().__init__()
        self.prepare = Prepare()
        self.trunk = _trunk(width)
        self.head = nn.Sequential(nn.Linear(64 * width + PAPER, 128), nn.LeakyReLU(), nn.Linear(128, CELLS + 1))

    def forward(self, heights: Tensor, vector: Tensor) -> Tensor:
        """(n, 1090) logits, by cell ix · 33 + iy; the last: none."""
        image, scaled = self.prepare(heights, vector)
        out: Tensor = self.head(torch.cat([self.trunk(image), scaled[:, :PAPER]], dim=1))
        return out


class PaperVpa(nn.Module):
    """The paper's VPA: weights of the safe-foothold function; the gait is fed beside the twist."""

    def __init__(self, width: int = 16, functions: int = 30) -> None:
        super().__init__()
        self.prepare = Prepare()
        self.trunk = _trunk(width)
        self.motion = nn.Sequential(nn.Linear(PAPER - 1, 32), nn.LeakyReLU())
        self.head = nn.Sequential(nn.Linear(64 * width + 32, 256), nn.LeakyReLU(), nn.Linear(256, functions))

    def forward(self, heights: Tensor, vector: Tensor) -> Tensor:
        """(n, E) weights, for numbers of safe footholds over hip heights above the map's median."""
        image, scaled = self.prepare(heights, vector)
        # Twist, gait and front or hind; the hip height is what the function is of.
        motion = self.motion(scaled[:, 1:PAPER])
        out: Tensor = self.head(torch.cat([self.trunk(image), motion], dim=1)) * CELLS
        return out


class Dense(nn.Module):
    """The safe map for every hip height at once.

    Of each cell it predicts whether terrain and swing path allow it at all, and between which hip heights the leg does:
    the probability that it is safe with the hip at z is σ(a) σ((z - low) / τ) σ((high - z) / τ).
    """

    cells: Tensor

    def __init__(self, width: int = 16) -> None:
        super().__init__()
        self.prepare = Prepare()
        w, features = width, len(FEATURES)
        self.register_buffer("cells", torch.from_numpy(cell_centers())[None])
        self.first = nn.Conv2d(8, w, 3, padding=1)
        self.shift_first = nn.Linear(features, w)
        self.second = nn.Conv2d(w, w, 3, padding=1)
        self.down = nn.Conv2d(w, 2 * w, 3, stride=2, padding=1)
        self.shift_down = nn.Linear(features, 2 * w)
        self.wide = nn.ModuleList([nn.Conv2d(2 * w, 2 * w, 3, padding=d, dilation=d) for d in (1, 2, 3)])
        self.join = nn.Conv2d(8 + 3 * w, 3 * w, 1)
        self.shift_join = nn.Linear(features, 3 * w)
        self.mix = nn.Conv2d(3 * w, 3 * w, 1)
        self.last = nn.Conv2d(3 * w, 3, 1)
        self.sharpness = nn.Parameter(torch.tensor(3.0))

    def bounds(self, heights: Tensor, vector: Tensor) -> Tensor:
        """(n, 3, 33, 33) a, low and high [m above the map's median]."""
        image, scaled = self.prepare(heights, vector)
        names = [name for name, _ in FEATURES]
        hip = vector[:, names.index("hip_x_m") : names.index("hip_x_m") + 2, None, None]
        lift = vector[:, names.index("lift_off_x_m") : names.index("lift_off_x_m") + 2, None, None]
        from_hip, from_lift = (self.cells - hip) / 0.3, (self.cells - lift) / 0.3
        image = torch.cat([image, from_hip, from_lift, from_hip.square()], dim=1)
        # The bounds hold for every hip height: the one of the tuple is not looked at.
        motion = torch.cat([torch.zeros_like(scaled[:, :1]), scaled[:, 1:]], dim=1)
        x = functional.leaky_relu(self.first(image) + self.shift_first(motion)[:, :, None, None])
        x = x + functional.leaky_relu(self.second(x))
        deep = functional.leaky_relu(self.down(x) + self.shift_down(motion)[:, :, None, None])
        for layer in self.wide:
            deep = deep + functional.leaky_relu(layer(deep))
        up = functional.interpolate(deep, size=(SIZE, SIZE), mode="nearest")
        y = self.join(torch.cat([image, x, up], dim=1)) + self.shift_join(motion)[:, :, None, None]
        y = functional.leaky_relu(y)
        y = y + functional.leaky_relu(self.mix(y))
        out = self.last(y).float()
        ground = torch.where(torch.isnan(heights), 0.0, heights)
        low = ground + 0.3 + 0.3 * out[:, 1:2]
        return torch.cat([4.0 * out[:, :1], low, low + 0.3 * functional.softplus(1.0 + out[:, 2:3])], dim=1)

    def log_safe(self, bounds: Tensor, hip_height: Tensor) -> Tensor:
        """Logarithm of the probability that cells are safe, for hip heights that broadcast against (n, 33, 33)."""
        sharp = self.sharpness.exp() * 5.0
        log = functional.logsigmoid
        a, low, high = bounds.unbind(dim=1)
        return log(a) + log((hip_height - low) * sharp) + log((high - hip_height) * sharp)

    def counts(self, bounds: Tensor, hip_heights: Tensor) -> Tensor:
        """(n, m) expected numbers of safe footholds over hip heights (n, m) or (1, m) above the map's median [m]."""
        sharp = self.sharpness.exp() * 5.0
        a, low, high = (x.flatten(1)[:, None] for x in bounds.unbind(dim=1))
        z = hip_heights[:, :, None]
        safe = torch.sigmoid(a) * torch.sigmoid((z - low) * sharp) * torch.sigmoid((high - z) * sharp)
        return safe.sum(dim=2)

    def forward(self, heights: Tensor, vector: Tensor) -> Tensor:
        """(n, 33, 33) probability that each cell is safe with the hip at the vector's height."""
        return self.log_safe(self.bounds(heights, vector), vector[:, :1, None]).exp()


class DenseCounts(nn.Module):
    """A trained dense network as counts over a fixed set of hip heights, for export."""

    hip_heights: Tensor

    def __init__(self, dense: Dense, hip_heights: np.ndarray) -> None:
        super().__init__()
        self.dense = dense
        self.register_buffer("hip_heights", torch.tensor(hip_heights, dtype=torch.float32)[None])

    def forward(self, heights: Tensor, vector: Tensor) -> Tensor:
        """(n, 31) counts."""
        return self.dense.counts(self.dense.bounds(heights, vector), self.hip_heights)


def basis_matrix(hip_heights: np.ndarray) -> Tensor:
    """(31, E) values of the basis functions at the set of hip heights."""
    basis = RadialBasis(float(hip_heights[0]), float(hip_heights[-1]))
    return torch.tensor(basis.functions(hip_heights), dtype=torch.float32)


def build_network(task: str, network: str, width: int) -> nn.Module:
    """The network of a task (``vfa`` or ``vpa``): the paper's, or the dense one that serves both."""
    if network == "dense":
        return Dense(width)
    return PaperVfa(width) if task == "vfa" else PaperVpa(width)
