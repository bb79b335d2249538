"""What a closed loop is made of: an environment that a robot is in, and a planner that is told what the robot knows.

Nothing here knows a simulator: a recorded log can stand where :class:`.SimulatedRobot` stands.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from legtool.sim.robots.state import RobotState
from legtool_runtime.perception.camera import Camera
from legtool_runtime.perception.regions import Regions
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.contact_plan import ContactPlan
from legtool_runtime.tracking.gait_tracker import Guidance

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DepthImage:
    """One image of the robot's depth camera.

    Attributes:
        depth: (h, w) float32 along the optical axis [m], NaN without return.
        camera: intrinsics.
        transform_camera_to_base: (4, 4) optical frame to base.
        labels: (h, w) index into LABELS, the truth, where a suite hands it out; None: they are to be found.
    """

    depth: NDArray[np.float32]
    camera: Camera
    transform_camera_to_base: Array
    labels: NDArray[np.uint8] | None = None


@dataclass(frozen=True, eq=False)
class Measured:
    """What a log holds of a robot at one instant, in the form in which step trackers take it.

    Attributes:
        velocity: (3,) vx, vy [m/s], yaw rate [rad/s], base frame.
        feet_base: (4, 3) relative to the trunk's origin, base frame [m].
        commanded: (3,) velocity command in force until now, whoever gave it.
    """

    velocity: Array
    feet_base: Array
    commanded: Array


@dataclass(frozen=True, eq=False)
class Observation:
    """What a robot knows at one tick.

    Attributes:
        time_s: since the start of the walk [s].
        state: as the robot measures it; overwritten at the next tick.
        image: of its depth camera, at the ticks at which there is a new one.
        terrain: the true heights around the robot instead of an image, where a suite hands them out (``map=truth``).
        regions: the true regions around the robot, where a suite hands them out (``regions=truth``).
        beside: images of other cameras, taken with ``image``.
        measured: what a recorded log says of the robot, whose joints may not be known.
    """

    time_s: float
    state: RobotState
    image: DepthImage | None = None
    terrain: HeightMap | None = None
    regions: Regions | None = None
    beside: tuple[DepthImage, ...] = ()
    measured: Measured | None = None


@dataclass(frozen=True, eq=False)
class VelocityCommand:
    """One answer of a planner: what a controller that takes velocity commands is to do from now on.

    Attributes:
        values: (3,) vx, vy [m/s] and yaw rate [rad/s], base frame.
        terrain: what the planner knows of the ground, for controllers that see it (``controller.show``); None: nothing.
    """

    values: Array
    terrain: HeightMap | None = None


@dataclass(frozen=True, eq=False)
class PlannedContacts:
    """Another answer: which foot is to stand where and when, for a controller that takes contact plans.

    Attributes:
        plan: on the walk's clock; the same one for as long as it is to be followed.
    """

    plan: ContactPlan


@dataclass(frozen=True, eq=False)
class GuidedGait:
    """A third answer: a gait's velocity, the places where its feet may stand, and the trunk's pose.

    Attributes:
        guidance: from now on.
    """

    guidance: Guidance


#: Everything that a planner may answer, each with a controller that takes it.
Answer = VelocityCommand | PlannedContacts | GuidedGait


class Environment(Protocol):
    """A robot somewhere: simulated in a world, or recorded in a log."""

    @property
    def time_s(self) -> float:
        """Time since the start [s]."""

    def begin(self) -> None:
        """Start."""

    def observe(self) -> Observation:
        """What the robot knows now."""

    def apply(self, answer: Answer) -> None:
        """Carry out a planner's answer until the next tick."""

    def outcome(self) -> str:
        """Why the walk is over (``goal``, ``fell``, ``stalled``, ``timeout``, an error); empty while it goes on."""


class WalkPlanner(Protocol):
    """Decides what the robot does next, from what the robot knows."""

    def act(self, observation: Observation) -> Answer:
        """The answer from now on; asked for at every tick."""


class Subscriber(Protocol):
    """Looks on: recorder, film, watchdog, missteps."""

    def begin(self) -> None:
        """The walk begins."""

    def tick(self, observation: Observation, answer: Answer) -> None:
        """One more tick was carried out."""

    def end(self) -> None:
        """The walk is over, however it went."""
