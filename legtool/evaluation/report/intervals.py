"""Bootstrap intervals over blocks: consecutive steps and whole episodes are not independent, blocks nearly are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from legtool.evaluation.report.results import Metric, metric

Array = NDArray[np.float64]


class Bootstrap:
    """Resamples of blocks, shared by all metrics of one evaluation."""

    def __init__(self, block: NDArray[np.intp], *, samples: int, seed: int) -> None:
        """Draw the resamples.

        Args:
            block: (n,) number of the block that each row belongs to, from 0 on.
            samples: resamples.
            seed: of the draws.
        """
        self._block = block
        self._blocks = int(block.max()) + 1
        rng = np.random.default_rng(seed)
        even = np.full(self._blocks, 1.0 / self._blocks)
        self._times = rng.multinomial(self._blocks, even, size=samples).astype(np.float64)  # (samples, blocks)

    def mean(self, values: Array, *, root: bool = False) -> tuple[float, tuple[float, float]]:
        """Mean over all of ``values`` (n, ...), or its square root, and the 95 % percentile interval."""
        rows = values.reshape(len(values), -1)
        sums = np.bincount(self._block, weights=rows.sum(axis=1), minlength=self._blocks)
        counts = np.bincount(self._block, minlength=self._blocks) * rows.shape[1]
        resampled = (self._times @ sums) / np.maximum(self._times @ counts, 1)
        low, high = np.quantile(resampled, [0.025, 0.975])
        value = float(rows.mean())
        if root:
            value, low, high = np.sqrt(value), np.sqrt(low), np.sqrt(high)
        return float(value), (float(low), float(high))


def share(successes: int, n: int) -> Metric:
    """A share of n trials with its 95 % Wilson interval."""
    if not n:
        return metric(0.0, None, 0, "1")
    interval = binomtest(successes, n).proportion_ci(method="wilson")
    return metric(successes / n, (float(interval.low), float(interval.high)), n, "1")


def mean(values: Sequence[float], unit: str) -> Metric:
    """A mean over independent samples with its 95 % percentile bootstrap interval; none from a single sample."""
    samples = np.asarray(values, dtype=np.float64)
    if len(samples) < 2:
        return metric(float(samples.mean()), None, len(samples), unit)
    rng = np.random.default_rng(0)
    means = samples[rng.integers(len(samples), size=(2000, len(samples)))].mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return metric(float(samples.mean()), (float(low), float(high)), len(samples), unit)
