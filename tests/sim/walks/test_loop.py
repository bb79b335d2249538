"""Walks whose controller or planner misbehaves end as failures with a reason, at once, and end alone."""

import time

import numpy as np
import pytest

from legtool.errors import ControllerError
from legtool.sim.robots.state import RobotState
from legtool.sim.walks.environment import Observation, VelocityCommand
from legtool.sim.walks.loop import run_trial
from legtool.sim.walks.planners import BlindPlanner
from legtool.sim.walks.watchdog import Watchdog


class Limp:
    """Never moves; what it does wrong it does at its fifth tick."""

    def __init__(self, wrong=None, at_reset=None) -> None:
        self.wrong, self.at_reset, self.ticks = wrong, at_reset, 0

    def reset(self, state) -> None:
        if self.at_reset:
            self.at_reset()

    def accepts_command(self) -> bool:
        return True

    def step(self, state, command):
        self.ticks += 1
        return self.wrong() if self.wrong and self.ticks == 5 else np.zeros(12)


def fail():
    raise ValueError("lost a packet")


def spin():
    while True:
        pass


@pytest.mark.parametrize(
    ("controller", "reason"),
    [
        (Limp(fail), "error: ValueError: lost a packet"),
        (Limp(at_reset=fail), "error: ValueError: lost a packet"),
        (Limp(lambda: np.full(12, np.nan)), "expected 12 finite torques"),
        (Limp(lambda: np.zeros(11)), "expected 12 finite torques"),
        (Limp(lambda: None), "expected 12 finite torques"),
        (Limp(lambda: np.full(12, 1e12)), "physics diverged"),
        (Limp(lambda: time.sleep(60)), "gave no answer for 0.2 s"),
        (Limp(spin), "gave no answer for 0.2 s"),
        (Limp(), "fell"),
    ],
)
def test_a_controller_that_misbehaves_loses_its_walk_with_the_reason(make, controller, reason) -> None:
    began = time.monotonic()
    assert reason in run_trial(make(controller), BlindPlanner(0.5), [Watchdog(0.2)])
    assert time.monotonic() - began < 20


def test_a_planner_that_throws_loses_its_walk(make) -> None:
    class Broken:
        def act(self, observation):
            raise RuntimeError("no plan")

    assert run_trial(make(), Broken()) == "error: RuntimeError: no plan"


def test_a_robot_that_makes_no_headway_stalls_and_one_that_never_arrives_runs_out_of_time(make) -> None:
    assert run_trial(make(stall_s=1.0), BlindPlanner(0.0)) == "stalled"
    assert run_trial(make(timeout_s=1.0), BlindPlanner(0.0)) == "timeout"


def test_the_loop_needs_no_simulator() -> None:
    """A recorded log can stand where a simulated robot stands."""

    class Log:
        def __init__(self) -> None:
            self.ticks, self.applied = 0, 0

        @property
        def time_s(self) -> float:
            return 0.1 * self.ticks

        def begin(self) -> None:
            self.ticks = 0

        def observe(self) -> Observation:
            return Observation(self.time_s, RobotState())

        def apply(self, answer) -> None:
            self.ticks += 1
            self.applied += 1

        def outcome(self) -> str:
            return "end of the log" if self.ticks == 10 else ""

    class Onlooker:
        def __init__(self) -> None:
            self.seen: list[str] = []

        def begin(self) -> None:
            self.seen.append("begin")

        def tick(self, observation: Observation, answer: VelocityCommand) -> None:
            self.seen.append(f"{observation.time_s:.1f} {answer.values[0]}")

        def end(self) -> None:
            self.seen.append("end")

    log, onlooker = Log(), Onlooker()
    assert run_trial(log, BlindPlanner(0.3), [onlooker]) == "end of the log"
    assert log.applied == 10
    assert onlooker.seen[:2] == ["begin", "0.0 0.3"] and onlooker.seen[-1] == "end" and len(onlooker.seen) == 12


def test_a_watchdog_that_is_fed_keeps_still() -> None:
    def feed(watchdog: Watchdog) -> None:
        watchdog.tick(Observation(0.0, RobotState()), VelocityCommand(np.zeros(3)))

    watchdog = Watchdog(0.1)
    watchdog.begin()
    try:
        for _ in range(6):
            feed(watchdog)
            time.sleep(0.03)
    finally:
        watchdog.end()
    time.sleep(0.15)  # and does nothing after the walk
    watchdog = Watchdog(0.05)
    watchdog.begin()
    try:
        feed(watchdog)
        with pytest.raises(ControllerError, match="no answer"):
            time.sleep(1)
    finally:
        watchdog.end()
