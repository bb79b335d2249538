"""The robot's own regions: perception fed with its depth images, or the true regions as they are given."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from legtool.sim.walks.environment import DepthImage, Observation
from legtool_runtime.perception.chain import Perception, PerceptionSettings
from legtool_runtime.perception.regions import Regions
from legtool_runtime.robot import Robot
from legtool_runtime.rotations import rotation_of

Labels = NDArray[np.uint8]


class RegionFinder:
    """Makes regions from what a robot observes.

    Attributes:
        times_s: that each frame of perception took.
    """

    def __init__(
        self,
        robot: Robot,
        settings: PerceptionSettings,
        segment: Callable[[NDArray[np.float32]], Labels] | None = None,
    ) -> None:
        """Begin a walk.

        Args:
            robot: who stands on flat ground at its start.
            settings: of perception.
            segment: finds the labels of images that come without; it is waited for, so that a walk does not depend on
                the machine's load.
        """
        self.times_s: list[float] = []
        self._robot, self._settings, self._segment = robot, settings, segment
        self._chain: Perception | None = None
        self._found: Regions | None = None

    def see(self, observation: Observation) -> Regions | None:
        """New regions where there is something new to see; else None.

        Images whose labels are neither given nor found show no ground to step on. Where the camera ahead sees nothing
        at all, as at the end of the world, the regions are those of before.

        Raises:
            PerceptionError: a jump of the robot's pose.
        """
        if observation.regions is not None or observation.image is None:
            return observation.regions
        state, image = observation.state, observation.image
        if self._chain is None:
            self._chain = Perception(
                image.camera, image.transform_camera_to_base, standing_height=self._robot.standing_height,
                settings=self._settings,
            )  # fmt: skip
        base = np.eye(4)
        base[:3, :3], base[:3, 3] = rotation_of(state.orientation), state.position_world
        labelled = [(one, self._labels(one)) for one in (*observation.beside, image) if _shows(one)]
        began = time.perf_counter()
        if not _shows(image):
            self._chain.move(base)
            return self._found
        for one, labels in labelled[:-1]:
            self._chain.look(
                one.depth, base, camera=one.camera, transform_camera_to_base=one.transform_camera_to_base, labels=labels
            )
        self._found = self._chain.update(image.depth, base, labels=labelled[-1][1]).regions
        self.times_s.append(time.perf_counter() - began)
        return self._found

    def _labels(self, image: DepthImage) -> Labels | None:
        return image.labels if image.labels is not None or self._segment is None else self._segment(image.depth)


def _shows(image: DepthImage) -> bool:
    """Whether anything is in a camera's range."""
    return bool((np.isfinite(image.depth) & (image.depth > 0)).any())
