"""The trot's clockwork: which legs stand, swing or search for ground, and the instants at which a step begins.

A step runs from one lift-off to the next: a diagonal pair swings, touches down, and all four feet stand until the end
of full stance. That instant is the transition: the command is taken up there and held for the whole step, so that what
a step does follows from the state at its beginning and its command alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.robot import TROT_PAIRS

Array = NDArray[np.float64]

GRAVITY = 9.81
STANDING, STEPPING = 0, 1
STANCE, SWING, SEARCH = 0, 1, 2
#: A stance foot without contact for this long is taken to have lost its ground [s].
LOST_S = 0.03
#: Share of the full stance for which both feet must have stood before the next lift-off, however late they came.
SHORTEST_FULL_STANCE = 0.5

PAIRS = np.array(TROT_PAIRS)

#: What the controller knows about the robot and its gains; one record.
PARAMETERS = np.dtype(
    [
        ("dt", "f8"),
        ("hips", "f8", (4, 3)),
        ("chain", "f8", (4, 3)),
        ("nominal", "f8", (4, 2)),
        ("height", "f8"),
        ("foot_radius", "f8"),
        ("link_mass", "f8", (4, 3)),
        ("link_com", "f8", (4, 3, 3)),
        ("link_inertia", "f8", (4, 3, 3, 3)),
        ("armature", "f8", (4, 3)),
        ("friction", "f8", (4, 3)),
        ("damping", "f8", (4, 3)),
        ("compensated", "f8", (4, 3)),
        ("friction_rate", "f8", (4, 3)),
        ("torque_limit", "f8", (4, 3)),
        ("mass", "f8"),
        ("trunk_mass", "f8"),
        ("trunk_com", "f8", (3,)),
        ("inertia", "f8", (3, 3)),
        ("moment_arm", "f8"),
        ("contact_force", "f8"),
        ("swing_s", "f8"),
        ("full_stance_s", "f8"),
        ("stretch_s", "f8"),
        ("swing_height", "f8"),
        ("search_speed", "f8"),
        ("search_depth", "f8"),
        ("early_contact", "f8"),
        ("arrival", "f8"),
        ("foothold_neutral", "f8"),
        ("foothold_gain_s", "f8"),
        ("foothold_reach", "f8"),
        ("swing_stiffness", "f8"),
        ("swing_damping", "f8"),
        ("velocity_gain", "f8"),
        ("velocity_trim", "f8"),
        ("acceleration_limit", "f8"),
        ("height_stiffness", "f8"),
        ("height_damping", "f8"),
        ("attitude_stiffness", "f8"),
        ("attitude_damping", "f8"),
        ("yaw_gain", "f8"),
        ("hold_stiffness", "f8"),
        ("moment_weight", "f8"),
        ("stance_friction", "f8"),
        ("friction_compensation", "f8"),
        ("load_s", "f8"),
        ("still_speed", "f8"),
        ("kicked_speed", "f8"),
        ("settled_reach", "f8"),
    ],
    align=True,
)

#: What the controller remembers from tick to tick; one record.
MEMORY = np.dtype(
    [
        ("mode", "i8"),
        ("clock", "f8"),
        ("pair", "i8"),
        ("transition", "i8"),
        ("command", "f8", (3,)),
        ("reference", "f8", (3,)),
        ("leg", "i8", (4,)),
        ("load", "f8", (4,)),
        ("lost", "f8", (4,)),
        ("late", "f8", (4,)),
        ("lift_off", "f8", (4, 3)),
        ("target", "f8", (4, 3)),
        ("ground", "f8", (4,)),
        ("forces", "f8", (4, 3)),
        ("dual", "f8", (4, 3)),
    ],
    align=True,
)

#: What one tick derives from the measured state; one record. Feet are relative to the base, world axes.
MOTION = np.dtype(
    [
        ("rotation", "f8", (3, 3)),
        ("yaw", "f8"),
        ("roll", "f8"),
        ("pitch", "f8"),
        ("position", "f8", (3,)),
        ("velocity", "f8", (3,)),
        ("rate", "f8", (3,)),
        ("feet", "f8", (4, 3)),
        ("feet_velocity", "f8", (4, 3)),
        ("contact", "i8", (4,)),
        ("com", "f8", (3,)),
        ("slope", "f8"),
    ],
    align=True,
)


@kernel
def advance(p: np.record, m: np.record, x: np.record, command: Array) -> None:
    """Move the clock by one tick: accept touchdowns, notice lost feet, begin a step at the end of full stance."""
    m.transition = 0
    m.clock += p.dt
    share = m.clock / p.swing_s
    for leg in range(4):
        if m.leg[leg] == STANCE:
            m.load[leg] += p.dt
            m.lost[leg] = 0.0 if x.contact[leg] else m.lost[leg] + p.dt
            if x.contact[leg]:
                m.ground[leg] = x.position[2] + x.feet[leg, 2] - p.foot_radius
            if m.lost[leg] > LOST_S and m.load[leg] > 2 * LOST_S:
                _begin_search(m, x, leg)
        else:
            if m.leg[leg] == SWING and share >= 1.0:
                m.leg[leg] = SEARCH
                m.late[leg] = 0.0
            if m.leg[leg] == SEARCH:
                m.late[leg] += p.dt
            if x.contact[leg] and (m.leg[leg] == SEARCH or share > p.early_contact):
                m.leg[leg] = STANCE
                m.load[leg] = 0.0
                m.lost[leg] = 0.0
                m.ground[leg] = x.position[2] + x.feet[leg, 2] - p.foot_radius
    idle = command[0] == 0.0 and command[1] == 0.0 and command[2] == 0.0
    if m.mode == STANDING:
        if not idle or _kicked(p, x):
            m.mode = STEPPING
            m.clock = p.swing_s
        return
    first, second = PAIRS[m.pair, 0], PAIRS[m.pair, 1]
    stood = min(m.load[first], m.load[second]) if m.leg[first] == STANCE and m.leg[second] == STANCE else 0.0
    due = p.swing_s + p.full_stance_s
    if m.clock < due or (stood < SHORTEST_FULL_STANCE * p.full_stance_s and m.clock < due + p.stretch_s):
        return
    for i in range(3):
        m.command[i] = command[i]
        m.reference[i] = command[i] * (p.velocity_trim if i < 2 else 1.0)
    if idle and _settled(p, x):
        m.mode = STANDING
        return
    m.transition = 1
    m.clock = 0.0
    pair = 0 if m.pair == 1 else 1
    m.pair = pair
    for foot in PAIRS[pair]:
        m.leg[foot] = SWING
        for i in range(3):
            m.lift_off[foot, i] = x.position[i] + x.feet[foot, i]
            m.target[foot, i] = m.lift_off[foot, i]


@kernel
def _begin_search(m: np.record, x: np.record, leg: int) -> None:
    m.leg[leg] = SEARCH
    m.late[leg] = 0.0
    for i in range(3):
        m.target[leg, i] = x.position[i] + x.feet[leg, i]


@kernel
def _off_centre(p: np.record, x: np.record) -> float:
    """Largest horizontal distance of a foot from where it stands at rest [m]."""
    c, s = np.cos(x.yaw), np.sin(x.yaw)
    largest = 0.0
    for leg in range(4):
        dx = x.feet[leg, 0] - (c * p.nominal[leg, 0] - s * p.nominal[leg, 1])
        dy = x.feet[leg, 1] - (s * p.nominal[leg, 0] + c * p.nominal[leg, 1])
        largest = max(largest, np.sqrt(dx * dx + dy * dy))
    return largest


@kernel
def _settled(p: np.record, x: np.record) -> bool:
    speed = np.sqrt(x.velocity[0] ** 2 + x.velocity[1] ** 2)
    return speed < p.still_speed and abs(x.rate[2]) < 0.3 and _off_centre(p, x) < p.settled_reach


@kernel
def _kicked(p: np.record, x: np.record) -> bool:
    speed = np.sqrt(x.velocity[0] ** 2 + x.velocity[1] ** 2)
    return speed > p.kicked_speed or abs(x.roll) > 0.2 or abs(x.pitch + np.arctan(x.slope)) > 0.2
