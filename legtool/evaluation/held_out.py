"""Predictions for steps that the motion models had not seen, and the axes they are measured on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legtool.datasets.motion.samples import MotionData

Array = NDArray[np.float64]

#: Columns of each model's targets that an axis pools; FDM pools both swing feet, and has no yaw.
AXES: dict[str, dict[str, tuple[int, ...]]] = {
    "fdm": {"x": (0, 3), "y": (1, 4), "z": (2, 5)},
    "cdm": {"x": (0,), "y": (1,), "z": (2,), "yaw": (3,)},
    "cvm": {"x": (0,), "y": (1,), "yaw": (2,)},
}


def axis_unit(model: str, axis: str) -> str:
    """SI unit of a model's axis."""
    return {"cvm": "m/s"}.get(model, "m") if axis != "yaw" else {"cvm": "rad/s"}.get(model, "rad")


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Predictions for steps that the models had not seen.

    Attributes:
        steps: what was measured, canonical.
        means: ``full``, ``no_history``, ``no_feet``, ``poly2`` by least squares, ``bayesian`` and ``poly2_bayesian``;
            each model name to (n, k).
        std: of ``bayesian``: model name to (n, k).
        block: (n,) number of the block that the bootstrap keeps together, increasing.
        split: how the steps were held out, in words.
        formulation: of the Bayesian models.
    """

    steps: MotionData
    means: dict[str, dict[str, Array]]
    std: dict[str, Array]
    block: NDArray[np.intp]
    split: str
    formulation: str

    def error(self, which: str, model: str) -> Array:
        """Prediction minus measurement: (n, k)."""
        return self.means[which][model] - self.steps.targets[model]
