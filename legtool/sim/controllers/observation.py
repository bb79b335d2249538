"""What a policy's network is shown: the terms of an observation, and their history."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from legtool.configs.observation import HeightSamples, NetworkSettings, ObservationTerm
from legtool.configs.policies import JOINT_NAMES, PolicySettings
from legtool.sim.controllers.anymal.heights import heights_at
from legtool.sim.robots.state import RobotState
from legtool_runtime.robot import LEGS, Robot
from legtool_runtime.rotations import rotation_of, yaw_of
from legtool_runtime.terrain.elevation import HeightMap

Array = NDArray[np.float64]


class Senses:
    """What terms are made of at one tick of a policy.

    Attributes:
        state: what the robot measures.
        command: (3,) vx, vy [m/s], yaw rate [rad/s], base frame.
        last_action: (12,) in the order of the network.
        phases: as they are shown [cycles]; empty without a gait clock.
        estimate: what the estimator gave at this tick; empty without one.
        elevation: what is known of the ground, world frame; None: nothing.
    """

    def __init__(self, settings: PolicySettings, robot: Robot) -> None:
        self._settings, self._robot = settings, robot
        self._joints = np.array([JOINT_NAMES.index(name) for name in settings.joint_order])
        self._legs = [LEGS.index(leg) for leg in settings.legs]
        self._home = np.array(settings.home)
        self._places = np.zeros((0, 2)) if settings.heights is None else _places(settings.heights)
        self.state, self.command = RobotState(), np.zeros(3)
        self.last_action, self.phases, self.estimate = np.zeros(12), np.zeros(0), np.zeros(0)
        self.elevation: HeightMap | None = None

    def value(self, term: ObservationTerm) -> Array:
        """What a term shows now: scale × clip(value + offset)."""
        own: Callable[[], Array] | None = getattr(self, f"_{term.term}", None)
        value = np.array(term.values) if own is None else own()
        value = value + np.array(term.offset)
        if term.clip is not None:
            value = np.clip(value, *term.clip)
        return value * np.array(term.scale)

    def _base_linear_velocity(self) -> Array:
        return rotation_of(self.state.orientation).T @ self.state.velocity_world

    def _base_angular_velocity(self) -> Array:
        return self.state.angular_velocity_base

    def _gravity(self) -> Array:
        return -rotation_of(self.state.orientation)[2]

    def _command(self) -> Array:
        return self.command

    def _joint_positions(self) -> Array:
        return self.state.joint_positions.ravel()[self._joints] - self._home

    def _joint_velocities(self) -> Array:
        return self.state.joint_velocities.ravel()[self._joints]

    def _last_action(self) -> Array:
        return self.last_action

    def _gait_phase(self) -> Array:
        return self.phases

    def _gait_phase_sin(self) -> Array:
        return np.sin(2.0 * np.pi * self.phases)

    def _gait_phase_cos(self) -> Array:
        return np.cos(2.0 * np.pi * self.phases)

    def _foot_contacts(self) -> Array:
        return (self.state.foot_forces > self._settings.contact_force)[self._legs].astype(np.float64)

    def _heights(self) -> Array:
        """Base less ground; where nothing is known, the ground is level at the lowest foot."""
        rotation, position = rotation_of(self.state.orientation), self.state.position_world
        feet = self._robot.feet(self.state.joint_positions) @ rotation.T
        lowest = float(position[2] + feet[:, 2].min() - self._robot.foot_radius)
        yaw = float(yaw_of(rotation))
        c, s = np.cos(yaw), np.sin(yaw)
        return position[2] - heights_at(
            self.elevation, position[:2] + self._places @ np.array([[c, s], [-s, c]]), lowest
        )

    def _estimate(self) -> Array:
        return self.estimate


def _places(samples: HeightSamples) -> Array:
    """(n, 2) places of height samples about the base, in their order [m]."""
    if samples.fastest == "y":
        return np.array([(x, y) for x in samples.x for y in samples.y])
    return np.array([(x, y) for y in samples.y for x in samples.x])


class Shown:
    """What one network is shown, tick by tick.

    Attributes:
        size: numbers.
        terms: in words: how many numbers there are, and of what.
    """

    def __init__(self, network: NetworkSettings, policy: PolicySettings) -> None:
        self._network = network
        ages = [network.ages_of(term) for term in network.observation]
        self._past: list[deque[Array]] = [deque(maxlen=max(age) + 1) for age in ages]
        sizes = [policy.size_of(term) for term in network.observation]
        if network.history_by == "time":
            order = [(k, age) for age in network.history for k in range(len(ages))]
        else:
            order = [(k, age) for k, own in enumerate(ages) for age in own]
        self._order = order
        self.size = sum(sizes[k] for k, _ in order)
        each = [
            f"{term.term} {size}" + ("" if network.history_by == "time" else f" × {len(age)}")
            for term, size, age in zip(network.observation, sizes, ages, strict=True)
        ]
        frames = f"{len(network.history)} frames of {sum(sizes)}: " if network.history_by == "time" else ""
        self.terms = f"{self.size} numbers ({frames}{', '.join(each)})"

    def reset(self) -> None:
        """Forget the past."""
        for past in self._past:
            past.clear()

    def observe(self, senses: Senses) -> Array:
        """(size,) what the network is shown now."""
        for term, past in zip(self._network.observation, self._past, strict=True):
            now = senses.value(term)
            if not past:
                past.extend(
                    [now if self._network.history_start == "first" else np.zeros_like(now)] * (past.maxlen or 1)
                )
            past.appendleft(now)
        out = np.concatenate([self._past[k][age] for k, age in self._order])
        limit = self._network.observation_clip
        return out if limit is None else np.clip(out, -limit, limit)

    def wrong(self) -> str:
        """The first term that is not finite now, in words; empty if all are."""
        for term, past in zip(self._network.observation, self._past, strict=True):
            if not np.isfinite(past[0]).all():
                return f"its term {term.term} was not finite"
        return ""
