"""How a robot walked, and what kept it from walking well: its velocity against its commands, what bore its weight, and
which limits its joints and feet were at. All on the true state."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from legtool.configs.sweep import CONTROL_RATE_HZ
from legtool.sim.controllers.trot.gait import GRAVITY
from legtool.sim.robots.mjcf import PREFIX
from legtool.sim.walks.environment import Answer, Observation, VelocityCommand
from legtool.sim.walks.simulated import SimulatedRobot
from legtool_runtime.robot import JOINTS

Array = NDArray[np.float64]

#: Ticks between looks.
EVERY = 8
_LOOK_S = EVERY / CONTROL_RATE_HZ
#: A velocity is compared with its command this long after the last change of the command or push, over at least this
#: long: about a step [s].
_SETTLED_TICKS, _STRETCH_S = CONTROL_RATE_HZ, 0.35
#: At its limit: the share of a torque limit, the distance to a joint's [rad], the share of the friction cone.
_TORQUE, _JOINT, _CONE = 0.999, 0.02, 0.98
#: A foot that bears this share of the weight is loaded.
_LOADED = 0.05
#: A leg that is longer than this share of thigh and shank is straight.
_STRAIGHT = 0.985


class Share(NamedTuple):
    """A mean in the making.

    Attributes:
        total: sum of what was found.
        of: what it is divided by.
    """

    total: float
    of: float


class WalkQuality:
    """Measures a walk under velocity commands; a :class:`.Subscriber`."""

    def __init__(self, environment: SimulatedRobot, disturbed_s: Array) -> None:
        """Look on.

        Args:
            environment: the walk.
            disturbed_s: (n,) times of pushes, increasing [s].
        """
        simulation = environment.simulation
        self._simulation, self._robot = simulation, simulation.robot
        self._model, self._data = self._robot.model, simulation.data
        self._disturbed = [*(disturbed_s * CONTROL_RATE_HZ).tolist(), np.inf]
        self._next = 0
        root = self._model.body_rootid[self._model.dof_bodyid[self._robot.base_dof]]
        self._own = self._model.body_rootid[self._model.geom_bodyid] == root
        self._load, self._touched = np.zeros(self._model.ngeom), np.zeros(self._model.ngeom)
        self._sliding = 0.0
        self._at_torque, self._at_joint = np.zeros(12), np.zeros(12)
        self._feet_down, self._straight = np.zeros(5), 0
        geometry = self._robot.geometry
        thigh, shank = geometry.thigh_length, geometry.shank_length
        # The law of cosines: the knee's cosine at which hip and foot are so far apart.
        self._straightest = ((_STRAIGHT * (thigh + shank)) ** 2 - thigh**2 - shank**2) / (2 * thigh * shank)
        self._looks = 0
        self._error, self._turn_error, self._compared = 0.0, 0.0, 0.0
        self._last: Answer | None = None
        self._since = 0
        self._begin_stretch()

    def begin(self) -> None:
        """Nothing to prepare."""

    def tick(self, observation: Observation, answer: Answer) -> None:
        """Look at the robot when it is time."""
        del observation
        tick = self._simulation.tick
        if answer is not self._last or tick >= self._disturbed[self._next]:
            while tick >= self._disturbed[self._next]:
                self._next += 1
            self._end_stretch()
            self._last, self._since = answer, tick
        if tick % EVERY:
            return
        self._looks += 1
        if tick - self._since >= _SETTLED_TICKS and isinstance(answer, VelocityCommand):
            self._velocity += self._moved() - answer.values
            self._stretch += 1
        self._weigh()
        robot, data = self._robot, self._data
        self._at_torque += np.abs(self._simulation.torque) >= _TORQUE * robot.torque_limit.ravel()
        angles = robot.joint_sign * data.qpos[robot.qpos] + robot.joint_offset
        limits = robot.geometry.joint_limits
        self._at_joint += (np.minimum(angles - limits[..., 0], limits[..., 1] - angles) < _JOINT).ravel()
        self._straight += bool((np.cos(angles[:, 2]) > self._straightest).any())
        self._feet_down[int((data.sensordata[robot.force_sensor] > _LOADED * robot.mass * GRAVITY).sum())] += 1

    def end(self) -> None:
        """Take the last stretch."""
        self._end_stretch()

    def _begin_stretch(self) -> None:
        self._velocity, self._stretch = np.zeros(3), 0

    def _end_stretch(self) -> None:
        if self._stretch * _LOOK_S >= _STRETCH_S:
            error = self._velocity / self._stretch
            self._error += self._stretch * _LOOK_S * float(np.hypot(error[0], error[1]))
            self._turn_error += self._stretch * _LOOK_S * abs(float(error[2]))
            self._compared += self._stretch * _LOOK_S
        self._begin_stretch()

    def _moved(self) -> Array:
        """(3,) vx, vy [m/s] and yaw rate [rad/s] along the trunk's heading."""
        data, robot = self._data, self._robot
        w, x, y, z = data.qpos[robot.base_qpos + 3 : robot.base_qpos + 7]
        yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        c, s = np.cos(yaw), np.sin(yaw)
        vx, vy = data.qvel[robot.base_dof : robot.base_dof + 2]
        return np.array([c * vx + s * vy, -s * vx + c * vy, data.qvel[robot.base_dof + 5]])

    def _weigh(self) -> None:
        """Add up what each shape bears, and how much of it at the edge of the friction cone."""
        data = self._data
        if not data.ncon:
            return
        contact = data.contact
        address, touched = contact.efc_address, set()
        for k in np.flatnonzero(address >= 0):
            a, b = contact.geom[k]
            geom = a if self._own[a] else b
            force = data.efc_force[address[k] : address[k] + 3]
            if force[0] <= 0.0:
                continue
            self._load[geom] += force[0]
            touched.add(int(geom))
            if np.hypot(force[1], force[2]) >= _CONE * contact.friction[k, 0] * force[0]:
                self._sliding += force[0]
        self._touched[list(touched)] += 1

    def measured(self) -> dict[str, Share]:
        """What was found, by name: errors [m/s, rad/s], shares of the load and of the time."""
        load, looks = float(self._load.sum()), float(self._looks)
        found = {
            "velocity_error": Share(self._error, self._compared),
            "yaw_rate_error": Share(self._turn_error, self._compared),
            "sliding": Share(float(self._sliding), load),
            "feet_down": Share(float(self._feet_down @ np.arange(5)), looks),
            "straight": Share(float(self._straight), looks),
            "flight": Share(float(self._feet_down[0]), looks),
        }
        for k, joint in enumerate(JOINTS):
            found[f"at_torque_limit.{joint}"] = Share(float(self._at_torque[k::3].max()), looks)
            found[f"at_joint_limit.{joint}"] = Share(float(self._at_joint[k::3].max()), looks)
        for geom in np.flatnonzero(self._own & (self._model.geom_contype != 0)):
            if geom in self._robot.foot_geoms:
                continue
            name = self._shape_name(int(geom))
            before = found.get(f"load.{name}", Share(0.0, 0.0)), found.get(f"touching.{name}", Share(0.0, 0.0))
            found[f"load.{name}"] = Share(before[0].total + float(self._load[geom]), load)
            found[f"touching.{name}"] = Share(max(before[1].total, float(self._touched[geom])), looks)
        return found

    def _shape_name(self, geom: int) -> str:
        """``shank`` of one on a shank; its own name, or its body's and what it is."""
        model = self._model
        body, shanks = int(model.geom_bodyid[geom]), set(model.dof_bodyid[self._robot.dof[:, 2]].tolist())
        above = body
        while above and above not in shanks:
            above = int(model.body_parentid[above])
        return ("shank " if above else "") + _plain_name(model, geom)


def _plain_name(model: mujoco.MjModel, geom: int) -> str:
    own = model.geom(geom)
    body = model.body(int(model.geom_bodyid[geom])).name.removeprefix(PREFIX)
    if own.name:
        return str(own.name).removeprefix(PREFIX)
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        return f"{body} (mesh {model.mesh(int(model.geom_dataid[geom])).name.removeprefix(PREFIX)})"
    return f"{body} ({mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix('mjGEOM_').lower()})"
