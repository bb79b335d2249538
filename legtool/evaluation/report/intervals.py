"""95 % intervals: Wilson's of a share, Newcombe's of a difference of paired shares, MOVER's of other differences, the
bootstrap of a mean, and the bootstrap over blocks of what goes together.

A bootstrap of one sample would have width 0, and one of a few blocks is far too narrow: these give None instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import binomtest, bootstrap

from legtool.evaluation.report.results import Metric, metric

Array = NDArray[np.float64]
Interval = tuple[float, float]
#: Blocks of which a bootstrap says anything.
FEWEST_BLOCKS = 5
#: Resamples of a mean over trials, and the seed that draws them.
_RESAMPLES, _SEED = 2000, 0


def share(successes: int, n: int) -> Metric:
    """The share of ``n`` trials that succeeded, with Wilson's interval, which is never of width 0; of none, 0."""
    if n == 0:
        return metric(0.0, None, 0, "1")
    interval = binomtest(int(successes), int(n)).proportion_ci(method="wilson")
    return metric(successes / n, (interval.low, interval.high), n, "1")


def paired_difference(first: Sequence[bool], second: Sequence[bool]) -> Metric:
    """The share of ``first`` less that of ``second``, which were tried on the same trials, and its interval.

    Newcombe's hybrid of two Wilson intervals with the correlation of the pairs (Statistics in Medicine 17, 1998, method
    10), which is never of width 0; of none, 0.
    """
    one, other = np.asarray(first, dtype=np.bool_), np.asarray(second, dtype=np.bool_)
    n = len(one)
    if n == 0:
        return metric(0.0, None, 0, "1")
    both, neither = int((one & other).sum()), int((~one & ~other).sum())
    alone, beside = int((one & ~other).sum()), int((~one & other).sum())
    margins = (both + alone) * (beside + neither) * (both + beside) * (alone + neither)
    product = float(both * neither - alone * beside)
    if product > 0.0:
        product = max(product - 0.5 * n, 0.0)
    correlation = product / math.sqrt(margins) if margins else 0.0
    lows, highs = [], []
    for count in (both + alone, both + beside):
        interval = binomtest(count, n).proportion_ci(method="wilson")
        lows.append(count / n - interval.low)
        highs.append(interval.high - count / n)
    below = lows[0] ** 2 - 2.0 * correlation * lows[0] * highs[1] + highs[1] ** 2
    above = highs[0] ** 2 - 2.0 * correlation * highs[0] * lows[1] + lows[1] ** 2
    value = (alone - beside) / n
    return metric(value, (value - math.sqrt(max(below, 0.0)), value + math.sqrt(max(above, 0.0))), n, "1")


def difference(first: Metric, second: Metric) -> tuple[float, Interval | None]:
    """By what ``second`` is more than ``first``, independent of it, and the interval; None where one of both has none.

    Zou and Donner's method of variance estimates recovery (Statistics in Medicine 27, 2008), which is Newcombe's hybrid
    where both are shares with Wilson intervals.
    """
    value = second["value"] - first["value"]
    if first["ci95"] is None or second["ci95"] is None:
        return value, None
    (low, high), (least, most) = first["ci95"], second["ci95"]
    below = math.hypot(second["value"] - least, high - first["value"])
    above = math.hypot(most - second["value"], first["value"] - low)
    return value, (value - below, value + above)


def paired_p(first: Sequence[bool], second: Sequence[bool]) -> float:
    """Exact McNemar: how likely a difference as large or larger is where each pair that differs may as well differ the
    other way; 1 where none differs."""
    one, other = np.asarray(first, dtype=np.bool_), np.asarray(second, dtype=np.bool_)
    alone, beside = int((one & ~other).sum()), int((~one & other).sum())
    return float(binomtest(alone, alone + beside).pvalue) if alone + beside else 1.0


def mean(values: Sequence[float] | Array, unit: str) -> Metric:
    """The mean of independent values, at least one, with its bootstrap interval (percentiles of 2000 resamples)."""
    samples = np.asarray(values, dtype=np.float64)
    interval = None
    if len(samples) > 1:
        rng = np.random.default_rng(_SEED)
        interval = bootstrap(
            (samples,), np.mean, n_resamples=_RESAMPLES, method="percentile", rng=rng
        ).confidence_interval
        if interval.low == interval.high:
            interval = None  # equal values do not say how far others would lie from them
    return metric(samples.mean(), interval, len(samples), unit)


class BlockBootstrap:
    """Resamples of blocks, shared by all metrics of one evaluation.

    Consecutive steps, frames of one scene and samples of one terrain are not independent; blocks of them nearly are.
    """

    def __init__(self, blocks: int, *, samples: int, seed: int) -> None:
        """Draw the resamples.

        Args:
            blocks: their number.
            samples: resamples.
            seed: of the draws.
        """
        rng = np.random.default_rng(seed)
        even = np.full(blocks, 1.0 / blocks)
        #: (samples, blocks) how often each resample holds each block.
        self.times = rng.multinomial(blocks, even, size=samples).astype(np.float64)

    def totals(self, sums: ArrayLike) -> Array:
        """Sums over each resample (samples, ...) of sums over each block (blocks, ...)."""
        return np.tensordot(self.times, np.asarray(sums, dtype=np.float64), axes=1)

    def interval(self, resampled: Array, held: ArrayLike) -> Interval | None:
        """The percentile interval.

        Args:
            resampled: (samples,) the statistic of each resample; what is not finite was not to be had there.
            held: (blocks,) how much each block holds of what the statistic is of.

        Returns:
            None where fewer than FEWEST_BLOCKS hold anything, or all resamples are alike.
        """
        known = resampled[np.isfinite(resampled)]
        if np.count_nonzero(held) < FEWEST_BLOCKS or not len(known):
            return None
        low, high = np.quantile(known, [0.025, 0.975])
        return (float(low), float(high)) if low < high else None

    def ratio(self, above: ArrayLike, below: ArrayLike) -> Interval | None:
        """The interval of a ratio of totals, both given as sums over each block (blocks,)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return self.interval(self.totals(above) / self.totals(below), below)

    def mean(self, values: Array, block: NDArray[np.intp], *, root: bool = False) -> tuple[float, Interval | None]:
        """Mean over all of ``values`` (n, ...), or its square root, and the interval.

        Args:
            values: numbers.
            block: (n,) number of each row's block.
            root: take the root of both.
        """
        rows = values.reshape(len(values), -1)
        blocks = self.times.shape[1]
        sums = np.bincount(block, weights=rows.sum(axis=1), minlength=blocks)
        value, interval = float(rows.mean()), self.ratio(sums, np.bincount(block, minlength=blocks) * rows.shape[1])
        if root:
            value, interval = value**0.5, interval and (interval[0] ** 0.5, interval[1] ** 0.5)
        return value, interval

    def statistic(
        self, values: Array, block: NDArray[np.intp], of: Callable[[Array], float]
    ) -> tuple[float, Interval | None]:
        """Any statistic of ``values`` (n,), such as the median, and the interval; ``block`` as above."""
        drawn = np.array([of(np.repeat(values, times[block])) for times in self.times.astype(int)])
        return float(of(values)), self.interval(drawn, np.bincount(block, minlength=self.times.shape[1]))
