"""A simulated robot in a world: the environment of every closed loop that is not a recorded log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool.configs.camera import DepthCamera
from legtool.configs.sweep import CONTROL_RATE_HZ, Noise
from legtool.errors import ControllerError
from legtool.sim.controllers.controller import AnyController, Orders, show, takes
from legtool.sim.controllers.trot.gait import GRAVITY
from legtool.sim.robots.robot import SimRobot
from legtool.sim.sensors.depth_camera import SideCamera, look, mount
from legtool.sim.walks.environment import (
    Answer,
    DepthImage,
    GuidedGait,
    Observation,
    PlannedContacts,
    VelocityCommand,
)
from legtool.sim.walks.guide import Guide
from legtool.sim.walks.simulation import Simulation
from legtool.sim.worlds.heights import TrueHeights
from legtool.sim.worlds.labels import label_image
from legtool.sim.worlds.steppable_regions import near, steppable_regions
from legtool.sim.worlds.world import World
from legtool_runtime.perception.regions import Regions
from legtool_runtime.rotations import rotation_of
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.terrain.settings import ElevationSettings

Array = NDArray[np.float64]

#: Ticks between looks at whether the walk is over.
CHECK_EVERY = 2
GOAL, TIMEOUT = "goal", "timeout"
#: Coming this much nearer to the goal is headway [m].
_HEADWAY_M = 0.05
#: True heights and regions are made this far beyond what is handed out at the ends of the way [m].
_ABOUT_M = 0.5
#: A foot that bears this share of the weight is loaded.
_LOADED = 0.03


@dataclass(frozen=True, eq=False)
class Eyes:
    """Where a simulated robot's knowledge of the terrain comes from.

    Attributes:
        camera: its depth camera.
        truth: the true heights are handed out at the camera's rate, as a grid of these settings; None: images.
        regions_m: the true regions are handed out, as far as this from the robot [m]; None: none are.
        images: whether images are taken where the true heights are handed out.
        labelled_m: images come with true labels, by which feet swing over what is as high as this [m]; None: without.
        beside: other cameras that take images with the first one.
    """

    camera: DepthCamera
    truth: ElevationSettings | None = None
    regions_m: float | None = None
    images: bool = False
    labelled_m: float | None = None
    beside: tuple[SideCamera, ...] = ()


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
        at_goal: a contact plan that is walked does not end it, but all feet on the ground within the goal's radius.
    """

    timeout_s: float = 60.0
    stall_s: float = 30.0
    check_every: int = CHECK_EVERY
    at_goal: bool = False


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
        if world is not None:
            self._guide = Guide(world)
        if eyes is not None:
            self._look_every = max(1, round(CONTROL_RATE_HZ / eyes.camera.rate_hz))
            self._mounts = [(eyes.camera, mount(eyes.camera))]
            self._mounts += [(side.camera, mount(side.camera, yaw=side.yaw)) for side in eyes.beside]
        self._regions: Regions | None = None
        self._heights: TrueHeights | None = None

    @property
    def time_s(self) -> float:
        """Simulated time [s]."""
        return self.simulation.time_s

    def warm_up(self) -> None:
        """Compile, or load, what an image calls, so that the first of them takes no longer than the others."""
        self._images(np.random.default_rng(0))

    def begin(self) -> None:
        """Let the controller start from the robot at rest."""
        self.simulation.begin()

    def observe(self) -> Observation:
        """Measure the robot's state, and take an image when it is time."""
        simulation, eyes = self.simulation, self._eyes
        simulation.observe()
        if eyes is None or simulation.tick % self._look_every:
            return Observation(simulation.time_s, simulation.state)
        images = self._images(self._rng)
        return Observation(
            simulation.time_s,
            simulation.state,
            image=images[0] if images else None,
            terrain=None if eyes.truth is None else self._truth(eyes.truth),
            regions=None if eyes.regions_m is None else self._true_regions(eyes.regions_m),
            beside=tuple(images[1:]),
        )

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
        if isinstance(answer, VelocityCommand):
            show(self.simulation.controller, answer.terrain)
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
        ended, at_goal = getattr(simulation.controller, "outcome", None), self._until.at_goal
        stopped: str = "" if ended is None else ended()
        if at_goal and stopped == GOAL:
            stopped = ""  # the plan is walked, and there may be another
        if stopped or self.world is None or (takes(simulation.controller) == "contact plans" and not at_goal):
            return stopped
        left = self._guide.remaining(simulation.state.position_world)
        if left <= 0.0 and (not at_goal or self._stands()):
            return GOAL
        if left < self._nearest - _HEADWAY_M:
            self._nearest, self._since_s = left, simulation.time_s
        elif simulation.time_s - self._since_s > self._until.stall_s:
            return "stalled"
        return ""

    def _stands(self) -> bool:
        """Whether all feet bear load, by what the robot measures."""
        simulation = self.simulation
        return bool((simulation.state.foot_forces > _LOADED * simulation.robot.mass * GRAVITY).all())

    def feet(self) -> tuple[Array, Array]:
        """The truth: (4, 3) lowest points of the feet, world frame [m], and (4,) the forces on them [N]."""
        robot, data = self.simulation.robot, self.simulation.data
        base = data.qpos[robot.base_qpos : robot.base_qpos + 7]
        angles = robot.joint_sign * data.qpos[robot.qpos] + robot.joint_offset
        feet = base[:3] + robot.geometry.feet(angles) @ rotation_of(base[3:]).T
        feet[:, 2] -= robot.geometry.foot_radius
        return feet, data.sensordata[robot.force_sensor]

    def _images(self, rng: np.random.Generator) -> list[DepthImage]:
        """What its cameras measure, that ahead first; none where the true heights stand in for images."""
        eyes = self._eyes
        if eyes is None or (eyes.truth is not None and not eyes.images):
            return []
        return [self._image(camera, place, eyes.labelled_m, rng) for camera, place in self._mounts]

    def _image(
        self, camera: DepthCamera, place: Array, labelled_m: float | None, rng: np.random.Generator
    ) -> DepthImage:
        """What a camera measures from where it truly is."""
        robot, data = self.simulation.robot, self.simulation.data
        base = data.qpos[robot.base_qpos : robot.base_qpos + 7]
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation_of(base[3:]), base[:3]
        assert self.world is not None
        seen_from = pose @ place
        image = look(self.world.scene, camera, seen_from, rng, normals=labelled_m is not None)
        intrinsics, labels = camera.camera(), None
        if labelled_m is not None:
            labels = label_image(self.world, image.seen, intrinsics, seen_from, swing_height_max=labelled_m)
        return DepthImage(image.depth, intrinsics, place, labels)

    def _truth(self, settings: ElevationSettings) -> HeightMap:
        if self._heights is None:
            low, high = self._area(0.5 * settings.size_m)
            assert self.world is not None
            self._heights = TrueHeights(self.world, low, high, settings.resolution_m)
        return self._heights.around(self.simulation.state.position_world[:2], settings.size_m)

    def _true_regions(self, radius_m: float) -> Regions:
        """Those around where the robot believes to be, of all that lie about its way."""
        if self._regions is None:
            low, high = self._area(radius_m)
            assert self.world is not None
            self._regions = steppable_regions(self.world, (low[0], low[1]), (high[0], high[1]))
        return near(self._regions, self.simulation.state.position_world, radius_m)

    def _area(self, reach_m: float) -> tuple[Array, Array]:
        """Lower and upper corner (2,) of what is handed out of the truth while the robot is about its way [m]."""
        assert self.world is not None
        places = np.concatenate([self.world.start[None, :2], self.world.points()])
        places = places[np.isfinite(places).all(axis=1)]
        return places.min(axis=0) - reach_m - _ABOUT_M, places.max(axis=0) + reach_m + _ABOUT_M
