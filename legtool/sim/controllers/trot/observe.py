"""What a controller derives from the measured state at each tick: attitude, feet, masses, each leg's dynamics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool.sim.controllers.trot.gait import GRAVITY
from legtool.sim.robots.leg import leg_terms
from legtool.sim.robots.state import FORCES, JOINTS, ORIENTATION, RATE, VELOCITY
from legtool_runtime.cache import kernel
from legtool_runtime.robot import leg_forward, leg_jacobian
from legtool_runtime.rotations import write_matrix

Array = NDArray[np.float64]


@kernel
def observe(
    p: np.record,
    m: np.record,
    x: np.record,
    values: Array,
    angles: Array,
    rates: Array,
    jacobians: Array,
    inertias: Array,
    torques: Array,
) -> None:
    """Fill the motion record, and each leg's Jacobian, inertia and gravity torque."""
    w, i, j, k = values[ORIENTATION], values[ORIENTATION + 1], values[ORIENTATION + 2], values[ORIENTATION + 3]
    r = x.rotation
    write_matrix(w, i, j, k, r)
    x.yaw = np.arctan2(r[1, 0], r[0, 0])
    x.roll = np.arctan2(r[2, 1], r[2, 2])
    x.pitch = -np.arcsin(min(1.0, max(-1.0, r[2, 0])))
    spin = values[RATE:JOINTS]
    gravity = np.empty(3)
    moment = np.empty(3)
    for a in range(3):
        x.position[a] = values[a]
        x.velocity[a] = values[VELOCITY + a]
        x.rate[a] = r[a, 0] * spin[0] + r[a, 1] * spin[1] + r[a, 2] * spin[2]
        gravity[a] = -GRAVITY * r[2, a]
        moment[a] = p.trunk_mass * p.trunk_com[a]
    foot, speed = np.empty(3), np.empty(3)
    for leg in range(4):
        leg_forward(p.hips[leg], p.chain[leg, 0], p.chain[leg, 1], p.chain[leg, 2], angles[leg], foot)
        leg_jacobian(p.chain[leg, 0], p.chain[leg, 1], p.chain[leg, 2], angles[leg], jacobians[leg])
        leg_terms(
            p.hips[leg],
            p.chain[leg],
            angles[leg],
            p.link_mass[leg],
            p.link_com[leg],
            p.link_inertia[leg],
            gravity,
            moment,
            torques[leg],
            inertias[leg],
        )
        for a in range(3):
            after, before = (a + 1) % 3, (a + 2) % 3
            speed[a] = spin[after] * foot[before] - spin[before] * foot[after]
            for q in range(3):
                speed[a] += jacobians[leg, a, q] * rates[leg, q]
        for a in range(3):
            x.feet[leg, a] = r[a, 0] * foot[0] + r[a, 1] * foot[1] + r[a, 2] * foot[2]
            x.feet_velocity[leg, a] = x.velocity[a] + r[a, 0] * speed[0] + r[a, 1] * speed[1] + r[a, 2] * speed[2]
        x.contact[leg] = values[FORCES + leg] > p.contact_force
    for a in range(3):
        x.com[a] = (r[a, 0] * moment[0] + r[a, 1] * moment[1] + r[a, 2] * moment[2]) / p.mass
    # Slope of the ground along the heading, from the last contacts of the front and hind feet.
    c, s = np.cos(x.yaw), np.sin(x.yaw)
    length = 0.0
    for leg in range(4):
        along = c * x.feet[leg, 0] + s * x.feet[leg, 1]
        length += 0.5 * along if leg < 2 else -0.5 * along
    rise = 0.5 * (m.ground[0] + m.ground[1] - m.ground[2] - m.ground[3])
    x.slope = min(0.6, max(-0.6, rise / max(length, 0.5 * p.hips[0, 0])))
