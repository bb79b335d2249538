"""Rigid-body terms of one leg: centre of mass, gravity torque and joint-space inertia. Base frame throughout."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel

Array = NDArray[np.float64]


@kernel
def leg_terms(
    hip: Array,
    chain: Array,
    angles: Array,
    masses: Array,
    coms: Array,
    inertias: Array,
    gravity: Array,
    moment: Array,
    torque: Array,
    inertia: Array,
) -> None:
    """Write a leg's gravity torque and inertia, and add its mass moment.

    Args:
        hip: (3,) abduction axis [m]; chain: (3,) abduction offset, thigh length, shank length [m].
        angles: (3,) [rad].
        masses: (3,) [kg]; coms: (3, 3) in link axes from the link's joint [m]; inertias: (3, 3, 3) link axes [kg m²].
        gravity: (3,) acceleration of gravity in the base frame [m/s²].
        moment: (3,) added to: mass × position, summed over the leg's links [kg m].
        torque: (3,) written: joint torque that holds the leg against gravity [Nm].
        inertia: (3, 3) written: joint-space inertia without rotors [kg m²].
    """
    c, s = np.cos(angles[0]), np.sin(angles[0])
    # Pitch axes of thigh and knee after abduction: Rx(hip)·ŷ.
    for i in range(3):
        torque[i] = 0.0
        for j in range(3):
            inertia[i, j] = 0.0
    anchor = np.empty((3, 3))
    anchor[0] = hip
    anchor[1, 0], anchor[1, 1], anchor[1, 2] = hip[0], hip[1] + c * chain[0], hip[2] + s * chain[0]
    sp, cp = np.sin(angles[1]), np.cos(angles[1])
    anchor[2, 0] = anchor[1, 0] - chain[1] * sp
    anchor[2, 1] = anchor[1, 1] + s * chain[1] * cp
    anchor[2, 2] = anchor[1, 2] - c * chain[1] * cp
    columns = np.empty((3, 3))
    rotated = np.empty((3, 3))
    for link in range(3):
        pitch = 0.0
        if link >= 1:
            pitch += angles[1]
        if link == 2:
            pitch += angles[2]
        sp, cp = np.sin(pitch), np.cos(pitch)
        # Link to base: Rx(hip)·Ry(pitch), rows.
        r00, r01, r02 = cp, 0.0, sp
        r10, r11, r12 = s * sp, c, -s * cp
        r20, r21, r22 = -c * sp, s, c * cp
        x, y, z = coms[link, 0], coms[link, 1], coms[link, 2]
        px = anchor[link, 0] + r00 * x + r01 * y + r02 * z
        py = anchor[link, 1] + r10 * x + r11 * y + r12 * z
        pz = anchor[link, 2] + r20 * x + r21 * y + r22 * z
        mass = masses[link]
        moment[0] += mass * px
        moment[1] += mass * py
        moment[2] += mass * pz
        # Joint axes in link axes: abduction is Ry(pitch)ᵀ·x̂, the others ŷ.
        ax, az = cp, sp
        for i in range(3):
            rotated[i, 0] = inertias[link, i, 0] * ax + inertias[link, i, 2] * az
            rotated[i, 1] = inertias[link, i, 1]
            rotated[i, 2] = rotated[i, 1]
        for j in range(link + 1):
            dx, dy, dz = px - anchor[j, 0], py - anchor[j, 1], pz - anchor[j, 2]
            if j == 0:
                columns[0, 0], columns[1, 0], columns[2, 0] = 0.0, -dz, dy
            else:
                columns[0, j] = c * dz - s * dy
                columns[1, j] = s * dx
                columns[2, j] = -c * dx
            torque[j] -= mass * (gravity[0] * columns[0, j] + gravity[1] * columns[1, j] + gravity[2] * columns[2, j])
        for i in range(link + 1):
            for j in range(link + 1):
                linear = columns[0, i] * columns[0, j] + columns[1, i] * columns[1, j] + columns[2, i] * columns[2, j]
                if i == 0:
                    angular = ax * rotated[0, j] + az * rotated[2, j]
                else:
                    angular = rotated[1, j]
                inertia[i, j] += mass * linear + angular
