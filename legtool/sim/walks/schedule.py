"""Command schedules: what a robot is told to do, and when. All are pure functions of settings, seed and number."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legtool.configs.sweep import SweepSettings

Array = NDArray[np.float64]

#: Every schedule begins with the robot standing for this long [s].
SETTLE_S = 0.5

#: What an episode moves along, by its number: one axis alone, or all at once.
_AXES = ((0,), (0, 1, 2), (0,), (0, 1, 2), (1,), (2,))


@dataclass(frozen=True, eq=False)
class Schedule:
    """Commands in time order.

    Attributes:
        times_s: (n,) when each command is sent; the first at 0.
        commands: (n, 3) vx, vy [m/s], yaw rate [rad/s].
        duration_s: end of the last command.
    """

    times_s: Array
    commands: Array
    duration_s: float


def sweep_schedule(settings: SweepSettings, index: int) -> Schedule:
    """The commands of one episode of a sweep.

    Consecutive episodes of a kind carry on through the pairs (previous, next) of their axes; when an axis has been
    through all of its pairs it starts again in another order.
    """
    axes = _AXES[index % len(_AXES)]
    changes = max(2, round((settings.episode_s - SETTLE_S) / np.mean(settings.hold_s)))
    earlier = sum(1 for other in range(index) if _AXES[other % len(_AXES)] == axes)
    commands = np.zeros((changes + 1, 3))
    for axis in axes:
        grid = np.array((settings.vx, settings.vy, settings.yaw_rate)[axis])
        # Each episode's first command is the last of the one before, so that no pair falls between two.
        commands[:, axis] = _walk(grid, settings.seed, axis, len(axes), earlier * changes, changes + 1)
    rng = np.random.default_rng([settings.seed, index, 1])
    rows, holds = [np.zeros(3)], []
    for command in commands:
        if rng.random() < settings.stop_share:
            rows += [command, np.zeros(3)]
            holds += [rng.uniform(*settings.hold_s), settings.stop_s]
        rows.append(command)
        holds.append(rng.uniform(*settings.hold_s))
    scaled = np.array(holds) * (settings.episode_s - SETTLE_S) / sum(holds)
    times = np.concatenate([[0.0], SETTLE_S + np.concatenate([[0.0], np.cumsum(scaled[:-1])])])
    return Schedule(times, np.array(rows), settings.episode_s)


def random_schedule(
    duration_s: float,
    seed: int,
    *,
    low: tuple[float, float, float] = (-0.3, -0.3, -0.6),
    high: tuple[float, float, float] = (1.0, 0.3, 0.6),
    hold_s: tuple[float, float] = (0.5, 3.0),
) -> Schedule:
    """Commands drawn evenly from a box, held for random times, after a standing start."""
    rng = np.random.default_rng(seed)
    holds = rng.uniform(*hold_s, size=int(np.ceil(duration_s / hold_s[0])))
    times = np.concatenate([[0.0], SETTLE_S + np.concatenate([[0.0], np.cumsum(holds)])])
    commands = np.concatenate([np.zeros((1, 3)), rng.uniform(low, high, size=(len(times) - 1, 3))])
    keep = times < duration_s
    return Schedule(times[keep], commands[keep], duration_s)


def all_pairs(count: int) -> NDArray[np.intp]:
    """A cycle of ``count²`` symbols in which each ordered pair of ``count`` symbols, equal ones too, is seen once."""
    cycle: list[int] = []
    for first in range(count):
        cycle.append(first)
        for second in range(first + 1, count):
            cycle += [first, second]
    return np.array(cycle)


def _walk(grid: Array, seed: int, axis: int, kind: int, start: int, count: int) -> Array:
    """``count`` values of an endless walk through all pairs of ``grid``, from ``start`` on."""
    cycle = all_pairs(len(grid))
    out = np.empty(count)
    for k in range(count):
        lap, step = divmod(start + k, len(cycle))
        # A new order at each lap; the walk's first symbol stays, so that the pair across two laps is the cycle's own.
        order = np.random.default_rng([seed, axis, kind, lap]).permutation(len(grid))
        out[k] = grid[order[cycle[step]]]
    return out
