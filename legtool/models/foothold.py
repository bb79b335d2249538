"""Networks of the foothold line: the paper's two CNNs, and a dense one that predicts the safe map for every hip height.

All take what :class:`legtool_runtime.foothold.features.Inputs` holds: heights (n, 1, 33, 33) above the map's median
[m], NaN where unknown, and the vector (n, 29), unscaled. The paper's networks take a coarse check beside it, which the
layers of its appendix A learn to correct: alone, these were seen to learn the robot's geometry slowly and roughly.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from legtool.models.cues import CUES, Cues, Told
from legtool_runtime.foothold.basis import RadialBasis
from legtool_runtime.foothold.features import FEATURES, HIPS, PAPER
from legtool_runtime.foothold.settings import SIZE, CriteriaSettings, hip_heights
from legtool_runtime.robot import Robot

CELLS = SIZE * SIZE
#: By which heights are divided [m], and to how many of these they are clipped.
_HEIGHT, _CLIP = 0.15, 4.0
#: A usual number of safe footholds.
_MANY = 100.0
#: Logit of what is never safe.
_NEVER = 30.0
#: How sharply what geometry says in closed form divides safe from unsafe: hip heights within reach, and the foot's path
#: above the terrain [1/m].
_SHARP_REACH, _SHARP_PATH = 2000.0, 20_000.0


class Prepare(nn.Module):
    """Heights to size one, unknown ones zero; the vector to size one."""

    scale: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("scale", torch.tensor([size for _, size in FEATURES]))

    def forward(self, heights: Tensor, vector: Tensor) -> tuple[Tensor, Tensor]:
        """(n, 1, 33, 33) and (n, 29)."""
        known = torch.where(torch.isnan(heights), 0.0, heights)
        return known.div(_HEIGHT).clamp(-_CLIP, _CLIP), vector / self.scale


def _trunk(channels: int, width: int) -> nn.Sequential:
    """Three 5 × 5 convolutions, padding 2, Leaky ReLU, 2 × 2 max-pooling each (appendix A)."""
    layers: list[nn.Module] = []
    for before, after in pairwise([channels, width, 2 * width, 4 * width]):
        layers += [nn.Conv2d(before, after, 5, padding=2), nn.LeakyReLU(), nn.MaxPool2d(2)]
    return nn.Sequential(*layers, nn.Flatten())


def _head(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    """Two layers (appendix A), which at first correct nothing."""
    last = nn.Linear(hidden, outputs)
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    return nn.Sequential(nn.Linear(inputs, hidden), nn.LeakyReLU(), last)


class PaperVfa(nn.Module):
    """The paper's VFA: which cell is the optimal foothold; one class more says that none is safe."""

    def __init__(self, width: int = 4) -> None:
        super().__init__()
        self.prepare = Prepare()
        self.trunk = _trunk(2, width)
        self.head = _head(64 * width + PAPER, 64, CELLS + 1)
        #: How much the coarse check is believed.
        self.trust = nn.Parameter(torch.tensor(8.0))

    def forward(self, heights: Tensor, vector: Tensor, coarse: Tensor) -> Tensor:
        """(n, 1090) logits, by cell ix · 33 + iy; the last: none."""
        image, scaled = self.prepare(heights, vector)
        seen = self.trunk(torch.cat([image, coarse[:, None]], dim=1))
        near = coarse.flatten(1)
        none = 2.0 * (near.amax(dim=1, keepdim=True) == 0)
        out: Tensor = self.head(torch.cat([seen, scaled[:, :PAPER]], dim=1))
        return out + self.trust * torch.cat([near, none], dim=1)


class PaperVpa(nn.Module):
    """The paper's VPA: weights of the safe-foothold function; the gait is fed beside the twist."""

    fit: Tensor

    def __init__(self, robot: Robot, width: int = 4) -> None:
        super().__init__()
        self.prepare = Prepare()
        self.trunk = _trunk(1, width)
        hips = hip_heights(robot, HIPS)
        # Weights for counts: the fit is linear.
        fit = RadialBasis(float(hips[0]), float(hips[-1])).fit(hips, np.eye(HIPS))
        self.register_buffer("fit", torch.tensor(fit, dtype=torch.float32))
        self.motion = nn.Sequential(nn.Linear(PAPER - 1 + 2 * HIPS, 64), nn.LeakyReLU())
        self.head = _head(64 * width + 64, 128, fit.shape[1])

    def forward(self, heights: Tensor, vector: Tensor, coarse: Tensor) -> Tensor:
        """(n, E) weights, for numbers of safe footholds over hip heights above the map's median."""
        image, scaled = self.prepare(heights, vector)
        # Twist, gait and front or hind; the hip height is what the function is of.
        motion = self.motion(torch.cat([scaled[:, 1:PAPER], coarse.flatten(1) / _MANY], dim=1))
        out: Tensor = self.head(torch.cat([self.trunk(image), motion], dim=1)) * _MANY
        return out + coarse[:, 0] @ self.fit


class Dense(nn.Module):
    """The safe map for every hip height at once, cell by cell from its :class:`legtool.models.cues.Cues`.

    Of each cell it holds whether terrain and swing path allow it at all, and between which hip heights the leg keeps
    its limits and stays clear of the terrain: the probability that it is safe with the hip at z is
    σ(a) σ(k (z - low)) σ(k (high - z)) σ(s (z - free)). The first three follow from geometry; of the last, below which
    the leg collides, geometry gives an estimate that the network learns to correct.
    """

    scale: Tensor

    def __init__(self, robot: Robot, criteria: CriteriaSettings, width: int = 96) -> None:
        super().__init__()
        self.cues = Cues(robot, criteria)
        self.register_buffer("scale", torch.tensor([size for _, size in FEATURES]))
        self.first = nn.Linear(CUES, width)
        self.motion = nn.Linear(len(FEATURES), width)
        self.hidden = nn.ModuleList([nn.Linear(width, width) for _ in range(2)])
        self.last = nn.Linear(width, 4)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)
        self.sharpness = nn.Parameter(torch.tensor(7.0))

    def judge(self, told: Told, vector: Tensor) -> Tensor:
        """(n, 4, p) a, low, high and free [m above the map's median] of cells, their neighbours not looked at."""
        y = functional.silu(self.first(told.cues) + self.motion(vector / self.scale)[:, None])
        for layer in self.hidden:
            y = y + functional.silu(layer(y))
        ankle, upper, little, much = self.last(y).float().unbind(dim=-1)
        # By how much a higher hip lifts the leg is learned: at first the upper leg by half, as the knee, the rest less.
        room = torch.minimum(
            (told.ankle - 0.02 * ankle) / functional.softplus(4 * little - 2.25),
            (told.upper - 0.02 * upper) / functional.softplus(4 * much - 0.43),
        )
        return torch.stack([_SHARP_PATH * told.clear, told.low, told.high, vector[:, :1] - room], dim=1)

    def bounds(self, heights: Tensor, vector: Tensor) -> Tensor:
        """(n, 4, 33, 33) a, low, high and free [m above the map's median], such that they hold for the cells around."""
        told = self.cues(heights, vector)
        a, low, high, free = self.judge(told, vector).unflatten(2, (SIZE, SIZE)).unbind(dim=1)
        a = torch.where(told.smooth & ~torch.isnan(heights[:, 0]), a, -_NEVER)
        erode = self.cues.erode
        low, free = (-erode(-bound, outside=0.0) for bound in (low, free))
        return torch.stack([erode(a, outside=-_NEVER), low, erode(high, outside=0.0), free], dim=1)

    def log_safe(self, bounds: Tensor, hip_height: Tensor) -> Tensor:
        """Logarithm of the probability that cells are safe, for hip heights that broadcast against (n, ...) cells."""
        log = functional.logsigmoid
        a, low, high, free = bounds.unbind(dim=1)
        reached = log((hip_height - low) * _SHARP_REACH) + log((high - hip_height) * _SHARP_REACH)
        return log(a) + reached + log(self.clear(free, hip_height))

    def clear(self, free: Tensor, hip_height: Tensor) -> Tensor:
        """Logit of the probability that the leg stays clear of the terrain."""
        return (hip_height - free) * self.sharpness.exp()

    def counts(self, bounds: Tensor, hip_heights: Tensor) -> Tensor:
        """(n, m) expected numbers of safe footholds over hip heights (n, m) or (1, m) above the map's median [m]."""
        safe = self.log_safe(bounds.flatten(2)[:, :, None], hip_heights[:, :, None]).exp()
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


def build_network(task: str, network: str, width: int, robot: Robot, criteria: CriteriaSettings) -> nn.Module:
    """The network of a task (``vfa`` or ``vpa``): the paper's, or the dense one that serves both."""
    if network == "dense":
        return Dense(robot, criteria, 6 * width)
    return PaperVfa(width) if task == "vfa" else PaperVpa(robot, width)
