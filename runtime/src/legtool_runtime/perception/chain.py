"""The whole of perception: depth image → normals and labels → egocan → superpixels → convex regions."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime import checks
from legtool_runtime.checks import Bounds
from legtool_runtime.errors import PerceptionError
from legtool_runtime.perception import STEPPABLE
from legtool_runtime.perception.camera import Camera, Depth, as_metres
from legtool_runtime.perception.egocan import Egocan, EgocanSettings, Pose, check_labels
from legtool_runtime.perception.normals import normals
from legtool_runtime.perception.regions import Regions, RegionSettings, convex_regions
from legtool_runtime.perception.steppability import LabelThread, Segmenter
from legtool_runtime.perception.superpixels import FloorGround, Superpixels, SuperpixelSettings, oversegment

LabelImage = NDArray[np.uint8]


@dataclass(frozen=True)
class PerceptionSettings:
    """Settings of each stage, and what is taken for granted at the start.

    Attributes:
        normal_reach: pixels to each side that a normal is fitted over, see :func:`normals.normals`.
        assumed_radius: around its first pose the robot is taken to stand on flat ground this far [m]; 0 for none.
        warm_start: whether superpixels begin where those of the last frame were.
    """

    egocan: EgocanSettings = field(default_factory=EgocanSettings)
    superpixels: SuperpixelSettings = field(default_factory=SuperpixelSettings)
    regions: RegionSettings = field(default_factory=RegionSettings)
    normal_reach: int = 3
    assumed_radius: float = 0.5
    warm_start: bool = True

    def __post_init__(self) -> None:
        bounds = {"normal_reach": Bounds(0, 20, "pixels"), "assumed_radius": Bounds(0.0, 3.0, "m")}
        checks.within("perception", self, bounds, PerceptionError)


class _Frame(NamedTuple):
    """An image that waits for its labels."""

    depth: Depth
    normals: NDArray[np.float32]
    transform_camera_to_world: Pose
    time: float


@dataclass(frozen=True, eq=False)
class Terrain:
    """What is known of the ground at one frame.

    Attributes:
        regions: where feet may be set, world frame.
        superpixels: what the regions were made of.
        label_age: time since the newest labelled image was handed in [s], inf if none was ever labelled.
    """

    regions: Regions
    superpixels: Superpixels
    label_age: float


class Perception:
    """The chain for one camera on one robot. Close it, or use it in a ``with`` block: it owns a thread.

    An image that is refused changes nothing: the next one carries on.
    """

    def __init__(
        self,
        camera: Camera,
        transform_camera_to_base: ArrayLike,
        *,
        standing_height: float,
        segment: Callable[[Depth], LabelImage] | None = None,
        settings: PerceptionSettings | None = None,
    ) -> None:
        """Set up.

        Args:
            camera: intrinsics of the depth camera.
            transform_camera_to_base: (4, 4) mount of its optical frame.
            standing_height: of the base above the ground at the start, ``robot.standing_height`` [m].
            segment: a :class:`Segmenter`; None where labels are given along with each image.
            settings: of the stages.

        Raises:
            PerceptionError: no rigid transform, or a segmenter that was trained for another camera.
        """
        _check_segmenter(segment, camera)
        self.settings = settings or PerceptionSettings()
        self.camera = camera
        self.egocan = Egocan(self.settings.egocan)
        self._mount = checks.pose("transform_camera_to_base", transform_camera_to_base, PerceptionError)
        self._standing_height = standing_height
        self._ground: FloorGround | None = None
        self._previous: Superpixels | None = None
        self._labelled_at = -np.inf
        self._thread: LabelThread[_Frame] | None = None if segment is None else LabelThread(segment)

    def move(self, transform_base_to_world: ArrayLike) -> None:
        """Carry what is known along to a new pose, between images.

        Raises:
            PerceptionError: no rigid transform, or a jump.
        """
        self.egocan.move(transform_base_to_world)
        if self._ground is None and self.settings.assumed_radius > 0:
            x, y, z = np.asarray(transform_base_to_world)[:3, 3]
            self._ground = FloorGround((x, y, z - self._standing_height), self.settings.assumed_radius)

    def look(
        self,
        image: NDArray[Any],
        transform_base_to_world: ArrayLike,
        *,
        camera: Camera,
        transform_camera_to_base: ArrayLike,
        labels: LabelImage | None = None,
    ) -> None:
        """Take in an image of another camera; what it shows is in the regions from the next :meth:`update` on.

        Args:
            image: (height, width) as :func:`camera.as_metres` takes it.
            transform_base_to_world: (4, 4) when it was taken.
            camera: its intrinsics.
            transform_camera_to_base: (4, 4) mount of its optical frame.
            labels: (height, width) index into LABELS; None: its points are unknown, and no ground to step on.

        Raises:
            PerceptionError: an image, pose, mount or label image that cannot be used.
        """
        depth = as_metres(image, camera)
        if labels is not None:
            check_labels(labels, camera)
        mount = checks.pose("transform_camera_to_base", transform_camera_to_base, PerceptionError)
        pose = checks.pose("pose", transform_base_to_world, PerceptionError) @ mount
        found = normals(depth, camera, reach=self.settings.normal_reach)
        self.move(transform_base_to_world)
        self.egocan.insert(depth, found, camera=camera, transform_camera_to_world=pose, labels=labels)

    def update(
        self, image: NDArray[Any] | None, transform_base_to_world: ArrayLike, *, labels: LabelImage | None = None
    ) -> Terrain:
        """Take in a depth image and say where feet may be set.

        Labels of earlier images that the segmenter has finished are taken in; it is never waited for.

        Args:
            image: (height, width) as :func:`camera.as_metres` takes it.
            transform_base_to_world: (4, 4) when it was taken.
            labels: (height, width) index into LABELS, where they are known already.

        Raises:
            PerceptionError: an image, pose or label image that cannot be used.
        """
        if image is None:
            what = "a label image came without its depth image" if labels is not None else "no depth image"
            raise PerceptionError(f"perception: {what}; to move on without an image call move(pose)")
        depth = as_metres(image, self.camera)
        if labels is not None:
            check_labels(labels, self.camera)
        pose = checks.pose("pose", transform_base_to_world, PerceptionError) @ self._mount
        found = normals(depth, self.camera, reach=self.settings.normal_reach)
        now = time.monotonic()
        done = None if self._thread is None else self._thread.take()
        self.move(transform_base_to_world)
        if done is not None:
            then = done.tag
            self._labelled_at = then.time
            self.egocan.relabel(
                done.labels,
                then.depth,
                camera=self.camera,
                transform_camera_to_world=then.transform_camera_to_world,
                normals=then.normals,
            )
        self.egocan.insert(
            depth,
            found,
            camera=self.camera,
            transform_camera_to_world=pose,
            labels=labels,
        )
        if labels is not None:
            self._labelled_at = now
        elif self._thread is not None:
            self._thread.submit(_Frame(depth, found, pose, now), depth)
        superpixels = oversegment(
            self.egocan.floor(),
            self.settings.superpixels,
            previous=self._previous if self.settings.warm_start else None,
            ground=self._ground,
        )
        self._previous = superpixels
        return Terrain(convex_regions(superpixels, self.settings.regions), superpixels, now - self._labelled_at)

    def reset(self) -> None:
        """Forget everything seen: after a jump of the localisation. Ground is assumed anew around the next pose."""
        self.egocan.reset()
        self._ground, self._previous, self._labelled_at = None, None, -np.inf
        if self._thread is not None:
            self._thread.drop()

    def close(self) -> None:
        """End the segmenter's thread."""
        if self._thread is not None:
            self._thread.close()

    def __enter__(self) -> Perception:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _check_segmenter(segment: Callable[[Depth], LabelImage] | None, camera: Camera) -> None:
    """A segmenter reads heights and slopes off its own camera's pixels: those of another it would misread."""
    sensor = segment.sensor if isinstance(segment, Segmenter) else None
    if sensor is None:
        return
    own, given = (
        (c.width, c.height, round(c.fx, 1), round(c.fy, 1), round(c.cx), round(c.cy)) for c in (sensor.camera, camera)
    )
    if not np.allclose(own, given, rtol=0.02, atol=2):
        raise PerceptionError(
            f"segmenter: trained for a camera of width, height, fx, fy, cx, cy {own}, this one has {given}; bring its "
            "images to that camera with depth.fit_camera, or train for this one"
        )


def warm_up() -> None:
    """Compile every kernel of perception, or load it from the user's cache, so that the first image costs no more."""
    camera = Camera.from_field_of_view(64, 48, np.deg2rad(70))
    down = np.array([[0.0, -1, 0, 0], [-1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])
    with Perception(camera, down, standing_height=0.5) as chain:
        labels = np.full((48, 64), STEPPABLE, dtype=np.uint8)
        pose = np.eye(4)
        for image in (np.full((48, 64), 0.5), np.full((48, 64), 0.5, np.float32), np.full((48, 64), 500, np.uint16)):
            pose[0, 3] += 0.01
            chain.update(image, pose, labels=labels)
        chain.egocan.relabel(labels, np.full((48, 64), 0.5, np.float32), camera=camera, transform_camera_to_world=down)
        chain.update(image, pose)
