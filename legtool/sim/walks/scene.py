"""What a planner knows and plans, and what the camera sees, kept as messages of a recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import zstandard
from numpy.typing import NDArray

from legtool.datasets.logs import scene_messages as scene
from legtool.datasets.logs.mcap_writer import Message
from legtool.sim.walks.environment import Answer, DepthImage, Observation
from legtool_runtime.motion.planning.plan import Plan
from legtool_runtime.perception.regions import Regions
from legtool_runtime.rotations import rotation_of
from legtool_runtime.terrain.costmap import FootCostmap
from legtool_runtime.terrain.elevation import HeightMap

Array = NDArray[np.float64]

#: Topics of what is seen and planned.
DEPTH, INFO = "/camera/depth/image", "/camera/depth/camera_info"
MAP, HEIGHTS, CLOUD, REGIONS, LABELS, PLAN, FEET = (
    "/map/steppable", "/map/elevation", "/camera/points", "/regions", "/camera/labels", "/plan", "/footsteps",
)  # fmt: skip
#: Maps, clouds and regions are kept so often, plans so often at most [s].
_MAP_S, _PLAN_S = 0.5, 0.1
#: Of clouds, one pixel of so many in each direction.
_EVERY = 4
#: Left legs are blue, right ones orange.
_LEG_COLOURS = np.array([scene.BLUE, scene.ORANGE, scene.BLUE, scene.ORANGE])


@dataclass(frozen=True, eq=False)
class Known:
    """What a planner knows at one moment, and the plan that it made of it; None where there is none.

    Attributes:
        terrain: heights around the robot.
        costmap: where feet may stand.
        regions: planar regions that a foot may be set on.
        labels: (h, w) of the last image that was labelled.
        plan: of velocity commands.
        footholds: (n, 3) planned, world frame [m], for planners that plan feet.
        times_s: of the latest of each stage, by name [s].
    """

    terrain: HeightMap | None = None
    costmap: FootCostmap | None = None
    regions: Regions | None = None
    labels: NDArray[np.uint8] | None = None
    plan: Plan | None = None
    footholds: Array | None = None
    times_s: tuple[tuple[str, float], ...] = ()


#: What a planner knows that sees nothing.
NOTHING = Known()


class SceneRecorder:
    """Keeps what a planner knows as messages; a :class:`.Subscriber`.

    Attributes:
        messages: in the order of time.
    """

    def __init__(self, known: Callable[[], Known], stamp_ns: Callable[[Observation], int]) -> None:
        """Look at what a planner knows.

        Args:
            known: what it knows now.
            stamp_ns: time of logging of an observation [ns].
        """
        self.messages: list[Message] = []
        self._known, self._stamp_ns = known, stamp_ns
        self._map_due_s = self._plan_due_s = -np.inf
        self._last: Known = Known()

    def begin(self) -> None:
        """Nothing to prepare."""

    def tick(self, observation: Observation, answer: Answer) -> None:
        """What is new since the last tick."""
        del answer
        known, now, stamp = self._known(), observation.time_s, self._stamp_ns(observation)
        fresh = known.costmap is not self._last.costmap or known.terrain is not self._last.terrain
        if (fresh or known.regions is not self._last.regions) and now >= self._map_due_s - 1e-9:
            self._map_due_s = now + _MAP_S
            self._maps(known, observation, stamp)
        if known.plan is not None and known.plan is not self._last.plan and now >= self._plan_due_s - 1e-9:
            self._plan_due_s = now + _PLAN_S
            self.messages.append(plan_message(stamp, known.plan, observation.state.position_world))
        if known.footholds is not None and known.footholds is not self._last.footholds:
            shape = scene.Shape("footholds", scene.SPHERE_LIST, known.footholds, scene.GREEN, 0.04)
            self.messages.append(scene.markers(stamp, PLAN, [shape]))
        told = dict(self._last.times_s)
        self.messages += [
            scene.number(stamp, f"/times/{name}", value) for name, value in known.times_s if told.get(name) != value
        ]
        self._last = known

    def end(self) -> None:
        """Nothing to close."""

    def _maps(self, known: Known, observation: Observation, stamp: int) -> None:
        if known.costmap is not None:
            self.messages.append(scene.occupancy(stamp, MAP, known.costmap))
        if known.terrain is not None:
            self.messages.append(scene.grid_map(stamp, HEIGHTS, known.terrain))
        if known.regions is not None:
            self.messages.append(scene.markers(stamp, REGIONS, scene.outlines(known.regions)))
        if known.labels is not None and known.labels is not self._last.labels:
            self.messages.append(scene.image(stamp, LABELS, known.labels))
        if observation.image is not None:
            self.messages.append(scene.points(stamp, CLOUD, seen_points(observation.image, observation)))


class CameraRecorder:
    """Keeps the images of the depth camera, exactly and compressed; a :class:`.Subscriber`.

    Attributes:
        messages: images, with the camera's intrinsics and place before the first of them.
        mount: (4, 4) optical frame to base; None before the first image.
    """

    def __init__(self, stamp_ns: Callable[[Observation], int]) -> None:
        self.messages: list[Message] = []
        self.mount: Array | None = None
        self._stamp_ns = stamp_ns

    def begin(self) -> None:
        """Nothing to prepare."""

    def tick(self, observation: Observation, answer: Answer) -> None:
        """An image, where there is a new one."""
        del answer
        if (image := observation.image) is None:
            return
        stamp = self._stamp_ns(observation)
        if self.mount is None:
            self.mount = image.transform_camera_to_base
            self.messages.append(scene.camera_info(stamp, INFO, image.camera))
            self.messages.append(scene.fixed_frame(stamp, self.mount))
        message = scene.image(stamp, DEPTH, image.depth)
        assert isinstance(message.data, bytes)
        packed = zstandard.ZstdCompressor(level=1).compress(message.data)
        self.messages.append(message._replace(data=lambda: zstandard.ZstdDecompressor().decompress(packed)))

    def end(self) -> None:
        """Nothing to close."""


def plan_message(stamp: int, plan: Plan, position: Array) -> Message:
    """A plan of velocity commands: the way of the CoM, and where its feet are to come down."""
    way = np.vstack([position[None], plan.position]) if len(plan.position) else np.empty((0, 3))
    touchdowns = plan.touchdowns.reshape(-1, 3)
    colours = _LEG_COLOURS[plan.legs.reshape(-1)] if len(touchdowns) else np.empty((0, 4))
    shapes = [
        scene.Shape("way", scene.LINE_STRIP, way, scene.VIOLET, 0.01),
        scene.Shape("touchdowns", scene.SPHERE_LIST, touchdowns, colours, 0.04),
    ]
    return scene.markers(stamp, PLAN, shapes)


def seen_points(image: DepthImage, observation: Observation) -> NDArray[np.float32]:
    """(n, 3) what some pixels of a depth image saw, at the pose that the robot believes, world frame [m]."""
    camera, depth = image.camera, image.depth[::_EVERY, ::_EVERY]
    v, u = np.nonzero(np.isfinite(depth) & (depth > 0))
    z = depth[v, u].astype(np.float64)
    x, y = (_EVERY * u - camera.cx) / camera.fx * z, (_EVERY * v - camera.cy) / camera.fy * z
    mount, state = image.transform_camera_to_base, observation.state
    in_base = np.stack([x, y, z], axis=1) @ mount[:3, :3].T + mount[:3, 3]
    return (in_base @ rotation_of(state.orientation).T + state.position_world).astype(np.float32)
