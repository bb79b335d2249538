"""Plans velocity commands whose footsteps are safe: A* over learned motion models (motion paper, III-B).

At every end of full stance the caller hands in the state, the costmap and the goal, applies the plan's first command
for the coming step, and plans anew. All that can be checked before a walk is checked when the planner is made and by
:meth:`Planner.check`; :meth:`Planner.plan` itself raises for no value it is given.
"""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import ArrayLike, NDArray

from legtool_runtime import checks
from legtool_runtime.errors import LegtoolError, MapError, PlannerError, StateError
from legtool_runtime.motion.features import FEET, UNEVEN_M, as_on_level_ground
from legtool_runtime.motion.model import INSTANTS, MotionModel, MotionState
from legtool_runtime.motion.planning import inputs, search, workspace
from legtool_runtime.motion.planning.clock import CLOCK, NEVER
from legtool_runtime.motion.planning.plan import (
    HALTS,
    STATUSES,
    Goal,
    Plan,
    PlannerSettings,
    checked_commands,
    forward_commands,
    planar_commands,
)
from legtool_runtime.motion.planning.problem import DistanceField, Models, Start, Task
from legtool_runtime.motion.planning.uncertainty import touchdown_variance
from legtool_runtime.robot import LEGS, TROT_PAIRS, Robot
from legtool_runtime.terrain.costmap import FootCostmap

__all__ = ["STATUSES", "Goal", "Plan", "Planner", "PlannerSettings", "forward_commands", "planar_commands"]

Array = NDArray[np.float64]

_STATUS = {
    search.REACHED_GOAL: "goal",
    search.REACHED_HORIZON: "horizon",
    search.HALTED: "horizon",
    search.OUT_OF_TIME: "deadline",
    search.OUT_OF_NODES: "deadline",
    search.GAVE_UP: "deadline",
    search.NOTHING_OPEN: "blocked",
}


class Planner:
    """Plans with one robot's motion models. One thread at a time: the search's memory is allocated once."""

    def __init__(
        self,
        model: MotionModel,
        robot: Robot,
        *,
        commands: ArrayLike | None = None,
        settings: PlannerSettings | None = None,
        instant: str = "full_stance_end",
        extrapolate: bool = False,
    ) -> None:
        """Prepare the search.

        Args:
            model: ``bundle.motion``.
            robot: ``bundle.robot``.
            commands: (m, 3) vx, vy [m/s], yaw rate [rad/s] to choose from; the paper's by default.
            settings: of the search.
            instant: the moment at which the states to come are taken, one of INSTANTS.
            extrapolate: whether to plan with commands outside the range that the models were fitted to, too; without
                it they are left out, and ``left_out`` holds them.

        Raises:
            StateError: the models were learned from states of another instant.
            PlannerError: commands that are not finite, doubled, too many, or without the zero command.
        """
        if instant not in INSTANTS:
            raise StateError(f"instant is {instant!r}, expected {' or '.join(INSTANTS)}")
        if instant != model.instant:
            raise StateError(
                f"states are taken at {instant}, but these motion models were learned from states at {model.instant}; "
                "take the states there, or train on a dataset of the other instant"
            )
        self.settings = settings or PlannerSettings()
        self.model = model
        wanted = checked_commands(forward_commands() if commands is None else commands)
        covered = model.covers(wanted) | ~wanted.any(axis=1)  # to stand is always allowed
        kept = np.ones(len(wanted), dtype=np.bool_) if extrapolate else covered
        self.commands = np.ascontiguousarray(wanted[kept])
        #: (m, 3) commands that were wanted, and left out.
        self.left_out = wanted[~kept]
        self._turns = bool(self.commands[:, 2].any())
        self._speeds = np.hypot(self.commands[:, 0], self.commands[:, 1])
        self._turning = self.commands.copy()
        self._slow_first = sorted(self._speeds.tolist())
        self._moves = np.where(self._speeds > 0, 1.0, 0.0)
        s = self.settings
        weights, covariance, _ = model.packed
        spread, noise = touchdown_variance(model, robot.stance, horizon=s.horizon)
        self._models = Models(weights, covariance[:1], spread, noise, self.commands, self._speeds)
        self._workspace = workspace.make_workspace(len(self.commands), s.horizon, _BREADTH)
        # A ball of a foot rolls on below a leg that turns about it.
        self._roll = robot.foot_radius / robot.standing_height
        self._number = 0

    def check(
        self, state: MotionState, costmap: FootCostmap, *, position: ArrayLike, rotation: ArrayLike, goal: Goal
    ) -> None:
        """Raise at the start of a walk what :meth:`plan` could not plan from.

        Raises:
            StateError: a position or rotation that is not finite, or no rotation.
            MapError: the map does not hold the robot, or is unknown throughout.
            PlannerError: the goal lies inside an obstacle.
        """
        at = self._check_inputs(costmap, position, rotation)[0]
        if not goal.steered:
            if costmap.contains((goal.x, goal.y)) and not costmap.distance_at([(goal.x, goal.y)])[0]:
                cell = np.floor((np.array([goal.x, goal.y]) - costmap.lower_corner) / costmap.resolution_m).astype(int)
                if costmap.known[cell[0], cell[1]]:
                    raise PlannerError(f"goal ({goal.x:.2f}, {goal.y:.2f}) m lies inside an obstacle; move it")
            if math.hypot(goal.x - at[0], goal.y - at[1]) > 100.0:
                raise PlannerError(f"goal ({goal.x:.2f}, {goal.y:.2f}) m is more than 100 m away; are these metres?")

    def plan(
        self,
        state: MotionState,
        costmap: FootCostmap,
        *,
        position: ArrayLike,
        rotation: ArrayLike,
        goal: Goal,
        bold: bool = False,
    ) -> Plan:
        """Search the best sequence of commands from here.

        Args:
            state: at the planner's instant, just before the step that is planned.
            costmap: where feet may stand.
            position: (3,) CoM, world frame [m].
            rotation: (3, 3) base to world; on uneven ground its heading alone is used, see
                :func:`.features.as_on_level_ground`.
            goal: where to walk.
            bold: take what the paper's bare check takes: no margin, and missteps at a fraction of their cost, so that
                they tell only between sequences that are otherwise as good.

        Returns:
            The plan; where nothing could be planned it has no commands, and says why.
        """
        start = time.clock_gettime_ns(CLOCK)
        try:
            for name, given, kind in (
                ("state", state, MotionState),
                ("costmap", costmap, FootCostmap),
                ("goal", goal, Goal),
            ):
                checks.instance(name, given, kind, PlannerError)
            at, turned = self._check_inputs(costmap, position, rotation)
        except LegtoolError as error:
            return self._refused(str(error), start)
        features = state.features
        if inputs.unevenness(state.feet_base, turned) > UNEVEN_M:
            feet, level = as_on_level_ground(state.feet_base[None], turned[None])
            features, turned = features.copy(), level[0]
            features[FEET] = feet.ravel()
        plan = self._search(features, state.swing_pair, costmap, at, turned, goal, bold, start)
        return plan._replace(planning_time_s=(time.clock_gettime_ns(CLOCK) - start) * 1e-9)

    def _search(
        self,
        features: Array,
        pair: int,
        costmap: FootCostmap,
        position: Array,
        rotation: Array,
        goal: Goal,
        bold: bool,
        start: int,
    ) -> Plan:
        s, w = self.settings, self._workspace
        heading = math.atan2(rotation[1, 0], rotation[0, 0])
        models = self._models
        if s.steering_rad_s and not self._turns:
            models = models._replace(commands=self._steered(goal, position, heading))
        corner, cells_per_m = costmap.lower_corner, 1.0 / costmap.resolution_m
        field = DistanceField(
            costmap.distance, float(corner[0]), float(corner[1]), cells_per_m, 0.5 / cells_per_m,
            0.0 if costmap.unknown_unsafe else math.inf,
        )  # fmt: skip
        deadline = NEVER if s.deadline_s is None else start + int(s.deadline_s * 1e9) - _ANSWER_NS
        task = self._task(goal, bold, deadline)
        self._number += 1
        why, n, expanded, generated = search.search(
            models, Start(position, rotation, features, pair), field, task, w, self._number
        )
        path = w.path[:n].copy()
        status = _STATUS[why]
        blocked = self._blocked_leg(n) if status == "blocked" else None
        return Plan(
            status=status,
            reason=_reason(why, n, blocked, s),
            commands=path[:, workspace.COMMAND : workspace.COST],
            cost=path[:, workspace.COST],
            position=path[:, workspace.POSITION : workspace.HEADING],
            heading=path[:, workspace.HEADING] + heading,
            velocity=path[:, workspace.VELOCITY : workspace.TOUCHDOWNS],
            touchdowns=path[:, workspace.TOUCHDOWNS : workspace.CLEARANCE].reshape(n, 2, 3),
            legs=_LEGS_OF_STEPS[pair][:n],
            clearance=path[:, workspace.CLEARANCE : workspace.MISS],
            misstep=path[:, workspace.MISS :],
            blocked_leg=blocked,
            expanded=expanded,
            generated=generated,
            planning_time_s=0.0,  # known when all is done
        )

    def _task(self, goal: Goal, bold: bool, deadline: int) -> Task:
        s, limit = self.settings, math.inf
        if goal.max_speed is not None:
            limit = next((speed + 1e-9 for speed in self._slow_first if speed >= goal.max_speed - 1e-9), math.inf)
        headway = _HEADWAY if goal.max_speed is None else min(_HEADWAY, _HEADWAY_S * goal.max_speed)
        margin, misstep_cost = (0.0, _BOLD * s.misstep_cost_m) if bold else (s.margin_m, s.misstep_cost_m)
        return Task(
            float(goal.x), float(goal.y), math.nan if goal.heading is None else float(goal.heading), self._turns,
            s.goal_tolerance_m, s.heading_tolerance_rad, s.heading_weight_m_per_rad, s.d_max_m, margin,
            misstep_cost, self._roll, s.waiting_cost_m, s.max_velocity_change, limit, s.cell_m,
            s.heading_bin_rad, headway, s.goal_tolerance_m + _NEAR, s.horizon, _BREADTH, _INSIST, deadline,
        )  # fmt: skip

    def _steered(self, goal: Goal, position: Array, heading: float) -> Array:
        """The commands with the yaw rate that takes the heading to the wanted one in a while; standing stays that."""
        wanted = math.atan2(goal.y - position[1], goal.x - position[0]) if goal.heading is None else goal.heading
        rate = math.remainder(wanted - heading, 2 * math.pi) / _STEERING_S
        limit = self.settings.steering_rad_s
        np.multiply(self._moves, min(limit, max(-limit, rate)), out=self._turning[:, 2])
        return self._turning

    def _blocked_leg(self, depth: int) -> str | None:
        rejected = self._workspace.progress["rejected"][0, depth]
        return LEGS[int(rejected.argmax())] if rejected.any() else None

    def _refused(self, reason: str, start: int) -> Plan:
        none = np.zeros((0, 3))
        return Plan(
            "refused", reason, none, none[:, 0], none, none[:, 0], none, np.zeros((0, 2, 3)), _LEGS_OF_STEPS[0][:0],
            none[:, :2], none[:, :2], None, 0, 0, (time.clock_gettime_ns(CLOCK) - start) * 1e-9,
        )  # fmt: skip

    def _check_inputs(self, costmap: FootCostmap, position: ArrayLike, rotation: ArrayLike) -> tuple[Array, Array]:
        # Whether they are finite is told in compiled code, with the rest.
        at = checks.numeric("state: position", position, (3,), StateError)
        turned = checks.numeric("state: rotation", rotation, (3, 3), StateError)
        fault = inputs.fault(at, turned, costmap.distance, costmap.lower_corner, costmap.resolution_m)
        if fault in (inputs.POSITION, inputs.ROTATION):
            name = "position" if fault == inputs.POSITION else "rotation"
            raise StateError(f"state: {name} holds a value that is not finite; check the estimator that gave it")
        if fault == inputs.NO_ROTATION:
            raise StateError("state: rotation is no rotation matrix (base to world)")
        if fault == inputs.OFF_MAP:
            raise MapError(f"map: the robot at ({at[0]:.2f}, {at[1]:.2f}) m is not on it; are both in one world frame?")
        if not costmap.seen:
            raise MapError("map: no cell of it has been seen; wait for the first depth image before walking")
        return at, turned

    def warm_up(self) -> None:
        """Compile the search or load it from the user's cache, and touch its memory, so that the first plan is fast."""
        feet = np.zeros((4, 3))
        distance = np.full((3, 3), np.inf, np.float32)
        costmap = FootCostmap(distance, np.ones((3, 3), np.bool_), 1.0, np.full(2, -1.5), False)
        for pair in range(len(TROT_PAIRS)):
            state = MotionState(np.zeros(3), np.zeros(3), np.zeros(3), feet, pair)
            for _ in range(_WARM_CALLS):
                self.plan(state, costmap, position=np.zeros(3), rotation=np.eye(3), goal=Goal(1.0, 0.0))


#: Headway per step below which a sequence counts as halting [m]: walking at about 0.15 m/s.
_HEADWAY = 0.05
#: The same for a goal with a speed limit [s]: a third of that limit, in a step of about 0.3 s.
_HEADWAY_S = 0.1
#: Within the goal's tolerance and this, coming to a halt is arriving [m].
_NEAR = 0.2
#: Most nodes to expand at each depth; and after a sequence that halts, in search of one that does not.
_BREADTH, _INSIST = 20, 100
#: What of a misstep's cost is left to a bold plan.
_BOLD = 0.2
#: A heading that is off is steered back to within about this time [s].
_STEERING_S = 2.0
#: Kept back from the deadline for handing over the plan [ns].
_ANSWER_NS = 150_000
_WARM_CALLS = 5
_LEGS_OF_STEPS = tuple(np.array([TROT_PAIRS[(pair + step) % 2] for step in range(32)]) for pair in (0, 1))


def _reason(why: int, steps: int, blocked: str | None, settings: PlannerSettings) -> str:
    horizon = settings.horizon
    if why == search.OUT_OF_TIME and settings.deadline_s is not None:
        return f"the deadline of {settings.deadline_s * 1e3:g} ms came first; best of {steps} of {horizon} steps so far"
    if why == search.OUT_OF_NODES:
        return f"the search's memory of {workspace.NODES} nodes is full; best of {steps} of {horizon} steps so far"
    if why == search.GAVE_UP:
        return f"not found among the {_BREADTH} likeliest nodes of a depth; best of {steps} of {horizon} steps so far"
    if why == search.HALTED:
        return HALTS
    if why == search.NOTHING_OPEN:
        leg = f"; {blocked} finds no safe foothold" if blocked else ""
        return f"no safe sequence beyond {steps} of {horizon} steps{leg}"
    return ""
