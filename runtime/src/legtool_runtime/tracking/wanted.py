"""What is asked of whole-body control at a tick, in compiled code: from the body's reference and the preview."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.legs import Legs
from legtool_runtime.tracking.body_reference import spline_at, turning

Array = NDArray[np.float64]

#: While a foot is late, the preview expects it after so long: two of its nodes. The body stops and goes on within this
#: time too: a body that went on at its speed would fall over the feet that wait [s].
WAIT_S, EASE_S = 0.1, 0.1
#: Share of the straight leg that a standing leg has left where the trunk begins to sag.
_ROOM = 0.02


@kernel
def delay(start: float, step: float, control: Array, clock: float, ahead: float, wait: float, out: Array) -> None:
    """Write the control points (n, 6) of a reference that is ``ahead`` [s] of a clock, which stands for ``wait`` [s].

    See ``Tracker._advance`` for how the time that it is ahead by falls.
    """
    at, tick, left = clock, 0.005, ahead
    spline = np.empty((3, control.shape[1]))
    for k in range(control.shape[0]):
        time = start + step * k
        if time < clock:
            time += ahead
        else:
            while at < time - 1e-9:
                ran = 0.0 if at < clock + wait else tick
                left += tick * (1.0 - left / EASE_S) - ran
                at += tick
            waited = min(max(time - clock, 0.0), wait)
            time += left - waited
        spline_at(start, step, control, time, spline)
        out[k] = spline[0]


@kernel
def lifted(
    moving: tuple[Array, Array, Array, Array, Array], offset: Array, legs: Legs, feet: Array, stands: NDArray[np.bool_]
) -> tuple[float, float]:
    """By how much the legs hold the centre of mass higher over the trunk than standing ones do [m], and its rate [m/s].

    What is planned is the trunk's height; two feet that are 10 cm up lift the centre of mass off it by 8 mm (ANYmal C)
    or 3 mm (HyQ, Go2, Aliengo). The nearer a standing leg is to its longest, the less of this is asked for: the trunk
    may sag, so that feet get to where they go.

    Args:
        moving: centre of mass and its velocity (3,) each, rotation (3, 3), position (3,) and velocity (6 or more,) of
            the trunk as measured.
        offset: (3,) of the centre of mass of the standing robot, base frame [m].
        legs: of the robot.
        feet: (4, 3) centres of the feet, world frame [m].
        stands: (4,) which of them stand.
    """
    com, com_velocity, turn, position, velocity = moving
    arm_x, arm_y, arm_z, spin_x, spin_y = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        arm_x, arm_y, arm_z = (
            arm_x + turn[0, i] * offset[i],
            arm_y + turn[1, i] * offset[i],
            arm_z + turn[2, i] * offset[i],
        )
        spin_x, spin_y = spin_x + turn[0, i] * velocity[3 + i], spin_y + turn[1, i] * velocity[3 + i]
    height = com[2] - position[2] - arm_z
    rate = com_velocity[2] - velocity[2] - (spin_x * arm_y - spin_y * arm_x)
    share = 1.0
    for leg in range(4):
        if not stands[leg]:
            continue
        square = -(legs.offset[leg] ** 2)
        for i in range(3):
            along = -legs.hips[leg, i] - offset[i]
            for j in range(3):
                along += turn[j, i] * (feet[leg, j] - position[j])
            square += along * along
        room = (legs.longest[leg] - np.sqrt(max(square, 0.0))) / (_ROOM * legs.size)
        share = min(share, max(room, 0.0))
    return share * height, share * rate


@kernel
def want(
    motion: tuple[Array, Array, Array, Array],
    turned: Array,
    carried: Array,
    spline: tuple[float, float, Array],
    since: float,
    stands: NDArray[np.bool_],
    com: Array,
    orientation: Array,
    rates_of: Array,
    forces: Array,
) -> None:
    """Write what is wanted ``since`` [s] after a preview: of the centre of mass (3, 3) and the forces (4, 3) by it, of
    the orientation (4,) and its rate by the body's reference, of its acceleration by the preview.

    ``motion`` are borders of nodes, positions, velocities and accelerations, ``turned`` (n, 3) angular accelerations
    and ``carried`` (n, 4, 3) forces of a :class:`.PreviewSolution`; ``spline`` of a :class:`.BodyReference`.
    """
    times, positions, velocities, accelerations = motion
    then = times[0] + since
    node = min(max(np.searchsorted(times, then, side="right") - 1, 0), accelerations.shape[0] - 1)
    into = min(then - times[node], 0.1)
    for i in range(3):
        rate, change = velocities[node, i], accelerations[node, i]
        com[0, i] = positions[node, i] + into * (rate + 0.5 * into * change)
        com[1, i], com[2, i] = rate + into * change, change
    for leg in range(4):
        for i in range(3):
            forces[leg, i] = carried[node, leg, i] if stands[leg] else 0.0
    at, rotation, rates = np.empty((3, 6)), np.empty((3, 3)), np.empty((2, 3))
    spline_at(spline[0], spline[1], spline[2], then, at)
    turning(at, rotation, rates)
    rates_of[0], rates_of[1] = rates[0], turned[node]
    _quaternion(at[0, 3:], orientation)


@kernel
def _quaternion(attitude: Array, out: Array) -> None:
    """Write w, x, y, z (4,) of roll, pitch, yaw (3,): yaw, then pitch, then roll about the moved axes."""
    cr, sr = np.cos(0.5 * attitude[0]), np.sin(0.5 * attitude[0])
    cp, sp = np.cos(0.5 * attitude[1]), np.sin(0.5 * attitude[1])
    cy, sy = np.cos(0.5 * attitude[2]), np.sin(0.5 * attitude[2])
    out[0] = cr * cp * cy + sr * sp * sy
    out[1] = sr * cp * cy - cr * sp * sy
    out[2] = cr * sp * cy + sr * cp * sy
    out[3] = cr * cp * sy - sr * sp * cy
