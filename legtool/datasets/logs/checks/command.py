"""The command against the motion: never recorded, another unit or sign, axes swapped, another computer's clock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from legtool.datasets.logs.checks.finding import Finding
from legtool.datasets.logs.checks.motion import AXES, FEWEST, MOVING, TURNING
from legtool.datasets.logs.checks.windows import WINDOW_S, Windows

Array = NDArray[np.float64]

#: A command has been followed once it has not changed for this many windows.
SETTLED = 3
#: No robot is told to turn as fast as this [rad/s].
FASTEST_TURN = 8.0
#: A robot that turns at less than this share of a large command was told degrees.
DEGREES = 0.08
#: Longest shift that is looked for [windows], and how well commands and motion must match there.
REACH, MATCH = 15, 0.7
#: Robots answer a command within this many windows, and never before it.
EARLIEST, LATEST = -1, 5


def check_command(windows: Windows, label: str) -> list[Finding]:
    """Compare the velocity command with the motion.

    Args:
        windows: of the log.
        label: name of the signal in messages.

    Returns:
        nothing if the robot does about what it is told, or hardly moves.
    """
    moving = (np.linalg.norm(windows.moved_base, axis=1) > MOVING) | (np.abs(windows.turned) > TURNING)
    if moving.sum() < FEWEST:
        return []
    if not windows.command.any():
        return _never(windows, moving, label)
    shifted = _shift(windows, label)
    if any(finding.level == "refuse" for finding in shifted):
        return shifted  # at other instants, all else would seem wrong too
    settled = windows.where(_settled(windows.command, windows.follows))
    return _turn(settled, label) or _axes(settled, label) or _constant(windows, label) or shifted


def _never(windows: Windows, moving: NDArray[np.bool_], label: str) -> list[Finding]:
    if moving.mean() < 0.1:
        return []
    speed = float(np.median(np.linalg.norm(windows.moved_base[moving], axis=1)))
    text = f"{label}: is 0 throughout, while the robot walks at {speed:.2f} m/s (median); is it recorded elsewhere?"
    return [Finding("command", "refuse", text)]


def _constant(windows: Windows, label: str) -> list[Finding]:
    """A command that never changes, while the robot walks and stands or turns back."""
    if (np.ptp(windows.command, axis=0) > 1e-6).any() or len(windows) < 50:
        return []
    low, high = np.quantile(_smooth(windows.moved_base), [0.1, 0.9], axis=0)
    spread = float((high - low).max())
    if spread < 0.3:
        return []
    told = ", ".join(f"{value:g}" for value in windows.command[0])
    text = f"{label}: is ({told}) throughout, while the velocity varies by {spread:.2f} m/s; is it the command?"
    return [Finding("command", "warn", text)]


def _settled(command: Array, follows: Array) -> NDArray[np.bool_]:
    same = np.concatenate([[False], (np.abs(np.diff(command, axis=0)) < 1e-6).all(axis=1) & (follows[1:] > 0)])
    run = np.cumsum(same)
    back = np.concatenate([np.zeros(SETTLED, dtype=run.dtype), run])[: len(run)]
    return np.asarray(run - back >= SETTLED)


def _turn(windows: Windows, label: str) -> list[Finding]:
    told = windows.command[:, 2]
    if len(told) and (fast := float(np.abs(told).max())) > FASTEST_TURN:
        text = f"{label}: the yaw rate is up to {fast:.3g} rad/s; is it in deg/s? set command: {{yaw_unit: deg/s}}"
        return [Finding("command", "refuse", text)]
    chosen = np.abs(told) > TURNING
    fast_turn = np.abs(windows.turned) > TURNING
    if chosen.sum() < FEWEST:
        return []
    size, done = (
        float(np.median(np.abs(told[chosen]))),
        float(np.median(windows.turned[chosen] * np.sign(told[chosen]))),
    )
    what = f"{label}: at a yaw rate of {size:.2g} rad/s (median) the robot turns at {done:.2g} rad/s"
    if size > 1.0 and 0.0 < done < DEGREES * size:
        return [Finding("command", "refuse", f"{what}; is it in deg/s? set command: {{yaw_unit: deg/s}}")]
    if done > 5 * size and fast_turn.sum() >= FEWEST:
        return [Finding("command", "refuse", f"{what}; is it in rad/s? set command: {{yaw_unit: rad/s}}")]
    if done < -0.3 * size:
        return [Finding("command", "refuse", f"{what}: the other way; correct its sign, or the orientation")]
    return []


def _axes(windows: Windows, label: str) -> list[Finding]:
    told, done = windows.command[:, :2], windows.moved_base
    chosen = np.linalg.norm(told, axis=1) > MOVING
    if chosen.sum() < FEWEST:
        return []
    told, done = told[chosen], done[chosen]
    size = float(np.sqrt((told**2).sum() * (done**2).sum())) or 1.0
    own = float((told * done).sum()) / size
    text, best = max(
        ((text, float(((told @ np.array(m).T) * done).sum()) / size) for text, m in AXES.items()),
        key=lambda pair: pair[1],
    )
    if own < 0.3 and best > 0.7:
        what = f"{label}: matches the motion {text} ({best:.2f} of 1), and not as declared ({own:.2f})"
        return [Finding("command", "refuse", f"{what}; correct command's fields or columns")]
    return []


def _shift(windows: Windows, label: str) -> list[Finding]:
    """Whether the robot moves before it is told, or long after: the command has another clock."""
    told = np.column_stack([windows.command])
    done = np.column_stack([_smooth(windows.moved_base), _smooth(windows.turned[:, None])])
    changes = int((np.abs(np.diff(told, axis=0)) > 0.05).any(axis=1).sum())
    if changes < 5 or len(windows) < 3 * REACH:
        return []
    told, done = (values - values.mean(axis=0) for values in (told, done))
    scores = {lag: _match(told, done, lag) for lag in range(-REACH, REACH + 1)}
    best = max(scores, key=lambda lag: scores[lag])
    expected = max(scores[lag] for lag in range(EARLIEST + 1, LATEST))
    if scores[best] < MATCH or scores[best] < expected + 0.05 or EARLIEST <= best <= LATEST:
        return []
    seconds = abs(best) * WINDOW_S
    how = "before it is told" if best < 0 else "after it is told"
    text = (
        f"{label}: the robot moves {seconds:.1f} s {how} (match {scores[best]:.2f}, without shift "
        f"{expected:.2f}); do the command's stamps come from another clock?"
    )
    return [Finding("command", "refuse" if best < 0 else "warn", text)]


def _match(told: Array, done: Array, lag: int) -> float:
    """Correlation of the command with the motion ``lag`` windows later."""
    n = len(told)
    a = told[max(-lag, 0) : n - max(lag, 0)]
    b = done[max(lag, 0) : n - max(-lag, 0)]
    size = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / size if size > 0 else 0.0


def _smooth(values: Array) -> Array:
    """Means over three windows: a trot sways within a step."""
    if len(values) < 3:
        return values
    padded = np.concatenate([values[:1], values, values[-1:]])
    return (padded[:-2] + padded[1:-1] + padded[2:]) / 3
