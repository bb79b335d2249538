"""Inputs of the dense foothold network for each cell: what the robot's legs reach, and the terrain along their way.

Nothing here is learned. Roughness (TR), reach and joint limits (KF) and the erosion of Remark 1 follow from geometry in
closed form. So does the height of foot and leg above the terrain (FC, LC) at some instants, with the leg bent for one
hip height. The network learns what this amounts to over the whole cycle and for other hip heights.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from legtool.models.leg_reach import PLACES, extents_of, inward, outward
from legtool_runtime.foothold.criteria import dilation
from legtool_runtime.foothold.features import FEATURES, cell_centers
from legtool_runtime.foothold.settings import RESOLUTION_M, SIZE, CriteriaSettings, leg_length
from legtool_runtime.robot import Robot

_NAMES = [name for name, _ in FEATURES]
#: Shares of the rest of the swing, and of the stance, at which the leg is checked; denser where the foot is fast.
_PHASES = (0.0, 0.094, 0.183, 0.257, 0.32, 0.377, 0.43, 0.481, 0.532, 0.585, 0.641, 0.704, 0.776, 0.864)
_STANCE = (0.0, 0.25, 0.5, 0.75, 1.0)
#: Indices of the instants whose leg positions are passed to the network directly.
_TOLD = (0, 7, 14, 18)
#: Shares of the way between the phases in which the foot may touch the terrain, at which its path is checked; denser
#: where the path is low. And the number of sub-cells per side of a cell in the lookup table.
_PATH = (0.0, 0.02, 0.05, 0.09, 0.14, 0.21, 0.3, 0.4, 0.5, 0.6, 0.7, 0.79, 0.86, 0.91, 0.95, 0.98, 1.0)
_FINE = 3
#: Points of the leg that are checked, as shares of the thigh from the knee up, of the shank from the ankle up, and of
#: the part below the ankle, where the leg is as thick as the foot, from the foot up. And the indices of the points, in
#: this order, that a higher hip lifts only a little.
_THIGH, _SHANK, _ANKLE = (0.17, 0.33, 0.5), (0.0, 0.2, 0.4, 0.6, 0.8, 1.0), (0.33, 0.67)
_LOW = (3, 4, 9, 10)
_FINE_LEG = 2
#: A height below all ground [m], which represents no ground.
_DEPTH = -10.0
#: Steps by which the least and greatest hip heights below a tilted trunk are refined.
_REFINED = 2
_NEIGHBOURS = [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (-1, 1), (1, -1), (1, 1)]
#: Number of inputs per cell.
CUES = 5 + len(_PATH) + 3 * len(_TOLD) + 2 + 1 + len(_PHASES + _STANCE) + len(_THIGH + _SHANK + _ANKLE)

Ball = tuple[list[tuple[int, int]], list[float]]


class Told(NamedTuple):
    """Geometry of p cells in each of n maps.

    Attributes:
        cues: (n, p, CUES) inputs of the network.
        low: (n, p) least hip height at which the leg stays within its limits on the way to the cell and on it [m].
        high: (n, p) greatest such hip height [m]; below ``low`` where there is none.
        clear: (n, p) least clearance of the swinging foot above the terrain [m].
        ankle: (n, p) least clearance of the lower leg, with the hip at the height in the vector [m].
        upper: (n, p) least clearance of the rest of the leg, likewise [m].
        smooth: (n, 33, 33) whether TR holds, for all cells.
    """

    cues: Tensor
    low: Tensor
    high: Tensor
    clear: Tensor
    ankle: Tensor
    upper: Tensor
    smooth: Tensor


class Cues(nn.Module):
    """Computes cues for the left legs of one robot and one set of criteria, from the inputs of the networks."""

    centers: Tensor
    legs: Tensor
    extents: Tensor
    phases: Tensor
    path: Tensor
    stance: Tensor

    def __init__(self, robot: Robot, criteria: CriteriaSettings) -> None:
        super().__init__()
        self.criteria, self.foot_radius = criteria, robot.foot_radius
        self.length = leg_length(robot)
        # Front and hind leg: offset, bend of the knee, and by which the foot's distance in the leg's plane is bounded.
        legs = []
        for leg in (0, 2):
            offset, (low, high) = robot.abduction_offset[leg], robot.joint_limits[leg, 0]
            lengths = robot.thigh_length[leg], robot.shank_length[leg]
            legs.append((offset, robot.knee_sign[leg], *lengths, *inward(offset, low), *outward(offset, high)))
        self.register_buffer("legs", torch.tensor(np.array(legs), dtype=torch.float32))
        extents = np.concatenate([extents_of(robot, leg, self.length) for leg in (0, 2)], axis=1)
        self.register_buffer("extents", torch.tensor(extents, dtype=torch.float32))
        self.register_buffer("centers", torch.from_numpy(cell_centers()).reshape(2, -1))
        self.register_buffer("phases", torch.tensor(_PHASES))
        self.register_buffer("path", torch.tensor(_PATH))
        self.register_buffer("stance", torch.tensor(_STANCE))
        self._thin, self._thick = _balls(robot.foot_radius, _FINE), _balls(criteria.leg_radius_m, _FINE_LEG)
        self._around = [(i, j) for i, j in dilation.disc(criteria.uncertainty_m, RESOLUTION_M).tolist()]

    @torch.no_grad()
    def forward(self, heights: Tensor, vector: Tensor, cells: Tensor | None = None) -> Told:
        """Return the cues of ``cells`` (n, p), numbered ix · 33 + iy, or of all cells.

        Args:
            heights: (n, 1, 33, 33) above the map's median, NaN where unknown [m].
            vector: (n, 29) of :mod:`legtool_runtime.foothold.features`.
            cells: numbers of the cells; None for all 1089, in order.
        """
        of = {name: vector[:, k, None] for k, name in enumerate(_NAMES)}
        h = heights[:, 0]
        filled, hind = _fill(h), (of["hind"] > 0.5).long()
        thin, thick = _dilate(filled, self._thin), _dilate(filled, self._thick)
        x, y = (center.expand(h.shape[0], -1) for center in self.centers)
        ground = filled.flatten(1)
        if cells is not None:
            x, y, ground = self.centers[0][cells], self.centers[1][cells], ground.gather(1, cells)
        z = ground + self.foot_radius
        lift = [of[f"lift_off_{axis}_m"] for axis in "xyz"]
        # The foot's way above the terrain, between the phases at which it may touch it; (n, p, k).
        begin, contact = of["swing_phase"], self.criteria.contact_phase
        free = begin.clamp(contact, 1 - contact)
        way = self._swing((free + (1 - contact - free) * self.path)[:, None], (x, y, z), lift)
        above = way[2] - _look_up(thin, *way[:2])
        clear = above.amin(dim=-1)
        # The foot in swing and stance, and the leg to it as seen from the moving hip.
        phase = (begin + (1 - begin) * self.phases)[:, None]
        stays = [end[..., None].expand(-1, -1, len(_STANCE)) for end in (x, y, z)]
        foot = [torch.cat(ways, dim=-1) for ways in zip(self._swing(phase, (x, y, z), lift), stays, strict=True)]
        tau = torch.cat([(phase[:, 0] - 1) * of["swing_s"], self.stance * of["stance_s"]], dim=1)
        hip = [
            (of[place] + of[f"hip_velocity_{axis}"] * tau)[:, None]
            for axis, place in zip("xyz", ("hip_x_m", "hip_y_m", "hip_height_m"), strict=True)
        ]
        trunk = _trunk(of["rate_z"] * tau, of["roll"], of["pitch"])
        rise = foot[2] - (of["hip_velocity_z"] * tau)[:, None]
        # As seen from a trunk whose hip is at height 0 at touchdown, and from there where it is.
        level = _into(trunk, (foot[0] - hip[0], foot[1] - hip[1], rise))
        along, aside, above_hip = (
            part - of["hip_height_m"][..., None] * up for part, up in zip(level, trunk[2], strict=True)
        )
        low, high = self._heights(level, trunk[2], of["hip_height_m"][..., None], hind)
        knee, axis = (
            [
                start + sum(column * part for column, part in zip(row, link, strict=True))
                for start, row in zip(hip, trunk, strict=True)
            ]
            for link in self._thighs(along, aside, above_hip, hind)
        )
        share_below = self.criteria.ankle_m / self.legs[hind, 3][..., None]
        spaces = [_space(knee, axis, share, thick) for share in _THIGH]
        spaces += [_space(foot, knee, share_below + (1 - share_below) * share, thick) for share in _SHANK]
        spaces += [_space(foot, knee, share_below * share, thin) for share in _ANKLE]
        space = torch.stack(spaces)
        least = space.amin(dim=-1).permute(1, 2, 0)
        ankle, upper = (
            least[..., [k for k in range(len(spaces)) if (k in _LOW) == below]].amin(dim=-1) for below in (True, False)
        )
        told = list(_TOLD)
        cues = [
            torch.stack([x, y], dim=-1) / 0.3,
            torch.stack([ground, z - lift[2], clear.clamp(-0.15, 0.15)], dim=-1) / 0.15,
            above.clamp(-0.3, 0.3) / 0.05,
            along[..., told] / 0.2,
            aside[..., told] / 0.2,
            (rise[..., told] - z[..., None]) / 0.2,
            torch.stack([low - z - 0.3, high - z - 0.5], dim=-1).clamp(-0.5, 0.5) / 0.1,
            (of["hip_height_m"] - z - 0.5).clamp(-0.5, 0.5)[..., None] / 0.1,
            space.amin(dim=0) / 0.05,
            least / 0.05,
        ]
        return Told(torch.cat(cues, dim=-1), low, high, clear, ankle, upper, self._smooth(h))

    def _swing(self, phase: Tensor, end: Sequence[Tensor], lift: Sequence[Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """The foot's centre x, y, z (n, p, k) at phases (n, 1, k) of its way from ``lift`` (n, 1) to ``end`` (n, p).

        As in legtool_runtime.foothold.criteria.gait_cycle.swing_weights.
        """
        across = phase - torch.sin(2 * math.pi * phase) / (2 * math.pi)
        x, y = (a[..., None] + (b - a)[..., None] * across for a, b in zip(lift[:2], end[:2], strict=True))
        u = 2 * torch.minimum(phase, 1 - phase)
        risen, rising = u * u * (3 - 2 * u), (phase < 0.5).to(u.dtype)
        level = rising * lift[2][..., None] + (1 - rising) * end[2][..., None]
        apex = torch.maximum(end[2], lift[2]) + self.criteria.swing_height_m
        return x, y, (1 - risen) * level + risen * apex[..., None]

    def _heights(
        self, level: Sequence[Tensor], up: Sequence[Tensor], hip: Tensor, hind: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Least and greatest hip height (n, p) at which the leg reaches the foot at all instants [m].

        Below a tilted trunk a higher hip sees the foot not only deeper but elsewhere, so that either bound is found by
        iteration. The first step, from the hip height of the vector, tells rightly to which side of the bounds that is.

        Args:
            level: (n, p, k) the foot in the trunk's frame, from a hip at height 0.
            up: (n, 1, k) the vertical in that frame.
            hip: (n, 1, 1) to start from [m].
            hind: (n, 1) whether the leg is a hind one.
        """
        steep = up[2].clamp(min=0.2)
        shallow, deep = self._depths(level[0] - hip * up[0], level[1] - hip * up[1], hind)
        low, high = (shallow + level[2]) / steep, (deep + level[2]) / steep
        for _ in range(_REFINED):
            shallow, _ = self._depths(level[0] - low * up[0], level[1] - low * up[1], hind)
            _, deep = self._depths(level[0] - high * up[0], level[1] - high * up[1], hind)
            low, high = (shallow + level[2]) / steep, (deep + level[2]) / steep
        return low.amax(dim=-1), high.amin(dim=-1)

    def _depths(self, along: Tensor, aside: Tensor, hind: Tensor) -> tuple[Tensor, Tensor]:
        """Least and greatest height of the hip above a foot ``along`` and ``aside`` (n, p, k) of it [m].

        All in the trunk's frame.
        """
        offset, _, _, _, in_at, in_by, out_at, out_by = (column[..., None] for column in self.legs[hind].unbind(dim=-1))
        place = ((along / self.length + 1) * (0.5 * (PLACES - 1))).clamp(0.0, PLACES - 1.001)
        cell = place.floor()
        share = place - cell
        first = cell.long() + hind[..., None] * PLACES
        # In the plane of thigh and shank, which the abduction joint turns about the axis along x.
        least, most = ((1 - share) * row[first] + share * row[first + 1] for row in self.extents)
        least = torch.maximum(least, torch.maximum((in_at - aside) * in_by, (aside - out_at) * out_by))
        beyond = offset.square() - aside.square()
        return (least.square() + beyond).clamp(min=0).sqrt(), (most.square() + beyond).clamp(min=0).sqrt()

    def _thighs(self, along: Tensor, aside: Tensor, z: Tensor, hind: Tensor) -> tuple[tuple[Tensor, ...], ...]:
        """Knees and thigh axes from the hips, x, y, z (n, p, k) each, for feet ``along``, ``aside`` and above them [m].

        Legs are bent as far as lengths allow, as in legtool_runtime.foothold.criteria.leg.bend_leg.
        """
        offset, sign, thigh, shank = (column[..., None] for column in self.legs[hind, :4].unbind(dim=-1))
        yz = aside.square() + z.square()
        w = (yz - offset.square()).clamp(min=1e-9).sqrt()
        c, s = (offset * aside - w * z) / (yz + 1e-9), (w * aside + offset * z) / (yz + 1e-9)
        length2 = along.square() + w.square()
        cos_knee = (length2 - thigh.square() - shank.square()) / (2 * thigh * shank)
        sin_knee = sign * (1 - cos_knee.square()).clamp(min=1e-9).sqrt()
        lower, across = thigh + shank * cos_knee, shank * sin_knee
        cos_thigh = (lower * w - across * along) / (length2 + 1e-9)
        sin_thigh = -(lower * along + across * w) / (length2 + 1e-9)
        down = thigh * cos_thigh
        knee = (-thigh * sin_thigh, c * offset + s * down, s * offset - c * down)
        return knee, (torch.zeros_like(c), c * offset, s * offset)

    def erode(self, x: Tensor, *, outside: float) -> Tensor:
        """Return the minimum of ``x`` (n, 33, 33) within the uncertainty radius (Remark 1); ``outside`` off the map."""
        least = x
        for part in _shifted(x, self._around, outside):
            least = torch.minimum(least, part)
        return least

    def _smooth(self, h: Tensor) -> Tensor:
        """TR, as in legtool_runtime.foothold.criteria.dilation.smooth: an unknown neighbour is not smooth."""
        away = [math.hypot(i, j) * RESOLUTION_M for i, j in _NEIGHBOURS]
        slopes = torch.stack(
            [(part - h).abs() / d for part, d in zip(_shifted(h, _NEIGHBOURS, math.nan), away, strict=True)]
        )
        mean = slopes.mean(dim=0)
        variance = slopes.square().mean(dim=0) - mean.square()
        return (mean <= self.criteria.slope_mean) & (variance <= self.criteria.slope_deviation**2)


def _trunk(yaw: Tensor, roll: Tensor, pitch: Tensor) -> list[list[Tensor]]:
    """The trunk's axes Rz(yaw) Ry(pitch) Rx(roll), three rows of three (n, 1, k), for yaws (n, k), angles (n, 1)."""
    y, b, g = yaw[:, None], roll[..., None], pitch[..., None]
    cy, sy, cb, sb, cg, sg = y.cos(), y.sin(), b.cos(), b.sin(), g.cos(), g.sin()
    one = torch.ones_like(cy)
    return [
        [cy * cg, cy * sg * sb - sy * cb, cy * sg * cb + sy * sb],
        [sy * cg, sy * sg * sb + cy * cb, sy * sg * cb - cy * sb],
        [-sg * one, cg * sb * one, cg * cb * one],
    ]


def _into(trunk: list[list[Tensor]], way: Sequence[Tensor]) -> list[Tensor]:
    """A way x, y, z (n, p, k) in the trunk's frame."""
    return [sum((row[k] * part for row, part in zip(trunk, way, strict=True)), torch.zeros(())) for k in range(3)]


def _shifted(x: Tensor, offsets: Sequence[tuple[int, int]], outside: float) -> list[Tensor]:
    """``x`` (n, 33, 33) as seen from each cell at ``offsets``; beyond the map, ``outside``."""
    reach = max(max(abs(i), abs(j)) for i, j in offsets)
    padded = functional.pad(x, (reach,) * 4, value=outside)
    return [padded[:, reach + i : reach + i + SIZE, reach + j : reach + j + SIZE] for i, j in offsets]


def _fill(h: Tensor) -> Tensor:
    """Heights (n, 33, 33) with unknown cells as high as the highest known beside them, for three rings; then 0."""
    x = torch.where(torch.isnan(h), _DEPTH, h)
    for _ in range(3):
        beside = functional.max_pool2d(x[:, None], 3, stride=1, padding=1)[:, 0]
        x = torch.where(x < 0.9 * _DEPTH, beside, x)
    return torch.where(x < 0.9 * _DEPTH, 0.0, x)


def _balls(radius: float, fineness: int) -> list[list[Ball]]:
    """For a ball over each of a cell's ``fineness``² parts: the columns that it can touch, and how far above them.

    As in legtool_runtime.foothold.criteria.dilation.ball.
    """
    cells, rises = dilation.ball(radius, RESOLUTION_M, fineness)
    out: list[list[Ball]] = [[([], []) for _ in range(fineness)] for _ in range(fineness)]
    for (a, b, i, j), rise in zip(cells.tolist(), rises.tolist(), strict=True):
        offsets, above = out[a][b]
        offsets.append((i, j))
        above.append(rise)
    return out


def _dilate(filled: Tensor, balls: list[list[Ball]]) -> Tensor:
    """Least height (n, 33 f, 33 f) at which a ball over each part of a cell is clear of the terrain."""
    rows = []
    for line in balls:
        parts = []
        for offsets, rises in line:
            seen = _shifted(filled, offsets, _DEPTH)
            part = seen[0] + rises[0]
            for other, rise in zip(seen[1:], rises[1:], strict=True):
                part = torch.maximum(part, other + rise)
            parts.append(part)
        rows.append(torch.stack(parts, dim=-1).flatten(2))
    return torch.stack(rows, dim=2).flatten(1, 2)


def _look_up(table: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """``table`` (n, 33 f, 33 f) at x, y (n, p, k) [m]; off the map there is no ground."""
    place = torch.stack([y, x], dim=-1) / (0.5 * SIZE * RESOLUTION_M)
    found = functional.grid_sample(
        (table - _DEPTH)[:, None], place, mode="nearest", padding_mode="zeros", align_corners=False
    )
    return found[:, 0] + _DEPTH


def _space(lower: Sequence[Tensor], upper: Sequence[Tensor], share: Tensor | float, table: Tensor) -> Tensor:
    """Height (n, p, k) above ``table`` of points at ``share`` of links from ``lower`` to ``upper``, x, y, z [m]."""
    x, y, z = (a + (b - a) * share for a, b in zip(lower, upper, strict=True))
    return (z - _look_up(table, x, y)).clamp(-0.3, 0.3)
