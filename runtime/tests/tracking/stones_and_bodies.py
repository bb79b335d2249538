"""Robots to track with, and courses of stones."""

import numpy as np

from legtool_runtime import Robot


def robot(name, *, hips, stance, offset, links, knees, limits, radius):
    """A robot from its left front leg, mirrored; limits of hip and thigh are wide where they do not matter."""
    mirror = np.array([[1, 1, 1], [1, -1, 1], [-1, 1, 1], [-1, -1, 1]])
    side = np.array([1.0, -1.0, 1.0, -1.0])
    joint_limits = np.empty((4, 3, 2))
    joint_limits[:, 0], joint_limits[:, 1] = (-1.2, 1.2), (-2.0, 4.0)
    for leg in range(4):
        joint_limits[leg, 2] = limits if knees[leg] < 0 else (-limits[1], -limits[0])
    return Robot(
        name=name, hips=np.array(hips) * mirror, abduction_offset=offset * side, thigh_length=np.full(4, links[0]),
        shank_length=np.full(4, links[1]), knee_sign=np.array(knees, float), joint_limits=joint_limits,
        foot_radius=radius, stance=np.array(stance) * mirror,
    )  # fmt: skip


X, M = (-1.0, -1.0, 1.0, 1.0), (-1.0,) * 4
#: Geometry, mass [kg] and inertia [kg m²] as of the presets.
BODIES = {
    "anymal_c": (
        robot("anymal_c", hips=(0.3598, 0.104, 0), stance=(0.3598, 0.3012, -0.52), offset=0.1972,
              links=(0.285, 0.3275), knees=X, limits=(-2.7, -0.3), radius=0.03),
        52.1, np.diag([1.9, 4.3, 4.6]),
    ),
    "hyq": (
        robot("hyq", hips=(0.3735, 0.207, -0.08), stance=(0.3735, 0.207, -0.62), offset=0.0, links=(0.35, 0.33),
              knees=X, limits=(-2.4435, -0.349), radius=0.02),
        90.0, np.diag([5.0, 12.0, 13.0]),
    ),
    "aliengo": (
        robot("aliengo", hips=(0.2399, 0.051, 0), stance=(0.2399, 0.134, -0.3635), offset=0.083, links=(0.25, 0.25),
              knees=M, limits=(-2.7751, -0.6458), radius=0.0265),
        24.0, np.diag([0.35, 0.95, 1.05]),
    ),
    "go2": (
        robot("go2", hips=(0.1934, 0.0465, 0), stance=(0.1934, 0.142, -0.298), offset=0.0955, links=(0.213, 0.213),
              knees=M, limits=(-2.7227, -0.83776), radius=0.022),
        15.0, np.diag([0.16, 0.40, 0.45]),
    ),
}  # fmt: skip


def stones(robot, steps, rng, *, stride=0.4, rise=0.1, most=0.25, jitter=0.02):
    """Footholds of each leg along x [m]: neighbours in a row ± ``rise``, left and right of their own."""
    out = []
    for leg in range(4):
        places = np.zeros((steps + 1, 3))
        places[:, :2] = robot.stance[leg, :2]
        places[1:, 0] += stride * np.arange(1, steps + 1) + rng.uniform(-jitter, jitter, steps)
        places[1:, 1] += rng.uniform(-jitter, jitter, steps)
        for k in range(1, steps + 1):
            places[k, 2] = np.clip(places[k - 1, 2] + rng.uniform(-rise, rise), -most, most)
        out.append(places)
    return out
