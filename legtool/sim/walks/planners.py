"""Planners that answer with velocity commands: an operator without eyes on the feet, and the learned motion models."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from legtool.sim.robots.state import RobotState
from legtool.sim.walks.environment import Measured, Observation, VelocityCommand
from legtool.sim.walks.mapping import Mapper
from legtool.sim.walks.scene import Known
from legtool.sim.walks.simulation import to_base
from legtool_runtime.motion.planning.pilot import Pilot
from legtool_runtime.motion.planning.plan import Goal, Plan
from legtool_runtime.motion.tracker import StepTracker
from legtool_runtime.robot import Robot
from legtool_runtime.rotations import rotation_of, yaw_of
from legtool_runtime.terrain.costmap import FootCostmap, foot_costmap
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.terrain.settings import CostmapSettings, ElevationSettings

Array = NDArray[np.float64]

#: The planner's goal lies beyond the world's, so that the robot walks over it instead of creeping up to it [m].
GOAL_BEYOND_M = 0.6
#: Observations between plans while all feet stand: the last plan before lift-off is the one the controller takes up.
PLAN_EVERY = 2
#: Steps between the plans that are kept with their maps.
SNAPSHOT_EVERY = 4


class BlindPlanner:
    """Walks ahead at one speed: what an operator without eyes on the feet does."""

    def __init__(self, speed: float) -> None:
        self._answer = VelocityCommand(np.array([speed, 0.0, 0.0]))

    def act(self, observation: Observation) -> VelocityCommand:
        """The same speed always."""
        del observation
        return self._answer


@dataclass
class PlanHistory:
    """What a planner of velocity commands planned on a walk.

    Attributes:
        executed: the last plan before each lift-off.
        planning_times_s: of every plan.
        snapshots: (plan, costmap, position) of some of the executed plans, for drawings.
    """

    executed: list[Plan] = field(default_factory=list)
    planning_times_s: list[float] = field(default_factory=list)
    snapshots: list[tuple[Plan, FootCostmap, Array]] = field(default_factory=list)


class VelocityPlanner:
    """What runs on a robot with a motion line: map, step tracker, planner and pilot, fed by observations.

    Attributes:
        history: of its plans.
        map_times_s: of its maps, one for each image.
        plan: the latest, None before the first.
    """

    def __init__(
        self,
        pilot: Pilot,
        tracker: StepTracker,
        robot: Robot,
        *,
        goal: Goal | None,
        elevation: ElevationSettings,
        costmap: CostmapSettings,
    ) -> None:
        """Begin a walk.

        Args:
            pilot: plans and commands.
            tracker: knows the robot's steps.
            robot: its geometry.
            goal: where to walk; None: where the commands of a recorded log lead, as if they came from a joystick.
            elevation: of the map that images are fused into.
            costmap: of the costs that are made of the map.
        """
        self.history = PlanHistory()
        self._pilot, self._tracker, self._robot, self._goal = pilot, tracker, robot, goal
        self._costmap_settings = costmap
        self._mapper = Mapper(robot, elevation)
        self._terrain: HeightMap | None = None
        self._costmap: FootCostmap | None = None
        self.map_times_s: list[float] = []
        self._command = np.zeros(3)
        self._ticks = self._steps = 0

    @property
    def plan(self) -> Plan | None:
        """The latest plan."""
        return self._pilot.plan

    @property
    def goal(self) -> Goal | None:
        """Where it walks; None where a recorded command leads."""
        return self._goal

    @property
    def horizon(self) -> int:
        """Steps that it looks ahead."""
        return self._pilot.planner.settings.horizon

    @property
    def known(self) -> Known:
        """Its map, and the latest plan."""
        latest = (("map", self.map_times_s), ("plan", self.history.planning_times_s))
        times = tuple((name, taken[-1]) for name, taken in latest if taken)
        return Known(terrain=self._terrain, costmap=self._costmap, plan=self.plan, times_s=times)

    @property
    def tracker(self) -> StepTracker:
        """What it knows of the robot's steps."""
        return self._tracker

    def act(self, observation: Observation) -> VelocityCommand:
        """The command of the latest plan; planned anew while all feet stand, or as a pair lands (see StepTracker).

        Raises:
            LegtoolError: at the start, what the planner could not plan from.
        """
        began = time.perf_counter()
        if (terrain := self._mapper.see(observation)) is not None:
            self._terrain, self._costmap = terrain, foot_costmap(terrain, self._costmap_settings)
            self.map_times_s.append(time.perf_counter() - began)
        tracker, state = self._tracker, observation.state
        measured = observation.measured or self._measured(state)
        tracker.update(
            observation.time_s,
            velocity=measured.velocity,
            feet_base=measured.feet_base,
            contact_force=state.foot_forces,
            reference=measured.commanded,
        )
        due = self._ticks % PLAN_EVERY == 0 or tracker.landed
        if tracker.at_instant and due and self._costmap is not None:
            self._command = self._pilot.command(
                tracker.state(),
                self._costmap,
                position=state.position_world,
                rotation=rotation_of(state.orientation),
                goal=self._goal or _steered(measured, state),
                time_s=observation.time_s,
                steps=tracker.steps,
            )
            assert self._pilot.plan is not None
            self.history.planning_times_s.append(self._pilot.plan.planning_time_s)
        if tracker.steps > self._steps:
            self._keep(state.position_world)
        self._steps = tracker.steps
        self._ticks += 1
        return VelocityCommand(self._command, self._terrain)

    def _measured(self, state: RobotState) -> Measured:
        velocity = to_base(state.orientation[None], state.velocity_world[None])[0]
        velocity[2] = state.angular_velocity_base[2]
        return Measured(velocity, self._robot.feet(state.joint_positions), self._command)

    def _keep(self, position: Array) -> None:
        plan, history = self._pilot.plan, self.history
        if plan is None:
            return
        history.executed.append(plan)
        if self._costmap is not None and len(history.executed) % SNAPSHOT_EVERY == 1:
            history.snapshots.append((plan, self._costmap, position.copy()))


def _steered(measured: Measured, state: RobotState) -> Goal:
    """Where the command in force leads."""
    heading = float(yaw_of(rotation_of(state.orientation)))
    return Goal.from_joystick(measured.commanded, position=state.position_world, heading=heading)
