"""Feet against the robot's legs: on the side of their hips, in the declared order, below the trunk, within reach."""

from __future__ import annotations

from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from legtool.configs.topics import TopicSettings
from legtool.datasets.logs.checks.finding import Finding
from legtool.datasets.logs.checks.windows import Windows
from legtool_runtime.robot import LEGS, Robot

Array = NDArray[np.float64]

#: A foot may be this share of a leg's length away from where it stands at rest, by median and along the ground.
FAR = 0.6
#: Another order of the legs must bring the feet nearer to where they stand at rest by this factor.
CLEARLY = 0.6


def check_feet(windows: Windows, robot: Robot, label: str, *, order: tuple[str, ...]) -> list[Finding]:
    """Compare where the feet are by median with where they stand at rest.

    Args:
        windows: of the log.
        robot: its legs.
        label: name of the signal in messages.
        order: the order of legs that was declared.

    Returns:
        nothing if each foot is near its own leg's.
    """
    if len(windows) < 2:
        return []
    return judge_feet(np.median(windows.feet, axis=0), robot, label, order=order)


def judge_feet(feet: Array, robot: Robot, label: str, *, order: tuple[str, ...]) -> list[Finding]:
    """Judge where the feet (4, 3) are by median, base frame [m], as :func:`check_feet` does."""
    ground, rest = feet[:, :2], robot.stance[:, :2]
    own = _distance(ground, rest)
    mirrored = _distance(ground * [1, -1], rest)
    backwards = _distance(ground * [-1, 1], rest)
    best = min(permutations(range(4)), key=lambda p: _distance(ground[list(p)], rest))
    swapped = _distance(ground[list(best)], rest)
    left = 0 if feet[0, 1] < 0 else 2
    where = f"{label}: by median the {LEGS[left]} foot is {abs(feet[left, 1]):.3f} m right of the trunk's middle"
    if feet[[0, 2], 1].max() < 0 < feet[[1, 3], 1].min() and mirrored < CLEARLY * own and mirrored <= swapped + 0.02:
        listed = declared_order(order, (1, 0, 3, 2))
        text = f"{where}; is the order of the legs another (legs: [{listed}]), or is y positive to the right?"
        return [Finding("feet", "refuse", text)]
    if best != (0, 1, 2, 3) and swapped < CLEARLY * own:
        listed = declared_order(order, best)
        text = f"{label}: feet are {own:.2f} m (mean) from where {robot.name} stands at rest, in another order of the "
        return [Finding("feet", "refuse", f"{text}legs {swapped:.2f} m; set legs: [{listed}]")]
    if backwards < CLEARLY * own:
        text = f"{label}: front feet are behind the hind feet by median; is x positive backwards?"
        return [Finding("feet", "refuse", text)]
    return _reach(feet, robot, label)


def declared_legs(topics: TopicSettings) -> tuple[str, ...]:
    """The order of the legs in which a log has its feet, or its joints."""
    signal = topics.feet or topics.joints
    return LEGS if signal is None else signal.legs


def _reach(feet: Array, robot: Robot, label: str) -> list[Finding]:
    length = robot.thigh_length + robot.shank_length
    off = np.linalg.norm(feet[:, :2] - robot.stance[:, :2], axis=1) / length
    above = feet[:, 2] - robot.hips[:, 2]
    leg = int(np.argmax(off))
    if off[leg] > FAR:
        text = f"{label}: by median the {LEGS[leg]} foot is {off[leg] * length[leg]:.2f} m from where it stands at rest"
        return [Finding("feet", "refuse", f"{text}; check --robot, the order of joints and legs, and signs")]
    if above.max() > -0.15 * length.mean():
        leg = int(np.argmax(above))
        text = (
            f"{label}: by median the {LEGS[leg]} foot is {-above[leg]:.2f} m below its hip, of {length[leg]:.2f} m leg"
        )
        return [Finding("feet", "refuse", f"{text}; check --robot, the order of joints, signs and zero angles")]
    return []


def declared_order(order: tuple[str, ...], best: tuple[int, ...]) -> str:
    """The order of legs to declare, such that the foot in place ``best[leg]`` of today's is that leg's."""
    position = {leg: order.index(leg) for leg in LEGS}
    fixed = list(order)
    for leg, source in enumerate(best):
        fixed[position[LEGS[source]]] = LEGS[leg]
    return ", ".join(fixed)


def _distance(a: Array, b: Array) -> float:
    return float(np.linalg.norm(a - b, axis=1).mean())
