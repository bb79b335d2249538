"""Poses that standing legs reach, neither too straight nor too folded: least squares over a horizon.

For poses pₖ = nominalₖ + oₖ (x, y, height, roll, pitch) of the centre of mass

    minimise  Σₖ oₖᵀ W oₖ + (τ/dt)⁴ |oₖ₊₁ - 2 oₖ + oₖ₋₁|²_W + ρ Σ (leg's length beyond its bounds)²
              + ρ_t Σ (depth of thighs and shanks in the ground)²

so that height, tilt and place are traded against each other, and a limit that comes is answered before it does. Gauss
and Newton's steps on a banded system; a handful of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.legs import Legs
from legtool_runtime.robot import leg_forward, leg_inverse
from legtool_runtime.tracking.ground import Ground, lowest_centre

Array = NDArray[np.float64]

#: W: x, y, height [1], roll, pitch [m²/rad²] for legs of a metre; sideways shifts cost balance.
_WEIGHTS = np.array([4.0, 4.0, 1.0, 0.4, 0.4])
_BEYOND, _IN_GROUND = 2000.0, 50.0
#: Depths beyond this pull no harder, as shares of the leg's length: a map's spike shall not lift the robot.
_DEEPEST = 0.08
_STEPS = 12
#: The search ends when a step gains less than this share of the cost, or of so little [m²].
_LEAST_GAIN, _LEAST_COST = 1e-4, 1e-9
_BAND = 10


@kernel
def to_body(pose: Array, point: Array, out: Array) -> tuple[float, float, float]:
    """Write a world point (3,) in the body's frame at ``pose`` (6,); returns it as turned by yaw and pitch alone."""
    dx, dy, dz = point[0] - pose[0], point[1] - pose[1], point[2] - pose[2]
    c, s = np.cos(pose[5]), np.sin(pose[5])
    x, y = c * dx + s * dy, c * dy - s * dx
    c, s = np.cos(pose[4]), np.sin(pose[4])
    gx, gz = c * x - s * dz, s * x + c * dz
    c, s = np.cos(pose[3]), np.sin(pose[3])
    out[0], out[1], out[2] = gx, c * y + s * gz, c * gz - s * y
    return gx, y, gz


@kernel
def leg_span(legs: Legs, leg: int, pose: Array, foot: Array, slope: Array) -> float:
    """Distance from thigh axis to a foot (3,) in the world [m]; its slopes by x, y, height, roll, pitch to (5,)."""
    f = np.empty(3)
    gx, _, gz = to_body(pose, foot, f)
    cr, sr = np.cos(pose[3]), np.sin(pose[3])
    by_roll_y, by_roll_z = f[2], -f[1]
    by_pitch_x, by_pitch_y, by_pitch_z = -gz, sr * gx, cr * gx
    for i in range(3):
        f[i] -= legs.hips[leg, i]
    square = f[0] * f[0] + max(f[1] * f[1] + f[2] * f[2] - legs.offset[leg] ** 2, 1e-8)
    length = np.sqrt(square)
    slope[3] = (f[1] * by_roll_y + f[2] * by_roll_z) / length
    slope[4] = (f[0] * by_pitch_x + f[1] * by_pitch_y + f[2] * by_pitch_z) / length
    # By the place: minus the direction, turned into the world.
    y, z = cr * f[1] - sr * f[2], sr * f[1] + cr * f[2]
    c, s = np.cos(pose[4]), np.sin(pose[4])
    x, z = c * f[0] + s * z, c * z - s * f[0]
    c, s = np.cos(pose[5]), np.sin(pose[5])
    slope[0], slope[1], slope[2] = -(c * x - s * y) / length, -(s * x + c * y) / length, -z / length
    return length


@kernel
def leg_points(legs: Legs, leg: int, pose: Array, foot: Array, work: Array, points: Array) -> None:
    """Write points (4, 3) on thigh and shank of a leg that stands at ``foot`` (3,), world frame [m].

    ``work`` (4, 3) is to work in.
    """
    inside, angles, knee, axis = work[0], work[1], work[2], work[3]
    to_body(pose, foot, inside)
    leg_inverse(
        legs.hips[leg], legs.offset[leg], legs.thigh[leg], legs.shank[leg], legs.sign[leg], inside, angles
    )  # fmt: skip
    leg_forward(legs.hips[leg], legs.offset[leg], legs.thigh[leg], 0.0, angles, knee)
    leg_forward(legs.hips[leg], legs.offset[leg], 0.0, 0.0, angles, axis)
    cr, sr, cp, sp = np.cos(pose[3]), np.sin(pose[3]), np.cos(pose[4]), np.sin(pose[4])
    cy, sy = np.cos(pose[5]), np.sin(pose[5])
    for k in range(4):
        if k < 2:
            share = 0.5 * (k + 1)
            px, py, pz = (
                axis[0] + share * (knee[0] - axis[0]),
                axis[1] + share * (knee[1] - axis[1]),
                axis[2] + share * (knee[2] - axis[2]),
            )
        else:
            share = 0.3 * (k - 1)
            px, py, pz = (
                knee[0] + share * (inside[0] - knee[0]),
                knee[1] + share * (inside[1] - knee[1]),
                knee[2] + share * (inside[2] - knee[2]),
            )
        y, z = cr * py - sr * pz, sr * py + cr * pz
        x, z = cp * px + sp * z, cp * z - sp * px
        points[k, 0], points[k, 1], points[k, 2] = pose[0] + cy * x - sy * y, pose[1] + sy * x + cy * y, pose[2] + z


@kernel
def depths_of(legs: Legs, points: Array, ground: Ground, depths: Array) -> float:
    """Write how deep (4,) points (4, 3) of a leg are in the ground [m], 0 when clear; returns the deepest."""
    deepest = 0.0
    for k in range(4):
        z = points[k, 2]
        top = lowest_centre(ground, points[k, 0], points[k, 1], legs.radius, True, z)
        depths[k] = min(top - z, _DEEPEST * legs.size)
        deepest = max(deepest, depths[k])
    return deepest


@kernel
def _residuals(
    legs: Legs, pose: Array, feet: Array, standing: NDArray[np.bool_], ground: Ground, hessian: Array, slope: Array
) -> float:
    """Cost of bounds and ground at a pose; adds its Gauss-Newton Hessian (5, 5) and half its slope (5,)."""
    cost = 0.0
    row, moved, work = np.empty(5), np.empty(6), np.empty((4, 3))
    points, depths, others, lift = np.empty((4, 3)), np.empty(4), np.empty((4, 3)), np.empty((5, 4))
    known = ground.heights.shape[0] > 1
    for leg in range(4):
        if not standing[leg]:
            continue
        length = leg_span(legs, leg, pose, feet[leg], row)
        beyond = length - min(max(length, legs.shortest[leg]), legs.longest[leg])
        if beyond != 0.0:
            cost += _BEYOND * beyond * beyond
            for i in range(5):
                slope[i] += _BEYOND * beyond * row[i]
                for j in range(5):
                    hessian[i, j] += _BEYOND * row[i] * row[j]
        if not known:
            continue
        leg_points(legs, leg, pose, feet[leg], work, points)
        if depths_of(legs, points, ground, depths) == 0.0:
            continue
        for i in range(5):
            moved[:] = pose
            moved[i] += 1e-4
            leg_points(legs, leg, moved, feet[leg], work, others)
            for k in range(4):
                # The ground is taken for level: beside a riser its slope says nothing of what helps.
                lift[i, k] = (others[k, 2] - points[k, 2]) * 1e4
        for k in range(4):
            if depths[k] > 0.0:
                cost += _IN_GROUND * depths[k] * depths[k]
                for i in range(5):
                    slope[i] -= _IN_GROUND * depths[k] * lift[i, k]
                    for j in range(5):
                        hessian[i, j] += _IN_GROUND * lift[i, k] * lift[j, k]
    return cost


@kernel
def _assemble(
    legs: Legs,
    nominal: Array,
    feet: Array,
    standing: NDArray[np.bool_],
    ground: Ground,
    smoothness: float,
    offsets: Array,
    band: Array,
    slope: Array,
) -> float:
    """The cost at ``offsets`` (n, 5), and the banded normal equations (n · 5, 11) with their right side."""
    n = nominal.shape[0]
    band[:], slope[:] = 0.0, 0.0
    cost = 0.0
    pose, hessian, part = np.empty(6), np.empty((5, 5)), np.empty(5)
    stencil = np.array([1.0, -2.0, 1.0])
    for k in range(n):
        pose[:] = nominal[k]
        pose[:5] += offsets[k]
        hessian[:], part[:] = 0.0, 0.0
        cost += _residuals(legs, pose, feet[k], standing[k], ground, hessian, part)
        for i in range(5):
            w, row = _WEIGHTS[i], 5 * k + i
            if i >= 3:
                w *= legs.size * legs.size
            cost += w * offsets[k, i] * offsets[k, i]
            hessian[i, i] += w
            slope[row] += part[i] + w * offsets[k, i]
            for j in range(i + 1):
                band[row, _BAND + j - i] += hessian[i, j]
            if 0 < k < n - 1:
                bend = offsets[k - 1, i] - 2.0 * offsets[k, i] + offsets[k + 1, i]
                cost += w * smoothness * bend * bend
                for a in range(3):
                    at = 5 * (k - 1 + a) + i
                    slope[at] += w * smoothness * bend * stencil[a]
                    for b in range(a + 1):
                        band[at, _BAND - 5 * (a - b)] += w * smoothness * stencil[a] * stencil[b]
    return cost


@kernel
def _solve_band(band: Array, right: Array) -> None:
    """Solve a symmetric positive system (m, 11), last column its diagonal, in place: ``right`` becomes the answer."""
    m = band.shape[0]
    for i in range(m):
        for j in range(max(i - _BAND, 0), i + 1):
            total = band[i, _BAND + j - i]
            for l in range(max(i - _BAND, j - _BAND, 0), j):
                total -= band[i, _BAND + l - i] * band[j, _BAND + l - j]
            band[i, _BAND + j - i] = np.sqrt(max(total, 1e-12)) if i == j else total / band[j, _BAND]
        for l in range(max(i - _BAND, 0), i):
            right[i] -= band[i, _BAND + l - i] * right[l]
        right[i] /= band[i, _BAND]
    for i in range(m - 1, -1, -1):
        right[i] /= band[i, _BAND]
        for l in range(max(i - _BAND, 0), i):
            right[l] -= band[i, _BAND + l - i] * right[i]


@kernel
def fit_poses(
    legs: Legs,
    nominal: Array,
    feet: Array,
    standing: NDArray[np.bool_],
    ground: Ground,
    smoothness: float,
    offsets: Array,
) -> int:
    """Find ``offsets`` (n, 5), from what they are, that make poses reach and clear the ground.

    Args:
        legs: of the robot.
        nominal: (n, 6) x, y, z of the centre of mass [m], roll, pitch, yaw [rad].
        feet: (n, 4, 3) their centres, world frame [m].
        standing: (n, 4) whose feet bind.
        ground: below thighs and shanks; a single cell: none.
        smoothness: (τ/dt)⁴.
        offsets: to start from, and the answer.

    Returns:
        the number of steps.
    """
    n = nominal.shape[0]
    band, slope = np.empty((5 * n, _BAND + 1)), np.empty(5 * n)
    trial, next_slope, next_band = offsets.copy(), np.empty(5 * n), np.empty((5 * n, _BAND + 1))
    cost = _assemble(legs, nominal, feet, standing, ground, smoothness, offsets, band, slope)
    right = slope.copy()
    for step in range(_STEPS):
        _solve_band(band, slope)
        # What the step gains where the cost is as its model says.
        promised = 0.0
        for i in range(5 * n):
            promised += right[i] * slope[i]
        if promised <= _LEAST_GAIN * cost + _LEAST_COST:
            return step
        length, better = 1.0, False
        for _ in range(5):
            for k in range(n):
                for i in range(5):
                    trial[k, i] = offsets[k, i] - length * slope[5 * k + i]
            found = _assemble(legs, nominal, feet, standing, ground, smoothness, trial, next_band, next_slope)
            if found < cost:
                better = True
                break
            length *= 0.4
        if not better:
            return step
        gained = cost - found
        cost = found
        offsets[:], band[:], slope[:], right[:] = trial, next_band, next_slope, next_slope
        if gained < _LEAST_GAIN * cost or cost < _LEAST_COST:
            return step + 1
    return _STEPS


@kernel
def level_pose(feet: Array, weights: Array, height: float, tilt: float, out: Array) -> None:
    """Write the pose (6,) that feet (4, 3) imply: over their weighted mean, along them, at a share of their slope.

    ``height`` is that of the centre of mass over the feet's centres [m]; yaw goes from hind to front feet.
    """
    out[5] = np.arctan2(
        feet[0, 1] + feet[1, 1] - feet[2, 1] - feet[3, 1], feet[0, 0] + feet[1, 0] - feet[2, 0] - feet[3, 0]
    )
    c, s = np.cos(out[5]), np.sin(out[5])
    total = weights.sum()
    mx, my, mz = 0.25 * feet[:, 0].sum(), 0.25 * feet[:, 1].sum(), 0.25 * feet[:, 2].sum()
    out[0], out[1] = (weights * feet[:, 0]).sum() / total, (weights * feet[:, 1]).sum() / total
    xx, xy, yy, xz, yz = 1e-6, 0.0, 1e-6, 0.0, 0.0
    for leg in range(4):
        dx, dy, dz = feet[leg, 0] - mx, feet[leg, 1] - my, feet[leg, 2] - mz
        x, y = c * dx + s * dy, c * dy - s * dx
        xx, xy, yy, xz, yz = xx + x * x, xy + x * y, yy + y * y, xz + x * dz, yz + y * dz
    det = max(xx * yy - xy * xy, 1e-9)
    forward, left = (yy * xz - xy * yz) / det, (xx * yz - xy * xz) / det
    out[3], out[4] = tilt * np.arctan(left), -tilt * np.arctan(forward)
    # Where the weights have moved the pose off the feet's middle, the plane there counts.
    dx, dy = out[0] - mx, out[1] - my
    out[2] = mz + height + tilt * (forward * (c * dx + s * dy) + left * (c * dy - s * dx))
