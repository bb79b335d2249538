"""Whole-body control: joint torques and contact forces that best give the wanted motion of trunk and feet at one tick.

One quadratic program over the joint accelerations and the forces of the standing feet, the base's acceleration
eliminated by the first six rows of M q̈ + h = S'τ + Σ J'f; after Bellicoso et al., "Dynamic locomotion through online
nonlinear motion optimization for quadrupedal robots" (RA-L 2018), with weights in place of strict priorities. It
minimises weighted squares of how far it falls short of

- standing feet at rest: J_c q̈ + J̇_c q̇ = -k v_c, at the points that touch the ground;
- swinging feet on their path: acceleration + stiffness × error + damping × error of the velocity;
- the trunk's orientation and the centre of mass in the same way, the latter by the sum of the forces;
- the forces of the preview, and small joint accelerations, both with little weight;

with friction pyramids about the contact normals, a least normal force and torque limits as hard bounds, which some
motion always satisfies, and joint limits as bounds that give way only where nothing else will do.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.cache import kernel
from legtool_runtime.errors import RobotError
from legtool_runtime.tracking.assembly import (
    ROWS,
    UNKNOWNS,
    Gains,
    Limits,
    References,
    Scratch,
    assemble,
    joint_drag,
    make_scratch,
    scaled,
)
from legtool_runtime.tracking.dynamics import DOF, GRAVITY, FullState, Model, Terms, dynamics_terms, make_terms
from legtool_runtime.tracking.model import TrackedRobot
from legtool_runtime.tracking.qp import Program, Room, make_program, make_room, solve

Array = NDArray[np.float64]

#: The height of ANYmal C standing at rest, for which the gains are written [m].
REFERENCE_HEIGHT = 0.55
#: What became of a tick: solved; no foot stands, so that only the swinging feet were controlled; the program was not
#: solved, and :func:`_fall_back` answered; state or references cannot be used (not finite, a normal or an orientation
#: not of unit length, no friction), and the torques of the last tick stay.
SOLVED, NO_STANCE, UNSOLVED, REFUSED = range(4)
#: Rate at which swinging legs are braked where there is no answer [1/s].
_BRAKE = 10.0


class Answer(NamedTuple):
    """What one tick decided; the arrays are overwritten at the next.

    ``torques`` (12,) of the motors, within their limits [Nm]; ``forces`` (4, 3) on the feet, world [N];
    ``acceleration`` (18,) in the order of the velocities; ``friction_margin`` (4,) 1 - |tangent| / (friction × normal)
    of the force of each standing foot, NaN of the others: at 0 it slips; along the diagonal of the pyramid it may be
    below; ``torque_share`` largest torque as a share of its limit; ``status`` SOLVED, NO_STANCE, UNSOLVED or REFUSED;
    ``iterations`` of the solver.
    """

    torques: Array
    forces: Array
    acceleration: Array
    friction_margin: Array
    torque_share: float
    status: int
    iterations: int

    @property
    def solved(self) -> bool:
        """Whether the torques are the program's: else they stay, carry the weight, or only swing legs."""
        return self.status == SOLVED


class WholeBody:
    """Whole-body control of one robot.

    Attributes:
        robot: what it controls.
        gains: scaled to the robot.
        terms: of the equation of motion, at the last tick's state.
    """

    def __init__(self, robot: TrackedRobot, gains: Gains | None = None) -> None:
        """Prepare.

        Args:
            robot: what it controls.
            gains: for a robot of ANYmal C's height; they are scaled to this one's.

        Raises:
            RobotError: a gain is negative or not finite, or a weight that must be positive is zero.
        """
        wanted = gains or Gains()
        for name, value in wanted._asdict().items():
            positive = name in ("joint_weight", "force_weight", "joint_limit_weight", "least_force", "letting_go")
            if not (np.isfinite(value) and (value > 0 if positive else value >= 0)):
                expected = "a positive number" if positive else "zero or more"
                raise RobotError(f"whole-body control: gain {name} is {value}, expected {expected}")
        self.robot = robot
        self.gains = scaled(wanted, robot.geometry.standing_height / REFERENCE_HEIGHT)
        self.terms = make_terms()
        limits = robot.geometry.joint_limits
        self._model = robot.model()
        self._limits = Limits(
            limits[..., 0].copy(),
            limits[..., 1].copy(),
            robot.torque_limit.copy(),
            robot.joint_friction.copy(),
            robot.joint_damping.copy(),
        )
        self._scratch = make_scratch()
        self._solver = make_program(UNKNOWNS, ROWS), make_room(UNKNOWNS, ROWS)
        self._out = np.zeros(12), np.zeros((4, 3)), np.zeros(DOF), np.zeros(4)

    @property
    def firm(self) -> Array:
        """(4,) how firmly standing feet were held to their places at the last tick: 1; 0 of a leg that ran against its
        limit and let its foot go."""
        return self._scratch.firm

    def control(self, state: FullState, wanted: References) -> Answer:
        """Torques and forces for this tick. It never raises for what a walk may bring: see ``Answer.status``.

        Args:
            state: measured, of the shapes in :class:`FullState`, float64 and contiguous.
            wanted: of the shapes in :class:`References`.
        """
        program, room = self._solver
        status, iterations, share = _tick(
            self._model, self._limits, self.gains, state, wanted, self.terms, self._scratch, program, room, self._out
        )
        return Answer(*self._out, share, status, iterations)


@kernel
def _tick(
    model: Model, limits: Limits, gains: Gains, state: FullState, wanted: References, terms: Terms, scratch: Scratch,
    program: Program, room: Room, out: tuple[Array, Array, Array, Array],
) -> tuple[int, int, float]:  # fmt: skip
    """Control one tick: its status, the solver's iterations and the largest share of a torque limit."""
    if not _usable(state, wanted):
        return REFUSED, 0, _torque_share(limits, out[0])
    dynamics_terms(model, state, wanted.normals, terms)
    n = assemble(model, limits, gains, state, wanted, terms, scratch, program)
    iterations = solve(program, n, (n - 12) // 3 * 4 + 12, room, scratch.unknowns)
    status = SOLVED if n > 12 else NO_STANCE
    if iterations > 0:
        _read(model.mass, scratch, n, out)
    else:
        status = UNSOLVED
        _fall_back(model.mass, limits, state, wanted, terms, scratch, out)
    torques, forces, margin = out[0], out[1], out[3]
    for leg in range(4):
        for joint in range(3):
            most = limits.torque[leg, joint]
            torques[3 * leg + joint] = min(most, max(-most, torques[3 * leg + joint]))
        margin[leg] = _friction_margin(forces[leg], wanted.normals[leg], wanted.friction[leg])
        if not wanted.stance[leg]:
            margin[leg] = np.nan
    return status, iterations, _torque_share(limits, torques)


@kernel
def _usable(state: FullState, wanted: References) -> bool:
    """Whether everything that will be read is finite, orientations and contact normals are of unit length."""
    for values in (state.position, state.orientation, state.velocity, wanted.orientation):
        for value in values:
            if not np.isfinite(value):
                return False
    for table in (state.joints, wanted.com, wanted.turning, wanted.normals):
        for value in table.flat:
            if not np.isfinite(value):
                return False
    for orientation in (state.orientation, wanted.orientation):
        if not abs(np.sum(orientation * orientation) - 1.0) < 0.01:
            return False
    for leg in range(4):
        if not abs(np.sum(wanted.normals[leg] * wanted.normals[leg]) - 1.0) < 1e-3:
            return False
        if wanted.stance[leg]:
            friction = wanted.friction[leg]
            if not (np.isfinite(np.sum(wanted.forces[leg])) and 0.0 < friction < np.inf):
                return False
        elif not np.isfinite(np.sum(wanted.swing[leg])):
            return False
    return True


@kernel
def _read(mass: float, scratch: Scratch, n: int, out: tuple[Array, Array, Array, Array]) -> None:
    """Torques, forces and accelerations from the unknowns."""
    z = scratch.unknowns
    torques, forces, acceleration = out[0], out[1], out[2]
    for i in range(12):
        value = scratch.torque_free[i]
        for k in range(n):
            value += scratch.torque[i, k] * z[k]
        torques[i] = value
        acceleration[6 + i] = z[i]
    for i in range(6):
        value = scratch.base_free[i]
        for k in range(n):
            value += scratch.base[i, k] * z[k]
        acceleration[i] = value
    for leg in range(4):
        first = scratch.first[leg]
        for i in range(3):
            value = 0.0
            if first >= 0:
                for axis in range(3):
                    value += mass * scratch.frames[leg, i, axis] * z[first + axis]
            forces[leg, i] = value
            scratch.solved_forces[leg, i] = value


@kernel
def _fall_back(
    mass: float, limits: Limits, state: FullState, wanted: References, terms: Terms, scratch: Scratch,
    out: tuple[Array, Array, Array, Array],
) -> None:  # fmt: skip
    """What is applied in place of an answer that does not exist: the last solved forces of the feet that still stand.

    They are scaled so that they carry the robot's weight, or are its even shares where there is nothing to scale; the
    torques hold them and the legs' own weight, and brake the swinging legs. One that is not finite stays as it was.
    """
    torques, forces, acceleration = out[0], out[1], out[2]
    for i in range(DOF):
        acceleration[i] = 0.0
    weight = mass * GRAVITY
    carried, standing = 0.0, 0
    for leg in range(4):
        if wanted.stance[leg]:
            carried += scratch.solved_forces[leg, 2]
            standing += 1
    for leg in range(4):
        for i in range(3):
            forces[leg, i] = 0.0
            if wanted.stance[leg]:
                if carried > 0.5 * weight:
                    forces[leg, i] = scratch.solved_forces[leg, i] * weight / carried
                elif i == 2:
                    forces[leg, i] = weight / standing
        for joint in range(3):
            row = 6 + 3 * leg + joint
            value = terms.bias[row]
            if wanted.stance[leg]:
                value += joint_drag(limits, state, scratch.rates, leg, joint)
            else:
                value -= _BRAKE * terms.mass[row, row] * state.velocity[row]
            for i in range(3):
                value -= terms.contact_jacobian[leg, i, row] * forces[leg, i]
            if np.isfinite(value):
                torques[3 * leg + joint] = value


@kernel
def _friction_margin(force: Array, normal: Array, friction: float) -> float:
    along = force[0] * normal[0] + force[1] * normal[1] + force[2] * normal[2]
    square = force[0] * force[0] + force[1] * force[1] + force[2] * force[2]
    if not (along > 0.0 and friction > 0.0):
        return 0.0
    return 1.0 - np.sqrt(max(square - along * along, 0.0)) / (friction * along)


@kernel
def _torque_share(limits: Limits, torques: Array) -> float:
    most = 0.0
    for leg in range(4):
        for joint in range(3):
            most = max(most, abs(torques[3 * leg + joint]) / limits.torque[leg, joint])
    return most
