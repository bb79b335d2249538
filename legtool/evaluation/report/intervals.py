"""Bootstrap intervals over blocks: consecutive steps and whole episodes are not independent, blocks nearly are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
