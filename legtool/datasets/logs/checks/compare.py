"""All checks of one log, in the order in which their findings are told."""

from __future__ import annotations

from typing import NamedTuple

from legtool.configs.topics import TopicSettings
from legtool.datasets.logs.checks.clocks import check_clocks, check_sampling
from legtool.datasets.logs.checks.command import check_command
from legtool.datasets.logs.checks.feet import check_feet, declared_legs
from legtool.datasets.logs.checks.finding import Finding
from legtool.datasets.logs.checks.motion import check_velocity, check_yaw_rate
from legtool.datasets.logs.checks.stance import StanceMotion, check_stance
from legtool.datasets.logs.checks.windows import Windows
from legtool.datasets.logs.facts import LogFacts
from legtool_runtime.robot import Robot

#: Streams that are held between samples; all others are interpolated.
HELD = frozenset({"command"})


class Evidence(NamedTuple):
    """What a log says about itself.

    Attributes:
        facts: of its streams and clocks.
        windows: of its signals.
        step_s: usual duration of a step [s]; None where none was found.
        stance: motion of stance feet over its steps; None where none were cut.
    """

    facts: LogFacts
    windows: Windows
    step_s: float | None
    stance: StanceMotion | None = None


def compare(evidence: Evidence, topics: TopicSettings, robot: Robot) -> list[Finding]:
    """Compare the signals of one log with each other.

    Args:
        evidence: of the log.
        topics: what was declared of it.
        robot: whose log it should be.
    """
    facts, windows, events = evidence.facts, evidence.windows, topics.events
    labels = {name.split("/")[0]: stream.label for name, stream in facts.streams.items()}
    clock_topic = topics.position.topic if isinstance(topics.position.topic, str) else None
    found = check_sampling(facts, held=HELD, events=events, step_s=evidence.step_s)
    found += check_clocks(facts.clocks, clock_topic=clock_topic)
    if topics.velocity is not None and "velocity" in labels:
        found += check_velocity(windows, labels["velocity"], frame=topics.velocity.frame, events=events)
    if topics.yaw_rate is not None and "yaw_rate" in labels:
        found += check_yaw_rate(windows, labels["yaw_rate"], events=events)
    feet, order = labels.get("feet", labels.get("joints", "feet")), declared_legs(topics)
    found += check_feet(windows, robot, feet, order=order)
    if evidence.stance is not None and not any(finding.level == "refuse" for finding in found):
        found += check_stance(evidence.stance, robot, feet, order=order, from_joints="feet" not in labels)
    return found + check_command(windows, labels["command"])
