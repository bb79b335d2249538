"""Planners that answer with velocity commands: an operator without eyes on the feet, and the learned motion models."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from legtool.sim.walks.environment import Observation, VelocityCommand
from legtool.sim.walks.simulation import to_base
from legtool_runtime.motion.planning.pilot import Pilot
from legtool_runtime.motion.planning.plan import Goal, Plan
from legtool_runtime.motion.tracker import StepTracker
from legtool_runtime.robot import Robot
from legtool_runtime.rotations import rotation_of
from legtool_runtime.terrain.costmap import FootCostmap, foot_costmap
from legtool_runtime.terrain.elevation import ElevationGrid, HeightMap
from legtool_runtime.terrain.settings import CostmapSettings, ElevationSettings

Array = NDArray[np.float64]

#: The planner's goal lies beyond the world's, so that the robot walks over it instead of creeping up to it [m].
GOAL_BEYOND_M = 0.6
#: Observations between plans while all feet stand: the last plan before lift-off is the one the controller takes up.
PLAN_EVERY = 2
#: Steps between the plans that are kept with their maps.
SNAPSHOT_EVERY = 4
#: The ground around a standing robot is taken to be flat within this [m]: its camera does not see its own feet.
_ASSUMED_FLAT_M = 0.9


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
        plan: the latest, None before the first.
    """

    def __init__(
        self,
        pilot: Pilot,
        tracker: StepTracker,
        robot: Robot,
        *,
        goal: Goal,
        elevation: ElevationSettings,
        costmap: CostmapSettings,
    ) -> None:
        """Begin a walk.

        Args:
            pilot: plans and commands.
            tracker: knows the robot's steps.
            robot: its geometry.
            goal: where to walk.
            elevation: of the map that images are fused into.
            costmap: of the costs that are made of the map.
        """
        self.history = PlanHistory()
        self._pilot, self._tracker, self._robot, self._goal = pilot, tracker, robot, goal
        self._costmap_settings = costmap
        self._grid = ElevationGrid(elevation)
        self._costmap: FootCostmap | None = None
        self._command = np.zeros(3)
        self._ticks = self._steps = 0

    @property
    def plan(self) -> Plan | None:
        """The latest plan."""
        return self._pilot.plan

    def act(self, observation: Observation) -> VelocityCommand:
        """The command of the latest plan; planned anew while all feet stand.

        Raises:
            LegtoolError: at the start, what the planner could not plan from.
        """
        if (terrain := self._map(observation)) is not None:
            self._costmap = foot_costmap(terrain, self._costmap_settings)
        tracker, state = self._tracker, observation.state
        velocity = to_base(state.orientation[None], state.velocity_world[None])[0]
        velocity[2] = state.angular_velocity_base[2]
        tracker.update(
            observation.time_s,
            velocity=velocity,
            feet_base=self._robot.feet(state.joint_positions),
            contact_force=state.foot_forces,
            reference=self._command,
        )
        if tracker.full_stance and self._ticks % PLAN_EVERY == 0 and self._costmap is not None:
            self._command = self._pilot.command(
                tracker.state(),
                self._costmap,
                position=state.position_world,
                rotation=rotation_of(state.orientation),
                goal=self._goal,
                time_s=observation.time_s,
                steps=tracker.steps,
            )
            assert self._pilot.plan is not None
            self.history.planning_times_s.append(self._pilot.plan.planning_time_s)
        if tracker.steps > self._steps:
            self._keep(state.position_world)
        self._steps = tracker.steps
        self._ticks += 1
        return VelocityCommand(self._command)

    def _map(self, observation: Observation) -> HeightMap | None:
        """A new map where there is something new to see, fused at the pose that the robot believes."""
        if observation.terrain is not None or observation.image is None:
            return observation.terrain
        state, image, grid = observation.state, observation.image, self._grid
        here = state.position_world
        grid.move_to(here[:2])
        if not self._ticks:
            ground = here[2] - self._robot.standing_height
            grid.assume_flat(here[:2], radius_m=_ASSUMED_FLAT_M, height_m=ground)
        base = np.eye(4)
        base[:3, :3], base[:3, 3] = rotation_of(state.orientation), here
        camera = image.camera
        intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        pose = base @ image.transform_camera_to_base
        grid.update(image.depth, intrinsics, transform_camera_to_world=pose, time_s=observation.time_s)
        return grid.map()

    def _keep(self, position: Array) -> None:
        plan, history = self._pilot.plan, self.history
        if plan is None:
            return
        history.executed.append(plan)
        if self._costmap is not None and len(history.executed) % SNAPSHOT_EVERY == 1:
            history.snapshots.append((plan, self._costmap, position.copy()))
