"""A simulated robot in a world: the environment of every closed loop that is not a recorded log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool.configs.camera import DepthCamera
from legtool.configs.sweep import CONTROL_RATE_HZ, Noise
from legtool.errors import ControllerError
from legtool.sim.controllers.controller import AnyController, Orders, takes
from legtool.sim.robots.robot import SimRobot
from legtool.sim.sensors.depth_camera import look, mount
from legtool.sim.walks.environment import Answer, DepthImage, GuidedGait, Observation, PlannedContacts
from legtool.sim.walks.simulation import Simulation
from legtool.sim.worlds.heights import elevation_map
from legtool.sim.worlds.world import World
from legtool_runtime.rotations import rotation_of
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.terrain.settings import ElevationSettings

Array = NDArray[np.float64]

#: Ticks between looks at whether the walk is over.
CHECK_EVERY = 2
TIMEOUT = "timeout"
#: Coming this much nearer to the goal is headway [m].
_HEADWAY_M = 0.05


@dataclass(frozen=True, eq=False)
class Eyes:
    """Where a simulated robot's knowledge of the terrain comes from.

    Attributes:
        camera: its depth camera.
        truth: the true heights are handed out at the camera's rate, as a grid of these settings; None: images.
    """

    camera: DepthCamera
    truth: ElevationSettings | None = None


def _order(answer: Answer) -> tuple[Orders, Any]:
    """What an answer is, and what of it a controller is given."""
    if isinstance(answer, PlannedContacts):
        return "contact plans", answer.plan
    if isinstance(answer, GuidedGait):
        return "guided gaits", answer.guidance
    return "velocity commands", answer.values


class Until(NamedTuple):
    """When a walk is over at the latest.

    Attributes:
        timeout_s: it ends after this [s].
        stall_s: without headway for this long the robot has stalled [s].
        check_every: ticks between looks at whether it is over.
    """

    timeout_s: float = 60.0
    stall_s: float = 30.0
    check_every: int = CHECK_EVERY


class SimulatedRobot:
    """A robot with its controller in a world; an :class:`.Environment`.

    Attributes:
        world: where it walks.
        simulation: physics, controller and measured state; ``simulation.data`` is the truth.
        ticks: the most that there will be.
    """

    def __init__(
        self,
        world: World | None,
        robot: SimRobot,
        controller: AnyController,
        *,
        rng: np.random.Generator,
        noise: Noise | None = None,
        eyes: Eyes | None = None,
        start: tuple[float, float, float] = (0.0, 0.0, 0.0),
        until: Until | None = None,
        delay_s: float = 0.0,
    ) -> None:
        """Stand the robot at rest at the start of the world.

        Args:
            world: in whose physics ``robot`` was built; None: an endless floor at z = 0, without a goal.
            robot: the robot in it.
            controller: makes it walk.
            rng: of all errors of measurement.
            noise: errors of the robot's estimate of its state; none: it measures the truth.
            eyes: its depth camera; none: it is blind.
            start: offset from the world's start: along its heading and to its left [m], and of the heading [rad].
            until: when the walk is over at the latest.
            delay_s: from the controller's torques to the joints [s], rounded to ticks.
        """
        self.world, until = world, until or Until()
        x, y, yaw = (0.0, 0.0, 0.0) if world is None else world.start
        c, s = np.cos(yaw), np.sin(yaw)
        at = np.array([x + c * start[0] - s * start[1], y + s * start[0] + c * start[1]])
        ground = 0.0 if world is None else float(world.height(*at))
        position = np.array([*at, ground + robot.geometry.standing_height])
        self.ticks = round(until.timeout_s * CONTROL_RATE_HZ)
        self.simulation = Simulation(
            robot, controller, ticks=self.ticks, noise=noise, rng=rng, position=position, yaw=yaw + start[2],
            delay=round(delay_s * CONTROL_RATE_HZ),
        )  # fmt: skip
        self._rng, self._eyes, self._until = rng, eyes, until
        self._nearest, self._since_s = np.inf, 0.0
        if eyes is not None:
            self._look_every = max(1, round(CONTROL_RATE_HZ / eyes.camera.rate_hz))
            self._mount = mount(eyes.camera)

    @property
    def time_s(self) -> float:
        """Simulated time [s]."""
        return self.simulation.time_s

    def warm_up(self) -> None:
        """Compile, or load, what an image calls, so that the first of them takes no longer than the others."""
        if self._eyes is not None and self._eyes.truth is None:
            self._image(self._eyes.camera, np.random.default_rng(0))

    def begin(self) -> None:
        """Let the controller start from the robot at rest."""
        self.simulation.begin()

    def observe(self) -> Observation:
        """Measure the robot's state, and take an image when it is time."""
        simulation, eyes = self.simulation, self._eyes
        simulation.observe()
        if eyes is None or simulation.tick % self._look_every:
            return Observation(simulation.time_s, simulation.state)
        if eyes.truth is not None:
            return Observation(simulation.time_s, simulation.state, terrain=self._truth(eyes.truth))
        return Observation(simulation.time_s, simulation.state, image=self._image(eyes.camera, self._rng))

    def apply(self, answer: Answer) -> None:
        """Let the controller act on the planner's answer, and step the world to the next tick.

        Raises:
            ControllerError: the controller does not take such answers.
        """
        (given, order), taken = _order(answer), takes(self.simulation.controller)
        if given != taken:
            name = type(self.simulation.controller).__name__
            raise ControllerError(
                f"the planner answers with {given}, and the controller {name} takes {taken}; choose a planner and a "
                "controller that go together"
            )
        self.simulation.act(order)

    def outcome(self) -> str:
        """Why the walk is over, looked at every few ticks; empty while it goes on."""
        ended = "" if (self.simulation.tick - 1) % self._until.check_every else self._ended()
        return ended or (TIMEOUT if self.simulation.tick >= self.ticks else "")

    def _ended(self) -> str:
        simulation = self.simulation
        if simulation.diverged():
            return "error: the physics diverged under the controller's torques"
        if simulation.fallen():
            return "fell"
        ended = getattr(simulation.controller, "outcome", None)
        stopped: str = "" if ended is None else ended()
        if stopped or takes(simulation.controller) == "contact plans":
            return stopped
        if self.world is None:
            return ""
        left = self.world.remaining(simulation.state.position_world)
        if left <= 0.0:
            return "goal"
        if left < self._nearest - _HEADWAY_M:
            self._nearest, self._since_s = left, simulation.time_s
        elif simulation.time_s - self._since_s > self._until.stall_s:
            return "stalled"
        return ""

    def feet(self) -> tuple[Array, Array]:
        """The truth: (4, 3) lowest points of the feet, world frame [m], and (4,) the forces on them [N]."""
        robot, data = self.simulation.robot, self.simulation.data
        base = data.qpos[robot.base_qpos : robot.base_qpos + 7]
        angles = robot.joint_sign * data.qpos[robot.qpos] + robot.joint_offset
        feet = base[:3] + robot.geometry.feet(angles) @ rotation_of(base[3:]).T
        feet[:, 2] -= robot.geometry.foot_radius
        return feet, data.sensordata[robot.force_sensor]

    def _image(self, camera: DepthCamera, rng: np.random.Generator) -> DepthImage:
        """What the camera measures from where it truly is."""
        robot, data = self.simulation.robot, self.simulation.data
        base = data.qpos[robot.base_qpos : robot.base_qpos + 7]
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation_of(base[3:]), base[:3]
        assert self.world is not None
        image = look(self.world.scene, camera, pose @ self._mount, rng, normals=False)
        return DepthImage(image.depth, camera.camera(), self._mount)

    def _truth(self, settings: ElevationSettings) -> HeightMap:
        assert self.world is not None
        at = self.simulation.state.position_world[:2]
        return elevation_map(self.world, at, settings.size_m, settings.resolution_m)
