"""Walks on regions under the monitor: judged again from their recording, pushed, and with plans that come late."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from legtool.configs.camera import DepthCamera
from legtool.configs.robots import load_robot
from legtool.configs.worlds import WorldSettings
from legtool.datasets.logs.mcap_writer import write_mcap
from legtool.datasets.logs.named_values import read_named
from legtool.errors import LogError
from legtool.sim.controllers.tracked import TrackedController
from legtool.sim.robots.robot import build_robot
from legtool.sim.walks.loop import run
from legtool.sim.walks.monitored import EVENTS, READINGS, SAID, VERDICTS, judge_again
from legtool.sim.walks.pips import Latency, PipsPlanner, pips_for
from legtool.sim.walks.recorder import Recorder
from legtool.sim.walks.region_finder import RegionFinder
from legtool.sim.walks.scripted import Push
from legtool.sim.walks.simulated import Eyes, SimulatedRobot, Until
from legtool.sim.worlds.build import build_world
from legtool.sim.worlds.mujoco_world import world_spec
from legtool_runtime.perception.chain import PerceptionSettings
from legtool_runtime.search.monitor import NAMES, MonitorSettings
from legtool_runtime.search.pips import Pips
from legtool_runtime.terrain.settings import ElevationSettings

Walk = Callable[..., tuple[SimulatedRobot, PipsPlanner]]
FLOOR = {
    "name": "floor", "floor": "pit", "pit_depth": 0.6, "goal": (1.6, 0.0), "goal_radius": 0.25, "friction": 0.7,
    "boxes": [{"center": [0.5, 0.0, -0.1], "size": [4.6, 2.4, 0.2]}],
}  # fmt: skip


@pytest.fixture(scope="module")
def walk() -> Walk:
    world = build_world(WorldSettings(**FLOOR))
    robot = build_robot(load_robot("anymal_c"), world_spec(world))

    def make(reach: float | None = None, **others) -> tuple[SimulatedRobot, PipsPlanner]:
        controller = TrackedController(robot)
        pips = pips_for(controller.robot, world, expansions=20)
        if reach is not None:
            shorter = replace(pips.settings, torso=replace(pips.settings.torso, reach=reach))
            pips = Pips(controller.robot.geometry, shorter, com_offset=controller.robot.com)
        finder = RegionFinder(controller.robot.geometry, PerceptionSettings())
        elevation = ElevationSettings()
        environment = SimulatedRobot(
            world, robot, controller, rng=np.random.default_rng(0),
            eyes=Eyes(DepthCamera(rate_hz=10.0), elevation, regions_m=2.0), until=Until(at_goal=True, timeout_s=20.0),
        )  # fmt: skip
        return environment, PipsPlanner(pips, world, controller, finder, elevation, **others)

    return make


def pushed(walk: Walk, speed: float, **others) -> tuple[str, SimulatedRobot, PipsPlanner, Push, Recorder]:
    environment, planner = walk(**others)
    push = Push(environment, planner.share, speed, np.random.default_rng(4))
    recorder = Recorder(environment, ticks=environment.ticks)
    return run(environment, planner, [recorder, push]), environment, planner, push, recorder


def test_a_recorded_walk_is_judged_again_with_the_same_events(walk: Walk, tmp_path: Path) -> None:
    outcome, environment, planner, push, recorder = pushed(walk, 0.9)
    assert outcome == "goal" and push.pushed_s is not None
    path, recording = tmp_path / "walk.mcap", recorder.log.recording(environment.simulation.robot, "walk")
    write_mcap(path, recording, beside=planner.monitor.columns(), metadata={})
    readings, verdicts = read_named(path, READINGS), read_named(path, VERDICTS)
    assert readings.names == NAMES and verdicts.names == SAID and len(readings.values) == len(recording)
    np.testing.assert_array_equal(judge_again(readings.values, planner.monitor.settings), verdicts.values)
    times = 1e-9 * recording.stamps_ns
    told = {(round(float(times[k]), 3), EVENTS[e].value) for k, e in np.argwhere(verdicts.values[:, :-2] > 0.0)}
    assert told == {(round(when, 3), event) for when, event, _ in planner.stages.told}
    events = {event for when, event in told if push.pushed_s <= when <= push.pushed_s + 1.0}
    assert events & {"torso_off", "slip", "torque", "tilt"}
    # Narrower limits tell of more: it is the readings that are judged, not the verdicts that are read back.
    narrow = judge_again(readings.values, MonitorSettings(torso_xy=0.02))
    assert narrow[:, :-2].sum() > verdicts.values[:, :-2].sum()
    with pytest.raises(LogError, match="no named values"):
        read_named(path, "/odom")


def test_a_robot_stops_where_the_monitor_says_so_and_walks_on(walk: Walk) -> None:
    environment, planner = walk()
    planner.monitor.settings = MonitorSettings(torque=0.45, torque_s=0.02, give_up=50)  # no walk needs so little
    outcome = run(environment, planner)
    counts = planner.stages.counts
    assert counts["aborts"] >= 1 and counts["event_torque"] >= 1
    assert outcome in ("goal", "stalled", "timeout")
    phases = np.array(planner.monitor.verdicts)[:, -1]
    assert (phases == 1).any() and (np.diff(phases) == -1).any()


def test_a_robot_that_has_to_stop_again_and_again_at_one_place_stands_and_tracking_is_to_blame(walk: Walk) -> None:
    environment, planner = walk()
    planner.monitor.settings = MonitorSettings(torque=0.2, torque_s=0.01)  # what standing needs
    environment._until = Until(timeout_s=20.0, stall_s=2.0, at_goal=True)
    assert run(environment, planner) == "stalled"
    assert planner.stages.counts["aborts"] == 5 and planner.stages.blocked_by == "tracking"
    tracker = planner._controller.tracker
    assert tracker is not None and tracker.contact.all() and not tracker.fault


def test_a_robot_that_only_looks_goes_on_in_spite_of_the_monitor(walk: Walk) -> None:
    environment, planner = walk(acts=False)
    planner.monitor.settings = MonitorSettings(torque=0.2, torque_s=0.01)
    assert run(environment, planner) == "goal"
    assert planner.stages.counts["event_torque"] >= 1


def test_plans_that_come_late_lead_to_the_goal(walk: Walk) -> None:
    environment, planner = walk(latency=Latency(0.2, np.random.default_rng(1)))
    assert run(environment, planner) == "goal"
    counts = planner.stages.counts
    frames = len(planner.history.planning_times_s)
    assert counts["replans"] > 5 and frames < 0.9 * 10 * environment.time_s  # none while one is on its way


def test_plans_that_come_after_their_start_are_shifted(walk: Walk) -> None:
    """They come when the last one is over: they are put off, and the robot does not leap after them."""
    slow = Latency(0.0, np.random.default_rng(1))
    slow.draw = lambda: 2.5
    environment, planner = walk(reach=0.5, latency=slow)
    assert run(environment, planner) in ("goal", "timeout")
    counts = planner.stages.counts
    assert counts.get("event_late_plan", 0) >= 1, counts
    readings = np.array(planner.monitor.readings)
    turning = readings[:, [NAMES.index(f"turning_{k}") for k in range(3)]]
    assert np.nanmax(np.abs(turning)) < 1.0
