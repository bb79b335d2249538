"""The one closed loop: an environment, a planner, and whoever looks on."""

from __future__ import annotations

from collections.abc import Sequence

from legtool.sim.walks.environment import Environment, Planner, Subscriber
from legtool_runtime.errors import LegtoolError


def run(
    environment: Environment, planner: Planner, subscribers: Sequence[Subscriber] = (), *, timeout_s: float = 60.0
) -> str:
    """The closed loop: observe, plan, act, until the environment says that the walk is over.

    Args:
        environment: the robot.
        planner: decides.
        subscribers: look on, in this order.
        timeout_s: the walk ends after this [s].

    Returns:
        the outcome: the environment's, or ``timeout``. What a controller or planner throws ends the walk as an
        ``error: ...``; a suite goes on with its next trial.
    """
    try:
        for subscriber in subscribers:
            subscriber.begin()
        environment.begin()
        while environment.time_s < timeout_s:
            observation = environment.observe()
            answer = planner.act(observation)
            environment.apply(answer)
            for subscriber in subscribers:
                subscriber.tick(observation, answer)
            if outcome := environment.outcome():
                return outcome
        return "timeout"
    except LegtoolError as error:
        return f"error: {error}"
    except Exception as error:  # a black box may throw anything; its trial is lost, the suite goes on
        return f"error: {type(error).__name__}: {error}"
    finally:
        for subscriber in subscribers:
            subscriber.end()
