"""The criteria of one leg over one gait cycle, in compiled code: many candidate footholds at once, in single precision.

The cycle is sampled: the swing from lift-off to each candidate, touchdown, and the stance to the next lift-off, while
the hip moves with the base twist. Angles are never formed: a joint is within its limits if the cosine of its distance
to the middle of its range is at least that of half the range, and cosines and sines follow from lengths (the inverse of
:func:`legtool_runtime.robot.leg_forward`). Loops over candidates have no branches, so that they compile to vector code.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel

Array32 = NDArray[np.float32]
Flags = NDArray[np.uint8]


class Leg(NamedTuple):
    """One leg's chain: lengths [m], and of each joint cosine and sine of its range's middle, cosine of half."""

    offset: float
    thigh: float
    shank: float
    knee_sign: float
    hip_cos: float
    hip_sin: float
    hip_range: float
    thigh_cos: float
    thigh_sin: float
    thigh_range: float
    knee_cos: float
    knee_sin: float
    knee_range: float


class Cycle(NamedTuple):
    """One gait cycle in the map's frame: x, y from the map's centre, τ = 0 at touchdown.

    ``lift`` is where the foot lifts off, ``aim`` the nominal foothold [m]; ``start`` the phase from which it is judged.
    """

    hip_x: float
    hip_y: float
    velocity_x: float
    velocity_y: float
    velocity_z: float
    yaw_rate: float
    lift_x: float
    lift_y: float
    aim_x: float
    aim_y: float
    swing_s: float
    stance_s: float
    start: float
    height: float


class Grid(NamedTuple):
    """Where a table of dilated heights lies: x and y of its lower corner [m], side of a cell [m], cells a side."""

    origin: float
    fine: float
    cells: int


class Tables(NamedTuple):
    """Heights dilated by the foot and by the bounding region of the leg, each with its grid and greatest height [m]."""

    thin: Array32
    thin_grid: Grid
    thin_top: float
    thick: Array32
    thick_grid: Grid
    thick_top: float


#: Candidates that are taken together: what they need stays in the first-level cache.
CHUNK = 220
#: Numbers in the widest vector.
_VECTOR = 16


@kernel
def swing_weights(phase: float, out: Array32) -> None:
    """Write the swing's weights (4,) at ``phase`` 0 to 1: of the way across, of lift-off, touchdown and apex.

    Across, a cycloid; up to the apex and down again, cubics at rest at both ends.
    """
    out[0] = phase - np.sin(2.0 * np.pi * phase) / (2.0 * np.pi)
    u = 2.0 * phase if phase < 0.5 else 2.0 * (1.0 - phase)
    risen = u * u * (3.0 - 2.0 * u)
    out[1] = 1.0 - risen if phase < 0.5 else 0.0
    out[2] = 0.0 if phase < 0.5 else 1.0 - risen
    out[3] = risen


@kernel
def swing_phases(start: float, first: float, last: float, out: Array32) -> None:
    """Write phases (k,) of the swing from ``max(start, first)`` to ``last``, closer where the foot is fast."""
    low, high = max(start, first), last
    n = out.shape[0]
    w = np.empty(4, np.float32)
    # Halfway between equal steps in time and equal steps across: the foot's spacing is at most 1.33 / n of its way.
    swing_weights(low, w)
    begin = 0.5 * (low + w[0])
    swing_weights(high, w)
    end = 0.5 * (high + w[0])
    phase = low
    for k in range(n):
        wanted = begin + (end - begin) * k / (n - 1)
        for _ in range(3):  # Newton's steps; the slope is never below a half
            value = phase - np.sin(2.0 * np.pi * phase) / (4.0 * np.pi)
            slope = 1.0 - 0.5 * np.cos(2.0 * np.pi * phase)
            phase -= (value - wanted) / slope
        out[k] = phase


@kernel
def place_swing(cycle: Cycle, lift_z: float, phase: float, candidates: Array32, foot: Array32) -> None:
    """Write the foot's centre (3, n) at a phase of the swing to each of ``candidates`` (3, n)."""
    w = np.empty(4, np.float32)
    swing_weights(phase, w)
    across, from_lift, from_end, from_apex = w[0], w[1], w[2], w[3]
    lift_x, lift_y = np.float32(cycle.lift_x), np.float32(cycle.lift_y)
    lift, rise = np.float32(lift_z), np.float32(cycle.height)
    xs, ys, zs = candidates[0], candidates[1], candidates[2]
    fx, fy, fz = foot[0], foot[1], foot[2]
    for j in range(xs.shape[0]):
        fx[j] = lift_x + (xs[j] - lift_x) * across
    for j in range(xs.shape[0]):
        fy[j] = lift_y + (ys[j] - lift_y) * across
    for j in range(xs.shape[0]):
        z = zs[j]
        apex = (z if z > lift else lift) + rise
        fz[j] = from_lift * lift + from_end * z + from_apex * apex


@kernel
def bend_leg(leg: Leg, cycle: Cycle, hip_z: float, tau: float, foot: Array32, links: Array32, margin: Array32) -> None:
    """Bend the leg to each foot ``foot`` (3, n) at time ``tau`` [s], and lower ``margin`` (n,) to its least margin.

    Writes ``links`` (6, n): knee and thigh axis x, y, z. A margin below zero is a foot out of reach or a joint beyond
    its limits.
    """
    one, tiny = np.float32(1.0), np.float32(1e-9)
    hx = np.float32(cycle.hip_x + cycle.velocity_x * tau)
    hy = np.float32(cycle.hip_y + cycle.velocity_y * tau)
    hz = np.float32(hip_z + cycle.velocity_z * tau)
    yaw = cycle.yaw_rate * tau
    cy, sy = np.float32(np.cos(yaw)), np.float32(np.sin(yaw))
    a, t, s = np.float32(leg.offset), np.float32(leg.thigh), np.float32(leg.shank)
    knee_sign = np.float32(leg.knee_sign)
    a2, t2, s2 = a * a, t * t, s * s
    twice = np.float32(1.0 / (2.0 * leg.thigh * leg.shank))
    hip_c, hip_s, hip_r = np.float32(leg.hip_cos), np.float32(leg.hip_sin), np.float32(leg.hip_range)
    thigh_c, thigh_s, thigh_r = np.float32(leg.thigh_cos), np.float32(leg.thigh_sin), np.float32(leg.thigh_range)
    knee_c, knee_s, knee_r = np.float32(leg.knee_cos), np.float32(leg.knee_sin), np.float32(leg.knee_range)
    fx, fy, fz = foot[0], foot[1], foot[2]
    for j in range(margin.shape[0]):
        dx, dy, z = fx[j] - hx, fy[j] - hy, fz[j] - hz
        x = cy * dx + sy * dy
        y = cy * dy - sy * dx
        yz = y * y + z * z
        lateral = yz - a2
        w = np.sqrt(lateral if lateral > tiny else tiny)
        under = one / (yz + tiny)
        c = (a * y - w * z) * under
        sn = (w * y + a * z) * under
        length2 = x * x + w * w
        cos_knee = (length2 - t2 - s2) * twice
        sin2 = one - cos_knee * cos_knee
        sin_knee = knee_sign * np.sqrt(sin2 if sin2 > tiny else tiny)
        # With the knee bent, the foot lies at (A, B) along and across the thigh; the thigh turns it to (x, w).
        along, across = t + s * cos_knee, s * sin_knee
        over = one / (length2 + tiny)
        cos_thigh = (along * w - across * x) * over
        sin_thigh = -(along * x + across * w) * over
        m = margin[j]
        m = lateral if lateral < m else m
        m = sin2 if sin2 < m else m
        other = c * hip_c + sn * hip_s - hip_r
        m = other if other < m else m
        other = cos_thigh * thigh_c + sin_thigh * thigh_s - thigh_r
        m = other if other < m else m
        other = cos_knee * knee_c + sin_knee * knee_s - knee_r
        m = other if other < m else m
        margin[j] = m
        kx, kw = -t * sin_thigh, t * cos_thigh
        ky, kz = c * a + sn * kw, sn * a - c * kw
        links[0, j] = hx + cy * kx - sy * ky
        links[1, j] = hy + sy * kx + cy * ky
        links[2, j] = hz + kz
        links[3, j] = hx - sy * c * a
        links[4, j] = hy + cy * c * a
        links[5, j] = hz + sn * a


@kernel
def lowest(z: Array32) -> float:
    """The least of some heights [m], a little less rather than more; in whole numbers, which make vector code."""
    scale = np.float32(4096.0)
    low = np.int32(2**30)
    for j in range(z.shape[0]):
        value = np.int32(z[j] * scale)
        low = value if value < low else low
    return (low - 1) / 4096.0


@kernel
def clear_points(
    begin: Array32,
    end: Array32,
    share: float,
    table: Array32,
    grid: Grid,
    index: NDArray[np.int32],
    below: Array32,
    clearance: Array32,
) -> None:
    """Lower ``clearance`` (n,) to the height above ``table`` of the points at ``share`` from ``begin`` to ``end``.

    Args:
        begin: (3, n) one end of each link [m].
        end: (3, n) the other.
        share: 0 to 1.
        table: from :func:`legtool_runtime.foothold.terrain.dilate`.
        grid: where the table lies.
        index: (n,) to work in.
        below: (n,) to work in.
        clearance: least clearance so far [m].
    """
    f, per, low = np.float32(share), np.float32(1.0 / grid.fine), np.float32(grid.origin)
    zero, highest = np.float32(0.0), np.float32(grid.cells - 1)
    stride = np.int32(grid.cells)
    g = np.float32(1.0) - f
    n = clearance.shape[0]
    x0, y0, z0, x1, y1, z1 = begin[0], begin[1], begin[2], end[0], end[1], end[2]
    # Three loops: the first and the last become vector code, the look-up cannot.
    for j in range(n):
        u = (g * x0[j] + f * x1[j] - low) * per
        v = (g * y0[j] + f * y1[j] - low) * per
        u = u if u > zero else zero
        v = v if v > zero else zero
        u = u if u < highest else highest
        v = v if v < highest else highest
        index[j] = np.int32(u) * stride + np.int32(v)
    flat = table.reshape(-1)
    for j in range(n):
        below[j] = flat[np.uint32(index[j])]
    for j in range(n):
        above = g * z0[j] + f * z1[j] - below[j]
        clearance[j] = above if above < clearance[j] else clearance[j]


@kernel
def clear_leg(
    points: Array32,
    links: Array32,
    foot: Array32,
    tables: Tables,
    index: NDArray[np.int32],
    below: Array32,
    clearance: Array32,
) -> None:
    """Lower ``clearance`` (n,) to that of legs bent by :func:`bend_leg`.

    Args:
        points: (p, 3) along the leg: link (0 thigh, 1 shank), share from its upper end, 1 where the leg is thick.
        links: (6, n) from :func:`bend_leg`.
        foot: (3, n) feet [m].
        tables: of the terrain.
        index: (n,) to work in.
        below: (n,) to work in.
        clearance: least clearance so far [m].
    """
    knee, hip = links[0:3], links[3:6]
    low_hip, low_knee, low_foot = lowest(links[5]), lowest(links[2]), lowest(foot[2])
    for p in range(points.shape[0]):
        share, table, grid, top = points[p, 1], tables.thin, tables.thin_grid, tables.thin_top
        if points[p, 2] > np.float32(0.5):
            table, grid, top = tables.thick, tables.thick_grid, tables.thick_top
        # Where all points are above the whole table, there is nothing to look up.
        if points[p, 0] > np.float32(0.5):
            if (1.0 - share) * low_knee + share * low_foot < top:
                clear_points(knee, foot, share, table, grid, index, below, clearance)
        elif (1.0 - share) * low_hip + share * low_knee < top:
            clear_points(hip, knee, share, table, grid, index, below, clearance)


@kernel
def clear_paths(
    cycle: Cycle, lift_z: float, candidates: Array32, phases: Array32, tables: Tables, clearance: Array32
) -> None:
    """Write the least clearance (n,) of the foot on its swings to ``candidates`` (3, n)."""
    n = clearance.shape[0]
    foot, below, index = np.empty((3, CHUNK), np.float32), np.empty(CHUNK, np.float32), np.empty(CHUNK, np.int32)
    part, least = np.empty((3, CHUNK), np.float32), np.empty(CHUNK, np.float32)
    for first in range(0, n, CHUNK):
        m = min(CHUNK, n - first)
        part[:, :m] = candidates[:, first : first + m]
        part[:, m:] = np.float32(1e3)
        least[:] = np.float32(1e3)
        for k in range(phases.shape[0]):
            place_swing(cycle, lift_z, phases[k], part, foot)
            if lowest(foot[2]) < tables.thin_top:
                clear_points(foot, foot, 0.0, tables.thin, tables.thin_grid, index, below, least)
        clearance[first : first + m] = least[:m]


@kernel
def move_leg(
    leg: Leg,
    cycle: Cycle,
    lift_z: float,
    hip_z: float,
    candidates: Array32,
    phases: Array32,
    stances: int,
    points: Array32,
    tables: Tables,
    hurry: bool,
    margin: Array32,
    clearance: Array32,
) -> None:
    """Write the least kinematic margin (n,) and the leg's least clearance (n,) [m] over the cycle of each candidate.

    Args:
        leg: the leg's chain.
        cycle: the gait cycle.
        lift_z: height of the foot's centre at lift-off [m].
        hip_z: height of the hip at touchdown [m].
        candidates: (3, n) foot centres at touchdown [m].
        phases: of the swing, touchdown left out.
        stances: samples of the stance, touchdown and next lift-off included.
        points: along the leg, see :func:`clear_leg`.
        tables: of the terrain.
        hurry: give up on a candidate that fails at touchdown or at the next lift-off; its margin is then below zero,
            and its clearance unknown. And on all when none is left: one of both is then below zero.
        margin: written.
        clearance: written.
    """
    n = candidates.shape[1]
    part, links = np.empty((3, CHUNK), np.float32), np.empty((6, CHUNK), np.float32)
    ends, place = np.empty(CHUNK, np.float32), np.empty(CHUNK, np.int32)
    samples = phases.shape[0] + stances
    margin[:] = np.float32(-1.0)
    clearance[:] = np.float32(1e3)
    taken = 0
    while taken < n:
        m = 0
        while m < CHUNK and taken < n:
            # In a hurry, a chunk is filled with candidates that hold at both ends of the stance.
            count = min(CHUNK - m, n - taken)
            for j in range(count):
                place[m + j] = taken + j
                for i in range(3):
                    part[i, m + j] = candidates[i, taken + j]
            taken += count
            if not hurry:
                m += count
                break
            ends[:] = np.float32(1.0)
            bend_leg(leg, cycle, hip_z, 0.0, part, links, ends)
            bend_leg(leg, cycle, hip_z, cycle.stance_s, part, links, ends)
            kept = m
            for j in range(m, m + count):
                if ends[j] > np.float32(0.0):
                    place[kept] = place[j]
                    for i in range(3):
                        part[i, kept] = part[i, j]
                    kept += 1
            m = kept
        if m == 0:
            break
        # No wider than need be, in whole vectors.
        width = (m + _VECTOR - 1) // _VECTOR * _VECTOR
        some, foot = np.empty((3, width), np.float32), np.empty((3, width), np.float32)
        bent, below, index = np.empty((6, width), np.float32), np.empty(width, np.float32), np.empty(width, np.int32)
        reach, least = np.full(width, np.float32(1.0)), np.full(width, np.float32(1e3))
        for i in range(3):
            some[i, :m] = part[i, :m]
            some[i, m:] = part[i, 0]
        for k in range(samples):
            if k < stances:
                tau = cycle.stance_s * k / (stances - 1)
                bend_leg(leg, cycle, hip_z, tau, some, bent, reach)
                end = some
            else:
                phase = phases[k - stances]
                place_swing(cycle, lift_z, phase, some, foot)
                bend_leg(leg, cycle, hip_z, (phase - 1.0) * cycle.swing_s, foot, bent, reach)
                end = foot
            clear_leg(points, bent, end, tables, index, below, least)
            if hurry:
                alive = 0
                for j in range(width):
                    alive += (reach[j] >= 0) & (least[j] >= 0)
                if alive == 0:
                    break
        for j in range(m):
            margin[place[j]] = reach[j]
            clearance[place[j]] = least[j]
