"""Velocity and yaw rate against what the pose says: sign, frame, axes, unit, or never filled at all."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from legtool.datasets.logs.checks.finding import Finding
from legtool.datasets.logs.checks.windows import Windows

Array = NDArray[np.float64]

#: Slower than this, a robot is not considered to walk [m/s], or to turn [rad/s].
MOVING, TURNING = 0.08, 0.1
#: Fewer windows of walking or turning than this say nothing.
FEWEST = 8
#: Disagreement that is accepted: a share of what is compared, and an absolute part [m/s, rad/s]. At step instants
#: momentary values are compared with means over a step, so that more has to be accepted.
SHARE = 0.25
SLACK, SLACK_AT_STEPS = 0.05, 0.2
TURN_SLACK, TURN_SLACK_AT_STEPS = 0.12, 0.5
#: With this share of what is compared, the disagreement is no inaccuracy any more.
WRONG = 0.6

#: What (vx, vy) may have been mistaken for: matrix from what was given to what is right, and its name.
AXES: dict[str, tuple[tuple[float, float], tuple[float, float]]] = {
    "with both signs turned": ((-1, 0), (0, -1)),
    "with the sign of x turned": ((-1, 0), (0, 1)),
    "with the sign of y turned": ((1, 0), (0, -1)),
    "with x and y swapped": ((0, 1), (1, 0)),
    "with x and y swapped and both signs turned": ((0, -1), (-1, 0)),
    "turned by 90 degrees": ((0, -1), (1, 0)),
    "turned by -90 degrees": ((0, 1), (-1, 0)),
}
_UNITS = {"mm/s": 1e-3, "cm/s": 1e-2}


class _Candidate(NamedTuple):
    text: str
    advice: str
    values: Array
    truth: Array


def check_velocity(windows: Windows, label: str, *, frame: str, events: bool) -> list[Finding]:
    """Compare a logged velocity with the position's derivative.

    Args:
        windows: of the log.
        label: name of the signal in messages.
        frame: the frame that was declared, ``base`` or ``world``.
        events: whether rows are step instants.

    Returns:
        nothing if they agree, or if the robot hardly moves.
    """
    moving = np.maximum(_length(windows.moved_base), _length(windows.velocity)) > MOVING
    if moving.sum() < FEWEST:
        return []
    w = windows.where(moving)
    speed = float(np.median(_length(w.moved_base)))
    if not windows.velocity.any():
        text = f"{label}: is 0 throughout, while the position moves at {speed:.2f} m/s (median): it was never filled"
        return [Finding("velocity", "refuse", f"{text}; leave velocity out of the topics to derive it", unfilled=True)]
    given, other = (w.velocity, w.moved_world) if frame == "base" else (w.velocity_world, w.moved_base)
    truth = w.moved_base if frame == "base" else w.moved_world
    wrong_frame = "world" if frame == "base" else "base"
    candidates = [
        _Candidate(f"in the {wrong_frame} frame", f"set velocity: {{frame: {wrong_frame}}}", given, other),
        *(
            _Candidate(
                f"in the {frame} frame {text}", "correct velocity's columns or fields", given @ np.array(m).T, truth
            )
            for text, m in AXES.items()
        ),
        *(
            _Candidate(f"in the {frame} frame in {unit}", f"set velocity: {{unit: {unit}}}", given * scale, truth)
            for unit, scale in _UNITS.items()
        ),
        *(
            _Candidate(f"in the {frame} frame in m/s", "set velocity: {unit: m/s}", given / scale, truth)
            for scale in _UNITS.values()
        ),
    ]
    slack = SLACK_AT_STEPS if events else SLACK
    return _judge("velocity", label, _Candidate("", "", given, truth), candidates, slack=slack, unit="m/s")


def check_yaw_rate(windows: Windows, label: str, *, events: bool) -> list[Finding]:
    """Compare a logged yaw rate with the orientation's derivative, as :func:`check_velocity` does."""
    moving = _length(windows.moved_base) > MOVING
    turning = np.maximum(np.abs(windows.turned), np.abs(windows.yaw_rate)) > TURNING
    if not windows.yaw_rate.any() and (moving.sum() >= FEWEST or turning.sum() >= FEWEST):
        text = f"{label}: is 0 throughout, while the robot walks: it was never filled"
        return [Finding("yaw_rate", "refuse", f"{text}; leave yaw_rate out of the topics to derive it", unfilled=True)]
    if turning.sum() < FEWEST:
        return []
    w = windows.where(turning)
    given, truth = w.yaw_rate[:, None], w.turned[:, None]
    degrees = 180 / np.pi
    candidates = [
        _Candidate("with its sign turned", "correct yaw_rate's field or column, or the orientation", -given, truth),
        _Candidate("in deg/s", "set yaw_rate: {unit: deg/s}", given / degrees, truth),
        _Candidate(
            "in deg/s with its sign turned", "set yaw_rate: {unit: deg/s} and its sign", -given / degrees, truth
        ),
        _Candidate("in rad/s", "set yaw_rate: {unit: rad/s}", given * degrees, truth),
    ]
    slack = TURN_SLACK_AT_STEPS if events else TURN_SLACK
    return _judge("yaw_rate", label, _Candidate("", "", given, truth), candidates, slack=slack, unit="rad/s")


def _judge(
    signal: str, label: str, given: _Candidate, candidates: list[_Candidate], *, slack: float, unit: str
) -> list[Finding]:
    """Whether a signal agrees with what the pose says, and which of the candidates agrees if it does not."""
    pose = "position" if signal == "velocity" else "orientation"
    what = f"{label}: differs from the {pose}'s derivative by {{:.2g}} {unit} (median, of {{:.2g}} {unit})"
    own = _residuals(given)
    likely: list[tuple[float, float, float, _Candidate]] = []
    for candidate in candidates:
        other = _residuals(candidate)
        # Only where the two differ can they be told apart: heading along x, the world frame is as good as the base.
        apart = _length(other - own) > 2 * slack
        if apart.sum() >= FEWEST:
            error, size = _median(other[apart]), _median(candidate.truth[apart])
            before = _median(own[apart])
            if error <= min(0.4 * before, SHARE * max(size, slack) + slack):
                likely.append((error, before, size, candidate))
    if likely:
        _, before, size, best = min(likely, key=lambda found: found[0] / found[1])
        return [Finding(signal, "refuse", f"{what.format(before, size)}; it agrees {best.text}: {best.advice}")]
    size, error = _median(given.truth), _median(own)
    if error <= SHARE * size + slack:
        return []
    if error > WRONG * size + 2 * slack:
        advice = f"check {signal} and the order of the orientation's numbers, or leave {signal} out to derive it"
        return [Finding(signal, "refuse", f"{what.format(error, size)}; {advice}")]
    return [Finding(signal, "warn", f"{what.format(error, size)}; models learn from it as it is")]


def _residuals(candidate: _Candidate) -> Array:
    return candidate.values - candidate.truth


def _median(vectors: Array) -> float:
    return float(np.median(_length(vectors)))


def _length(vectors: Array) -> Array:
    return np.linalg.norm(vectors, axis=1)
