"""A learned policy as a black-box controller: ONNX in, joint torques out."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from legtool.configs.policies import JOINT_NAMES, PolicySettings
from legtool.errors import SettingsError
from legtool.sim.robots.physics import CONTROL_RATE_HZ
from legtool.sim.robots.state import RobotState
from legtool_runtime.onnx_session import OnnxSession
from legtool_runtime.rotations import rotation_of

Array = NDArray[np.float64]


class PolicyController:
    """Runs a policy at its own rate and holds its joint targets with a PD law at every control tick."""

    def __init__(self, settings: PolicySettings) -> None:
        """Load the network and check its shapes against the description.

        Raises:
            SettingsError: the file is missing or not ONNX, or its input or output has another size.
        """
        self._settings = settings
        self._session = _load(settings)
        self._input = self._session.inputs[0].name
        order = [JOINT_NAMES.index(name) for name in settings.joint_order]
        self._to_policy = np.array(order)
        self._from_policy = np.argsort(order)
        self._home = np.array(settings.home)
        self._ticks = max(1, round(CONTROL_RATE_HZ / settings.rate_hz))
        self._torque = np.zeros(12)
        self._forget()

    def _forget(self) -> None:
        self._tick = 0
        self._action = np.zeros(12)
        self._frames: deque[Array] = deque(maxlen=self._settings.history)
        self._phase = np.array(self._settings.phase.start) if self._settings.phase else np.zeros(4)
        self._target = self._home[self._from_policy]

    def reset(self, state: RobotState) -> None:
        """Forget the past; the first frame fills the whole history."""
        self._forget()

    def step(self, state: RobotState, command: Array) -> Array:
        """Run one control tick; the network only when its time has come."""
        if self._tick % self._ticks == 0:
            self._think(state, command)
        self._tick += 1
        error = self._target - state.joint_positions.ravel()
        np.multiply(error, self._settings.stiffness, out=self._torque)
        self._torque -= self._settings.damping * state.joint_velocities.ravel()
        return self._torque

    def accepts_command(self) -> bool:
        """A policy reads its command at every tick of its own."""
        return self._tick % self._ticks == 0

    def _think(self, state: RobotState, command: Array) -> None:
        settings = self._settings
        frame = self._frame(state, command)
        self._frames.append(frame)
        while len(self._frames) < settings.history:
            self._frames.append(frame)
        observation = np.concatenate(self._frames).astype(np.float32)[None]
        raw = np.asarray(self._session.run({self._input: observation})[0], dtype=np.float64).ravel()
        clipped = np.clip(raw, -settings.action_clip, settings.action_clip)
        action = settings.action_filter * clipped + (1 - settings.action_filter) * self._action
        self._action = action
        self._target = (self._home + settings.action_scale * action)[self._from_policy]
        if settings.phase is not None:
            self._phase = (self._phase + settings.phase.frequency_hz / settings.rate_hz) % 1.0

    def _frame(self, state: RobotState, command: Array) -> Array:
        rotation = rotation_of(state.orientation)
        phase = self._phase
        if self._settings.phase is not None and not np.any(command):
            phase = np.full(4, self._settings.phase.idle)
        terms = {
            "base_linear_velocity": rotation.T @ state.velocity_world,
            "base_angular_velocity": state.angular_velocity_base,
            "gravity": -rotation[2],
            "command": command,
            "joint_positions": state.joint_positions.ravel()[self._to_policy] - self._home,
            "joint_velocities": state.joint_velocities.ravel()[self._to_policy],
            "last_action": self._action,
            "gait_phase": phase,
        }
        return np.concatenate([terms[term] for term in self._settings.observation])


def _load(settings: PolicySettings) -> OnnxSession:
    if not settings.onnx.is_file():
        raise SettingsError(f"{settings.onnx}: no such policy; set 'onnx' to the network's file")
    session = OnnxSession(settings.onnx, what="policy", error=SettingsError)
    expected = settings.frame_size * settings.history
    for what, size, found in (
        ("input", expected, session.inputs[0].shape),
        ("output", 12, session.outputs[0].shape),
    ):
        if found[-1] != size:
            raise SettingsError(
                f"{settings.onnx}: its {what} has shape {found}, the description asks for {size} "
                f"({settings.history} frames of {settings.frame_size}, 12 joints)"
            )
    return session
