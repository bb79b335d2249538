"""Stance feet against the trunk's travel and turns: they stand, unless lengths, units or the legs' order are wrong."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from legtool.datasets.logs.checks.finding import Finding
from legtool_runtime.robot import LEGS, Robot

#: Fewer steps than this say nothing.
FEWEST = 8
#: Ball feet roll by some hundredths of the trunk's travel. Shares of it that are told, and that are refused.
DOUBTFUL, WRONG = (-0.15, 0.4), (-0.25, 0.5)
#: Feet that come from joint angles go farther back than the trunk travels if lengths are too long, and less far if they
#: are too short: this share of it more than ball feet roll, or so many times the spread of steps that differ.
TOO_LONG, TOO_SHORT, SPREADS = -0.06, 0.07, 3.0
#: Share of irregular steps that is told, and of how many steps at least.
IRREGULAR, FEWEST_SWINGS = 0.5, 20
#: Share of what a wrong order of legs would make of a turn, from which on it is called one.
SWAPPED = 0.5


class StanceMotion(NamedTuple):
    """Motion of stance feet over steps.

    Attributes:
        steps: in which the trunk travels.
        along: motion of stance feet along the trunk's travel, as a share of it, median.
        spread: median distance of the steps' shares from it.
        turns: steps in which the trunk turns.
        left_right: by how much the left stance foot moves ahead of the right one, by the turn [m/rad].
        front_hind: by how much the front stance foot moves to the left of the hind one, by the turn [m/rad].
    """

    steps: int
    along: float
    spread: float
    turns: int
    left_right: float
    front_hind: float


def check_stance(
    motion: StanceMotion, robot: Robot, label: str, *, order: tuple[str, ...], from_joints: bool = False
) -> list[Finding]:
    """Judge the motion of stance feet.

    Args:
        motion: of the log's steps.
        robot: whose log it should be.
        label: name of the feet or joints in messages.
        order: the order of legs that was declared.
        from_joints: whether the feet come from joint angles, by the robot's lengths.
    """
    if motion.turns >= FEWEST:
        # Seen as its mirror image, a foot turns about the wrong place, twice its own distance from it.
        width, length = (2 * (abs(robot.stance[:2, 1]).sum()), 2 * (robot.stance[0, 0] - robot.stance[2, 0]))
        sides, ends = abs(motion.left_right) > SWAPPED * width, abs(motion.front_hind) > SWAPPED * length
        if sides or ends:
            swapped = {(True, False): (1, 0, 3, 2), (False, True): (2, 3, 0, 1), (True, True): (3, 2, 1, 0)}[
                sides, ends
            ]
            legs = ", ".join(LEGS[swapped[LEGS.index(leg)]] for leg in order)
            text = f"{label}: in turns, stance feet move as if they were other legs' ({motion.left_right:+.2f} m/rad)"
            return [Finding("legs", "refuse", f"{text}; set legs: [{legs}]")]
    roll, (low, high) = robot.foot_radius / robot.standing_height, DOUBTFUL
    if from_joints:
        low, high = TOO_LONG, min(high, roll + max(TOO_SHORT, SPREADS * motion.spread))
    if motion.steps < FEWEST or low <= motion.along <= high:
        return []
    legs = f", as of legs that are too {'long' if motion.along < roll else 'short'}" if from_joints else ""
    text = (
        f"{label}: stance feet move by {100 * motion.along:.0f} % of the trunk's travel, expected about 5 %{legs}; "
        f"check the lengths of {robot.name} (--robot), the position's unit, the joints' zero angles, and clocks"
    )
    level = "warn" if WRONG[0] <= motion.along <= WRONG[1] else "refuse"
    return [Finding("stance", "warn" if level == "warn" else "refuse", text)]


def check_regular(counts: Mapping[str, float]) -> list[Finding]:
    """Tell where most steps of a log are irregular; ``counts`` are those of its transitions."""
    stumbles = {name: value for name, value in counts.items() if name.startswith("stumble_")}
    irregular, regular = sum(stumbles.values()), counts.get("steps", 0) + counts.get("steps_without_history", 0)
    if irregular <= IRREGULAR * (irregular + regular) or irregular + regular < FEWEST_SWINGS or not regular:
        return []
    worst = max(stumbles, key=lambda name: stumbles[name])
    text = (
        f"steps: {irregular:g} of {irregular + regular:g} are irregular, most by {worst.replace('_', ' ')}; is it a "
        "trot, of this robot, and are the signals on one clock?"
    )
    return [Finding("steps", "warn", text)]
