"""The one closed loop: an environment, a planner, and whoever looks on."""

from __future__ import annotations

from collections.abc import Sequence

from legtool.sim.walks.environment import Environment, Subscriber, WalkPlanner
from legtool_runtime.errors import LegtoolError


def run(environment: Environment, planner: WalkPlanner, subscribers: Sequence[Subscriber] = ()) -> str:
    """Observe, plan, act, until the environment says that the walk is over.

    Args:
        environment: the robot.
        planner: decides.
        subscribers: look on, in this order.

    Returns:
        the outcome that the environment gives.

    Raises:
        LegtoolError: what the controller or the planner raises; and whatever else they throw.
    """
    begun: list[Subscriber] = []
    try:
        for subscriber in subscribers:
            subscriber.begin()
            begun.append(subscriber)
        environment.begin()
        outcome = ""
        while not outcome:
            observation = environment.observe()
            answer = planner.act(observation)
            environment.apply(answer)
            for subscriber in subscribers:
                subscriber.tick(observation, answer)
            outcome = environment.outcome()
        return outcome
    finally:
        for subscriber in begun:
            subscriber.end()


def run_trial(environment: Environment, planner: WalkPlanner, subscribers: Sequence[Subscriber] = ()) -> str:
    """The loop for a suite: whatever a controller or planner throws ends this walk alone.

    Returns:
        the outcome as :func:`run` gives it, or ``error: ...``.
    """
    try:
        return run(environment, planner, subscribers)
    except LegtoolError as error:
        return f"error: {error}"
    except Exception as error:  # a black box may throw anything; its trial is lost, the suite goes on
        return f"error: {type(error).__name__}: {error}"
