"""A check of motions in plain NumPy, from link poses alone: nothing of the runtime's kernels is called."""

from __future__ import annotations

import numpy as np

GRAVITY = np.array([0.0, 0.0, -9.81])
TINY = 1e-6


def about(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out = np.eye(3)
    out[i, i], out[i, j], out[j, i], out[j, j] = c, -s, s, c
    return out


def cross_matrix(v: np.ndarray) -> np.ndarray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def turned(vector: np.ndarray) -> np.ndarray:
    """Rotation by a rotation vector."""
    angle = np.linalg.norm(vector)
    if angle < 1e-12:
        return np.eye(3) + cross_matrix(vector)
    k = cross_matrix(vector / angle)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def vector_of(rotation: np.ndarray) -> np.ndarray:
    angle = np.arccos(np.clip(0.5 * (np.trace(rotation) - 1), -1, 1))
    v = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    return 0.5 * v * (angle / np.sin(angle) if angle > 1e-8 else 1.0)


def bodies(robot, base, rotation, joints):
    """Masses (13,), centres (13, 3), rotations (13, 3, 3), inertias (13, 3, 3), and centres of the feet (4, 3)."""
    geometry = robot.geometry
    masses, centres = [robot.trunk_mass], [base + rotation @ robot.trunk_com]
    turns, inertias, feet = [rotation], [robot.trunk_inertia], []
    for leg in range(4):
        frame, origin = rotation @ about(0, joints[3 * leg]), base + rotation @ geometry.hips[leg]
        ways = [
            np.zeros(3), np.array([0, geometry.abduction_offset[leg], 0]), np.array([0, 0, -geometry.thigh_length[leg]])
        ]  # fmt: skip
        for link in range(3):
            origin = origin + frame @ ways[link]
            if link > 0:
                frame = frame @ about(1, joints[3 * leg + link])
            masses.append(robot.link_mass[leg, link])
            centres.append(origin + frame @ robot.link_com[leg, link])
            turns.append(frame)
            inertias.append(robot.link_inertia[leg, link])
        feet.append(origin + frame @ [0, 0, -geometry.shank_length[leg]])
    return np.array(masses), np.array(centres), np.array(turns), np.array(inertias), np.array(feet)


def com_of(robot, base, rotation, joints):
    masses, centres, *_ = bodies(robot, base, rotation, joints)
    return masses @ centres / masses.sum()


def momentum_of(robot, before, after, dt):
    """Angular momentum about the centre of mass (3,) between two configurations (base, rotation, joints)."""
    m, p0, r0, inertias, _ = bodies(robot, *before)
    _, p1, r1, _, _ = bodies(robot, *after)
    velocities, middle = (p1 - p0) / dt, 0.5 * (p0 + p1)
    com, com_velocity = m @ middle / m.sum(), m @ velocities / m.sum()
    total = np.zeros(3)
    for i in range(len(m)):
        spin = vector_of(r1[i] @ r0[i].T) / dt
        total += m[i] * np.cross(middle[i] - com, velocities[i] - com_velocity) + r0[i] @ inertias[i] @ r0[i].T @ spin
    return total


def torques(robot, rotation, joints, forces):
    """(12,) that hold forces on the feet and the legs' weight, by virtual work; the base stays."""
    out = np.empty(12)
    for j in range(12):
        step = TINY * np.eye(12)[j]
        values = []
        for q in (joints + step, joints - step):
            m, centres, _, _, feet = bodies(robot, np.zeros(3), rotation, q)
            values.append(-(m @ centres) @ GRAVITY - (feet * forces).sum())
        out[j] = (values[0] - values[1]) / (2 * TINY)
    return out


def faults(robot, motion, plan, *, friction: float, speed: float) -> list[str]:
    """Everything that is wrong with a motion; empty where nothing is."""
    found = []
    radius, mass = robot.geometry.foot_radius, robot.trunk_mass + robot.link_mass.sum()
    limits = robot.geometry.joint_limits.reshape(12, 2)

    def note(what: str, k: int, value: float, most: float) -> None:
        if not value <= most:
            found.append(f"{what} at knot {k}: {value:.3g}, at most {most:.3g}")

    for k in range(len(motion.times_s)):
        state = motion.base[k], motion.rotations[k], motion.joints[k]
        note("centre of mass", k, np.abs(com_of(robot, *state) - motion.com[k]).max(), 1e-9)
        feet = bodies(robot, *state)[4]
        note("rotation", k, np.abs(state[1] @ state[1].T - np.eye(3)).max(), 1e-9)
        note("joint limit", k, max((limits[:, 0] - state[2]).max(), (state[2] - limits[:, 1]).max()), 0.0)
        if k == len(motion.forces):
            break
        dt, f = motion.times_s[k + 1] - motion.times_s[k], motion.forces[k]
        acceleration = f.sum(axis=0) / mass + GRAVITY
        note("velocity", k, np.abs(motion.velocity[k] + dt * acceleration - motion.velocity[k + 1]).max(), 1e-5)
        place = motion.com[k] + dt * motion.velocity[k] + 0.5 * dt * dt * acceleration
        note("place", k, np.abs(place - motion.com[k + 1]).max(), 1e-5)
        note("joints", k, np.abs(motion.joints[k] + dt * motion.rates[k] - motion.joints[k + 1]).max(), 1e-5)
        note("joint speed", k, np.abs(motion.rates[k]).max(), speed)
        middle, moment = 0.5 * (motion.times_s[k] + motion.times_s[k + 1]), np.zeros(3)
        for leg in range(4):
            stance = plan.current(leg, middle)
            if stance is None:
                note("force in the air", k, np.abs(f[leg]).max(), 1e-9)
                continue
            off = feet[leg] - radius * stance.normal - stance.place
            note("stance", k, np.abs(off).max(), 1e-3)
            along = f[leg] @ stance.normal
            note("friction", k, np.linalg.norm(f[leg] - along * stance.normal) - friction * along, 1e-6)
            steps = (np.arange(200) + 0.5) * dt / 200
            way = motion.com[k] + steps[:, None] * motion.velocity[k] + 0.5 * steps[:, None] ** 2 * acceleration
            moment += np.cross(stance.place - way, f[leg]).mean(axis=0) * dt
        note("moment", k, np.abs(motion.momentum[k] + moment / mass - motion.momentum[k + 1]).max(), 1e-5)
        note("torque", k, (np.abs(torques(robot, *state[1:], f)) / robot.torque_limit.ravel()).max(), 1.0)
        # The angular momentum that the bodies have half-way from knot to knot is the mean of both knots'.
        turn, ways = vector_of(state[1].T @ motion.rotations[k + 1]), motion.base[k + 1] - motion.base[k]
        at = [
            (state[0] + s * ways, state[1] @ turned(s * turn), state[2] + s * dt * motion.rates[k])
            for s in (0.5 - 1e-4, 0.5 + 1e-4)
        ]
        has = momentum_of(robot, *at, 2e-4 * dt) / mass
        note("momentum", k, np.abs(has - 0.5 * (motion.momentum[k] + motion.momentum[k + 1])).max(), 2e-4)
    return found
