"""The runtime on a recorded walk: it sees, maps and plans as on the robot, and what it answers is only noted."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool.sim.walks.environment import Answer, Observation, VelocityCommand
from legtool.sim.walks.planners import VelocityPlanner
from legtool.sim.walks.region_finder import RegionFinder
from legtool.sim.walks.scene import Known
from legtool_runtime.rotations import rotation_of
from legtool_runtime.terrain.costmap import FootCostmap

Array = NDArray[np.float64]


class TimedLabels:
    """A segmenter with a clock.

    Attributes:
        times_s: that each image took: the age of its labels when they are there.
        latest: labels (h, w) of the last image; None before the first.
    """

    def __init__(self, segment: Callable[[NDArray[np.float32]], NDArray[np.uint8]]) -> None:
        self.times_s: list[float] = []
        self.latest: NDArray[np.uint8] | None = None
        self._segment = segment

    def __call__(self, depth: NDArray[np.float32]) -> NDArray[np.uint8]:
        """Label an image."""
        began = time.perf_counter()
        self.latest = self._segment(depth)
        self.times_s.append(time.perf_counter() - began)
        return self.latest


class ReplayPlanner:
    """All that a bundle has for a log: a planner of velocity commands, perception, both, or neither.

    Attributes:
        velocity: the planner; None where there is no map to plan on, or no motion line.
        labels: the segmenter; None without a steppability line.
        images: that were seen.
        regions: numbers of regions that were found in each frame.
    """

    def __init__(
        self,
        velocity: VelocityPlanner | None,
        finder: RegionFinder | None = None,
        labels: TimedLabels | None = None,
    ) -> None:
        self.velocity, self.labels = velocity, labels
        self.images, self.regions = 0, list[int]()
        self._finder = finder
        self._known = Known()

    @property
    def known(self) -> Known:
        """What it knows now."""
        known = self._known if self.velocity is None else self.velocity.known
        if self._finder is None or self.labels is None:
            return known
        times = (*known.times_s, *((("labels", self.labels.times_s[-1]),) if self.labels.times_s else ()))
        return replace(known, regions=self._known.regions, labels=self.labels.latest, times_s=times)

    @property
    def perception_s(self) -> list[float]:
        """Times of perception's frames, without their labels [s]."""
        return [] if self._finder is None else self._finder.times_s

    def act(self, observation: Observation) -> VelocityCommand:
        """What it would command; zero where it plans nothing."""
        if observation.image is not None:
            self.images += 1
            if self._finder is not None and (regions := self._finder.see(observation)) is not None:
                self._known = replace(self._known, regions=regions)
                self.regions.append(len(regions))
        if self.velocity is None:
            return VelocityCommand(np.zeros(3))
        return self.velocity.act(observation)


class Touchdown(NamedTuple):
    """A foot that came down: when [s], which leg, where (3,) world frame [m], and what the map said of that place."""

    time_s: float
    leg: int
    place: Array
    said: str


@dataclass
class Answers:
    """Plans of a walk, counted.

    Attributes:
        plans: how many there were, by how their search ended.
        steps: steps that began, and for how many of them the latest plan before was whole.
        planned: the latter.
        same: ticks at which the answer was what was commanded in fact.
        ticks: all.
    """

    plans: dict[str, int]
    steps: int = 0
    planned: int = 0
    same: int = 0
    ticks: int = 0


class Watcher:
    """Looks on while a log is replayed; a :class:`.Subscriber`.

    Attributes:
        touchdowns: of feet, where the planner follows steps.
        answers: of the planner.
    """

    def __init__(self, planner: ReplayPlanner, commanded: Callable[[], Array]) -> None:
        """Watch a planner; ``commanded`` is the command (3,) of the row that was observed last."""
        self.touchdowns: list[Touchdown] = []
        self.answers = Answers({})
        self._planner, self._commanded = planner, commanded
        self._contact = np.ones(4, dtype=np.bool_)
        self._steps, self._counted = 0, 0

    def begin(self) -> None:
        """Nothing to prepare."""

    def tick(self, observation: Observation, answer: Answer) -> None:
        """Note what came down where, and what was planned."""
        velocity, measured = self._planner.velocity, observation.measured
        if velocity is None or measured is None:
            return
        answers, plan = self.answers, velocity.plan
        answers.ticks += 1
        if isinstance(answer, VelocityCommand):
            answers.same += bool((answer.values == self._commanded()).all())
        if plan is not None and len(velocity.history.planning_times_s) > self._counted:
            self._counted = len(velocity.history.planning_times_s)
            answers.plans[plan.status] = answers.plans.get(plan.status, 0) + 1
        if velocity.tracker.steps > self._steps:
            self._steps = velocity.tracker.steps
            answers.steps += 1
            answers.planned += plan is not None and plan.status in ("goal", "horizon")
        contact = velocity.tracker.contact
        for leg in np.flatnonzero(contact & ~self._contact).tolist():
            state = observation.state
            place = state.position_world + rotation_of(state.orientation) @ measured.feet_base[leg]
            said = what_map_said(velocity.known.costmap, place)
            self.touchdowns.append(Touchdown(observation.time_s, leg, place, said))
        self._contact = contact.copy()

    def end(self) -> None:
        """Nothing to close."""


def what_map_said(costmap: FootCostmap | None, place: Array) -> str:
    """``safe``, ``unsafe`` or ``unknown``, of the cell in which a place (x, y, …) lies, world frame [m]."""
    if costmap is None or not costmap.contains(place):
        return "unknown"
    cell = np.floor((place[:2] - costmap.lower_corner) / costmap.resolution_m).astype(int)
    if not costmap.known[cell[0], cell[1]]:
        return "unknown"
    return "unsafe" if costmap.distance[cell[0], cell[1]] == 0.0 else "safe"
