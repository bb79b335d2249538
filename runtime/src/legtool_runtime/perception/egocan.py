"""The egocan: what the robot has seen around and beneath it, as images (QuadPiPS, section IV-A and V-C).

A panoramic cylinder, closed by a floor and a ceiling cap, in the *levelled frame*: x ahead, y to the left, z up, with
the base's yaw and its origin in the base (or above it by ``lift``). Every cell holds the exact point that fell into it,
its normal and its label. The paper's can stands in the camera frame, which a pitched camera would tilt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime import checks, rotations
from legtool_runtime.checks import Bounds, instance
from legtool_runtime.errors import PerceptionError
from legtool_runtime.perception import LABELS
from legtool_runtime.perception import egocan_kernels as kernels
from legtool_runtime.perception import egocan_view_kernels as view_kernels
from legtool_runtime.perception.camera import Camera, Depth
from legtool_runtime.perception.normals import normals as find_normals

Pose = NDArray[np.float64]
Floats = NDArray[np.float32]

_BOUNDS = {
    "width": Bounds(8, 4096, "cells"),
    "height": Bounds(8, 4096, "cells"),
    "side": Bounds(8, 4096, "cells"),
    "vertical_field_of_view": Bounds(np.pi / 6, 2 * np.pi / 3, "rad (30° to 120°)"),
    "lift": Bounds(0.0, 2.0, "m"),
    "largest_translation": Bounds(0.0, np.inf, "m", above=True),
    "largest_rotation": Bounds(0.0, np.inf, "rad", above=True),
}
_NO_LABELS = np.empty(0, dtype=np.uint8)
_NO_IMAGE = np.empty((0, 0), dtype=np.uint8)


@dataclass(frozen=True)
class EgocanSettings:
    """Size of the can and what it takes for a jump.

    Attributes:
        width, height: cells of the cylinder around and up.
        side: cells along each side of a cap.
        vertical_field_of_view: of the cylinder [rad]. The floor image reaches (height above the floor) ·
            cot(vertical_field_of_view / 2): 1.73 heights at 60°.
        lift: height of the can's origin above the base [m]; lifting it widens the floor image.
        largest_translation, largest_rotation: motion between two poses that is believed [m], [rad].
    """

    width: int = 512
    height: int = 128
    side: int = 256
    vertical_field_of_view: float = np.pi / 3
    lift: float = 0.0
    largest_translation: float = 0.5
    largest_rotation: float = 0.7

    def __post_init__(self) -> None:
        checks.within("egocan", self, _BOUNDS, PerceptionError)

    @property
    def cap_focal_length(self) -> float:
        """f_low of equation 4, (side / 2) · tan(v_fov / 2) [cells]."""
        return 0.5 * self.side * float(np.tan(0.5 * self.vertical_field_of_view))


@dataclass(frozen=True, eq=False)
class CanImage:
    """One surface of the can, a copy.

    Attributes:
        points: (a, b, 3) levelled frame [m], NaN where the cell is empty. The cylinder is indexed (v, u): v down, u to
            the right, ahead in the middle. A cap is indexed (ix, iy): x ahead, y to the left.
        normals: (a, b, 3) levelled frame, NaN where unknown.
        labels: (a, b) index into LABELS.
        focal_length: cells per unit of x/|z| of a cap, 0 for the cylinder.
        transform_to_world: (4, 4) of the levelled frame.
    """

    points: Floats
    normals: Floats
    labels: NDArray[np.uint8]
    focal_length: float
    transform_to_world: Pose

    @property
    def known(self) -> NDArray[np.bool_]:
        """(a, b) whether the cell holds a point."""
        return ~np.isnan(self.points[..., 0])


@dataclass(frozen=True, eq=False)
class _Labelled:
    """The last frame whose labels are known."""

    labels: NDArray[np.uint8]
    view: view_kernels.DepthView
    transform_camera_to_world: Pose


class Egocan:
    """The can and its contents.

    A cell belongs to the nearest return. A point is forgotten when the camera sees through its place, or when it moves
    behind a nearer one; what is out of sight is kept. Points of a frame without labels take them from the last frame
    that has some, where it saw the same surface.
    """

    def __init__(self, settings: EgocanSettings | None = None) -> None:
        self.settings = s = settings or EgocanSettings()
        rim = np.tan(0.5 * s.vertical_field_of_view)
        self._shape = (s.width, s.height, s.side)
        # The cylinder's rows are spread over the whole field of view, so that cylinder and caps close: equation 2's
        # focal length is its special case v_fov = 2 atan(π h / w).
        self._scale = np.array([s.width / (2 * np.pi), 0.5 * s.height / rim, s.cap_focal_length, rim], dtype=np.float32)
        size = s.width * s.height + 2 * s.side**2
        self._can, self._spare = (
            kernels.Can(
                np.full(size, np.inf, dtype=np.float32),
                np.zeros((size, 6), dtype=np.float32),
                np.zeros(size, dtype=np.uint8),
            )
            for _ in range(2)
        )
        self._fresh = np.empty(size, dtype=np.float32)
        self._source = np.empty(size, dtype=np.int32)
        self._found = np.empty(size, dtype=np.uint8)
        self._pixel = np.empty(size, dtype=np.int32)
        # What is found in a frame is not needed while the can moves.
        self._scratch = kernels.EgocanScratch(
            np.empty((3, size), dtype=np.float32), self._source, self._fresh, self._pixel
        )
        self._pose: Pose | None = None
        self._labelled: _Labelled | None = None

    @property
    def transform_to_world(self) -> Pose:
        """(4, 4) pose of the levelled frame.

        Raises:
            PerceptionError: before the first :meth:`move`.
        """
        if self._pose is None:
            raise PerceptionError("egocan: it has no pose yet; call move(transform_base_to_world) first")
        return self._pose

    def reset(self) -> None:
        """Forget everything, the pose too: after a jump of the localisation."""
        self._can.near[:] = np.inf
        self._can.labels[:] = 0
        self._pose = None
        self._labelled = None

    def move(self, transform_base_to_world: ArrayLike) -> None:
        """Carry the contents along to the robot's new pose (equation 3, with exact points).

        Args:
            transform_base_to_world: (4, 4).

        Raises:
            PerceptionError: no pose, or a jump; the can is as it was.
        """
        pose = self.levelled(transform_base_to_world)
        if self._pose is not None:
            motion = np.linalg.inv(pose) @ self._pose
            distance, angle = np.linalg.norm(motion[:3, 3]), abs(np.arctan2(motion[1, 0], motion[0, 0]))
            if distance > self.settings.largest_translation or angle > self.settings.largest_rotation:
                raise PerceptionError(
                    f"pose: it jumped by {distance:.2f} m and {np.rad2deg(angle):.0f}° since the last one, expected at "
                    f"most {self.settings.largest_translation:g} m and "
                    f"{np.rad2deg(self.settings.largest_rotation):.0f}°; "
                    "if the localisation was corrected, call reset() and go on"
                )
            if distance > 0 or angle > 0:
                kernels.move(_split(motion), self._shape, self._scale, self._can, self._spare, self._scratch)
                self._can, self._spare = self._spare, self._can
        self._pose = pose

    def insert(
        self,
        depth: Depth,
        normals: Floats,
        *,
        camera: Camera,
        transform_camera_to_world: ArrayLike,
        labels: NDArray[np.uint8] | None = None,
    ) -> None:
        """Add a depth image taken at the pose that the can was last moved to.

        Args:
            depth: (height, width) [m], NaN where there is no return: see :func:`camera.as_metres`.
            normals: (height, width, 3) optical frame, NaN where unknown.
            camera: the camera that took it.
            transform_camera_to_world: (4, 4) of the optical frame.
            labels: (height, width) index into LABELS; None where they come later, see :meth:`relabel`.

        Raises:
            PerceptionError: images of different sizes, or no pose; the can is as it was.
        """
        _check_images(depth, camera, normals=normals, labels=labels)
        to_can = np.linalg.inv(self.transform_to_world) @ _pose(transform_camera_to_world)
        view, forward = view_kernels.DepthView(depth, normals, camera.intrinsics), _split(to_can)
        self._look_again(view, _split(np.linalg.inv(to_can)), _NO_LABELS)
        view_kernels.nearest(view, forward, self._shape, self._scale, self._fresh, self._source)
        frame_labels = _NO_IMAGE if labels is None else labels
        view_kernels.merge(view, frame_labels, forward, self._fresh, self._source, self._found, self._can)
        if labels is not None:
            self._labelled = _Labelled(labels, view, _pose(transform_camera_to_world))
        elif self._labelled is not None:
            self._apply(self._labelled, only_unknown=True)

    def relabel(
        self,
        labels: NDArray[np.uint8],
        depth: Depth,
        *,
        camera: Camera,
        transform_camera_to_world: ArrayLike,
        normals: Floats | None = None,
    ) -> None:
        """Give the points that an earlier depth image saw the labels that have now come for it.

        Args:
            labels: (height, width) index into LABELS; unknown leaves a point's label as it is.
            depth: (height, width) the image that they belong to [m].
            camera: the camera that took it.
            transform_camera_to_world: (4, 4) of the optical frame when it was taken.
            normals: (height, width, 3) of that image, optical frame; None to find them anew.

        Raises:
            PerceptionError: images of different sizes, labels out of range, or no pose.
        """
        _check_images(depth, camera, normals=normals, labels=labels)
        pose = _pose(transform_camera_to_world)
        view = view_kernels.DepthView(
            depth, find_normals(depth, camera) if normals is None else normals, camera.intrinsics
        )
        self._labelled = _Labelled(labels, view, pose)
        self._apply(self._labelled, only_unknown=False)

    def _apply(self, frame: _Labelled, *, only_unknown: bool) -> None:
        from_can: Pose = np.linalg.inv(frame.transform_camera_to_world) @ self.transform_to_world
        known = self._can.labels if only_unknown else _NO_LABELS
        self._look_again(frame.view, _split(from_can), known)
        view_kernels.relabel(frame.labels, self._found, self._pixel, self._can.labels)

    def _look_again(self, view: view_kernels.DepthView, from_can: kernels.Transform, known: NDArray[np.uint8]) -> None:
        view_kernels.look_again(view, from_can, self._can, known, self._found, self._pixel, self._source)

    def cylinder(self) -> CanImage:
        """The panorama, (height, width)."""
        return self._image(0, (self.settings.height, self.settings.width), 0.0)

    def floor(self) -> CanImage:
        """The floor image, (side, side)."""
        return self._image(
            self.settings.width * self.settings.height, (self.settings.side,) * 2, self.settings.cap_focal_length
        )

    def ceiling(self) -> CanImage:
        """The ceiling image, (side, side)."""
        start = self.settings.width * self.settings.height + self.settings.side**2
        return self._image(start, (self.settings.side,) * 2, self.settings.cap_focal_length)

    def _image(self, begin: int, shape: tuple[int, int], focal_length: float) -> CanImage:
        points, normals = np.empty((2, *shape, 3), dtype=np.float32)
        labels = np.empty(shape, dtype=np.uint8)
        kernels.extract(self._can, begin, points.reshape(-1, 3), normals.reshape(-1, 3), labels.reshape(-1))
        return CanImage(points, normals, labels, focal_length, self.transform_to_world)

    def levelled(self, transform_base_to_world: ArrayLike) -> Pose:
        """(4, 4) levelled frame to world of a base pose (4, 4)."""
        base = _pose(transform_base_to_world)
        out = np.eye(4)
        out[:3, :3] = rotations.about_z(rotations.yaw_of(base))
        out[:3, 3] = base[:3, 3]
        out[2, 3] += self.settings.lift
        return out


def _pose(transform: ArrayLike) -> Pose:
    return checks.pose("pose", transform, PerceptionError)


def _split(transform: NDArray[np.floating]) -> kernels.Transform:
    return kernels.Transform(transform[:3, :3].astype(np.float32), transform[:3, 3].astype(np.float32))


def _check_images(
    depth: Depth, camera: Camera, *, normals: Floats | None = None, labels: NDArray[np.uint8] | None = None
) -> None:
    size = (camera.height, camera.width)
    if depth.shape != size or depth.dtype != np.float32:
        raise PerceptionError(
            f"depth image: {depth.dtype} {depth.shape}, expected float32 {size}; take it through camera.as_metres"
        )
    if normals is not None and (normals.shape != (*size, 3) or normals.dtype != np.float32):
        raise PerceptionError(f"normals: {normals.dtype} {normals.shape}, expected float32 {(*size, 3)}")
    if labels is not None:
        check_labels(labels, camera)


def check_labels(labels: NDArray[np.uint8], camera: Camera) -> None:
    """Refuse what is no label image of a camera.

    Raises:
        PerceptionError: another type, size, or values that name no label.
    """
    size = (camera.height, camera.width)
    instance("label image", labels, np.ndarray, PerceptionError)
    if labels.shape != size or labels.dtype != np.uint8:
        raise PerceptionError(
            f"label image: {labels.dtype} {labels.shape}, expected uint8 {size} like the depth image it belongs to"
        )
    if labels.max(initial=0) >= len(LABELS):
        raise PerceptionError(
            f"label image: value {labels.max()}, expected 0 to {len(LABELS) - 1}: {', '.join(LABELS)}"
        )
