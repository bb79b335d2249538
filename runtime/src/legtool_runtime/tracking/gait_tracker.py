"""A gait on footholds that are chosen on the way: ViTAL's foothold selection and body poses over the tracker.

At each lift-off the feet that lift are given their footholds, and again in mid-swing; what follows after them is
foretold by the gait, so that body reference and preview see where the feet will be.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool_runtime.errors import TrackingError
from legtool_runtime.foothold.settings import CriteriaSettings
from legtool_runtime.rotations import rotation_of, yaw_of
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.tracking.assembly import Gains
from legtool_runtime.tracking.contact_plan import ContactPlan, Stance, foot_at
from legtool_runtime.tracking.foothold_choice import Choice, FootholdChooser, Trunk
from legtool_runtime.tracking.gaits import GaitTiming, walked_on
from legtool_runtime.tracking.model import TrackedRobot
from legtool_runtime.tracking.pendulum import frequency
from legtool_runtime.tracking.selectors import Place, Selector, any_place, place_at
from legtool_runtime.tracking.settings import TrackerSettings
from legtool_runtime.tracking.tracker import SIZE_M, MeasuredState, Tracker

Array = NDArray[np.float64]

#: The first feet lift off after this [s].
_START_S = 0.3
#: The gait is foretold for so long: the preview's horizon, what the reference is smoothed over, and a step more [s].
_AHEAD_S = 2.6

#: Feet that swing by the criteria's path rise steeply: with less weight they stay behind it and meet risers, with more
#: they shake the trunk.
_GAINS = Gains(swing_weight=3.0)


class Guidance(NamedTuple):
    """What a gait is walked by from now on.

    ``command`` (3,) forward, left [m/s], yaw rate [rad/s], in the heading's frame; ``select`` finds the place for a
    foot; ``pose`` (3,) of the trunk, see :meth:`.Tracker.aim`, None: as the feet imply; ``elevation``: the ground, to
    keep legs off it and to judge touchdowns by, None: nothing is known of it; ``paced``: the trunk slows down and stops
    where footholds stay behind (:meth:`.FootholdChooser.pace`).
    """

    command: tuple[float, float, float]
    select: Selector
    pose: Array | None = None
    elevation: HeightMap | None = None
    paced: bool = True


class Chosen(NamedTuple):
    """A foothold chosen for a leg: when by the robot's clock [s], and at which phase of its swing."""

    leg: int
    time_s: float
    phase: float
    choice: Choice


class GaitTracker:
    """Walks a gait by velocity commands.

    Attributes:
        robot: whose torques it gives.
        timing: of the gait; replaced ones count from the next lift-off on.
        tracker: that carries it out; None before the first tick.
        chosen: every foothold that was chosen, in order.
    """

    def __init__(self, robot: TrackedRobot, timing: GaitTiming, *, settings: TrackerSettings | None = None) -> None:
        """Take the robot, its gait, and settings of tracking; None: those for feet on maps, :meth:`settings_for`."""
        self.robot, self.timing = robot, timing
        self.tracker: Tracker | None = None
        self.chosen: list[Chosen] = []
        self._settings = settings or self.settings_for(robot)
        self._chooser = FootholdChooser(robot.geometry, timing, any_place(None), com_offset=robot.com)
        self._guidance: Guidance | None = None
        #: Share of the commanded velocity that the footholds allow.
        self._pace = 1.0
        self._time_s = 0.0
        self._start_s = 0.0

    @staticmethod
    def settings_for(robot: TrackedRobot, **changes: object) -> TrackerSettings:
        """Settings for feet on maps: they swing as the foothold criteria judge it, go far down for the ground, and the
        trunk may sag: held at its height, it is nearer to a planned pose by a millimetre, and HyQ falls more on risers
        of 14 cm."""
        geometry = robot.geometry
        size = (geometry.standing_height - geometry.foot_radius + float(robot.com[2])) / SIZE_M
        usual = {
            "swing_profile": "judged", "swing_height_m": CriteriaSettings.for_robot(geometry).swing_height_m / size,
            "search_speed": 0.4, "search_depth_m": 0.25, "aim_below_m": 0.01, "held": "mass",
        }  # fmt: skip
        return TrackerSettings(**{**usual, **changes})  # type: ignore[arg-type]

    def step(self, state: MeasuredState, time_s: float, guidance: Guidance) -> Array:
        """Run one tick, see :meth:`.Tracker.step`.

        A command or pose that cannot be used stops the robot in mid-walk (:attr:`.Tracker.fault`).

        Raises:
            TrackingError: the same at the first tick.
        """
        if fault := _fault(guidance):
            if self.tracker is None:
                raise TrackingError(fault)
            self.tracker.stop(fault)
            return self.tracker.step(state, time_s)
        self._guidance, self._time_s = guidance, time_s
        if self.tracker is None:
            self._start_s = time_s + _START_S
            self.tracker = Tracker(
                self.robot, self._standing(state), settings=self._settings, gains=_GAINS, lead=self._lead
            )
        self.tracker.elevation = guidance.elevation
        return self.tracker.step(state, time_s)

    def _standing(self, state: MeasuredState) -> ContactPlan:
        """The plan of a robot that stands as it does now."""
        robot = self.robot.geometry
        feet = state.position + robot.feet(state.joints) @ rotation_of(state.orientation).T
        feet[:, 2] -= robot.foot_radius
        return ContactPlan([[Stance(-math.inf, math.inf, place, np.array([0.0, 0.0, 1.0]))] for place in feet])

    def _lead(self, tracker: Tracker) -> None:
        """Choose the footholds that are due, and foretell those after them."""
        assert self._guidance is not None
        guidance, plan, now = self._guidance, tracker.plan, tracker.clock_s
        command = self._paced()
        tracker.aim(guidance.pose)
        if not math.isfinite(plan.stances[0][-1].begin_s):
            tracker.follow(self._foretold(tracker, plan), checked=True)
            plan = tracker.plan
        lifting = []
        if not tracker.late().any():
            lifting = [leg for leg in range(4) if tracker.contact[leg] and plan.index(leg, now) is None]
        chooser, rows = self._chooser, [list(row) for row in plan.stances]
        chooser.select, chooser.elevation = guidance.select, guidance.elevation
        if lifting:
            chooser.timing = self.timing
        found: dict[int, Choice] = {}
        for leg in range(4):
            phase = 0.0 if leg in lifting or tracker.contact[leg] else tracker.phase(leg)
            again = not tracker.contact[leg] and phase < 1.0 and chooser.due(leg, phase)
            k = next((k for k, s in enumerate(rows[leg]) if s.begin_s > now), None) if leg in lifting or again else None
            if k is None:
                continue
            trunk, others = self._trunk(tracker, leg, rows[leg][k].begin_s)
            if leg in lifting:
                stood = Place(rows[leg][k - 1].place, rows[leg][k - 1].normal)
                choice: Choice | None = chooser.lift_off(
                    leg, trunk, stood=stood, command=command, asked=guidance.command, **others
                )
            else:
                aimed = Place(rows[leg][k].place, rows[leg][k].normal)
                choice = chooser.again(leg, trunk, phase=phase, aimed=aimed, command=command, **others)
            if choice is not None:
                found[leg] = choice
                rows[leg][k] = replace(rows[leg][k], place=choice.place.point, normal=choice.place.normal)
                self.chosen.append(Chosen(leg, self._time_s, phase, choice))
        if found:
            self._pace = chooser.pace(guidance.command, float(yaw_of(tracker.terms.rotation)))
            tracker.follow(self._foretold(tracker, ContactPlan(rows)), checked=True)

    def _paced(self) -> tuple[float, float, float]:
        """The command, as fast as the footholds allow; nothing turns either while feet go back to where they stood."""
        assert self._guidance is not None
        vx, vy, rate = self._guidance.command
        if not self._guidance.paced:
            return vx, vy, rate
        return self._pace * vx, self._pace * vy, 0.0 if self._chooser.held else rate

    def _trunk(self, tracker: Tracker, leg: int, touchdown_s: float) -> tuple[Trunk, dict[str, object]]:
        """The trunk now, as planned at a touchdown, and what the nominal foothold of the gait is made from."""
        terms, reference, com = tracker.terms, tracker.reference, self.robot.com
        yaw = float(yaw_of(terms.rotation))
        if reference is None:
            height, roll, pitch = float(terms.com[2] - com[2]), 0.0, 0.0
        else:
            roll, pitch, _ = (float(value) for value in reference.at(touchdown_s).attitude)
            height = float(reference.base_at(touchdown_s, com)[2])
        trunk = Trunk(terms.com.copy(), terms.com_velocity.copy(), yaw, height, roll, pitch)
        if self._chooser.crawls:
            implied = self._implied(tracker.plan, tracker.clock_s, yaw)
            return trunk, {"implied": implied, "divergence": self._divergence(tracker, touchdown_s)}
        group = next(legs for legs in self.timing.groups if leg in legs)
        feet = terms.feet[[other for other in range(4) if other not in group]].copy()
        feet[:, 2] -= self.robot.geometry.foot_radius
        return trunk, {"diagonal": feet}

    def _implied(self, plan: ContactPlan, time_s: float, yaw: float) -> tuple[float, float, float]:
        """x, y [m] of the centre of mass and yaw [rad] that the feet imply."""
        feet, offset = np.empty((4, 3)), (self.robot.geometry.stance - self.robot.com).mean(axis=0)
        for leg in range(4):
            foot_at(plan.table, leg, time_s, feet[leg])
        across = feet[:2].mean(axis=0) - feet[2:].mean(axis=0)
        turned = math.atan2(across[1], across[0])
        # Feet that are close together say nothing of the heading.
        turned = turned if math.hypot(*across[:2]) > 0.1 else yaw
        c, s = math.cos(turned), math.sin(turned)
        x, y = feet[:, :2].mean(axis=0)
        return float(x - c * offset[0] + s * offset[1]), float(y - s * offset[0] - c * offset[1]), turned

    def _divergence(self, tracker: Tracker, time_s: float) -> Array:
        """(2,) by how much the divergent component of the preview is off that of the reference at a time [m]."""
        solution, reference = tracker.preview, tracker.reference
        if solution is None or reference is None or not solution.solved:
            return np.zeros(2)
        node = solution.node(min(time_s, float(solution.times_s[-1])))
        at = reference.at(float(solution.times_s[node]))
        omega = frequency(float(tracker.terms.com[2] - tracker.terms.feet[:, 2].mean()))
        off = solution.position[node] - at.position + (solution.velocity[node] - at.velocity) / omega
        return np.asarray(off[:2], dtype=np.float64)

    def _foretold(self, tracker: Tracker, plan: ContactPlan) -> ContactPlan:
        """The plan up to each leg's next foothold, carried on by the gait."""
        assert self._guidance is not None
        now, timing, robot = tracker.clock_s, self._chooser.timing, self.robot
        rows: list[Sequence[Stance]] = []
        for row in plan.stances:
            swings = not any(s.begin_s <= now < s.end_s for s in row)
            rows.append([s for k, s in enumerate(row) if s.begin_s <= now or (swings and row[k - 1].begin_s <= now)])
        kept = ContactPlan(rows)
        yaw = float(yaw_of(tracker.terms.rotation))
        x, y, heading = self._implied(kept, now, yaw)
        command = self._paced()
        elevation = self._guidance.elevation
        stance, turn = robot.geometry.stance - robot.com, command[2]
        level = [float(row[-1].place[2]) for row in kept.stances]
        most = self._chooser.most_rise_m

        def place_of(leg: int, touchdown_s: float) -> tuple[Array, Array]:
            ahead = touchdown_s + 0.5 * timing.stance_s - now
            middle, then = heading + 0.5 * turn * ahead, heading + turn * ahead
            c, s = math.cos(middle), math.sin(middle)
            at_x = x + (c * command[0] - s * command[1]) * ahead
            at_y = y + (s * command[0] + c * command[1]) * ahead
            c, s = math.cos(then), math.sin(then)
            ox, oy = stance[leg, :2]
            found = place_at(elevation, at_x + c * ox - s * oy, at_y + s * ox + c * oy)
            if abs(found.point[2] - level[leg]) > most:  # a pit: the foot will not go there
                return np.array([*found.point[:2], level[leg]]), np.array([0.0, 0.0, 1.0])
            level[leg] = float(found.point[2])
            return found.point, found.normal

        return walked_on(kept, timing, place_of, start_s=self._start_s, until_s=now + _AHEAD_S)


def _fault(guidance: Guidance) -> str:
    """What of a guidance cannot be used; empty if all can."""
    command, pose = guidance.command, guidance.pose
    if len(command) != 3 or not all(math.isfinite(value) for value in command):
        return f"gait: command {command}, expected three finite numbers"
    if pose is not None and not (np.shape(pose) == (3,) and np.isfinite(pose).all()):
        return f"gait: pose {np.asarray(pose).tolist()}, expected finite height, roll and pitch"
    return ""
