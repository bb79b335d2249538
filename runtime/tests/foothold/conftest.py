"""HyQ, random terrains, and the criteria once more: slowly, in double precision, by plain trigonometry and distances.

Nothing here is shared with the kernels but the definitions in their docstrings: links are placed by rotation matrices,
joints found by the law of cosines, paths and links sampled densely, and clearances are distances from points to boxes.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from legtool_runtime import Robot
from legtool_runtime.foothold import Gait

N, CELL = 33, 0.02


def hyq(knees=(-1.0, 1.0), offset=0.0, name="hyq"):
    side = np.array([1.0, -1.0, 1.0, -1.0])
    hips = np.stack([[0.3735, 0.3735, -0.3735, -0.3735], 0.207 * side, np.full(4, -0.08)], axis=1)
    limits = np.empty((4, 3, 2))
    for leg in range(4):
        limits[leg, 0] = (-0.5236, 1.5708) if side[leg] > 0 else (-1.5708, 0.5236)
        sign = knees[leg // 2]
        limits[leg, 1] = (-0.8727, 1.2217) if sign < 0 else (-1.2217, 0.8727)
        limits[leg, 2] = (-2.4435, -0.34907) if sign < 0 else (0.34907, 2.4435)
    return Robot(
        name=name,
        hips=hips,
        abduction_offset=offset * side,
        thigh_length=np.full(4, 0.35),
        shank_length=np.full(4, 0.33),
        knee_sign=np.repeat(knees, 2),
        joint_limits=limits,
        foot_radius=0.02,
        stance=hips + np.stack([np.zeros(4), offset * side, np.full(4, -0.54)], axis=1),
    )


def random_terrain(rng):
    """(33, 33) heights with the centre near 0 [m]: edges, bars, blocks, slopes, roughness; some cells unknown."""
    x, y = np.meshgrid((np.arange(N) - 16) * CELL, (np.arange(N) - 16) * CELL, indexing="ij")
    angle = rng.uniform(-np.pi, np.pi)
    along = np.cos(angle) * x + np.sin(angle) * y + rng.uniform(-0.3, 0.3)
    kind = rng.integers(6)
    h = np.zeros((N, N))
    if kind == 0:
        h = np.floor(along / rng.uniform(0.2, 0.4)) * rng.uniform(-0.15, 0.15)
    elif kind == 1:
        h = np.where(np.abs(along) < rng.uniform(0.02, 0.1), rng.uniform(-0.3, 0.25), 0.0)
    elif kind == 2:
        for _ in range(6):
            cx, cy = rng.uniform(-0.3, 0.3, 2)
            inside = (np.abs(x - cx) < rng.uniform(0.03, 0.12)) & (np.abs(y - cy) < rng.uniform(0.03, 0.12))
            h[inside] = rng.uniform(-0.1, 0.25)
    elif kind == 3:
        h = along * rng.uniform(-0.5, 0.5)
    elif kind == 4:
        h = np.floor(along / 0.3) * 0.1 + rng.normal(scale=0.004, size=(N, N))
    h = h - h[16, 16] + rng.normal(scale=rng.choice([0.0, 0.002]), size=(N, N))
    if rng.random() < 0.3:
        h[rng.random((N, N)) < 0.01] = np.nan
    return h.astype(np.float32)


def random_case(rng, robot, tilt=0.0):
    """A terrain and everything else that the criteria take, as keyword arguments; roll and pitch up to ``tilt``."""
    angle, speed = rng.uniform(-np.pi, np.pi), rng.uniform(0, 0.6)
    twist = np.concatenate([speed * np.array([np.cos(angle), np.sin(angle)]), rng.normal(scale=[0.03, 0.05, 0.1, 0.3])])
    frequency, duty = rng.uniform(1.0, 2.0), rng.uniform(0.45, 0.75)
    gait = Gait(speed / frequency * rng.uniform(0.8, 1.2), frequency, duty, rng.choice([5.0, rng.uniform(0.02, 0.3)]))
    case = {
        "heights": random_terrain(rng),
        "leg": int(rng.integers(4)),
        "hip_height": rng.uniform(0.42, 0.66),
        "base_twist": tuple(float(value) for value in twist),
        "gait": gait,
        "nominal": None if rng.random() < 0.5 else tuple(rng.normal(scale=0.08, size=2)),
    }
    return case if tilt == 0 else {**case, "roll": rng.uniform(-tilt, tilt), "pitch": rng.uniform(-tilt, tilt)}


def attitude(case):
    """(3, 3) the trunk in the horizontal frame: Ry(pitch) Rx(roll), the product written out by hand."""
    b, g = case.get("roll", 0.0), case.get("pitch", 0.0)
    rx = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    ry = np.array([[np.cos(g), 0, np.sin(g)], [0, 1, 0], [-np.sin(g), 0, np.cos(g)]])
    return ry @ rx


def _filled(h):
    h = h.astype(float)
    while np.isnan(h).any():
        new = h.copy()
        for i, j in np.argwhere(np.isnan(h)):
            around = h[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
            if not np.isnan(around).all():
                new[i, j] = np.nanmax(around)
        h = new
    return h


def distance(points, h):
    """Distance [m] of points (..., 3) to the solid of square columns below ``h``; infinite off it or high above."""
    p = points.reshape(-1, 3)
    out = np.full(len(p), np.inf)
    i, j = (np.floor(p[:, k] / CELL + 0.5).astype(int) + 16 for k in (0, 1))
    inside = np.flatnonzero((i >= 0) & (i < N) & (j >= 0) & (j < N) & (p[:, 2] < h.max() + 0.06))
    reach = 3
    padded = np.pad(h, reach, constant_values=-np.inf)
    for di in range(-reach, reach + 1):
        for dj in range(-reach, reach + 1):
            ii, jj = i[inside] + di, j[inside] + dj
            top = padded[ii + reach, jj + reach]
            gx = np.maximum(np.abs(p[inside, 0] - (ii - 16) * CELL) - CELL / 2, 0)
            gy = np.maximum(np.abs(p[inside, 1] - (jj - 16) * CELL) - CELL / 2, 0)
            gz = np.maximum(p[inside, 2] - top, 0)
            out[inside] = np.minimum(out[inside], np.sqrt(gx**2 + gy**2 + gz**2))
    return out.reshape(points.shape[:-1])


def swing(lift, end, rise, s):
    """(n, 3) the swing at phases ``s`` (n,)."""
    across = s - np.sin(2 * np.pi * s) / (2 * np.pi)
    apex = max(lift[2], end[2]) + rise
    up = lambda u: 3 * u**2 - 2 * u**3  # noqa: E731
    z = np.where(s < 0.5, lift[2] + (apex - lift[2]) * up(2 * s), end[2] + (apex - end[2]) * up(2 * (1 - s)))
    xy = lift[:2] + np.outer(across, end[:2] - lift[:2])
    return np.column_stack([xy, z])


def bend(robot, leg, foot):
    """Joint angles (n, 3) for feet (n, 3) in the hip's frame, and how far within reach they are [m]; law of cosines."""
    a, t, s = robot.abduction_offset[leg], robot.thigh_length[leg], robot.shank_length[leg]
    from_axis = np.hypot(foot[:, 1], foot[:, 2])
    # In the plane across the abduction axis: foot at angle arctan2(y, -z) from straight down, offset a to the side.
    side = np.arcsin(np.clip(a / np.maximum(from_axis, 1e-9), -1, 1))
    hip = np.arctan2(foot[:, 1], -foot[:, 2]) - side
    down = np.sqrt(np.maximum(from_axis**2 - a**2, 0))
    length = np.hypot(foot[:, 0], down)
    reach = np.minimum.reduce([t + s - length, length - abs(t - s), from_axis - abs(a)])
    inner = np.arccos(np.clip((t**2 + s**2 - length**2) / (2 * t * s), -1, 1))
    knee = robot.knee_sign[leg] * (np.pi - inner)
    at_hip = np.arccos(np.clip((t**2 + length**2 - s**2) / (2 * t * np.maximum(length, 1e-9)), -1, 1))
    # The knee lies behind the line from hip to foot for a negative sign: the thigh is turned backwards, + about y.
    thigh = np.arctan2(-foot[:, 0], down) - robot.knee_sign[leg] * at_hip
    return np.stack([hip, thigh, knee], axis=1), reach


def chain(robot, leg, q):
    """Thigh axis, knee and foot (n, 3) each in the hip's frame, by rotation matrices."""

    def rx(angle):
        m = np.tile(np.eye(3), (len(angle), 1, 1))
        m[:, 1, 1], m[:, 1, 2], m[:, 2, 1], m[:, 2, 2] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
        return m

    def ry(angle):
        m = np.tile(np.eye(3), (len(angle), 1, 1))
        m[:, 0, 0], m[:, 0, 2], m[:, 2, 0], m[:, 2, 2] = np.cos(angle), np.sin(angle), -np.sin(angle), np.cos(angle)
        return m

    first, second = rx(q[:, 0]), ry(q[:, 1])
    axis = first @ np.array([0, robot.abduction_offset[leg], 0])
    knee = axis + first @ second @ np.array([0, 0, -robot.thigh_length[leg]])
    foot = knee + first @ second @ ry(q[:, 2]) @ np.array([0, 0, -robot.shank_length[leg]])
    return axis, knee, foot


def _roughness(h, ix, iy, settings):
    if not (0 < ix < N - 1 and 0 < iy < N - 1):
        return -np.inf
    slopes = [
        (h[ix + i, iy + j] - h[ix, iy]) / np.hypot(i * CELL, j * CELL) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j
    ]
    return min(settings.slope_mean - np.mean(np.abs(slopes)), settings.slope_deviation - np.std(np.abs(slopes)))


def _cycle(robot, case):
    """Hip at touchdown, its velocity, aim, durations of swing and stance, phase from which the swing is judged."""
    leg, gait = case["leg"], case["gait"]
    twist = np.array(case["base_twist"])
    velocity = twist[:3] + np.cross(twist[3:], attitude(case) @ robot.hips[leg])
    swing_s, stance_s = (1 - gait.duty_factor) / gait.step_frequency_hz, gait.duty_factor / gait.step_frequency_hz
    if case["nominal"] is None:
        hip = np.array([0, 0, case["hip_height"]])
        aim = (robot.stance[leg] - robot.hips[leg])[:2] + velocity[:2] * stance_s / 2
    else:
        hip = np.array([-case["nominal"][0], -case["nominal"][1], case["hip_height"]])
        aim = np.zeros(2)
    begin = min(max(1 - gait.time_to_touchdown_s / swing_s, 0), 1)
    return hip, velocity, aim, swing_s, stance_s, begin


def _leg_margins(robot, settings, case, solid, tau, feet):
    """Kinematic margins [rad or m] and clearances [m], (n,) each, with the foot at ``feet`` (n, 3) at times ``tau``."""
    leg = case["leg"]
    hip, velocity, *_ = _cycle(robot, case)
    rate = case["base_twist"][5]
    c, sn = np.cos(rate * tau), np.sin(rate * tau)
    turn = np.zeros((len(tau), 3, 3))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = c, -sn, sn, c, 1
    turn = turn @ attitude(case)
    base = hip + velocity * tau[:, None]
    q, reach = bend(robot, leg, np.einsum("nji,nj->ni", turn, feet - base))
    low, high = robot.joint_limits[leg].T
    middle, half = (low + high) / 2, (high - low) / 2
    off = np.abs((q - middle + np.pi) % (2 * np.pi) - np.pi)
    kinematics = np.minimum(reach, np.where(half >= np.pi, np.inf, half - off).min(axis=1))
    axis, knee, foot = chain(robot, leg, q)
    f = np.linspace(0, 1, 31)[:, None, None]
    place = lambda p: base + np.einsum("nij,...nj->...ni", turn, p)  # noqa: E731
    shank = place(knee + f * (foot - knee))
    above = np.linalg.norm(shank - place(foot), axis=-1)
    thigh = place(axis + f[:-1] * (knee - axis))
    near = lambda p: distance(p, solid)  # noqa: E731
    # Below the ankle the leg is as thick as the foot; right above the foot's centre the ball of FC has it covered.
    lower = (above < settings.ankle_m - 1e-9) & (
        above > settings.ankle_m / np.ceil(settings.ankle_m / (1.75 * robot.foot_radius)) - 0.003
    )
    upper = above >= settings.ankle_m - 1e-9
    clear = near(shank) - np.where(upper, settings.leg_radius_m, robot.foot_radius)
    clear[~(upper | lower)] = np.inf
    return kinematics, np.minimum(clear.min(axis=0), near(thigh).min(axis=0) - settings.leg_radius_m)


#: A leg may or may not lift off with margins of joints [rad] and clearances [m] between these.
DOUBT = (-0.02, 0.02), (-0.012, 0.006)


def lift_offs(robot, settings, case, solid):
    """(3,) foot centres where the foot may have stood: the one place, and nearer ones that the thresholds put in doubt.

    The nearest place to one step length behind the aim that is smooth all around and that the leg can lift off from:
    on the first two fifths of a level swing to the aim it keeps its limits and its clearance.
    """
    h, gait = case["heights"].astype(float), case["gait"]
    _, velocity, aim, swing_s, _, begin = _cycle(robot, case)
    speed = np.hypot(*velocity[:2])
    wanted = aim - (gait.step_length_m * velocity[:2] / speed if speed > 1e-3 else 0)
    at = wanted / CELL + 16
    i, j = np.floor(at + 0.5).astype(int)
    reach = settings.uncertainty_m / CELL
    span = range(-int(reach + 1e-6), int(reach + 1e-6) + 1)
    disc = [(a, b) for a in span for b in span if np.hypot(a, b) <= reach + 1e-6]
    places = []
    if 0 <= i < N and 0 <= j < N:
        cells = [(p, q) for p in range(max(i - 8, 0), min(i + 9, N)) for q in range(max(j - 8, 0), min(j + 9, N))]
        cells.sort(key=lambda c: round((c[0] - at[0]) ** 2 + (c[1] - at[1]) ** 2, 6))
        for p, q in cells:
            if np.hypot(p - at[0], q - at[1]) < 8 and all(_roughness(h, p + a, q + b, settings) >= 0 for a, b in disc):
                places.append(np.array([(p - 16) * CELL, (q - 16) * CELL, solid[p, q] + robot.foot_radius]))
    if not places:
        i, j = np.clip([i, j], 0, N - 1)
        return [np.array([*wanted, solid[i, j] + robot.foot_radius])]
    if begin >= 0.4 or len(places) == 1:
        return places[:1]
    found, s, some = [], np.linspace(begin, 0.4, 9), 12
    for first in range(0, len(places), some):
        these = places[first : first + some]
        feet = [swing(place, np.array([*aim, place[2]]), settings.swing_height_m, s) for place in these]
        tau = np.tile((s - 1) * swing_s, len(these))
        both = _leg_margins(robot, settings, case, solid, tau, np.concatenate(feet))
        joints, clear = (margin.reshape(len(these), -1).min(axis=1) for margin in both)
        for place, joint, gap in zip(these, joints, clear, strict=True):
            if joint > DOUBT[0][0] and gap > DOUBT[1][0]:
                found.append(place)
            if joint > DOUBT[0][1] and gap > DOUBT[1][1]:
                return found
    return [*found, places[0]]


def judge(robot, settings, case, ix, iy, lift):
    """Margins of one cell: roughness, leg clearance [m], kinematics [rad or m], path clearance [m]; + is safe."""
    h = case["heights"].astype(float)
    solid = _filled(h)
    _, _, _, swing_s, stance_s, begin = _cycle(robot, case)
    end = np.array([(ix - 16) * CELL, (iy - 16) * CELL, h[ix, iy] + robot.foot_radius])
    s = np.linspace(max(begin, settings.contact_phase), 1 - settings.contact_phase, 160)
    path = (distance(swing(lift, end, settings.swing_height_m, s), solid) - robot.foot_radius).min()
    s = np.linspace(begin, 1, 70)
    feet = np.concatenate([swing(lift, end, settings.swing_height_m, s), np.tile(end, (30, 1))])
    tau = np.concatenate([(s - 1) * swing_s, np.linspace(0, stance_s, 30)])
    kinematics, collision = _leg_margins(robot, settings, case, solid, tau, feet)
    return {"TR": _roughness(h, ix, iy, settings), "LC": collision.min(), "KF": kinematics.min(), "FC": path}


def judge_all(robot, settings, case, cells):
    """For each of ``cells``, :func:`judge` for each place where the foot may have stood."""
    lifts = lift_offs(robot, settings, case, _filled(case["heights"].astype(float)))
    return [[judge(robot, settings, case, ix, iy, lift) for lift in lifts] for ix, iy in cells]


@pytest.fixture(scope="session")
def robots():
    """HyQ, and a leg with an abduction offset and all knees behind."""
    return [hyq(), hyq(knees=(-1.0, -1.0), offset=0.09, name="offset")]


@pytest.fixture(scope="session")
def slow():
    """The plain reference: ``slow.case(rng, robot)`` and ``slow.judge_all(robot, settings, case, cells)``."""
    return SimpleNamespace(case=random_case, judge_all=judge_all)
