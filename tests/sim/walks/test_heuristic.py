"""Gaits that step on the nearest admissible ground: what of a map is ground, and the paper's command."""

import math
from dataclasses import replace

import numpy as np
import pytest

from legtool.configs.camera import DepthCamera, DepthNoise
from legtool.configs.families import FAMILIES
from legtool.configs.sweep import CONTROL_RATE_HZ
from legtool.sim.walks.flat_ground import flat_cells
from legtool.sim.walks.heuristic import HeuristicPlanner
from legtool.sim.walks.operators import HeldHeading, OperatedPlanner, TowardsGoal
from legtool.sim.walks.region_finder import RegionFinder
from legtool.sim.walks.simulated import Eyes
from legtool.sim.worlds.build import build_world
from legtool_runtime.foothold.gait import Gait
from legtool_runtime.perception.chain import PerceptionSettings
from legtool_runtime.perception.egocan import EgocanSettings
from legtool_runtime.terrain.elevation import HeightMap
from legtool_runtime.terrain.settings import ElevationSettings
from legtool_runtime.tracking.selectors import Wish

CAMERA = DepthCamera(width=160, height=120, pitch=0.5, noise=DepthNoise(steps=()))


def map_of(heights, cell=0.02):
    return HeightMap(np.asarray(heights, np.float32), cell, np.zeros(2))


def test_flat_cells_keep_two_cells_off_steps_and_what_is_unknown():
    heights = np.zeros((40, 40))
    heights[20:] = 0.1
    heights[5, 30] = np.nan
    flat = flat_cells(map_of(heights))
    assert flat[2:18, 2:28].all() and flat[22:38, 2:38].all()
    assert not flat[18:22].any() and not flat[3:8, 28:33].any()


@pytest.mark.parametrize(("angle", "ground"), [(0.3, True), (0.45, True), (0.6, False)])
def test_slopes_up_to_30_degrees_are_ground(angle, ground):
    x = 0.02 * np.arange(30)
    for heights in (np.add.outer(np.tan(angle) * x, np.zeros(30)), np.add.outer(np.zeros(30), np.tan(angle) * x)):
        assert flat_cells(map_of(heights))[5:-5, 5:-5].all() == ground
        assert flat_cells(map_of(heights))[5:-5, 5:-5].any() == ground


def test_stones_of_15_cm_are_lost_in_cells_of_6_cm():
    """What the paper's elevation maps made of its stepping stones."""

    def stones(cell):
        centre = cell * (np.arange(round(1.2 / cell)) + 0.5)
        on = (centre % 0.3) < 0.15
        return map_of(np.where(on[:, None] & on[None, :], 0.0, -1.0), cell)

    assert flat_cells(stones(0.02)).any() and not flat_cells(stones(0.06)).any()


def test_the_command_leads_straight_to_the_goal_and_stops_there():
    world = build_world(FAMILIES["balance_beam"].settings(None), robot="anymal_c")
    rule, goal = TowardsGoal(world), world.goal
    vx, vy, rate = rule.command(goal - [2.0, 0.0], 0.4)
    assert math.hypot(vx, vy) == pytest.approx(0.25) and rate == pytest.approx(-0.1)
    assert math.atan2(vy, vx) == pytest.approx(-0.4)
    assert rule.command(goal + np.array([0.0, 0.7 * world.goal_radius_m]), 0.4) == (0.0, 0.0, 0.0)


def test_planners_answer_with_the_command_and_a_selector_on_what_they_see(make, world):
    environment = make(eyes=Eyes(CAMERA, labelled_m=0.1))
    observation, robot = environment.observe(), environment.simulation.robot.geometry
    finder = RegionFinder(robot, PerceptionSettings(egocan=EgocanSettings(lift=0.3)))
    gap, hip = np.array([1.25, 0.05]), np.array([1.25, 0.05, 0.35])
    for given in (finder, None):
        planner = HeuristicPlanner(world, robot, ElevationSettings(), finder=given)
        guidance = planner.act(observation).guidance
        assert guidance.command == pytest.approx(
            TowardsGoal(world).command(observation.state.position_world, 0.0), abs=0.02
        )
        twist = (*guidance.command[:2], 0.0, 0.0, 0.0, guidance.command[2])
        place = guidance.select(Wish(0, gap, 0.0, hip, twist, Gait(0.1, 1.5, 0.55, 0.3), np.inf))
        assert world.on_ground(place.point[None])[0] and not world.on_ground([[*gap, place.point[2]]])[0]
        assert len(planner.history.planning_times_s) == 1
    blind = OperatedPlanner(TowardsGoal(world)).act(observation)
    assert blind.values == pytest.approx(guidance.command)


def test_a_held_heading_stops_a_robot_that_turns_by_itself():
    """EM-DTC on ANYmal C turns by -0.04 to -0.1 rad/s where no turn is commanded."""
    world = build_world(FAMILIES["balance_beam"].settings(None), robot="anymal_c")
    far, ends = world.goal - [2.0, 0.0], []
    for rule in (TowardsGoal(world), HeldHeading(TowardsGoal(world))):
        yaw = 0.0
        for _ in range(60 * CONTROL_RATE_HZ):
            yaw += (rule.command(far, yaw)[2] - 0.095) / CONTROL_RATE_HZ
        ends.append(yaw)
    assert ends[0] < -0.3 and abs(ends[1]) < 0.01


def test_policies_are_told_that_the_ground_beside_a_beam_falls_away(make, world):
    """Their heights were level there, where an edge hides the pit: EM-RL stepped off the published beam."""
    environment = make(eyes=Eyes(CAMERA, labelled_m=0.1))
    heights = np.zeros((100, 100))
    heights[:, :20], heights[:, 20:50] = -0.9, np.nan
    observation = replace(environment.observe(), image=None, terrain=map_of(heights))
    robot = environment.simulation.robot.geometry
    for hidden_m, known in ((0.0, False), (1.0, True)):
        planner = HeuristicPlanner(world, robot, ElevationSettings(), chooses=False, hidden_m=hidden_m)
        strip = planner.act(observation).guidance.elevation.heights[50, 20:50]
        assert np.isfinite(strip).all() == known and np.isfinite(strip).any() == known
    assert (np.diff(strip) > 0.0).all() and -0.9 < strip[0] < strip[-1] < 0.0
