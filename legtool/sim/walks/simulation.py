"""One robot, one controller, one world: measure, control, step. Every simulated walk is a loop around it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from legtool.configs.sweep import CONTROL_RATE_HZ, Noise
from legtool.datasets.logs.recording import Recording
from legtool.errors import ControllerError
from legtool.sim.controllers.controller import AnyController
from legtool.sim.controllers.trot.gait import GRAVITY
from legtool.sim.robots.physics import SUBSTEPS
from legtool.sim.robots.robot import SimRobot
from legtool.sim.robots.state import (
    FORCES,
    JOINT_VELOCITIES,
    JOINTS,
    ORIENTATION,
    RATE,
    STATE_SIZE,
    VELOCITY,
    RobotState,
)
from legtool.sim.sensors.state_noise import ERROR_SIZE, SimulatorLayout, measure, sense_errors
from legtool_runtime.rotations import to_base
from legtool_runtime.tracking.contact_plan import ContactPlan
from legtool_runtime.tracking.gait_tracker import Guidance

Array = NDArray[np.float64]

#: A robot has fallen when it leans more than this [rad], or is lower above its feet than this share of standing.
FALL_TILT = 0.9
FALL_HEIGHT = 0.45
#: MuJoCo's warnings after which it begins anew.
_DIVERGED = tuple(int(getattr(mujoco.mjtWarning, f"mjWARN_BAD{what}")) for what in ("QPOS", "QVEL", "QACC"))
_WARNINGS = {
    int(kind): name.removeprefix("mjWARN_").lower()
    for name, kind in mujoco.mjtWarning.__members__.items()
    if name.startswith("mjWARN_")
}
TICK_S = 1.0 / CONTROL_RATE_HZ
TICK_NS = 1_000_000_000 // CONTROL_RATE_HZ


class Simulation:
    """A walk in the making. At each tick: :meth:`observe`, then :meth:`act` on a command.

    Attributes:
        robot: the robot in its world.
        data: MuJoCo's state of it: the truth.
        state: what the robot measured at the last :meth:`observe`.
        tick: number of control ticks done.
        torque: (12,) of the last :meth:`act` [Nm].
    """

    def __init__(
        self,
        robot: SimRobot,
        controller: AnyController,
        *,
        ticks: int,
        noise: Noise | None = None,
        rng: np.random.Generator | None = None,
        position: Array | None = None,
        yaw: float = 0.0,
        delay: int = 0,
    ) -> None:
        """Stand the robot at rest.

        Args:
            robot: the robot in its world.
            controller: makes it walk.
            ticks: how many there will be at most.
            noise: of the robot's estimate of its state; none: it measures the truth.
            rng: of the noise.
            position: (3,) of the base [m]; by default the origin, on a floor at z = 0.
            yaw: heading at the start [rad].
            delay: ticks from the controller's torques to the joints.
        """
        self.robot = robot
        self.controller = controller
        self.data = mujoco.MjData(robot.model)
        self.state = RobotState()
        self.tick = 0
        self.torque = np.zeros(12)
        self._delayed: deque[Array] = deque(maxlen=delay)
        robot.place(self.data, position, yaw=yaw)
        if noise is None:
            self._errors = np.zeros((1, ERROR_SIZE))
        else:
            generator = rng if rng is not None else np.random.default_rng(0)
            self._errors = sense_errors(noise, generator, ticks, rate_hz=CONTROL_RATE_HZ, weight=robot.mass * GRAVITY)
        self._measured = self.data.qpos, self.data.qvel, self.data.sensordata
        self._layout = SimulatorLayout(
            base_qpos=robot.base_qpos,
            base_dof=robot.base_dof,
            qpos=robot.qpos,
            dof=robot.dof,
            sign=robot.joint_sign,
            offset=robot.joint_offset,
            force_sensor=robot.force_sensor,
        )
        self._applied = self.data.qfrc_applied
        self._dof = robot.dof.ravel()
        self._sign = robot.joint_sign.ravel()
        self._lowest = FALL_HEIGHT * robot.geometry.standing_height
        self._upright = np.cos(FALL_TILT)
        self.observe()

    def begin(self) -> None:
        """Let the controller start from the robot at rest."""
        self.controller.reset(self.state)

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return self.tick * TICK_S

    def push(self, change: Array) -> None:
        """Change the base's horizontal velocity at once by (2,), world frame [m/s]."""
        self.data.qvel[self.robot.base_dof : self.robot.base_dof + 2] += change

    def observe(self) -> None:
        """Measure the robot's state."""
        row = self._errors[self.tick] if len(self._errors) > 1 else self._errors[0]
        measure(*self._measured, self._layout, row, self.state.values)

    def act(self, command: Array | ContactPlan | Guidance) -> None:
        """Let the controller act on what was observed, and step the world to the next tick.

        Args:
            command: of the kind that the controller takes.

        Raises:
            ControllerError: it returned something else than twelve finite torques.
        """
        step: Callable[[RobotState, Any], Array] = self.controller.step
        torque = step(self.state, command)
        if np.shape(torque) != (12,) or not np.isfinite(torque).all():
            raise ControllerError(
                f"the controller returned {np.array2string(np.asarray(torque), threshold=3, edgeitems=3)} at "
                f"{self.time_s:.3f} s, expected 12 finite torques"
            )
        if self._delayed.maxlen:
            late = self._delayed[0] if len(self._delayed) == self._delayed.maxlen else np.asarray(torque)
            self._delayed.append(np.array(torque))
            torque = late
        self.torque = torque
        self._applied[self._dof] = self.torque * self._sign
        mujoco.mj_step(self.robot.model, self.data, SUBSTEPS)
        self.tick += 1

    def diverged(self) -> bool:
        """Whether the physics gave up: torques so large that MuJoCo found no finite motion."""
        return any(self.data.warning[kind].number for kind in _DIVERGED)

    def warnings(self) -> dict[str, int]:
        """How often MuJoCo warned, by kind, such as ``badqacc`` where it began anew; kinds of which there are none are
        left out."""
        numbers = [int(one.number) for one in self.data.warning]
        return {_WARNINGS[kind]: number for kind, number in enumerate(numbers) if number}

    def fallen(self) -> bool:
        """Whether the robot lies: leaning, or low above its lowest foot."""
        values = self.state.values
        w, x, y, z = values[ORIENTATION:VELOCITY]
        up = 1.0 - 2.0 * (x * x + y * y)
        if not up > self._upright:
            return True
        feet = self.robot.geometry.feet(values[JOINTS:JOINT_VELOCITIES])
        below = 2.0 * (x * z - w * y) * feet[:, 0] + 2.0 * (y * z + w * x) * feet[:, 1] + up * feet[:, 2]
        return bool(-below.min() < self._lowest)


class WalkLog:
    """Rows of what a robot measured and was told, every so many ticks."""

    def __init__(self, *, ticks: int, every: int) -> None:
        self.every = every
        self._values = np.empty((ticks // every + 1, STATE_SIZE))
        self._commands = np.empty((len(self._values), 3))
        self._torques = np.empty((len(self._values), 12))
        self._rows = 0

    def add(self, values: Array, command: Array, torque: Array) -> None:
        """One more row: ``RobotState.values``, the command in force from now on, and the torques."""
        self._values[self._rows] = values
        self._commands[self._rows] = command
        self._torques[self._rows] = torque
        self._rows += 1

    @property
    def joint_positions(self) -> Array:
        """(n, 4, 3) [rad]."""
        return self._values[: self._rows, JOINTS:JOINT_VELOCITIES].reshape(-1, 4, 3).copy()

    @property
    def joint_velocities(self) -> Array:
        """(n, 4, 3) [rad/s]."""
        return self._values[: self._rows, JOINT_VELOCITIES:FORCES].reshape(-1, 4, 3).copy()

    @property
    def joint_torques(self) -> Array:
        """(n, 4, 3) [Nm]."""
        return self._torques[: self._rows].reshape(-1, 4, 3).copy()

    def recording(self, robot: SimRobot, name: str) -> Recording:
        """The rows as a recording; stamps start at 0."""
        values = self._values[: self._rows]
        orientation = values[:, ORIENTATION:VELOCITY]
        return Recording(
            name=name,
            stamps_ns=np.arange(self._rows, dtype=np.int64) * self.every * TICK_NS,
            position_world=values[:, :ORIENTATION].copy(),
            orientation=orientation.copy(),
            velocity_base=to_base(orientation, values[:, VELOCITY:RATE]),
            yaw_rate=values[:, RATE + 2].copy(),
            command=self._commands[: self._rows].copy(),
            feet_base=robot.geometry.feet(values[:, JOINTS:JOINT_VELOCITIES]),
            contact_force=values[:, FORCES:].copy(),
        )
