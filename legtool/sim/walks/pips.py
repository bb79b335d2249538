"""QuadPiPS in the closed loop: torso and foothold search on regions once a frame of the camera."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from legtool.sim.controllers.tracked import TrackedController, standing_feet
from legtool.sim.walks.environment import Observation, PlannedContacts
from legtool.sim.walks.guide import Guide
from legtool.sim.walks.mapping import Mapper
from legtool.sim.walks.monitored import WalkMonitor
from legtool.sim.walks.planners import PlanHistory
from legtool.sim.walks.region_finder import RegionFinder
from legtool.sim.walks.scene import Known
from legtool.sim.walks.stages import StageLog
from legtool.sim.worlds.world import World
from legtool_runtime.errors import TrackingError
from legtool_runtime.perception.regions import Regions
from legtool_runtime.rotations import rotation_of, yaw_of
from legtool_runtime.search.contact_plans import committed, last_places
from legtool_runtime.search.late_plans import arrive
from legtool_runtime.search.monitor import Phase, Reaction, Verdict
from legtool_runtime.search.pips import Pips, PipsPlan
from legtool_runtime.search.settings import Mode, PipsSettings
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.terrain.settings import ElevationSettings
from legtool_runtime.tracking.contact_plan import ContactPlan
from legtool_runtime.tracking.model import TrackedRobot
from legtool_runtime.tracking.reassign import Footholds
from legtool_runtime.tracking.tracker import Tracker

Array = NDArray[np.float64]

#: Of the goal's radius: feet are planned to within the first share of it, and the robot has arrived within the second.
_FEET_WITHIN, _ARRIVED_WITHIN = 0.5, 0.8
#: The deadline of searches that no clock is to end [s].
_NO_DEADLINE_S = 60.0
#: One frame of so many is kept for drawings.
_KEPT = 15
#: What the stages are called in results.
_STAGES = {"candidates": "candidates", "torso": "torso_search", "field": "field", "feet": "foothold_search"}


def pips_for(
    robot: TrackedRobot,
    world: World,
    mode: Mode = "walkable",
    *,
    expansions: int | None = None,
    sight: float | None = None,
) -> Pips:
    """The searches for a robot that is to come within a world's goal.

    Args:
        robot: that the tracker walks.
        world: whose goal has a radius, or none.
        mode: the rules of the searches.
        expansions: of the foothold search, which end it in its deadline's place; None: its deadline does.
        sight: half of the camera's horizontal view [rad]; None: what the robot knows does not come from one camera.
    """
    settings = PipsSettings.of(robot.geometry, mode)
    radius = world.goal_radius_m or settings.goal_tolerance
    feet = replace(settings.feet, tolerance=min(settings.feet.tolerance, _FEET_WITHIN * radius))
    if expansions is not None:
        feet = replace(feet, expansions=expansions, deadline_s=_NO_DEADLINE_S)
    arrived = min(settings.goal_tolerance, _ARRIVED_WITHIN * radius)
    settings = replace(settings, feet=feet, goal_tolerance=arrived, sight=sight if mode == "walkable" else None)
    return Pips(robot.geometry, settings, com_offset=robot.com)


@dataclass(frozen=True, eq=False)
class PlannedFrame:
    """One frame that is kept for drawings.

    Attributes:
        time_s: when [s].
        position: (3,) of the base, world frame [m].
        regions: that were known.
        answer: of the searches.
    """

    time_s: float
    position: Array
    regions: Regions
    answer: PipsPlan


class Latency:
    """How late plans come: each one's delay is drawn, and while one is on its way no other is made."""

    def __init__(self, most_s: float, rng: np.random.Generator) -> None:
        """Take the longest delay [s], and what draws."""
        self._most_s, self._rng = most_s, rng

    def draw(self) -> float:
        """Of one plan [s]."""
        return float(self._rng.uniform(0.0, self._most_s))


class PipsPlanner:
    """Footholds on regions, planned anew at every image.

    Attributes:
        stages: times of the stages, plans that were followed (``replans``), that the tracker refused (``refused``) and
            that came too late to be followed (``stale``), what the monitor told of, feet in the air that were sent
            elsewhere (``reassigned``), and motions that were refused (``swings_refused``) where the body follows
            optimised ones.
        monitor: of the walk.
        history: times of whole plans.
        answer: the latest; None before the first.
        frames: one in so many, for drawings.
    """

    def __init__(
        self,
        pips: Pips,
        world: World,
        controller: TrackedController,
        finder: RegionFinder,
        elevation: ElevationSettings,
        *,
        latency: Latency | None = None,
        acts: bool = True,
    ) -> None:
        """Begin a walk.

        Args:
            pips: the searches.
            world: whose places the walk leads through.
            controller: whose tracker walks the plans, and tells what of them is still ahead.
            finder: of regions.
            elevation: of the map that legs are kept off by.
            latency: of plans on their way to the tracker; None: they are there at once.
            acts: whether the robot does what the monitor says; else it only looks on.
        """
        self.stages, self.history = StageLog(), PlanHistory()
        self.answer: PipsPlan | None = None
        self.frames: list[PlannedFrame] = []
        self._pips, self._controller, self._finder = pips, controller, finder
        self._guide = Guide(world)
        self._mapper = Mapper(controller.robot.geometry, elevation, for_feet=True)
        self._map: HeightMap | None = None
        self._contacts: ContactPlan | None = None
        self._latency = latency
        self._coming: tuple[float, PipsPlan] | None = None
        self._whole_m = np.nan
        self._shown: tuple[PipsPlan | None, Array] = None, np.empty((0, 3))
        self.monitor = WalkMonitor(controller.robot.geometry, self.stages)
        self._acts, self._regions, self._phase = acts, None, Phase.WALKING

    _regions: Regions | None

    @property
    def known(self) -> Known:
        """Its map and regions, and the footholds of the latest plan."""
        feet = None if self.answer is None or self.answer.feet is None else self._places(self.answer)
        times = tuple((name, all_[-1]) for name, all_ in self.stages.times_s.items() if len(all_))
        return Known(terrain=self._map, regions=self._regions, footholds=feet, times_s=times)

    def act(self, observation: Observation) -> PlannedContacts:
        """The plan to follow; another one where a new frame led to it.

        Raises:
            PlannerError: nothing can be planned from where the robot stands at first.
        """
        if (seen := self._mapper.see(observation)) is not None:
            self._map = seen
        tracker = self._controller.tracker
        if tracker is not None:
            tracker.elevation = self._map
            if self.answer is not None and (found := self.answer.candidates) is not None:
                tracker.footholds = Footholds(found.points, found.normals)
        regions = self._finder.see(observation)
        if regions is not None:
            self._regions = regions
        if self._coming is not None and observation.time_s >= self._coming[0]:
            answer, self._coming = self._coming[1], None
            self._follow(answer, observation.time_s, late=True)
        verdict = self.monitor.look(observation, tracker, self.answer, final=self._ends_there(observation))
        if self._acts:
            self._react(verdict, observation, tracker)
        stopped = self._acts and verdict.phase > Phase.WALKING
        asked = (self._acts and verdict.reaction == Reaction.REPLAN) or self._refused_swings(tracker)
        if self._regions is not None and not stopped and self._coming is None and (asked or regions is not None):
            self._plan(observation, self._regions)
        if regions is not None:
            self.monitor.frame()
        assert self._contacts is not None
        return PlannedContacts(self._contacts)

    def _places(self, answer: PipsPlan) -> Array:
        """The footholds (n, 3) of a plan, the same array for as long as it is the latest."""
        if self._shown[0] is not answer and answer.feet is not None:
            places = answer.feet.positions.reshape(-1, 3)
            self._shown = answer, places[np.isfinite(places).all(axis=1)]
        return self._shown[1]

    def _refused_swings(self, tracker: Tracker | None) -> bool:
        """Take transitions that the swing optimisation refuses out of the plans to come; whether there are any."""
        optimised = self._controller.references
        if tracker is None or optimised is None or not optimised.refusals:
            return False
        for one in optimised.refusals:
            self.stages.count(f"swing_refused_{one.rule.replace(' ', '_')}")
            self._pips.refuse(one.before, one.after, tracker.clock_s, ahead=True)
        optimised.refusals.clear()
        return True

    def _react(self, verdict: Verdict, observation: Observation, tracker: Tracker | None) -> None:
        """Stop where the monitor says so."""
        if tracker is None or verdict.reaction < Reaction.HOLD or verdict.phase == self._phase:
            self._phase = verdict.phase
            return
        self._phase, self._coming = verdict.phase, None
        if verdict.avoid and self.answer is not None and self.answer.waypoint is not None:
            self._pips.avoid(self.answer.waypoint, tracker.clock_s)
        if verdict.phase == Phase.STANDING:
            self.stages.blocked_by, self.stages.reason = self.stages.cause(observation.time_s), verdict.reason
        stop = committed(tracker.plan, tracker.clock_s, 0.0).plan
        if self._takes(stop):
            self._contacts = stop

    def _plan(self, observation: Observation, regions: Regions) -> None:
        state, tracker = observation.state, self._controller.tracker
        position = state.position_world
        target = self._guide.target(position)
        began = time.perf_counter()
        answer = self._pips.plan(
            regions,
            position=position,
            yaw=float(yaw_of(rotation_of(state.orientation))),
            feet=standing_feet(self._controller.robot, state),
            goal=target,
            time_s=0.0 if tracker is None else tracker.clock_s,
            plan=None if tracker is None else tracker.plan,
            elevation=self._map,
        )
        self.history.planning_times_s.append(time.perf_counter() - began)
        self._note(answer, regions)
        self.answer = answer
        if len(self.history.planning_times_s) % _KEPT == 1:
            self.frames.append(PlannedFrame(observation.time_s, position.copy(), regions, answer))
        if self._contacts is None:
            self._contacts = answer.plan
        elif answer.changed and self._latency is not None:
            self._coming = observation.time_s + self._latency.draw(), answer
        elif answer.changed:
            self._follow(answer, observation.time_s)

    def _follow(self, answer: PipsPlan, time_s: float, *, late: bool = False) -> None:
        """Hand a plan to the tracker, if it takes it; one that comes late is joined to what feet did meanwhile."""
        plan, tracker, shift = answer.plan, self._controller.tracker, 0.0
        if late and tracker is not None:
            arrival = arrive(plan, tracker.plan, tracker.clock_s, lead_s=self._pips.settings.commit_s)
            if arrival.plan is None:
                self.stages.count("stale")
                return
            plan, shift = arrival.plan, arrival.shift_s
        if not self._takes(plan):
            if answer.feet is not None and len(answer.feet):  # the first transition is not tried again
                places = answer.feet.positions
                self._pips.refuse(places[0], places[1], time_s)
            return
        self.stages.count("replans")
        self.monitor.came(time_s, shift)
        self._contacts = plan

    def _ends_there(self, observation: Observation) -> bool:
        """Whether the plan that is walked ends at the place that is walked to."""
        if self._contacts is None:
            return False
        way = last_places(self._contacts)[0][:, :2].mean(axis=0) - self._guide.target(observation.state.position_world)
        return bool(np.hypot(*way) <= self._pips.settings.goal_tolerance)

    def share(self, observation: Observation) -> float:
        """How much of the way is behind the robot, 0 to 1."""
        left = self._guide.remaining(observation.state.position_world)
        if not np.isfinite(self._whole_m):
            self._whole_m = max(left, 1e-3)
        return 1.0 - left / self._whole_m

    def _takes(self, plan: ContactPlan) -> bool:
        """Whether the tracker takes a plan."""
        try:
            ContactPlan(plan.stances, robot=self._controller.robot.geometry)
        except TrackingError:
            self.stages.count("refused")
            return False
        return True

    def _note(self, answer: PipsPlan, regions: Regions) -> None:
        stages = self.stages
        if (optimised := self._controller.references) is not None:
            stages.times_s["swing"] = optimised.times_s
            stages.counts["swings_refused"] = len(optimised.refused)
        if self._controller.tracker is not None:
            stages.counts["reassigned"] = self._controller.tracker.reassigned
        for key, name in _STAGES.items():
            if key in answer.times_s:
                stages.took(name, answer.times_s[key])
        if self._finder.times_s:
            stages.times_s["perception"] = self._finder.times_s
        stages.blocked_by = stages.reason = ""
        if answer.status == "exhausted":
            stages.count("exhausted")
            stages.reason = answer.reason
            stages.blocked_by = "search" if len(regions) else "perception"
